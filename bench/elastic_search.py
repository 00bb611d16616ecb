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
Time of the search for an elastic model: arms side by side, and one after the other.

Run with ``OMP_NUM_THREADS=1 python bench/elastic_search.py``. The recording is made by the
simulator (or given with ``--bag`` and ``--arm``). What is compiled is warm; each figure is from
one run of the search alone, CPU time of all threads beside the time that passed. The last row is
the whole command, from start to report.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.cli.main import main as tudor
from tudor_dynamics.identification import elastic_problem
from tudor_dynamics.identification.dataset import load, parse_choice
from tudor_dynamics.identification.elastic_problem import records_of
from tudor_dynamics.identification.elastic_search import identify

ROOT = Path(__file__).resolve().parents[1]


def main() -> int:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--bag', help='recording with strain; simulated by default')
    parser.add_argument('--arm', default=str(ROOT / 'config' / 'tudor.yaml'))
    parser.add_argument('--seconds', type=float, default=80.0, help='length of what is simulated')
    options = parser.parse_args()
    with TemporaryDirectory() as place:
        bag = options.bag
        if not bag:
            bag = f'{place}/bags/stimulus_01'
            if tudor(['record', '--arm', options.arm, '--payload', '0.2', '--stimuli', '1',
                      '--seconds', str(options.seconds), '--out', f'{place}/bags']):
                return 1
        arm = load_arm(options.arm)
        records = records_of([load(parse_choice(bag), arm, arm.spec.preprocessing, learn=True)])
        identify(arm, [record.head(3.0) for record in records])  # compiled now
        print(f'{"":34}{"time":>8}{"CPU":>9}{"fit":>9}')
        for lanes, name in ((elastic_problem.LANES, 'side by side'), (1, 'one after the other')):
            elastic_problem.LANES = lanes
            begin, cpu = perf_counter(), process_time()
            found = identify(arm, records)
            print(f'{name:34}{perf_counter() - begin:6.1f} s{process_time() - cpu:7.1f} s'
                  f'{found.fit:7.2f} %', flush=True)
        begin = perf_counter()
        subprocess.run([sys.executable, '-m', 'tudor_dynamics', 'fit', bag, '--arm', options.arm,
                        '--models', 'elastic', '--out', f'{place}/model'],
                       check=False, stdout=subprocess.DEVNULL)
        print(f'{"tudor fit --models elastic":34}{perf_counter() - begin:6.1f} s')
    return 0


if __name__ == '__main__':
    sys.exit(main())
