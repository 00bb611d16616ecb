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
Table of lying drives and encoders: what the arm truly did, and what was said.

The lies and what must hold are those of the tests (test/lying.py); here all of them are combined
with all situations. One line is the worst over rates, payloads, driver's velocities and limits;
exit 1 where anything did not hold.
"""

from __future__ import annotations

import argparse
from itertools import groupby, product
from pathlib import Path
import sys
import time

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / 'test'))

from lying import (  # noqa: E402, I100
    cases, LIES, Outcome, run, SCALES, STARTS, to_a_limit, VELOCITIES)


def row(outcomes: list[Outcome]) -> str:
    """Give the worst of some outcomes in a line."""
    found = np.array([item.found for item in outcomes])
    worst = max(outcomes, key=lambda item: (len(item.broken), item.false))
    missed = int(np.isnan(found).sum())
    latest = '    -' if missed == len(found) else f'{np.nanmax(found):5.2f}'
    return (f'{len(outcomes):3d} {sum(bool(item.broken) for item in outcomes):3d} {missed:3d} '
            f'{latest} {max(i.false for i in outcomes):6.1f} '
            f'{max(i.beyond for i in outcomes):6.1f} {max(i.speed for i in outcomes):5.0f} '
            f'{np.nanmax([0.0, *(i.still for i in outcomes)]):5.2f}  {worst.cause}')


def scales(rates: list[float], payloads: list[float]) -> None:
    """Print how far beyond a limit small errors of scale lead joint2, and what is said."""
    for scale in SCALES:
        found = [to_a_limit(scale, rate, payload, velocity) for rate, payload, velocity in product(
            rates, payloads, ('truth', 'absent'))]
        print(f'{scale:4g} {np.degrees(max(found)[0]):5.1f} deg beyond: '
              f'{sorted({text for _, text in found})}', flush=True)


def main() -> int:
    """Run what is asked for, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--rates', type=float, nargs='+', default=(100.0, 500.0), metavar='HZ')
    parser.add_argument('--payloads', type=float, nargs='+', default=(0.0, 0.4), metavar='KG')
    parser.add_argument('--velocities', nargs='+', default=VELOCITIES, choices=VELOCITIES)
    parser.add_argument('--starts', nargs='+', default=STARTS, choices=STARTS)
    parser.add_argument('--only', default='', metavar='TEXT', help='part of the name of a lie')
    parser.add_argument('--brief', action='store_true', help='no list of what did not hold')
    parser.add_argument('--scales', action='store_true',
                        help='small errors of scale alone, on the way through the range')
    args = parser.parse_args()
    if args.scales:
        scales(args.rates, args.payloads)
        return 0
    begun, every = time.perf_counter(), []
    print(f'{"lie":34s}{"since":8s}runs bad missed; latest [s], false [deg], beyond [deg], '
          'speed [deg/s], standstill [s], text')
    for (name, start), group in groupby(
            cases(args.rates, args.payloads, args.velocities, args.starts,
                  [lie for lie in LIES if args.only in lie.name]),
            key=lambda case: (case.lie.name, case.start)):
        outcomes = [run(case) for case in group]
        print(f'{name:34s}{start:8s}{row(outcomes)}', flush=True)
        every += outcomes
        for item in [] if args.brief else outcomes:
            if item.broken:
                print(f'  {item.case}: {"; ".join(item.broken)}; said: {item.cause!r}')
    broken = [item for item in every if item.broken]
    print(f'{len(every)} runs in {time.perf_counter() - begun:.0f} s, {len(broken)} did not keep '
          'to what must hold')
    return bool(broken)


if __name__ == '__main__':
    raise SystemExit(main())
