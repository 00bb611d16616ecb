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

"""Thresholds learned from free motion, offline or while the robot runs; as plain values."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
import math
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator, ValidationInfo

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.errors import FitError, ModelError
from tudor_dynamics.models.base import BundlePart, read, Text
from tudor_dynamics.online.detector import levels
from tudor_dynamics.online.settings import (
    BLOCK, CALIBRATION_SAMPLES, CALIBRATION_STRIDE, FRICTION_UNCERTAIN, GROUP, LAGS, LARGEST_SHAPE,
    LARGEST_TAIL_SHARE, LEAST_BLOCKS, LEAST_SCALES, LEAST_SHOWN, LEVEL_QUANTILE, MOST_MOTIONS,
    PROFILE_FLOOR, PROFILE_QUANTILE, PROFILE_ROWS, REVERSAL_SPEED, SHAPE_ERROR, SHAPE_ERRORS, STEP,
    TAIL_PEAKS, TAIL_SHARE, USUAL_SHARE, WINDOW)
from tudor_dynamics.online.streams import Residual
from tudor_dynamics.online.thresholds import (
    accumulate, held_friction, learn_taps, MethodThresholds, motion_features, onset_statistic,
    Positive, released, Tail)
from tudor_dynamics.typing import FloatArray


DIGITS = 10  # digits of the numbers in a bundle
Number = Annotated[float, Field(allow_inf_nan=False)]
Size = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Matrix = tuple[tuple[Number, ...], ...]


class ThresholdsPart(BundlePart):
    """Thresholds of one method, of an arm whose channels and joints come as context."""

    channels: tuple[Text, ...]  # joints or gauges
    seconds: float  # of free motion that they were learned from
    step: Positive  # between samples of the autoregression [s]
    taps: tuple[Matrix, ...]  # of the autoregression
    profile: tuple[tuple[Size, ...], ...]  # usual size of a statistic by the motion
    tails: tuple[Tail, ...]  # how rarely a ratio is exceeded
    usual: tuple[Positive, ...]  # usual level of the onset statistics
    reach: tuple[Positive, ...]  # largest speeds of the training [rad/s or m/s]
    stiction: tuple[Size, ...]  # what friction may hold at standstill

    @model_validator(mode='after')
    def _fits(self, info: ValidationInfo) -> ThresholdsPart:
        context = info.context or {}
        channels, joints = context['channels'], context['n_joints']
        n = len(channels)
        if self.channels != channels:
            raise ValueError(f'channels are {list(self.channels)}; the arm has {list(channels)}')
        for name, value, shape in (
                ('taps', self.taps, (LAGS + WINDOW, n, n)),
                ('profile', self.profile, (2 * n, 1 + 4 * joints)), ('usual', self.usual, (n,)),
                ('reach', self.reach, (joints,)), ('stiction', self.stiction, (n,))):
            if np.shape(value) != shape:
                raise ValueError(f'{name} has the shape {np.shape(value)}; expected {shape}')
        if len(self.tails) != 3 * n:
            raise ValueError(f'tails has {len(self.tails)} entries; expected {3 * n}, 3 a channel')
        if any(row[0] == 0.0 for row in self.profile):
            raise ValueError('profile begins with 0 in some row; expected more than 0')
        if n != joints and any(self.stiction):
            raise ValueError('stiction must be 0 for channels that are gauges')
        return self


def thresholds_to_dict(thresholds: MethodThresholds) -> dict[str, Any]:
    """Make plain values of the thresholds of a method: YAML-ready, numbers of ten digits."""
    def short(x: Any) -> Any:
        return [short(item) for item in x] if isinstance(x, list) else float(f'{x:.{DIGITS}g}')

    return {
        'channels': list(thresholds.channels), 'seconds': round(thresholds.seconds, 3),
        'step': short(thresholds.step),
        'tails': [{key: short(value) for key, value in asdict(tail).items()}
                  for tail in thresholds.tails],
        **{key: short(getattr(thresholds, key).tolist())
           for key in ('taps', 'profile', 'usual', 'reach', 'stiction')}}


def thresholds_from_dict(
    content: Any, channels: tuple[str, ...], n_joints: int,
) -> MethodThresholds:
    """Read thresholds of an arm with these channels and so many joints."""
    try:
        part = read(ThresholdsPart, content, {'channels': channels, 'n_joints': n_joints})
    except ModelError as err:
        raise err.at('model.yaml, key facts.thresholds') from None
    return MethodThresholds(
        channels, part.step, np.array(part.taps), np.array(part.profile), part.tails, part.seconds,
        np.array(part.usual), np.array(part.reach), np.array(part.stiction))


def stored_thresholds(stored: Any, arm: Arm, kind: str) -> dict[str, MethodThresholds]:
    """Give what `thresholds_to_dict` made, for one kind of model, by methods that have some."""
    found: dict[str, MethodThresholds] = {}
    for method, channels in (('strain', arm.gauge_names), ('effort', arm.active_joints),
                             ('momentum', arm.active_joints)):
        kinds = stored.get(method) if isinstance(stored, dict) else None
        own = 'analytical' if method == 'momentum' else kind
        if isinstance(kinds, dict) and own in kinds:
            found[method] = thresholds_from_dict(kinds[own], channels, len(arm.active_joints))
    return found


@dataclass(frozen=True, eq=False)
class FreeMotion:
    """A gapless stretch of residuals while nothing touched the arm."""

    stamp: NDArray[np.int64]  # header stamps, (samples,) [ns]
    motion: FloatArray  # of the samples
    residual: FloatArray  # of a model that was not fitted to these samples
    motion_of: str = ''  # bag, or part of one: what belongs to one motion, day and load

    @property
    def t(self) -> FloatArray:
        """Time since the first sample [s]."""
        return np.asarray((self.stamp - self.stamp[0]) * 1e-9)

    def halves(self) -> tuple[FreeMotion, FreeMotion]:
        """Give the first and the second half."""
        middle = len(self.stamp) // 2
        first, second = (replace(self, stamp=self.stamp[part], motion=self.motion[part],
                                 residual=self.residual[part])
                         for part in (slice(middle), slice(middle, None)))
        return first, second


def learn_thresholds(
    records: Sequence[FreeMotion], channels: tuple[str, ...], stiction: FloatArray | None = None,
) -> MethodThresholds:
    """Learn the thresholds of one method: stiction (channels,) [unit of the residual]."""
    if not records:
        raise FitError('no motion to learn thresholds from; let the arm move without contact')
    period = float(np.median(np.concatenate([np.diff(r.t) for r in records])))
    step = max(STEP, period)
    block = max(1, round(BLOCK / period))
    # each half has a block to be judged by after its past is complete, in time and in samples
    least = 2.0 * ((LAGS + WINDOW) * step + BLOCK)
    records = [r for r in records if min(r.t[-1], (len(r.t) - 1) * period) > least]
    seconds = float(sum(r.t[-1] for r in records))
    if seconds < LEAST_BLOCKS * BLOCK:
        raise FitError(f'{seconds:.1f} s of motion are too little for thresholds; move the arm '
                       f'for {LEAST_BLOCKS * BLOCK:g} s or more without contact or lost messages')
    stiction = np.zeros(len(channels)) if stiction is None else stiction
    rows = _Rows(records, step, period, stiction)
    taps, profile = rows.law()
    halves = [list(part) for part in zip(*(r.halves() for r in records), strict=True)]
    laws, *left_out = [[
        (_Rows(left, step, period, stiction), _Rows(
            [r for other in parts if other is not left for r in other], step, period,
            stiction).law(profile)) for left in parts]
        for parts in (halves, _motions(records)) if parts]
    # Ratios to a profile that was not learned from them: others are too small. Nor from their
    # motion, where there are several: days and kinds of motion differ by more than halves do.
    ratios, *others = [np.vstack([judged.ratios(*law, block) for judged, law in some])
                       for some in (laws, *left_out)]
    usual = np.quantile(np.vstack([judged.levels(*law) for judged, law in laws]), USUAL_SHARE,
                        axis=0)
    n, alive = len(channels), rows.noise() > 0.0
    tails = []
    for place in range(3 * n):
        least = LEAST_SCALES[place // n] if alive[place % n] else 0.0
        some = (ratios, *others) if place < 2 * n else (ratios,)  # sums fall back within seconds
        tails.append(max((_tail(item[:, place], least) for item in some),
                         key=lambda tail: tail.ratio(1.0)))
    return MethodThresholds(channels, step, taps, profile, tuple(tails), seconds,
                            np.asarray(usual), rows.reach(), stiction)


def _motions(records: Sequence[FreeMotion]) -> list[list[FreeMotion]]:
    """Sort records by motion, in a few groups that are left out in turn; none of one motion."""
    names = list(dict.fromkeys(r.motion_of for r in records))
    return [[r for r in records if names.index(r.motion_of) % MOST_MOTIONS == place]
            for place in range(min(len(names), MOST_MOTIONS))] if len(names) > 1 else []


class _Rows:
    """What is learned from: residuals with the columns of their motion."""

    def __init__(
        self, records: Sequence[FreeMotion], step: float, period: float, stiction: FloatArray,
    ) -> None:
        self._step, self._group = step, max(1, round(GROUP / period))
        self._records, n = [], len(stiction)
        for r in records:
            held = (held_friction(stiction, np.abs(r.motion[:, n:2 * n])) if stiction.any()
                    else np.zeros_like(r.residual))
            self._records.append((r.t, r.residual, held, released(r.t, r.residual, held),
                                  motion_features(r.stamp, r.motion)))

    def _judged(self, taps: FloatArray) -> Iterator[tuple[FloatArray, ...]]:
        """Go through the records: dt, residuals, held friction, columns, sizes."""
        for t, residual, held, free, columns in self._records:
            onset = onset_statistic(t, free, taps, self._step)  # 0 until its past is complete
            sizes = np.hstack([np.maximum(np.abs(residual) - held, 0.0), np.abs(onset)])
            yield np.diff(t, prepend=t[0]), residual, held, columns, sizes

    def law(self, fallback: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Learn taps and profile; rows in which friction covers nearly all are the fallback's."""
        taps = learn_taps([(t, free) for t, _, _, free, _ in self._records], self._step)
        judged = [(_largest(columns, self._group), _largest(sizes, self._group))
                  for _, _, _, columns, sizes in self._judged(taps)]
        columns, peaks = (np.vstack(parts) for parts in zip(*judged, strict=True))
        least = np.concatenate([self.noise(), np.zeros(taps.shape[1])])
        return taps, np.array([
            fallback[i] if fallback is not None and np.count_nonzero(peak) < LEAST_SHOWN
            else _profile(columns, peak, least[i]) for i, peak in enumerate(peaks.T)])

    def ratios(self, taps: FloatArray, profile: FloatArray, block: int) -> FloatArray:
        """Give the largest ratio to a profile in each block, and the largest sums of onsets."""
        parts, n = [], taps.shape[1]
        for dt, residual, held, columns, sizes in self._judged(taps):
            usual = columns @ profile.T
            scale = usual[:, :n] + FRICTION_UNCERTAIN * held
            sums = accumulate(dt, np.sign(residual) * sizes[:, :n] / scale)
            parts.append(_largest(np.hstack([sizes / usual, sums]), block))
        return np.vstack(parts)

    def levels(self, taps: FloatArray, profile: FloatArray) -> FloatArray:
        """Give the level of the onset statistics at each sample, as ratios to a profile."""
        found = []
        for dt, _, _, columns, sizes in self._judged(taps):
            ratio = (sizes / (columns @ profile.T))[:, taps.shape[1]:]
            found.append(levels(dt, ratio, np.quantile(ratio, LEVEL_QUANTILE, axis=0)))
        return np.vstack(found)

    def reach(self) -> FloatArray:
        """Give the largest speed of each joint; one that stood still moves from there on."""
        columns = np.vstack([columns for *_, columns in self._records])
        speeds = columns[:, 1:1 + (columns.shape[1] - 1) // 4]
        return np.asarray(np.maximum(speeds.max(axis=0), REVERSAL_SPEED))

    def noise(self) -> FloatArray:
        """Give the size of what changes from sample to sample, for each residual."""
        changes = np.vstack([np.diff(residual, axis=0) for _, residual, *_ in self._records])
        return np.asarray(np.sqrt(0.5 * np.mean(changes ** 2, axis=0)))


def _largest(x: FloatArray, count: int) -> FloatArray:
    """Take the largest of each ``count`` rows."""
    whole = len(x) // count * count
    return np.asarray(x[:whole].reshape(-1, count, x.shape[1]).max(axis=1))


def _profile(columns: FloatArray, peaks: FloatArray, least: float) -> FloatArray:
    """Fit a quantile of the peaks by non-negative columns, as a linear program."""
    stride = -(-len(peaks) // PROFILE_ROWS)
    columns, peaks = columns[::stride], peaks[::stride]
    largest, shown = np.maximum(columns.max(axis=0), 1e-12), peaks > 0.0
    unit = float(np.median(peaks[shown])) if shown.any() else max(least, 1e-300)
    # Friction that holds covers a joint at rest. However long the arm stood, what it covers weighs
    # no more than all others: otherwise the profile is 0, and the tail has to do it all.
    weight = np.where(shown, 1.0, min(1.0, shown.sum() / max(1, (~shown).sum())) or 1.0)
    from scipy import optimize  # slow to import

    # the dual has a constraint a column, not one a row: 7 to 9 times as fast
    found = optimize.linprog(
        -peaks / unit, A_ub=(columns / largest).T, b_ub=np.zeros(columns.shape[1]),
        bounds=np.outer(weight, (PROFILE_QUANTILE - 1.0, PROFILE_QUANTILE)), method='highs')
    if not found.success:
        raise FitError(f'thresholds cannot be fitted ({found.message}); record more motion')
    profile = np.maximum(-found.ineqlin.marginals, 0.0) * unit / largest
    # without a floor, standstill in the data would make the slightest noise a collision
    profile[0] = max(profile[0], PROFILE_FLOOR * unit)
    return np.asarray(profile)


def _tail(peaks: FloatArray, least: float) -> Tail:
    """Fit a generalised Pareto distribution to the highest peaks by L-moments (Hosking, 1987)."""
    # A bound is believed as far as the peaks prove it: two standard errors below the estimate. The
    # scale is at least what is given: friction may cover a joint that stands, and sums may stay at
    # zero, which is no reason to be alarmed by the next touch of noise.
    share = max(TAIL_SHARE, min(TAIL_PEAKS / len(peaks), LARGEST_TAIL_SHARE))
    location = max(float(np.quantile(peaks, 1.0 - share)), 1e-6)
    above = np.sort(peaks[peaks > location] - location)
    n = len(above)
    largest = float(peaks.max())
    if n < 3 or above[-1] <= 0.0:
        return Tail(location, least, 0.0, share, max(largest, location), max(n, 3))
    first = float(above.mean())
    second = 2.0 * float((np.arange(n) / (n - 1) * above).mean()) - first
    shape = first / second - 2.0 - SHAPE_ERRORS * SHAPE_ERROR / math.sqrt(n)
    shape = min(max(shape, 0.0), LARGEST_SHAPE)
    return Tail(location, max(first * (1.0 + shape), least), shape, share, largest, n)


class Calibration:
    """Collects free motion for a while: seconds [s]."""

    def __init__(
        self, channels: dict[str, tuple[str, ...]], seconds: float,
        stiction: Callable[[str, FloatArray], FloatArray] | None = None,
    ) -> None:
        self.channels = channels
        self.stiction = stiction
        self.seconds = seconds
        self._parts: dict[str, list[list[Residual]]] = {name: [] for name in channels}
        self._collected = dict.fromkeys(channels, 0.0)
        self._count = 0

    def add(self, method: str, residual: Residual) -> None:
        """Collect one residual."""
        parts = self._parts[method]
        motion = residual.motion
        last = parts[-1][-1].motion.stamp if parts else 0
        dt = (motion.stamp - last) * 1e-9
        if not parts or not 0.0 < dt <= max(5.0 * motion.dt, 0.02):
            parts.append([])
        else:
            self._collected[method] += dt
        parts[-1].append(residual)
        self._count += 1

    @property
    def done(self) -> bool:
        """Say whether every method has enough."""
        return (self._count > CALIBRATION_SAMPLES
                or min(self._collected.values(), default=0.0) >= self.seconds)

    def learn(self) -> dict[str, MethodThresholds]:
        """Learn the thresholds."""
        found = {}
        for method, parts in self._parts.items():
            records = [FreeMotion(np.array([r.motion.stamp for r in part], dtype=np.int64),
                                  np.array([r.motion.row for r in part]),
                                  np.array([r.value for r in part]))
                       for part in parts if len(part) > 1]
            held = None if self.stiction is None or not records else self.stiction(
                method, np.vstack([r.motion[::CALIBRATION_STRIDE, :r.motion.shape[1] // 3]
                                   for r in records]))
            learned = learn_thresholds(records, self.channels[method], held)
            for channel, tail in zip(3 * learned.channels, learned.tails, strict=True):
                if not tail.scale > 0:
                    raise FitError(f'{method}: the residual of {channel!r} never changes; check '
                                   'its sensor')
            found[method] = learned
        return found
