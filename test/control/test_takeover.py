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

"""When an arm of unknown motion may be commanded."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tudor_dynamics.control.motion_controller import Takeover
from tudor_dynamics.control.settings import TAKEOVER_TIME

ACCELERATION = np.array([3.5, 3.5])


def taken(speed: Callable[[float], float], dt: float = 0.002, delay: float = 0.03) -> float:
    """Give the time after which an arm is taken over [s]."""
    takeover = Takeover(ACCELERATION)
    for k in range(round(3.0 / dt)):
        if takeover.step(k * dt, np.array([speed(k * dt), 0.0]), delay):
            return k * dt
    raise AssertionError('never')


@pytest.mark.parametrize('dt', [0.001, 0.01, 0.1])
def test_standing_and_steady_arms(dt: float) -> None:
    """They are taken over once they were looked at, at any rate."""
    for speed in (0.0, 1.2, -0.7):
        found = taken(lambda t: speed, dt)  # noqa: B023
        assert found == pytest.approx(TAKEOVER_TIME + 0.03, abs=dt + 1e-6)


def test_braking_arm_is_left_to_stop() -> None:
    """An arm that brakes by 200 deg/s^2, at once or after 0.1 s, nearly stands before."""
    for begins in (0.0, 0.1):
        def speed(t: float) -> float:
            return max(1.22 - 3.5 * max(t - begins, 0.0), 0.0)  # noqa: B023
        assert speed(taken(speed) - 0.04) < 0.15
