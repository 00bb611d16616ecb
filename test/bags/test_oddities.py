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

"""What a recording keeps of its bag beside the arrays: its clock, other joints, velocities."""

from __future__ import annotations

from pathlib import Path

from bag_making import joint_states, JOINTS, make_bag, motion, plain_arm, times, write_raw
import numpy as np
import pytest

from tudor_dynamics.bags.reader import read_recording, set_backs
from tudor_dynamics.bags.writer import encode
from tudor_dynamics.errors import TudorWarning
from tudor_dynamics.identification.doctor.examine import examine

NS = 1_000_000_000


def test_a_clock_set_back_is_found_and_splits_the_record(tmp_path: Path) -> None:
    """What comes before and after was not joined, and is not filtered as if it was."""
    stamp = times(1200)
    late = np.where(np.arange(1200) >= 600, stamp - NS, stamp)
    q, dq = motion(stamp)
    (newest, size, lost), = set_backs(late)
    assert (newest, lost) == (stamp[599], 99)
    assert size == pytest.approx(NS, rel=1e-3)
    assert set_backs(stamp) == []
    write_raw(tmp_path / 'bag', stamp, encode(joint_states(
        late, position=q, velocity=dq, effort=5.0 * q)).data)
    with pytest.warns(TudorWarning, match='backward'):
        found = read_recording(tmp_path / 'bag', plain_arm())
    assert found.segments == (slice(0, 600), slice(600, 1100))
    (item,) = found.oddities.set_backs
    assert item.time == pytest.approx(5.99)
    assert item.seconds == pytest.approx(1.0, rel=1e-3)


def test_overtaken_messages_are_no_clock_that_was_set_back() -> None:
    """One or two late messages are left out as before."""
    stamp = times(100).copy()
    stamp[[40, 41]] = stamp[[41, 40]]
    assert set_backs(stamp) == []


def test_velocities_of_zeros_are_not_used(tmp_path: Path) -> None:
    """They are told of by name, and the doctor says it."""
    path = make_bag(tmp_path / 'bag', joint_states(velocity=np.zeros((300, 2))))
    with pytest.warns(TudorWarning, match='always zero'):
        found = read_recording(path, plain_arm())
    assert found.dq is None
    assert found.oddities.zero_velocities == JOINTS
    assert 'velocity_zeros' in {item.kind for item in examine(plain_arm(), found).findings}


def test_other_joints_and_how_far_they_move(tmp_path: Path) -> None:
    """Names in the joint states that the description does not ask for."""
    stamp = times()
    q, _ = motion(stamp)
    path = make_bag(tmp_path / 'bag', joint_states(
        stamp, names=(*JOINTS, 'wrist'), position=np.column_stack([q, q[:, 0]]),
        velocity=None, effort=np.column_stack([q, q[:, 0]])))
    found = read_recording(path, plain_arm())
    assert found.oddities.others == {'wrist': pytest.approx(2.0, rel=0.02)}
