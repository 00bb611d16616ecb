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

"""Links that bend by their own strain, and how they bend, from motion with known loads."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.errors import ModelError
from tudor_dynamics.load.settings import (
    CUTOFF, EXPLAINED, FINE, LONG, SEARCHED, SETTLED, SMALLEST, STEPS, TURN)
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import BundlePart, Coefficient, read
from tudor_dynamics.signals.filters import SmoothStates
from tudor_dynamics.typing import FloatArray


# -- Recordings of arms that bend: positions and strains after the same filter


@dataclass(frozen=True, eq=False)
class Watched:
    """A gapless stretch of a recording."""

    dt: FloatArray  # time since the sample before, (samples,) [s]
    q: FloatArray  # positions of the active joints, (samples, joints) [rad or m]
    strain: FloatArray  # readings in their units, (samples, gauges)
    payload: float  # what is carried [kg]
    begin: float = 0.0  # time of the first sample since the beginning of the recording [s]


@dataclass(frozen=True, eq=False)
class Smoothed:
    """A stretch after the filter, decimated."""

    states: FloatArray  # (3, samples, joints + gauges): with two derivatives
    strain: FloatArray  # readings after the filter, in their units, (samples, gauges)
    payload: float  # what is carried [kg]
    step: float  # time between samples [s]
    t: FloatArray  # since the beginning of the recording, (samples,) [s]


def smoothed(items: Iterable[Watched], cutoff: float, step: float = FINE) -> list[Smoothed]:
    """Filter stretches from where the filter has settled on: cutoff [Hz], step [s]."""
    found = []
    for item in items:
        dt = float(np.median(item.dt))
        every = max(1, round(step / dt))
        smooth = SmoothStates(cutoff)
        elapsed = np.cumsum(item.dt) - item.dt[0]
        begin = int(np.searchsorted(elapsed, smooth.settle))
        states = smooth.process(item.dt, np.hstack([item.q, item.strain]))[:, begin::every]
        if states.shape[1] > 1:
            found.append(Smoothed(states, states[0, :, item.q.shape[1]:], item.payload,
                                  every * dt, item.begin + elapsed[begin::every]))
    return found


# -- Links that bend: where they really are, by their own strain.
#
# A model of rigid bodies takes the motors' motion for that of the links. After each move links
# ring about it by angles that are proportional to their strains, so ``q + A e`` is nearer to where
# they are, and its acceleration has the ringing in it, at whatever frequency the load lets it be.
# Rows of rigid bodies, evaluated there, explain strain with and without a load several times as
# well.
#
# It shows loads only. A touch makes links ring as well, so it would hide half of what a detector
# looks for.

FACT = 'bent_links'  # where facts of a bundle have it
KIND = 'analytical'  # kind of model that shows loads


class BentPart(BundlePart):
    """Links that bend, with a model of the strain by where they are."""

    cutoff: Annotated[float, Field(gt=0.0, le=1e5)]
    bending: tuple[tuple[Coefficient, ...], ...]
    density: tuple[tuple[Coefficient, ...], ...]
    model: dict[str, Any]


@dataclass(frozen=True, eq=False)
class BentLinks:
    """How links bend, and a model of the strain that knows it."""

    cutoff: float  # of the filter that positions and strains go through [Hz]
    # Angle of a joint by which its link is ahead of it, per strain, (joints, gauges)
    # [rad or m per unit of the gauge].
    bending: FloatArray
    model: AnalyticalModel  # strain by where links are; of all payloads or of one
    # (gauges, gauges): residual of the model, as the mean square of its mean over a long
    # time, times that time: in the product of the gauges' units times seconds.
    density: FloatArray

    def as_dict(self, arm: Arm) -> dict[str, Any]:
        """Give it as plain values."""
        return {'cutoff': self.cutoff, 'bending': self.bending.tolist(),
                'density': self.density.tolist(), 'model': self.model.to_dict(arm, 'strain')}


def links_of(states: FloatArray, bending: FloatArray) -> FloatArray:
    """Give how links move, (samples, 3 joints): states (3, samples, joints + gauges)."""
    joints = len(bending)
    moved = states[..., :joints] + states[..., joints:] @ bending.T
    return np.ascontiguousarray(np.moveaxis(moved, 0, 1)).reshape(moved.shape[1], 3 * joints)


def bent_links(facts: Mapping[str, Any], arm: Arm) -> BentLinks | None:
    """Read how links bend from the facts of a bundle; returns None where the facts do not say."""
    content = facts.get(FACT)
    if content is None:
        return None
    part = read(BentPart, content)
    made = AnalyticalModel.from_dict(part.model, arm, 'strain')
    bending, density = np.array(part.bending), np.array(part.density)
    joints, gauges = len(arm.active_joints), len(arm.gauge_names)
    if bending.shape != (joints, gauges) or density.shape != (gauges, gauges):
        msg = (f'{FACT}: bending of shape {bending.shape} and density of shape {density.shape}; '
               f'expected {(joints, gauges)} and {(gauges, gauges)}: fit the model again')
        raise ModelError(msg)
    try:
        np.linalg.cholesky(density)
    except np.linalg.LinAlgError:
        msg = f'{FACT} of the model is damaged (noise not positive definite); fit the model again'
        raise ModelError(msg) from None
    return BentLinks(part.cutoff, bending, made, density)


# -- How links bend, from motion with known loads: by the residual of their strain.
#
# Parameters of the rows are linear and are taken out of the search (variable projection in the
# form of Kaufman, "A variable projection method for solving separable nonlinear least squares
# problems", BIT 15, 1975); angles per strain are what it moves.


def bends(arm: Arm) -> FloatArray:
    """Say which gauges may turn which joints: those of the own link and the one before."""
    joints = list(arm.active_joints)
    found = np.zeros((len(joints), len(arm.gauges)), dtype=bool)
    for column, gauge in enumerate(arm.gauges):
        if gauge.joint in joints:
            first = joints.index(gauge.joint)
            found[first:first + 2, column] = True
    return found


def find_bending(arm: Arm, model: AnalyticalModel, watched: Sequence[Watched]) -> BentLinks | None:
    """Search for angles per strain that explain strain best; None where links hardly bend."""
    stretches, allowed = _searched(watched), bends(arm)
    least = 10 * (model.n_inputs + int(allowed.sum()))
    if sum(len(item.strain) for item in stretches) < least or not allowed.any():
        return None
    search = _Search(model, stretches, allowed)
    nothing = np.zeros(int(allowed.sum()))
    rigid = search.size(nothing)
    turns = search.run(nothing)
    if not (search.size(turns) < EXPLAINED * rigid).any():
        return None
    return _learned(model, stretches, smoothed(watched, CUTOFF), search.bending(turns))


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
    """Least squares of all gauges, each by its residual."""

    def __init__(
        self, model: AnalyticalModel, stretches: Sequence[Smoothed], allowed: FloatArray,
    ) -> None:
        self._model, self._stretches, self._allowed = model, stretches, allowed
        self._measured = np.vstack([item.strain for item in stretches])
        self._usual = np.maximum(self._measured.std(axis=0), 1e-300)

    def bending(self, turns: FloatArray) -> FloatArray:
        """Give angles per strain from angles at the usual strain."""
        found = np.zeros(self._allowed.shape)
        found[self._allowed] = turns
        return found / self._usual

    def size(self, turns: FloatArray) -> FloatArray:
        """Give the residual of each gauge, as a root mean square."""
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
        """Give parameters of the rows, residuals, and what spans the rows by gauge."""
        rows = self._model.regressor.rows(self._inputs(turns))
        parameters = np.zeros((rows.shape[1], rows.shape[2]))
        left, spans = self._measured.copy(), []
        for gauge in range(rows.shape[1]):
            own = rows[:, gauge]
            size = np.sqrt(np.mean(own ** 2, axis=0))
            used = np.flatnonzero(size > 0.0)
            scaled = own[:, used] / size[used]
            values, vectors = np.linalg.eigh(scaled.T @ scaled)
            shown = values > SMALLEST * values[-1]
            span = scaled @ (vectors[:, shown] / np.sqrt(values[shown]))
            along = span.T @ self._measured[:, gauge]
            parameters[gauge, used] = (
                vectors[:, shown] @ (along / np.sqrt(values[shown])) / size[used])
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
    found = AnalyticalModel(
        model.regressor, model.n_joints, estimator=model.estimator, base=model.base_,
    ).fit(np.vstack([_motion(item, model, bending) for item in stretches]),
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
