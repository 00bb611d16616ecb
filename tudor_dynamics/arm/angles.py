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
Angles that were meant to be right ones: rounded in a file, exact in the model.

A file says 1.5708 where the drawing has a quarter turn. Axes that are parallel on the arm are then
not quite so in the model, and base parameters appear that only that difference shows: columns of
4e-6, coefficients of 5e4. What lies this close to a multiple of 45 degrees is taken as that; where
an arm was measured to be off by less than a milliradian, its dynamics do not feel it.
"""

from __future__ import annotations

import math

STEP = math.pi / 4
NEAR = 1e-3
"""What is closer to a multiple of `STEP` is taken as that [rad]."""
WORTH_SAYING = 1e-6
"""Smaller differences are those of printed digits [rad]."""
SHOWN = 3
"""Angles that one note names."""


def exact(angle: float) -> float:
    """
    Give the multiple of 45 degrees that an angle was rounded from.

    angle [rad]; returns the multiple where it is within `NEAR`, else the angle itself [rad].
    """
    nearest = round(angle / STEP) * STEP
    return nearest if abs(angle - nearest) <= NEAR else angle


class Snapped:
    """Takes angles as what they were rounded from, and remembers which it changed."""

    def __init__(self) -> None:
        self._told: list[str] = []

    def take(self, angle: float, where: str) -> float:
        """Give the exact angle: angle [rad]."""
        found = exact(angle)
        if abs(found - angle) > WORTH_SAYING:
            self._told.append(f'{where} {angle:.7g} as {found:.7g}')
        return found

    def note(self) -> str:
        """Say in one sentence what was changed; nothing where nothing was."""
        if not self._told:
            return ''
        more = len(self._told) - SHOWN
        shown = ', '.join(self._told[:SHOWN]) + (f' and {more} more' if more > 0 else '')
        return (f'angles within {NEAR:g} rad of a multiple of 45 degrees are taken as that: '
                f'{shown} [rad]')
