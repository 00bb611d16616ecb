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

"""Planned motion of joints as a table (CSV) and as one JointTrajectory message."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import get_typestore, Stores

from tudor_dynamics.errors import BagError
from tudor_dynamics.files import read_bounded
from tudor_dynamics.typing import FloatArray

MAX_TABLE_BYTES = 50_000_000
TRAJECTORY = 'trajectory_msgs/msg/JointTrajectory'
ENDINGS = ('', '_velocity', '_acceleration')
"""What follows the name of a joint in the head of a table's column."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """
    Motion of joints over time.

    Attributes
    ----------
    names : tuple of str
        Joints that move, in the order of the columns.
    t : ndarray of shape (n,)
        Time from the start, ascending [s].
    q, dq, ddq : ndarray of shape (n, n_joints)
        Positions, velocities and accelerations [rad, rad/s, rad/s^2 or m, m/s, m/s^2].

    """

    names: tuple[str, ...]
    t: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray

    def table(self) -> bytes:
        """Write it as CSV: time, then position, velocity and acceleration of each joint."""
        head = ['t', *(f'{name}{ending}' for name in self.names for ending in ENDINGS)]
        columns = np.stack([self.q, self.dq, self.ddq], axis=2).reshape(len(self.t), -1)
        text = StringIO()
        np.savetxt(text, np.column_stack([self.t, columns]), fmt='%.9g', delimiter=',',
                   header=','.join(head), comments='')
        return text.getvalue().encode()


def read_trajectory(path: Path) -> Trajectory:
    """
    Read motion from a table, as `Trajectory.table` writes it.

    Parameters
    ----------
    path : Path
        CSV file: ``t``, then ``joint``, ``joint_velocity``, ``joint_acceleration`` of each joint.

    Returns
    -------
    Trajectory
        Motion.

    Raises
    ------
    BagError
        If it is no such table; the message says what is wrong where.

    """
    try:
        text = read_bounded(path, MAX_TABLE_BYTES).decode()
    except (OSError, ValueError) as err:
        msg = f'the trajectory cannot be read ({getattr(err, "strerror", None) or err})'
        raise BagError(msg, place=path) from None
    head, _, body = text.partition('\n')
    columns = [name.strip() for name in head.split(',')]
    names = tuple(columns[1::3])
    wanted = ['t', *(f'{name}{ending}' for name in names for ending in ENDINGS)]
    if columns != wanted or not names or len(set(names)) < len(names):
        msg = (f'the first line is {head[:200]!r}; expected t, then joint, joint_velocity, '
               'joint_acceleration of each joint')
        raise BagError(msg, place=path, remedy='`tudor excite` writes such a table')
    try:
        values = np.loadtxt(StringIO(body), delimiter=',', ndmin=2)
    except ValueError as err:
        raise BagError(f'a line is no row of numbers ({err})', place=path) from None
    if (values.shape[1:] != (len(columns),) or len(values) < 2 or not np.isfinite(values).all()
            or (np.diff(values[:, 0]) <= 0.0).any()):
        msg = (f'found a table of shape {values.shape}; expected two rows or more of '
               f'{len(columns)} finite numbers, times ascending')
        raise BagError(msg, place=path)
    parts = values[:, 1:].reshape(len(values), -1, 3)
    return Trajectory(names, values[:, 0], parts[:, :, 0], parts[:, :, 1], parts[:, :, 2])


@dataclass(frozen=True, eq=False)
class TrajectorySeries:
    """
    Messages of one JointTrajectory topic.

    Attributes
    ----------
    topic : str
        Full name, e.g. ``/joint_trajectory``.
    stamp : ndarray of int64, shape (n,)
        Header stamps [ns].
    trajectories : sequence of Trajectory
        One for each message.
    msgtype : str
        Type of the messages.

    """

    topic: str
    stamp: NDArray[np.int64]
    trajectories: Sequence[Trajectory]
    msgtype: str = TRAJECTORY

    def encode(self) -> list[bytes]:
        """
        Encode the messages.

        Returns
        -------
        list of bytes
            CDR buffers, little endian.

        """
        typestore = get_typestore(Stores.ROS2_JAZZY)
        types = typestore.types
        nothing = np.zeros(0)

        def message(stamp: int, trajectory: Trajectory) -> bytes:
            time = types['builtin_interfaces/msg/Time'](*divmod(stamp, 10**9))
            points = [types['trajectory_msgs/msg/JointTrajectoryPoint'](
                q, dq, ddq, nothing,
                types['builtin_interfaces/msg/Duration'](*divmod(ns, 10**9)))
                for q, dq, ddq, ns in zip(
                    trajectory.q, trajectory.dq, trajectory.ddq,
                    np.round(trajectory.t * 1e9).astype(np.int64).tolist(), strict=True)]
            return bytes(typestore.serialize_cdr(types[TRAJECTORY](
                types['std_msgs/msg/Header'](time, ''), list(trajectory.names), points),
                TRAJECTORY))
        return [message(stamp, trajectory) for stamp, trajectory in zip(
            self.stamp.tolist(), self.trajectories, strict=True)]
