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
What the damper does to the simulated reference arm, as tables.

Frequencies with the joints held, settling after a move, decay after a tap, for payloads of 0 to
400 g. What models explain with the damper and without it is in ``python -m papers figures``.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
import sys

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.arm.limits import planned_limits
from tudor_dynamics.mechanics.closed_loop import ClosedLoop
from tudor_dynamics.mechanics.hardware import Imperfections, Push, with_payload
from tudor_dynamics.mechanics.run import modes
from tudor_dynamics.signals.filters import ring_modes, RingMode
from tudor_dynamics.signals.motion_profile import follow_targets, motion_limits

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from papers.figures import free_of_positions  # noqa: E402, I100

PAYLOADS = (0.0, 0.1, 0.2, 0.3, 0.4)
# Finite elements, joints held by elastic gears: first two frequencies [Hz] at q3 = 0, 45,
# 90 deg; fitted to ring-downs in the public recordings of the arm at 0 g, computed beyond.
EXPECTED = {
    0.0: ((3.05, 14.7), (3.14, 13.9), (3.38, 12.5)), 0.1: ((2.53, 10.6), (2.64, 9.6), (2.99, 8.1)),
    0.2: ((2.20, 9.5), (2.31, 8.3), (2.69, 6.8)), 0.3: ((1.97, 9.0), (2.08, 7.7), (2.46, 6.0)),
    0.4: ((1.79, 8.7), (1.90, 7.3), (2.27, 5.6))}
BAND = 10.0  # um/m
NEAR = np.radians(0.2)


def weightless(arm: Arm) -> Arm:
    """Take gravity away."""
    return Arm(arm.spec.model_copy(update={'gravity': (0.0, 0.0, 0.0)}), arm.full_model,
               arm.source, arm.urdf)


def plane_frequencies(arm: Arm, payload: float, q3: float) -> NDArray[np.float64]:
    """Give the first two frequencies of bending in the plane, rotors held [Hz]."""
    loop = ClosedLoop(with_payload(arm, payload))
    loop.reset([0.0, q3])
    found = modes(loop.plant, 8, arm.active_joints)
    across = [i for i, name in enumerate(loop.plant.mechanism.coordinate_names)
              if name.split()[0] in ('uz', 'rx', 'ry')]
    share = (found.shape[:, across] ** 2).sum(axis=1) / (found.shape**2).sum(axis=1)
    return found.frequency[share < 0.5][:2]


def frequencies(arm: Arm, title: str) -> None:
    """Print frequencies beside the expected ones."""
    print(f'frequencies with joints held, {title} [Hz]: first, second (expected, deviation)')
    worst = 0.0
    for payload, rows in EXPECTED.items():
        parts = []
        for q3, expected in zip((0.0, 45.0, 90.0), rows, strict=True):
            found = plane_frequencies(arm, payload, np.radians(q3))
            off = found / expected - 1.0
            worst = max(worst, float(np.abs(off).max()))
            parts.append('  '.join(f'{f:5.2f} ({e:g}, {100 * d:+.1f} %)'
                                   for f, e, d in zip(found, expected, off, strict=True)))
        print(f'  {1000 * payload:3.0f} g  ' + ' | '.join(parts))
    print(f'  largest deviation {100 * worst:.1f} %')


def stretched(arm: Arm) -> NDArray[np.float64]:
    """Give the pose nearest to stretched out and horizontal in the planned range [rad]."""
    planned = planned_limits(arm)
    return np.clip(np.zeros(len(planned.lower)), planned.lower, planned.upper)


def settle(arm: Arm, payload: float, damping: float, move: tuple[float, float]) -> str:
    """Give settling of the strain, return and overshoot of the joints after a move."""
    loop = ClosedLoop(with_payload(arm, payload), damping=damping, seed=1)
    start = stretched(arm)
    loop.reset(start)
    begin, target = np.array([2.0]), start + np.radians(move)
    reference = follow_targets(
        start, [begin, begin], [target[:1], target[1:]], motion_limits(arm), loop.dt,
        int(10.0 / loop.dt))
    seen = loop.run(reference.q, reference.dq)
    ends = seen.t[np.flatnonzero(np.abs(reference.dq).max(axis=1) > 1e-9)[-1]]
    # The mean over the last oscillations is the final value; over 10 ms noise is averaged out.
    strain = seen.strain[:, 0] - seen.strain[seen.t > 7.0, 0].mean()
    strain = np.convolve(strain, np.full(20, 0.05), 'same')[:-20]
    t = seen.t[:-20]
    outside = t[np.abs(strain) > BAND]
    error = np.abs(seen.q - seen.q_ref).max(axis=1)
    away = seen.t[error > NEAR]
    peak = np.abs(strain[t > ends]).max()
    never = outside.size and outside[-1] > t[-1] - 0.3
    time_text = f'> {t[-1] - ends:.1f}' if never else f'{max(outside[-1] - ends, 0.0):5.2f}'
    back = max(away[-1] - ends, 0.0) if away.size else 0.0
    over = np.degrees(((seen.q - target) * np.sign(move)).max())
    return f'{time_text:>6} s  {peak:5.0f} um/m  {back:4.2f} s  {max(over, 0.0):4.1f} deg'


def settling(arm: Arm) -> None:
    """Print settling after moves."""
    free = free_of_positions(arm)
    for chosen, move, where in (
            (free, (45.0, -45.0), "(0, 0), the paper's Figure 2, limits of position lifted"),
            (arm, (45.0, -45.0), 'as stretched out as the planned range allows'),
            (free, (30.0, -30.0), '(0, 0)'), (free, (20.0, 20.0), '(0, 0)')):
        print(f'\nmove of {move} deg from {where}:\nlink 2 within 10 um/m of its final value, '
              'residual peak, joints within 0.2 deg after the end of\nthe reference; overshoot')
        for payload in PAYLOADS:
            print(f'  {1000 * payload:3.0f} g   damped {settle(chosen, payload, 1.0, move)}'
                  f'   undamped {settle(chosen, payload, 0.0, move)}')


QUIET = Imperfections(strain_noise=False, strain_resolution=False, current_noise=False)
FREE = dataclasses.replace(QUIET, friction=False, backlash=False)


def tap(arm: Arm, payload: float, damping: float, chosen: Imperfections,
        ) -> tuple[list[RingMode], list[RingMode]]:
    """Give what rings after a tap: below 5 Hz at the gauge of link 2, above at that of link 3."""
    loop = ClosedLoop(with_payload(arm, payload), damping=damping, imperfections=chosen)
    q = np.radians([45.0, -45.0])
    loop.reset(q)
    last = arm.active_joints[-1]
    length = loop.plant.mechanism.length(last)
    loop.set_pushes([Push(3.0, 0.06, last, length, (0.0, 0.0, -6.0), 0.03)])
    steps = int(5.5 / loop.dt)
    seen = loop.run(np.tile(q, (steps, 1)), np.zeros((steps, 2)))
    after = seen.strain[seen.t > 3.08][:int(1.2 / loop.dt)]
    return ([mode for mode in ring_modes(after[:, 0], loop.dt, count=3)
             if 1.0 < mode.frequency < 5.0],
            [mode for mode in ring_modes(after[:, 1], loop.dt, count=3) if mode.frequency > 5.0])


def taps(arm: Arm, chosen: Imperfections, title: str) -> None:
    """Print damping ratios after a tap on the tip at standstill."""
    print(f'\ntap on the tip (6 N, 60 ms) at (45, -45) deg, {title}: frequency and damping ratio '
          'of the first two modes')
    for payload in PAYLOADS:
        texts: dict[str, list[str]] = {'damped': [], 'undamped': []}
        for free, damped in zip(tap(arm, payload, 0.0, chosen), tap(arm, payload, 1.0, chosen),
                                strict=True):
            mode = max(free, key=lambda item: item.amplitude)
            same = min(damped, key=lambda item: abs(np.log(item.frequency / mode.frequency)),
                       default=None)
            for name, item in (('undamped', mode), ('damped', same)):
                texts[name].append('nothing rings' if item is None else
                                   f'{item.frequency:5.2f} Hz {item.damping:.3f}')
        print(f'  {1000 * payload:3.0f} g   ' + '   '.join(
            f'{name} {"  ".join(found)}' for name, found in texts.items()))


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--arm', default='config/tudor.yaml', metavar='YAML')
    args = parser.parse_args()
    arm = load_arm(args.arm)
    frequencies(weightless(arm), 'straight links without weight')
    frequencies(arm, 'links bent and tilted by their weight')
    settling(arm)
    taps(arm, QUIET, 'friction and backlash')
    taps(arm, FREE, 'without friction and backlash')


if __name__ == '__main__':
    main()
