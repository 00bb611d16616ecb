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

"""Friction that a joint keeps where it has come to rest, by the way in which it came."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from tudor_dynamics.models.base import SLIDING
from tudor_dynamics.typing import FloatArray

AtRest = Literal['none', 'kept']
AT_REST: tuple[AtRest, ...] = ('none', 'kept')
"""None; or that of the last motion, until the joint moves the other way."""


def kept_speeds(speed: FloatArray, turning: ArrayLike) -> FloatArray:
    """
    Give speeds at which friction is what a joint keeps at rest, for those at which it is none.

    A bristle that was bent by sliding stays bent when the joint stops, and straightens only when
    it moves back (Dupont et al., "Single state elastoplastic friction models", IEEE TAC 47(5),
    2002). So below the speed of sliding the sign is that of the last motion that was faster than
    where the sign of friction turns.

    speed (points, joints) [rad/s or m/s], turning (joints,) [rad/s or m/s]; returns
    (points, joints).
    """
    moves = np.abs(speed) >= np.asarray(turning)
    latest = np.maximum.accumulate(
        np.where(moves, np.arange(len(speed))[:, None], -1), axis=0)
    signs = np.where(latest >= 0, np.sign(
        np.take_along_axis(speed, np.maximum(latest, 0), axis=0)), 0.0)
    slow = (np.abs(speed) < SLIDING) & (signs != 0.0)
    return np.where(slow, signs * SLIDING, speed)
