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

"""Trajectories of files: tables, and bags of trajectory_msgs/JointTrajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import get_typestore, Stores

from tudor_dynamics.bags.layouts.cdr_layout import MAX_NAMES, POINT_FIELDS
from tudor_dynamics.bags.opening import open_bag
from tudor_dynamics.bags.trajectory import (
    read_trajectory, TRAJECTORY, Trajectory, TrajectorySeries)
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.errors import BagError, TudorError, UsageError
from tudor_dynamics.files import write_whole

MOST_MESSAGES = 100_000
SECOND = 1_000_000_000


@dataclass(frozen=True, eq=False)
class Sent:
    """
    A trajectory as it stood in a file.

    Attributes
    ----------
    trajectory : Trajectory
        What joints are to do.
    topic : str
        Topic in the bag; empty for a table.
    time : int
        When the message was recorded [ns].
    stamp : int
        Header stamp; 0 lets a controller begin at once [ns].
    frame_id : str
        Of the header.

    """

    trajectory: Trajectory
    topic: str = ''
    time: int = 0
    stamp: int = 0
    frame_id: str = ''


def is_table(path: Path) -> bool:
    """Say whether a path is that of a table rather than of a bag."""
    return path.suffix.lower() == '.csv'


def read_trajectories(path: Path, topic: str = '') -> list[Sent]:
    """
    Read the trajectories of a file.

    Parameters
    ----------
    path : Path
        CSV table, or bag.
    topic : str, optional
        Topic of the bag; by default the only one with trajectories.

    Returns
    -------
    list of Sent
        One of a table; those of the bag in their order.

    Raises
    ------
    TudorError
        If it cannot be read, or a trajectory cannot be used; which, and why.

    """
    if is_table(path):
        return [Sent(read_trajectory(path))]
    bag = open_bag(path)
    found = sorted(name for name, info in bag.topics.items() if info.msgtype == TRAJECTORY)
    if topic not in found if topic else len(found) != 1:
        msg = (f'{topic or "one topic"} of {TRAJECTORY} is wanted, and the bag has '
               f'{", ".join(found) or "none"}')
        raise BagError(msg, place=path, remedy='name one of them by --topic' if found else
                       'record the topic on which trajectories are sent, or give a CSV file')
    name = topic or found[0]
    raw = bag.read([name])[name]
    if not 0 < len(raw.data) <= MOST_MESSAGES:
        msg = f'topic {name} has {len(raw.data)} messages; expected 1 to {MOST_MESSAGES}'
        raise BagError(msg, place=path)
    return [_decode(data, name, int(time), f'{path}, message {number} of {name}')
            for number, (data, time) in enumerate(zip(raw.data, raw.log_time, strict=True))]


def _decode(data: bytes, topic: str, time: int, place: str) -> Sent:
    """Read one message; whatever is wrong with it is said with its place."""
    try:
        message: Any = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(data, TRAJECTORY)
    except Exception as err:  # rosbags raises whatever the bytes lead it to
        msg = f'is no {TRAJECTORY} ({type(err).__name__})'
        raise BagError(msg, place=place, remedy='the bag is damaged; record it anew') from None
    stamp = message.header.stamp
    try:
        found = _trajectory(message)
    except TudorError as err:
        raise err.at(place) from None
    return Sent(found, topic, time, stamp.sec * SECOND + stamp.nanosec, message.header.frame_id)


def _trajectory(message: Any) -> Trajectory:
    """Turn a message into arrays."""
    joints = tuple(message.joint_names)
    if len(joints) > MAX_NAMES:
        msg = f'has {len(joints)} joints; at most {MAX_NAMES} are read'
        raise BagError(msg)
    t = np.array([point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec
                  for point in message.points])
    return Trajectory.from_points(joints, t, *(
        [getattr(point, field) for point in message.points] for field in POINT_FIELDS[:3]))


def write_trajectories(path: Path, sent: Sequence[Sent]) -> None:
    """
    Write trajectories, as a table or a bag by the name of the file.

    Parameters
    ----------
    path : Path
        File ``.csv``, or directory of a bag, which must not exist.
    sent : sequence of Sent
        Trajectories of one topic; one for a table.

    Raises
    ------
    UsageError
        If there are several for a table.
    BagError, OSError
        If it cannot be written.

    """
    if not is_table(path):
        topics: dict[str, list[Sent]] = {}
        for item in sent:
            topics.setdefault(item.topic or '/joint_trajectory', []).append(item)
        write_bag(path, [TrajectorySeries(
            topic, np.array([item.time for item in own], dtype=np.int64),
            [item.trajectory for item in own],
            np.array([item.stamp for item in own], dtype=np.int64),
            [item.frame_id for item in own]) for topic, own in topics.items()])
        return
    if len(sent) != 1:
        msg = f'{len(sent)} trajectories do not go into one table'
        raise UsageError(msg, place=path, remedy='write a bag: --out with a name without .csv')
    write_whole(path, sent[0].trajectory.table())
