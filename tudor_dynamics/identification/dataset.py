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

"""Recordings ready for models: which bags and parts, with which payload, filtered how."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
import glob
import os
from pathlib import Path
import re
from typing import Any, TypeVar
import warnings

import numpy as np

from tudor_dynamics.arm.description import Arm, OUTPUTS
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.info import recorded_names
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.storage import bags_below, natural
from tudor_dynamics.errors import check_type, FitError, quiet, TudorError, TudorWarning, UsageError
from tudor_dynamics.models.base import Blocks, MemorylessModel, Model, Range, SAME
from tudor_dynamics.signals.preprocessing import prepare, retimed, Stretch, Timing, TrainingBlock


# -- Where a recording moves, but for standstill in the middle

STANDSTILL = 2e-3  # part of the largest motion of any joint that is no motion yet
STANDSTILL_KEPT = 0.5
"""Standstill before and after the motion that stays, for ringing and breaking away [s]."""


def motion_span(recording: Recording) -> tuple[float, float]:
    """Find begin and end of the motion of a recording [s]; standstill in the middle counts."""
    # Friction that holds a joint has a sign that no model knows, and a long wait before or after
    # the motion would count as much as the motion.
    t, q = recording.t, recording.q
    bound = STANDSTILL * max(float(np.ptp(q, axis=0).max(initial=0.0)), 1e-300)
    away = np.flatnonzero(np.any(np.abs(q - q[0]) > bound, axis=1))
    back = np.flatnonzero(np.any(np.abs(q - q[-1]) > bound, axis=1))
    if not len(away):
        return 0.0, float(t[-1])
    begin, end = float(t[away[0]]) - STANDSTILL_KEPT, float(t[back[-1]]) + STANDSTILL_KEPT
    return (begin if begin > STANDSTILL_KEPT else 0.0,
            end if end < t[-1] - STANDSTILL_KEPT else float(t[-1]))


def standstill_note(recording: Recording) -> str:
    """Say what of a recording is left out because nothing moves."""
    span = motion_span(recording)
    parts = [f'{length:.1f} s at the {end}' for length, end in (
        (span[0], 'start'), (float(recording.t[-1]) - span[1], 'end')) if length > 0.0]
    return f'standstill of {" and ".join(parts)} is left out' if parts else ''


# -- Which bag, and which part of it: as arguments of commands name it

Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]


@dataclass(frozen=True)
class BagChoice:
    """A bag, or a part of it by time."""

    path: str  # bag directory or file
    # Part used, as fractions of its duration, or since its first sample [s].
    begin: float = 0.0
    end: float = 1.0
    seconds: bool = False  # whether begin and end are times
    # Of the recording, where it was read; needed to compare times with fractions [s].
    duration: float | None = field(default=None, compare=False)

    def overlaps(self, other: BagChoice) -> bool:
        """Say whether another choice of the same recording has samples of this one."""
        # times and fractions can be compared once one of the two was read; before, they are not
        # said to overlap
        duration = self.duration or other.duration
        if duration is None and self.seconds != other.seconds:
            return False
        own, others = (one.span(duration or 1.0) for one in (self, other))
        return own[0] < others[1] and others[0] < own[1]

    def span(self, duration: float) -> tuple[float, float]:
        """Give begin and end as times: duration [s]; returns begin, end [s]."""
        scale = 1.0 if self.seconds else duration
        return self.begin * scale, self.end * scale

    def within(self, begin: float, end: float) -> BagChoice:
        """Give a part of this one, by fractions of it."""
        width = self.end - self.begin
        return replace(self, begin=self.begin + begin * width, end=self.begin + end * width)

    def __str__(self) -> str:
        """Write the choice as it is written on the command line."""
        if self.seconds:
            return f'{self.path}@{self.begin:g}s-{self.end:g}s'
        if (self.begin, self.end) == (0.0, 1.0):
            return self.path
        return f'{self.path}@{100 * self.begin:g}-{100 * self.end:g}%'


def parse_choice(text: str) -> BagChoice:
    """Read a bag argument: ``PATH``, ``PATH@BEGIN-END%`` or ``PATH@BEGINs-ENDs``."""
    match = re.fullmatch(r'(.+)@(\d+(?:\.\d+)?)(s-|-)(\d+(?:\.\d+)?)(s|%)', text)
    if match is None or (match[3] == 's-') != (match[5] == 's'):
        return BagChoice(text)
    path, first, _, last, unit = match.groups()
    if unit == 's':
        choice = BagChoice(path, float(first), float(last), seconds=True)
        if not choice.begin < choice.end < float('inf'):
            raise UsageError(f'{text}: the part {first}s-{last}s is empty; give the earlier time '
                             f'first, such as {path}@5s-50s')
        return choice
    choice = BagChoice(path, float(first) / 100.0, float(last) / 100.0)
    if not choice.begin < choice.end <= 1.0:
        raise UsageError(f'{text}: the part {first}-{last}% is empty or outside 0-100%; give two '
                         f'shares of the bag, the smaller first, such as {path}@0-60%')
    return choice


def choices(bags: Paths, name: str = 'bags') -> list[BagChoice]:
    """Read the names of bags, one or several."""
    if isinstance(bags, (str, os.PathLike)):
        bags = [bags]
    advice = 'give the path of a bag, or a list of paths'
    check_type(bags, (list, tuple), name, advice)
    for bag in bags:
        check_type(bag, (str, os.PathLike), f'one of {name}', advice)
    return [parse_choice(os.fspath(bag)) for bag in bags]


def found_choices(texts: Sequence[str]) -> list[BagChoice]:
    """Read bag arguments, among them folders of bags and patterns such as ``'bags/2026-*'``."""
    found: list[BagChoice] = []
    for text in texts:
        choice = parse_choice(text)
        if os.path.lexists(choice.path) or not glob.has_magic(choice.path):
            paths = [Path(choice.path)]
        else:
            paths = sorted(map(Path, glob.glob(choice.path)), key=natural)
            if not paths:
                raise UsageError(f'{text}: no file has such a name', remedy='name a bag, or a '
                                 'folder of bags')
        below = [bag for path in paths for bag in bags_below(path)]
        found += [choice] if below == [Path(choice.path)] else [
            replace(choice, path=str(bag)) for bag in below]
    return found


def check_choices(training: Sequence[BagChoice], test: Sequence[BagChoice]) -> None:
    """Refuse parts of one bag that overlap."""
    if not training:
        raise UsageError('there is no bag to learn from; give the paths of one or more bags')
    known: dict[Path, list[BagChoice]] = {}
    for number, other in enumerate((*training, *test)):
        same = known.setdefault(Path(other.path).resolve(), [])
        for one in same:
            if one.overlaps(other):
                msg = (f'{one} and {other} overlap, so samples would count twice; name parts that '
                       'do not overlap, such as BAG@0-60% and BAG@60-100%')
                raise UsageError(msg)
        if number < len(training):
            same.append(other)


def with_recorded_gauges(arm: Arm, bags: Sequence[BagChoice]) -> Arm:
    """Leave out gauges of the description that no bag has, where bags have others."""
    if len(arm.gauges) < 2 or any(gauge.interface or gauge.index is not None
                                  for gauge in arm.gauges):
        return arm
    topics = {gauge.topic for gauge in arm.gauges}
    found = frozenset[str]().union(*(recorded_names(path, topics)
                                     for path in dict.fromkeys(bag.path for bag in bags)))
    missing = [name for name in arm.gauge_names if name not in found]
    damped = () if arm.spec.damper is None else arm.spec.damper.joints
    if not missing or len(missing) == len(arm.gauges) or {*missing} & {i.gauge for i in damped}:
        return arm
    msg = (f'arm {arm.name!r}: no bag has the strain of {", ".join(map(repr, missing))}, so no '
           'model of it is fitted; record it, or remove it from the key gauges of the description')
    warnings.warn(msg, TudorWarning, stacklevel=2)
    return arm.with_gauges(found)


# -- Recordings made ready for models: which bags, which part of them, filtered how

SAMPLE = 8
"""Of many bags those that stay in memory, for choices, thresholds and figures; what they take is
in bench/many_bags.py."""
Item = TypeVar('Item')


@dataclass(frozen=True, eq=False)
class BagData:
    """One bag, ready for models."""

    choice: BagChoice  # bag and part
    recording: Recording  # signals as read (the part chosen)
    stretches: tuple[Stretch, ...]  # gapless stretches, filtered
    payload: float | None = None  # mass at the tip, where it is known [kg]
    timing: Timing | None = None  # why even stamps took the place of those recorded

    def has(self, output: str) -> bool:
        """Say whether the bag has an output, ``effort`` or ``strain``."""
        return getattr(self.recording, output) is not None

    @property
    def samples(self) -> int:
        """Give the number of samples used, after decimation."""
        return sum(stretch.n_kept for stretch in self.stretches)


@dataclass(frozen=True)
class SurveyedBag:
    """A bag before it is read."""

    choice: BagChoice  # bag, or part of one, as it was given
    checksum: str  # SHA-256 over its storage files
    payload: float | None = None  # mass at the tip, as given or as its metadata say [kg]
    fold: int = -1  # which bags it is left out with


def cut(recording: Recording, choice: BagChoice) -> Recording:
    """Take a part of a recording by time."""
    if (choice.begin, choice.end, choice.seconds) == (0.0, 1.0, False):
        return recording
    t = recording.t
    begin, end = choice.span(float(t[-1]))
    if end > t[-1] + recording.dt:
        msg = (f'{choice}: the recording lasts {t[-1]:.4g} s; name a part that ends before')
        raise UsageError(msg)
    first, last = np.searchsorted(t, [begin, end]).tolist()
    if end >= t[-1]:
        last = len(t)
    segments = tuple(
        slice(start, stop) for part in recording.segments
        if (start := max(part.start, first) - first) < (stop := min(part.stop, last) - first))
    if not segments:
        before, after = float(t[first - 1]), float(t[first])
        raise UsageError(f'{choice.path}: nothing was recorded from {before:.4g} to '
                         f'{after:.4g} s; give the parts before and after that as two bags: '
                         f'{choice.path}@0s-{before:.4g}s {choice.path}@{after:.4g}s-{t[-1]:.4g}s')

    start = next((part.start for part in recording.segments
                  if part.start < first < part.stop), first)
    earlier = (recording.stamp[start:first], recording.q[start:first]) if start < first else None
    if start == 0 and recording.earlier is not None:
        stamps, places = recording.earlier
        earlier = (np.concatenate([stamps, recording.stamp[:first]]),
                   np.vstack([places, recording.q[:first]]))
    taken = {name: values[first:last] for name in ('stamp', 'q', 'dq', 'effort', 'strain', 'push')
             if (values := getattr(recording, name)) is not None}
    return replace(recording, **taken, segments=segments, earlier=earlier)


def load(
    choice: BagChoice, arm: Arm, preprocessing: PreprocessingSpec | None, *, learn: bool = False,
    payload: float | None = None, whole: bool = False,
) -> BagData:
    """Read a bag, payload in [kg]; without preprocessing as a monitor hears it, stamp by stamp."""
    read = read_recording(choice.path, arm, need_output=True, need_motion=learn)
    full, timing = (read, None) if preprocessing is None else retimed(read)
    bag = BagData(replace(choice, duration=float(full.t[-1])), cut(full, choice), (),
                  full.payload if payload is None else payload, timing)
    if preprocessing is None:
        return bag
    if whole:
        return replace(bag, stretches=tuple(prepare(bag.recording, preprocessing)))
    if note := standstill_note(bag.recording):
        bag = replace(bag, recording=replace(
            bag.recording, warnings=(*bag.recording.warnings, note)))
    return filtered(bag, preprocessing)


def spread_sample(items: Sequence[Item], read: Callable[[Item], BagData]) -> list[BagData]:
    """Read some, evenly among all; one that cannot be read is reported by a later pass."""
    found = []
    with quiet():
        for i in range(SAMPLE):
            for item in items[i * len(items) // SAMPLE:(i + 1) * len(items) // SAMPLE]:
                try:
                    found.append(read(item))
                except TudorError:
                    continue
                break
    return found


def filtered(bag: BagData, preprocessing: PreprocessingSpec) -> BagData:
    """Filter the recording of a bag, and leave out standstill at its ends."""
    begin, end = motion_span(bag.recording)
    stretches = []
    for stretch in prepare(bag.recording, preprocessing):
        t = stretch.t[stretch.decimation.keep]
        inside = stretch.decimation.keep[(t >= begin) & (t <= end)]
        if len(inside) >= 2:
            stretches.append(replace(stretch, decimation=replace(stretch.decimation, keep=inside)))
    return replace(bag, stretches=tuple(stretches or prepare(bag.recording, preprocessing)))


def part(bag: BagData, begin: float, end: float, preprocessing: PreprocessingSpec) -> BagData:
    """Take a part of a bag by time, filtered on its own."""
    recording = cut(bag.recording, BagChoice(bag.choice.path, begin, end))
    named = bag.choice.within(begin, end)
    return filtered(BagData(named, recording, (), bag.payload), preprocessing)


def training_blocks(data: Sequence[BagData], output: str, model: MemorylessModel) -> Blocks:
    """Give the training data of one output from several bags, as a model takes it."""
    def blocks() -> Iterator[TrainingBlock]:
        for bag in data:
            for stretch in bag.stretches:
                motion = model.inputs(stretch)
                if model.payload_range is not None:
                    motion = np.column_stack([motion, np.full(len(motion), bag.payload)])
                yield from stretch.blocks(output, motion)
    return blocks


def all_stretches(data: Iterable[BagData]) -> Iterator[Stretch]:
    """Go through the stretches of several bags."""
    for bag in data:
        yield from bag.stretches


def refuse_copies(training: Sequence[BagData], test: Sequence[BagData]) -> None:
    """Refuse bags with the same samples: such a bag is no test of another."""
    for i, one in enumerate(training):
        for other in (*training[i + 1:], *test):
            same = one.recording.checksum == other.recording.checksum != ''
            if same and one.choice.overlaps(other.choice):
                raise FitError(f'{other.choice} has the same samples as the training bag '
                               f'{one.choice}, so it does not test the model; give another '
                               'recording in its place')


def common_outputs(data: Sequence[BagData]) -> tuple[str, ...]:
    """Say which outputs all the bags have."""
    return tuple(output for output in OUTPUTS if data and all(bag.has(output) for bag in data))


# -- What is known of a bag once it was read: for bundles, pages and JSON, without its samples

@dataclass(frozen=True)
class BagFacts:
    """A bag that was used."""

    bag: str  # bag, or part of one, as it was given
    checksum: str  # SHA-256 over its storage files
    # Samples as recorded, and those that are left after decimation.
    recorded: int
    used: int
    # Length [s] and samples per second as recorded [Hz].
    duration: float
    rate: float
    gaps: int = 0  # number of gaps
    longest_gap: float = 0.0  # length of the longest [s]
    dropped: Mapping[str, int] = field(default_factory=dict)  # messages left out, by cause
    payload: float | None = None  # mass at the tip, where it is known [kg]
    warnings: tuple[str, ...] = ()  # what was noted when it was read

    def as_dict(self) -> dict[str, Any]:
        """Say which bag was used, so that it can be found and checked again."""
        facts = {'bag': self.bag, 'sha256': self.checksum, 'samples': self.used,
                 'duration': round(self.duration, 6), 'dropped': dict(self.dropped)}
        return facts if self.payload is None else {**facts, 'payload': self.payload}


@dataclass(frozen=True)
class Unused:
    """A bag that was left out."""

    bag: str  # bag, or part of one, as it was given
    why: str  # what is wrong with it, on one line

    def __str__(self) -> str:
        """Write it on one line."""
        return f'{self.bag!r}: {self.why.removeprefix(f"{self.bag}: ")}'


def facts_of(bag: BagData) -> BagFacts:
    """Give what is known of a bag."""
    recording = bag.recording
    t, parts = recording.t, recording.segments
    holes = [float(t[after.start] - t[before.stop - 1])
             for before, after in zip(parts, parts[1:], strict=False)]
    return BagFacts(
        str(bag.choice), recording.checksum, len(t), bag.samples, float(t[-1]),
        1.0 / recording.dt, len(holes), max(holes, default=0.0), dict(recording.dropped),
        bag.payload, recording.warnings)


# -- Which payload each bag was recorded with, and models that know of it

def parse_payloads(texts: Sequence[str], choices: Sequence[BagChoice]) -> dict[str, float]:
    """Read ``BAG=KG`` arguments [kg]."""
    known = {str(Path(choice.path).resolve()) for choice in choices}
    found = {}
    for text in texts:
        path, _, number = text.rpartition('=')
        try:
            mass = float(number)
        except ValueError:
            mass = -1.0
        if not path or not 0.0 <= mass < float('inf'):
            raise UsageError(f'payload_of= {text}: expected BAG=KG, 0 kg or more, as in run1=0.2')
        resolved = str(Path(path).resolve())
        if resolved not in known:
            raise UsageError(f'payload_of= {text}: {path!r} is not among the bags of the '
                             'command; write it exactly as in the list of bags')
        found[resolved] = mass
    return found


def payload_range(
    training: Sequence[BagData | SurveyedBag], test: Sequence[BagData | SurveyedBag],
) -> Range | None:
    """Find the least and largest payload of training bags [kg]; None where they do not differ."""
    masses = [bag.payload for bag in training if bag.payload is not None]
    if not masses or max(masses) - min(masses) < SAME:
        return None
    unknown = [repr(str(bag.choice)) for bag in (*training, *test) if bag.payload is None]
    if unknown:
        raise UsageError(f'training bags have loads of {min(masses):g} to {max(masses):g} kg, '
                         f'but that of bag {", ".join(unknown)} is not known; state it (tudor fit '
                         '--payload-of BAG=KG), or ignore all loads (--ignore-payload)')
    return min(masses), max(masses)


def model_for(model: Model, bag: BagData) -> Model:
    """Put the payload of a bag into a model that knows of payloads; others stay as they are."""
    if model.payload_range is not None:
        if bag.payload is None:
            raise UsageError(f'the load of bag {str(bag.choice)!r} is not known, but the model '
                             'needs it', remedy='give payload= in kg, or write custom_data: '
                             '{payload: KG} into metadata.yaml of the bag')
        return model.at(bag.payload)
    return model
