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

"""Descriptions altered by hand: gravity, tables, gauges, joints."""

from __future__ import annotations

from dataclasses import replace
import math
from pathlib import Path

from faults.injected import Fault
import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.description import arm_from_dict


def altered(arm, **changes):
    """Give an arm with other keys in its description."""
    content = arm.spec.model_dump(mode='json') | changes
    return arm_from_dict(content, base=Path(arm.source).parent, source=arm.source)


def with_gravity(arm, gravity):
    """Give an arm with another gravity."""
    model = pin.Model(arm.full_model)
    model.gravity = pin.Motion(np.array(gravity), np.zeros(3))
    spec = arm.spec.model_copy(update={'gravity': tuple(float(x) for x in gravity)})
    return replace(arm, spec=spec, full_model=model)


def axes(arm):
    """Give the directions of all joint axes in the base frame, where all of them are parallel."""
    model, data = arm.model, arm.model.createData()
    pin.computeJointJacobians(model, data, np.zeros(model.nq))
    columns = data.J[3:, :]
    return columns.T


def of_descriptions(bag, rng):
    """Go through the faults of descriptions that fit a bag."""
    arm, data = bag.arm, bag.data
    own = np.array(arm.spec.gravity)
    size = float(np.linalg.norm(own))
    felt = size > 0.0 and np.abs(np.cross(axes(arm), own)).max() > 0.1
    if felt:
        others = [axis for axis in np.vstack([np.eye(3), -np.eye(3)]) if axis @ own < 0.9 * size]
        for axis in rng.permutation(others)[:3]:
            yield Fault('gravity_axis', ('gravity_axis',), with_gravity(arm, size * axis), (data,))
    rows = arm.spec.kinematics.dh
    if rows is not None and any(abs(row[0]) + abs(row[2]) > 0.0 for row in rows):
        scaled = [[1e3 * a, alpha, 1e3 * d, theta] for a, alpha, d, theta in rows]
        yield Fault('dh_in_millimetres', ('dh_in_millimetres',), altered(
            arm, kinematics={'dh': scaled, 'convention': arm.spec.kinematics.convention}),
            (data,))
    if rows is not None and any(row[1] or row[3] for row in rows):
        turned = [[a, math.degrees(alpha), d, math.degrees(theta)] for a, alpha, d, theta in rows]
        yield Fault('dh_in_degrees', ('dh_in_degrees',), altered(
            arm, kinematics={'dh': turned, 'convention': arm.spec.kinematics.convention}),
            (data,))
    if data.recording.strain is not None:
        chosen = int(rng.integers(len(arm.gauges)))
        for kind, distance in (
                ('gauge_in_millimetres', 1e3 * arm.gauges[chosen].distance),
                ('gauge_beyond_link', float(rng.uniform(1.1, 1.8)) * 0.45)):
            gauges = [gauge.model_dump(mode='json') for gauge in arm.gauges]
            gauges[chosen]['distance'] = distance
            yield Fault(kind, (kind,), altered(arm, gauges=gauges), (data,),
                        channels=(arm.gauges[chosen].name,), size=distance)


def one_joint_of_many(bag, rng):
    """List one joint of an arm whose others move, too."""
    arm, data = bag.arm, bag.data
    if arm.spec.kinematics.urdf is None or len(arm.active_joints) < 3:
        return
    kept = int(rng.integers(1, 4))
    joints = [arm.joints[kept].model_dump(mode='json')]
    spans = np.subtract(*np.percentile(data.recording.q, [99.0, 1.0], axis=0))
    # as the reader finds them in the joint states
    others = {name: float(span) for i, (name, span) in enumerate(
        zip(arm.active_joints, spans, strict=True)) if i != kept}
    recording = data.recording
    changed = replace(
        recording, q=recording.q[:, [kept]],
        dq=None if recording.dq is None else recording.dq[:, [kept]],
        effort=None if recording.effort is None else recording.effort[:, [kept]],
        oddities=replace(recording.oddities, others=others))
    missing = tuple(name for name, span in others.items() if span > 0.02)
    yield Fault('joint_not_listed', ('joint_not_listed',),
                altered(arm, joints=joints, gauges=[], active_joints=None, couplings=None),
                (replace(data, recording=changed),), channels=missing)
