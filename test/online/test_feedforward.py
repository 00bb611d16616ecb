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

"""Efforts of wanted motions: of the model, with load, as currents and torques, at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from payload_making import true_outputs, two_gauge_arm
import pytest
from sample_arms import planar_arm, random_states
from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import ModelError, SignalError
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import SLIDING
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.regressor import EffortRegressor, PayloadRegressor
from tudor_dynamics.online.feedforward import Feedforward, kept_speeds
from tudor_dynamics.signals.motion_profile import states

T = np.linspace(0.0, 1.0, 11)
JOINTS = ('j1', 'j2')


def bundle(arm: Arm, payload: float = 0.0, scale: float = 1.0) -> ModelBundle:
    """Give a bundle of one payload, which its bags tell."""
    motion = random_states(300, 2, 0)
    model = AnalyticalModel(EffortRegressor(arm), 2).fit(
        motion, true_outputs(two_gauge_arm(), motion, payload)['effort'] * scale)
    return ModelBundle(arm, PreprocessingSpec(), {'effort': {'analytical': model}},
                       {'training': [{'bag': 'run', 'payload': payload}]})


def path() -> Trajectory:
    """Swing both joints by cubics, from rest to rest."""
    s = T**2 * (3.0 - 2.0 * T)
    return Trajectory(JOINTS, T, np.outer(s, [1.0, -0.5]),
                      np.outer(6.0 * T * (1.0 - T), [1.0, -0.5]))


def test_effort_is_what_the_model_says_of_the_wanted_motion() -> None:
    """To the last digit of the truth; at the ends, where it rests, it is that of the weight."""
    found = Feedforward(bundle(two_gauge_arm())).along(path())
    truth = true_outputs(two_gauge_arm(), states(path()), 0.0)['effort']
    assert found.effort == pytest.approx(truth, rel=1e-7)
    rest = np.hstack([path().q[[0, -1]], np.zeros((2, 4))])
    assert found.effort is not None
    assert found.effort[[0, -1]] == pytest.approx(
        true_outputs(two_gauge_arm(), rest, 0.0)['effort'], rel=1e-7)
    assert np.array_equal(found.q, path().q) and found.ddq is None


def test_friction_goes_smoothly_through_zero() -> None:
    """It has the sign of the wanted speed, is none at rest, and never jumps."""
    ahead = Feedforward(bundle(two_gauge_arm()))
    speed = np.linspace(-0.2, 0.2, 401)
    motion = np.zeros((401, 6))
    motion[:, 2] = speed
    effort = ahead.efforts(motion)[:, 0] - ahead.efforts(np.zeros((1, 6)))[0, 0]
    assert effort[200] == pytest.approx(0.0, abs=1e-9)
    assert effort[-1] == pytest.approx(-effort[0]) and effort[-1] > 0.2
    assert np.all(np.diff(effort) > 0.0) and np.abs(np.diff(effort)).max() < 0.02


def test_friction_kept_at_rest() -> None:
    """It is that of the last motion until the joint turns; without motion before there is none."""
    found = kept_speeds(np.array([[0.0, 0.01], [0.3, 0.0], [0.01, 0.0], [0.0, 0.0], [-0.01, 0.0],
                                  [-0.03, 0.0], [0.0, 0.0], [-0.4, 0.0]]), [0.02, 0.02])
    assert np.array_equal(found[:, 0], [0.0, 0.3, SLIDING, SLIDING, SLIDING, -SLIDING, -SLIDING,
                                        -0.4])
    assert np.array_equal(found[:, 1], [0.01, *np.zeros(7)])
    none, kept = (Feedforward(bundle(two_gauge_arm()), friction_at_rest=what).along(path()).effort
                  for what in ('none', 'kept'))
    assert none is not None and kept is not None
    assert np.array_equal(kept[:-1], none[:-1])
    last = np.array([[1.0, -0.5, SLIDING, -SLIDING, 0.0, 0.0]])
    truth = true_outputs(two_gauge_arm(), last, 0.0)['effort'][0]
    assert kept[-1] == pytest.approx(truth, rel=1e-6)
    assert np.all((kept[-1] - none[-1]) * [1.0, -1.0] > 0.04)


@pytest.mark.parametrize('payload', [0.0, 0.15, 0.4])
def test_payload_of_a_model_of_all(payload: float) -> None:
    """It is in the efforts, at the start and when it changes."""
    arm, motion = two_gauge_arm(), random_states(300, 2, 0)
    inputs = np.vstack([np.column_stack([motion, np.full(300, m)]) for m in (0.0, 0.4)])
    values = np.vstack([true_outputs(arm, motion, m)['effort'] for m in (0.0, 0.4)])
    model = AnalyticalModel(PayloadRegressor(EffortRegressor(arm), arm, (0.0, 0.4)), 2).fit(
        inputs, values)
    whole = ModelBundle(arm, PreprocessingSpec(), {'effort': {'analytical': model}})
    ahead = Feedforward(whole, payload=0.3)
    ahead.carry(payload)
    truth = true_outputs(arm, states(path()), payload)['effort']
    assert ahead.along(path()).effort == pytest.approx(truth, rel=1e-6)


def test_payload_beside_a_model_of_one() -> None:
    """By what a kilogram is worth where efforts are torques; refused where nobody knows."""
    ahead = Feedforward(bundle(two_gauge_arm(), payload=0.2), payload=0.35)
    truth = true_outputs(two_gauge_arm(), states(path()), 0.35)['effort']
    assert ahead.along(path()).effort == pytest.approx(truth, rel=1e-6)
    joints = [{'name': name, 'friction': ['viscous', 'coulomb'], 'effort': {'unit': 'A'}}
              for name in JOINTS]
    unknown = bundle(planar_arm(joints), payload=0.2)
    assert Feedforward(unknown).payload == 0.2
    with pytest.raises(ModelError, match='0.2 kg, and cannot convert its efforts'):
        Feedforward(unknown, payload=0.3)
    with pytest.raises(ModelError, match='kg: give 0 or more'):
        Feedforward(unknown, payload=-1.0)


def test_currents_and_torques() -> None:
    """One is the other times the torque constant, which has to be known."""
    joints = [{'name': name, 'friction': ['viscous', 'coulomb'],
               'effort': {'unit': 'A', 'torque_constant': constant}}
              for name, constant in zip(JOINTS, (2.0, 4.0), strict=True)]
    known = bundle(planar_arm(joints), scale=0.5)
    plain, torque = (Feedforward(known, unit=unit) for unit in ('model', 'torque'))
    assert plain.units == ('A', 'A') and torque.units == ('N m', 'N m')
    motion = states(path())
    assert torque.efforts(motion) == pytest.approx(plain.efforts(motion) * [2.0, 4.0])
    assert np.array_equal(Feedforward(known, unit='current').efforts(motion),
                          plain.efforts(motion))
    with pytest.raises(ModelError, match='the joint has no torque constant'):
        Feedforward(bundle(two_gauge_arm()), unit='current')


def test_joints_in_any_order_and_held_ones() -> None:
    """Held joints get no effort and stay where they were held; strangers are refused."""
    arm = two_gauge_arm()
    ahead = Feedforward(bundle(arm))
    plain = ahead.along(path())
    turned = ahead.along(replace(path(), joints=('j2', 'j1'), q=path().q[:, ::-1],
                                 dq=path().dq[:, ::-1]))
    assert plain.effort is not None
    assert np.array_equal(turned.effort, plain.effort[:, ::-1])
    with pytest.raises(SignalError, match="has the joint 'j9', but"):
        ahead.along(Trajectory(('j9', *JOINTS), T, np.zeros((11, 3))))
    lone = planar_arm([{'name': 'j1'}, {'name': 'j2', 'hold': 0.4}], active_joints=['j1'])
    motion = random_states(100, 1, 0)
    model = AnalyticalModel(EffortRegressor(lone), 1).fit(motion, motion[:, 2:])
    one = Feedforward(ModelBundle(lone, PreprocessingSpec(), {'effort': {'analytical': model}}))
    q = np.column_stack([np.full(11, 0.4), path().q[:, 0]])
    found = one.along(Trajectory(('j2', 'j1'), T, q))
    assert found.effort is not None
    assert found.effort.shape == (11, 2) and not found.effort[:, 0].any()
    with pytest.raises(SignalError, match="'j2' at 0.4 rad, but point 1 moves it to 0"):
        one.along(Trajectory(('j2', 'j1'), T, q - 0.4))


def test_models_that_are_not_there() -> None:
    """The bundle says what it has; motors of rigid arms are not led."""
    with pytest.raises(ModelError, match='kind= elastic: for efforts the model has the kinds'):
        Feedforward(bundle(two_gauge_arm()), kind='elastic')
    with pytest.raises(ModelError, match='elastic model cannot be used'):
        Feedforward(bundle(two_gauge_arm()), positions='motor')
