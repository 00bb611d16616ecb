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

"""Drives altered by hand: coupled ones described without, others described with a coupling."""

from __future__ import annotations

from faults.injected import Fault
from faults.signals import moving, put
import numpy as np

from tudor_dynamics.arm.schema import CouplingPair, CouplingsSpec
from tudor_dynamics.identification.doctor.examine import examine
from tudor_dynamics.signals.filters import zero_phase


FELT = 0.5
"""Part of an effort that the bodies have to make up before a coupling is put in."""


def of_drives(bag, rng):
    """Go through couplings that fit a bag."""
    arm, data = bag.arm, bag.data
    r, names = data.recording, arm.active_joints
    if r.effort is None or len(names) < 2:
        return
    if arm.coupling is not None:
        pair = arm.spec.couplings.pairs[0]
        yield Fault('coupling_missing', ('coupling_missing',), arm.changed(couplings=None),
                    (data,), channels=(pair.motor, pair.joint), size=pair.ratio)
        return
    case = examine(arm, r).case
    # a wrist that carries nothing feels friction alone, and so nothing of a coupling
    felt = [np.std(case.usual['effort'].freed(i, y)) > FELT * np.std(y)
            for i, y in enumerate(case.outputs['effort'].T)]
    joints = {i for i in moving(r) if felt[i]}
    pairs = [(i, j) for i in joints for j in (i - 1, i + 1) if j in joints]
    for k in rng.permutation(len(pairs))[:2]:
        joint, motor = pairs[int(k)]
        ratio = float(rng.choice([-1.0, 1.0]))
        both = names[motor], names[joint]
        spec = CouplingsSpec(pairs=(CouplingPair(motor=both[0], joint=both[1], ratio=ratio),),
                             positions='motors', efforts='motors')
        yield Fault('coupling_wrong', ('coupling_wrong',), arm.changed(couplings=spec), (data,),
                    channels=both)
        matrix = np.eye(len(names))
        matrix[motor, joint] = ratio
        yield Fault('coupling_missing', ('coupling_missing',), arm, (put(
            data, **coupled(arm, r, matrix, motor)),), channels=both, size=ratio)


def coupled(arm, recording, matrix, motor):
    """Give what the motors would have shown, had one been coupled: its friction turns with it."""
    case = examine(arm, recording).case
    output = case.outputs['effort'][:, motor]
    bodies = case.usual['effort'].parameters(case.outputs['effort'])[motor]
    own = case.usual['effort'].own_parameters(motor, output, bodies)
    q = recording.q @ matrix.T
    sharp = 0.03 * float(np.sqrt(np.mean(case.motion[:, len(matrix) + motor] ** 2)))

    def drive(positions):
        motion = zero_phase(recording.t, positions[:, [motor]], 8.0)
        dq = motion.dq[:, 0]
        return np.column_stack([motion.ddq[:, 0], dq, np.tanh(dq / sharp)]) @ own[:3]

    effort = recording.effort.copy()
    effort[:, motor] -= drive(recording.q)
    effort = effort @ np.linalg.inv(matrix)
    effort[:, motor] += drive(q)
    return {'q': q, 'dq': None if recording.dq is None else recording.dq @ matrix.T,
            'effort': effort}
