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

"""The steps from decoded topics to aligned arrays."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.bags.alignment import (
    gap_limit, increasing, interpolate, set_backs, split_at_gaps)
from tudor_dynamics.bags.joint_states import check_lengths, DecodedTopic, ranges_of_others
from tudor_dynamics.bags.layouts.carriers import DYNAMIC_JOINT_STATE, FLOAT64_MULTI_ARRAY
from tudor_dynamics.bags.layouts.cdr_layout import JOINT_STATE
from tudor_dynamics.bags.notes import Notes
from tudor_dynamics.bags.recording import SetBack
from tudor_dynamics.bags.sources import ChannelSource, resolve, Sources
from tudor_dynamics.bags.storage.raw import Bag
from tudor_dynamics.bags.streams import check_finite, choose_clock, select, Stream
from tudor_dynamics.errors import BagError
from tudor_dynamics.typing import FloatArray

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
