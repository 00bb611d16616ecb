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

"""
Friction that holds a joint: how much it may be, and how much of it there is.

A joint that stands keeps whatever friction it came to rest with. As far as friction can hold, a
residual that stays is none of contact; what is left of it shows changes.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from tudor_dynamics.compiled import compiled
from tudor_dynamics.monitoring.thresholds.features import STANDING
from tudor_dynamics.typing import FloatArray

SETTLES = 0.5
"""Time constant with which a residual that stays is taken for friction that holds [s]."""
AnyFloat = TypeVar('AnyFloat', float, FloatArray)


@compiled
def held_friction(stiction: AnyFloat, speed: AnyFloat) -> AnyFloat:
    """
    Give the friction that may hold a joint at a speed.

    stiction [unit of its effort], speed [rad/s or m/s].
    """
    return stiction * np.maximum(0.0, 1.0 - speed / STANDING)


@compiled
def advance_held(
    dt: float, value: FloatArray, held: FloatArray, friction: FloatArray, out: FloatArray,
) -> None:
    """
    Follow the friction that holds each joint, and give what is left of the residual.

    value (channels,) [its unit], held, out (channels,); dt [s]: 0 to begin anew; writes friction
    (channels,).
    """
    share = 1.0 if dt <= 0.0 else dt / (SETTLES + dt)
    for i in range(len(value)):
        if value[i] == value[i]:  # NaN tells nothing
            friction[i] += share * (value[i] - friction[i])
        friction[i] = min(max(friction[i], -held[i]), held[i])
        out[i] = value[i] - friction[i]


@compiled
def _record(dt: FloatArray, value: FloatArray, held: FloatArray, out: FloatArray) -> None:
    friction = np.zeros(value.shape[1])
    for k in range(len(value)):
        advance_held(dt[k], value[k], held[k], friction, out[k])


def released(t: FloatArray, value: FloatArray, held: FloatArray) -> FloatArray:
    """
    Take the friction that holds off a gapless record.

    t (samples,) [s], value, held (samples, channels) [its unit]; returns (samples, channels).
    """
    out = np.empty_like(value)
    _record(np.diff(t, prepend=t[0]), value, held, out)
    return out
