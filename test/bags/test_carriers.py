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

"""Efforts and strains from Float64MultiArray and DynamicJointState, offline."""

from __future__ import annotations

from pathlib import Path
import struct
import warnings

from bag_making import currents, GAUGES, joint_states, JOINTS, make_arm, motion, START, times
from carrier_making import ARRAY, array, DELAY, DYNAMIC, dynamic, Topic, topic_of, write
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from tudor_dynamics.bags.info import describe
from tudor_dynamics.bags.messages import array_layout, CdrError, dynamic_layout
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.errors import BagError, TudorWarning


def positions() -> Topic:
    """Give joint states without efforts."""
    return topic_of(joint_states(effort=None))


def tensions(delay: int = DELAY) -> Topic:
    """Give strains as an array of four values, of which places 2 and 0 are the gauges'."""
    q, _ = motion(times())
    rows = np.column_stack([100 * q[:, 1], np.ones(len(q)), 50 * q[:, 0], -q[:, 0]])
    return Topic('/bridge', ARRAY, times() + delay, [array(row, ('a', 'b')) for row in rows])


def interfaces() -> Topic:
    """Give currents and temperatures as interfaces; the elbow has no temperature."""
    q, _ = motion(times())
    data = [dynamic(int(stamp), {
        'elbow': {'current': 3 * row[1]},
        'shoulder': {'temperature': 40.0 + row[0], 'current': 2 * row[0]}})
        for stamp, row in zip(times(), q, strict=True)]
    return Topic('/dynamic_joint_states', DYNAMIC, times() + DELAY, data)


def arm(**effort: object) -> object:
    """Describe the arm of these topics."""
    return make_arm(
        joints=[{'name': name, 'effort': {'topic': 'dynamic_joint_states', 'unit': 'A',
                                          'interface': 'current', **effort}} for name in JOINTS],
        gauges=[{'name': GAUGES[0], 'joint': JOINTS[0], 'distance': 0.05, 'topic': 'bridge',
                 'index': 2},
                {'name': GAUGES[1], 'joint': JOINTS[1], 'distance': 0.05, 'topic': 'bridge',
                 'index': 0}])


@pytest.mark.parametrize('plugin', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_values_are_found_by_place_and_interface(tmp_path: Path, plugin: StoragePlugin) -> None:
    """Whatever the order in the messages; arrays get the log times less the usual delay."""
    bag = write(tmp_path / 'bag', positions(), tensions(), interfaces(), plugin=plugin)
    with pytest.warns(TudorWarning, match='on /bridge have no stamp, .* minus 3 ms for the usual'):
        found = read_recording(bag, arm())
    q, _ = motion(found.stamp)
    assert found.effort == pytest.approx(q * [2.0, 3.0])
    assert found.strain == pytest.approx(q * [50.0, 100.0])


def test_arrays_that_are_late_are_interpolated(tmp_path: Path) -> None:
    """A stream between the stamps of the joint states is brought onto them."""
    bag = write(tmp_path / 'bag', positions(), tensions(DELAY + 4_000_000), interfaces())
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', TudorWarning)
        found = read_recording(bag, arm())
    q, _ = motion(found.stamp - 4_000_000)
    assert np.abs(found.strain - q * [50.0, 100.0]).max() < 0.02


def test_info_says_what_is_there(tmp_path: Path) -> None:
    """Places of arrays and interfaces of joints with their ranges."""
    report = describe(write(tmp_path / 'bag', positions(), tensions(), interfaces()))
    topics = {topic.name: topic for topic in report.topics}
    bridge, dynamics = topics['/bridge'], topics['/dynamic_joint_states']
    assert bridge.names == ['0', '1', '2', '3'] and bridge.fields == ['data']
    assert bridge.clock == 'log' and bridge.rate == pytest.approx(100.0)
    assert next(c for c in bridge.channels if c.name == '1').maximum == 1.0
    assert dynamics.names == ['elbow', 'shoulder']
    assert set(dynamics.fields) == {'current', 'temperature'}
    hot = next(c for c in dynamics.channels if (c.name, c.field) == ('shoulder', 'temperature'))
    assert hot.maximum == pytest.approx(41.0, abs=0.1) and hot.not_finite == 0
    missing = next(c for c in dynamics.channels if (c.name, c.field) == ('elbow', 'temperature'))
    assert missing.maximum is None


@pytest.mark.parametrize(('effort', 'text'), [
    ({'interface': None}, 'expected sensor_msgs/msg/JointState; say with interface: NAME'),
    ({'interface': None, 'index': 0}, 'expected std_msgs/msg/Float64MultiArray; say with interf'),
    ({'topic': 'bridge'}, 'expected control_msgs/msg/DynamicJointState; say with index: N'),
])
def test_a_topic_of_another_type_is_refused(
    tmp_path: Path, effort: dict[str, object], text: str,
) -> None:
    """One line says which type it is and what to write instead."""
    bag = write(tmp_path / 'bag', positions(), tensions(), interfaces())
    described = {'topic': 'dynamic_joint_states', 'unit': 'A', 'interface': 'current', **effort}
    joints = [{'name': name, 'effort': described} for name in JOINTS]
    with pytest.raises(BagError, match=text):
        read_recording(bag, make_arm(joints=joints, gauges=[]))


def test_places_and_interfaces_that_are_not_there(tmp_path: Path) -> None:
    """Are lacking, as names are that a JointState does not have."""
    bag = write(tmp_path / 'bag', positions(), tensions(), interfaces())
    with pytest.warns(TudorWarning, match="no voltage of 'shoulder', 'elbow' in /dynamic_joint"):
        assert read_recording(bag, arm(interface='voltage')).effort is None
    with pytest.warns(TudorWarning, match="no data of 'shoulder', 'elbow' in /bridge, which has"):
        assert read_recording(bag, arm(topic='bridge', interface=None, index=9)).effort is None


def test_another_definition_is_refused(tmp_path: Path) -> None:
    """Where the bag says that its messages are made otherwise, none of them is read."""
    bag = write(tmp_path / 'bag', positions(), interfaces())
    file, = (item for item in bag.iterdir() if item.suffix == '.mcap')
    content = file.read_bytes()
    assert b'float64[] values' in content
    file.write_bytes(content.replace(b'float64[] values', b'float32[] values'))
    expected = r'InterfaceValue in .* is .*float32\[\] values.* expected .*float64'
    with pytest.raises(BagError, match=expected):
        read_recording(bag, arm())
    report = describe(bag)  # which may have nothing to do with the arm
    assert any('InterfaceValue' in text for text in report.odd) and len(report.topics) == 2


def test_index_and_interface_exclude_each_other() -> None:
    """A value is in an array, or an interface."""
    with pytest.raises(ValueError, match='not both'):
        arm(index=1)


@settings(deadline=None)
@given(st.lists(st.floats(allow_nan=False), max_size=9), st.lists(st.text(
    st.characters(exclude_characters='\0', exclude_categories=['Cs']), max_size=5), max_size=3))
def test_arrays_as_rosbags_writes_them(values: list[float], labels: list[str]) -> None:
    """Whatever the dimensions are called, the values are found."""
    buffer = array(np.array(values), tuple(labels))
    layout = array_layout(buffer)
    rows = np.frombuffer(buffer, np.uint8)[None]
    assert layout.names == tuple(str(number) for number in range(len(values)))
    assert layout.numbers(rows, *layout.fields['data']).tolist() == [values]


@settings(deadline=None)
@given(st.binary(max_size=200), st.integers(0, 150), st.integers(0, 255))
def test_damaged_messages_are_refused(tail: bytes, place: int, value: int) -> None:
    """Any bytes: a layout within the buffer, or the one error."""
    sound = dynamic(START, {'a': {'current': 1.0, 'effort': 2.0}, 'b': {}})
    changed = bytearray(sound)
    changed[min(place, len(sound) - 1)] = value
    for buffer in (b'\x00\x01\x00\x00' + tail, bytes(changed), sound[:place]):
        for parse in (array_layout, dynamic_layout):
            try:
                layout = parse(buffer)
            except CdrError:
                continue
            assert layout.significant.size == len(buffer)


def test_a_message_may_not_announce_more_than_it_has() -> None:
    """Counts beyond the buffer are refused before anything is made of them."""
    for count in (2**31, 10**6):
        with pytest.raises(CdrError):
            array_layout(b'\x00\x01\x00\x00' + struct.pack('<I', count) + bytes(64))


def test_currents_stay_what_they_were(tmp_path: Path) -> None:
    """An arm of plain JointStates reads the same beside such topics."""
    bag = write(tmp_path / 'bag', positions(), tensions(), topic_of(currents()))
    with warnings.catch_warnings():
        warnings.simplefilter('error', TudorWarning)
        found = read_recording(bag, make_arm(gauges=[]))
    assert found.effort == pytest.approx(2 * motion(found.stamp)[0])
