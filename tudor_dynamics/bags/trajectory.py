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

"""Trajectories: points in time as tables, as messages, and in files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from typing import Any
from warnings import catch_warnings, simplefilter

import numpy as np
from rosbags.typesys import get_typestore, Stores

from tudor_dynamics.bags.messages import MAX_NAMES, POINT_FIELDS
from tudor_dynamics.bags.storage import open_bag, RawMessages
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.errors import BagError, SignalError, TudorError, UsageError
from tudor_dynamics.files import read_text, write_whole
from tudor_dynamics.typing import FloatArray, Shown


# A table has the columns ``t, JOINT, ...`` of positions, as ``tudor simulate --motion`` takes it,
# and ``JOINT_velocity``, ``JOINT_acceleration``, ``JOINT_effort`` for what is known beside.

Points = Sequence[Sequence[float]]
MAX_TABLE_BYTES = 50_000_000
LARGEST = 1e12  # what no joint reaches [rad, m, s]: squares of more are no numbers
TRAJECTORY = 'trajectory_msgs/msg/JointTrajectory'
MOST_MESSAGES = 100_000
SECOND = 1_000_000_000
FIELDS = {'': 'q', '_velocity': 'dq', '_acceleration': 'ddq', '_effort': 'effort'}
"""What follows the name of a joint in the head of a table's column, and what stands there."""


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(Shown):
    """
    Points in time that joints pass.

    Attributes
    ----------
    joints : tuple of str
        Names of the joints.
    t : ndarray of shape (n_points,)
        Times of the points since the start, increasing [s].
    q : ndarray of shape (n_points, n_joints)
        Positions at the points [rad or m].
    dq, ddq : ndarray of shape (n_points, n_joints), optional
        Velocities and accelerations [rad/s, rad/s^2 or m/s, m/s^2]; None where they are not given.
    effort : ndarray of shape (n_points, n_joints), optional
        Efforts, in a unit that the arm knows.

    Raises
    ------
    SignalError
        If there is no point, shapes do not fit, a number is not finite, or time does not increase.

    """

    joints: tuple[str, ...]
    t: FloatArray
    q: FloatArray
    dq: FloatArray | None = None
    ddq: FloatArray | None = None
    effort: FloatArray | None = None

    def __post_init__(self) -> None:
        shape = (len(self.t), len(self.joints))
        if not shape[0]:
            raise SignalError('the trajectory has no points; give one or more with positions')
        for name, values in (('positions', self.q), ('velocities', self.dq),
                             ('accelerations', self.ddq), ('efforts', self.effort)):
            if values is not None and values.shape != shape:
                raise SignalError(f'the {name} have the shape {values.shape}; give {shape}, a row '
                                  f'for each point, a column for each of {", ".join(self.joints)}')
            if values is not None and not (np.abs(values) < LARGEST).all():
                row, column = np.argwhere(~(np.abs(values) < LARGEST))[0].tolist()
                raise SignalError(f'the {name} of point {row + 1} of {shape[0]} have '
                                  f'{values[row, column]:g} for {self.joints[column]!r}; give a '
                                  f'finite number below {LARGEST:g}')
        known = np.abs(self.t) < LARGEST
        later = np.diff(np.where(known, self.t, np.nan)) > 0.5 / SECOND  # messages count ns
        if not known.all() or not later.all():
            row = int(np.argmin(np.append(later, False)))
            raise SignalError(f'time does not increase after point {row + 1} of {shape[0]}, at '
                              f'{self.t[row]:g} s; let time_from_start grow from point to point')
        if self.ddq is not None and self.dq is None:
            msg = 'the trajectory has accelerations without velocities'
            raise SignalError(msg, remedy='give velocities too, or no accelerations')

    @classmethod
    def from_points(
        cls, joints: tuple[str, ...], t: FloatArray, positions: Points, velocities: Points,
        accelerations: Points,
    ) -> Trajectory:
        """
        Take the fields of messages, of which points leave some empty.

        Parameters
        ----------
        joints : tuple of str
            Names of the joints.
        t : ndarray of shape (n_points,)
            Times since the start [s].
        positions, velocities, accelerations : sequence of sequence of float
            Values of each point [rad, rad/s, rad/s^2 or m, m/s, m/s^2].

        Returns
        -------
        Trajectory
            A field that any point leaves empty is not given, as controllers see it.

        Raises
        ------
        SignalError
            If positions are missing, or a field has another length.

        """
        arrays: list[FloatArray | None] = []
        for name, field in (('positions', positions), ('velocities', velocities),
                            ('accelerations', accelerations)):
            if arrays and not all(len(row) for row in field):
                arrays.append(None)
                continue
            wrong = [k for k, row in enumerate(field) if len(row) != len(joints)]
            if wrong:
                msg = (f'point {wrong[0] + 1} of {len(field)} has {len(field[wrong[0]])} of '
                       f'{len(joints)} {name}, one for each joint ({", ".join(joints)})')
                raise SignalError(msg, remedy='give one value for each joint')
            arrays.append(np.array(field, dtype=float).reshape(len(field), len(joints)))
        q, dq, ddq = arrays
        assert q is not None
        return cls(joints, t, q, dq, None if dq is None else ddq)

    def of(self, joints: tuple[str, ...]) -> Trajectory:
        """Take some of the joints, in their own order; none may be missing or named twice."""
        missing = [name for name in joints if self.joints.count(name) != 1]
        if missing:
            msg = (f'joint {missing[0]!r} is {"twice" if missing[0] in self.joints else "missing"}'
                   f' in the trajectory, which names {", ".join(map(repr, self.joints))}')
            raise SignalError(msg, remedy=f'give each of {", ".join(map(repr, joints))} once')
        places = [self.joints.index(name) for name in joints]
        return replace(self, joints=joints, **{
            field: values[:, places] for field in FIELDS.values()
            if (values := getattr(self, field)) is not None})

    def table(self) -> bytes:
        """Write it as CSV, with all digits: time, then all that is known of each joint."""
        known = {ending: values for ending, field in FIELDS.items()
                 if (values := getattr(self, field)) is not None}
        head = ['t', *(f'{name}{ending}' for name in self.joints for ending in known)]
        columns = np.stack(list(known.values()), axis=2).reshape(len(self.t), -1)
        rows = np.column_stack([self.t, columns]).tolist()
        return '\n'.join([','.join(head), *(','.join(map(repr, row)) for row in rows),
                          '']).encode()


def read_trajectory(path: Path) -> Trajectory:
    """Read motion from a table, as `Trajectory.table` writes it; columns in any order."""
    head, _, body = read_text(path, MAX_TABLE_BYTES, 'the trajectory', BagError).partition('\n')
    columns = [name.strip() for name in head.lstrip('#').split(',')]
    joints = tuple(name for name in columns[1:] if not any(
        ending and name.endswith(ending) and name.removesuffix(ending) in columns
        for ending in FIELDS))
    if columns[0] != 't' or not joints or len(set(columns)) < len(columns):
        msg = f'the first line is {head[:200]!r}; expected t, then each joint once'
        raise BagError(msg, place=path, remedy='name columns t [s], JOINT [rad or m], and where '
                       'known JOINT_velocity and JOINT_acceleration')
    try:
        with catch_warnings():
            simplefilter('ignore', UserWarning)  # of a table without rows, which is refused below
            values = np.loadtxt(StringIO(body), delimiter=',', ndmin=2)
    except ValueError as err:
        raise BagError(f'a row is not all numbers ({err}); correct it', place=path) from None
    if values.shape[1:] != (len(columns),):
        msg = f'the table has the shape {values.shape}, but its first line names {len(columns)}'
        raise BagError(msg, place=path, remedy='give each row a number for each column')
    found: dict[str, FloatArray | None] = {}
    for ending, field in FIELDS.items():
        there = [name for name in joints if f'{name}{ending}' in columns]
        if there and len(there) < len(joints):
            msg = (f'there is a column {there[0]}{ending}, but not one for each of the joints '
                   f'{", ".join(joints)}')
            raise BagError(msg, place=path, remedy='give such columns for all joints or none')
        found[field] = values[:, [columns.index(f'{name}{ending}') for name in joints]] \
            if there else None
    q = found['q']
    assert q is not None
    try:
        return Trajectory(joints, values[:, 0], q, found['dq'], found['ddq'])
    except SignalError as err:
        raise BagError(err.cause, place=path, remedy=err.remedy) from None


@dataclass(frozen=True, eq=False)
class Sent:
    """A trajectory as it stands in a file, a table or a bag of JointTrajectory."""

    trajectory: Trajectory  # what joints are to do
    topic: str = ''  # in the bag; empty for a table
    time: int = 0  # when the message was recorded [ns]
    stamp: int = 0  # of the header; 0 lets a controller begin at once [ns]
    frame_id: str = ''  # of the header

    def encode(self) -> bytes:
        """Encode the message."""
        typestore = get_typestore(Stores.ROS2_JAZZY)
        types, trajectory = typestore.types, self.trajectory
        fields = [getattr(trajectory, field) for field in FIELDS.values()]
        points = [types['trajectory_msgs/msg/JointTrajectoryPoint'](
            *(np.zeros(0) if field is None else np.ascontiguousarray(field[k])
              for field in fields),
            types['builtin_interfaces/msg/Duration'](*divmod(ns, SECOND)))
            for k, ns in enumerate(np.round(trajectory.t * 1e9).astype(np.int64).tolist())]
        header = types['std_msgs/msg/Header'](
            types['builtin_interfaces/msg/Time'](*divmod(self.stamp, SECOND)), self.frame_id)
        return bytes(typestore.serialize_cdr(
            types[TRAJECTORY](header, list(trajectory.joints), points), TRAJECTORY))


def is_table(path: Path) -> bool:
    """Say whether a path is that of a table rather than of a bag."""
    return path.suffix.lower() == '.csv'


def read_trajectories(path: Path, topic: str = '') -> list[Sent]:
    """Read the one of a CSV table, or those of a bag's topic, the only one with any by default."""
    if is_table(path):
        return [Sent(read_trajectory(path))]
    bag = open_bag(path)
    found = sorted(name for name, info in bag.topics.items() if info.msgtype == TRAJECTORY)
    if topic not in found if topic else len(found) != 1:
        msg = (f'expected {topic or "one topic"} of type {TRAJECTORY}, but the bag has '
               f'{", ".join(found) or "none"}')
        raise BagError(msg, place=path, remedy='choose one of these as topic' if found else
                       'record the topic on which trajectories are sent, or give a CSV file')
    name = topic or found[0]
    raw = bag.read([name])[name]
    if not 0 < len(raw.data) <= MOST_MESSAGES:
        msg = f'topic {name} has {len(raw.data)} messages; expected 1 to {MOST_MESSAGES}'
        raise BagError(msg, place=path, remedy='give a bag that holds the trajectory')
    return [_decode(data, name, int(time), f'{path}, message {number} (from 1) of {name}')
            for number, (data, time) in enumerate(zip(raw.data, raw.log_time, strict=True), 1)]


def _decode(data: bytes, topic: str, time: int, place: str) -> Sent:
    """Read one message; whatever is wrong with it is said with its place."""
    try:
        message: Any = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(data, TRAJECTORY)
    except Exception as err:  # rosbags raises whatever the bytes lead it to
        msg = f'cannot be read as {TRAJECTORY} ({type(err).__name__})'
        raise BagError(msg, place=place, remedy='the bag is damaged; record it again') from None
    joints, stamp = tuple(message.joint_names), message.header.stamp
    if len(joints) > MAX_NAMES:
        raise BagError(f'has {len(joints)} joints; record at most {MAX_NAMES}', place=place)
    t = np.array([point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec
                  for point in message.points])
    try:
        found = Trajectory.from_points(joints, t, *(
            [getattr(point, field) for point in message.points] for field in POINT_FIELDS[:3]))
    except TudorError as err:
        raise err.at(place) from None
    return Sent(found, topic, time, stamp.sec * SECOND + stamp.nanosec, message.header.frame_id)


def write_trajectories(path: Path, sent: Sequence[Sent], *, overwrite: bool = False) -> None:
    """Write one as a table (``.csv``), or several as a bag."""
    if not is_table(path):
        topics: dict[str, list[Sent]] = {}
        for item in sent:
            topics.setdefault(item.topic or '/joint_trajectory', []).append(item)
        write_bag(path, [RawMessages(
            topic, TRAJECTORY, np.array([item.time for item in own], dtype=np.int64),
            [item.encode() for item in own]) for topic, own in topics.items()],
            overwrite=overwrite)
        return
    if len(sent) != 1:
        msg = f'{len(sent)} trajectories do not fit into one CSV file'
        raise UsageError(msg, place=path, remedy='give a name without .csv to write a bag')
    write_whole(path, sent[0].trajectory.table())
