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

    python bench/command_cost.py evaluate --model model BAG
    python bench/command_cost.py --against ../before fit BAG --arm ARM --out model --overwrite
    python bench/command_cost.py --against ../before --script bench/simulate_speed.py
    python bench/command_cost.py --against ../before -- --help

CPU time counts user and system, with one thread for linear algebra; beside other work it is the
figure to compare. The first run is not counted: it reads files from disk, and compiles what is not
kept yet. With another checkout both run by turns; the ratio is that of CPU times, before / now:
above 1 the tree here is faster.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import resource
import subprocess
import sys
import time

import numpy as np
from tables import show

ROOT = Path(__file__).resolve().parents[1]


def run(tree: Path, words: list[str]) -> tuple[float, float]:
    """Run a command of a tree here; CPU and wall time [s]."""
    environment = {**os.environ, 'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1',
                   'PYTHONPATH': str(tree)}
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(words, stdout=subprocess.DEVNULL, env=environment, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode > 1:  # 1 is an answer
        raise SystemExit(done.returncode)
    return (after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
            time.perf_counter() - begun)


def main() -> int:
    """Print the table; the exit code of the command where it fails."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--runs', type=int, default=5)
    parser.add_argument('--against', metavar='TREE', type=Path, help='checkout to compare with')
    parser.add_argument('--script', action='store_true',
                        help='the words are a script of each tree and its options')
    parser.add_argument('command', nargs=argparse.REMAINDER, metavar='...',
                        help='words after `tudor`, such as: evaluate --model model BAG')
    args = parser.parse_args()
    args.command = args.command[args.command[:1] == ['--']:]
    trees = [ROOT] if args.against is None else [args.against.resolve(), ROOT]
    taken: dict[Path, list[tuple[float, float]]] = {tree: [] for tree in trees}
    for _ in range(1 + args.runs):
        for tree in trees:
            words = ([str(tree / args.command[0]), *args.command[1:]] if args.script
                     else ['-m', 'tudor_dynamics', *args.command])
            taken[tree].append(run(tree, [sys.executable, *words]))
    used = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    name = ' '.join(args.command if args.script else ['tudor', args.command[0]])
    show(('command', 'CPU, median', 'time, median', 'memory, most'), (
        (name + (', before' if tree is not ROOT else ''), *(
            f'{np.median(column):.2f} s ({column.min():.2f} to {column.max():.2f})'
            for column in np.array(taken[tree][1:]).T), f'{used:.0f} MiB') for tree in trees))
    if len(trees) > 1:
        ratios = np.array([before[0] / now[0] for before, now in zip(
            taken[trees[0]][1:], taken[ROOT][1:], strict=True)])
        print(f'ratio of CPU times, before / now: median {np.median(ratios):.2f}, from '
              f'{ratios.min():.2f} to {ratios.max():.2f}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
