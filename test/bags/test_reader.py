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

"""From a bag to a Recording: names, fields, stamps, gaps, and what is refused."""

from bag_making import (
    currents, GAUGES, joint_states, JOINTS, make_arm, make_bag, motion, plain_arm, START, strains,
    times, write_raw)
import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores

from tudor_dynamics.bags.messages import joint_signals, Signals, WRENCH_STAMPED
from tudor_dynamics.bags.reader import read_recording, read_wrenches
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.bags.writer import encode, recording_series, write_bag
from tudor_dynamics.errors import BagError, TudorWarning


def read_warned(path, arm, match, **options):
    """Read a bag that must give a warning."""
    with pytest.warns(TudorWarning, match=match):
        return read_recording(path, arm, **options)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_recording_has_all_signals(tmp_path, recwarn, storage):
    """Positions, velocities, currents and strains come back exactly, without a warning."""
    series = (joint_states(effort=None), currents(), strains())
    bag = make_bag(tmp_path / 'b', *series, storage=storage)
    found = read_recording(bag, make_arm(), need_output=True, need_motion=True)
    np.testing.assert_array_equal(found.stamp, times())
    np.testing.assert_array_equal(found.q, series[0].values['position'])
    np.testing.assert_array_equal(found.dq, series[0].values['velocity'])
    np.testing.assert_array_equal(found.effort, series[1].values['effort'])
    np.testing.assert_array_equal(found.strain, series[2].values['position'])
    assert (found.dt, found.segments, found.dropped) == (0.01, (slice(0, 300),), {})
    assert not recwarn.list and not found.warnings and len(found.checksum) == 64


def test_joints_are_found_by_name(tmp_path):
    """The order may change from message to message; other joints are ignored."""
    first, second = times()[:150], times()[150:]
    q, dq = motion(second)
    pad = np.full((150, 1), 9.0)
    other = joint_signals('/joint_states', second, ('elbow', 'gripper', 'shoulder'),
                          np.hstack([q[:, 1:], pad, q[:, :1]]),
                          np.hstack([dq[:, 1:], pad, dq[:, :1]]))
    # Two series on one topic make two layouts; the writer wants each topic once.
    data = encode(joint_states(first, effort=None)).data + encode(other).data
    bag = tmp_path / 'b'
    write_raw(bag, times(), data)
    found = read_recording(bag, plain_arm())
    np.testing.assert_array_equal(found.q, motion(times())[0])
    np.testing.assert_array_equal(found.dq, motion(times())[1])


def test_two_publishers_share_a_topic(tmp_path):
    """Messages of a gripper between those of the arm do not disturb."""
    gripper = joint_signals('/joint_states', times() + 3_000_000, ('finger',),
                            np.ones((300, 1)))
    pairs = sorted(zip([*times(), *gripper.stamp], encode(joint_states()).data
                       + encode(gripper).data, strict=True), key=lambda pair: pair[0])
    write_raw(tmp_path / 'b', np.array([time for time, _ in pairs]), [raw for _, raw in pairs])
    found = read_recording(tmp_path / 'b', plain_arm())
    np.testing.assert_array_equal(found.stamp, times())
    assert found.dropped == {}


@pytest.mark.parametrize('topic', ['/joint_states', 'joint_states', '/left/joint_states'])
def test_topic_is_found_with_and_without_namespace(tmp_path, topic):
    """The description says joint_states; the bag may have it in a namespace."""
    bag = make_bag(tmp_path / 'b', joint_states(topic=topic))
    assert len(read_recording(bag, plain_arm()).stamp) == 300


def test_ambiguous_namespace_is_refused(tmp_path):
    """Two arms in one bag: the description must say which."""
    bag = make_bag(tmp_path / 'b', joint_states(topic='/a/joint_states'),
                   joint_states(topic='/b/joint_states'))
    with pytest.raises(BagError, match='/a/joint_states, /b/joint_states'):
        read_recording(bag, plain_arm())


def test_absent_fields_and_topics_are_none(tmp_path):
    """No velocity, no currents, no strains: None, and a warning for what was described."""
    bag = make_bag(tmp_path / 'b', joint_states(velocity=None, effort=None))
    found = read_warned(bag, make_arm(), 'no topic motor_currents')
    assert found.dq is None and found.effort is None and found.strain is None
    with pytest.warns(TudorWarning), pytest.raises(BagError, match='neither efforts nor strains'):
        read_recording(bag, make_arm(), need_output=True)


def test_only_what_is_absent_counts_as_a_reason(tmp_path):
    """A gauge that stands still is odd, but not why there are no strains; the other's topic is."""
    topics = ('blade_1', 'blade_2')
    arm = make_arm(gauges=[{'name': gauge, 'joint': joint, 'distance': 0.05, 'topic': topic}
                           for gauge, joint, topic in zip(GAUGES, JOINTS, topics, strict=True)])
    bag = make_bag(tmp_path / 'b', joint_states(velocity=None, effort=None), joint_states(
        topic='/blade_1', names=GAUGES[:1], position=np.ones((300, 1)), velocity=None,
        effort=None))
    with pytest.warns(TudorWarning, match='never changes'), pytest.raises(BagError) as caught:
        read_recording(bag, arm, need_output=True)
    assert 'no topic blade_2' in caught.value.cause and 'never' not in caught.value.cause
    assert caught.value.place == str(bag)
    assert str(caught.value).startswith(f'{bag}: the bag has neither')


def test_velocity_in_some_messages_is_not_used(tmp_path):
    """Velocities that come and go are left to differentiation."""
    data = (encode(joint_states(times()[:200])).data
            + encode(joint_states(times()[200:], velocity=None)).data)
    write_raw(tmp_path / 'b', times(), data)
    found = read_warned(tmp_path / 'b', plain_arm(), 'only 200 of 300 messages on /joint_states')
    assert found.dq is None and len(found.stamp) == 300


def test_velocity_that_is_nan_throughout_is_absent(tmp_path):
    """joint_state_broadcaster fills interfaces that are not there with NaN."""
    bag = make_bag(tmp_path / 'b', joint_states(velocity=np.full((300, 2), np.nan)))
    assert read_warned(bag, plain_arm(), 'shoulder, elbow in .* is always NaN').dq is None


def test_streams_of_other_rates_are_interpolated(tmp_path):
    """Currents at 40 Hz with an offset are brought onto joint states at 100 Hz."""
    slow = START + 7_000_000 + 25_000_000 * np.arange(110)
    line = (slow - START)[:, None] * 1e-9 * np.array([3.0, -2.0])
    bag = make_bag(tmp_path / 'b', joint_states(effort=None), currents(slow, effort=line),
                   strains())
    found = read_warned(bag, make_arm(), 'comes every 25 ms')
    np.testing.assert_allclose(found.effort, found.t[:, None] * [3.0, -2.0] + [0.03, -0.02],
                               atol=1e-9)
    inside = (times() >= slow[0]) & (times() <= slow[-1])
    np.testing.assert_array_equal(found.stamp, times()[inside])
    assert found.dropped == {'no_neighbour': int(np.sum(~inside))}


def test_nothing_is_interpolated_across_a_gap(tmp_path):
    """Joint states without currents close before and after are left out."""
    keep = np.r_[0:100, 120:300]
    bag = make_bag(tmp_path / 'b', joint_states(effort=None), currents(times()[keep]), strains())
    found = read_warned(bag, make_arm(), 'gap')
    np.testing.assert_array_equal(found.stamp, times()[keep])
    assert found.dropped == {'no_neighbour': 20}
    assert found.segments == (slice(0, 100), slice(100, 280))


def test_clocks_that_do_not_overlap_are_refused(tmp_path):
    """Currents stamped an hour later cannot be aligned."""
    bag = make_bag(tmp_path / 'b', joint_states(effort=None),
                   currents(times() + 3600 * 10**9, effort=currents().values['effort']))
    with pytest.raises(BagError, match='same clock'):
        read_recording(bag, make_arm())


def test_duplicate_and_backward_stamps_are_dropped(tmp_path):
    """Each is counted by its cause; the first message of a stamp stays."""
    stamp = times().copy()
    stamp[50:53] = stamp[49]
    stamp[80] = stamp[70] + 1
    write_raw(tmp_path / 'b', times(), encode(joint_states(stamp)).data)
    found = read_warned(tmp_path / 'b', plain_arm(), 'duplicate stamp')
    assert found.dropped == {'duplicate_stamp': 3, 'backward_stamp': 1}
    assert np.all(np.diff(found.stamp) > 0) and len(found.stamp) == 296
    assert stamp[49] in found.stamp


def test_stamps_that_stand_still_are_refused(tmp_path):
    """A frozen clock is no recording."""
    write_raw(tmp_path / 'b', times(), encode(joint_states(np.full(300, START))).data)
    with pytest.raises(BagError, match='of 300 stamps of position in /joint_states, 299 repeat'):
        read_recording(tmp_path / 'b', plain_arm())


def test_log_times_replace_stamps_that_are_not_set(tmp_path):
    """Zero stamps: log times with a warning; without these, an error with a remedy."""
    data = encode(joint_states(position=motion(times())[0], stamp=np.zeros(300, np.int64),
                               velocity=motion(times())[1], effort=None)).data
    write_raw(tmp_path / 'b', times(), data)
    found = read_warned(tmp_path / 'b', plain_arm(), 'stamps on /joint_states are zero, so')
    np.testing.assert_array_equal(found.stamp, times())
    write_raw(tmp_path / 'c', np.zeros(300, np.int64), data)
    with pytest.raises(BagError, match=r'set header\.stamp'):
        read_recording(tmp_path / 'c', plain_arm())


def test_simulated_time_from_zero_is_no_missing_stamp(tmp_path, recwarn):
    """A recording whose first stamp is 0 s keeps all its samples."""
    stamp = times() - START
    q, dq = motion(times())
    bag = make_bag(tmp_path / 'b', joint_states(stamp, position=q, velocity=dq))
    assert len(read_recording(bag, plain_arm()).stamp) == 300
    assert not recwarn.list


def test_gap_splits_the_record(tmp_path):
    """Two seconds without messages make two segments; the warning says how long."""
    stamp = np.r_[times()[:100], times()[100:] + 2 * 10**9]
    bag = make_bag(tmp_path / 'b', joint_states(stamp))
    found = read_warned(bag, plain_arm(), r'1 gap.*longest 2\.010 s, first after 0\.990 s')
    assert found.segments == (slice(0, 100), slice(100, 300))


def test_lost_messages_are_no_gap_and_lonely_ones_are_dropped(tmp_path):
    """Four lost messages leave one segment; three samples between gaps are left out."""
    keep = np.r_[0:50, 54:150, 180:183, 220:300]
    bag = make_bag(tmp_path / 'b', joint_states(times()[keep]))
    found = read_warned(bag, plain_arm(), '3 samples stand alone')
    assert found.dropped == {'isolated': 3}
    assert [part.stop - part.start for part in found.segments] == [146, 80]


@pytest.mark.parametrize('value', [np.nan, np.inf])
def test_few_samples_that_are_not_finite_are_left_out(tmp_path, value):
    """The warning names joint, count and time of the first."""
    series = joint_states()
    series.values['effort'][100:103, 1] = value
    found = read_warned(make_bag(tmp_path / 'b', series), plain_arm(),
                        r"'elbow' .in 3 of 300 samples.*, first after 1\.000 s")
    assert found.dropped == {'not_finite': 3}
    assert len(found.stamp) == 297 and np.isfinite(found.effort).all()
    assert not np.isin(times()[100:103], found.stamp).any()


@pytest.mark.parametrize('field', ['position', 'effort'])
def test_channel_of_nan_is_refused(tmp_path, field):
    """A joint that is never measured cannot be left out silently."""
    series = joint_states()
    series.values[field][:, 1] = np.nan
    with pytest.raises(BagError, match=f"{field} in /joint_states is .* 'elbow' .in 300 of 300"):
        read_recording(make_bag(tmp_path / 'b', series), plain_arm())


@pytest.mark.parametrize('extra', [-1, 1])
@pytest.mark.parametrize('field', ['position', 'velocity', 'effort'])
def test_arrays_of_another_length_than_names_are_refused(tmp_path, field, extra):
    """Topic, message and both lengths are named."""
    store, kind = get_typestore(Stores.ROS2_JAZZY), 'sensor_msgs/msg/JointState'
    data = encode(joint_states()).data
    for index in range(120, 300):
        message = store.deserialize_cdr(data[index], kind)
        setattr(message, field, np.ones(2 + extra))
        data[index] = bytes(store.serialize_cdr(message, kind))
    write_raw(tmp_path / 'b', times(), data)
    with pytest.raises(BagError, match=f'message 121 on /joint_states has {2 + extra} '
                                       f'values in {field}, but 2 names'):
        read_recording(tmp_path / 'b', plain_arm())


@pytest.mark.parametrize('factors', [(57.29578, 57.29578), (57.29578, 1.0), (1.0, 57.29578)])
def test_degrees_are_refused(tmp_path, factors):
    """In positions, in velocities, and in both."""
    q, dq = motion(times())
    bag = make_bag(tmp_path / 'b', joint_states(position=factors[0] * q, velocity=factors[1] * dq))
    with pytest.raises(BagError, match='look like degrees.*publish rad'):
        read_recording(bag, plain_arm())


def test_degrees_without_velocity_are_refused(tmp_path):
    """Positions alone show by their size."""
    bag = make_bag(tmp_path / 'b', joint_states(position=57.3 * motion(times())[0],
                                                velocity=None))
    with pytest.raises(BagError, match='look like degrees'):
        read_recording(bag, plain_arm())


def test_wrapped_positions_are_no_degrees(tmp_path):
    """Positions in [0, 2 pi) of a joint that may go from -1 to 1 rad are read."""
    q, dq = motion(times())
    bag = make_bag(tmp_path / 'b', joint_states(position=q % (2.0 * np.pi), velocity=None))
    limited = plain_arm(limits={'lower': -1.0, 'upper': 1.0})
    assert np.ptp(read_recording(bag, limited).q[:, 0]) > 6.0


def test_small_degrees_show_against_the_limits(tmp_path):
    """Nine degrees are no turn: a warning for the speed; far beyond limits of one radian."""
    q, dq = motion(times())
    bag = make_bag(tmp_path / 'b', joint_states(position=9 * q, velocity=9 * dq))
    read_warned(bag, plain_arm(), 'in rad, not in degrees')
    with pytest.raises(BagError, match='shoulder goes to .* beyond 4 rad'):
        read_recording(bag, plain_arm(limits={'lower': -1.0, 'upper': 1.0}))


@pytest.mark.parametrize('kind', ['continuous', 'prismatic'])
def test_other_joints_may_go_far(tmp_path, kind):
    """A wheel turns many times, a gantry travels many metres."""
    t = (times() - START)[:, None] * 1e-9
    q, dq = t * [10.0, 8.0], np.tile([10.0, 8.0], (300, 1))
    unit = {'unit': 'N' if kind == 'prismatic' else 'N m'}
    bag = make_bag(tmp_path / 'b', joint_states(position=q, velocity=dq))
    assert read_recording(bag, plain_arm(type=kind, effort=unit)).q.max() > 25


@pytest.mark.parametrize(('factor', 'match'), [
    (-1.0, 'opposite sign'), (2.0, '2 times the derivative'), (0.0, 'always zero')])
def test_velocities_that_contradict_positions_are_warned_of(tmp_path, factor, match):
    """Signs, factors, and velocities that nobody measures."""
    bag = make_bag(tmp_path / 'b', joint_states(velocity=factor * motion(times())[1]))
    read_warned(bag, plain_arm(), match)


def test_noise_in_place_of_velocity_is_warned_of(tmp_path):
    """A velocity that has nothing to do with the position is named."""
    noise = np.random.default_rng(1).normal(size=(300, 2)).cumsum(axis=0)
    bag = make_bag(tmp_path / 'b', joint_states(velocity=noise))
    read_warned(bag, plain_arm(), 'does not follow its position')


def test_standing_still_is_refused_for_learning_only(tmp_path):
    """A constant pose with encoder noise is a recording, but nothing can be learned from it."""
    noise = np.random.default_rng(2).choice([0.0, 2e-4], size=(300, 2))
    bag = make_bag(tmp_path / 'b', joint_states(position=1 + noise, velocity=0 * noise))
    read_warned(bag, plain_arm(), 'no joint moves')
    with pytest.raises(BagError, match=r'no joint moves \(shoulder, elbow'):
        read_recording(bag, plain_arm(), need_motion=True)


@pytest.mark.parametrize('stamp', [times(40, 0.05), times(90, 0.01)])
def test_short_recordings_are_refused(tmp_path, stamp):
    """Fewer than 50 samples, or less than a second."""
    with pytest.raises(BagError, match='too short'):
        read_recording(make_bag(tmp_path / 'b', joint_states(stamp)), plain_arm())


def test_missing_joint_is_refused_with_both_lists(tmp_path):
    """The user sees what the bag has and what was wanted."""
    bag = make_bag(tmp_path / 'b', joint_states(names=('shoulder', 'elbo')))
    with pytest.raises(BagError) as caught:
        read_recording(bag, plain_arm())
    assert 'which has elbo, shoulder; the' in str(caught.value)
    assert 'names shoulder, elbow, so' in str(caught.value)


def wrenches(topic, force):
    """Give signals of forces, with the opposite torques."""
    return Signals(topic, times(), {'force': force, 'torque': -force}, frame='tip',
                   msgtype=WRENCH_STAMPED)


def test_other_type_and_missing_topic_are_refused(tmp_path):
    """A topic of the right name and the wrong type, and no topic at all."""
    wrench = wrenches('/joint_states', np.zeros((300, 3)))
    with pytest.raises(BagError, match='WrenchStamped, expected sensor_msgs'):
        read_recording(make_bag(tmp_path / 'b', wrench), plain_arm())
    with pytest.raises(BagError, match='is on /motor_currents'):
        read_recording(make_bag(tmp_path / 'c', currents()), plain_arm())


def test_effort_of_another_joint_is_told(tmp_path):
    """Currents under other names leave the effort out and say which names there are."""
    bag = make_bag(tmp_path / 'b', joint_states(effort=None), currents(names=('m1', 'm2')),
                   strains())
    found = read_warned(bag, make_arm(), 'which has it of m1, m2')
    assert found.effort is None and found.strain is not None


def test_wrenches_are_read(tmp_path):
    """Force, torque and frame come back; a bag without the topic has none."""
    force = np.arange(900.0).reshape(300, 3)
    bag = make_bag(tmp_path / 'b', wrenches('/applied_wrench', force))
    found = read_wrenches(open_bag(bag))
    np.testing.assert_array_equal(found.stamp, times())
    np.testing.assert_array_equal(found.values['force'], force)
    np.testing.assert_array_equal(found.values['torque'], -force)
    assert set(found.frame) == {'tip'} and found.topic == '/applied_wrench'
    assert read_wrenches(open_bag(make_bag(tmp_path / 'c'))) is None
    with pytest.raises(BagError, match='expected geometry_msgs/msg/WrenchStamped or'):
        read_wrenches(open_bag(bag.parent / 'c'), 'joint_states')


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_bags_are_written_whole_and_reproducibly(tmp_path, storage):
    """The same arrays give the same bytes; nothing else is left in the folder."""
    series = (joint_states(), currents(times(77, 0.037)), strains())
    for folder in ('a', 'b'):
        make_bag(tmp_path / folder / 'bag', *series, storage=storage)
    files = sorted(item.name for item in (tmp_path / 'a' / 'bag').iterdir())
    assert len(files) == 2
    for name in files:
        first, second = ((tmp_path / folder / 'bag' / name).read_bytes() for folder in 'ab')
        assert first == second
    assert [item.name for item in (tmp_path / 'a').iterdir()] == ['bag']


def test_writer_leaves_nothing_half_done(tmp_path):
    """Series that do not fit, an existing path and an unknown storage: refused, no trace."""
    with pytest.raises(BagError, match='has shape'):
        make_bag(tmp_path / 'b', joint_states(), strains(position=np.zeros((1, 1))))
    assert list(tmp_path.iterdir()) == []
    bag = make_bag(tmp_path / 'b')
    before = {item: item.read_bytes() for item in bag.iterdir()}
    with pytest.raises(BagError, match='exists already; choose another path=, or add overwrite='):
        make_bag(bag)
    assert before == {item: item.read_bytes() for item in bag.iterdir()}
    with pytest.raises(BagError, match="storage 'bag' is unknown"):
        make_bag(tmp_path / 'c', storage='bag')


@pytest.mark.parametrize('own', [False, True])
def test_recording_is_written_and_read_again(tmp_path, own):
    """A recording goes through its arm's topics and comes back the same."""
    joints = [{'name': JOINTS[0], 'effort': {'topic': 'motor_currents', 'unit': 'A'}},
              {'name': JOINTS[1]}] if own else None
    arm = make_arm(**({'joints': joints} if own else {}))
    effort = joint_states().values['effort'] if own else None
    bag = make_bag(tmp_path / 'b', joint_states(effort=effort), currents(), strains())
    first = read_recording(bag, arm)
    series = recording_series(first, arm)
    write_bag(tmp_path / 'c', series)
    second = read_recording(tmp_path / 'c', arm)
    for name in ('stamp', 'q', 'dq', 'effort', 'strain'):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert tuple(series[-1].names) == GAUGES
