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

"""Drive: friction that holds, backlash, stiffness, limits, each by a hand calculation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tudor_dynamics.arm.drives import MotorSpec
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.simulation import drive as dr
from tudor_dynamics.simulation.drive import drive_row, Imperfections

DT = 5e-4
MOTOR = MotorSpec(
    joint='a', gear_ratio=100, torque_constant=0.1, efficiency=0.8, rotor_inertia=1e-5,
    viscous=(0.05, 0.1), coulomb=(0.2, 0.3), breakaway=1.5, current_limit=2.0, stiffness=200.0,
    damping=0.2, backlash=0.01)


def turn(row: np.ndarray, current: float, steps: int,
         state: np.ndarray | None = None) -> np.ndarray:
    """Drive a free rotor."""
    state = np.zeros(dr.STATES) if state is None else state
    for _ in range(steps):
        dr.rotor_law(row, state, DT, current)
    return state


def test_values_at_the_joint() -> None:
    """Gear ratio, efficiency and friction in amperes become values at the joint."""
    row = drive_row(MOTOR, DT, Imperfections())
    assert row[dr.TORQUE] == pytest.approx(0.1 * 100 * 0.8)
    assert row[dr.INERTIA] == pytest.approx(1e-5 * 100**2)
    np.testing.assert_allclose(row[dr.COULOMB:dr.COULOMB + 2], [1.6, 2.4])
    np.testing.assert_allclose(row[dr.VISCOUS:dr.VISCOUS + 2], [0.4, 0.8])
    assert row[dr.PLAY] == pytest.approx(0.005)


def test_stiction_holds_and_breaks() -> None:
    """Below breakaway (1.5 x 0.2 A) nothing moves, ever; above it the rotor runs on."""
    row = drive_row(MOTOR, DT, Imperfections())
    held = turn(row, 0.299, 20000)
    assert held[dr.ANGLE] == 0.0 and held[dr.SPEED] == 0.0
    state = turn(row, 0.31, 1)
    assert state[dr.SPEED] > 0.0
    # Once it moves, 0.25 A are enough to keep it moving against 0.2 A.
    assert turn(row, 0.25, 4000, state)[dr.SPEED] > 0.0
    assert turn(row, 0.0, 4000, state)[dr.SPEED] == 0.0


@pytest.mark.parametrize(('current', 'coulomb', 'viscous'), [(1.2, 0.2, 0.05), (-1.2, -0.3, 0.1)])
def test_final_speed_by_direction(current: float, coulomb: float, viscous: float) -> None:
    """A free rotor ends at (current - Coulomb) / viscous of its direction."""
    state = turn(drive_row(MOTOR, DT, Imperfections()), current, 20000)
    assert state[dr.SPEED] == pytest.approx((current - coulomb) / viscous, rel=1e-6)


def test_coasting_takes_the_time_of_its_energy() -> None:
    """With Coulomb friction alone a rotor of speed w stops after w J / (k I_c)."""
    motor = MOTOR.model_copy(update={'viscous': (0.0, 0.0)})
    row, state = drive_row(motor, DT, Imperfections()), np.zeros(dr.STATES)
    state[dr.SPEED] = 5.0
    steps = 0
    while state[dr.SPEED] > 0.0:
        dr.rotor_law(row, state, DT, 0.0)
        steps += 1
    assert steps * DT == pytest.approx(5.0 * 0.1 / 1.6, abs=2 * DT)
    assert state[dr.ANGLE] == pytest.approx(0.5 * 5.0**2 * 0.1 / 1.6, rel=0.01)


def test_current_limit() -> None:
    """No more current than the limit flows, in either direction, and the state says so."""
    row = drive_row(MOTOR, DT, Imperfections())
    for wanted, given in ((5.0, 2.0), (-5.0, -2.0), (1.0, 1.0)):
        state = turn(row, wanted, 1)
        assert state[dr.CURRENT] == given
        assert (state[dr.LIMITED] > 0.0) == (wanted != given)
    free = drive_row(MOTOR, DT, Imperfections(current_limit=False))
    assert turn(free, 5.0, 1)[dr.CURRENT] == 5.0


def test_backlash() -> None:
    """Inside the play the link feels nothing, outside stiffness times what is beyond its edge."""
    row, state = drive_row(MOTOR, DT, Imperfections()), np.zeros(dr.STATES)
    for angle, torque in ((0.004, 0.0), (0.007, 200 * 0.002), (-0.015, -200 * 0.010)):
        state[dr.ANGLE] = angle
        q = 0.1
        state[dr.ANGLE] += q
        push = dr.gear_push(row, state, DT, q, 0.0)
        assert push - row[dr.STIFFNESS] * q == pytest.approx(torque, abs=1e-9)


def test_each_imperfection_has_its_switch() -> None:
    """Switching all off leaves a rotor on a nearly rigid gear."""
    row = drive_row(MOTOR, DT, Imperfections.none())
    assert not row[dr.COULOMB:dr.COULOMB + 2].any() and not row[dr.VISCOUS:dr.VISCOUS + 2].any()
    assert row[dr.PLAY] == 0.0 and row[dr.LIMIT] == math.inf
    assert row[dr.STIFFNESS] == pytest.approx(0.1 * (0.5 / DT) ** 2)
    for name in ('friction', 'backlash', 'gear_compliance', 'current_limit'):
        alone = drive_row(MOTOR, DT, Imperfections(**{name: False}))
        assert not np.array_equal(alone, drive_row(MOTOR, DT, Imperfections()))


def test_rotor_needs_inertia() -> None:
    """A motor without rotor inertia is refused by the name of its joint."""
    with pytest.raises(SimulationError, match="joint 'a': rotor_inertia"):
        drive_row(MOTOR.model_copy(update={'rotor_inertia': 0.0}), DT, Imperfections())
