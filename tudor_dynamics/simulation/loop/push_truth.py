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

"""Pushes of a recording: their random choice, and the truth about them as messages."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
import pinocchio as pin

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.kinematics import joint_axis, link_frame
from tudor_dynamics.bags.layouts.messages import WrenchSeries
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.simulation.loop.pushes import link_length, Push, push_forces, push_table
from tudor_dynamics.simulation.loop.signals import LoopRecord
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.simulation.mechanics.mechanism import Mechanism

PUSH_FORCE = (3.0, 12.0)  # N
PUSH_TIME = (0.1, 1.0)  # s
HELD_FORCE = (2.0, 6.0)  # N
HELD_TIME = (1.5, 4.0)  # s
FIRST_PUSH = 3.0  # s: not before the arm moves


def random_pushes(
    arm: Arm, mechanism: Mechanism, count: int, seconds: float, seed: int, *,
    held: bool = False,
) -> tuple[Push, ...]:
    """
    Choose pushes on any beam, one after the other, across the axis of its joint.

    Parameters
    ----------
    arm, mechanism : Arm, Mechanism
        What is pushed.
    count : int
        Number of pushes.
    seconds : float
        Length of the recording [s].
    seed : int
        Of the choice.
    held : bool, default=False
        Let every second push be weaker and last for seconds.

    Returns
    -------
    tuple of Push
        In the order of time.

    Raises
    ------
    SimulationError
        If they do not fit into the recording.

    """
    if count == 0:
        return ()
    slot = (seconds - FIRST_PUSH) / count
    longest = HELD_TIME[1] if held else PUSH_TIME[1]
    if slot < 1.5 * longest + 0.5 * PUSH_TIME[1]:
        room = 1.5 * longest + 0.5 * PUSH_TIME[1]
        msg = (f'{count} pushes do not fit into {seconds:g} s: each takes up to {room:g} s after '
               f'the first {FIRST_PUSH:g} s; record longer or push less')
        raise SimulationError(msg)
    beams = [joint for joint in arm.active_joints if link_length(mechanism, joint) > 0.0]
    if not beams:
        msg = f'{arm.source}: no active joint moves an elastic link that could be pushed'
        raise SimulationError(msg)
    data = arm.full_model.createData()
    pin.forwardKinematics(arm.full_model, data, pin.neutral(arm.full_model))
    rng = np.random.default_rng(seed)
    result = []
    for number in range(count):
        joint = beams[int(rng.integers(len(beams)))]
        times, forces = ((HELD_TIME, HELD_FORCE) if held and number % 2 else
                         (PUSH_TIME, PUSH_FORCE))
        duration = float(rng.uniform(*times))
        begin = FIRST_PUSH + slot * number + rng.uniform(0.0, slot - 1.5 * duration)
        axis = (data.oMi[arm.full_model.getJointId(joint)].rotation
                @ joint_axis(arm.full_model, joint))
        across = np.cross(axis, rng.standard_normal(3))
        force = across / np.linalg.norm(across) * rng.uniform(*forces)
        place = float(rng.uniform(0.2, 1.0)) * link_length(mechanism, joint)
        fx, fy, fz = (round(float(value), 4) + 0.0 for value in force)
        result.append(Push(round(float(begin), 3), round(duration, 3), joint, round(place, 4),
                           (fx, fy, fz)))
    return tuple(result)


def push_wrenches(
    arm: Arm, mechanism: Mechanism, pushes: tuple[Push, ...], signals: LoopRecord,
    stamp: NDArray[np.int64],
) -> WrenchSeries:
    """
    Give the truth about the pushes, each in the frame of its (rigid) link.

    stamp (samples,) [ns].
    """
    forces = push_forces(push_table(pushes, mechanism), signals.t)
    force, torque = np.zeros((2, len(stamp), 3))
    frames = ['base'] * len(stamp)
    model = arm.full_model
    data = model.createData()
    hold = {joint.name: joint.hold for joint in arm.spec.joints}
    columns = [model.joints[model.getJointId(name)].idx_q for name in arm.active_joints]
    q = np.zeros(model.nq)
    for name, value in hold.items():
        q[model.joints[model.getJointId(name)].idx_q] = value
    for push, values in zip(pushes, forces, strict=True):
        floats = mechanism.body_float[mechanism.body_of[push.joint]]
        along = floats[at.BODY_ROTATION:at.BODY_ROTATION + 9].reshape(3, 3)[:, 0]
        place = floats[at.BODY_PLACE:at.BODY_PLACE + 3] + push.distance * along
        index, frame = model.getJointId(push.joint), link_frame(model, push.joint)
        for row in np.flatnonzero(np.any(values != 0.0, axis=1)):
            q[columns] = signals.q_true[row]
            pin.forwardKinematics(model, data, q)
            force[row] = data.oMi[index].rotation.T @ values[row]
            torque[row] = np.cross(place, force[row])
            frames[row] = frame
    return WrenchSeries('/applied_wrench', stamp, force, torque, frames)
