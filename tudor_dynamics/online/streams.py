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

"""Live streams: stamps, gaps, filtered joint states, measured values on their stamps."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np
from tudor_dynamics.arm.description import OUTPUTS
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.settings import GAP_FLOOR, GAP_PERIODS
from tudor_dynamics.compiled import all_finite
from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.online.memory import Memory
from tudor_dynamics.online.settings import (
    CLOCK_JUMP, EARLY_STEP, LOST_STEP, PAIRING_QUEUE, PERIOD_INTERVALS, PERIOD_RENEWAL,
    STRAIN_APART, STRAIN_QUEUE)
from tudor_dynamics.signals.filters import CausalDifferentiator, low_pass_gain
from tudor_dynamics.typing import FloatArray


class Losses:
    """Counts samples that never came, by the period that it learns; late ones are not counted."""

    def __init__(self) -> None:
        self.recent: deque[int] = deque(maxlen=31)
        self.period = 0.0  # 0 until it is known [ns]
        self._long = -1.0
        self._renewal = PERIOD_INTERVALS
        self._late = 0.0

    def reset(self) -> int:
        """Forget the period, and give the samples lost that were still in doubt."""
        late = max(0, round(self._late))
        self.recent.clear()
        self.period, self._long, self._renewal, self._late = 0.0, -1.0, PERIOD_INTERVALS, 0.0
        return late

    def unusable(self) -> None:
        """Take a sample into account that came, but whose stamp is not stepped to."""
        self._late -= 1.0

    def step(self, step: int) -> int:
        """Take the time between two samples: step [ns]."""
        self.recent.append(step)
        self._renewal -= 1
        if not self._renewal:
            self._renewal = PERIOD_RENEWAL
            self.period = float(median(self.recent))
            if self.period > self._long > 0.0:
                self._late = 0.0  # the source has slowed down, which is no loss
            self._long = LOST_STEP * self.period
        if 0.0 < step <= self._long and not self._late:
            return 0  # nearly always
        return self._settle(step / self.period) if self.period else 0

    def _settle(self, step: float) -> int:
        """Add what a long step [periods] lacks, take off what early ones give back."""
        if step > LOST_STEP:
            self._late += step - 1.0
            return 0
        late = max(0.0, self._late - max(0.0, 1.0 - step))
        self._late = late if step < EARLY_STEP else 0.0
        return 0 if step < EARLY_STEP else round(late)


class StampGate:
    """Lets increasing stamps pass and counts the others; a gap is what it is in recordings."""

    def __init__(self, gap: float = 0.0) -> None:
        self.gap = gap  # [s]; 0 for five periods, at least 20 ms
        self.drops: Counter[str] = Counter()
        self._losses = Losses()
        self.last: int | None = None

    def reset(self) -> None:
        """Take the next stamp for a first one."""
        self.last = None
        lost = self._losses.reset()
        if lost:
            self.drops['gap'] += lost

    def unusable(self) -> None:
        """Take a sample into account that came and is left out for its values: it is not lost."""
        self._losses.unusable()

    def limit(self) -> float:
        """Give the longest time between samples that is not a gap now [s]."""
        if self.gap > 0:
            return self.gap
        recent = self._losses.recent
        if len(recent) < PERIOD_INTERVALS:
            return CLOCK_JUMP
        return max(GAP_PERIODS * median(recent) * 1e-9, GAP_FLOOR)

    def step(self, stamp: int) -> float | None:
        """Give the time since the last stamp [s]; 0 where none counts, None if it is no newer."""
        if self.last is None:
            self.last = stamp
            return 0.0
        step = stamp - self.last
        if step <= 0:
            if -step * 1e-9 <= CLOCK_JUMP:
                self.drops['duplicate_stamp' if step == 0 else 'backward_stamp'] += 1
                return None
            self.drops['clock_set_back'] += 1
            self.reset()
            self.last = stamp
            return 0.0
        dt = step * 1e-9
        self.last = stamp
        first = dt > GAP_FLOOR and dt > self.limit()
        # also after a gap: a source that has slowed down is not one gap after another
        lost = self._losses.step(step)
        if first and not self._losses.period:
            lost = 1  # how many, nobody knows
        if lost:
            self.drops['gap'] += lost
        return 0.0 if first else dt


@dataclass(eq=False, slots=True)  # frozen would be three times as slow to make
class Motion:
    """Motion of one sample."""

    stamp: int  # header stamp of the sample [ns]
    elapsed: float  # time since the filter began, or restarted after a gap [s]
    dt: float  # time since the sample before; 0 at the beginning [s]
    row: FloatArray  # of the active joints, (3 joints,)

    def settled(self, settle: float) -> bool:
        """Say whether the filters' transients [s] are over, by the offline tools' rule."""
        return self.elapsed >= settle - 0.5 * self.dt


class LowPass:
    """First-order low-pass of vectors: cutoff [Hz]."""

    def __init__(self, cutoff: float | None) -> None:
        self.cutoff = cutoff
        self._state: FloatArray | None = None

    def step(self, dt: float, x: FloatArray) -> FloatArray:
        """Filter one sample (channels,); dt [s]: 0 restarts."""
        if self.cutoff is None:
            return x
        if self._state is None or dt <= 0:
            self._state = x.copy()
        else:
            self._state = self._state + low_pass_gain(self.cutoff, dt) * (x - self._state)
        return self._state


class StateFilter:
    """Filter of live joint states; gap [s]: 0 for five periods."""

    def __init__(self, spec: PreprocessingSpec, gap: float = 0.0) -> None:
        self.spec = spec
        self.gate = StampGate(gap)
        self.drops: Counter[str] = self.gate.drops
        self._differentiator = CausalDifferentiator(spec.velocity_cutoff, spec.acceleration_cutoff)
        self._output = LowPass(spec.output_cutoff)
        self._began = 0
        self._with_velocity = False

    def reset(self) -> None:
        """Forget the past."""
        self.gate.reset()

    def step(self, stamp: int, q: FloatArray, measured: FloatArray | None = None) -> Motion | None:
        """Filter a sample (joints,) at a stamp [ns]; None for one that is left out."""
        if not all_finite(q):
            self.drops['not_finite'] += 1
            self.gate.unusable()
            return None
        if not self.spec.measured_velocity or (measured is not None and not all_finite(measured)):
            measured = None
        step = self.gate.step(stamp)
        if step is None:
            return None
        changed = self._with_velocity != (measured is not None)
        if changed or not step:
            if changed and step:
                self.drops['velocity_came_or_went'] += 1
            self._differentiator.reset()
            self._began = stamp
            self._with_velocity = measured is not None
        dt = 0.0 if stamp == self._began else step
        row = self._differentiator.step_row(step, q, measured)
        if self._output.cutoff is not None:
            n = len(q)
            row[:2 * n] = self._output.step(dt, row[:2 * n])
        return Motion(stamp, (stamp - self._began) * 1e-9, dt, row)


@dataclass(eq=False, slots=True)  # frozen would be three times as slow to make
class PairedSample:
    """A motion with its prediction and the measurement at the same time."""

    motion: Motion
    predicted: FloatArray | None  # None while the filters settle
    measured: FloatArray  # interpolated between neighbours where stamps differ


def between(
    known: deque[tuple[int, FloatArray]], stamp: int, apart: Callable[[], float],
) -> FloatArray | None:
    """Interpolate readings at a stamp [ns], unless too far apart [s]; forget older ones."""
    while len(known) > 1 and known[1][0] <= stamp:
        known.popleft()
    if not known or known[0][0] > stamp:
        return None
    before, values = known[0]
    if before == stamp:
        return values
    if len(known) == 1:
        return None
    after, later = known[1]
    if (after - before) * 1e-9 > apart():
        return None
    share = (stamp - before) / (after - before)
    return values + share * (later - values)  # so a constant stays one, to the last bit


class Pairing:
    """Waits for measurements at the stamps of motions, interpolated where none is equal."""

    def __init__(self) -> None:
        self.gate = StampGate()
        self.drops: Counter[str] = self.gate.drops
        self._motions: deque[tuple[Motion, FloatArray | None]] = deque()
        self._measured: deque[tuple[int, FloatArray]] = deque()

    def add_motion(self, motion: Motion, predicted: FloatArray | None) -> list[PairedSample]:
        """Add a motion, later than those before it: predicted (channels,)."""
        if self._motions and motion.stamp <= self._motions[-1][0].stamp:
            self.drops['no_measurement'] += len(self._motions)
            self._motions.clear()  # the clock was set back
            self._measured.clear()
            self.drops['clock_set_back'] += 1
        if len(self._motions) >= PAIRING_QUEUE:
            self._motions.popleft()
            self.drops['no_measurement'] += 1
        self._motions.append((motion, predicted))
        return self._complete()

    def add_measured(self, stamp: int, values: FloatArray) -> list[PairedSample]:
        """Add a measurement: stamp [ns], values (channels,) [its unit]."""
        if not all_finite(values):
            self.drops['not_finite'] += 1
            self.gate.unusable()
            return []
        step = self.gate.step(stamp)
        if step is None:
            return []
        if not step:
            while self._measured and self._measured[-1][0] > stamp:  # the clock was set back
                self._measured.pop()
        if len(self._measured) >= PAIRING_QUEUE:
            self._measured.popleft()
        self._measured.append((stamp, values))
        return self._complete()

    def _complete(self) -> list[PairedSample]:
        pairs: list[PairedSample] = []
        motions, measured = self._motions, self._measured
        while motions and measured:
            motion, predicted = motions[0]
            values = between(measured, motion.stamp, self.gate.limit)
            if values is not None:
                pairs.append(PairedSample(motion, predicted, values))
            elif measured[-1][0] < motion.stamp:
                break
            else:
                self.drops['no_neighbour'] += 1
            motions.popleft()
        return pairs


class Gathering:
    """Puts readings of several topics together, interpolated at the stamps of the first topic."""

    def __init__(self, channels: Sequence[str], topics: Mapping[str, Sequence[str]]) -> None:
        self.topics = tuple(topics)
        order = [name for names in topics.values() for name in names]
        self._order = [order.index(name) for name in channels]
        self._gate = StampGate()
        self._stages = [Pairing() for _ in self.topics[1:]]

    @property
    def drops(self) -> list[Counter[str]]:
        """Give the readings left out, by cause; one topic's pairing with the motion counts."""
        return [self._gate.drops, *(stage.drops for stage in self._stages)]

    def add(self, topic: str, stamp: int, values: FloatArray) -> list[tuple[int, FloatArray]]:
        """Take a message of its topic's channels into account; returns (channels,)."""
        if not self._stages:
            return [(stamp, values)]  # of a single topic, in its order
        place = self.topics.index(topic)
        if place:
            done = [(pair.motion.stamp, np.concatenate([pair.motion.row, pair.measured]))
                    for pair in self._stages[place - 1].add_measured(stamp, values)]
        elif self._gate.step(stamp) is None:
            return []
        else:
            done = [(stamp, values)]
        for stage in self._stages[place:]:
            done = [(pair.motion.stamp, np.concatenate([pair.motion.row, pair.measured]))
                    for when, row in done
                    for pair in stage.add_motion(Motion(when, 0.0, 0.0, row), None)]
        return [(when, row[self._order]) for when, row in done]


class Predictor:
    """Predicts every output of a bundle with one kind of model."""

    def __init__(self, bundle: ModelBundle, kind: str = 'analytical') -> None:
        self.settle = bundle.preprocessing.settle
        self.models: dict[str, Model] = {
            output: bundle.models[output][kind] for output in OUTPUTS
            if kind in bundle.models.get(output, {})}
        if not self.models:
            have = sorted({k for kinds in bundle.models.values() for k in kinds})
            raise ModelError(f'the model folder has models of the kinds {", ".join(have)}, not '
                             f'{kind!r}; set kind= to one of these')
        self._live = type(next(iter(self.models.values()))).live(self.models)
        self.observing = self._live.observing
        self._stamp = 0
        self._strains: deque[tuple[int, FloatArray]] = deque(maxlen=STRAIN_QUEUE)
        self.memory = Memory(self._live, bundle.digest)

    def add_strain(self, stamp: int, values: FloatArray) -> None:
        """
        Give a measured strain, which corrects an elastic model.

        It counts for the motion of the same stamp, whichever of the two comes first, if it comes
        before the next motion. Between two readings their interpolation counts.
        """
        if self.observing:
            if self._strains and stamp <= self._strains[-1][0]:
                self._strains.clear()  # the clock was set back
            self._strains.append((stamp, values))

    def step(
        self, motion: Motion, wanted: Collection[str] = OUTPUTS,
    ) -> dict[str, FloatArray] | None:
        """Predict one sample; returns (channels,) [its unit], None while the filters settle."""
        if self.observing:
            measured = between(self._strains, self._stamp, lambda: STRAIN_APART * motion.dt)
            if measured is not None:
                self._live.measure(measured)
        self._stamp = motion.stamp
        # a model with a memory follows every sample: what it predicts depends on all that was
        settled = motion.settled(self.settle)
        predicted = self._live.step(motion.dt, motion.row, wanted if settled else ())
        self.memory.step(motion.stamp)
        return predicted if settled else None


@dataclass(eq=False, slots=True)  # frozen would be three times as slow to make
class Residual:
    """What the model does not explain of one sample."""

    motion: Motion  # motion of the sample
    measured: FloatArray  # reading, after the output filter, (channels,)
    predicted: FloatArray  # prediction for the sample, (channels,)
    value: FloatArray  # their difference, in the unit of the output, (channels,)


class ResidualStage:
    """Makes residuals of pairs: cutoff [Hz], settle [s]."""

    def __init__(self, cutoff: float | None, settle: float) -> None:
        self.settle = settle
        self._filter = LowPass(cutoff)
        self._last = 0

    def step(self, pair: PairedSample) -> Residual | None:
        """Take the difference; returns None while the filters settle."""
        stamp = pair.motion.stamp
        # since the pair before, which is not the sample before where messages were lost
        dt = 0.0 if pair.motion.dt == 0.0 else (stamp - self._last) * 1e-9
        self._last = stamp
        measured = self._filter.step(dt, pair.measured)
        if pair.predicted is None or not pair.motion.settled(self.settle):
            return None
        return Residual(pair.motion, measured, pair.predicted, measured - pair.predicted)
