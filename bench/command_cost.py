# Copyright 2026 tudor_dynamics contributors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.


"""
Time and memory of a `tudor` command, run several times in processes of its own.

CPU time counts user and system, with one thread for linear algebra; beside other work it is the
figure to compare. The first run is not counted: it reads files from disk, and compiles what is not
kept yet.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import time

import numpy as np


def main() -> int:
    """Print the table; the exit code of the command where it fails."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--runs', type=int, default=5)
    parser.add_argument('command', nargs=argparse.REMAINDER, metavar='...',
                        help='words behind `tudor`, such as: evaluate --model model BAG')
    args = parser.parse_args()
    words = [sys.executable, '-m', 'tudor_dynamics', *args.command]
    environment = {**os.environ, 'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'}
    taken = []
    for _ in range(1 + args.runs):
        before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        done = subprocess.run(words, stdout=subprocess.DEVNULL, env=environment, check=False)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        if done.returncode > 1:  # 1 is an answer
            return done.returncode
        taken.append((after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
                      time.perf_counter() - begun))
    for name, column in zip(('CPU', 'time'), np.array(taken[1:]).T, strict=True):
        print(f'{name:5s} median {np.median(column):.2f} s, from {column.min():.2f} to '
              f'{column.max():.2f} s')
    print(f'memory {after.ru_maxrss / 1024:.0f} MiB at most')
    return 0


if __name__ == '__main__':
    sys.exit(main())
