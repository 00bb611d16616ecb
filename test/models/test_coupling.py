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

"""Coupled drives: what efforts feel of motors that turn with several joints, by virtual work."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sample_arms import arm_of, random_states, SIX_ROWS

from tudor_dynamics.errors import ArmError
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.friction import friction_columns
from tudor_dynamics.models.regressor import EffortRegressor

JOINTS: list[dict[str, Any]] = [
    {'name': 'a', 'friction': ['viscous', 'coulomb', 'offset']}, {'name': 'b', 'asymmetric': True},
    {'name': 'c', 'friction': ['viscous', 'stribeck']}]
RATIO = 0.8
MATRIX = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, RATIO, 1.0]])


def _arm(**couplings: Any) -> Any:
    more = {'couplings': couplings} if couplings else {}
    return arm_of(SIX_ROWS[:3], JOINTS, **more)


PAIRS = [{'motor': 'c', 'joint': 'b', 'ratio': RATIO}]


def _parts(motor_motion: np.ndarray, own: np.ndarray, arm: Any) -> np.ndarray:
    """Inertia and friction of each motor, at its own speed."""
    torque, begin = np.zeros((len(motor_motion), 3)), 0
    for i, joint in enumerate(arm.joints):
        columns = np.column_stack([motor_motion[:, 6 + i],
                                   friction_columns(joint, motor_motion[:, 3 + i])])
        torque[:, i] = columns @ own[begin:begin + columns.shape[1]]
        begin += columns.shape[1]
    return torque


@pytest.mark.parametrize('positions', ['joints', 'motors'])
@pytest.mark.parametrize('efforts', ['joints', 'motors'])
@pytest.mark.parametrize('form', [{'pairs': PAIRS}, {'matrix': MATRIX.tolist()}])
def test_virtual_work(positions: str, efforts: str, form: dict[str, Any]) -> None:
    """
    Whatever side is measured, bodies and motors together do the work that they do uncoupled.

    Reference: the plain arm for the bodies, friction columns at the motors' speeds, and
    ``tau_motor' w = tau_joint' dq`` for the torques.
    """
    plain, arm = _arm(), _arm(**form, positions=positions, efforts=efforts)
    joint_motion = random_states(30, 3, seed=2)
    motor_motion = np.hstack([joint_motion[:, i:i + 3] @ MATRIX.T for i in (0, 3, 6)])
    regressor = EffortRegressor(arm)
    parameters = np.random.default_rng(1).uniform(0.5, 2.0, len(regressor.columns))
    bodies = np.where(np.arange(len(parameters)) < 30, parameters, 0.0)
    tau = EffortRegressor(plain).rows(joint_motion) @ bodies
    drives = _parts(motor_motion, parameters[30:], arm)
    expected = (tau + drives @ MATRIX if efforts == 'joints' else
                tau @ np.linalg.inv(MATRIX) + drives)
    measured = motor_motion if positions == 'motors' else joint_motion
    assert np.allclose(regressor.rows(measured) @ parameters, expected, rtol=1e-9)
    several = np.random.default_rng(3).normal(size=(3, len(regressor.columns)))
    rows = np.einsum('kcp,cp->kc', regressor.rows(measured), several)
    assert np.allclose(regressor.outputs(measured, several), rows, rtol=0.0,
                       atol=1e-12 * np.abs(rows).max())


def test_it_is_learned() -> None:
    """Friction that a coupled motor puts into two joints is explained by the coupling alone."""
    arm = _arm(pairs=PAIRS)
    motion, other = random_states(300, 3, seed=1), random_states(100, 3, seed=2)
    regressor = EffortRegressor(arm)
    truth = np.random.default_rng(4).uniform(0.5, 2.0, len(regressor.columns))
    truth[-3:] *= 10.0

    def error(described: Any) -> float:
        model = AnalyticalModel(EffortRegressor(described), 3).fit(
            motion, regressor.rows(motion) @ truth)
        wrong = model.predict(other) - regressor.rows(other) @ truth
        return float(np.linalg.norm(wrong) / np.linalg.norm(regressor.rows(other) @ truth))
    assert error(arm) < 1e-6 < 0.01 < error(_arm())


@pytest.mark.parametrize(('wrong', 'message'), [
    ({}, 'give either pairs'),
    ({'pairs': PAIRS, 'matrix': MATRIX.tolist()}, 'give either pairs'),
    ({'matrix': [[1.0, 0.0], [0.0, 1.0]]}, 'expected 3 rows of 3'),
    ({'matrix': [[1.0, 0.0, 0.0], [0.0, 1.0, 1.0], [0.0, 1.0, 1.0]]}, 'correct the ratios'),
    ({'pairs': [{'motor': 'c', 'joint': 'z', 'ratio': 1.0}]}, "'z', which is not among"),
    ({'pairs': [{'motor': 'c', 'joint': 'c', 'ratio': 1.0}]}, 'name two different joints')])
def test_what_cannot_be_is_refused(wrong: dict[str, Any], message: str) -> None:
    """The message names what is wrong and what to do."""
    with pytest.raises(ArmError, match=message):
        arm_of(SIX_ROWS[:3], JOINTS, couplings=wrong)


def test_a_held_joint() -> None:
    """A coupling with a held joint is left out; what is measured at motors needs both."""
    arm = arm_of(SIX_ROWS[:3], JOINTS, couplings={'pairs': PAIRS}, active_joints=['a', 'c'])
    assert np.array_equal(arm.coupling, np.eye(2))
    with pytest.raises(ArmError, match='list both in active_joints, or neither'):
        arm_of(SIX_ROWS[:3], JOINTS, active_joints=['a', 'c'],
               couplings={'pairs': PAIRS, 'efforts': 'motors'})
    assert arm.digest != arm_of(SIX_ROWS[:3], JOINTS, active_joints=['a', 'c']).digest
