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

"""From a recording to filtered, settled, decimated states and outputs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.errors import SignalError
from tudor_dynamics.signals import settings
from tudor_dynamics.signals.filters import (
    CausalDifferentiator, chebyshev, forward_backward, low_pass, low_pass_sections, MotionState,
    zero_phase)
from tudor_dynamics.typing import finite_array, FloatArray, Shown


@dataclass(frozen=True, eq=False)
class Timing:
    """Stamps of an even sampling, compared with those that were recorded."""

    stamp: NDArray[np.int64]  # even stamps, (n,) [ns]
    jitter: float  # standard deviation of the recorded stamps about them [s]
    # Roughness of the positions over the recorded and over the even stamps: rms error by which a
    # sample follows from its four neighbours, relative to the largest of the two.
    now: float
    even: float

    @property
    def clear(self) -> bool:
        """Say whether the positions were sampled evenly beyond doubt."""
        return self.even < settings.CLEAR * self.now


def timing(recording: Recording) -> Timing | None:
    """Compare recorded stamps with even ones; None where they are even, or no even ones fit."""
    # the positions of an arm are smooth in time. Where each follows better from its neighbours by
    # a cubic over even stamps than over the recorded ones, the sampling was even, and the stamps
    # were late by varying times
    stamp = recording.stamp.copy()
    squares, count = np.zeros((2, recording.q.shape[1])), 0
    offsets = []
    for part in recording.segments:
        if part.stop - part.start < settings.FEWEST_STAMPS:
            continue
        t = (recording.stamp[part] - recording.stamp[part.start]) * 1e-9
        even = _even(t)
        if even is None:
            return None
        stamp[part] = recording.stamp[part.start] + np.round(even * 1e9).astype(np.int64)
        offsets.append(t - even)
        for i, times in enumerate((t, even)):
            squares[i] += np.sum(_unexpected(times, recording.q[part]) ** 2, axis=0)
        count += len(t) - 4
    if not count:
        return None
    jitter = float(np.std(np.concatenate(offsets)))
    if jitter < settings.LEAST_JITTER * recording.dt or np.any(np.diff(stamp) <= 0):
        return None
    rough = np.sqrt(squares / count)
    # the joint with the largest difference: one that stands still says nothing
    joint = int(np.argmax(np.abs(rough[0] - rough[1])))
    largest = max(float(rough[:, joint].max()), 1e-300)
    return Timing(stamp, jitter, float(rough[0, joint]) / largest,
                  float(rough[1, joint]) / largest)


def retimed(recording: Recording) -> tuple[Recording, Timing | None]:
    """Give a recording even stamps where its positions were sampled evenly beyond doubt."""
    found = timing(recording)
    if found is None or not found.clear:
        return recording, None
    note = (f'stamps jitter by {found.jitter * 1e3:.2g} ms on an even sampling of '
            f'{1.0 / recording.dt:.4g} Hz; even stamps took their place')
    return replace(recording, stamp=found.stamp, warnings=(*recording.warnings, note)), found


def _even(t: FloatArray) -> FloatArray | None:
    """Give the even times nearest to stamps; lost samples leave their places free."""
    whole = _fitted(t, np.arange(len(t), dtype=float), settings.LARGEST_IN_ORDER)
    step = float(np.median(np.diff(t)))
    # step by step: over a whole record, the error of the median would come to many samples
    index = np.concatenate([[0.0], np.cumsum(np.maximum(np.round(np.diff(t) / step), 1.0))])
    slope, first = np.polyfit(index, t, 1)
    index = np.round((t - first) / slope)
    holed = None if np.any(np.diff(index) < 1.0) else _fitted(t, index, settings.LARGEST_OFFSET)
    found = [even for even in (whole, holed) if even is not None]
    return min(found, key=lambda even: float(np.std(t - even)), default=None)


def _fitted(t: FloatArray, index: FloatArray, largest: float) -> FloatArray | None:
    """Give even times for places in a row; None where a stamp is too far from its own."""
    slope, first = np.polyfit(index, t, 1)
    even = np.asarray(first + slope * index)
    return None if np.max(np.abs(t - even)) > largest * slope else even


def _unexpected(t: FloatArray, x: FloatArray) -> FloatArray:
    """Give by how much each sample differs from the cubic through its four neighbours."""
    places, values = ([y[:-4], y[1:-3], y[3:-1], y[4:]] for y in (t, x))
    left = x[2:-2].copy()
    for i, (place, value) in enumerate(zip(places, values, strict=True)):
        weight = np.prod([(t[2:-2] - other) / (place - other)
                          for j, other in enumerate(places) if j != i], axis=0)
        left -= weight[:, None] * value
    return left


# From a recording to what models are fitted to: filtered states and outputs, without warm-up,
# decimated. The same function serves training, validation and evaluation; its settings travel in
# the model bundle. Decimation is linear, and is applied to measured outputs and to regressor rows
# or predictions alike (Gautier's parallel filtering), so that both sides stay comparable.

BLOCK = 4096
COLUMNS_AT_A_TIME = 64


@dataclass(frozen=True, eq=False)
class Decimation:
    """A linear operation on the samples: anti-alias filter if need be, then their choice."""

    keep: NDArray[np.intp]  # indices of the samples that are kept, (kept,)
    # (sections, 3): zero-phase anti-alias filter, see `filters.low_pass_sections`; None keeps
    # samples as they are, as sub-sampling does next to the running robot.
    sections: FloatArray | None = None

    def __call__(self, x: FloatArray) -> FloatArray:
        """Decimate ``x`` of shape (n_samples, ...) along its first axis."""
        if self.sections is None:
            return x[self.keep]
        flat = x.reshape(len(x), -1)
        pad = min(len(x) - 1, 300)
        smooth = np.empty((len(self.keep), flat.shape[1]))
        for first in range(0, flat.shape[1], COLUMNS_AT_A_TIME):  # the filter makes copies
            part = slice(first, first + COLUMNS_AT_A_TIME)
            smooth[:, part] = forward_backward(self.sections, flat[:, part], pad)[self.keep]
        return smooth.reshape(len(self.keep), *x.shape[1:])


@dataclass(frozen=True, eq=False)
class TrainingBlock:
    """Motion, little enough to build regressor rows for, and the outputs that belong to it."""

    motion: FloatArray  # of all samples
    output: FloatArray  # measured outputs after decimation, (kept, channels)
    decimation: Decimation | None = None  # of `motion` to `output`; None where rows match


@dataclass(frozen=True, eq=False, repr=False)
class Stretch(Shown):
    """A gapless stretch of a recording, filtered."""

    t: FloatArray  # time since the start of the recording, (samples,) [s]
    stamp: NDArray[np.int64]  # header stamps, (samples,) [ns]
    states: MotionState  # positions, velocities, accelerations of all samples
    # Outputs of all samples, (samples, channels).
    effort: FloatArray | None
    strain: FloatArray | None
    decimation: Decimation  # from all samples to those used
    margin: int = 0  # samples that the anti-alias filter needs on each side of a block
    # `[dt, q]` of the gapless motion just before, where the stretch begins in the middle of it,
    # (earlier, 1 + joints) [s, rad or m].
    before: FloatArray | None = None
    since: float = 0.0  # time between the last of these samples and the first of the stretch [s]

    @property
    def past_unknown(self) -> bool:
        """Whether all that is known of its motion begins in motion."""
        if self.before is None:
            start = np.abs(self.states.dq[self.t < self.t[0] + 0.3])
        else:
            first = self.before[np.cumsum(self.before[:, 0]) < 0.3, 1:]
            start = np.ptp(first, axis=0) / 0.3
        return float(start.max()) > settings.STILL

    @property
    def motion(self) -> FloatArray:
        """All states side by side, shape (n_samples, 3 n_joints)."""
        return self.states.motion

    @property
    def dt(self) -> FloatArray:
        """Time since the sample before, as the running robot has it; 0 for none [s]."""
        dt = np.asarray(np.diff(self.stamp, prepend=self.stamp[0]) * 1e-9)
        if self.before is not None:
            dt[0] = self.since
        return dt

    @property
    def n_kept(self) -> int:
        """Give the number of samples after decimation."""
        return len(self.decimation.keep)

    def blocks(self, output: str, motion: FloatArray | None = None) -> Iterator[TrainingBlock]:
        """Cut motion (samples, inputs), that of the stretch by default, and an output."""
        keep = self.decimation.keep
        motion = self.motion if motion is None else motion
        values: FloatArray = getattr(self, output)
        if self.decimation.sections is None:
            for first in range(0, len(keep), BLOCK):
                index = keep[first:first + BLOCK]
                yield TrainingBlock(motion[index], values[index],
                                    Decimation(np.arange(len(index))))
            return
        step = max(1, int(np.median(np.diff(keep)))) if len(keep) > 1 else 1
        size = max(1, BLOCK // step)
        for first in range(0, len(keep), size):
            part = keep[first:first + size]
            begin = max(0, int(part[0]) - self.margin)
            end = min(len(self.t), int(part[-1]) + 1 + self.margin)
            decimation = Decimation(part - begin, self.decimation.sections)
            yield TrainingBlock(motion[begin:end], decimation(values[begin:end]), decimation)


def noise_gain(stretch: Stretch, spec: PreprocessingSpec) -> float:
    """Give the share of white noise of an output that remains after its filters."""
    cutoff = spec.output_cutoff if spec.filter == 'causal' else None
    white = np.random.default_rng(0).normal(size=(len(stretch.t), 1))
    return float(stretch.decimation(causal_outputs(stretch.dt, white, cutoff)).std())


def causal_outputs(dt: FloatArray, x: FloatArray, cutoff: float | None) -> FloatArray:
    """Low-pass an output from its first value on; a cutoff [Hz] of None leaves it as it is."""
    if cutoff is None:
        return x
    y = x.copy()
    y[1:] = low_pass(x[1:], dt[1:], cutoff, x[0])
    return y


def _filtered(
    spec: PreprocessingSpec, t: FloatArray, dt: FloatArray, q: FloatArray, dq: FloatArray | None,
) -> MotionState:
    measured = dq if spec.measured_velocity else None
    if spec.filter == 'zero_phase':
        rate = (len(t) - 1) / float(t[-1] - t[0])
        return zero_phase(t, q, spec.cutoff or rate / 10.0, measured)
    filt = CausalDifferentiator(spec.velocity_cutoff, spec.acceleration_cutoff)
    states = filt.process(dt, q, measured)
    return MotionState(causal_outputs(dt, states.q, spec.output_cutoff),
                       causal_outputs(dt, states.dq, spec.output_cutoff), states.ddq)


def _warm_up(settle: float, t: FloatArray, q: FloatArray) -> float:
    """Say how much of a beginning to leave out [s]: less where the arm stood, and moved soon."""
    moved = np.abs(q - q[0]).max(axis=1)
    early, later = (moved[np.abs(t - t[0]) <= span].max() for span in (settings.STOOD, settle))
    return settings.STOOD if early <= settings.STANDSTILL < 0.1 * later else settle


def _decimation(spec: PreprocessingSpec, t: FloatArray, q: FloatArray) -> tuple[Decimation, int]:
    n = len(t)
    dt = float(t[-1] - t[0]) / (n - 1)
    factor = 1 if spec.rate is None else max(1, round(1.0 / (spec.rate * dt)))
    begin = int(np.searchsorted(t, t[0] + _warm_up(spec.settle, t, q) - 0.5 * dt))
    end = n
    if spec.filter == 'zero_phase':
        left = _warm_up(spec.settle, t[::-1], q[::-1])
        end = int(np.searchsorted(t, t[-1] - left + 0.5 * dt))
    keep = np.arange(begin, end, factor)
    if spec.filter == 'causal' or factor == 1:
        return Decimation(keep), 0
    # The anti-alias filter of MATLAB's and scipy's decimate: Chebyshev I, order 8, 0.05 dB.
    sections = low_pass_sections(chebyshev(8, 0.05), 0.4 / factor)
    # With so much on each side, blocks differ from the whole by less than 1e-7 (measured; the
    # slowest poles need 113 output samples to decay to 1e-9, but hardly show in the output).
    return Decimation(keep, sections), 80 * factor + 100


def prepare(recording: Recording, spec: PreprocessingSpec) -> list[Stretch]:
    """
    Filter and decimate a recording, stretch by stretch; nothing crosses a gap.

    Parameters
    ----------
    recording : Recording
        Signals of one bag.
    spec : PreprocessingSpec
        Filters and rate.

    Returns
    -------
    list of Stretch
        Stretches long enough to hold at least two samples after settling.

    Raises
    ------
    SignalError
        If no stretch is long enough, or a cut-off does not fit the sample rate.

    """
    for name, values in recording.signals.items():
        finite_array(values, name, len(recording.stamp), None)
    stretches = []
    t_all = recording.t
    for part in recording.segments:
        t = t_all[part]
        if len(t) < settings.FEWEST or t[-1] - t[0] <= 2.0 * spec.settle:
            continue
        stamp = recording.stamp[part]
        # from the stamps, as the running robot has it: differences of t are off by rounding
        dt = np.diff(stamp, prepend=stamp[0]) * 1e-9
        dq = None if recording.dq is None else recording.dq[part]
        try:
            states = _filtered(spec, t, dt, recording.q[part], dq)
        except SignalError as err:
            raise err.at(recording.path) from None
        decimation, margin = _decimation(spec, t, recording.q[part])
        if len(decimation.keep) < 2:
            continue
        cutoff = spec.output_cutoff if spec.filter == 'causal' else None
        before, since = None, 0.0
        if recording.earlier is not None and part.start == 0:
            past, places = recording.earlier
            before = np.column_stack([np.diff(past, prepend=past[0]) * 1e-9, places])
            since = float(stamp[0] - past[-1]) * 1e-9
        effort, strain = (None if whole is None else causal_outputs(dt, whole[part], cutoff)
                          for whole in (recording.effort, recording.strain))
        stretches.append(Stretch(
            t, stamp, states, effort, strain, decimation, margin, before, since))
    if not stretches:
        raise SignalError(f'{recording.path}: no part without gaps is longer than '
                          f'{2 * spec.settle:.3g} s and {settings.FEWEST} samples; record '
                          'longer, or lower preprocessing.settle or raise preprocessing.rate')
    return stretches
