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

"""Bulk decoding and encoding of CDR against rosbags, message by message."""

from bag_making import joint_states, times
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores

from tudor_dynamics.bags.messages import (
    decode, FIELDS, IMU, JOINT_STATE, joint_state_layout, LAYOUTS, Signals, WRENCH_STAMPED)
from tudor_dynamics.bags.writer import encode
from tudor_dynamics.errors import BagError

STORE = get_typestore(Stores.ROS2_JAZZY)
NAMES = st.lists(st.text(max_size=9).filter(lambda s: '\0' not in s), max_size=5)
NUMBER = st.floats(allow_nan=True, width=64)


def header(sec, nanosec, frame_id):
    """Make a std_msgs/Header."""
    time = STORE.types['builtin_interfaces/msg/Time'](sec=sec, nanosec=nanosec)
    return STORE.types['std_msgs/msg/Header'](stamp=time, frame_id=frame_id)


def serialize(message, msgtype, little):
    """Encode with rosbags."""
    return bytes(STORE.serialize_cdr(message, msgtype, little_endian=little))


@st.composite
def joint_state(draw):
    """Draw a JointState and its byte order; arrays of any length."""
    frame = draw(st.text(max_size=5).filter(lambda s: '\0' not in s))
    arrays = {field: np.array(draw(st.lists(NUMBER, max_size=5)), dtype=float)
              for field in FIELDS}
    message = STORE.types[JOINT_STATE](
        header=header(draw(st.integers(-2**31, 2**31 - 1)), draw(st.integers(0, 2**32 - 1)),
                      frame),
        name=draw(NAMES), **arrays)
    return serialize(message, JOINT_STATE, draw(st.booleans()))


@settings(max_examples=150, deadline=None)
@given(st.lists(joint_state(), min_size=1, max_size=5), st.lists(st.integers(0, 4), max_size=9))
def test_joint_states_decode_as_with_rosbags(kinds, order):
    """Any mixture of layouts and byte orders gives what rosbags gives, in order."""
    messages = kinds + [kinds[i % len(kinds)] for i in order]
    seen = []
    for block in decode(messages, joint_state_layout, '/t'):
        for row, index in enumerate(block.index):
            expected = STORE.deserialize_cdr(messages[index], JOINT_STATE)
            stamp = expected.header.stamp
            assert block.stamp[row] == stamp.sec * 10**9 + stamp.nanosec
            assert block.layout.frame_id == expected.header.frame_id
            assert list(block.layout.names) == expected.name
            for field in FIELDS:
                np.testing.assert_array_equal(block.values(field)[row], getattr(expected, field))
            seen.append(index)
    assert sorted(seen) == list(range(len(messages)))


@settings(max_examples=60, deadline=None)
@given(st.lists(NUMBER, min_size=6, max_size=6), st.text(max_size=6), st.booleans())
def test_wrenches_decode_as_with_rosbags(values, frame, little):
    """Force and torque come out as rosbags reads them."""
    frame = frame.replace('\0', '')
    vector = STORE.types['geometry_msgs/msg/Vector3']
    wrench = STORE.types['geometry_msgs/msg/Wrench'](
        force=vector(*values[:3]), torque=vector(*values[3:]))
    raw = serialize(STORE.types[WRENCH_STAMPED](header=header(3, 4, frame), wrench=wrench),
                    WRENCH_STAMPED, little)
    block, = decode([raw, raw], LAYOUTS[WRENCH_STAMPED], '/w')
    np.testing.assert_array_equal(block.values('force'), [values[:3]] * 2)
    np.testing.assert_array_equal(block.values('torque'), [values[3:]] * 2)
    assert block.layout.frame_id == frame


@settings(max_examples=300, deadline=None)
@given(joint_state(), st.data())
def test_damaged_messages_are_refused_or_decoded(raw, data):
    """Cuts and flipped bytes give arrays or a BagError, nothing else."""
    raw = bytearray(raw[:data.draw(st.integers(0, len(raw)))])
    if raw:
        for place in data.draw(st.lists(st.integers(0, len(raw) - 1), max_size=4)):
            raw[place] = data.draw(st.integers(0, 255))
    try:
        for block in decode([bytes(raw)], joint_state_layout, '/t'):
            for field in FIELDS:
                block.values(field)
    except BagError as err:
        assert 'message 1 of 1' in str(err)


def test_garbage_in_padding_is_no_layout():
    """Bytes of alignment, which a middleware need not clear, do not split the layout."""
    first = bytearray(encode(joint_states(frame='ab')).data[0])
    # frame_id 'ab' + NUL ends at byte 19, the count of names begins at byte 20.
    assert first[16:19] == b'ab\0'
    second = first.copy()
    second[19] = 0xAA
    assert len(decode([bytes(first), bytes(second)], joint_state_layout, '/t')) == 1


def test_too_many_layouts_are_refused():
    """A topic that changes its frame all the time ends in one clear line."""
    one = bytes(encode(joint_states(times()[:1], 'f0000')).data[0])
    messages = [one.replace(b'f0000', b'f%04d' % i) for i in range(300)]
    with pytest.raises(BagError, match='vary in more than 256 ways'):
        decode(messages, joint_state_layout, '/t')


@pytest.mark.parametrize('absent', [(), ('velocity',), ('position', 'velocity'), FIELDS])
def test_signals_encode_as_with_rosbags(absent):
    """The bytes of messages are those of rosbags' serialize_cdr."""
    series = joint_states(frame='base', **dict.fromkeys(absent))
    encoded = encode(series).data
    for index in (0, 7):
        stamp = int(series.stamp[index])
        arrays = {field: series.values[field][index] if field in series.values else np.empty(0)
                  for field in FIELDS}
        message = STORE.types[JOINT_STATE](
            header=header(stamp // 10**9, stamp % 10**9, 'base'), name=list(series.names),
            **arrays)
        assert encoded[index] == serialize(message, JOINT_STATE, True)


def test_wrenches_decode_to_themselves():
    """Encoding is the inverse of decoding; rosbags reads the same."""
    stamp = np.array([0, 5_000_000_001])
    force, torque = np.arange(6.0).reshape(2, 3), -np.arange(6.0).reshape(2, 3)
    raw = encode(Signals('/w', stamp, {'force': force, 'torque': torque}, frame='tip',
                         msgtype=WRENCH_STAMPED)).data
    block, = decode(raw, LAYOUTS[WRENCH_STAMPED], '/w')
    np.testing.assert_array_equal(block.stamp, stamp)
    np.testing.assert_array_equal(block.values('force'), force)
    np.testing.assert_array_equal(block.values('torque'), torque)
    message = STORE.deserialize_cdr(raw[1], WRENCH_STAMPED)
    assert (message.wrench.force.y, message.wrench.torque.z) == (4.0, -5.0)


@pytest.mark.parametrize(('changes', 'match'), [
    ({'effort': np.zeros((3, 2))}, r'shape \(3, 2\), not \(300, 2\)'),
    ({'stamp': times() - 2 * 10**18}, 'stamps from -'),
])
def test_signals_that_do_not_fit_are_refused(changes, match):
    """Shapes and stamps are checked before anything is written."""
    with pytest.raises(BagError, match=match):
        encode(joint_states(**changes))


def test_rosbags_reads_imu_messages():
    """Quaternion, rates and accelerations come back; covariances are zero: unknown."""
    stamp = np.array([1_500_000_000, 2_000_000_007])
    values = np.arange(20.0).reshape(2, 10)
    raw = encode(Signals('/imu/tip', stamp, {
        'orientation': values[:, :4], 'angular_velocity': values[:, 4:7],
        'linear_acceleration': values[:, 7:]}, frame='tip_imu', msgtype=IMU)).data
    for k, buffer in enumerate(raw):
        message = STORE.deserialize_cdr(buffer, 'sensor_msgs/msg/Imu')
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp[k]
        assert message.header.frame_id == 'tip_imu'
        q, w, a = message.orientation, message.angular_velocity, message.linear_acceleration
        assert [q.x, q.y, q.z, q.w, w.x, w.y, w.z, a.x, a.y, a.z] == values[k].tolist()
        assert not message.orientation_covariance.any()
        assert bytes(STORE.serialize_cdr(message, 'sensor_msgs/msg/Imu'))[:len(buffer)] == buffer
