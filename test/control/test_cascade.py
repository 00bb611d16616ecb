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

"""Joint cascade: tuning, tracking, limits."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.limits import Limits
from tudor_dynamics.control.cascade import (
    arm_gains, Cascade, JointGains, motor_gains, position_law, SATURATED, SATURATING, velocity_law)
from tudor_dynamics.control.settings import COMMANDED_SPEED
from tudor_dynamics.errors import ArmError

DT = 5e-4


def test_gains_of_reference_arm(root: Path) -> None:
    """The velocity gain is J w / k_t of the rotor, by hand for joint 2 of the reference arm."""
    arm = load_arm(root / 'config' / 'tudor.yaml')
    gains = arm_gains(arm)
    inertia, torque = 1.1e-5 * 230**2, 0.07 * 0.7 * 230
    assert gains[0].velocity == pytest.approx(inertia * 2 * math.pi * 20 / torque)
    assert gains[0].current_limit == 2.5


def test_tuning_needs_the_rotor(root: Path) -> None:
    """Without the rotor's inertia there is no gain, and the message says where it belongs."""
    arm = load_arm(root / 'config' / 'tudor.yaml')
    assert arm.spec.damper is not None
    motor = arm.spec.motors[1].model_copy(update={'rotor_inertia': 0.0})
    with pytest.raises(ArmError, match='rotor_inertia'):
        motor_gains(motor, arm.spec.damper)


def step(
    cascade: Cascade, q_ref: float, dq_ref: float, q: float, dq: float, yielding: float = 0.0,
    ahead: float = 0.0,
) -> float:
    """Give the current of the only joint, by the laws in the order of the closed loop."""
    wanted = position_law(cascade.rows[0], q_ref, dq_ref, q, yielding)
    speed = cascade.envelope.step(DT, [wanted], [q])[0]
    return velocity_law(cascade.rows[0], cascade.state[0], DT, speed, dq, ahead)


def saturated(cascade: Cascade) -> bool:
    """Say whether current, speed or position of the only joint were at a limit."""
    return bool(cascade.state[0, SATURATED] > 0.0 or cascade.envelope.cuts[0] & SATURATING)


def run_rotor(cascade: Cascade, q_ref: float, seconds: float, load: float) -> np.ndarray:
    """Turn a free rotor of 1 kg m^2 and 1 N m/A against a load torque."""
    q = dq = 0.0
    places = []
    for _ in range(int(seconds / DT)):
        current = step(cascade, q_ref, 0.0, q, dq)
        dq += DT * (current - load)
        q += DT * dq
        places.append((q, current))
    return np.array(places)


def test_reaches_its_reference_against_a_load() -> None:
    """The integrator carries a constant load without a lasting error."""
    cascade = Cascade([JointGains(4.0, 60.0, 600.0)], DT)
    places = run_rotor(cascade, 0.2, 4.0, 3.0)
    assert places[-1, 0] == pytest.approx(0.2, abs=1e-4)
    assert places[-1, 1] == pytest.approx(3.0, rel=1e-3)


def test_no_windup_at_the_limit() -> None:
    """After a long time at the current limit the joint does not shoot over by the integrator."""
    limited = Cascade([JointGains(4.0, 60.0, 600.0, current_limit=1.0)], DT)
    for _ in range(4000):
        step(limited, 1.0, 0.0, 0.0, 0.0)  # blocked
    assert saturated(limited)
    places = run_rotor(limited, 0.2, 6.0, 0.0)
    assert np.abs(places[:, 1]).max() <= 1.0
    assert places[:, 0].max() < 0.26
    assert places[-1, 0] == pytest.approx(0.2, abs=2e-3)
    assert not saturated(limited)


def test_what_is_fed_forward_is_not_asked_of_errors() -> None:
    """It is added to the current within the limit, and does not wind the integrator up."""
    cascade = Cascade([JointGains(4.0, 60.0, 600.0, current_limit=2.0)], DT)
    assert step(cascade, 0.1, 0.5, 0.1, 0.5, ahead=1.5) == pytest.approx(1.5)
    assert step(cascade, 0.1, 0.5, 0.1, 0.5, ahead=9.0) == pytest.approx(2.0)
    assert saturated(cascade)
    assert step(cascade, 0.1, 0.5, 0.1, 0.5) == pytest.approx(0.0)
    known, unknown = (Cascade([JointGains(4.0, 60.0, 0.0)], DT) for _ in range(2))
    places = []
    for one, ahead in ((known, 3.0), (unknown, 0.0)):
        q, dq = 0.0, 0.0
        for _ in range(4000):
            dq += DT * (step(one, 0.2, 0.0, q, dq, ahead=ahead) - 3.0)
            q += DT * dq
        places.append(q)
    assert places[0] == pytest.approx(0.2, abs=1e-4)
    assert places[1] == pytest.approx(0.2 - 3.0 / 240.0, abs=1e-4)  # load over 4 / s times 60 A s


def test_speed_limit_counts_damper_and_reference() -> None:
    """The commanded speed is bounded whatever asks for it."""
    limits = Limits(*(np.array([x]) for x in (-np.inf, np.inf, 0.5 / COMMANDED_SPEED, np.inf)))
    cascade = Cascade([JointGains(4.0, 1.0, 0.0)], DT, limits)
    assert step(cascade, 0.0, 0.4, 0.0, 0.0, 0.4) == pytest.approx(0.5)
    assert saturated(cascade)
    assert step(cascade, 0.0, 0.4, 0.0, 0.0, -0.4) == pytest.approx(0.0)
    assert not saturated(cascade)
