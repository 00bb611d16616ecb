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

"""APRBS: range, clock, coverage, limits, seeds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.limits import Limits
from tudor_dynamics.errors import SignalError
from tudor_dynamics.mechanics.campaign import stimulus_motion
from tudor_dynamics.signals import settings
from tudor_dynamics.signals.motion_profile import (
    aprbs, binary_sequence, joint_range, motion_limits)

BOUNDS = Limits(np.radians([13.0, -80.0]), np.radians([178.0, 80.0]), np.full(2, 1.2),
                np.full(2, 3.5))


def test_shift_register_has_full_length() -> None:
    """A register of 7 bits repeats after 127 clocks, with 64 ones among them, and not before."""
    bits = binary_sequence(254, np.random.default_rng(1))
    assert np.array_equal(bits[:127], bits[127:])
    assert bits[:127].sum() == 64
    assert not any(np.array_equal(bits[:127], bits[k:k + 127]) for k in range(1, 127))


def test_levels_cover_the_range() -> None:
    """Each joint gets one level in each of as many equal bins as it has levels."""
    targets = aprbs(BOUNDS, 80.0, 3)
    for j in range(2):
        levels = np.append(targets.values[j], targets.start[j])
        share = (levels - BOUNDS.lower[j]) / (BOUNDS.upper[j] - BOUNDS.lower[j])
        np.testing.assert_array_equal(np.sort(np.floor(share * len(share))), np.arange(len(share)))


def test_clock() -> None:
    """Targets of a joint are whole clocks apart; 19 to 60 of them in 80 s; joints differ."""
    targets = aprbs(BOUNDS, 80.0, 3)
    for times in targets.times:
        gaps = np.diff(times)
        np.testing.assert_allclose(gaps, np.round(gaps), atol=1e-9)
        assert gaps.min() >= 1.0 - 1e-9
        assert 19 <= len(times) <= 60
        assert times[0] >= settings.REST
    assert not np.array_equal(targets.times[0], targets.times[1])


def test_seeds() -> None:
    """The same seed gives the same targets, another seed others."""
    one, same, other = (aprbs(BOUNDS, 40.0, seed) for seed in (7, 7, 8))
    np.testing.assert_array_equal(one.values[0], same.values[0])
    assert not np.array_equal(one.values[0][:5], other.values[0][:5])
    with pytest.raises(SignalError, match='no target'):
        aprbs(BOUNDS, 2.0, 0)


def test_motion_keeps_to_limits(root: Path) -> None:
    """The planned motion stays inside range, speed and acceleration of the reference arm."""
    arm = load_arm(root / 'config' / 'tudor.yaml')
    bounds, limits = joint_range(arm), motion_limits(arm)
    for seed in range(4):
        seen = stimulus_motion(arm, 80.0, seed, 2e-3)
        assert (np.abs(seen.dq) <= limits.velocity * (1 + 1e-9)).all()
        assert (np.abs(seen.ddq) <= limits.acceleration * (1 + 1e-9)).all()
        assert (seen.q >= bounds.lower - 1e-9).all() and (seen.q <= bounds.upper + 1e-9).all()
        assert np.ptp(seen.q, axis=0).min() > 0.7 * (bounds.upper - bounds.lower).min()
