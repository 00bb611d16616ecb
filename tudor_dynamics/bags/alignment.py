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

"""From decoded topics to aligned arrays: stamps, gaps, segments, streams of different rates."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.bags.messages import (
    array_layout, check_definition, decode, DYNAMIC_JOINT_STATE, dynamic_layout, EXPECTED,
    FLOAT64_MULTI_ARRAY, JOINT_STATE, joint_state_layout, MessageBatch)
from tudor_dynamics.bags.recording import ChannelSource, resolve, SetBack, Sources
from tudor_dynamics.bags.storage import Bag, Notes, RawMessages
from tudor_dynamics.errors import BagError
from tudor_dynamics.typing import FloatArray


# -- Stamps: order, gaps, segments, and the alignment of streams of different rates

GAP_PERIODS = 5.0
GAP_FLOOR = 0.02
"""
A gap is longer than five sample times and than 20 ms [s].

Five sample times pass the odd lost message. The floor is for fast recordings: at 1 kHz a stall of
a few milliseconds is scheduling, and motion and oscillation of arms (below 20 Hz) are still
sampled faster than twice their frequency across 20 ms.
"""

LEAST_BEHIND = 3
"""Messages in a row behind the newest stamp that make a clock that was set back."""


@dataclass(frozen=True, eq=False)
class Order:
    """Which messages increase in time."""

    keep: NDArray[np.bool_]  # messages later than all before them, (n,)
    # Messages with the stamp of the newest one before them, and with an older one.
    duplicate: int
    backward: int


def increasing(stamp: NDArray[np.int64]) -> Order:
    """Find the messages whose stamps increase: stamp (n,) [ns]."""
    newest = np.maximum.accumulate(stamp)[:-1] if len(stamp) else stamp
    later = stamp[1:] > newest
    duplicate = int(np.sum(stamp[1:] == newest))
    keep = np.concatenate([np.ones(min(1, len(stamp)), dtype=bool), later])
    return Order(keep, duplicate, int(np.sum(~keep)) - duplicate)


def set_backs(stamp: NDArray[np.int64]) -> list[tuple[int, int, int]]:
    """
    Find where a clock was set back: messages in a row that begin again before the newest stamp.

    stamp (n,) [ns]; returns newest stamp before, by how much the clock was set back [ns].
    """
    if len(stamp) < 3:
        return []
    newest = np.maximum.accumulate(stamp)
    behind = np.concatenate([[False], stamp[1:] < newest[:-1]])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], behind, [False]]).astype(int)))
    step = int(np.median(np.abs(np.diff(stamp))))
    found = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        # one or two late messages were overtaken on their way
        if last - first >= LEAST_BEHIND and np.mean(np.diff(stamp[first:last]) > 0) > 0.9:
            before = int(newest[first - 1])
            found.append((before, before + step - int(stamp[first]), int(last - first)))
    return found


def gap_limit(stamp: NDArray[np.int64]) -> float:
    """
    Give the longest time between samples that is not a gap.

    stamp (n,) [ns]; returns limit [s].
    """
    if len(stamp) < 2:
        return GAP_FLOOR
    return max(GAP_PERIODS * float(np.median(np.diff(stamp))) * 1e-9, GAP_FLOOR)


def split_at_gaps(stamp: NDArray[np.int64]) -> tuple[slice, ...]:
    """Split a record at its gaps: stamp (n,) [ns]."""
    cuts = np.flatnonzero(np.diff(stamp) * 1e-9 > gap_limit(stamp)) + 1
    ends = [0, *cuts.tolist(), len(stamp)]
    return tuple(slice(a, b) for a, b in zip(ends, ends[1:]) if b > a)


def interpolate(
    at: NDArray[np.int64], stamp: NDArray[np.int64], values: FloatArray,
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """
    Bring a stream onto other stamps.

    Samples with the same stamp are taken as they are, others interpolated linearly between their
    neighbours, unless there is a gap between these.

    at (m,) [ns], stamp (n,) [ns]; values (n, k): NaN marks a sample without value; returns (m, k)
    and (m,).
    """
    result = np.full((len(at), values.shape[1]), np.nan)
    if not len(stamp):
        return result, np.zeros(len(at), dtype=bool)
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


# -- Topics that carry named values as arrays, and whether their messages keep their contract

LAYOUTS = {JOINT_STATE: joint_state_layout, FLOAT64_MULTI_ARRAY: array_layout,
           DYNAMIC_JOINT_STATE: dynamic_layout}
"""Types of messages with named values; those of an array are named by their places."""


@dataclass(frozen=True, eq=False)
class DecodedTopic:
    """All messages of a topic of JointState, or of another type with named values."""

    topic: str  # name of the topic
    # When each was recorded, and its header stamp, zero where it has none, (n,) [ns].
    log_time: NDArray[np.int64]
    stamp: NDArray[np.int64]
    blocks: list[MessageBatch]  # messages by layout
    msgtype: str = JOINT_STATE  # type of the messages

    @property
    def stamped(self) -> bool:
        """Say whether messages of this type have a stamp."""
        return self.msgtype != FLOAT64_MULTI_ARRAY


def decode_joint_states(raw: RawMessages, path: str) -> DecodedTopic:
    """Decode a topic."""
    layout = LAYOUTS.get(raw.msgtype)
    if layout is None:
        msg = (f'{path}: topic {raw.topic} is of type {raw.msgtype}, expected {JOINT_STATE}; '
               'name another topic in the arm description')
        raise BagError(msg)
    try:
        blocks = decode(raw.data, layout, raw.topic)
    except BagError as err:
        raise err.at(path) from None
    stamp = np.zeros(len(raw.data), dtype=np.int64)
    for block in blocks:
        stamp[block.index] = block.stamp
    return DecodedTopic(raw.topic, raw.log_time, stamp, blocks, raw.msgtype)


def load_joint_states(bag: Bag, topics: Collection[str]) -> dict[str, DecodedTopic]:
    """Read and decode topics of a bag."""
    for name in topics:
        msgtype = bag.topics[name].msgtype if name in bag.topics else ''
        if msgtype in EXPECTED:
            for text in bag.definitions(msgtype):
                check_definition(msgtype, text, name, str(bag.path))
    return {name: decode_joint_states(raw, str(bag.path))
            for name, raw in bag.read(topics).items()}


def ranges_of_others(states: DecodedTopic, names: Sequence[str]) -> dict[str, float]:
    """
    Say how far joints move that are not asked for.

    Returns name to range of its positions, the outermost percents left out [rad or m].
    """
    found: dict[str, float] = {}
    for block in states.blocks:
        if not block.layout.fields.get('position', (0, 0))[1]:
            continue
        values = block.values('position')
        for i, name in enumerate(block.layout.names[:values.shape[1]]):
            column = values[:, i][np.isfinite(values[:, i])]
            if name not in names and len(column):
                low, high = np.percentile(column, [1.0, 99.0])
                found[name] = max(found.get(name, 0.0), float(high - low))
    return found


def check_lengths(states: DecodedTopic, names: Sequence[str], path: str) -> None:
    """Refuse messages whose arrays do not go with their names."""
    for block in states.blocks:
        layout = block.layout
        if not set(names) & set(layout.names):
            continue
        where = f'topic {states.topic}, message {block.index[0]}'
        for field, (_, size) in layout.fields.items():
            if size not in (0, len(layout.names)):
                msg = (f'{where}: {field} has {size} values for {len(layout.names)} names; a '
                       'JointState array has the length of name or is empty: repair the '
                       'publisher and record again')
                raise BagError(msg, place=path)
        for name in names:
            if layout.names.count(name) > 1:
                msg = (f'{where}: {name!r} stands in name {layout.names.count(name)} times; '
                       'repair the publisher and record again')
                raise BagError(msg, place=path)


# -- Streams: the values of chosen names in a topic, with stamps, before they are aligned

FEW = 0.05
"""Share of samples of a channel that may be no numbers and are left out with a warning."""
MAX_VALUE = 1e12
"""Nothing about an arm is larger in any unit; squares and products stay far from overflowing."""


@dataclass(frozen=True, eq=False)
class Stream:
    """Values of some names."""

    # For messages, e.g. `effort in /motor_currents`.
    what: str
    names: tuple[str, ...]  # names of the columns
    stamp: NDArray[np.int64]  # times of the samples, (n,) [ns]
    values: FloatArray  # in the units of the topic, (n, names)

    def at(self, rows: NDArray) -> Stream:
        """Give the stream with a selection of its rows."""
        return Stream(self.what, self.names, self.stamp[rows], self.values[rows])


def select(
    states: DecodedTopic,
    names: Sequence[str],
    field: str,
    stamp: NDArray[np.int64],
) -> tuple[Stream, NDArray[np.intp]]:
    """Take the values of names from all messages that have them: stamp [ns]."""
    rows, parts = [], []
    for block in states.blocks:
        layout = block.layout
        if layout.size(field) and set(names) <= set(layout.names):
            columns = [layout.names.index(name) for name in names]
            rows.append(block.index)
            parts.append(block.values(field)[:, columns])
    what = f'{field} in {states.topic}'
    if not rows:
        nothing = Stream(what, tuple(names), np.empty(0, np.int64), np.empty((0, len(names))))
        return nothing, np.empty(0, np.intp)
    index, values = np.concatenate(rows), np.concatenate(parts)
    if len(rows) > 1:
        order = np.argsort(index)
        index, values = index[order], values[order]
    return Stream(what, tuple(names), stamp[index], values), index


def choose_clock(
    topics: Mapping[str, DecodedTopic], notes: Notes, path: str,
) -> dict[str, NDArray[np.int64]]:
    """
    Take header stamps, or log times where a topic has no header stamps.

    A stamp of zero means "not set" in ROS. Streams with different clocks could not be aligned, so
    one topic without stamps sends all to their log times. Messages of a type that has no stamp get
    their log times less what stamped messages of the bag take to be recorded.

    Returns time of each message of each topic [ns].
    """
    unset = [name for name, states in topics.items()
             if states.stamped and len(states.stamp) > 1 and not states.stamp.any()]
    if not unset:
        delays = [states.log_time - states.stamp for states in topics.values() if states.stamped]
        delay = int(np.median(np.concatenate([*delays, np.zeros(0, np.int64)]))) if any(
            map(len, delays)) else 0
        for name, states in topics.items():
            if not states.stamped and len(states.stamp):
                notes.add(f'messages in {name} have no stamp: their log times count, less '
                          f'{delay * 1e-6:.3g} ms that stamped messages take to be recorded')
        return {name: states.stamp if states.stamped else states.log_time - delay
                for name, states in topics.items()}
    for name, states in topics.items():
        if len(states.stamp) > 1 and np.mean(np.diff(states.log_time) > 0) < 0.9:
            msg = (f'all header stamps in {", ".join(unset)} are zero and the log times '
                   f'in {name} do not increase; let the publisher set header.stamp and record '
                   'again')
            raise BagError(msg, place=path)
    notes.add(f'all header stamps in {", ".join(unset)} are zero; log times are used, which '
              'include the delays of the network')
    return {name: states.log_time for name, states in topics.items()}


def check_finite(stream: Stream, notes: Notes, path: str) -> Stream:
    """Mark samples that are no measured numbers, refuse channels that are mostly so."""
    bad = ~(np.abs(stream.values) <= MAX_VALUE)
    if not bad.any():
        return stream
    counts = bad.sum(axis=0)
    first = int(np.argmax(bad.any(axis=1)))
    seconds = (stream.stamp[first] - stream.stamp[0]) * 1e-9
    who = ', '.join(f'{name} {count}' for name, count in zip(stream.names, counts, strict=True)
                    if count)
    large = '' if not np.isfinite(stream.values[bad]).any() else f' or beyond {MAX_VALUE:g}'
    text = (f'{stream.what}: of {len(bad)} samples are NaN or infinite{large}: {who}, the first '
            f'at {seconds:.3f} s')
    if counts.max() > FEW * len(bad):
        msg = f'{text}; repair the driver or leave this channel out, and record again'
        raise BagError(msg, place=path)
    notes.add(f'{text}; left out')
    return Stream(stream.what, stream.names, stream.stamp,
                  np.where(bad, np.nan, stream.values))


# -- The steps from decoded topics to aligned arrays

REMEDIES = {
    JOINT_STATE: 'leave out index and interface in the arm description',
    FLOAT64_MULTI_ARRAY: 'say with index: N in the arm description which value of the array it is',
    DYNAMIC_JOINT_STATE: 'say with interface: NAME in the arm description which one it is'}
"""Where a topic has another type than described: what to write."""
MIN_SEGMENT = 5
"""Fewer samples between two gaps are left out: nothing can be differentiated from them."""


@dataclass(frozen=True, eq=False)
class Output:
    """Efforts or strains on the stamps of the joint states."""

    values: FloatArray  # values in the units of the description, (samples, channels)
    found: NDArray[np.bool_]  # samples at which there are values of all channels, (samples,)


class Assembly:
    """The steps from decoded topics to a recording; holds what they share."""

    def __init__(
        self, bag: Bag, topics: Mapping[str, DecodedTopic], plan: Sources, notes: Notes,
    ) -> None:
        self.bag, self.topics, self.plan, self.notes = bag, topics, plan, notes
        self.path = str(bag.path)
        self.dropped: Counter[str] = Counter()
        self.cuts: list[int] = []
        self.set_backs: list[SetBack] = []
        self.others: dict[str, float] = {}
        self.clock = choose_clock(topics, notes, self.path)

    def states(self, name: str, channel: ChannelSource | None = None) -> DecodedTopic:
        """
        Give a topic of the bag, which must be of the type wanted.

        channel: positions by default.
        """
        found = self.bag.topics[name].msgtype
        msgtype = JOINT_STATE if channel is None else channel.msgtype
        if name not in self.topics or found != msgtype:
            remedy = 'name another topic in the arm description'
            remedy = remedy if channel is None else REMEDIES.get(found, remedy)
            msg = f'topic {name} is of type {found}, expected {msgtype}; {remedy}'
            raise BagError(msg, place=self.path)
        return self.topics[name]

    def ordered(self, stream: Stream, *, count: bool = True) -> tuple[Stream, NDArray[np.bool_]]:
        """Leave out duplicate and backward stamps, tell how many, check what is left."""
        order = increasing(stream.stamp)
        lost = order.duplicate + order.backward
        if lost and 2 * lost >= len(stream.stamp):
            msg = (f'the stamps of {stream.what} do not increase '
                   f'({order.duplicate} duplicate, {order.backward} backward of '
                   f'{len(stream.stamp)}); check the clock of the publisher and record again')
            raise BagError(msg, place=self.path)
        if count:
            for cause, number in (('duplicate_stamp', order.duplicate),
                                  ('backward_stamp', order.backward)):
                if number:
                    self.dropped[cause] += number
                    self.notes.add(f'{number} messages ({stream.what}) with a '
                                   f'{cause.replace("_", " ")}; left out')
        return stream.at(order.keep), order.keep

    def motion(self) -> tuple[Stream, FloatArray | None]:
        """Give positions with stamps that increase, and velocities on the same rows."""
        plan, path = self.plan, self.path
        name = resolve(plan.joint_topic, self.bag.topics, path)
        if name is None:
            others = sorted(topic for topic, info in self.bag.topics.items()
                            if info.msgtype == JOINT_STATE)
            msg = (f'no topic {plan.joint_topic}; ' + (
                f'{JOINT_STATE} is on {", ".join(others)}: correct joint_topic in the arm '
                'description' if others else
                f'no topic has the type {JOINT_STATE}: record the joint states'))
            raise BagError(msg, place=self.path)
        states = self.states(name)
        if not len(states.stamp):
            msg = f'no messages in {name}; record again with the driver running'
            raise BagError(msg, place=self.path)
        check_lengths(states, plan.joints, path)
        stream, index = select(states, plan.joints, 'position', self.clock[name])
        if not len(index):
            raise BagError(self._names_message(states), place=self.path)
        partial = len(self._touching(states)) - len(index)
        if partial:
            self.dropped['incomplete'] += partial
            self.notes.add(f'{partial} messages in {name} lack a joint or its position; left out')
        self._set_back(stream.stamp)
        self.others = ranges_of_others(states, plan.joints)
        stream, keep = self.ordered(stream)
        return check_finite(stream, self.notes, path), self._velocity(states, index[keep])

    def _set_back(self, stamp: NDArray[np.int64]) -> None:
        """Note where the clock was set back: what is kept before and after was not joined."""
        for newest, size, lost in set_backs(stamp):
            self.cuts.append(newest)
            self.set_backs.append(SetBack(float(newest - stamp[0]) * 1e-9, size * 1e-9, lost))

    def _touching(self, states: DecodedTopic) -> NDArray[np.intp]:
        parts = [block.index for block in states.blocks
                 if set(self.plan.joints) & set(block.layout.names)]
        return np.concatenate([np.empty(0, np.intp), *parts])

    def _names_message(self, states: DecodedTopic) -> str:
        found = sorted({name for block in states.blocks for name in block.layout.names})
        wanted = list(self.plan.joints)
        missing = [name for name in wanted if name not in found]
        if missing:
            return (f'joints {missing} are not in {states.topic}; it has {found}, '
                    f'the arm description wants {wanted}: correct joints[].name')
        return (f'no message in {states.topic} has positions of all joints {wanted} '
                f'(names in the topic: {found}); publish them in one message')

    def _velocity(self, states: DecodedTopic, rows: NDArray[np.intp]) -> FloatArray | None:
        stream, index = select(states, self.plan.joints, 'velocity', self.clock[states.topic])
        if not len(index):
            return None
        place = np.searchsorted(index, rows)
        present = (place < len(index)) & (index[np.minimum(place, len(index) - 1)] == rows)
        if not present.all():
            self.notes.add(f'velocity in {states.topic} is there in {int(present.sum())} of '
                           f'{len(rows)} messages only; not used')
            return None
        stream = stream.at(place)
        empty = [not column.any() for column in np.isfinite(stream.values).T]
        if any(empty):
            # joint_state_broadcaster fills the fields of interfaces that are not there with NaN
            names = [name for name, none in zip(stream.names, empty, strict=True) if none]
            self.notes.add(f'velocity in {states.topic} is NaN throughout for '
                           f'{", ".join(names)}; velocities are not used')
            return None
        return check_finite(stream, self.notes, self.path).values

    def output(
        self, motion: Stream, names: Sequence[str], channels: Sequence[ChannelSource],
    ) -> Output | None:
        """Give efforts or strains on the stamps of the motion; None where there are none."""
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
            values[:, columns], inside = interpolate(motion.stamp, stream.stamp, stream.values)
            if not inside.any():
                msg = (f'{stream.what} has no sample at the time of any joint '
                       'state; let both publishers stamp with the same clock')
                raise BagError(msg, place=self.path)
            found &= inside
            own, other = np.median(np.diff(stream.stamp)), np.median(np.diff(motion.stamp))
            if own > 1.5 * other:
                self.notes.add(f'{stream.what} comes every {own * 1e-6:.3g} ms, joint states '
                               f'every {other * 1e-6:.3g} ms; interpolated')
        return Output(values, found)

    def _output_stream(
        self, names: Sequence[str], channels: Sequence[ChannelSource],
    ) -> Stream | None:
        who, keys = ', '.join(names), [channel.name for channel in channels]
        wanted, field = channels[0].topic, channels[0].field
        topic = resolve(wanted, self.bag.topics, self.path, channels[0].msgtype)
        if topic is None:
            self.notes.add(f'no topic {wanted} ({field} of {who})', lacking=True)
            return None
        states = self.states(topic, channels[0])
        check_lengths(states, keys, self.path)
        stream, index = select(states, keys, field, self.clock[topic])
        if not len(index):
            present = sorted({name for block in states.blocks for name in block.layout.names
                              if block.layout.size(field)})
            self.notes.add(f'no {field} of {who} in {topic}, ' + (
                f'which has it of {", ".join(present)}' if present else 'the field is empty'),
                lacking=True)
            return None
        joint_topic = resolve(self.plan.joint_topic, self.bag.topics, self.path)
        # Stamps of the joint states' own topic were counted with the positions.
        stream, _ = self.ordered(stream, count=topic != joint_topic)
        if len(stream.stamp) < 2:
            self.notes.add(f'only one message with {stream.what} of {who}', lacking=True)
            return None
        if not np.isfinite(stream.values).any():
            self.notes.add(f'{stream.what} is NaN throughout', lacking=True)
            return None
        stream = check_finite(stream, self.notes, self.path)
        spans = np.nanmax(stream.values, axis=0) - np.nanmin(stream.values, axis=0)
        if not spans.all():
            still = [name for name, span in zip(names, spans, strict=True) if not span]
            self.notes.add(f'{stream.what} of {", ".join(still)} never changes')
        return stream

    def rows(
        self, motion: Stream, dq: FloatArray | None, outputs: Sequence[Output | None],
    ) -> NDArray[np.intp]:
        """
        Give the rows where everything is there; count the others by cause.

        dq (samples, joints) [rad/s or m/s].
        """
        found = np.ones(len(motion.stamp), dtype=bool)
        finite = np.isfinite(motion.values).all(axis=1)
        if dq is not None:
            finite &= np.isfinite(dq).all(axis=1)
        for output in outputs:
            if output is not None:
                found &= output.found
                finite &= np.isfinite(output.values).all(axis=1) | ~output.found
        for cause, number in (('no_neighbour', int(np.sum(~found & finite))),
                              ('not_finite', int(np.sum(~finite)))):
            if number:
                self.dropped[cause] += number
        if self.dropped['no_neighbour']:
            self.notes.add(f'{self.dropped["no_neighbour"]} of {len(found)} joint states have no '
                           'effort or strain close before and after; left out')
        kept = np.flatnonzero(found & finite)
        parts = split_at_gaps(motion.stamp[kept])
        long = [np.arange(p.start, p.stop) for p in parts if p.stop - p.start >= MIN_SEGMENT]
        isolated = len(kept) - sum(map(len, long))
        if isolated and long:
            self.dropped['isolated'] += isolated
            self.notes.add(f'{isolated} samples stand alone between gaps; left out')
        return kept[np.concatenate(long)] if long else kept

    def segments(self, stamp: NDArray[np.int64]) -> tuple[slice, ...]:
        """Split at gaps and tell of them: stamp (samples,) [ns]."""
        parts = split_at_gaps(stamp)
        if len(parts) > 1:
            starts = np.array([part.start for part in parts[1:]])
            lengths = (stamp[starts] - stamp[starts - 1]) * 1e-9
            at = (stamp[starts[0] - 1] - stamp[0]) * 1e-9
            self.notes.add(
                f'{len(lengths)} gap(s) longer than {gap_limit(stamp):.3g} s, the longest '
                f'{lengths.max():.3f} s, the first at {at:.3f} s; the record is split there')
        for cut in np.searchsorted(stamp, self.cuts, side='right').tolist():
            parts = tuple(piece for part in parts for piece in (
                (slice(part.start, cut), slice(cut, part.stop))
                if part.start < cut < part.stop else (part,)))
        return parts
