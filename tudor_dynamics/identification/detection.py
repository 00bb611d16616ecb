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

"""How well collisions are detected: truth, replay, score."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
import csv
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
import math
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv, gammaincinv

from tudor_dynamics.bags.messages import JOINT_STATE
from tudor_dynamics.bags.reader import BOOL, read_flags, read_wrenches
from tudor_dynamics.bags.recording import gap_limit, Recording
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.errors import BagError, SignalError, UsageError
from tudor_dynamics.files import read_text
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.online.contact import ContactEstimate, ContactRecord
from tudor_dynamics.online.detector import CollisionEvent, Level, time_of_day
from tudor_dynamics.online.monitor import Found, MonitorSettings, SOURCE, Watch
from tudor_dynamics.online.settings import BLOCK
from tudor_dynamics.online.streams import Predictor, StateFilter
from tudor_dynamics.typing import FloatArray, Shown


# -- What is known of the pushes of a bag: from a topic, from a table, or nothing.
#
# Where nothing is known, an event is neither right nor false.

FORCE = 0.01  # less is no push [N]
MERGE = 0.1  # pauses of the force that do not end a push [s]
TOPIC = 'applied_wrench'  # where forces that were applied on purpose are recorded
LARGEST_TOLERANCE = 1.0  # a push that is marked by eye is not farther off [s]
LONGEST = 1e9  # later no bag has a push [s]: stamps count nanoseconds in 64 bits
MAX_TABLE = 10_000_000  # bytes of a table of pushes that are read


@dataclass(frozen=True)
class KnownPush:
    """A push that was applied on purpose."""

    # Stamps of its first and last sample [ns].
    begin: int
    end: int
    force: float = float('nan')  # mean force [N], as of contacts; NaN where it is not known
    early: int = 0  # an event so long before belongs to it: how uncertain its mark is [ns]


@dataclass(frozen=True)
class Truth:
    """The pushes of a bag, as far as they are known."""

    source: str = ''  # where that is known from; empty where it is not
    pushes: tuple[KnownPush, ...] = ()  # in order

    @property
    def known(self) -> bool:
        """Say whether an event without a push is a false alarm."""
        return bool(self.source)


FREE = Truth('nothing touched the arm')  # truth of a recording of free motion


def find_truth(
    path: str,
    topic: str | None = None,  # of WrenchStamped, or of Bool, true while the arm is touched
    clock: str = 'joint_states',  # topic with the stamps of the recording
) -> Truth:
    """Read the pushes of a bag, by default of ``applied_wrench``; without it nothing is known."""
    name = topic or TOPIC
    bag = open_bag(path)
    found = bag.find({name: JOINT_STATE})[name]
    if found is not None and topic is not None and bag.topics[found].msgtype == BOOL:
        flags = read_flags(bag, topic, clock)
        if flags is not None:
            stamp, touched = flags
            # a flag may be published on change alone: it is up from rise to fall
            change = np.flatnonzero(np.diff(touched.astype(np.int8), prepend=0, append=0))
            times = stamp[np.minimum(change, len(stamp) - 1)].tolist()
            return Truth(topic, tuple(map(KnownPush, times[::2], times[1::2])))
    wrenches = read_wrenches(bag, name)
    if wrenches is not None:
        stamp = wrenches.stamp
        size = np.hypot.reduce(wrenches.values['force'], axis=1)  # also of 1e300 N
        where = np.flatnonzero(size > FORCE)
        begun = np.flatnonzero(np.diff(stamp[where]) > MERGE * 1e9) + 1
        return Truth(name, tuple(
            KnownPush(int(stamp[push[0]]), int(stamp[push[-1]]), float(size[push].mean()))
            for push in np.split(where, begun) if len(push)))
    if topic is None:
        return Truth()
    raise BagError(f'{path}: has no messages on {topic}, the topic of pushes; '
                   'name another topic, or give a table of pushes (CSV)')


def table_of_pushes(path: str | Path) -> list[tuple[float, float, float]]:
    """
    Read a table of pushes, as a person writes it down; returns begin, end, tolerance of each [s].

    It has a line ``BEGIN,END`` for each push, seconds since the beginning of the bag; a third
    number says by how much an event may be earlier, as where pushes were marked by eye. A first
    line may name the columns, what follows a ``#`` is a comment.
    """
    text = read_text(Path(path), MAX_TABLE, 'the table of pushes', UsageError,
                     'give a table of begin,end in seconds')
    lines = [line.split('#')[0].strip() for line in text.splitlines()]
    rows = [(number, row) for number, row in enumerate(
        next(csv.reader([line]), []) for line in lines) if row]
    found = []
    for place, (number, row) in enumerate(rows):
        try:
            begin, end = float(row[0]), float(row[1])
            # words in that column are notes
            early = float(row[2]) if row[2:] and row[2].strip()[:1] in [*'+-.0123456789'] else 0.0
        except (ValueError, IndexError):
            if place == 0 and len(row) >= 2:
                continue  # names of the columns
            begin, end, early = 0.0, -1.0, 0.0
        if not (0.0 <= begin <= end < LONGEST and 0.0 <= early <= LARGEST_TOLERANCE):
            msg = (f'found {",".join(row)!r}, expected begin,end in s since the start of the '
                   f'bag, such as 2.0,2.95, perhaps a tolerance to {LARGEST_TOLERANCE:g} s')
            raise UsageError(msg, place=f'{path}, line {number + 1}')
        found.append((begin, end, early))
    return sorted(found)


def truth_of_file(path: str | Path, bag: BagData) -> Truth:
    """Read the pushes of a bag, or of a part of it, from a table."""
    begun, _ = bag.choice.span(bag.choice.duration or 0.0)
    first = int(bag.recording.stamp[0]) - round(begun * 1e9)
    return Truth(str(path), tuple(KnownPush(
        first + round(begin * 1e9), first + round(end * 1e9), early=round(early * 1e9))
        for begin, end, early in table_of_pushes(path)))


# -- Figures of collisions: how alarms are judged by the pushes that are known.
#
# A push counts as found if an event falls between its start and shortly after its end. Its latency
# runs from the start of the force to the sample at which the detector is sure.

RECENT = 60  # estimates of a contact before an event that may belong to it: 0.3 s at 200 Hz
LATE = 0.3  # after the end of a push an event still counts as found [s]
AFTERMATH = 2.0  # after the end of a push an event is no false alarm: the arm still rings [s]


@dataclass(frozen=True)
class CollisionScore:
    """Figures of one method."""

    events: int  # events in all bags
    pushes: int  # pushes in the bags
    found: int  # those found
    detection_rate: float | None  # their ratio; None without pushes
    # From the start of the push to certainty, over those found, 0 within its tolerance [s].
    latency_median: float | None
    latency_p95: float | None
    false_alarms: int | None  # in bags of known pushes; None without such bags
    hours: float  # judged time without a push in those bags [h]
    false_alarms_per_hour: float | None  # false alarms over those hours [1/h]
    unjudged: float = 0.0  # time in gaps between judged samples of those bags [h]

    def as_dict(self) -> dict[str, Any]:
        """Give the figures as JSON-ready dictionary."""
        return asdict(self)

    def kept(self, per_hour: float) -> dict[str, float] | None:
        """Compare false alarms with those promised: ratio, exact Poisson interval of 90 %."""
        if not self.hours:
            return None
        count, promised = self.false_alarms or 0, per_hour * self.hours
        low, high = poisson_interval(count)
        return {'promised': promised, 'ratio': count / promised, 'low': low / promised,
                'high': high / promised}


@dataclass(eq=False)
class DetectedEvent:
    """One event of a bag, as a person wants to know of it; it grows until it is over."""

    event: CollisionEvent  # what was found
    time: float  # from the first sample of the bag to certainty [s]
    channel: str  # joint or gauge that stood furthest above its threshold
    ratio: float  # largest ratio to the collision threshold while it lasted
    seconds: float  # from the first sample above the threshold to the last
    push: int | None = None  # place of the push that it belongs to; None without one
    touched: ContactRecord | None = None  # where contacts are estimated
    no_contact: str = ''  # why they are not

    @cached_property
    def contact(self) -> dict[str, Any] | None:
        """Say what touched the arm, by `ContactRecord.summary`; None where that is unknown."""
        return None if self.touched is None else self.touched.summary() or None

    @property
    def note(self) -> str:
        """Say what of force and place is not known, why, and what would show it; or nothing."""
        if self.contact is not None:
            return str(self.contact['note'])
        return self.no_contact and f'force and place are not known: {self.no_contact}'

    def as_dict(self) -> dict[str, Any]:
        """Give it as JSON-ready dictionary."""
        return {'time': self.time, 'stamp': self.event.stamp, 'onset': self.event.onset,
                'time_of_day': time_of_day(self.event.onset),
                'link': self.event.link, 'channel': self.channel, 'ratio': self.ratio,
                'seconds': self.seconds, 'push': self.push, 'contact': self.contact,
                'note': self.note}


@dataclass(frozen=True, eq=False, repr=False)
class WatchedBag(Shown):
    """One bag as one method, or all together, saw it."""

    bag: str  # path of the bag
    stamp: NDArray[np.int64]  # samples with a residual, (samples,) [ns]
    ratio: FloatArray  # (samples,): largest ratio that held for the debounce time
    truth: Truth  # pushes that there were
    sightings: tuple[DetectedEvent, ...]  # what was found
    heard: NDArray[np.int64]  # all samples of the bag [ns]

    @property
    def alarms(self) -> NDArray[np.int64]:
        """Stamps at which the detector was sure [ns]."""
        return np.array([item.event.stamp for item in self.sightings], dtype=np.int64)

    def unjudged(self, begin: int, end: int) -> int:
        """Give the time between stamps that is in gaps, more than a period after a sample [ns]."""
        last = np.flatnonzero(np.diff(self.stamp) > gap_limit(self.heard) * 1e9)
        since = self.stamp[last] + int(np.median(np.diff(self.heard)))
        gaps = np.minimum(self.stamp[last + 1], end) - np.maximum(since, begin)
        return int(np.maximum(gaps, 0).sum())

    @property
    def not_judged(self) -> float:
        """Give the share of the bag since the first judged sample that is not; 1 without any."""
        if not len(self.stamp):
            return 1.0
        first, last, end = int(self.stamp[0]), int(self.stamp[-1]), int(self.heard[-1])
        return (self.unjudged(first, last) + end - last) / max(end - first, 1)


def push_of(stamp: int, pushes: Sequence[KnownPush]) -> int | None:
    """Find the push that an event at a stamp [ns] belongs to; None after its aftermath."""
    begun = [i for i, push in enumerate(pushes) if push.begin - push.early <= stamp]
    if not begun or stamp > pushes[begun[-1]].end + round(AFTERMATH * 1e9):
        return None
    return begun[-1]


def score(watched: Sequence[WatchedBag]) -> CollisionScore:
    """Judge alarms by the pushes."""
    latencies, pushes, false, free, lost = [], 0, 0, 0.0, 0
    for item in watched:
        if not item.truth.known:
            continue
        times = item.alarms
        first, last = item.stamp[[0, -1]].tolist() if len(item.stamp) else (0, 0)
        gaps = item.unjudged(first, last)
        span, lost = (last - first - gaps) * 1e-9, lost + gaps
        for push in item.truth.pushes:
            pushes += 1
            over = push.end + round(AFTERMATH * 1e9)
            span -= (over - push.begin - item.unjudged(push.begin, over)) * 1e-9
            begun = times >= push.begin - push.early
            hits = times[begun & (times <= push.end + round(LATE * 1e9))]
            if len(hits):
                latencies.append(max(0.0, float(hits[0] - push.begin) * 1e-9))
        false += sum(push_of(stamp, item.truth.pushes) is None for stamp in times.tolist())
        free += max(span, 0.0)
    hours = free / 3600.0
    known = any(item.truth.known for item in watched)
    return CollisionScore(
        sum(len(item.sightings) for item in watched),
        pushes, len(latencies), len(latencies) / pushes if pushes else None,
        float(np.median(latencies)) if latencies else None,
        float(np.percentile(latencies, 95)) if latencies else None,
        false if known else None, hours, false / hours if known and hours > 0 else None,
        lost * 1e-9 / 3600.0)


# -- Pushes found against false events, as thresholds sink
#
# A push counts by the largest ratio in its time, free motion by that of each second: alarms that
# last do not merge into one, and a lower threshold never finds less.

@dataclass(frozen=True, eq=False, repr=False)
class Roc(Shown):
    """Receiver operating characteristic of one method; intervals are exact ones of 90 %."""

    factor: FloatArray  # thresholds, as multiples of those in force, falling, (points,)
    found: NDArray[np.int64]  # pushes found, (points,)
    false: NDArray[np.int64]  # seconds of free motion with a false event, (points,)
    pushes: int
    hours: float  # free time [h]
    windows: int  # seconds of free motion that were judged

    @property
    def now(self) -> int:
        """Place of the thresholds in force."""
        return int(np.argmin(np.abs(self.factor - 1.0)))

    def per_hour(self) -> FloatArray:
        """Give false events per hour, (points,)."""
        return self.false / max(self.hours, 1e-9)

    def share(self) -> FloatArray:
        """Give pushes found [%], (points,)."""
        return 100.0 * self.found / max(self.pushes, 1)

    def found_interval(self) -> tuple[FloatArray, FloatArray]:
        """Give bounds of the share of pushes found (Clopper and Pearson) [%], (points,) each."""
        missed = self.pushes - self.found
        low = np.where(self.found > 0, betaincinv(np.maximum(self.found, 1), missed + 1, 0.05), 0)
        high = np.where(missed > 0, betaincinv(self.found + 1, np.maximum(missed, 1), 0.95), 1)
        return 100.0 * low, 100.0 * high

    def false_interval(self, place: int) -> tuple[float, float]:
        """Give bounds of the false events per hour at a point."""
        low, high = poisson_interval(int(self.false[place]))
        return low / max(self.hours, 1e-9), high / max(self.hours, 1e-9)

    def __iter__(self) -> Iterator[tuple[float, float, float]]:
        """Give factor, false events per hour and share of the pushes found, point by point."""
        return zip(self.factor.tolist(), self.per_hour().tolist(), (0.01 * self.share()).tolist(),
                   strict=True)


def poisson_interval(count: int) -> tuple[float, float]:
    """Give exact bounds (90 %) of the number of events to be expected where so many came."""
    return float(gammaincinv(count, 0.05)) if count else 0.0, float(gammaincinv(count + 1, 0.95))


FACTORS = np.array([*np.geomspace(0.1, 10.0, 81), 1.0])  # multiples of a threshold that are judged


def roc_of(watched: Sequence[WatchedBag], hours: float, grid: FloatArray = FACTORS) -> Roc:
    """Judge each threshold by the peaks of pushes and of the seconds between them."""
    touched, free = [], []
    for item in watched:
        if not item.truth.known or not len(item.stamp):
            continue
        near = np.zeros(len(item.stamp), dtype=bool)
        for push in item.truth.pushes:
            begun = item.stamp >= push.begin - push.early
            within_it = begun & (item.stamp <= push.end + round(LATE * 1e9))
            touched.append(float(item.ratio[within_it].max(initial=0.0)))
            near |= begun & (item.stamp <= push.end + round(AFTERMATH * 1e9))
        second = ((item.stamp - item.stamp[0]) // round(BLOCK * 1e9))[~near]
        if len(second):
            first = np.flatnonzero(np.diff(second, prepend=-1))
            free += np.maximum.reduceat(item.ratio[~near], first).tolist()
    # each push that shows has a point just below its peak
    shown = [peak for peak in touched if peak > 0.0]
    factor = np.unique([*grid, *np.nextafter(shown, 0.0)])[::-1]
    found, false = (np.asarray(np.sum(np.array(peaks)[:, None] > factor, axis=0))
                    for peaks in (touched, free))
    return Roc(factor, found, false, len(touched), hours, len(free))


# -- How well collisions are found: recordings replayed past every method of detection

ALL = 'all'  # in place of a method: those of a monitor, which share the false alarms allowed


@dataclass(frozen=True, eq=False, repr=False)
class MethodResult(Shown):
    """Result of one method, or of all together."""

    method: str  # `strain`, `effort` or `momentum` alone; `all` for all as the monitor runs
    score: CollisionScore  # figures at the thresholds asked for
    watched: tuple[WatchedBag, ...]  # bags that were replayed
    roc: Roc  # what other thresholds would have found


@dataclass(slots=True)
class EventLog:
    """What a detector makes of a bag, sample after sample."""

    first: int  # stamp of the first sample of the bag [ns]
    truth: Truth  # pushes that there were
    ratios: dict[str, list[tuple[int, float]]] = field(default_factory=dict)  # of each method
    events: list[DetectedEvent] = field(default_factory=list)
    under_way: DetectedEvent | None = None  # the last of the events, until it is over
    # Contacts of the last moments: a touch begins before the detector is sure.
    recent: deque[ContactEstimate] = field(default_factory=lambda: deque(maxlen=RECENT))

    def add(self, found: Found, watch: Watch) -> None:
        """Take the samples that became known, and the level after them."""
        now = self.under_way
        for method, excess in found.excesses:
            stamp, ratio = excess.residual.motion.stamp, float(excess.collision.max())
            self.ratios.setdefault(method, []).append((stamp, ratio))
            if now is not None and ratio >= 1.0 and method == now.event.method:
                now.seconds = (stamp - now.event.onset) * 1e-9
                if ratio > now.ratio:
                    now.ratio = ratio
                    now.channel = list(now.event.ratios)[int(np.argmax(excess.collision))]
        for event in found.events:
            now = DetectedEvent(
                event, (event.stamp - self.first) * 1e-9, event.channel,
                event.ratios[event.channel], (event.stamp - event.onset) * 1e-9,
                push_of(event.stamp, self.truth.pushes),
                None if watch.contact is None else watch.contact.record(), watch.no_contact)
            self.events.append(now)
            if now.touched is not None:
                now.touched.add(*self.recent)
        self.recent.extend(found.contacts)
        if now is not None and now.touched is not None:
            now.touched.add(*found.contacts)
        self.under_way = now if watch.level is Level.COLLISION else None

    def watched(self, name: str, heard: NDArray[np.int64], debounce: float) -> WatchedBag:
        """Give the bag as it was seen, of several methods the larger ratio."""
        held: dict[int, float] = {}
        for found in self.ratios.values():
            at, ratio = (np.array(values) for values in zip(*found, strict=True))
            since = np.searchsorted(at, at - round(debounce * 1e9))
            for k, (stamp, a) in enumerate(zip(at.tolist(), since.tolist(), strict=True)):
                held[stamp] = max(held.get(stamp, 0.0), float(ratio[a:k + 1].min()))
        stamps = np.array(sorted(held), dtype=np.int64)
        return WatchedBag(name, stamps, np.array([held[stamp] for stamp in stamps.tolist()]),
                          self.truth, tuple(self.events), heard)


def watch_bag(
    bundle: ModelBundle, settings: dict[str, MonitorSettings], name: str, recording: Recording,
    truth: Truth,
) -> dict[str, WatchedBag]:
    """Replay one bag past monitors, by name: one filter and predictor, a detector for each."""
    bundle = bundle.beside_robot()
    common = next(iter(settings.values()))
    front, predictor = (StateFilter(bundle.preprocessing, common.gap),
                        Predictor(bundle, common.kind))
    watches = {key: Watch(bundle, one) for key, one in settings.items()}
    logs = {key: EventLog(int(recording.stamp[0]), truth) for key in settings}
    for k, stamp in enumerate(recording.stamp.tolist()):
        motion = front.step(stamp, recording.q[k],
                            None if recording.dq is None else recording.dq[k])
        predicted = None if motion is None else predictor.step(motion)
        if recording.strain is not None:
            predictor.add_strain(stamp, recording.strain[k])
        for key, watch in watches.items():
            if motion is not None:
                logs[key].add(watch.add_motion(motion, predicted), watch)
            for output in watch.outputs:
                if (values := getattr(recording, output)) is not None:
                    logs[key].add(watch.add_measured(output, stamp, values[k]), watch)
    return {key: log.watched(name, recording.stamp, settings[key].detector.debounce)
            for key, log in logs.items()}


def evaluate_collisions(
    bundle: ModelBundle, bags: Sequence[tuple[str, Recording]], settings: MonitorSettings,
    truths: Sequence[Truth],
) -> list[MethodResult]:
    """Evaluate all methods together, then each that has models, thresholds and signals alone."""
    every = replace(settings, methods=())
    stages = Watch(bundle, every).stages
    chosen = {method: replace(settings, methods=(method,)) for method in stages if all(
        getattr(recording, SOURCE[method]) is not None for _, recording in bags)}
    if not chosen:
        raise UsageError('the model has no collision thresholds for efforts or strains of these '
                         'bags; fit again with more bags in which nothing touches the arm')
    if len(stages) > 1:  # also where some have no signals: their share of false alarms is theirs
        chosen = {ALL: every, **chosen}
    seen = [watch_bag(bundle, chosen, path, recording, within(truth, recording))
            for (path, recording), truth in zip(bags, truths, strict=True)]
    by_method = {method: tuple(item[method] for item in seen) for method in chosen}
    return [MethodResult(method, found, watched, roc_of(watched, found.hours))
            for method, watched in by_method.items() for found in [score(watched)]]


UTC = 'began\nUTC'
NOTABLE = 0.01  # share of a bag that is not judged, from which on it is said
EVENT_NAMES = ('method', 'channel', 'push', 'link')
EVENT_FIGURES = ('began\n[s]', UTC, 'ratio', 'force\n[N]', 'place\n[mm]')


def event_table(
    results: Sequence[MethodResult], place: int,
) -> tuple[str, list[str], list[list[str]]]:
    """Give when a bag begins, the names of known figures of its events, and rows of texts."""
    found = sorted(((item.method, seen, item.watched[place].truth) for item in results
                    for seen in item.watched[place].sightings), key=lambda row: row[1].time)
    first = int(results[0].watched[place].heard[0])
    rows: list[tuple[str, ...]] = []
    for method, seen, truth in found:
        push, contact = '?' if not truth.known else 'none: false', seen.contact
        if seen.push is not None:
            force = truth.pushes[seen.push].force
            push = f'{seen.push + 1}' + ('' if math.isnan(force) else f' ({force:.3g} N)')
        rows.append((method, seen.channel, push, contact['link'] if contact else seen.event.link,
                     f'{(seen.event.onset - first) * 1e-9:.2f}',
                     time_of_day(seen.event.onset).split()[1],
                     f'{seen.ratio:.1f}', *_force_and_place(contact)))
    rest = range(len(EVENT_NAMES), len(EVENT_NAMES + EVENT_FIGURES))
    known = [k for k in rest if any(row[k] != '-' for row in rows)]
    return (time_of_day(first), [(EVENT_NAMES + EVENT_FIGURES)[k] for k in known],
            [[*row[:len(EVENT_NAMES)], *(row[k] for k in known)] for row in rows])


def _force_and_place(contact: dict[str, Any] | None) -> tuple[str, str]:
    if not contact:
        return '-', '-'
    force, place, other = contact['force'], contact['place'], contact['or_place']
    return ('not known' if force is None else f'{force:.1f} +- {contact["force_deviation"]:.1f}',
            'not known' if place is None else (
                f'{1e3 * place:.0f} +- {1e3 * contact["place_deviation"]:.0f}')
            + ('' if other is None else f' or {1e3 * other:.0f}'))


def event_notes(results: Sequence[MethodResult]) -> list[str]:
    """Say what was not judged, and what of forces and places is not known, each reason once."""
    return [f'{bag.bag}: {100.0 * bag.not_judged:.0f} % of the time was not judged: gaps, and '
            'filters that settle after them' for bag in results[0].watched
            if bag.not_judged > NOTABLE
            ] + list(dict.fromkeys(f'{item.method}: {seen.note}' for item in results
                                   for bag in item.watched for seen in bag.sightings if seen.note))


class Detector(Protocol):
    """A detector of one's own, such as a function."""

    def __call__(self, recording: Recording, /) -> FloatArray:
        """Give for each sample, (samples,), how likely a touch is, in any unit; NaN for none."""


def roc_of_detector(
    detector: Detector, bags: Sequence[tuple[str, Recording]], truths: Sequence[Truth],
) -> Roc:
    """Judge a detector of one's own by what is known of the pushes."""
    watched = []
    for (path, recording), truth in zip(bags, truths, strict=True):
        said = np.asarray(detector(recording), dtype=float)
        if said.shape != recording.stamp.shape or np.isinf(said).any():
            raise SignalError(f'the detector returned an array of shape {said.shape} for {path}; '
                              f'expected {recording.stamp.shape}: one number per sample, no inf')
        judged = ~np.isnan(said)
        watched.append(WatchedBag(path, recording.stamp[judged], said[judged],
                                  within(truth, recording), (), recording.stamp))
    grid = np.concatenate([item.ratio for item in watched])
    if not (grid > 0.0).any():
        raise SignalError('the detector returned no value above zero; return one during pushes')
    grid = np.quantile(grid[grid > 0.0], np.linspace(0.0, 1.0, 101))
    return roc_of(watched, score(watched).hours, grid)


def within(truth: Truth, recording: Recording) -> Truth:
    """Leave out pushes outside a recording, which may be a part of a bag."""
    begin, end = recording.stamp[0], recording.stamp[-1]
    return replace(truth, pushes=tuple(push for push in truth.pushes
                                       if begin <= push.begin and push.end <= end))
