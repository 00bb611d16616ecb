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
What the damper's settings trade: overshoot of the joints against settling of the links.

Moves of the simulated arm with all imperfections, over the gain and the two frequencies of the
mean. For each setting the worst overshoot beyond the target and the mean time until link 2 stays
within 10 um/m of its final value.
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
from tudor_dynamics.mechanics.closed_loop import ClosedLoop
from tudor_dynamics.mechanics.hardware import with_payload
from tudor_dynamics.signals.motion_profile import follow_targets, motion_limits

MOVES = (((18.0, 0.0), (45.0, -45.0)), ((100.0, -30.0), (-45.0, 60.0)),
         ((150.0, 40.0), (-90.0, -60.0)), ((20.0, -60.0), (20.0, 20.0)))
"""Start and way of each move [deg]."""
FREQUENCIES = ((0.3, 0.3), (0.5, 0.5), (0.5, 1.0), (0.5, 2.0), (0.5, 4.0))
"""Of the mean at rest and while the reference moves [Hz]."""
PARTS = (0.6, 0.8, 1.0, 1.3)
"""Of the gains of the description."""
BAND = 10.0


def changed(arm: Arm, rest: float, moving: float, part: float) -> Arm:
    """Give an arm with other settings of its damper."""
    damper = arm.spec.damper
    assert damper is not None
    joints = tuple(item.model_copy(update={'gain': part * item.gain}) for item in damper.joints)
    spec = arm.spec.model_copy(update={'damper': damper.model_copy(update={
        'joints': joints, 'mean_frequency': rest, 'moving_frequency': moving})})
    return Arm(spec, arm.full_model, arm.source, arm.urdf)


def one(case: tuple[str, float, float, float, float]) -> tuple[float, float]:
    """Give the worst overshoot [deg] and the mean settling [s] of a setting."""
    source, payload, rest, moving, part = case
    arm = with_payload(changed(load_arm(source), rest, moving, part), payload)
    overshoot, settling = 0.0, []
    for start, way in np.radians(MOVES):
        loop = ClosedLoop(arm, seed=1)
        loop.reset(start)
        begin = np.array([2.0])
        reference = follow_targets(
            start, [begin] * 2, [np.array([x]) for x in start + way], motion_limits(arm), loop.dt,
            int(8.0 / loop.dt))
        seen = loop.run(reference.q, reference.dq)
        ends = seen.t[np.flatnonzero(np.abs(reference.dq).max(axis=1) > 1e-9)[-1]]
        strain = seen.strain[:, 0] - seen.strain[seen.t > 6.0, 0].mean()
        strain = np.convolve(strain, np.full(20, 0.05), 'same')[:-20]
        outside = seen.t[:-20][np.abs(strain) > BAND]
        settling.append(max(outside[-1] - ends, 0.0) if outside.size else 0.0)
        overshoot = max(overshoot, float(np.degrees(
            ((seen.q - start - way) * np.sign(way))[seen.t > 2.0].max())))
    return overshoot, float(np.mean(settling))


def main() -> None:
    """Print the trade-off as a table, and draw it."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--arm', default='config/tudor.yaml', metavar='YAML')
    parser.add_argument('--payload', type=float, default=0.2, metavar='KG')
    parser.add_argument('--jobs', type=int, default=os.cpu_count() or 1, metavar='N')
    parser.add_argument('--picture', metavar='PNG', help='draw it there')
    args = parser.parse_args()
    cases = [(args.arm, args.payload, *frequencies, part)
             for frequencies, part in itertools.product(FREQUENCIES, PARTS)]
    with ProcessPoolExecutor(args.jobs) as pool:
        found = dict(zip(((case[2:4], case[4]) for case in cases), pool.map(one, cases),
                         strict=True))
    print(f'{1000 * args.payload:g} g, {len(MOVES)} moves: largest overshoot, mean settling time')
    show(('mean at rest, in motion', *(f'gains x {part:g}' for part in PARTS)), (
        (f'{rest:g} Hz, {moving:g} Hz', *(
            '{:.1f} deg, {:.2f} s'.format(*found[(rest, moving), part]) for part in PARTS))
        for rest, moving in FREQUENCIES))
    if args.picture:
        figure = Figure(figsize=(6.0, 4.0))
        axis = figure.subplots()
        for frequencies, sign in zip(FREQUENCIES, 'osD^v', strict=True):
            points = np.array([found[frequencies, part] for part in PARTS])
            axis.plot(points[:, 1], points[:, 0], sign + '-', color='black', mfc='white', lw=0.8,
                      label=f'{frequencies[0]:g} Hz at rest, {frequencies[1]:g} Hz moving')
        axis.set(xlabel='settling of link 2, mean of the moves [s]',
                 ylabel='worst overshoot of a joint [deg]', ylim=(0.0, None))
        axis.grid(color='0.85')
        axis.legend(fontsize=8, title='mean of the strain')
        figure.tight_layout()
        figure.savefig(args.picture, dpi=110)


if __name__ == '__main__':
    main()
