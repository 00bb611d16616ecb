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

"""How much of the outputs some rows explain: least squares from small products."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.typing import FloatArray

SMALLEST = 1e-9
"""Directions of the scaled Gram matrix below this part of the largest are left out."""
FORETELLING = 1e-5
"""The same where samples are foretold that were not learned from."""
FLOOR = 1e-6
"""No output is taken to be explained better than to this part of its variance."""
PASSES = 2


class Explained:
    """
    Rows, freed of what each channel has to itself, ready for many candidates of the outputs.

    Channels of a group share their parameters and are weighted by their residuals.

    rows (n, channels, columns), own (n, own).
    """

    def __init__(
        self, rows: FloatArray, own: Sequence[FloatArray], groups: Sequence[tuple[int, ...]],
    ) -> None:
        self.groups = tuple(groups)
        self._plain, self._bodies = tuple(own), [rows[:, i] for i in range(rows.shape[1])]
        self._own = [_orthonormal(x) for x in own]
        self._rows = [rows[:, i] - basis @ (basis.T @ rows[:, i])
                      for i, basis in enumerate(self._own)]
        self._grams = [x.T @ x for x in self._rows]

    def freed(self, channel: int, values: FloatArray) -> FloatArray:
        """Free values of what a channel has to itself: values (n,)."""
        basis = self._own[channel]
        return np.asarray(values - basis @ (basis.T @ values))

    def residuals(self, outputs: FloatArray) -> FloatArray:
        """Give what is left of each channel: outputs (n, channels); returns (n, channels)."""
        return np.column_stack([
            self.freed(i, outputs[:, i]) - self._rows[i] @ x
            for i, x in enumerate(self.parameters(outputs))])

    def parameters(self, outputs: FloatArray) -> FloatArray:
        """
        Give the parameters of the bodies.

        outputs (n, channels); returns (channels, columns).
        """
        found = np.empty((outputs.shape[1], self._rows[0].shape[1]))
        for group in self.groups:
            free = [self.freed(i, outputs[:, i]) for i in group]
            sizes = np.array([float(np.std(outputs[:, i])) for i in group])
            told = sizes > 0.0  # what never changes has no say
            safe = np.where(told, sizes, 1.0)
            weights = told / safe
            for _ in range(PASSES if len(group) > 1 else 1):
                gram = sum(w ** 2 * self._grams[i] for w, i in zip(weights, group, strict=True))
                right = sum(w ** 2 * (self._rows[i].T @ y)
                            for w, i, y in zip(weights, group, free, strict=True))
                parameters = _solve(np.asarray(gram), np.asarray(right))
                left = [y - self._rows[i] @ parameters
                        for i, y in zip(group, free, strict=True)]
                spread = np.array([np.sqrt(np.mean(x ** 2)) for x in left])
                weights = told / np.maximum(spread, 0.03 * safe)
            found[list(group)] = parameters
        return found

    def shares(self, outputs: FloatArray) -> FloatArray:
        """
        Give the part of each channel's variance that is left.

        outputs (n, channels); returns (channels,).
        """
        return share_of(self.residuals(outputs), outputs)

    def alone(self, channel: int, candidates: FloatArray) -> FloatArray:
        """
        Give the part of each candidate's variance that one channel's rows leave.

        candidates (n, candidates); returns (candidates,).
        """
        basis, rows = self._own[channel], self._rows[channel]
        free = candidates - basis @ (basis.T @ candidates)
        left = free - rows @ _solve(self._grams[channel], rows.T @ free)
        return share_of(left, candidates)

    def rest(self, channel: int, values: FloatArray) -> FloatArray:
        """Free values of all that one channel's rows can explain: values (n,); returns (n,)."""
        free, rows = self.freed(channel, values), self._rows[channel]
        return np.asarray(free - rows @ _solve(self._grams[channel], rows.T @ free))

    def of_own(self, channel: int, values: FloatArray, parameters: FloatArray) -> FloatArray:
        """
        Give what a channel has to itself, beside known parameters of the bodies.

        values (n,), parameters (columns,); returns (own,).
        """
        own, left = self._plain[channel], values - self._bodies[channel] @ parameters
        return _solve(own.T @ own, own.T @ left)

    def whole(self, channel: int, parameters: FloatArray, own: FloatArray) -> FloatArray:
        """
        Give what a channel measures with known parameters.

        parameters (columns,), own (own,).
        """
        return np.asarray(self._bodies[channel] @ parameters + self._plain[channel] @ own)

    def foretold(
        self, channel: int, values: FloatArray, known: NDArray[np.bool_],
    ) -> FloatArray:
        """
        Learn one channel from some samples, and foretell all of them.

        values, known (n,); returns (n,).
        """
        columns = np.column_stack([self._bodies[channel], self._plain[channel]])
        some = columns[known]
        return np.asarray(columns @ _solve(some.T @ some, some.T @ values[known], FORETELLING))

    def extended(self, columns: FloatArray) -> Explained:
        """Give each channel more columns to itself: columns (n, more)."""
        return Explained(np.stack(self._bodies, axis=1),
                         [np.column_stack([own, columns]) for own in self._plain], self.groups)

    def friction(self, channel: int, output: FloatArray) -> tuple[float, float]:
        """
        Say whether friction brakes a joint, as it does wherever directions are right.

        output (n,).
        """
        own, rows = self._plain[channel], self._bodies[channel]
        both, few = np.column_stack([rows, own]), np.column_stack([
            rows, np.delete(own, (1, 2), axis=1)])
        values = _solve(both.T @ both, both.T @ output)
        left = output - both @ values
        without = output - few @ _solve(few.T @ few, few.T @ output)
        friction, speed = own[:, 1:3] @ values[-own.shape[1]:][1:3], own[:, 1]
        size = float(np.sqrt(np.mean(friction ** 2) * np.mean(speed ** 2)))
        power = float(np.mean(friction * speed)) / size if size > 0.0 else 0.0
        rest = max(float(np.sum(left ** 2)), FLOOR * float(np.sum((output - output.mean()) ** 2)),
                   1e-300)
        return power, float(np.sum(without ** 2)) / rest


def share_of(left: FloatArray, outputs: FloatArray) -> FloatArray:
    """Give the part of the variance of outputs that is left, never below `FLOOR`."""
    total = np.sum((outputs - outputs.mean(axis=0)) ** 2, axis=0)
    rest = np.sum(left ** 2, axis=0)
    # what never changes has nothing to be explained
    return np.where(total > 0.0, np.clip(rest / np.where(total > 0.0, total, 1.0), FLOOR, None),
                    1.0)


def _orthonormal(columns: FloatArray) -> FloatArray:
    scale = np.linalg.norm(columns, axis=0)
    used = columns[:, scale > 1e-12 * max(float(scale.max()), 1e-300)]
    return np.asarray(np.linalg.qr(used / np.linalg.norm(used, axis=0))[0])


def _solve(gram: FloatArray, right: FloatArray, smallest: float = SMALLEST) -> FloatArray:
    """Solve the scaled normal equations, without the directions that are not there."""
    scale = np.sqrt(np.diag(gram))
    seen = scale > 1e-10 * max(float(scale.max(initial=0.0)), 1e-300)
    safe = np.where(seen, scale, 1.0)
    scaled = np.where(np.outer(seen, seen), gram, 0.0) / np.outer(safe, safe)
    values, vectors = np.linalg.eigh(scaled)
    good = values > smallest * max(float(values[-1]), 1e-300)
    inverse = np.where(good, 1.0 / np.where(good, values, 1.0), 0.0)
    shape = (-1,) + (1,) * (right.ndim - 1)
    projected = inverse.reshape(shape) * (vectors.T @ (right / safe.reshape(shape)))
    return np.asarray((vectors @ projected) / safe.reshape(shape)
                      * seen.reshape(shape))
