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

"""A bag becomes a ``Recording``: found by name, ordered, aligned, split at gaps, checked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.bags.messages import (
    decode_topic, DecodedTopic, DYNAMIC_JOINT_STATE, FLOAT64_MULTI_ARRAY, JOINT_STATE,
    load_topics, Signals, WRENCH_STAMPED)
from tudor_dynamics.bags.recording import (
    ChannelSource, check_plausible, gap_limit, Oddities, plan_from_arm, Recording, SetBack,
    Sources, split_at_gaps)
from tudor_dynamics.bags.settings import (
    FEW, LEAST_SET_BACK, MAX_VALUE, MIN_DURATION, MIN_SAMPLES, MIN_SEGMENT)
from tudor_dynamics.bags.storage import Bag, Notes, open_bag, RawMessages
from tudor_dynamics.errors import BagError, check_type
from tudor_dynamics.typing import FloatArray


def increasing(stamp: NDArray[np.int64]) -> tuple[NDArray[np.bool_], int, int]:
    """Find messages later than all before (n,); how many repeat a stamp, how many are older."""
    newest = np.maximum.accumulate(stamp)[:-1] if len(stamp) else stamp
    later = stamp[1:] > newest
    duplicate = int(np.sum(stamp[1:] == newest))
    keep = np.concatenate([np.ones(min(1, len(stamp)), dtype=bool), later])
    return keep, duplicate, int(np.sum(~keep)) - duplicate


def set_backs(stamp: NDArray[np.int64]) -> list[tuple[int, int, int]]:
    """Find where a clock was set back: newest stamp before, and by how much [ns]."""
    if len(stamp) < 3:
        return []
    newest = np.maximum.accumulate(stamp)
    older = np.concatenate([[False], stamp[1:] < newest[:-1], [False]])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], older]).astype(int)))
    step = int(np.median(np.abs(np.diff(stamp))))
    found = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        if last - first >= LEAST_SET_BACK and np.mean(np.diff(stamp[first:last]) > 0) > 0.9:
            before = int(newest[first - 1])
            found.append((before, before + step - int(stamp[first]), int(last - first)))
    return found


def interpolate(
    at: NDArray[np.int64], stamp: NDArray[np.int64], values: FloatArray,
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Bring a stream onto other stamps, linearly between two of its own that no gap separates."""
    result = np.full((len(at), values.shape[1]), np.nan)
    right = np.minimum(np.searchsorted(stamp, at), len(stamp) - 1)
    left = np.maximum(right - 1, 0)
    exact = stamp[right] == at
    width = (stamp[right] - stamp[left]) * 1e-9
    inside = (stamp[left] < at) & (at < stamp[right]) & (width <= gap_limit(stamp))
    result[exact] = values[right[exact]]
    a, b = left[inside], right[inside]
    weight = ((at[inside] - stamp[a]) / (stamp[b] - stamp[a]))[:, None]
    result[inside] = (1 - weight) * values[a] + weight * values[b]
    return result, exact | inside


def choose_clock(
    topics: Mapping[str, DecodedTopic], notes: Notes, path: str,
) -> dict[str, NDArray[np.int64]]:
    """Take header stamps, or log times where a topic has no header stamps."""
    # a stamp of zero means "not set" in ROS. Streams with different clocks could not be aligned,
    # so one topic without stamps sends all to their log times. Messages of a type that has no
    # stamp get their log times less what stamped messages of the bag take to be recorded
    unset = [name for name, states in topics.items()
             if states.stamped and len(states.stamp) > 1 and not states.stamp.any()]
    if not unset:
        delays = [states.log_time - states.stamp for states in topics.values() if states.stamped]
        delay = int(np.median(np.concatenate([*delays, np.zeros(0, np.int64)]))) if any(
            map(len, delays)) else 0
        for name, states in topics.items():
            if not states.stamped and len(states.stamp):
                notes.add(f'messages on {name} have no stamp, so the time at which they were '
                          f'recorded is used, minus {delay * 1e-6:.3g} ms for the usual delay; '
                          f'for exact times, publish a message type with a header on {name}')
        return {name: states.stamp if states.stamped else states.log_time - delay
                for name, states in topics.items()}
    for name, states in topics.items():
        if len(states.stamp) > 1 and np.mean(np.diff(states.log_time) > 0) < 0.9:
            raise BagError(f'all header stamps on {", ".join(unset)} are zero, and the times at '
                           f'which messages on {name} were recorded do not increase; set '
                           'header.stamp in the publisher, and record again', place=path)
    notes.add(f'all header stamps on {", ".join(unset)} are zero, so the times are used at which '
              'messages were recorded, late by the network; set header.stamp in the publisher')
    return {name: states.log_time for name, states in topics.items()}


def check_finite(stream: Signals, field: str, notes: Notes, path: str) -> FloatArray:
    """Give a field with NaN for what is no measured number; refuse what is mostly so."""
    values = stream.values[field]
    bad = ~(np.abs(values) <= MAX_VALUE)
    if not bad.any():
        return values
    counts = bad.sum(axis=0)
    first = int(np.argmax(bad.any(axis=1)))
    seconds = (stream.stamp[first] - stream.stamp[0]) * 1e-9
    who = ', '.join(f'{name!r} (in {count} of {len(bad)} samples)' for name, count in zip(
        stream.names, counts, strict=True) if count)
    large = '' if not np.isfinite(values[bad]).any() else f' or beyond {MAX_VALUE:g}'
    text = (f'{stream.what} is NaN or infinite{large} for {who}, first after {seconds:.3f} s')
    if counts.max() > FEW * len(bad):
        raise BagError(f'{text}; repair the driver of this sensor and record again', place=path)
    notes.add(f'{text}; these samples are left out; if there are many, check the driver')
    return np.where(bad, np.nan, values)


REMEDIES = {
    JOINT_STATE: 'leave out index and interface in the arm description',
    FLOAT64_MULTI_ARRAY: 'say with index: N in the arm description which value of the array it is',
    DYNAMIC_JOINT_STATE: 'say with interface: NAME in the arm description which one it is'}
"""Where a topic has another type than described: what to write."""


class Assembly:
    """The steps from decoded topics to a recording; holds what they share."""

    def __init__(self, bag: Bag, topics: Mapping[str, DecodedTopic], plan: Sources) -> None:
        self.bag, self.plan, self.notes, self.path = bag, plan, bag.notes, str(bag.path)
        self.names = bag.find(plan.topics)
        self.topics = {name: topics[name] for name in sorted(topics)
                       if name in self.names.values()}
        self.dropped: Counter[str] = Counter()
        self.cuts: list[int] = []
        self.set_backs: list[SetBack] = []
        self.others: dict[str, float] = {}
        self.clock = choose_clock(self.topics, self.notes, self.path)

    def states(self, name: str, channel: ChannelSource | None = None) -> DecodedTopic:
        """Give a topic of the bag, which must be of the type wanted; positions by default."""
        found = self.bag.topics[name].msgtype
        msgtype = JOINT_STATE if channel is None else channel.msgtype
        if name not in self.topics or found != msgtype:
            remedy = 'correct joint_topic in the arm description' if channel is None else (
                REMEDIES.get(found, 'correct the topic of these values in the arm description'))
            msg = f'topic {name} is of type {found}, expected {msgtype}; {remedy}'
            raise BagError(msg, place=self.path)
        return self.topics[name]

    def select(
        self, states: DecodedTopic, names: Sequence[str], field: str,
    ) -> tuple[Signals, NDArray[np.intp]]:
        """Take the values of names from all messages that have them, and which these are."""
        index, values = states.select(names, field, self.path)
        return Signals(states.topic, self.clock[states.topic][index], {field: values},
                       names), index

    def ordered(self, stream: Signals, *, count: bool = True) -> tuple[Signals, NDArray[np.bool_]]:
        """Leave out duplicate and backward stamps, report how many, check what remains."""
        keep, duplicate, backward = increasing(stream.stamp)
        lost = duplicate + backward
        if lost and 2 * lost >= len(stream.stamp):
            raise BagError(f'of {len(stream.stamp)} stamps of {stream.what}, {duplicate} repeat '
                           f'and {backward} go back; correct the clock of the publisher, and '
                           'record again', place=self.path)
        if count:
            for cause, number in (('duplicate_stamp', duplicate), ('backward_stamp', backward)):
                if number:
                    self.dropped[cause] += number
                    self.notes.add(f'{number} messages with {stream.what} are left out for a '
                                   f'{cause.replace("_", " ")}; check their publisher')
        return stream.at(keep), keep

    def motion(self) -> Signals:
        """Give positions with stamps that increase, and velocities where they are there."""
        plan = self.plan
        name = self.names[plan.joint_topic]
        if name is None:
            others = sorted(topic for topic, info in self.bag.topics.items()
                            if info.msgtype == JOINT_STATE)
            msg = (f'no topic {plan.joint_topic}; ' + (
                f'{JOINT_STATE} is on {", ".join(others)}, so correct joint_topic in the arm '
                'description' if others else
                f'no topic has the type {JOINT_STATE}, so record the joint states'))
            raise BagError(msg, place=self.path)
        states = self.states(name)
        if not len(states.stamp):
            raise BagError(f'no messages in {name}; start its driver and record', place=self.path)
        stream, index = self.select(states, plan.joints, 'position')
        if not len(index):
            found = sorted({name for block in states.blocks for name in block.layout.names})
            missing = ', '.join(name for name in plan.joints if name not in found)
            has, wanted = ', '.join(found), ', '.join(plan.joints)
            raise BagError(
                f'joints {missing} are not in {name}, which has {has}; the arm description names '
                f'{wanted}, so correct joints[].name' if missing else
                f'no message in {name} has positions of all joints {wanted} '
                f'(names in the topic: {has}); publish them in one message', place=self.path)
        partial = sum(len(block.index) for block in states.blocks
                      if set(plan.joints) & set(block.layout.names)) - len(index)
        if partial:
            self.dropped['incomplete'] += partial
            self.notes.add(f'{partial} messages in {name} lack a joint or position: left out')
        for newest, size, lost in set_backs(stream.stamp):  # the record is split there
            self.cuts.append(newest)
            self.set_backs.append(
                SetBack(float(newest - stream.stamp[0]) * 1e-9, size * 1e-9, lost))
        self.others = states.ranges(plan.joints)
        stream, keep = self.ordered(stream)
        values = {'position': check_finite(stream, 'position', self.notes, self.path)}
        dq = self._velocity(states, index[keep])
        return replace(stream, values=values if dq is None else {**values, 'velocity': dq})

    def _velocity(self, states: DecodedTopic, rows: NDArray[np.intp]) -> FloatArray | None:
        stream, index = self.select(states, self.plan.joints, 'velocity')
        if not len(index):
            return None
        present = np.isin(rows, index)
        if not present.all():
            self.notes.add(f'only {int(present.sum())} of {len(rows)} messages on {states.topic} '
                           'have velocities, so these are not used')
            return None
        stream = stream.at(np.searchsorted(index, rows))
        empty = [not column.any() for column in np.isfinite(stream.values['velocity']).T]
        if any(empty):
            # joint_state_broadcaster fills the fields of interfaces that are not there with NaN
            names = [name for name, none in zip(stream.names, empty, strict=True) if none]
            self.notes.add(f'the velocity of {", ".join(names)} in {states.topic} is always NaN, '
                           'so velocities are not used')
            return None
        return check_finite(stream, 'velocity', self.notes, self.path)

    def output(
        self, motion: Signals, names: Sequence[str], channels: Sequence[ChannelSource],
    ) -> tuple[FloatArray, NDArray[np.bool_]] | None:
        """Give efforts or strains (samples, channels) on the motion's stamps; which have all."""
        if not channels:
            return None
        values = np.full((len(motion.stamp), len(names)), np.nan)
        found = np.ones(len(motion.stamp), dtype=bool)
        sources = [(channel.topic, channel.field, channel.msgtype) for channel in channels]
        for source in dict.fromkeys(sources):
            columns = [i for i, other in enumerate(sources) if other == source]
            stream = self._output_stream([names[i] for i in columns],
                                         [channels[i] for i in columns])
            if stream is None:
                return None
            values[:, columns], inside = interpolate(motion.stamp, stream.stamp,
                                                     stream.values[source[1]])
            if not inside.any():
                raise BagError(f'no stamp of {stream.what} is close to one of the joint states; '
                               'stamp both by the same clock, and record again', place=self.path)
            found &= inside
            own, other = (np.median(np.diff(stamp)) if len(stamp) > 1 else 0.0
                          for stamp in (stream.stamp, motion.stamp))
            if own > 1.5 * other:
                self.notes.add(f'{stream.what} comes every {own * 1e-6:.3g} ms, but joint states '
                               f'every {other * 1e-6:.3g} ms, so it is interpolated')
        return values, found

    def _output_stream(
        self, names: Sequence[str], channels: Sequence[ChannelSource],
    ) -> Signals | None:
        who, keys = ', '.join(map(repr, names)), [channel.name for channel in channels]
        wanted, field = channels[0].topic, channels[0].field
        what = 'strain' if field == 'position' else field  # a JointState has strains there
        topic = self.names[wanted]
        if topic is None:
            self.notes.add(f'no topic {wanted}, so the {what} of {who} is missing; record '
                           'that topic if it is needed', lacking=True)
            return None
        states = self.states(topic, channels[0])
        stream, index = self.select(states, keys, field)
        if not len(index):
            present = sorted({name for block in states.having(field)
                              for name in block.layout.names})
            self.notes.add(f'no {what} of {who} in {topic}, ' + (
                f'which has it of {", ".join(present)}' if present else
                f'the field {field} is empty'), lacking=True)
            return None
        # Stamps of the joint states' own topic were counted with the positions.
        stream, _ = self.ordered(stream, count=topic != self.names[self.plan.joint_topic])
        if len(stream.stamp) < 2:
            self.notes.add(f'{topic} has only one message with {what} of {who}', lacking=True)
            return None
        if not np.isfinite(stream.values[field]).any():
            self.notes.add(f'{stream.what} is always NaN; check its driver', lacking=True)
            return None
        values = check_finite(stream, field, self.notes, self.path)
        spans = np.nanmax(values, axis=0) - np.nanmin(values, axis=0)
        if not spans.all():
            still = [name for name, span in zip(names, spans, strict=True) if not span]
            self.notes.add(f'{what} of {", ".join(still)} in {topic} never changes; check the '
                           'sensor and its driver')
        return replace(stream, values={field: values})

    def rows(
        self, motion: Signals, outputs: Sequence[tuple[FloatArray, NDArray[np.bool_]] | None],
    ) -> NDArray[np.intp]:
        """Give the rows where everything is there; count the others by cause."""
        found, finite = np.ones((2, len(motion.stamp)), dtype=bool)
        for values in motion.values.values():
            finite &= np.isfinite(values).all(axis=1)
        for output in outputs:
            if output is not None:
                values, inside = output
                found &= inside
                finite &= np.isfinite(values).all(axis=1) | ~inside
        self.dropped.update(no_neighbour=int(np.sum(~found & finite)),
                            not_finite=int(np.sum(~finite)))
        if self.dropped['no_neighbour']:
            self.notes.add(f'{self.dropped["no_neighbour"]} of {len(found)} joint states have no '
                           'effort or strain close before and after, so they are left out')
        kept = np.flatnonzero(found & finite)
        parts = split_at_gaps(motion.stamp[kept])
        long = [np.arange(p.start, p.stop) for p in parts if p.stop - p.start >= MIN_SEGMENT]
        isolated = len(kept) - sum(map(len, long))
        if isolated and long:
            self.dropped['isolated'] += isolated
            self.notes.add(f'{isolated} samples stand alone between gaps and are left out')
        return kept[np.concatenate(long)] if long else kept

    def segments(self, stamp: NDArray[np.int64]) -> tuple[slice, ...]:
        """Split at gaps and report them: stamp (samples,) [ns]."""
        parts = split_at_gaps(stamp)
        if len(parts) > 1:
            starts = np.array([part.start for part in parts[1:]])
            lengths = (stamp[starts] - stamp[starts - 1]) * 1e-9
            at = (stamp[starts[0] - 1] - stamp[0]) * 1e-9
            self.notes.add(
                f'messages are missing on {self.names[self.plan.joint_topic]} in {len(lengths)} '
                f'gap(s) longer than {gap_limit(stamp):.3g} s (longest {lengths.max():.3f} s, '
                f'first after {at:.3f} s); the recording is split there; if other bags have gaps '
                'too, find out whether driver, network or disk is too slow')
        for cut in np.searchsorted(stamp, self.cuts, side='right').tolist():
            parts = tuple(piece for part in parts for piece in (
                (slice(part.start, cut), slice(cut, part.stop))
                if part.start < cut < part.stop else (part,)))
        return parts


def assemble(
    bag: Bag, topics: Mapping[str, DecodedTopic], plan: Sources, *, need_output: bool = False,
    need_motion: bool = False, checksum: bool = True,
) -> Recording:
    """Make a recording of decoded topics, those of the plan and perhaps more."""
    work = Assembly(bag, topics, plan)
    motion = work.motion()
    effort = work.output(motion, plan.joints, plan.efforts)
    strain = work.output(motion, plan.gauges, plan.strains)
    rows = work.rows(motion, (effort, strain))
    motion = motion.at(rows)
    stamp = motion.stamp
    duration = (stamp[-1] - stamp[0]) * 1e-9 if len(stamp) else 0.0
    if len(rows) < MIN_SAMPLES or duration < MIN_DURATION:
        msg = (f'too short: {len(rows)} usable samples in {duration:.3g} s, at least '
               f'{MIN_SAMPLES} samples and {MIN_DURATION:g} s are needed; record longer')
        raise BagError(msg, place=bag.path)
    recording = Recording(
        str(bag.path), stamp, motion.values['position'], motion.values.get('velocity'),
        None if effort is None else effort[0][rows],
        None if strain is None else strain[0][rows],
        work.segments(stamp), float(np.median(np.diff(stamp))) * 1e-9,
        {cause: number for cause, number in work.dropped.items() if number},
        (), bag.checksum() if checksum else '', bag.payload(),
        oddities=Oddities(tuple(work.set_backs), work.others))
    return check_plausible(recording, plan, bag.notes, need_output=need_output,
                           need_motion=need_motion)


def read_recording(
    path: str | Path, arm: Arm, *, need_output: bool = False, need_motion: bool = False,
) -> Recording:
    """
    Read the signals of an arm from a bag.

    Joints and gauges are found by name, in any order. Efforts and strains are brought onto the
    header stamps of the joint states. What is wrong is warned of and kept in ``warnings``.

    Parameters
    ----------
    path : str or Path
        rosbag2 directory, ``.mcap`` or ``.db3``.
    arm : Arm
        Arm whose active joints and gauges are read.
    need_output : bool
        Refuse a bag with neither efforts nor strains.
    need_motion : bool
        Refuse a bag in which no joint moves.

    Returns
    -------
    Recording
        Aligned arrays, in SI and the units of the description.

    Raises
    ------
    BagError
        If the bag is damaged or cannot be used; the message says why and what to do.

    """
    check_type(path, (str, Path), 'path', 'the path of a bag')
    check_type(arm, Arm, 'arm', "read a description with load_arm('arm.yaml')")
    return read_planned(path, plan_from_arm(arm), need_output=need_output, need_motion=need_motion)


def read_planned(
    path: str | Path, plan: Sources, *, need_output: bool = False, need_motion: bool = False,
    quiet: bool = False,
) -> Recording:
    """Read what a plan names from a bag, as `read_recording` does; quiet: without warnings."""
    bag = open_bag(path, quiet=quiet)
    there = {name for name in bag.find(plan.topics).values() if name is not None}
    found = assemble(bag, load_topics(bag, sorted(there)), plan, need_output=need_output,
                     need_motion=need_motion)
    with suppress(BagError):  # of another type, or damaged: nothing is known
        if (wrenches := read_wrenches(bag)) is not None:
            size = np.linalg.norm(wrenches.values['force'], axis=1)
            found = replace(found, push=np.interp(found.stamp, wrenches.stamp, size, 0.0, 0.0))
    return found


BOOL = 'std_msgs/msg/Bool'
BOOL_BYTES = 5  # A Bool after its encapsulation header


def _messages(bag: Bag, topic: str, known: Sequence[str]) -> RawMessages | None:
    """Read a topic of the first of some types; None where it is not there, or is empty."""
    name = bag.find({topic: JOINT_STATE})[topic]
    if name is None or not bag.topics[name].count:
        return None
    if bag.topics[name].msgtype != known[0]:
        raise BagError(f'{bag.path}: topic {name} is of type {bag.topics[name].msgtype}, expected '
                       f'{" or ".join(known)}; name a topic of such a type')
    return bag.read([name])[name]


def read_wrenches(bag: Bag, topic: str = 'applied_wrench') -> Signals | None:
    """Read the wrenches of a bag; None where it has no message with one."""
    raw = _messages(bag, topic, (WRENCH_STAMPED, BOOL))
    if raw is None or not raw.data:
        return None
    found = decode_topic(raw, str(bag.path)).signals()
    return found.at(increasing(found.stamp)[0])


def read_flags(
    bag: Bag, topic: str, clock: str = 'joint_states',
) -> tuple[NDArray[np.int64], NDArray[np.bool_]] | None:
    """Read a Bool topic (n,), without stamps of its own, on header stamps of another; or None."""
    raw = _messages(bag, topic, (BOOL, WRENCH_STAMPED))
    if raw is None:
        return None
    if any(not BOOL_BYTES <= len(data) < BOOL_BYTES + 8 or data[4] > 1 for data in raw.data):
        raise BagError(f'{bag.path}: {raw.topic} has messages that are no {BOOL}; record it again')
    joints = bag.find({clock: JOINT_STATE})[clock]
    shift = 0
    if joints is not None:
        known = load_topics(bag, [joints])[joints]
        if known.stamp.any():
            shift = int(np.median(known.stamp - known.log_time))
    return raw.log_time + shift, np.array([data[4] != 0 for data in raw.data])
