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

"""Rows of rigid bodies are those of Pinocchio's joint torque regressor."""

from __future__ import annotations

from hypothesis import given, settings, strategies as st
import numpy as np
import pinocchio as pin
import pytest

from tudor_dynamics.models.rigid_bodies import RigidBodies
from tudor_dynamics.typing import FloatArray

SAMPLES = 5


def tree(seed: int, joints: int) -> pin.Model:
    """Build a branched arm of revolute and prismatic joints about odd axes."""
    random = np.random.default_rng(seed)
    model = pin.Model()
    for i in range(joints):
        axis = random.normal(size=3)
        axis /= np.linalg.norm(axis)
        joint = (pin.JointModelPrismaticUnaligned(axis) if random.random() < 0.3
                 else pin.JointModelRevoluteUnaligned(axis))
        turn = pin.exp3(random.normal(size=3))
        model.addJoint(int(random.integers(max(0, i - 1), i + 1)), joint,
                       pin.SE3(turn, random.normal(size=3)), f'j{i}')
    model.gravity.linear = random.normal(size=3) * 9.81
    return model


def expected(model: pin.Model, motion: FloatArray, driven: list[int], wanted: list[int],
             ) -> FloatArray:
    """Ask Pinocchio."""
    data, rows = model.createData(), []
    for sample in motion:
        state = np.zeros((3, model.nv))
        state[:, driven] = sample.reshape(3, -1)
        # of one joint it gives a vector
        row = pin.computeJointTorqueRegressor(model, data, *state).reshape(model.nv, -1)
        rows.append(row[wanted].copy())
    return np.array(rows)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10**6), st.integers(1, 8))
def test_rows(seed: int, joints: int) -> None:
    """To 1e-12 of the largest, for some of the joints, which are not all driven."""
    model, random = tree(seed, joints), np.random.default_rng(seed)
    driven = sorted(random.choice(joints, max(1, joints - 1), replace=False).tolist())
    wanted = sorted(random.choice(joints, max(1, joints - 2), replace=False).tolist())
    motion = random.normal(size=(SAMPLES, 3 * len(driven)))
    bodies = RigidBodies(model, np.array(driven), np.array(wanted))
    out = np.full((SAMPLES, len(wanted), 10 * joints), np.nan)
    bodies.rows(motion, out)
    reference = expected(model, motion, driven, wanted)
    assert np.abs(out - reference).max() <= 1e-12 * np.abs(reference).max()
    parameters = random.normal(size=(len(wanted), 10 * joints))
    efforts = np.empty((SAMPLES, len(wanted)))
    bodies.outputs(motion, parameters, efforts)
    assert efforts == pytest.approx(np.einsum('kcp,cp->kc', reference, parameters), abs=1e-9)


def test_gravity_of_another_direction() -> None:
    """It is that of the model when the bodies were taken from it."""
    model = tree(4, 5)
    places = np.arange(5)
    motion = np.random.default_rng(1).normal(size=(SAMPLES, 15))
    bodies, out, before = RigidBodies(model, places, places), np.empty((SAMPLES, 5, 50)), (
        expected(model, motion, list(places), list(places)))
    model.gravity.linear = np.array([1.0, -2.0, 3.0])
    RigidBodies(model, places, places).rows(motion, out)
    assert out == pytest.approx(expected(model, motion, list(places), list(places)), abs=1e-10)
    bodies.rows(motion, out)
    assert out == pytest.approx(before, abs=1e-10)
