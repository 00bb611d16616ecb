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

"""Trajectories as tables and as messages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from tudor_dynamics.bags.trajectory import (
    read_trajectory, Sent, Trajectory, write_trajectories)
from tudor_dynamics.errors import BagError


def sample(n: int = 50) -> Trajectory:
    """Give a motion of two joints."""
    t = np.arange(n) * 0.01
    angle = np.column_stack([t, 2.0 * t])
    return Trajectory(('a', 'b'), t, np.sin(angle), np.cos(angle), -np.sin(angle))


def test_table_and_back(tmp_path: Path) -> None:
    """A table has the same motion to nine digits."""
    path = tmp_path / 'motion.csv'
    path.write_bytes(sample().table())
    found = read_trajectory(path)
    assert found.joints == ('a', 'b')
    for name in ('t', 'q', 'dq', 'ddq'):
        np.testing.assert_allclose(getattr(found, name), getattr(sample(), name), atol=1e-8)


def test_what_is_known_goes_into_the_table(tmp_path: Path) -> None:
    """All digits of what there is, in columns of any order; efforts are written, not read."""
    path = tmp_path / 'motion.csv'
    q = np.array([[0.1, 1 / 3], [0.2, -2e-7]])
    path.write_bytes(Trajectory(('a', 'b'), np.array([0.0, 0.7]), q, effort=q * 3.0).table())
    assert path.read_text().splitlines()[0] == 't,a,a_effort,b,b_effort'
    found = read_trajectory(path)
    assert np.array_equal(found.q, q) and found.dq is None and found.effort is None
    path.write_text('# t, a_velocity, b, a, b_velocity\n0,1,2,3,4\n1,5,6,7,8\n')
    found = read_trajectory(path)
    assert found.joints == ('b', 'a') and np.array_equal(found.q, [[2, 3], [6, 7]])
    assert np.array_equal(found.dq, [[4, 1], [8, 5]])


def test_message_as_others_read_it(tmp_path: Path) -> None:
    """Rosbags reads the message: names, points, times, no effort."""
    write_trajectories(tmp_path / 'bag', [
        Sent(sample(150), time=5_000_000_000, stamp=5_000_000_000)])
    with AnyReader([tmp_path / 'bag']) as reader:
        [(connection, stamp, raw)] = list(reader.messages())
        message = reader.deserialize(raw, connection.msgtype)
    assert connection.msgtype == 'trajectory_msgs/msg/JointTrajectory' and stamp == 5_000_000_000
    assert message.joint_names == ['a', 'b'] and message.header.stamp.sec == 5
    last = message.points[-1]
    assert (last.time_from_start.sec, last.time_from_start.nanosec) == (1, 490_000_000)
    np.testing.assert_allclose(last.velocities, sample(150).dq[-1])
    assert len(last.effort) == 0


@pytest.mark.parametrize(('text', 'said'), [
    ('time,a\n0,1\n1,1\n', 'expected t, then each joint once'), ('', 'expected t, then'),
    ('t\n0\n1\n', 'expected t, then'), ('t,a,a\n0,1,1\n1,1,1\n', 'expected t, then'),
    ('t,a,b,a_velocity\n0,1,1,1\n1,1,1,1\n', 'not one for each'),
    ('t,a,a_acceleration\n0,1,1\n1,1,1\n', 'accelerations without velocities'),
    ('t,a,a_velocity,a_acceleration\n0,1,0,0\n0,1,0,0\n', 'time does not increase'),
    ('t,a,a_velocity,a_acceleration\n0,1,0,0\n1,nan,0,0\n', 'point 2 of 2 have nan'),
    ('t,a,a_velocity,a_acceleration\n0,1,0,x\n1,1,0,0\n', 'is not all numbers'),
    ('t,a\n0,1,2\n', 'its first line names 2'),
    ('t,a,a_velocity,a_acceleration,a,a_velocity,a_acceleration\n', 'expected t')])
def test_what_is_no_table(text: str, said: str, tmp_path: Path) -> None:
    """Each is refused with what is wrong, and the name of the file."""
    path = tmp_path / 'motion.csv'
    path.write_text(text)
    with pytest.raises(BagError, match=said) as caught:
        read_trajectory(path)
    assert 'motion.csv' in str(caught.value)
    with pytest.raises(BagError, match='cannot be read'):
        read_trajectory(tmp_path / 'none.csv')


@pytest.mark.parametrize(('rows', 'said'), [
    (('0,1', 'inf,1', 'inf,2'), 'time does not increase after point 1'),
    (('0,1', '1e-300,2', '1,3'), 'time does not increase after point 1'),
    (('0,1', '1,1e300'), 'positions of point 2 of 2 have 1e.300'),
    ((), 'the table has the shape')])
@pytest.mark.filterwarnings('error')
def test_numbers_that_nobody_can_square(
    rows: tuple[str, ...], said: str, tmp_path: Path,
) -> None:
    """They are refused where they are read, without a warning of what overflows."""
    path = tmp_path / 'motion.csv'
    path.write_text('\n'.join(['t,a', *rows, '']))
    with pytest.raises(BagError, match=said):
        read_trajectory(path)
