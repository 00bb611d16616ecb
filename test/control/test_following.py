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

"""When an arm follows: each reason by itself, and none."""

from __future__ import annotations

import numpy as np
import pytest

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.limits import hard_limits
from tudor_dynamics.control.cascade import learned_period
from tudor_dynamics.control.motion_controller import ReferenceGate
from tudor_dynamics.control.settings import FOLLOWING_TIME, NEAR_TIME, RESTING_SPEED
from tudor_dynamics.signals.motion_profile import motion_limits

TIMEOUT = 0.1


@pytest.fixture
def parts(root) -> tuple[ReferenceGate, np.ndarray, np.ndarray]:
    """Give the gate, planned speeds, and where the reference rests."""
    arm = load_arm(root / 'config' / 'tudor.yaml')
    limits = hard_limits(arm)
    planned = motion_limits(arm).velocity
    gate = ReferenceGate(arm.active_joints, limits, planned)
    place = 0.5 * (limits.lower + limits.upper)
    gate.add(0.0, place, np.zeros(len(place)))
    return gate, planned, place


def test_it_begins_at_rest_at_the_arm(parts) -> None:
    """Near, at rest, fresh, and an arm that does not brake any more."""
    gate, planned, place = parts
    still = np.zeros(len(place))
    near, far = place + 0.9 * NEAR_TIME * planned, place + 1.1 * NEAR_TIME * planned
    assert gate.obstacle(0.0, TIMEOUT, near, still) == ''
    assert 'begins where the arm is' in gate.obstacle(0.0, TIMEOUT, far, still)
    assert 'brakes' in gate.obstacle(0.0, TIMEOUT, near, 2.0 * RESTING_SPEED * planned)
    assert gate.obstacle(
        2.0 * TIMEOUT, TIMEOUT, near, still) == (
            'no reference on joint_reference; start reference_generator')
    gate.add(0.0, place, 2.0 * RESTING_SPEED * planned)
    assert 'send one at rest' in gate.obstacle(0.0, TIMEOUT, near, still)


def test_it_ends_where_the_arm_strays_or_nothing_comes(parts) -> None:
    """Farther than where it may begin, and with the joint that is farthest."""
    gate, planned, place = parts
    assert gate.stray(0.0, TIMEOUT, place + 0.9 * FOLLOWING_TIME * planned) == ''
    away = place.copy()
    away[1] += 1.1 * FOLLOWING_TIME * planned[1]
    assert gate.stray(0.0, TIMEOUT, away).startswith('joint3 is ')
    assert gate.stray(2.0 * TIMEOUT, TIMEOUT, place) == (
        'no reference on joint_reference for 100 ms; check its sender')


def test_the_period_is_learned_from_the_short_ones() -> None:
    """Every tenth sample is lost: the period is that of the others."""
    period = 0.01
    for k in range(3000):
        period = learned_period(period, 0.004 if k % 10 == 9 else 0.002)
    assert period == pytest.approx(0.002, rel=0.05)
