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

"""Gains from an elastic model: the linear loop, and the damping ratio that was asked for."""

from __future__ import annotations

from functools import lru_cache
import math

from elastic_making import blade_arm
import numpy as np
import pytest
from tudor_dynamics.arm.description import Arm
from tudor_dynamics.control.schedule import Schedule
from tudor_dynamics.errors import ArmError, ModelError, UsageError
from tudor_dynamics.identification.ringdowns import vibrations
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.models.tuning import (
    design, FeedbackLoop, fixed_ratios, Judge, loop_damping, loop_matrix, TunedArm, Wish)

POSE = np.array([0.6, -0.5])


def damped_arm(**more: object) -> Arm:
    """Describe two blades with a damper."""
    return blade_arm(backlash=0.0, **{
        'damper': {'position_gain': 3.0, 'mean_frequency': 0.3, 'velocity_bandwidth': 20.0,
                   'joints': [{'joint': 'j1', 'gauge': 'g1', 'gain': 1200.0},
                              {'joint': 'j2', 'gauge': 'g2', 'gain': 900.0}]},
        'sensors': [{'gauge': 'g1', 'gain': 121.4}, {'gauge': 'g2', 'gain': 121.4}],
        'joints': [{'name': name, 'limits': {'lower': low, 'upper': high, 'velocity': 2.0,
                                             'acceleration': 15.0},
                    'planned': {'velocity': 1.2, 'acceleration': 3.5}}
                   for name, low, high in (('j1', 0.3, 1.2), ('j2', -0.6, 0.6))], **more})


@lru_cache
def tuned() -> TunedArm:
    """Give the arm as it was described."""
    return TunedArm(damped_arm())


@lru_cache
def scheduled(ratio: float = 0.5, delay: float = 0.004) -> Schedule:
    """Give a schedule of three payloads."""
    return design(tuned(), Wish(ratio, delay, (0.0, 0.2, 0.4)))


def test_modes_are_those_of_the_elastic_model() -> None:
    """Drives held: the same frequencies and damping ratios by other means."""
    found = tuned().at(0.2, POSE).modes(2)
    driven = DrivenArm(damped_arm())
    driven.set_parameters({'payload': 0.2})
    for f, zeta, mode in zip(found.frequency, found.damping, vibrations(driven, POSE),
                             strict=True):
        assert mode.frequency == pytest.approx(f * math.sqrt(1.0 - zeta**2), rel=2e-3)
        assert mode.damping == pytest.approx(zeta, rel=0.05)


def test_strain_by_slow_acceleration() -> None:
    """What the schedule says of accelerations is what the elastic model feels, followed slowly."""
    small = tuned().at(0.2, POSE)
    driven = DrivenArm(damped_arm())
    driven.set_parameters({'payload': 0.2})
    t = np.arange(0.0, 3.0, 2e-3)
    ramp = 0.5 * (1.0 - np.cos(math.pi * np.clip(t / 2.0, 0.0, 1.0)))  # of the acceleration
    q = np.tile(POSE, (len(t), 1))
    q[:, 0] += 0.1 * np.cumsum(np.cumsum(ramp)) * 4e-6
    dt = np.full(len(t), 2e-3)
    dt[0] = 0.0
    moment = driven.follow(q, dt).moment
    rest = np.array([driven.follow(row[None], np.zeros(1)).moment[0] for row in q[-400:]])
    felt = (moment[-400:] - rest).mean(axis=0) * 121.4e-6
    np.testing.assert_allclose(felt, small.inertia[:, 0] * 0.1, rtol=0.1)


def test_one_blade_is_damped_as_the_formula_says() -> None:
    """An ideal drive without position loop: 2 zeta w = k c, c of the strain by a moved drive."""
    small = tuned().at(0.0, POSE)
    found = small.modes(2)
    gain = 300.0
    matrix = loop_matrix(small, FeedbackLoop(
        np.array([gain, 0.0]), np.array([0, 1]), 1e-6, 1e-6, 0.0, 1e4, np.zeros(2)))
    got = loop_damping(matrix, *found.frequency.tolist()).first
    rate = gain * found.strain[0, 0] * found.drive[0, 0]
    wanted = found.damping[0] + rate / (2.0 * 2.0 * math.pi * found.frequency[0])
    assert got == pytest.approx(wanted, rel=0.1)


def test_ratio_that_was_asked_for() -> None:
    """Every node has it; with fixed gains it is another one at each payload."""
    schedule = scheduled()
    np.testing.assert_allclose(schedule.column('reached'), 0.5, atol=0.01)
    fixed = fixed_ratios(tuned(), 0.004, schedule)
    assert np.ptp(fixed) > 0.03
    assert schedule.column('position_gain').max() <= 3.0
    # half of the delay from which on it excites
    judge = Judge(tuned(), tuned().at(0.4, POSE), *tuned().at(0.4, POSE).modes(
        2).frequency.tolist())
    delay = judge.full_delay(1.5)
    assert judge(1.5, 1.9 * delay).decay > 0.0 > judge(1.5, 2.1 * delay).decay


def test_delay_that_forbids_it() -> None:
    """With 60 ms of delay less is had, and said; faster modes keep their own damping."""
    late = scheduled(0.8, 0.06)
    assert late.column('reached').max() < 0.6
    assert late.column('gain(j1)').max() < scheduled().column('gain(j1)').min()


def test_what_cannot_be_tuned() -> None:
    """No damper, unknown gains of gauges, impossible wishes: each says what to do."""
    with pytest.raises(ArmError, match="the key 'damper' is missing"):
        TunedArm(blade_arm())
    with pytest.raises(ModelError, match='gains of the gauges'):
        TunedArm(damped_arm(sensors=[]))
    for wish, said in (({'damping_ratio': 1.2}, 'give 0.02'), ({'delay': -1.0}, 'give 0 to'),
                       ({'payloads': (0.2, 0.1)}, 'give masses')):
        with pytest.raises(UsageError, match=said):
            Wish(**wish)
