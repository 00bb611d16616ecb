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

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.bags.alignment import Assembly, DecodedTopic, increasing, load_joint_states
from tudor_dynamics.bags.messages import (
    decode, JOINT_STATE, wrench_layout, WRENCH_STAMPED, WrenchSeries)
from tudor_dynamics.bags.recording import (
    ChannelSource, check_units, MANY_TURNS, moving_joints, Oddities, plan_from_arm, Recording,
    resolve, Sources, without_zero_velocities)
from tudor_dynamics.bags.storage import Bag, Notes, open_bag
from tudor_dynamics.errors import BagError, check_type


# -- Ground truth of collisions in a bag: forces that were applied on purpose, and flags

BOOL = 'std_msgs/msg/Bool'
BOOL_BYTES = 5
"""A Bool behind its encapsulation header."""


def _topic_of(bag: Bag, topic: str, known: Sequence[str], path: str | Path) -> str | None:
    """Find a topic of the first of some types; None where it is not there, or is empty."""
    name = resolve(topic, bag.topics, str(path))
    if name is None or not bag.topics[name].count:
        return None
    if bag.topics[name].msgtype != known[0]:
        msg = (f'{path}: topic {name} is of type {bag.topics[name].msgtype}, expected '
               f'{" or ".join(known)}; name another topic')
        raise BagError(msg)
    return name


def read_wrenches(path: str | Path, topic: str = 'applied_wrench') -> WrenchSeries | None:
    """
    Read the wrenches of a bag.

    Returns None where the bag has no such topic, or no message in it.
    """
    bag = open_bag(path)
    name = _topic_of(bag, topic, (WRENCH_STAMPED,), path)
    if name is None:
        return None
    raw = bag.read([name])[name]
    try:
        blocks = decode(raw.data, wrench_layout, name)
    except BagError as err:
        raise err.at(path) from None
    if not blocks:
        return None
    order = np.argsort(np.concatenate([block.index for block in blocks]))
    stamp = np.concatenate([block.stamp for block in blocks])[order]
    values = np.concatenate([block.values('wrench') for block in blocks])[order]
    keep = increasing(stamp).keep
    names = np.concatenate([[block.layout.frame_id] * len(block.index) for block in blocks])
    return WrenchSeries(name, stamp[keep], values[keep, :3], values[keep, 3:],
                        tuple(names[order][keep].tolist()))


def read_flags(
    path: str | Path, topic: str, clock: str = 'joint_states',
) -> tuple[NDArray[np.int64], NDArray[np.bool_]] | None:
    """
    Read a Bool topic, which has no stamps of its own, on the header stamps of another.

    Returns (n,) [ns], None where the bag has no such topic, or no message in it.
    """
    bag = open_bag(path)
    name = _topic_of(bag, topic, (BOOL, WRENCH_STAMPED), path)
    if name is None:
        return None
    raw = bag.read([name])[name]
    if any(not BOOL_BYTES <= len(data) < BOOL_BYTES + 8 or data[4] > 1 for data in raw.data):
        msg = f'{path}: topic {name} has messages that are no {BOOL}; the bag is damaged'
        raise BagError(msg)
    joints = resolve(clock, bag.topics, str(path))
    shift = 0
    if joints is not None:
        known = load_joint_states(bag, [joints])[joints]
        if known.stamp.any():
            shift = int(np.median(known.stamp - known.log_time))
    order = np.argsort(raw.log_time, kind='stable')
    return raw.log_time[order] + shift, np.array([data[4] != 0 for data in raw.data])[order]


# -- A plan from the topics of a bag, where no arm description is at hand

STRAIN_WORDS = ('strain', 'gauge')
"""A topic of JointState whose name has one of these carries strains, where no arm is given."""


def guess_plan(topics: Mapping[str, DecodedTopic]) -> Sources | None:
    """
    Guess what an arm description would say, from the topics alone.

    Returns None where no topic has positions.
    """
    def with_field(what: str) -> dict[str, list[str]]:
        found = {}
        for name, states in topics.items():
            blocks = [block for block in states.blocks if block.layout.size(what)]
            if blocks:
                largest = max(blocks, key=lambda block: len(block.index))
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


# -- A bag becomes a Recording: found by name, ordered, aligned, split at gaps, checked

MIN_SAMPLES = 50
MIN_DURATION = 1.0
"""Shorter recordings do not outlast the transients of the filters [s]."""


def assemble(
    bag: Bag,
    topics: Mapping[str, DecodedTopic],
    plan: Sources,
    notes: Notes,
    *,
    need_output: bool = False,
    need_motion: bool = False,
    checksum: bool = True,
) -> Recording:
    """Make a recording of decoded topics."""
    work = Assembly(bag, topics, plan, notes)
    motion, dq = work.motion()
    effort = work.output(motion, plan.joints, plan.efforts)
    strain = work.output(motion, plan.gauges, plan.strains)
    rows = work.rows(motion, dq, (effort, strain))
    stamp = motion.stamp[rows]
    duration = (stamp[-1] - stamp[0]) * 1e-9 if len(stamp) else 0.0
    if len(rows) < MIN_SAMPLES or duration < MIN_DURATION:
        msg = (f'too short: {len(rows)} usable samples in {duration:.3g} s, at least '
               f'{MIN_SAMPLES} samples and {MIN_DURATION:g} s are needed; record longer')
        raise BagError(msg, place=bag.path)
    recording = Recording(
        str(bag.path), stamp, motion.values[rows], None if dq is None else dq[rows],
        None if effort is None else effort.values[rows],
        None if strain is None else strain.values[rows],
        work.segments(stamp), float(np.median(np.diff(stamp))) * 1e-9,
        {cause: number for cause, number in work.dropped.items() if number},
        (), bag.checksum() if checksum else '', stated_payload(bag, notes),
        oddities=Oddities(tuple(work.set_backs), work.others))
    recording = without_zero_velocities(recording, plan, notes)
    check_units(recording, plan, notes)
    _check_use(recording, plan, notes, need_output, need_motion)
    object.__setattr__(recording, 'warnings', tuple(notes.texts))
    return recording


def stated_payload(bag: Bag, notes: Notes) -> float | None:
    """Give the mass at the tip as whoever recorded wrote it down."""
    text = bag.custom.get('payload')
    if text is None:
        return None
    try:
        mass = float(text)
    except ValueError:
        mass = -1.0
    if not 0.0 <= mass < float('inf'):
        notes.add(f'the metadata give the payload {text[:40]!r}, which is no mass in kg; ignored')
        return None
    return mass


def _check_use(
    recording: Recording, plan: Sources, notes: Notes, need_output: bool, need_motion: bool,
) -> None:
    moving = moving_joints(recording, plan.prismatic)
    if not any(moving):
        text = f'no joint moves ({", ".join(plan.joints)} keep their positions)'
        if need_motion:
            msg = f'{text}; nothing can be learned, record a motion'
            raise BagError(msg, place=recording.path)
        notes.add(text)
    elif not all(moving):
        still = [name for name, moves in zip(plan.joints, moving, strict=True) if not moves]
        notes.add(f'{", ".join(still)} does not move')
    if need_output and recording.effort is None and recording.strain is None:
        reasons = '; '.join(notes.lacking)
        msg = (f'neither efforts nor strains ({reasons or "none described"}); nothing can be '
               'learned: correct effort.topic or gauges[].topic in the arm description, or '
               'record them')
        raise BagError(msg, place=recording.path)


def read_recording(
    path: str | Path,
    arm: Arm,
    *,
    need_output: bool = False,
    need_motion: bool = False,
) -> Recording:
    """
    Read the signals of an arm from a bag.

    Joints and gauges are found by name, in any order. Efforts and strains are brought onto the
    header stamps of the joint states. What is odd is warned of and kept in ``warnings``.

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
    return read_planned(path, plan_from_arm(arm), Notes(str(path)), need_output=need_output,
                        need_motion=need_motion)


def planned_topics(bag: Bag, plan: Sources) -> list[str]:
    """Give the topics of a bag that a plan names, by their full names."""
    types = {channel.topic: channel.msgtype for channel in (*plan.efforts, *plan.strains)}
    names = {resolve(name, bag.topics, str(bag.path), types.get(name, JOINT_STATE))
             for name in plan.topics}
    return sorted(name for name in names if name is not None)


def read_planned(
    path: str | Path,
    plan: Sources,
    notes: Notes,
    *,
    need_output: bool = False,
    need_motion: bool = False,
) -> Recording:
    """Read what a plan names from a bag, as `read_recording` does."""
    bag = open_bag(path, notes)
    topics = load_joint_states(bag, planned_topics(bag, plan))
    return assemble(bag, topics, plan, notes, need_output=need_output, need_motion=need_motion)
