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
Coordinates in which the search for elastic parameters runs straight.

What strain shows sharply are sums: of the compliances of a gear and the link behind it, of masses.
What it shows weakly is how a sum is shared. Along such a valley, logarithms of stiffnesses and
masses bend away from constant sums; compliances and masses themselves do not.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tudor_dynamics.models.elastic.parameters import kind_of
from tudor_dynamics.typing import FloatArray


class Straight:
    """Logarithms to coordinates and back: center (names,)."""

    def __init__(self, names: Sequence[str], center: FloatArray) -> None:
        self.center = center
        self._sign = np.array([float(kind_of(name).adds) for name in names])
        self._plain = self._sign == 0.0

    def of(self, x: FloatArray) -> FloatArray:
        """
        Give compliances and masses relative to the centre, other logarithms as they are.

        x (names,).
        """
        return np.where(self._plain, x, np.exp(self._sign * (x - self.center)))

    def back(self, u: FloatArray) -> FloatArray:
        """Give the logarithms: u (names,)."""
        positive = np.where(self._plain, 1.0, np.maximum(u, 1e-300))
        return np.where(self._plain, u, self.center + self._sign * np.log(positive))

    def slope(self, u: FloatArray) -> FloatArray:
        """Differentiate ``back``: u (names,)."""
        return np.where(self._plain, 1.0, self._sign / np.where(self._plain, 1.0, u))
