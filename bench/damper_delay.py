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
What the delay of the loop leaves of the damper's gain: stability over delay, rate and gain.

One move of the simulated arm for each combination, with all imperfections and a fixed share of the
gains of the description; 4 s after its end the strain that still rings is compared with that of
the arm without damper. The rule that ``oscillation_damper`` follows is drawn beside.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
import itertools
import os

from matplotlib.figure import Figure
import numpy as np
from tables import show

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.arm.limits import planned_limits
from tudor_dynamics.control.cascade import damping_share
from tudor_dynamics.control.motion_controller import State
from tudor_dynamics.mechanics.rig import Rig
from tudor_dynamics.models.tuning import design, TunedArm, Wish

DELAYS = (0.0, 0.01, 0.02, 0.03, 0.04, 0.06, 0.08)
SHARES = (0.125, 0.25, 0.5, 1.0, 2.0)
RATES = (100.0, 200.0, 500.0, 1000.0)
QUIET = 5.0
"""Ringing of damped links that is noise and play [um/m]."""


def ringing(arm: Arm, rate: float, payload: float, delay: float, share: float) -> float:
    """Give the strain that rings 4 to 5 s after a move, RMS over the damper's gauges [um/m]."""
    rig = Rig(arm, rate=rate, payload=payload, delay=delay, share=share)
    assert rig.controller is not None and rig.source is not None
    rig.controller.gains.adapts = False
    rig.run(1.0)
    planned = planned_limits(arm)
    rig.source.go(planned.lower + np.array([0.3, 0.25]) * (planned.upper - planned.lower))
    rig.step()
    assert rig.source.motion is not None
    rig.run(rig.source.motion.remaining + 4.0)
    begin = len(rig.trace.t)
    rig.run(1.0)
    index = [arm.gauge_names.index(name) for name in rig.controller.damper.gauges]
    strain = rig.trace.array('strain')[begin:, index]
    return float(np.sqrt(((strain - strain.mean(axis=0)) ** 2).mean()))


def chart(
    arm: Arm, payloads: list[float], jobs: int,
) -> dict[tuple[float, float, float], tuple[float, float]]:
    """Give for each rate, delay and share the worst ringing over payloads, and that without."""
    cases = [(rate, payload, delay, share) for rate, delay, payload in itertools.product(
        RATES, DELAYS, payloads) for share in (0.0, *SHARES) if share or delay == 0.0]
    with ProcessPoolExecutor(jobs) as pool:
        found = dict(zip(cases, pool.map(_case, [(arm.source, *case) for case in cases]),
                         strict=True))
    return {(rate, delay, share): max(
        ((found[rate, payload, delay, share], found[rate, payload, 0.0, 0.0])
         for payload in payloads), key=lambda pair: pair[0] / pair[1])
        for rate, delay, share in itertools.product(RATES, DELAYS, SHARES)}


def _case(case: tuple[str, float, float, float, float]) -> float:
    source, rate, payload, delay, share = case
    return ringing(load_arm(source), rate, payload, delay, share)


def mark(with_damper: float, without: float) -> str:
    """Say what the damper does: damps, does little, or excites."""
    if with_damper < max(0.5 * without, QUIET):
        return 'damps'
    return 'weak' if with_damper <= 1.5 * without else 'EXCITES'


def draw(found: dict[tuple[float, float, float], tuple[float, float]], full: float,
         path: str) -> None:
    """Draw the chart: one panel a rate, signs that can be told in grey."""
    figure = Figure(figsize=(11.0, 3.8))
    axes = figure.subplots(1, len(RATES), sharey=True)
    signs = {'damps': ('o', 'white', 'damps'), 'weak': ('o', '0.6', 'does little'),
             'EXCITES': ('X', 'black', 'excites')}
    x = np.linspace(0.0, 1.1 * max(DELAYS), 200)
    for axis, rate in zip(axes, RATES, strict=True):
        for kind, (sign, colour, label) in signs.items():
            points = [(1e3 * delay, share) for (r, delay, share), pair in found.items()
                      if r == rate and mark(*pair) == kind]
            axis.plot(*(np.array(points).T if points else ([], [])), sign, mec='black', mfc=colour,
                      ms=7, ls='none', label=label)
        # a command is held for a sample, and the answer seen one later
        axis.plot(1e3 * x, [max(damping_share(d + 1.0 / rate, full), 1e-3) for d in x], 'k-',
                  lw=1.5, label='rule of the node')
        axis.set(title=f'{rate:g} Hz', xlabel='delay of the loop [ms]', yscale='log',
                 ylim=(0.08, 2.8))
        axis.set_yticks(SHARES, [f'{share:g}' for share in SHARES])
        axis.grid(color='0.85')
    axes[0].set_ylabel('part of the gain')
    figure.legend(*axes[0].get_legend_handles_labels(), loc='lower center', ncols=4, fontsize=9)
    figure.tight_layout(rect=(0.0, 0.08, 1.0, 1.0))
    figure.savefig(path, dpi=110)


def quiet(case: tuple[str, float, float, float]) -> tuple[float, bool]:
    """Give the largest command 5 s after each of three moves [deg/s], and whether it followed."""
    source, rate, delay, payload = case
    arm = load_arm(source)
    rig = Rig(arm, rate=rate, payload=payload, delay=delay, seed=1)
    assert rig.controller is not None and rig.source is not None
    rig.run(1.0)
    planned = planned_limits(arm)
    largest = 0.0
    for shares in ((0.02, 0.1), (0.97, 0.9), (0.3, 0.25)):
        rig.source.go(planned.lower + np.array(shares) * (planned.upper - planned.lower))
        rig.step()
        assert rig.source.motion is not None
        rig.run(rig.source.motion.remaining + 5.0)
        begin = len(rig.trace.t)
        rig.run(0.5)
        largest = max(largest, float(np.degrees(np.abs(
            rig.trace.array('command')[begin:]).max())))
    return largest, rig.controller.state is State.FOLLOWING and not rig.controller.gains.excited


def moves(arm: Arm, payloads: list[float], jobs: int) -> int:
    """Print what is commanded after moves with the node's rule in force; 0 where all is quiet."""
    cases = [(arm.source, rate, delay, payload) for rate, delay, payload in itertools.product(
        RATES, (*DELAYS, 0.05), payloads)]
    with ProcessPoolExecutor(jobs) as pool:
        found = list(pool.map(quiet, cases))
    for rate in RATES:
        mine = [item for case, item in zip(cases, found, strict=True) if case[1] == rate]
        print(f'{rate:5g} Hz: at most {max(speed for speed, _ in mine):.2f} deg/s 5 s after a '
              f'move, {sum(not good for _, good in mine)} of {len(mine)} not followed')
    return 0 if all(speed < 1.0 and good for speed, good in found) else 1


def ratios(arm: Arm, payloads: list[float]) -> None:
    """Print which damping ratios `tudor tune` reaches at a delay, with room for twice of it."""
    rows = []
    for delay in (0.005, 0.01, 0.02, 0.03, 0.04):
        reached = design(TunedArm(arm, None), Wish(0.95, delay, tuple(payloads))).column('reached')
        rows.append((f'{1e3 * delay:g} ms', *(f'{of.min():.2f} to {of.max():.2f}'
                                              for of in reached)))
    show(('delay', *(f'{1e3 * payload:g} g' for payload in payloads)), rows)


def main() -> int:
    """Print the chart as a table, and draw it."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--arm', default='config/tudor.yaml', metavar='YAML')
    parser.add_argument('--payloads', type=float, nargs='+', default=[0.0, 0.2, 0.4], metavar='KG')
    parser.add_argument('--jobs', type=int, default=os.cpu_count() or 1, metavar='N')
    parser.add_argument('--picture', metavar='PNG', help='draw it there')
    parser.add_argument('--moves', action='store_true',
                        help='instead, moves with the rule of the node in force')
    parser.add_argument('--ratios', action='store_true',
                        help='instead, damping ratios of `tudor tune` that the delay allows')
    args = parser.parse_args()
    arm = load_arm(args.arm)
    if args.moves:
        return moves(arm, args.payloads, args.jobs)
    if args.ratios:
        ratios(arm, args.payloads)
        return 0
    found = chart(arm, args.payloads, args.jobs)
    for rate in RATES:
        print(f'\n{rate:g} Hz: strain that rings 4 s after a move, over that without damper; '
              'worst payload\ndelay [ms]   ' + ''.join(f'{share:>14g}' for share in SHARES))
        for delay in DELAYS:
            print(f'{1e3 * delay:10.0f}   ' + ''.join(
                f'{found[rate, delay, share][0] / found[rate, delay, share][1]:6.2f} '
                f'{mark(*found[rate, delay, share]):7s}' for share in SHARES))
    assert arm.spec.damper is not None
    if args.picture:
        draw(found, arm.spec.damper.full_delay, args.picture)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
