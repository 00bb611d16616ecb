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

"""When an arm begins to follow its reference, and when it may not go on."""

from __future__ import annotations

import numpy as np

from tudor_dynamics.control.guards.reference_gate import ReferenceGate
from tudor_dynamics.typing import FloatArray

NEAR_TIME = 0.07
"""A reference is near the arm within what the planned speed goes in this time [s]: 4.9 deg."""
FOLLOWING_TIME = 0.3
"""Following error at which the arm stops, as such a time [s]: 21 deg."""
RESTING = 0.05
"""Part of the planned speed below which a reference rests."""


class Following:
    """Reasons not to follow a reference: planned (joints,) [rad/s or m/s]."""

    def __init__(
        self, joints: tuple[str, ...], planned: FloatArray, reference: ReferenceGate,
    ) -> None:
        self._joints, self._planned, self._reference = joints, planned, reference

    def stray(self, now: float, timeout: float, q: FloatArray) -> str:
        """
        Say why an arm that follows must not go on; empty if it may.

        now, timeout [s], q (joints,) [rad or m].
        """
        away = self._away(now, timeout, q)
        if self._reference.age(now) > timeout:
            return f'no reference for {1e3 * timeout:.0f} ms'
        if np.any(away > FOLLOWING_TIME * self._planned):
            j = int(np.argmax(away / self._planned))
            return f'{self._joints[j]} is {away[j]:.3g} away from its reference'
        return ''

    def obstacle(self, now: float, timeout: float, q: FloatArray, held: FloatArray) -> str:
        """
        Say why an arm that holds cannot begin to follow; empty if it can.

        held (joints,) [rad/s or m/s].
        """
        reference, away = self._reference, self._away(now, timeout, q)
        if reference.age(now) > timeout:
            return reference.refusal or 'no reference comes'
        if np.any(away > NEAR_TIME * self._planned):
            j = int(np.argmax(away / self._planned))
            return (f'the reference is {away[j]:.3g} away from {self._joints[j]}: it has to '
                    'begin at the arm')
        if np.any(np.abs(reference.dq) > RESTING * self._planned):
            return 'the reference moves already: it has to begin at rest'
        return 'the arm brakes' if np.any(np.abs(held) > RESTING * self._planned) else ''

    def _away(self, now: float, timeout: float, q: FloatArray) -> FloatArray:
        return np.abs(self._reference.place(now, timeout) - q)
