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

"""Trajectories in tables and bags: back as they went, and refused where they are damaged."""

from __future__ import annotations

from pathlib import Path

from bag_making import joint_states
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from tudor_dynamics.bags import trajectory
from tudor_dynamics.bags.trajectory import (
    read_trajectories, Sent, Trajectory, write_trajectories)
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.errors import BagError, TudorError

JOINTS = ('a', 'b')
T = np.array([0.0, 0.25, 1.0])
Q = np.array([[0.1, 1 / 3], [0.2, -1.0], [0.3, 2e-7]])


@pytest.mark.parametrize('fields', [(), (Q + 1.0,), (Q + 1.0, Q - 2.0)])
def test_what_is_written_is_read(fields: tuple[np.ndarray, ...], tmp_path: Path) -> None:
    """All digits of all fields that are there, as table and as bag, with stamps and topic."""
    path = Trajectory(JOINTS, T, Q, *fields)
    sent = [Sent(path, '/plan', 100, 7_000_000_001, 'base'),
            Sent(path.of(('b', 'a')), '/plan', 200)]
    write_trajectories(tmp_path / 'bag', sent)
    write_trajectories(tmp_path / 'path.csv', sent[:1])
    back = read_trajectories(tmp_path / 'bag')
    assert [(item.topic, item.time, item.stamp, item.frame_id) for item in back] == [
        ('/plan', 100, 7_000_000_001, 'base'), ('/plan', 200, 0, '')]
    for found, wanted in zip([*back, *read_trajectories(tmp_path / 'path.csv')],
                             [path, path.of(('b', 'a')), path], strict=True):
        assert found.trajectory.joints == wanted.joints
        for name in ('t', 'q', 'dq', 'ddq', 'effort'):
            one, other = getattr(found.trajectory, name), getattr(wanted, name)
            assert (one is None) == (other is None)
            assert one is None or np.array_equal(one, other)


def test_bags_without_trajectories_and_with_several_topics(tmp_path: Path) -> None:
    """What there is is named, and one of several topics can be chosen."""
    write_bag(tmp_path / 'states', [joint_states()])
    with pytest.raises(BagError, match='the bag has none'):
        read_trajectories(tmp_path / 'states')
    path = Trajectory(JOINTS, T, Q)
    write_trajectories(tmp_path / 'two', [Sent(path, '/one'), Sent(path, '/other')])
    with pytest.raises(BagError, match='/one, /other; choose one of these as topic'):
        read_trajectories(tmp_path / 'two')
    assert len(read_trajectories(tmp_path / 'two', '/other')) == 1
    with pytest.raises(BagError, match='expected /third of'):
        read_trajectories(tmp_path / 'two', '/third')
    with pytest.raises(TudorError, match='do not fit into one CSV file'):
        write_trajectories(tmp_path / 'path.csv', [Sent(path), Sent(path)])


WHOLE = Sent(Trajectory(JOINTS, T, Q, Q)).encode()


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 400), st.binary(min_size=1, max_size=8), st.integers(0, 60))
def test_damaged_messages(place: int, noise: bytes, cut: int) -> None:
    """Any bytes give a trajectory or one line, nothing else, and not without end."""
    data = bytearray(WHOLE)
    place %= len(data)
    data[place:place + len(noise)] = noise
    try:
        trajectory._decode(bytes(data[:len(data) - cut]), '/plan', 0, 'bag, message 0')
    except TudorError as err:
        assert 'bag, message 0' in str(err)
