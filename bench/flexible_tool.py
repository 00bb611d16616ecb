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
Predict how a beam rings on, by a tool that was fitted to other recordings of it.

Of the recordings of a beam (TUDOR_SHARED_DATA, by default ../shared/data), 27 translations with
the beam up, level and down are the training, of the rigid model first, whose inertia is taken out
of the efforts in all rests: this arm yields as much as the beam. Predicted are: the frequency in
an orientation that was not in training; the amplitude from 1.2 s after the stop on in five
transfers (T1) and in one that rotates (T3), by planned motion and measured torques; and two
repetitions of each run by a fit to the third one.
"""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
import sys
from typing import Any
import warnings

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tudor_dynamics.arm.description import Arm, load_arm  # noqa: E402
from tudor_dynamics.bags.reader import read_recording  # noqa: E402
from tudor_dynamics.bags.recording import Recording  # noqa: E402
from tudor_dynamics.identification.ringdowns import ring_of  # noqa: E402
from tudor_dynamics.identification.tool import find_moves, fit_tool, Moves, REFERENCE  # noqa: E402
from tudor_dynamics.library import fit  # noqa: E402
from tudor_dynamics.models.base import Model  # noqa: E402
from tudor_dynamics.models.flexible_tool import Flange, FlexibleTool  # noqa: E402
from tudor_dynamics.typing import FloatArray  # noqa: E402

DATA = Path(os.environ.get('TUDOR_SHARED_DATA', ROOT / '../shared/data'))
FREQUENCY = {'up': 2.770, 'level': 2.943, 'down': 3.039}


def amplitude(moves: Moves, tool: FlexibleTool) -> FloatArray:
    """Measure a ring where a rest begins, one too small to be found by the tool's frequency."""
    (rest,) = moves.rests
    ring = ring_of(rest.t, rest.effort)
    if ring is not None:
        return np.abs(ring.amplitude)
    t = rest.t - rest.t[0]
    w = 2.0 * math.pi * tool.frequency(moves.flange.motion[-1, 9:])[0].value
    fading = np.exp(-tool.damping[0] * w * t)
    rows = np.column_stack([fading * np.cos(w * t), fading * np.sin(w * t),
                            np.vander(t / t[-1], 4)])
    values = np.linalg.lstsq(rows, rest.effort, rcond=None)[0]
    return np.asarray(np.hypot(values[0], values[1]))


def compared(tool: FlexibleTool, moves: Moves) -> dict[str, Any]:
    """Compare a prediction with what was measured, at the joint that shows most."""
    (rest,), flange = moves.rests, moves.flange
    n = int(np.searchsorted(flange.t, rest.t[0])) + 1
    found = tool.ring(Flange(flange.t[:n], flange.motion[:n], flange.velocity[:n], rest.jacobian))
    size = float(amplitude(moves, tool)[found.loudest])
    return {'measured': size, 'predicted': found.torque.value,
            'interval': [found.torque.low, found.torque.high],
            'inside': found.torque.low <= size <= found.torque.high}


def main() -> int:
    """Measure and print as JSON."""
    warnings.simplefilter('ignore')
    arm = load_arm(DATA / 'arms/panda.yaml')
    reference: Arm = arm.changed(joint_topic=REFERENCE)
    bags = {bag.name.removeprefix('beam_'): (read_recording(bag, arm),
                                             read_recording(bag, reference))
            for bag in sorted((DATA / 'bags').glob('beam_*'))}
    translations = sorted((DATA / 'bags').glob('beam_est_*'))
    model = fit(translations, arm, bare=True).models['effort']['analytical']
    result: dict[str, Any] = {}
    for kind in ('planned', 'measured'):
        result[kind] = figures(arm, {name: (one, plan if kind == 'planned' else None)
                                     for name, (one, plan) in bags.items()}, kind,
                               model)
    print(json.dumps(result, indent=2))
    return 0


def figures(
    arm: Arm, bags: dict[str, tuple[Recording, Recording | None]], kind: str, model: Model,
) -> dict[str, Any]:
    """Measure with one kind of motion."""
    moves = {name: find_moves(arm, *pair, model)[0] for name, pair in bags.items()}
    runs = {name: one for name, one in moves.items() if name.startswith('est_')}
    tool = fit_tool(arm, list(runs.values()), kind)
    frequency = {}
    for pose, truth in FREQUENCY.items():
        others = fit_tool(arm, [one for name, one in runs.items() if f'_{pose}_' not in name],
                          kind)
        there = next(one for name, one in runs.items() if f'_{pose}_' in name).flange.motion[-1]
        found = others.frequency(there[9:])[0]
        frequency[pose] = {'measured': truth, 'predicted': found.value,
                           'interval': [found.low, found.high],
                           'error': abs(found.value / truth - 1.0)}
    with_t1 = fit_tool(arm, [one for name, one in moves.items() if 'T3' not in name], kind)
    transfers = {name: compared(with_t1 if name.startswith('T3') else tool, one)
                 for name, one in moves.items() if name.startswith('T')}
    unshaped = transfers['T1_unshaped']['measured']
    for name, one in transfers.items():
        if name.startswith('T1'):
            one['error_of_unshaped'] = abs(one['predicted'] - one['measured']) / unshaped
    order = [sorted((name for name in transfers if name.startswith('T1')),
                    key=lambda name: float(transfers[name][key])) for key in
             ('measured', 'predicted')]
    first = fit_tool(arm, [one for name, one in runs.items() if name.endswith('_1')], kind)
    again = [compared(first, one) for name, one in runs.items()
             if not name.endswith('_1')]
    return {
        'tool': str(tool), 'place': np.round(tool.place, 3).tolist(),
        'hidden': tool.hidden, 'hidden_with_T1': with_t1.hidden, 'scatter': tool.scatter,
        'frequency_not_in_training': frequency, 'transfers': transfers,
        'order_right': order[0] == order[1], 'order': order,
        'repetitions': {
            'median_error': float(np.median([abs(one['predicted'] / one['measured'] - 1.0)
                                             for one in again])),
            'inside': float(np.mean([one['inside'] for one in again])), 'rings': len(again)}}


if __name__ == '__main__':
    sys.exit(main())
