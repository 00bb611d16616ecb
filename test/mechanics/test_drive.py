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

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from tudor_dynamics.arm.schema import MotorSpec
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.mechanics import hardware as dr
from tudor_dynamics.mechanics.hardware import (
    current_reading, drive_row, drive_sensor_row, Imperfections)

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
    for wanted, flows in ((5.0, 2.0), (-5.0, -2.0), (1.0, 1.0)):
        state = turn(row, wanted, 1)
        assert state[dr.CURRENT] == flows
        assert (state[dr.LIMITED] > 0.0) == (wanted != flows)
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
        assert push - row[dr.GEAR_STIFFNESS] * q == pytest.approx(torque, abs=1e-9)


@pytest.mark.parametrize('presliding', [0.0, 1e-3])
def test_friction_grows_with_the_load(presliding: float) -> None:
    """A gear that carries 4 N m and loses a quarter: 4 + 1 + 1.6 N m lift, 4 - 1 - 2.4 lower."""
    motor = MOTOR.model_copy(update={
        'load_friction': 0.25, 'presliding': presliding, 'breakaway': 1.0})
    row = drive_row(motor, DT, Imperfections())
    for current, sense in ((6.5 / 8, 0), (6.7 / 8, 1), (0.7 / 8, 0), (0.5 / 8, -1)):
        state = np.zeros(dr.STATES)
        state[dr.GEAR] = 4.0
        turn(row, 4.0 / 8, 1000, state)
        before = turn(row, current, 1000, state)[dr.ANGLE]
        way = turn(row, current, 2000, state)[dr.ANGLE] - before
        assert (abs(way) < 1e-4) if sense == 0 else (sense * way > 1e-3), current


def test_presliding_is_a_spring_that_keeps_its_place() -> None:
    """Below Coulomb friction the rotor leans on it, comes back, and creeps under no tremor."""
    motor = MOTOR.model_copy(update={
        'presliding': 2e-3, 'breakaway': 1.0, 'coulomb': (0.2, 0.2), 'viscous': (1.0, 1.0)})
    row = drive_row(motor, DT, Imperfections())
    state = turn(row, 0.1, 4000)
    assert state[dr.ANGLE] == pytest.approx(1e-3, rel=1e-6)
    for k in range(40000):
        dr.rotor_law(row, state, DT, 0.1 + 0.09 * math.sin(0.3 * k))
    turn(row, 0.1, 4000, state)
    assert state[dr.ANGLE] == pytest.approx(1e-3, rel=1e-6)
    turn(row, 0.0, 4000, state)
    assert state[dr.ANGLE] == pytest.approx(0.0, abs=1e-9)


def test_friction_turns_over_twice_the_presliding() -> None:
    """Behind a reversal it has its full size again after twice the way, not at once."""
    motor = MOTOR.model_copy(update={'presliding': 2e-3, 'breakaway': 1.0})
    row, state = drive_row(motor, DT, Imperfections()), np.zeros(dr.STATES)
    turn(row, 1.0, 1000, state)
    assert state[dr.BRISTLE] == 1.0
    while state[dr.SPEED] > 0.0:
        dr.rotor_law(row, state, DT, -1.0)
    furthest = state[dr.ANGLE]
    while state[dr.BRISTLE] > -1.0:
        dr.rotor_law(row, state, DT, -1.0)
    assert furthest - state[dr.ANGLE] == pytest.approx(4e-3, abs=abs(2 * DT * state[dr.SPEED]))


def test_presliding_breaks_away() -> None:
    """The bristle of 0.2 A holds up to 0.3 A, and drops to 0.2 A once it slides."""
    row = drive_row(MOTOR.model_copy(update={'presliding': 1e-3, 'viscous': (2.0, 2.0)}), DT,
                    Imperfections())
    held = np.zeros(dr.STATES)
    for current in np.linspace(0.0, 0.29, 20000):  # slowly, so that it does not overshoot
        dr.rotor_law(row, held, DT, current)
    assert held[dr.ANGLE] == pytest.approx(1e-3 * 0.29 / 0.2, rel=1e-2)
    assert turn(row, 0.31, 20000, held)[dr.SPEED] == pytest.approx((0.31 - 0.2) / 2.0, rel=1e-3)
    assert turn(row, 0.25, 20000, held)[dr.SPEED] == pytest.approx((0.25 - 0.2) / 2.0, rel=1e-3)


@settings(deadline=None)
@given(inertia=st.floats(1e-7, 1e-3), coulomb=st.floats(0.0, 5.0), viscous=st.floats(0.0, 5.0),
       load=st.floats(0.0, 0.99), presliding=st.floats(1e-9, 0.1), breakaway=st.floats(1.0, 3.0),
       speed=st.floats(-10.0, 10.0), angle=st.floats(-0.1, 0.1), carried=st.floats(-20.0, 20.0))
def test_friction_only_takes_energy(
    inertia: float, coulomb: float, viscous: float, load: float, presliding: float,
    breakaway: float, speed: float, angle: float, carried: float,
) -> None:
    """Whatever the parameters, at the step of 0.5 ms: rotor and bristle together never gain."""
    motor = MOTOR.model_copy(update={
        'rotor_inertia': inertia, 'coulomb': (coulomb, coulomb), 'viscous': (viscous, viscous),
        'load_friction': load, 'presliding': presliding, 'breakaway': breakaway})
    row, state = drive_row(motor, DT, Imperfections()), np.zeros(dr.STATES)
    state[dr.SPEED], state[dr.GEAR] = speed, carried
    grip = row[dr.COULOMB] + row[dr.LOADED] * abs(carried)
    # the current carries the load, so that only friction acts
    current = carried / row[dr.TORQUE]
    row[dr.LIMIT] = math.inf

    def energy() -> float:
        return float(0.5 * row[dr.INERTIA] * state[dr.SPEED] ** 2
                     + 0.5 * grip * presliding * state[dr.BRISTLE] ** 2)

    before = energy()
    for _ in range(200):
        dr.rotor_law(row, state, DT, current)
        assert energy() <= before * (1.0 + 1e-9) + 1e-15
        before = energy()
    assert abs(state[dr.BRISTLE]) <= breakaway


@settings(deadline=None, max_examples=50)
@given(inertia=st.floats(1e-7, 1e-3), coulomb=st.tuples(st.floats(0.0, 5.0), st.floats(0.0, 5.0)),
       load=st.floats(0.0, 0.99), presliding=st.sampled_from([0.0, 1e-9, 1e-4, 1e-2]),
       stiffness=st.floats(1.0, 1e6), speed=st.floats(-10.0, 10.0))
def test_rotor_on_its_gear_comes_to_rest(
    inertia: float, coulomb: tuple[float, float], load: float, presliding: float,
    stiffness: float, speed: float,
) -> None:
    """On a held link a rotor swings out: never faster than it began."""
    motor = MOTOR.model_copy(update={
        'rotor_inertia': inertia, 'coulomb': coulomb, 'load_friction': load,
        'presliding': presliding, 'stiffness': stiffness, 'damping': 0.0, 'breakaway': 1.0})
    row, state = drive_row(motor, DT, Imperfections()), np.zeros(dr.STATES)
    state[dr.SPEED] = speed
    for _ in range(2000):
        state[dr.GEAR] = dr.gear_push(row, state, DT, 0.0, 0.0)
        dr.rotor_law(row, state, DT, 0.0)
        assert abs(state[dr.SPEED]) <= 1.2 * abs(speed) + 1e-9
    assert np.isfinite(state).all()


def test_reading_of_the_current() -> None:
    """The ripple is a cosine of the motor's angle, in time with it, whatever the current."""
    motor = MOTOR.model_copy(update={'current_ripple': 0.2, 'current_ripple_phase': 0.5})
    row = drive_sensor_row(motor, Imperfections())
    for rotor, current in ((0.0, 0.0), (0.013, 1.0), (-2.0, -0.7)):
        assert current_reading(row, current, rotor, 0.0) == pytest.approx(
            current + 0.2 * math.cos(100 * rotor + 0.5), abs=1e-12)
    plain = drive_sensor_row(motor, Imperfections(current_ripple=False))
    assert current_reading(plain, 0.3, 0.013, 0.0) == 0.3


def test_each_imperfection_has_its_switch() -> None:
    """Switching all off leaves a rotor on a nearly rigid gear."""
    row = drive_row(MOTOR, DT, Imperfections.none())
    assert not row[dr.COULOMB:dr.COULOMB + 2].any() and not row[dr.VISCOUS:dr.VISCOUS + 2].any()
    assert row[dr.LOADED] == row[dr.PRESLIDING] == 0.0
    assert row[dr.PLAY] == 0.0 and row[dr.LIMIT] == math.inf
    assert row[dr.GEAR_STIFFNESS] == pytest.approx(0.1 * (0.5 / DT) ** 2)
    for name in ('friction', 'backlash', 'gear_compliance', 'current_limit'):
        alone = drive_row(MOTOR, DT, Imperfections(**{name: False}))
        assert not np.array_equal(alone, drive_row(MOTOR, DT, Imperfections()))


def test_rotor_needs_inertia() -> None:
    """A motor without rotor inertia is refused by the name of its joint."""
    with pytest.raises(SimulationError, match="rotor_inertia of joint 'a' is 0"):
        drive_row(MOTOR.model_copy(update={'rotor_inertia': 0.0}), DT, Imperfections())
