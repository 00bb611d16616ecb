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
How links bend, from motion with known loads: by what their strain then leaves unexplained.

Parameters of the rows are linear and are taken out of the search (variable projection in the form
of Kaufman, "A variable projection method for solving separable nonlinear least squares problems",
BIT 15, 1975); angles per strain are what it moves.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.payload.bent import BentLinks, links_of
from tudor_dynamics.payload.watched import CUTOFF, Smoothed, smoothed, Watched
from tudor_dynamics.typing import FloatArray

TURN = 1e-3
"""Angle by which a gauge's usual strain is tried [rad or m]."""
STEPS = 12
SETTLED = 1e-3
"""Part of the error by which a step has to lessen it."""
SEARCHED = 6000
"""Samples that the search needs."""
EXPLAINED = 0.9
"""Part of what rigid links leave over that bent ones may leave at most, in some gauge."""
LONG = 0.5
"""Time over which means of what is left over do not depend on each other [s]."""
SMALLEST = 1e-7
"""Share of the largest eigenvalue below which rows tell nothing."""


def bends(arm: Arm) -> FloatArray:
    """
    Say which gauges may turn which joints: those of the link itself, and of the link before.

    Returns (joints, gauges).
    """
    joints = list(arm.active_joints)
    found = np.zeros((len(joints), len(arm.gauges)), dtype=bool)
    for column, gauge in enumerate(arm.gauges):
        if gauge.joint in joints:
            first = joints.index(gauge.joint)
            found[first:first + 2, column] = True
    return found


def find_bending(
    arm: Arm, model: AnalyticalModel, watched: Sequence[Watched],
) -> BentLinks | None:
    """
    Search for the angles per strain that explain strain best.

    Returns None where links hardly bend, or there is too little motion.
    """
    stretches = _searched(watched)
    allowed = bends(arm)
    strains = np.vstack([item.strain for item in stretches]) if stretches else np.zeros(
        (0, len(arm.gauges)))
    columns = model.n_inputs + int(allowed.sum())
    if len(strains) < 10 * columns or not allowed.any():
        return None
    usual = np.maximum(strains.std(axis=0), 1e-300)
    search = _Search(model, stretches, allowed, usual)
    nothing = np.zeros(int(allowed.sum()))
    rigid = search.size(nothing)
    turns = search.run(nothing)
    if not (search.size(turns) < EXPLAINED * rigid).any():
        return None
    bending = search.bending(turns)
    return _learned(model, stretches, smoothed(watched, CUTOFF), bending)


def relearned(bent: BentLinks, watched: Sequence[Watched]) -> BentLinks:
    """Fit the model of links that bend as they are known to, to other motion."""
    return _learned(bent.model, _searched(watched), smoothed(watched, bent.cutoff), bent.bending)


def _searched(watched: Sequence[Watched]) -> list[Smoothed]:
    """Filter stretches, and keep as many samples as the search needs."""
    every = max(1, int(sum(len(item.dt) for item in watched) / SEARCHED))
    return [found for item in watched
            for found in smoothed([item], CUTOFF, every * float(np.median(item.dt)))]


def _motion(stretch: Smoothed, model: AnalyticalModel, bending: FloatArray) -> FloatArray:
    """Give the input of a model at where links are."""
    motion = links_of(stretch.states, bending)
    if model.n_inputs > motion.shape[1]:
        motion = np.column_stack([motion, np.full(len(motion), stretch.payload)])
    return motion


class _Search:
    """Least squares of all gauges, each by what it leaves over."""

    def __init__(
        self, model: AnalyticalModel, stretches: Sequence[Smoothed], allowed: FloatArray,
        usual: FloatArray,
    ) -> None:
        self._model, self._stretches = model, stretches
        self._allowed, self._usual = allowed, usual
        self._measured = np.vstack([item.strain for item in stretches])

    def bending(self, turns: FloatArray) -> FloatArray:
        """Give angles per strain from angles at the usual strain."""
        found = np.zeros(self._allowed.shape)
        found[self._allowed] = turns
        return found / self._usual

    def size(self, turns: FloatArray) -> FloatArray:
        """Give what each gauge leaves over, as a root mean square."""
        return np.asarray(np.sqrt(np.mean(self._solve(turns)[1] ** 2, axis=0)))

    def run(self, turns: FloatArray) -> FloatArray:
        """Step until nothing gets better."""
        noise = self.size(turns)
        now = self._cost(turns, noise)
        for _ in range(STEPS):
            step = self._step(turns, noise)
            while (then := self._cost(turns + step, noise)) >= now:
                step = 0.5 * step
                if np.abs(step).max() < 0.01 * TURN:
                    return turns
            turns = turns + step
            if then > (1.0 - SETTLED) * now:
                return turns
            noise = self.size(turns)
            now = self._cost(turns, noise)
        return turns

    def _cost(self, turns: FloatArray, noise: FloatArray) -> float:
        return float(np.sum(np.mean(self._solve(turns)[1] ** 2, axis=0) / noise ** 2))

    def _inputs(self, turns: FloatArray) -> FloatArray:
        bending = self.bending(turns)
        return np.vstack([_motion(item, self._model, bending) for item in self._stretches])

    def _solve(self, turns: FloatArray) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
        """Give parameters of the rows, what they leave over, and what spans them by gauge."""
        rows = self._model.regressor.rows(self._inputs(turns))
        parameters = np.zeros((rows.shape[1], rows.shape[2]))
        left, spans = self._measured.copy(), []
        for gauge in range(rows.shape[1]):
            own = rows[:, gauge]
            size = np.sqrt(np.mean(own ** 2, axis=0))
            used = np.flatnonzero(size > 0.0)
            scaled = own[:, used] / size[used]
            values, vectors = np.linalg.eigh(scaled.T @ scaled)
            told = values > SMALLEST * values[-1]
            span = scaled @ (vectors[:, told] / np.sqrt(values[told]))
            along = span.T @ self._measured[:, gauge]
            parameters[gauge, used] = (
                vectors[:, told] @ (along / np.sqrt(values[told])) / size[used])
            left[:, gauge] -= span @ along
            spans.append(span)
        return parameters, left, spans

    def _step(self, turns: FloatArray, noise: FloatArray) -> FloatArray:
        parameters, left, spans = self._solve(turns)
        outputs = self._model.regressor.outputs
        here = outputs(self._inputs(turns), parameters)
        slopes = []
        for place in range(len(turns)):
            moved = turns.copy()
            moved[place] += TURN
            slope = (outputs(self._inputs(moved), parameters) - here) / TURN
            for gauge, span in enumerate(spans):
                slope[:, gauge] -= span @ (span.T @ slope[:, gauge])
            slopes.append((slope / noise).ravel())
        return np.asarray(np.linalg.lstsq(
            np.column_stack(slopes), (left / noise).ravel(), rcond=1e-8)[0], dtype=float)


def _learned(
    model: AnalyticalModel, stretches: Sequence[Smoothed], fine: Sequence[Smoothed],
    bending: FloatArray,
) -> BentLinks:
    found = model.like().fit(np.vstack([_motion(item, model, bending) for item in stretches]),
                             np.vstack([item.strain for item in stretches]))
    sums, count = np.zeros((bending.shape[1], bending.shape[1])), 0
    for item in fine:
        left = item.strain - found.predict(_motion(item, model, bending))
        length = max(1, round(LONG / item.step))
        for first in range(0, len(left) - length + 1, length):
            mean = left[first:first + length].mean(axis=0)
            sums += np.outer(mean, mean) * (length * item.step)
            count += 1
    density = sums / max(count, 1)
    # gauges of a link that agree to all digits still have noise of their own
    density += np.diag(1e-4 * np.diag(density) + 1e-300)
    return BentLinks(CUTOFF, bending, found, density)
