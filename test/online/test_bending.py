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

"""Motors that lead bent links: where they end, what they hold, and a spring solved by hand."""

from __future__ import annotations

from elastic_making import blade, blade_arm, STIFFNESS
import numpy as np
import pytest
from sample_arms import LENGTH_1, LENGTH_2, multisine
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import SignalError, SimulationError
from tudor_dynamics.mechanics import chain as at
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.models.elastic.model import ElasticModel
from tudor_dynamics.online.feedforward import DeflectedArm, Feedforward
from tudor_dynamics.signals.motion_profile import states
from tudor_dynamics.typing import FloatArray

POSES = np.array([[0.3, -0.4], [1.2, 0.6], [2.6, -1.0], [np.pi / 2, 0.0]])


def at_rest(q: FloatArray) -> FloatArray:
    """Give states of an arm at rest."""
    return np.hstack([q, np.zeros((len(q), 4))])


def tip(driven: DrivenArm) -> FloatArray:
    """Give the tip of an arm where it stands, in its plane [m]."""
    return driven.tables.chain.moving[-1, at.ORIGIN:at.ORIGIN + 2].copy()


def rigid_tip(q: FloatArray) -> FloatArray:
    """Give the tip of two rigid links [m]."""
    first, second = q[..., 0], q[..., 0] + q[..., 1]
    return np.stack([LENGTH_1 * np.cos(first) + LENGTH_2 * np.cos(second),
                     LENGTH_1 * np.sin(first) + LENGTH_2 * np.sin(second)], axis=-1)


@pytest.mark.parametrize('backlash', [0.0, 0.01])
def test_tip_of_the_resting_arm_is_where_it_is_wanted(backlash: float) -> None:
    """
    The driven arm, which is another solution of the same equations, rests with its tip there.

    But for what bending lengthens a linear beam by, 0.4 mm: no joint can take that back.
    """
    arm = blade_arm(backlash=backlash)
    bent = DeflectedArm(arm, {})
    motor, torque = bent.under(at_rest(POSES), reach=True)
    driven = DrivenArm(arm)
    for k, q in enumerate(POSES):
        if backlash and k == 3:
            continue  # upright nothing holds the teeth on one side of the play
        response = driven.follow(motor[k:k + 1], np.zeros(1))
        near = np.linalg.norm(tip(driven) - rigid_tip(q))
        assert near < (6e-4 if k < 3 else 2e-6)
        assert response.torque[0] == pytest.approx(torque[k], abs=1e-4)
        driven.follow(q[None], np.zeros(1))
        assert np.linalg.norm(tip(driven) - rigid_tip(q)) > 100.0 * near or k == 3
    _, back = bent.under(at_rest(motor), reach=False)
    assert back[:3] == pytest.approx(torque[:3], abs=1e-4)


def test_springs_in_joints_by_hand() -> None:
    """Hardly bending links: the motor leads by torque over stiffness, De Luca's inversion."""
    stiff = blade(material={'E': 9e14, 'nu': 0.29, 'rho': 7850})
    arm = blade_arm(backlash=0.0, links=[
        {'joint': 'j1', 'flexible': stiff}, {'joint': 'j2', 'flexible': stiff}])
    motion = multisine(np.linspace(0.0, 9.0, 40), 2, seed=3)
    motor, held = DeflectedArm(arm, {}).under(motion, reach=True)
    stiffness = np.array([STIFFNESS['j1'], STIFFNESS['j2']])
    assert motor - motion[:, :2] == pytest.approx(held / stiffness, abs=2e-5)
    # two links of 0.47 kg/m, 0.2 kg at the end; inertia of the beams' cross sections left out
    q, dq, ddq = motion[:, :2], motion[:, 2:4], motion[:, 4:]
    line, tip_mass, g = 0.004 * 0.015 * 7850, 0.2, 9.81
    mass = line * LENGTH_2
    inertia = mass * LENGTH_2**2 / 3 + tip_mass * LENGTH_2**2
    moment = mass * LENGTH_2 / 2 + tip_mass * LENGTH_2
    torque = (inertia * (ddq[:, 0] + ddq[:, 1])
              + moment * LENGTH_1 * (np.cos(q[:, 1]) * ddq[:, 0] + np.sin(q[:, 1]) * dq[:, 0]**2)
              + moment * g * np.cos(q[:, 0] + q[:, 1]))
    assert held[:, 1] == pytest.approx(torque, abs=5e-3)


def test_a_led_motion_keeps_the_tip_on_its_path() -> None:
    """With its vibrations, the tip is thirty times as near as with motors on the path."""
    arm, rate = blade_arm(backlash=0.0), 200.0
    t = np.arange(0.0, 3.0, 1.0 / rate)
    s = np.clip((t - 0.5) / 1.5, 0.0, 1.0)
    law = np.polynomial.Polynomial([0, 0, 0, 0, 35, -84, 70, -20])  # smooth to the jerk
    q, dq, ddq = (np.outer(law.deriv(k)(s) if k else law(s), [0.8, -0.9]) / 1.5**k
                  for k in range(3))
    path = Trajectory(('j1', 'j2'), t, q + [0.4, 0.2], dq, ddq)
    effort, strain = (ElasticModel(arm, output) for output in ('effort', 'strain'))
    effort.coefficients_ = tuple(np.array([0.1, 0.05, 0.0, 0.0, 0.0]) for _ in range(2))
    ahead = Feedforward(ModelBundle(arm, PreprocessingSpec(), {
        'effort': {'elastic': effort}, 'strain': {'elastic': strain}}), kind='elastic',
        positions='motor')
    errors = []
    for motor in (path.q, ahead.along(path).q):
        driven, off = DrivenArm(arm), []
        for k in range(len(t)):
            driven.follow(motor[k:k + 1], np.array([0.0 if k == 0 else 1.0 / rate]))
            off.append(np.linalg.norm(tip(driven) - rigid_tip(path.q[k])))
        errors.append(float(np.sqrt(np.mean(np.square(off)))))
    assert errors[1] < errors[0] / 30.0
    found = ahead.along(path)
    _, torque = DeflectedArm(arm, {}).under(states(path), reach=True)
    assert found.ddq is not None
    assert found.effort == pytest.approx(0.1 * torque + 0.05 * found.ddq, abs=1e-6)
    assert not found.ddq[[0, -1]].any()


def test_motors_are_not_led_beyond_their_limits() -> None:
    """A path at the limit is refused where bending needs more, with the joint and the point."""
    arm = blade_arm(joints=[{'name': 'j1', 'limits': {'lower': -0.1, 'upper': 1.25}},
                            {'name': 'j2'}])
    effort = ElasticModel(arm, 'effort')
    effort.coefficients_ = tuple(np.zeros(5) for _ in range(2))
    ahead = Feedforward(ModelBundle(arm, PreprocessingSpec(), {'effort': {'elastic': effort}}),
                        kind='elastic', positions='motor')
    q = np.array([[0.5, 0.1], [1.24, 0.1]])
    assert ahead.along(Trajectory(('j1', 'j2'), np.array([0.0, 1.0]), q * 0.9)).ddq is not None
    with pytest.raises(SignalError, match="the motor of 'j1' has to be at 1.[23]"):
        ahead.along(Trajectory(('j1', 'j2'), np.array([0.0, 1.0]), q))


def test_payload_bends_more() -> None:
    """A heavier load leads the motors further; back again it is as before."""
    bent = DeflectedArm(blade_arm(), {})
    before, _ = bent.under(at_rest(POSES), reach=True)
    bent.carry(0.6)
    assert bent.payload == 0.6
    after, _ = bent.under(at_rest(POSES), reach=True)
    assert np.all(np.abs(after - POSES)[:3] > np.abs(before - POSES)[:3])
    bent.carry(0.2)
    assert np.array_equal(bent.under(at_rest(POSES), reach=True)[0], before)


def test_links_that_are_too_weak() -> None:
    """An arm that cannot hold its load says at which point, and does not bend without end."""
    bent = DeflectedArm(blade_arm(), {'bending(j1)': 0.2, 'bending(j2)': 0.2})
    with pytest.raises(SimulationError, match='cannot hold point 1'):
        bent.under(at_rest(POSES), reach=True)
