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

"""Reactions: hold brakes, retreat drives the path back, comply follows the strain."""

from __future__ import annotations

import numpy as np
import pytest

from tudor_dynamics.arm.limits import Limits
from tudor_dynamics.control.references import ReactingReference, yielding_speed
from tudor_dynamics.errors import UsageError

LIMITS = Limits(np.full(2, -3.0), np.full(2, 3.0), np.full(2, 1.2), np.full(2, 3.5))
DT = 0.002


def moving(reaction: str) -> ReactingReference:
    """Give a reference in the middle of a move of joint 1."""
    reference = ReactingReference(LIMITS, np.array([0.8, 0.1]), reaction)
    reference.go(np.array([-0.4, 0.1]))
    for _ in range(300):
        reference.step(DT)
    assert reference.dq[0] < -0.8
    return reference


@pytest.mark.parametrize('reaction', ['hold', 'retreat'])
def test_brakes_and_retreats_within_the_limits(reaction: str) -> None:
    """The reference has no step in place or speed; it rests, after or before the collision."""
    reference = moving(reaction)
    touched = float(reference.q[0])
    reference.collide()
    assert not reference.go(np.array([0.0, 0.0]))
    place, speed = [], []
    for _ in range(2500):
        reference.step(DT)
        place.append(reference.q.copy())
        speed.append(reference.dq.copy())
    assert np.abs(np.diff(place, axis=0)).max() <= 1.01 * 1.2 * DT
    assert not speed[-1].any() and np.ptp(np.array(place)[:, 1]) < 1e-12
    if reaction == 'hold':
        assert place[-1][0] < touched
    else:
        assert place[-1][0] > touched + 0.2
    reference.clear()
    assert reference.go(np.array([0.0, 0.0]))


def test_comply_follows_the_load() -> None:
    """A load that bends a horizontal link down (strain positive) lowers the joint, bounded."""
    reference = moving('comply')
    reference.collide()
    before = reference.q.copy()
    reference.yielding[:] = yielding_speed(100.0, 1e6, 1000.0), 0.0
    for _ in range(100):
        reference.step(DT)
    assert reference.q - before == pytest.approx([-0.1 * 0.2, 0.0])
    reference.yielding[:] = 50.0
    reference.step(DT)
    assert reference.dq == pytest.approx([0.6, 0.6])


def test_none_goes_on_and_unknown_is_refused() -> None:
    """Without a reaction the move ends at its target."""
    reference = moving('none')
    reference.collide()
    for _ in range(2000):
        reference.step(DT)
    assert reference.q == pytest.approx([-0.4, 0.1])
    with pytest.raises(UsageError, match='retreat'):
        ReactingReference(LIMITS, np.zeros(2), 'jump')
