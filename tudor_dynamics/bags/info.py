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

"""What is in a bag, what it can be used for, and what is implausible about it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.bags.messages import DecodedTopic, JOINT_STATE, load_topics, NAMED
from tudor_dynamics.bags.reader import assemble, increasing
from tudor_dynamics.bags.recording import (
    ChannelSource, gap_limit, plan_from_arm, Recording, Sources, split_at_gaps)
from tudor_dynamics.bags.settings import MANY_TURNS
from tudor_dynamics.bags.storage import Bag, open_bag
from tudor_dynamics.errors import BagError
from tudor_dynamics.typing import FloatArray


STRAIN_WORDS = ('strain', 'gauge')
"""A topic of JointState whose name has one of these carries strains, where no arm is given."""


def guess_plan(topics: Mapping[str, DecodedTopic]) -> Sources | None:
    """Guess an arm description from the topics alone; None where no topic has positions."""
    def with_field(what: str) -> dict[str, list[str]]:
        found = {}
        for name, states in topics.items():
            largest = max(states.having(what), key=lambda block: len(block.index), default=None)
            if largest is not None:
                found[name] = list(largest.layout.names)
        return found

    def is_strain(name: str) -> bool:
        return any(word in name.lower() for word in STRAIN_WORDS)

    topics = {name: states for name, states in topics.items() if states.msgtype == JOINT_STATE}
    positions, efforts = with_field('position'), with_field('effort')
    candidates = [name for name in positions if not is_strain(name)]
    if not candidates:
        return None
    topic = max(candidates, key=lambda name: (name.endswith('joint_states'),
                                              len(topics[name].stamp)))
    joints = tuple(dict.fromkeys(positions[topic]))
    sources = [name for name in (topic, *sorted(efforts))
               if set(joints) <= set(efforts.get(name, ()))]
    strains = {gauge: ChannelSource(name, gauge, 'position') for name, gauges in positions.items()
               if is_strain(name) for gauge in gauges}
    source = sources[0] if sources else topic
    return Sources(topic, joints, (False,) * len(joints), (MANY_TURNS,) * len(joints),
                   tuple(ChannelSource(source, joint, 'effort') for joint in joints),
                   tuple(strains), tuple(strains.values()))


@dataclass(frozen=True)
class ChannelReport:
    """One name in one field of a topic."""

    name: str  # joint or gauge
    field: str  # `position`, `velocity`, `effort`, `data` of an array, or an interface
    # Range of the finite values; None where there are none.
    minimum: float | None
    maximum: float | None
    not_finite: int  # NaN and infinite values


@dataclass(frozen=True)
class TopicReport:
    """A topic. Times are header stamps where these are set, else log times."""

    name: str  # of the topic
    type: str  # noqa: A003 (a key of the JSON output)
    count: int  # number of messages
    clock: str = 'log'  # `stamp` or `log`
    rate: float | None = None  # from the median time between messages [Hz]
    jitter: float | None = None  # standard deviation of that time, gaps left out [s]
    duration: float = 0.0  # from first to last message [s]
    # Number of gaps, and the longest [s].
    gaps: int = 0
    longest_gap: float = 0.0
    # Messages with a stamp that came before, or that lies back in time.
    duplicates: int = 0
    backward: int = 0
    names: list[str] = field(default_factory=list)  # joints or gauges
    fields: list[str] = field(default_factory=list)  # arrays that any message fills
    channels: list[ChannelReport] = field(default_factory=list)  # ranges of its joints or gauges


@dataclass(frozen=True)
class BagReport:
    """A bag."""

    # What was read, and its format.
    path: str
    storage: str
    files: list[str]  # names of the storage files
    size: int  # of these files [bytes]
    checksum: str  # SHA-256 over these files
    start: float | None  # log time of the first message [s]
    duration: float  # from the first to the last message of any topic [s]
    topics: list[TopicReport]  # topics by name
    # What can be learned from the bag.
    effort_model: bool
    strain_model: bool
    verdict: str  # the same in words, with the reason
    samples: int = 0  # aligned samples for that
    dropped: dict[str, int] = field(default_factory=dict)  # messages left out of these, by cause
    odd: list[str] = field(default_factory=list)  # what the user should know
    payload: float | None = None  # mass at the tip by the bag's own metadata [kg]
    recording: Recording | None = field(default=None, repr=False)  # None: too little
    plan: Sources | None = field(default=None, repr=False)  # names of its columns

    def as_dict(self) -> dict[str, Any]:
        """Give the report as it is printed with ``--json``."""
        content = asdict(replace(self, recording=None, plan=None))
        del content['recording'], content['plan']
        return content


def _times(stamp: NDArray[np.int64], clock: str) -> dict[str, Any]:
    if len(stamp) < 2:
        return {'clock': clock}
    keep, duplicate, backward = increasing(stamp)
    kept = stamp[keep]
    result: dict[str, Any] = {
        'clock': clock, 'duplicates': duplicate, 'backward': backward,
        'duration': float(kept[-1] - kept[0]) * 1e-9}
    if len(kept) > 1:
        steps = np.diff(kept)
        is_gap = steps * 1e-9 > gap_limit(kept)
        result |= {'rate': 1e9 / float(np.median(steps)), 'gaps': len(split_at_gaps(kept)) - 1,
                   'jitter': float(np.std(steps[~is_gap])) * 1e-9,
                   'longest_gap': float(steps[is_gap].max()) * 1e-9 if is_gap.any() else 0.0}
    return result


def _channels(states: DecodedTopic, names: list[str], fields: list[str]) -> list[ChannelReport]:
    found: dict[tuple[str, str], list[FloatArray]] = {}
    for block in states.blocks:
        for what in block.layout.fields:
            # an array may be shorter or longer than the names; the first of equal names counts
            columns = [*zip(block.layout.names, block.values(what).T, strict=False)]
            for name, column in dict(reversed(columns)).items():
                found.setdefault((name, what), []).append(column)
    reports = []
    for name, what in ((name, what) for name in names for what in fields if (name, what) in found):
        values = np.concatenate(found[name, what])
        finite = values[np.isfinite(values)].tolist()
        reports.append(ChannelReport(name, what, min(finite, default=None),
                                     max(finite, default=None), len(values) - len(finite)))
    return reports


def _topic_report(states: DecodedTopic) -> TopicReport:
    names = list(dict.fromkeys(one for block in states.blocks for one in block.layout.names))
    fields = list(dict.fromkeys(what for block in states.blocks for what in block.layout.fields
                                if block.layout.size(what)))
    unset = not states.stamp.any()
    times = _times(states.log_time if unset else states.stamp, 'log' if unset else 'stamp')
    return TopicReport(states.topic, states.msgtype, len(states.stamp), names=names,
                       fields=fields, channels=_channels(states, names, fields), **times)


def _verdict(bag: Bag, topics: Mapping[str, DecodedTopic], plan: Sources | None) -> dict[str, Any]:
    nothing = {'effort_model': False, 'strain_model': False}
    if plan is None:
        return nothing | {'verdict': 'nothing, as the bag has no joint positions; '
                          'record joint_states'}
    try:
        found = assemble(bag, topics, plan, need_output=True, need_motion=True, checksum=False)
    except BagError as err:
        return nothing | {'verdict': f'nothing, as {err.advice}'}
    models = [name for name, values in (('effort', found.effort), ('strain', found.strain))
              if values is not None]
    lacking = {'effort': '; no efforts', 'strain': '; no strains'}
    reason = ''.join(text for name, text in lacking.items() if name not in models)
    return {'effort_model': 'effort' in models, 'strain_model': 'strain' in models,
            'verdict': f'{" and ".join(models)} model{reason}', 'samples': len(found.stamp),
            'dropped': dict(found.dropped), 'recording': found}


def recorded_names(path: str | Path, topics: Collection[str]) -> frozenset[str]:
    """List whom the joint-state messages of some topics speak of."""
    bag = open_bag(path, quiet=True)
    there = set(bag.find(dict.fromkeys(topics, JOINT_STATE)).values())
    states = load_topics(bag, sorted(topic for topic in there if topic is not None))
    return frozenset(name for item in states.values() for block in item.blocks
                     for name in block.layout.names)


def describe(path: str | Path, arm: Arm | None = None) -> BagReport:
    """Describe a bag; arm: guessed from the topics by default."""
    bag = open_bag(path, quiet=True)
    topics = load_topics(bag, [name for name, info in bag.topics.items()
                               if info.msgtype == JOINT_STATE])
    for name, info in bag.topics.items():
        if info.msgtype in NAMED and name not in topics:
            try:
                topics |= load_topics(bag, [name])
            except BagError as err:  # it may have nothing to do with the arm
                bag.notes.add(err.cause)
    others = bag.read([name for name in bag.topics if name not in topics], with_data=False)
    reports, edges = [], []
    for name, info in sorted(bag.topics.items()):
        log_time = topics[name].log_time if name in topics else others[name].log_time
        reports.append(_topic_report(topics[name]) if name in topics else TopicReport(
            name, info.msgtype, len(log_time), **_times(log_time, 'log')))
        if info.count != len(log_time):
            bag.notes.add(f'the bag lists {info.count} messages on {name}, but has '
                          f'{len(log_time)}, which are used; record again if more are needed')
        if len(log_time):
            edges += [int(log_time[0]), int(log_time[-1])]
    plan = guess_plan(topics) if arm is None else plan_from_arm(arm)
    return BagReport(
        str(path), bag.storage, [file.name for file in bag.metadata.files],
        sum(file.stat().st_size for file in bag.metadata.files), bag.checksum(),
        min(edges) * 1e-9 if edges else None, (max(edges) - min(edges)) * 1e-9 if edges else 0.0,
        reports, **_verdict(bag, topics, plan), odd=bag.notes.texts,
        payload=bag.payload(), plan=plan)
