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
Random sequences of faults, references, settings and reactions on the commanded arm.

The state machine is that of the tests (test/motion_machine.py); here it runs through many more
sequences. In each sample position, speed and acceleration must be within the limits of the
description; the seed of a failure is printed, and the sequence that shows it.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys
import time

from hypothesis import HealthCheck, Phase, seed, settings
from hypothesis.stateful import run_state_machine_as_test

sys.path.insert(0, str(Path(__file__).parent.parent / 'test'))

from motion_machine import MotionMachine  # noqa: E402


def main() -> int:
    """Run the sequences and say how many kept to the limits."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--sequences', type=int, default=1000, metavar='N')
    parser.add_argument('--steps', type=int, default=12, metavar='N', help='of each sequence')
    parser.add_argument('--seed', type=int, default=0, metavar='N')
    args = parser.parse_args()
    begun, machines, seconds = time.perf_counter(), 0, 0.0

    class Counted(MotionMachine):
        """Counts what was simulated."""

        def teardown(self) -> None:
            nonlocal machines, seconds
            machines += 1
            seconds += self.rig.t if self.rig is not None else 0.0
            if sys.stderr.isatty():
                print(f'\r{machines} of {args.sequences}', end='', file=sys.stderr, flush=True)

    chosen = settings(max_examples=args.sequences, stateful_step_count=args.steps, deadline=None,
                      database=None, phases=[Phase.generate],
                      suppress_health_check=list(HealthCheck))
    try:
        run_state_machine_as_test(seed(args.seed)(Counted), settings=chosen)
    except AssertionError as err:
        print(f'beyond the limits with --seed {args.seed}, after {machines} sequences: {err}',
              *getattr(err, '__notes__', []), sep='\n')
        return 1
    print(f'{machines} sequences (seed {args.seed}), {seconds / 3600.0:.1f} h of simulated '
          f'time in {time.perf_counter() - begun:.0f} s: none left the limits')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
