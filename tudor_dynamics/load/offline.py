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

"""From models and recordings to what the arm carries, with honest errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
import math
from typing import Any

import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.errors import FitError
from tudor_dynamics.load.bending import BentLinks, links_of, smoothed, Watched
from tudor_dynamics.load.rows import (
    carrier_frame, consistent, COUNT, find_scale, friction_terms, LoadRows, Scale, Source, tip)
from tudor_dynamics.load.settings import (
    LARGEST_ARM, PASSES, POSES, STEP, SURE, TURNS, UNKNOWN_STD, WIDER, WINDOW)
from tudor_dynamics.models.base import Model
from tudor_dynamics.signals.preprocessing import Stretch
from tudor_dynamics.typing import FloatArray, Shown


# -- Least squares of a load on the residual of a model, with errors for residuals that are
#    coloured.
#
# Each channel has terms to itself (zero, another day's friction), which are projected out.
# Residuals of a model ring and drift: the covariance of the estimate is that of Newey and West ("A
# simple, positive semi-definite, heteroskedasticity and autocorrelation consistent covariance
# matrix", Econometrica 55(3), 1987) over a window that is longer than an oscillation.

FLAT = 1e-9  # part of a row's size below which it is nothing but rounding


@dataclass(frozen=True, eq=False)
class LoadFit:
    """Parameters of a load as one output shows them."""

    parameters: FloatArray  # (parameters,): least squares; directions that are not shown are zero
    information: FloatArray  # inverse covariance, singular where nothing is shown
    # (samples, channels): residual without and with the load, each channel's own terms
    # left out, in its unit.
    before: FloatArray
    after: FloatArray


def solve_load(
    residual: FloatArray, rows: FloatArray, own: Sequence[FloatArray], rate: float,
) -> LoadFit:
    """Explain a residual (samples, channels) by a load, with each channel's own columns."""
    count = residual.shape[1]
    free, left = np.empty_like(rows), np.empty_like(residual)
    for i in range(count):
        basis = np.linalg.qr(own[i])[0]
        free[:, i] = rows[:, i] - basis @ (basis.T @ rows[:, i])
        left[:, i] = residual[:, i] - basis @ (basis.T @ residual[:, i])
    size = np.linalg.norm(rows, axis=(0, 1))
    # a row that its own terms take up leaves rounding, which is no information
    free[:, :, np.linalg.norm(free, axis=(0, 1)) <= FLAT * size] = 0.0
    scale = np.where(size > 0.0, size, 1.0)
    free = free / scale
    before = left.std(axis=0)
    alive = before > 0.0
    deviation = before.copy()
    parameters: FloatArray = np.zeros(rows.shape[2])
    for _ in range(PASSES):
        weight = np.where(alive, 1.0 / np.where(alive, deviation, 1.0), 0.0)
        x = (free * weight[:, None]).reshape(-1, rows.shape[2])
        parameters = np.asarray(np.linalg.lstsq(x, (left * weight).reshape(-1), rcond=1e-8)[0])
        error = left - free @ parameters
        deviation = np.maximum(error.std(axis=0), 1e-9 * before)
    scores = np.einsum('kcp,kc->kp', free * weight[:, None] ** 2, error)
    gram = x.T @ x
    window = min(round(WINDOW * rate), len(scores) // 4)
    # a window that is a part of the recording has an error of its own: two standard deviations
    # are those of Kiefer and Vogelsang, "A new asymptotic theory for heteroskedasticity-
    # autocorrelation robust tests", Econometric Theory 21(6), 2005, Table 1, Bartlett's kernel
    share = window / len(scores)
    wider = 1.0 + (2.9694 * share + 0.4160 * share ** 2 - 0.5324 * share ** 3) / 1.96
    spread = scores.T @ scores
    for lag in range(1, window + 1):  # covariances, with weights that fall linearly
        part = scores[lag:].T @ scores[:-lag]
        spread += (1.0 - lag / (window + 1.0)) * (part + part.T)
    spread = spread * wider ** 2
    # of a load as of the noise: a spread that a short recording shows by chance is no less
    spread = spread + FLAT * np.trace(spread) * np.eye(len(spread))
    information = gram @ np.linalg.pinv(spread, rcond=1e-12, hermitian=True) @ gram
    return LoadFit(parameters / scale, information * np.outer(scale, scale), left, error)


# -- What became known of a load, with its standard deviations

class Presence(Enum):
    """Whether there is a load."""

    LOAD = 'load'
    NONE = 'no load'
    UNKNOWN = 'no information'


@dataclass(frozen=True, eq=False)
class Leftover:
    """Residual of an output, each channel's own zero and friction left out."""

    channels: tuple[str, ...]  # joints or gauges; without those of unknown scale
    t: FloatArray  # since the beginning of the recording, (samples,) [s]
    # Without and with the load, in units of the channels, (samples, channels).
    before: FloatArray
    after: FloatArray

    def sizes(self) -> tuple[FloatArray, FloatArray]:
        """Give root mean squares by channel, without and with the load."""
        return (np.asarray(np.sqrt(np.mean(self.before ** 2, axis=0))),
                np.asarray(np.sqrt(np.mean(self.after ** 2, axis=0))))

    def shares(self) -> FloatArray:
        """Give the part of each channel's squares that the load explains, from 0 to 1."""
        before, after = self.sizes()
        return np.asarray(np.maximum(1.0 - (after / np.maximum(before, 1e-300)) ** 2, 0.0))


@dataclass(frozen=True, eq=False)
class OutputMass:
    """Mass at the tip as one output shows it."""

    output: str  # output that was read
    # In addition to what the model knows, with its standard deviation without that of the scale
    # [kg]; without a scale as a part of the arm's own moment.
    mass: float
    std: float
    # Relative residual without and with the load.
    before: float
    after: float
    bent: bool  # whether it is estimated by where links are that bend
    leftover: Leftover  # the same by sample, with the load at the tip or as a body


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class PayloadEstimate(Shown):
    """What the arm carries."""

    verdict: Presence  # whether there is a load; `UNKNOWN` where the recording does not show
    # In all, with what the model knows of [kg]; NaN without a scale.
    mass: float = math.nan
    mass_std: float = math.nan
    known: float  # part of it that the model knows of [kg]
    # (3,): centre of the mass in `frame` [m]; NaN where it is not shown.
    com: FloatArray = field(default_factory=lambda: np.full(3, math.nan))
    com_std: FloatArray = field(default_factory=lambda: np.full(3, math.nan))
    # (6,): xx, xy, yy, xz, yz, zz about the origin of `frame` [kg m^2]; NaN where it is not shown.
    inertia: FloatArray = field(default_factory=lambda: np.full(6, math.nan))
    inertia_std: FloatArray = field(default_factory=lambda: np.full(6, math.nan))
    frame: str  # frame that turns with the last joint
    at_tip: bool = True  # assumed, where motion does not show its place
    tip: FloatArray  # (3,): place of the tip in `frame` [m]
    source: Source  # where kilograms come from
    scale_std: float = math.nan  # relative, of the scale; `mass_std` has it in it
    # Moment of the load over that of the arm itself, both held out horizontally by its last
    # joints; for loads without a scale.
    relative: float
    relative_std: float
    outputs: tuple[OutputMass, ...]  # what each output says by itself

    def as_dict(self) -> dict[str, Any]:
        """Give it as plain values; None for what is not known."""
        def plain(value: Any) -> Any:
            if isinstance(value, np.ndarray):
                return [plain(item) for item in value.tolist()]
            return float(f'{value:.6g}') if math.isfinite(value) else None

        def plains(item: Any, *names: str) -> dict[str, Any]:
            return {name: plain(getattr(item, name)) for name in names}
        return {
            'verdict': self.verdict.value,
            **plains(self, 'mass', 'mass_std', 'known', 'com', 'com_std', 'inertia',
                     'inertia_std'),
            'frame': self.frame, 'at_tip': self.at_tip, 'scale': self.source.name.lower(),
            **plains(self, 'scale_std', 'relative', 'relative_std'),
            'outputs': {item.output: {
                **plains(item, 'mass', 'std', 'before', 'after'), 'bent_links': item.bent,
                'channels': {
                    name: {'before': plain(before), 'after': plain(after), 'share': plain(share)}
                    for name, before, after, share in zip(
                        item.leftover.channels, *item.leftover.sizes(), item.leftover.shares(),
                        strict=True)}} for item in self.outputs}}

    @property
    def sentence(self) -> str:
        """Say it in one sentence."""
        if self.verdict is Presence.UNKNOWN:
            return ('no information: in these poses and motions a load hardly changes what is '
                    'measured; move the links away from the vertical')
        if self.source is Source.NOTHING:
            share = f'{100 * self.relative:.1f} +- {100 * self.relative_std:.1f} % of the moment'
            return (f'{self.verdict.value}: {share} that the arm itself makes; kilograms need '
                    'effort.torque_constant, sensors[].gain, or a model of two known loads')
        place = ''
        if self.verdict is Presence.LOAD:
            known = [f'{axis} {1000 * value:.0f} +- {1000 * std:.2g} mm' for axis, value, std in
                     zip('xyz', self.com, self.com_std, strict=True) if math.isfinite(value)]
            tip = ', '.join(f'{axis} {1000 * value:.0f} mm' for axis, value in zip(
                'xyz', self.tip, strict=True))
            place = (f', centre at {", ".join(known)} in the frame of {self.frame}' if known else
                     ', its centre not shown by this motion')
            if self.at_tip:
                place += (': mounted as the loads of the model were taken to be'
                          if self.source is Source.PAYLOADS else
                          f': taken to sit at the tip, {tip} in the frame of {self.frame}')
        return (f'{self.verdict.value}: {self.mass:.4g} +- {self.mass_std:.2g} kg{place}; '
                f'the kilograms rest on {self.source.value}')


# -- A recording next to a model

@dataclass(frozen=True, eq=False)
class Readings:
    """An output of a recording next to what a model predicts."""

    motion: FloatArray  # of the samples
    # (samples, channels): in units of the output; predicted as if nothing were carried beyond what
    # the model knows.
    measured: FloatArray
    predicted: FloatArray
    rate: float  # samples a second [Hz]
    t: FloatArray  # since the beginning of the recording, (samples,) [s]
    own: list[FloatArray]  # per channel: zero and friction, which differ from day to day

    def solve(self, rows: FloatArray, used: slice = slice(None)) -> LoadFit:
        """Explain what was not predicted, in the channels that are used, by a load."""
        return solve_load((self.measured - self.predicted)[:, used], rows[:, used],
                          self.own[used], self.rate)


class RecordedOutput:
    """An output of a recording, and its model: of strain by the links that bend, where known."""

    def __init__(
        self, arm: Arm, output: str, model: Model, stretches: Sequence[Stretch],
        bent: BentLinks | None, watched: Sequence[Watched],
    ) -> None:
        self.arm, self.output, self._stretches = arm, output, stretches
        self._smooth = [] if bent is None or output != 'strain' else smoothed(watched, bent.cutoff)
        self.links = bent if self._smooth else None
        self.model = model if self.links is None else self.links.model

    def readings(self, model: Model) -> Readings:
        """Put the recording next to the model, or the model with a payload put in."""
        if self.links is not None:
            smooth, bending = self._smooth, self.links.bending
            motion = np.vstack([links_of(item.states, bending) for item in smooth])
            t = np.concatenate([item.t for item in smooth])
            measured = np.vstack([item.strain for item in smooth])
            predicted = model.predict(motion)
            rate = 1.0 / float(np.median([item.step for item in smooth]))
        else:
            pieces = [(s.t[s.decimation.keep], s.motion[s.decimation.keep],
                       s.decimation(getattr(s, self.output)), model.follow_kept(s))
                      for s in self._stretches]
            t, motion, measured, predicted = (
                np.concatenate(column) for column in zip(*pieces, strict=True))
            seconds = sum(float(s.t[-1] - s.t[0]) for s in self._stretches)
            rate = len(motion) / max(seconds, 1e-9)
        n = len(self.arm.joints)
        own = ([np.ones((len(motion), 1))] * measured.shape[1] if self.output == 'strain' else
               [friction_terms(motion[:, n + i], joint.friction_velocity)
                for i, joint in enumerate(self.arm.joints)])
        return Readings(motion, measured, predicted, rate, t, own)


# -- From models and filtered recordings to what the arm carries

LEAST = 1e-300


def estimate_payload(
    arm: Arm, models: Mapping[str, Model], stretches: Sequence[Stretch], *, known: float = 0.0,
    errors: Mapping[str, float] | None = None, whole: bool = True, bent: BentLinks | None = None,
    watched: Sequence[Watched] = (),
) -> PayloadEstimate:
    """Estimate what the arm carries: known, errors [kg]."""
    of_all = any(model.payload_range is not None or model.has_memory for model in models.values())
    found = []
    for output in models:
        if any(getattr(stretch, output) is None for stretch in stretches) or not stretches:
            continue
        source = RecordedOutput(arm, output, models[output], stretches, bent, watched)
        error = (errors or {}).get(output, 0.0)
        found.append(_by_model(source, known, error) if of_all else
                     _by_rows(source, error, whole=whole))
    if not found:
        msg = f'the recording has none of the outputs that the model predicts: {", ".join(models)}'
        raise FitError(msg, remedy='record the efforts or strains that the fit used')
    scaled = [item for item in found if item.scaled]
    return _combined(arm, scaled, known) if scaled else _relative(arm, found, known)


@dataclass(frozen=True, eq=False)
class _OutputLoad:
    """What an output says: at the tip, and as a body where its rows have a scale."""

    source: RecordedOutput
    here: Readings
    scale: Scale
    point: LoadFit
    reference: float
    model_error: float  # standard deviation by the model's own error [kg]
    used: slice  # channels
    body: LoadFit | None = None

    @property
    def scaled(self) -> bool:
        return bool(self.scale.factor.any())

    @property
    def error(self) -> float:
        return self.model_error * (1.0 if self.scaled else self.reference)

    @property
    def mass(self) -> float:
        """Mass at the tip in addition to what the model knows [kg]."""
        return float(self.point.parameters[0])

    @property
    def variance(self) -> float:
        """Of the mass at the tip, without that of the scale [kg^2]."""
        information = float(self.point.information[0, 0])
        return (1.0 / information if information > 0.0 else math.inf) + self.error ** 2

    def summary(self, unit: float = 1.0, *, at_tip: bool = True) -> OutputMass:
        spread = np.var(self.here.measured[:, self.used], axis=0)
        size = max(float(np.sqrt(np.mean(spread))), LEAST)
        channels = self.source.model.channels[self.used]
        taken = self.point if at_tip or self.body is None else self.body
        shown = np.flatnonzero(self.scale.factor) if len(channels) > 1 else np.arange(1)
        return OutputMass(
            self.source.output, unit * self.mass, unit * math.sqrt(self.variance),
            float(np.sqrt(np.mean(self.point.before ** 2))) / size,
            float(np.sqrt(np.mean(self.point.after ** 2))) / size, self.source.links is not None,
            Leftover(tuple(channels[place] for place in shown), self.here.t,
                     taken.before[:, shown], taken.after[:, shown]))


def _by_model(source: RecordedOutput, known: float, error: float) -> _OutputLoad:
    """Let a model say what more payload would do: a line, or its tangent where it bends."""
    model = source.model
    low, high = model.payload_range or (known, known + STEP)
    mass, step = low, high - low
    for _ in range(TURNS if model.has_memory else 1):
        here, more = source.readings(model.at(mass)), source.readings(model.at(mass + step))
        rows = (more.predicted - here.predicted) / step
        found = here.solve(rows[:, :, None])
        total = mass + float(found.parameters[0])
        mass, step = max(total, 0.0), STEP  # where it is asked next; none is negative
    solution = LoadFit(np.array([total - known]), found.information, found.before, found.after)
    reference = high - low if model.payload_range is not None else math.inf
    scale = Scale(np.ones(rows.shape[1]), 0.0,
                  Source.ELASTIC if model.has_memory else Source.PAYLOADS)
    return _OutputLoad(source, here, scale, solution, reference, error, slice(None))


def _by_rows(source: RecordedOutput, error: float, *, whole: bool) -> _OutputLoad:
    """Explain the residual of a model of one payload by the rows of the last body."""
    arm, model = source.arm, source.model
    here = source.readings(model)
    scale = find_scale(arm, source.output, here.motion, here.predicted)
    rows = LoadRows(arm, source.output)
    # what weighs as much as the arm itself, over all poses
    rng = np.random.default_rng(0)
    n = len(arm.joints)
    poses = np.hstack([rng.uniform(-math.pi, math.pi, (POSES, n)), np.zeros((POSES, 2 * n))])
    own_weight, load_weight = model.predict(poses).std(axis=0), rows.point(poses).std(axis=0)
    most = int(np.argmax(load_weight))
    unit = scale.factor[most] if scale.factor[most] else 1.0
    reference = float(own_weight[most] / max(float(load_weight[most] * abs(unit)), LEAST))
    point, body = rows.point(here.motion), None
    used = slice(None)
    if scale.factor.any():
        solution = here.solve((point * scale.factor)[:, :, None])
        if whole:
            body = here.solve(rows.rows(here.motion) * scale.factor[:, None])
    else:  # each channel is in a unit of its own: that on which a load acts most
        used = slice(most, most + 1)
        solution = here.solve(point[:, :, None], used)
    return _OutputLoad(source, here, scale, solution, reference, error, used, body)


def _relative(arm: Arm, loads: Sequence[_OutputLoad], known: float) -> PayloadEstimate:
    """Estimate a load without a scale, as a part of the arm's moment."""
    weighty = [item for item in loads if item.reference > 0.0] or list(loads)
    best = min(weighty, key=lambda item: math.sqrt(item.variance) / max(item.reference, LEAST))
    value = _over(best.mass, best.reference)
    std = _over(math.sqrt(best.variance), best.reference)
    return PayloadEstimate(
        verdict=_verdict(value, std, std, 1.0), known=known, frame=carrier_frame(arm),
        tip=tip(arm), source=Source.NOTHING, relative=value, relative_std=std,
        outputs=tuple(item.summary(_over(1.0, item.reference)) for item in loads))


def _verdict(value: float, std: float, plain_std: float, reference: float) -> Presence:
    if not plain_std < UNKNOWN_STD * reference:
        return Presence.UNKNOWN
    return Presence.LOAD if abs(value) > SURE * std else Presence.NONE


def _combined(arm: Arm, loads: Sequence[_OutputLoad], known: float) -> PayloadEstimate:
    """Put the outputs together, each by its information; then the scale's own error."""
    weights = np.array([1.0 / item.variance for item in loads])
    share = weights / weights.sum() if weights.any() else np.full(len(loads), 1.0 / len(loads))
    mass = float(sum(w * item.mass for w, item in zip(share, loads, strict=True)))
    plain = math.sqrt(1.0 / weights.sum()) if weights.any() else math.inf
    best = loads[int(np.argmax(weights))]
    relative = math.sqrt(float(sum((w * item.scale.relative) ** 2
                                   for w, item in zip(share, loads, strict=True))))
    reference = min(item.reference for item in loads)
    bodies = [item for item in loads if item.body is not None]
    places: dict[str, FloatArray] = {}
    at_tip = True
    if bodies:
        length = max(float(np.linalg.norm(tip(arm))), 0.1)
        body, covariance = _body(bodies, mass, reference, length)
        body_std = math.sqrt(max(float(covariance[0, 0]), 0.0))
        # a load that does not sit at the tip is another mass there
        if body_std < max(WIDER * plain, 0.05 * abs(float(body[0]))):
            mass, plain, at_tip = float(body[0]), max(body_std, plain), False
            if mass > SURE * math.hypot(plain, relative * mass):
                places = _places(body, covariance)
    std = math.hypot(plain, relative * mass)
    return PayloadEstimate(
        verdict=_verdict(mass, std, plain, reference), mass=known + mass, mass_std=std,
        known=known, frame=carrier_frame(arm), at_tip=at_tip, tip=tip(arm),
        source=best.scale.source,
        scale_std=relative, relative=_over(mass, reference), relative_std=_over(plain, reference),
        outputs=tuple(item.summary(at_tip=at_tip) for item in loads), **places)


def _over(value: float, reference: float) -> float:
    """Give a part of the arm's own moment; NaN where gravity asks nothing of the arm."""
    return value / reference if reference > 0.0 else math.nan


def _places(body: FloatArray, covariance: FloatArray) -> dict[str, FloatArray]:
    """Give centre and inertia with their standard deviations, NaN where they are not shown."""
    com = body[1:4] / body[0]
    slope = np.column_stack([-com, np.eye(3), np.zeros((3, 6))]) / body[0]
    std = np.sqrt(np.maximum(np.diag(slope @ covariance @ slope.T), 0.0))
    unknown = std > LARGEST_ARM
    inertia, spread = body[4:], np.sqrt(np.diag(covariance)[4:])
    dark = SURE * spread > np.abs(inertia)
    return {'com': np.where(unknown, math.nan, com),
            'com_std': np.where(unknown, math.nan, std),
            'inertia': np.where(dark, math.nan, inertia),
            'inertia_std': np.where(dark, math.nan, spread)}


def _body(
    loads: Sequence[_OutputLoad], mass: float, reference: float, length: float,
) -> tuple[FloatArray, FloatArray]:
    """Combine the bodies of outputs: parameters (10,) of one that can exist, their covariance."""
    information, right = np.zeros((COUNT, COUNT)), np.zeros(COUNT)
    for item in loads:
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
    return (consistent(free, information, length) if sure else free,
            np.asarray(covariance, dtype=float))
