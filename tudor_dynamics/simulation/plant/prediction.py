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

"""Accelerations that a step begins with: as they went on, by the order that served best before."""

from __future__ import annotations

from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled

PAST = 4
"""Accelerations that are kept."""
ORDERS = 4
"""Polynomials to choose from: constant to cubic."""


@compiled
def extrapolated(past: NDArray, order: int, i: int) -> float:
    """
    Continue the polynomial through the last accelerations of a coordinate.

    past (PAST, n) [rad/s^2 or m/s^2].
    """
    a, b, c = past[0, i], past[1, i], past[2, i]
    if order == 0:
        return a
    if order == 1:
        return 2.0 * a - b
    if order == 2:
        return 3.0 * (a - b) + c
    return 4.0 * (a + c) - 6.0 * b - past[3, i]


@compiled
def best_order(found: NDArray, past: NDArray, prescribed: NDArray, factor: NDArray) -> int:
    """
    Say which order would have come nearest to what a step has found.

    What moves smoothly is met best by a high one, what rings in modes that a step cannot follow by
    a low one.

    found (n,) [rad/s^2 or m/s^2], past (PAST, n), prescribed (n,), factor (n, n).
    """
    errors = (0.0, 0.0, 0.0, 0.0)
    for i in range(found.shape[0]):
        if not prescribed[i]:
            a, b, c = past[0, i], past[1, i], past[2, i]
            weight = 1.0 / factor[i, i]
            first = weight * (found[i] - a)
            second = first - weight * (a - b)
            third = second - weight * (a - 2.0 * b + c)
            fourth = third - weight * (a - 3.0 * b + 3.0 * c - past[3, i])
            errors = (errors[0] + first * first, errors[1] + second * second,
                      errors[2] + third * third, errors[3] + fourth * fourth)
    best = 0
    for order in range(1, ORDERS):
        if errors[order] < errors[best]:
            best = order
    return best


@compiled
def remember(past: NDArray, found: NDArray) -> None:
    """Put the newest accelerations before the others."""
    for i in range(found.shape[0]):
        past[3, i], past[2, i], past[1, i], past[0, i] = (
            past[2, i], past[1, i], past[0, i], found[i])


@compiled
def forget(past: NDArray) -> None:
    """Take the newest accelerations away again."""
    for i in range(past.shape[1]):
        past[0, i], past[1, i], past[2, i] = past[1, i], past[2, i], past[3, i]
