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

"""Messages as bytes: the same as rclpy reads and writes."""

from __future__ import annotations

from array import array
from collections import Counter

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.nodes.common.messages import (
    JointStateDecoder, JointStateEncoder, MotionDecoder, MotionEncoder, put_trajectory,
    trajectory_of)

NAMES = st.lists(st.text(st.characters(codec='utf-8', exclude_characters='\0'), max_size=6),
                 max_size=4)
VALUES = st.lists(st.floats(width=64), max_size=4).map(lambda x: array('d', x))
FIELDS = ('position', 'velocity', 'effort')
POINT_FIELDS = ('positions', 'velocities', 'accelerations')


@st.composite
def joint_states(draw: st.DrawFn) -> JointState:
    """Draw a JointState, arrays of any length."""
    message = JointState(name=draw(NAMES))
    message.header.frame_id = draw(st.sampled_from(['', 'base', 'world_']))
    message.header.stamp.sec = draw(st.integers(-2**31, 2**31 - 1))
    message.header.stamp.nanosec = draw(st.integers(0, 2**32 - 1))
    for field in FIELDS:
        setattr(message, field, draw(VALUES))
    return message


def on_the_wire(message: object) -> bytes:
    """Serialise, without the bytes that rclpy appends because it estimates the size."""
    data = serialize_message(message)
    for size in range(max(0, len(data) - 16), len(data)):
        try:
            deserialize_message(data[:size], type(message))
        except Exception:  # noqa: B902
            continue
        return data[:size]
    return data


def nanoseconds(time: object) -> int:
    """Give a Time or Duration [ns]."""
    return time.sec * 10**9 + time.nanosec  # type: ignore[attr-defined]


@settings(max_examples=200, deadline=None)
@given(st.lists(joint_states(), min_size=1, max_size=4),
       st.lists(st.integers(0, 3), max_size=8))
def test_joint_states_are_decoded_as_by_rclpy(
    kinds: list[JointState], order: list[int],
) -> None:
    """Whatever follows on whatever: names, stamps and numbers are those of the message."""
    drops: Counter[str] = Counter()
    decoder = JointStateDecoder(drops)
    for message in kinds + [kinds[i % len(kinds)] for i in order]:
        found = decoder.decode(on_the_wire(message))
        again = decoder.decode(on_the_wire(message))
        assert found is not None and again is not None
        assert again.name is found.name  # which it is not where rclpy had to decode it
        assert found.name == list(message.name)
        assert found.stamp == nanoseconds(message.header.stamp)
        for field in FIELDS:
            np.testing.assert_array_equal(getattr(found, field), getattr(message, field))
    assert not drops


def trajectory(names: list[str], points: int, seed: int) -> JointTrajectory:
    """Make a trajectory."""
    rng = np.random.default_rng(seed)
    message = JointTrajectory(joint_names=names)
    message.header.stamp.sec, message.header.stamp.nanosec = seed, 5 * seed
    for _ in range(points):
        point = JointTrajectoryPoint(**{
            field: array('d', rng.normal(size=len(names))) for field in POINT_FIELDS})
        point.time_from_start.sec, point.time_from_start.nanosec = 3, seed
        message.points.append(point)
    return message


def test_motions_are_decoded_as_by_rclpy() -> None:
    """Names that change and points that are too many are seen."""
    drops: Counter[str] = Counter()
    decoder = MotionDecoder(drops)
    for seed, names in enumerate([['a', 'b'], ['a', 'b'], ['b', 'a'], ['long_name'], ['a', 'b']]):
        message = trajectory(names, 1, seed)
        found = decoder.decode(on_the_wire(message))
        again = decoder.decode(on_the_wire(message))
        assert found is not None and found.name == names
        assert again is not None and again.name is found.name
        assert found.stamp == nanoseconds(message.header.stamp)
        assert found.elapsed == 3 * 10**9 + seed
        for field in POINT_FIELDS:
            np.testing.assert_array_equal(
                getattr(found, field), getattr(message.points[0], field))
    for points in (0, 2):
        assert decoder.decode(serialize_message(trajectory(['a', 'b'], points, 1))) is None
    assert drops == {'not_one_point': 2}


@settings(max_examples=200, deadline=None)
@given(joint_states(), st.data())
def test_bytes_that_are_no_message_are_counted(message: JointState, data: st.DataObject) -> None:
    """A cut or damaged message gives another one or nothing, but no error."""
    drops: Counter[str] = Counter()
    decoder = JointStateDecoder(drops)
    whole = on_the_wire(message)
    assert decoder.decode(whole) is not None
    cut = bytearray(whole[:data.draw(st.integers(0, len(whole) - 1))])
    for _ in range(min(len(cut), 3)):
        cut[data.draw(st.integers(0, len(cut) - 1))] = data.draw(st.integers(0, 255))
    assert (decoder.decode(bytes(cut)) is None) == bool(drops)
    assert decoder.decode(whole) is not None


@pytest.mark.parametrize('fields', [('position',), ('effort',), FIELDS])
def test_joint_states_are_encoded_as_by_rclpy(fields: tuple[str, ...]) -> None:
    """What rclpy reads is what was written; a wrong number of values is refused."""
    encoder = JointStateEncoder(('joint2', 'j3', 'x'), fields)
    for k in range(3):
        values = [np.random.default_rng(k).normal(size=6)[::2] for _ in fields]
        found = deserialize_message(encoder.encode(10**18 + k, *values), JointState)
        assert list(found.name) == ['joint2', 'j3', 'x']
        assert nanoseconds(found.header.stamp) == 10**18 + k
        for field in FIELDS:
            expected = values[fields.index(field)] if field in fields else []
            np.testing.assert_array_equal(getattr(found, field), expected)
    with pytest.raises(ValueError, match='2 values'):
        encoder.encode(0, *[np.zeros(2)] * len(fields))


def test_motions_are_encoded_as_by_rclpy() -> None:
    """Positions, velocities, accelerations and the time since the beginning."""
    row = np.arange(6.0)
    data = MotionEncoder(('joint2', 'j3')).encode(10**18 + 7, 1_250_000_000, row)
    found = deserialize_message(data, JointTrajectory)
    assert list(found.joint_names) == ['joint2', 'j3'] and len(found.points) == 1
    assert nanoseconds(found.header.stamp) == 10**18 + 7
    assert nanoseconds(found.points[0].time_from_start) == 1_250_000_000
    for i, field in enumerate(POINT_FIELDS):
        np.testing.assert_array_equal(getattr(found.points[0], field), row[2 * i:2 * i + 2])


@pytest.mark.parametrize('orders', [1, 2, 3])
def test_trajectories_are_read_as_they_were_written(orders: int) -> None:
    """What a trajectory lacks stays empty, also where the message had it."""
    t = np.array([0.0, 0.25, 1.5])
    parts = np.random.default_rng(orders).normal(size=(orders, 3, 2))
    written = Trajectory(('a', 'b'), t, *parts)
    for message in (JointTrajectory(), put_trajectory(JointTrajectory(), Trajectory(
            ('c', 'd'), t, *np.ones((3, 3, 2))))):
        found = trajectory_of(put_trajectory(message, written))
        assert found.joints == ('a', 'b')
        np.testing.assert_array_equal(found.t, t)
        for name, part in zip(('q', 'dq', 'ddq'), [*parts, None, None], strict=False):
            np.testing.assert_array_equal(getattr(found, name), part)
