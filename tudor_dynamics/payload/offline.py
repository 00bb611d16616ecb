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

"""From models and filtered recordings to what the arm carries."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
import math

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import FitError
from tudor_dynamics.models.base import Model
from tudor_dynamics.payload.bent import BentLinks
from tudor_dynamics.payload.estimate import Leftover, OutputMass, PayloadEstimate, Verdict
from tudor_dynamics.payload.inertia import consistent, COUNT
from tudor_dynamics.payload.least_squares import Solution, solve_load
from tudor_dynamics.payload.readings import bent_readings, Readings, readings
from tudor_dynamics.payload.rows import carrier_frame, LoadRows, tip
from tudor_dynamics.payload.scale import find_scale, friction_terms, Scale, Source
from tudor_dynamics.payload.watched import smoothed, Watched
from tudor_dynamics.signals import Stretch
from tudor_dynamics.typing import FloatArray

TURNS = 4
"""Steps of Gauss and Newton of a model whose outputs are no straight line of the payload."""
STEP = 0.05
"""Difference of payloads by which such a model tells what a little more would do [kg]."""
UNTOLD = 0.25
"""Standard deviation of a mass, as a part of what weighs like the arm itself (or of the payloads
of the model), from which on a recording tells nothing of a load."""
LEAST = 1e-300
SURE = 2.0
"""Standard deviations from which on a load is one."""
WIDER = 2.0
"""A mass with a free place may be as many times as uncertain as one at the tip."""
LARGEST_ARM = 0.1
"""Standard deviation of a place along an axis from which on it is not told [m]."""
POSES = 200


def estimate_payload(
    arm: Arm,
    models: Mapping[str, Model],
    stretches: Sequence[Stretch],
    *,
    known: float = 0.0,
    errors: Mapping[str, float] | None = None,
    whole: bool = True,
    bent: BentLinks | None = None,
    watched: Sequence[Watched] = (),
) -> PayloadEstimate:
    """Estimate what the arm carries: known, errors [kg]."""
    of_all = any(model.payload_range is not None or model.has_memory for model in models.values())
    told = []
    for output in models:
        if any(getattr(stretch, output) is None for stretch in stretches) or not stretches:
            continue
        seen = _seen(output, models[output], stretches, bent, watched)
        found = (_by_model(arm, output, seen, known) if of_all else
                 _by_rows(arm, output, seen, whole=whole))
        error = (errors or {}).get(output, 0.0)
        told.append(replace(found, error=error * (
            1.0 if found.scale.factor.any() else found.reference)))
    if not told:
        msg = f'the recording has none of the outputs that the model predicts: {list(models)}'
        raise FitError(msg, remedy='record joint efforts or strains as for the fit')
    scaled = [item for item in told if item.scale.factor.any()]
    if not scaled:
        return _relative(arm, told, known)
    return _combined(arm, scaled, known)


@dataclass(frozen=True, eq=False)
class _Told:
    """What an output says: at the tip, and as a body where its rows are worth N m."""

    output: str
    scale: Scale
    point: Solution
    body: Solution | None
    reference: float
    error: float
    size: float
    bent: bool
    channels: tuple[str, ...]
    t: FloatArray

    @property
    def mass(self) -> float:
        """Mass at the tip beside what the model knows [kg]."""
        return float(self.point.parameters[0])

    @property
    def variance(self) -> float:
        """Of the mass at the tip, without that of the scale [kg^2]."""
        information = float(self.point.information[0, 0])
        return (1.0 / information if information > 0.0 else math.inf) + self.error ** 2

    def summary(self, worth: float = 1.0, *, at_tip: bool = True) -> OutputMass:
        size = max(self.size, 1e-300)
        taken = self.point if at_tip or self.body is None else self.body
        felt = np.flatnonzero(self.scale.factor) if len(self.channels) > 1 else np.arange(1)
        return OutputMass(
            self.output, worth * self.mass, worth * math.sqrt(self.variance),
            float(np.sqrt(np.mean(self.point.before ** 2))) / size,
            float(np.sqrt(np.mean(self.point.after ** 2))) / size, self.bent,
            Leftover(tuple(self.channels[place] for place in felt), self.t, taken.before[:, felt],
                     taken.after[:, felt]))


def _own(arm: Arm, output: str, motion: FloatArray, channels: int) -> list[FloatArray]:
    """Give what each channel may be off by on another day: its zero, and a joint's friction."""
    if output == 'strain':
        return [np.ones((len(motion), 1))] * channels
    n = len(arm.joints)
    return [friction_terms(motion[:, n + i], joint.friction_velocity)
            for i, joint in enumerate(arm.joints)]


def _size(measured: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.var(measured, axis=0))))


@dataclass(frozen=True, eq=False)
class _Seen:
    """A model of an output, and the recording beside it with a payload put in."""

    model: Model
    beside: Callable[[Model], Readings]
    bent: bool


def _seen(
    output: str, model: Model, stretches: Sequence[Stretch], bent: BentLinks | None,
    watched: Sequence[Watched],
) -> _Seen:
    """Choose the model that leaves the least over: that of links that bend."""
    if bent is not None and output == 'strain':
        smooth = smoothed(watched, bent.cutoff)
        if smooth:
            return _Seen(bent.model, lambda plain: bent_readings(bent, plain, smooth), True)
    return _Seen(model, lambda plain: readings(plain, stretches, output), False)


def _by_model(arm: Arm, output: str, seen: _Seen, known: float) -> _Told:
    """Let a model say what more payload would do: a line, or its tangent where it bends."""
    model = seen.model
    low, high = model.payload_range or (known, known + STEP)
    mass, step = low, high - low
    for _ in range(TURNS if model.has_memory else 1):
        here, more = seen.beside(model.at(mass)), seen.beside(model.at(mass + step))
        rows = (more.predicted - here.predicted) / step
        found = solve_load(here.measured - here.predicted, rows[:, :, None],
                           _own(arm, output, here.motion, rows.shape[1]), here.rate)
        total = mass + float(found.parameters[0])
        mass, step = max(total, 0.0), STEP  # where it is asked next; none is negative
    solution = Solution(np.array([total - known]), found.information, found.before, found.after)
    source = Source.ELASTIC if model.has_memory else Source.PAYLOADS
    reference = high - low if model.payload_range is not None else math.inf
    scale = Scale(np.ones(rows.shape[1]), 0.0, source)
    return _Told(output, scale, solution, None, reference, 0.0, _size(here.measured), seen.bent,
                 model.channels, here.t)


def _by_rows(arm: Arm, output: str, seen: _Seen, *, whole: bool) -> _Told:
    """Explain what a model of one payload leaves over by the rows of the last body."""
    model = seen.model
    here = seen.beside(model)
    scale = find_scale(arm, output, here.motion, here.predicted)
    rows = LoadRows(arm, output)
    left, own = here.measured - here.predicted, _own(arm, output, here.motion,
                                                     here.measured.shape[1])
    # what weighs as much as the arm itself, over all poses
    rng = np.random.default_rng(0)
    n = len(arm.joints)
    poses = np.hstack([rng.uniform(-math.pi, math.pi, (POSES, n)), np.zeros((POSES, 2 * n))])
    own_weight, load_weight = model.predict(poses).std(axis=0), rows.point(poses).std(axis=0)
    most = int(np.argmax(load_weight))
    worth = scale.factor[most] if scale.factor[most] else 1.0
    reference = float(own_weight[most] / max(float(load_weight[most] * abs(worth)), 1e-300))
    point, body, size = rows.point(here.motion), None, _size(here.measured)
    channels = model.channels
    if scale.factor.any():
        solution = solve_load(left, (point * scale.factor)[:, :, None], own, here.rate)
        if whole:
            body = solve_load(left, rows.rows(here.motion) * scale.factor[:, None], own,
                              here.rate)
    else:  # each channel is in a unit of its own: that which feels most
        one = slice(most, most + 1)
        solution = solve_load(left[:, one], point[:, one, None], own[one], here.rate)
        size, channels = _size(here.measured[:, one]), channels[one]
    return _Told(output, scale, solution, body, reference, 0.0, size, seen.bent, channels, here.t)


def _relative(arm: Arm, told: Sequence[_Told], known: float) -> PayloadEstimate:
    """Tell a load without a scale: each output in its own unit, as a part of the arm's moment."""
    weighty = [item for item in told if item.reference > 0.0] or list(told)
    best = min(weighty, key=lambda item: math.sqrt(item.variance) / max(item.reference, LEAST))
    value = _over(best.mass, best.reference)
    std = _over(math.sqrt(best.variance), best.reference)
    nothing = np.full(3, math.nan)
    return PayloadEstimate(
        _verdict(value, std, std, 1.0), math.nan, math.nan, known, nothing, nothing,
        np.full(6, math.nan), np.full(6, math.nan), carrier_frame(arm), True, Source.NOTHING,
        math.nan, value, std, tuple(item.summary(_over(1.0, item.reference)) for item in told))


def _verdict(value: float, std: float, plain_std: float, reference: float) -> Verdict:
    if not plain_std < UNTOLD * reference:
        return Verdict.UNKNOWN
    return Verdict.LOAD if abs(value) > SURE * std else Verdict.NONE


def _combined(arm: Arm, told: Sequence[_Told], known: float) -> PayloadEstimate:
    """Put the outputs together, each by its information; then the scale's own error."""
    weights = np.array([1.0 / item.variance for item in told])
    share = weights / weights.sum() if weights.any() else np.full(len(told), 1.0 / len(told))
    mass = float(sum(w * item.mass for w, item in zip(share, told, strict=True)))
    plain = math.sqrt(1.0 / weights.sum()) if weights.any() else math.inf
    best = told[int(np.argmax(weights))]
    relative = math.sqrt(float(sum((w * item.scale.relative) ** 2
                                   for w, item in zip(share, told, strict=True))))
    reference = min(item.reference for item in told)
    bodies = [item for item in told if item.body is not None]
    com, com_std = np.full(3, math.nan), np.full(3, math.nan)
    inertia, inertia_std = np.full(6, math.nan), np.full(6, math.nan)
    at_tip = True
    if bodies:
        length = max(float(np.linalg.norm(tip(arm))), 0.1)
        body = _body(bodies, mass, reference, length)
        # a load that does not sit at the tip is another mass there
        if body.mass_std < max(WIDER * plain, 0.05 * abs(body.mass)):
            mass, plain, at_tip = body.mass, max(body.mass_std, plain), False
            if mass > SURE * math.hypot(plain, relative * mass):
                com, com_std, inertia, inertia_std = body.places()
    std = math.hypot(plain, relative * mass)
    return PayloadEstimate(
        _verdict(mass, std, plain, reference), known + mass, std, known, com, com_std, inertia,
        inertia_std, carrier_frame(arm), at_tip, best.scale.source, relative,
        _over(mass, reference), _over(plain, reference),
        tuple(item.summary(at_tip=at_tip) for item in told))


def _over(value: float, reference: float) -> float:
    """Give a part of the arm's own moment; NaN where gravity asks nothing of the arm."""
    return value / reference if reference > 0.0 else math.nan


@dataclass(frozen=True, eq=False)
class _Body:
    """A body that can exist, with the covariance of its ten parameters."""

    parameters: FloatArray
    covariance: FloatArray

    @property
    def mass(self) -> float:
        return float(self.parameters[0])

    @property
    def mass_std(self) -> float:
        return math.sqrt(max(float(self.covariance[0, 0]), 0.0))

    def places(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Give centre and inertia with their standard deviations, NaN where they are not shown."""
        com = self.parameters[1:4] / self.mass
        slope = np.zeros((3, COUNT))
        slope[:, 0], slope[:, 1:4] = -com / self.mass, np.eye(3) / self.mass
        std = np.sqrt(np.maximum(np.diag(slope @ self.covariance @ slope.T), 0.0))
        unknown = std > LARGEST_ARM
        inertia, spread = self.parameters[4:], np.sqrt(np.diag(self.covariance)[4:])
        dark = SURE * spread > np.abs(inertia)
        return (np.where(unknown, math.nan, com), np.where(unknown, math.nan, std),
                np.where(dark, math.nan, inertia), np.where(dark, math.nan, spread))


def _body(told: Sequence[_Told], mass: float, reference: float, length: float) -> _Body:
    """Combine the bodies of outputs, and find the one that can exist."""
    information, right = np.zeros((COUNT, COUNT)), np.zeros(COUNT)
    for item in told:
        assert item.body is not None
        own = float(item.point.information[0, 0])
        # a model that is wrong by as much as it was before knows so much less
        part = item.body.information / (1.0 + item.error ** 2 * own)
        information += part
        right += part @ item.body.parameters
    # so far away that it decides nothing, so that what is not shown has a size at all
    heavy = 100.0 * max(reference, abs(mass))
    prior = np.array([heavy, *3 * [heavy * length], *6 * [heavy * length ** 2]])
    covariance = np.linalg.inv(information / np.outer(1.0 / prior, 1.0 / prior) + np.eye(COUNT))
    covariance = np.asarray(covariance * np.outer(prior, prior))
    free = covariance @ right
    sure = free[0] > SURE * math.sqrt(max(float(covariance[0, 0]), 0.0))
    return _Body(consistent(free, information, length) if sure else free,
                 np.asarray(covariance, dtype=float))
