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

"""Which share of the samples was judged, why others were not, and sensors that died."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
import math
from statistics import median

import numpy as np

from tudor_dynamics.compiled import largest_size
from tudor_dynamics.online.settings import (
    COVERAGE_PERIOD, COVERAGE_TIME, PERIODS_APART, SENSOR_SPEED, STAMPS_APART, UNJUDGED_ERROR,
    UNJUDGED_WARNING)
from tudor_dynamics.online.streams import PairedSample


class SensorHealth:
    """Watches channels of one sensor."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        self._values = np.full(len(self.names), np.nan)
        self._still = np.zeros(len(self.names))

    def step(self, pair: PairedSample) -> None:
        """Take a reading into account; time counts only while the arm moves."""
        row, n = pair.motion.row, len(pair.motion.row) // 3
        dt = pair.motion.dt if largest_size(row, n, 2 * n) > SENSOR_SPEED else 0.0
        self._still = np.where(pair.measured == self._values, self._still + dt, 0.0)
        self._values = pair.measured

    def dead(self, stuck_time: float) -> list[str]:
        """Name the channels that have not changed for longer than a time [s]."""
        return [name for name, still in zip(self.names, self._still, strict=True)
                if still > stuck_time]


MEANING = {
    'settling': 'filters settle for some seconds after {on} starts or pauses; wait; if this '
                'lasts, look for pauses with `ros2 topic hz {on}`',
    'gap': 'messages on {on} are lost; run `ros2 topic hz`: if it shows the rate of the driver, '
           'close other programs on this computer, otherwise check the network',
    'not_finite': 'messages on {on} have NaN or infinite values; check the driver and its sensors',
    'duplicate_stamp': 'stamps on {on} repeat; correct the driver, or stop a second publisher',
    'backward_stamp': 'stamps on {on} go back; correct the driver, or stop a second publisher',
    'unknown_names': 'messages on {on} lack some joints or gauges of the model; publish all of '
                     "them in one message, or set the parameter 'model' to the model of this arm",
    'other_names': 'messages on {on} name no joint or gauge of the model; set the parameter '
                   "'model' to the model of this arm, or correct the names in the driver",
    'short_array': 'messages on {on} have fewer values than names; correct the driver',
    'no_measurement': 'nothing comes on {on} during the motion; start the publisher',
    'no_neighbour': 'no stamp on {on} is near that of a joint state; publish {on} at the rate of '
                    'the joint states, and synchronise the clocks of both publishers',
    'no_prediction': 'no prediction comes, or the model diverged; check the node that predicts',
    'no_thresholds': 'the model has no thresholds; fit it with more motion without contact, or '
                     'call the service ~/calibrate while the arm moves without contact'}
"""Causes for which a sample is not judged; ``on``: the topics that they are about."""
SENDERS = {'joint_motion': 'joint_state_filter', 'predicted_efforts': 'dynamics_predictor',
           'predicted_strains': 'dynamics_predictor'}  # nodes of this package, by topic
ALSO = '\n'  # between two texts of one level; the first is the message of a diagnosis
OF_OTHERS = 'other_names'  # what another device sends on the same topic; counts where it is all
OF_MOTIONS = ('no_measurement', 'no_neighbour')  # of a pairing; count motions, not measurements


class CoverageLevel(IntEnum):
    """How much the detector sees."""

    ENOUGH = 0
    PARTIAL = 1
    NONE = 2


@dataclass(eq=False, slots=True)
class TopicCount:
    """Messages of a topic."""

    topic: str  # name of the topic
    count: int = 0  # messages that have come
    stamp: int = 0  # newest header stamp [ns]


@dataclass(frozen=True)
class CoverageReport:
    """How much was judged."""

    level: CoverageLevel = CoverageLevel.ENOUGH  # whether it is enough
    text: str = ''  # what is wrong; empty where nothing is
    share: float = 0.0  # part of the samples of the last second that was not judged
    causes: dict[str, float] = field(default_factory=dict)  # the same by cause


@dataclass(frozen=True, slots=True)
class _Counts:
    """Counts at an earlier look."""

    time: float
    motion: Counter[str]
    measured: Counter[str]
    came: tuple[int, ...]
    stamps: tuple[int, ...]


class OutputCoverage:
    """Looks at what a detector counts for one output, ten times a second: settle [s]."""

    def __init__(
        self, output: str, motion: TopicCount, others: Sequence[TopicCount],
        sensors: Sequence[TopicCount], motions: Sequence[Counter[str]],
        measured: Sequence[Counter[str]], settle: float,
    ) -> None:
        self.output = output
        self.streams = (motion, *others)
        self._sensors = [self.streams.index(stream) for stream in sensors]
        self._motions, self._measured = tuple(motions), tuple(measured)
        self._patience = settle + 2.0 * COVERAGE_TIME
        self._past: deque[_Counts] = deque()
        self._offsets: list[deque[tuple[float, float]]] = [deque() for _ in others]
        self._arrivals: list[float] = [0.0] * len(self.streams)
        self._flowing: float | None = None
        self._blind: float | None = None
        self._settling: float | None = None

    def look(self, now: float) -> CoverageReport:
        """Compare the counts with those of a second ago: now [s]."""
        motion: Counter[str] = Counter()
        measured: Counter[str] = Counter()
        for counts in self._motions:
            motion.update({k: n for k, n in counts.items() if k in MEANING or k == 'judged'})
        for counts in self._measured:
            for cause, n in counts.items():
                if cause in MEANING:
                    (motion if cause in OF_MOTIONS else measured)[cause] += n
        new = _Counts(now, motion, measured, tuple(stream.count for stream in self.streams),
                      tuple(stream.stamp for stream in self.streams))
        self._follow(new, self._past[-1] if self._past else new)
        self._past.append(new)
        while len(self._past) > 2 and now - self._past[1].time >= COVERAGE_TIME:
            self._past.popleft()
        return self._judge(new, self._past[0])

    def _follow(self, new: _Counts, last: _Counts) -> None:
        """Keep since when samples come, since when none was judged, and how stamps lie apart."""
        came = [a > b for a, b in zip(new.came, last.came, strict=True)]
        self._arrivals = [new.time if fresh else at
                          for fresh, at in zip(came, self._arrivals, strict=True)]
        if any(came):
            if self._flowing is None:
                self._flowing = new.time
        elif self._flowing is not None and new.time - max(self._arrivals) >= COVERAGE_TIME:
            self._flowing = None
        if self._flowing is None or new.motion['judged'] > last.motion['judged']:
            self._blind = None
        elif self._blind is None:
            self._blind = last.time
        for place, offsets in enumerate(self._offsets, 1):
            if came[0] and came[place]:
                offsets.append((new.time, (new.stamps[0] - new.stamps[place]) * 1e-9))
            while offsets and new.time - offsets[0][0] > COVERAGE_TIME:
                offsets.popleft()

    def _judge(self, new: _Counts, old: _Counts) -> CoverageReport:
        motions, measured = self._shares(new, old)
        share = max(sum(motions.values()), sum(measured.values()))
        causes = {cause: max(motions.get(cause, 0.0), measured.get(cause, 0.0))
                  for cause in motions | measured}
        settling = causes.get('settling', 0.0)
        if not settling:
            self._settling = None
        elif self._settling is None:
            self._settling = new.time
        patient = self._settling is not None and new.time - self._settling < self._patience
        if self._blind is not None and new.time - self._blind >= COVERAGE_TIME and not (
                patient and share == settling):
            causes = causes or {'no_measurement': 1.0}
            silent = [
                stream.topic for stream, at in zip(self.streams, self._arrivals, strict=True)
                if new.time - max(at, self._flowing or at) >= COVERAGE_TIME - COVERAGE_PERIOD]
            starts = dict.fromkeys(
                SENDERS.get(topic.rpartition('/')[2], 'the driver that publishes there')
                for topic in silent)
            why = self._apart(new, old) if not silent else (
                f'no message came on {" and on ".join(silent)}; start {" and ".join(starts)}')
            return CoverageReport(
                CoverageLevel.NONE, f'collisions cannot be detected in any sample of {self.output}'
                f'{f", because {why}" if why else self._main(causes, motions)}', 1.0, causes)
        faults = list(filter(None, [self._apart(new, old)]))
        if share >= UNJUDGED_WARNING:
            of = 'any sample' if share == 1.0 else f'{100.0 * share:.1f} % of the samples'
            faults.append(f'collisions cannot be detected in {of} of {self.output} in the last '
                          f'second{self._main(causes, motions)}')
        lasting = share - (settling if patient else 0.0)
        full = (self._flowing is not None
                and new.time - max(old.time, self._flowing) >= COVERAGE_TIME)
        level = CoverageLevel.ENOUGH if not faults else (
            CoverageLevel.NONE if full and lasting >= UNJUDGED_ERROR else CoverageLevel.PARTIAL)
        return CoverageReport(level, ALSO.join(faults), share, causes)

    def _main(self, causes: dict[str, float], motions: dict[str, float]) -> str:
        """Name the cause that explains most, what it means, and the topics it is about."""
        # where measurements are left out, motions lack them: the reason is what they were
        cause = max(causes, key=lambda name: (
            causes[name] * (0.5 if name in (*OF_MOTIONS, OF_OTHERS) else 1.0),
            name not in OF_MOTIONS))
        of = self._sensors if cause in OF_MOTIONS or motions.get(cause) != causes[cause] else [0]
        on = ', '.join(self.streams[k].topic for k in of)
        return f', {"mainly " * (len(causes) > 1)}because {MEANING[cause].format(on=on)}'

    def _shares(self, new: _Counts, old: _Counts) -> tuple[dict[str, float], dict[str, float]]:
        """Give shares of the motions that were not judged, and of measurements left out."""
        motion, measured = new.motion - old.motion, new.measured - old.measured
        came = sum(new.came[i] - old.came[i] for i in self._sensors) + (
            measured['gap'] - measured[OF_OTHERS])
        if motion.total() > motion[OF_OTHERS]:
            del motion[OF_OTHERS]
        if motion['judged']:
            del measured[OF_OTHERS]
        total = motion.total()
        del motion['judged']
        came = max(came, measured.total())
        return ({cause: n / total for cause, n in motion.items()},
                {cause: n / came for cause, n in measured.items() if n})

    def _apart(self, new: _Counts, old: _Counts) -> str:
        """Name the topic whose stamps lie apart from those of the motion; empty for none."""
        for place, offsets in enumerate(self._offsets, 1):
            if len(offsets) < COVERAGE_TIME / COVERAGE_PERIOD / 2:
                continue
            offset = median(item for _, item in offsets)
            limit = max(STAMPS_APART, *(PERIODS_APART * self._period(i, new, old)
                                        for i in (0, place)))
            if abs(offset) > limit:
                one, other = self.streams[place].topic, self.streams[0].topic
                side = 'later' if offset > 0.0 else 'earlier'
                return (f'stamps of {one} are {1e3 * abs(offset):.0f} ms {side} than those of '
                        f'{other} (limit {1e3 * limit:.0f} ms); synchronise both publishers')
        return ''

    def _period(self, place: int, new: _Counts, old: _Counts) -> float:
        count = new.came[place] - old.came[place]
        return abs(new.stamps[place] - old.stamps[place]) * 1e-9 / count if count else 0.0


class Coverage:
    """Counts the messages of a detector's topics, and looks at what became of them."""

    def __init__(self) -> None:
        self.verdict = CoverageReport()
        self._streams: dict[str, TopicCount] = {}
        self._outputs: list[OutputCoverage] = []
        self._looked = -math.inf

    def begin(self) -> None:
        """Forget the outputs; topics go on where they are."""
        self._outputs.clear()
        self._looked = -math.inf

    def add(
        self, output: str, motion: str, predictions: str | None, sensors: Sequence[str],
        motions: Sequence[Counter[str]], measured: Sequence[Counter[str]], settle: float,
    ) -> None:
        """Look at one more output: settle [s]."""
        own = [self._stream(topic) for topic in sensors]
        predicted = [] if predictions is None else [self._stream(predictions)]
        self._outputs.append(OutputCoverage(
            output, self._stream(motion), [*predicted, *own], own, motions, measured, settle))

    def _stream(self, topic: str) -> TopicCount:
        return self._streams.setdefault(topic, TopicCount(topic))

    def came(self, topic: str, stamp: int, now: float) -> bool:
        """Count a message by stamp [ns] and time [s]; called for each one."""
        stream = self._streams.get(topic)
        if stream is None:
            return False
        before = self.verdict.level
        worse = self.look(now).level > before  # before it counts: messages are worked off
        stream.count += 1
        stream.stamp = stamp
        return worse

    def apart(self) -> dict[str, float]:
        """Give by how much the newest stamp of each topic is later than that of the motion [s]."""
        return {stream.topic: (stream.stamp - one.streams[0].stamp) * 1e-9
                for one in self._outputs for stream in one.streams[1:] if stream.count}

    def look(self, now: float) -> CoverageReport:
        """Look at the counts, unless the last look was just before; ``now`` is steady [s]."""
        if now - self._looked >= COVERAGE_PERIOD:
            self._looked = now
            self.verdict = _together({one.output: one.look(now) for one in self._outputs})
        return self.verdict


def _together(found: dict[str, CoverageReport]) -> CoverageReport:
    """Give the worst level with the texts that have it, and the largest shares: by output."""
    level = max((verdict.level for verdict in found.values()), default=CoverageLevel.ENOUGH)
    causes: dict[str, float] = {}
    # what is the same for several outputs is said once: text, and outputs by their share
    texts: dict[str, tuple[str, dict[str, list[str]]]] = {}
    for output, verdict in found.items():
        for cause, share in verdict.causes.items():
            causes[cause] = max(share, causes.get(cause, 0.0))
        if verdict.level == level and verdict.text:
            part = f'{100.0 * verdict.share:.1f} % of the samples'
            part = part if part in verdict.text else 'any sample'
            text = verdict.text.replace(f'{part} of {output}', 'SAMPLES')
            longest, outputs = texts.get(same := text.replace(', mainly ', ', '), ('', {}))
            outputs.setdefault(part, []).append(output)
            texts[same] = max(text, longest, key=len), outputs
    said = ALSO.join(text.replace('SAMPLES', ' and '.join(
        f'{part} of {" and ".join(names)}' for part, names in outputs.items()))
        for text, outputs in texts.values())
    return CoverageReport(level, said, max((v.share for v in found.values()), default=0.0), causes)
