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

"""Recordings: topics, truth about pushes, seeds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_typestore, Stores

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.limits import hard_limits
from tudor_dynamics.bags.reader import read_wrenches
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.mechanics.campaign import (
    random_pushes, record_stimulus, stimulus_motion, stimulus_seeds,
    StimulusSpec)
from tudor_dynamics.mechanics.closed_loop import ClosedLoop, steps_per_message
from tudor_dynamics.mechanics.hardware import with_payload
from tudor_dynamics.mechanics.mechanism import build_mechanism


def spec(**changes: object) -> StimulusSpec:
    """Give a short stimulus."""
    values = {'payload': 0.2, 'seconds': 9.0, 'rate': 100.0, 'damping': 1.0,
              'motion_seed': 1, 'noise_seed': 2, 'push_seed': 3,
              'pushes': 2, **changes}
    return StimulusSpec(**values)  # type: ignore[arg-type]


def test_bag_of_a_stimulus(root: Path, tmp_path: Path) -> None:
    """All topics at 100 Hz, pushes as their truth in the frame of their link."""
    arm = load_arm(root / 'config' / 'tudor.yaml')
    seen: list[int] = []
    result = record_stimulus(arm, spec(), tmp_path / 'bag', seen.append)
    assert sum(seen) == 18000
    assert result.samples == 900 and len(result.pushes) == 2
    found: dict[str, list] = {}
    with AnyReader([tmp_path / 'bag'],
                   default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, _, raw in reader.messages():
            found.setdefault(connection.topic, []).append(
                reader.deserialize(raw, connection.msgtype))
    assert {topic: len(messages) for topic, messages in found.items()} == dict.fromkeys(
        ('/joint_states', '/motor_currents', '/link_strains', '/joint_reference',
         '/applied_wrench'), 900)
    assert found['/joint_states'][0].name == ['joint2', 'joint3']
    assert found['/link_strains'][0].name[0] == 'link2_hub'
    times = np.array([m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec
                      for m in found['/applied_wrench']]) - 1.0
    np.testing.assert_allclose(times, np.arange(900) * 0.01, atol=1e-9)
    wrenches = found['/applied_wrench']
    force = np.array([[m.wrench.force.x, m.wrench.force.y, m.wrench.force.z] for m in wrenches])
    frames = np.array([m.header.frame_id for m in wrenches])
    read = read_wrenches(open_bag(tmp_path / 'bag'))
    assert read is not None and list(read.frame) == frames.tolist()
    np.testing.assert_array_equal(read.values['force'], force)
    acting = np.linalg.norm(force, axis=1) > 0.0
    assert set(frames[~acting]) == {'base'}
    for push in result.pushes:
        during = (times > push.time + 0.06) & (times < push.time + push.duration - 0.06)
        assert set(frames[during]) == {push.joint.replace('joint', 'link')}
        np.testing.assert_allclose(np.linalg.norm(force[during], axis=1),
                                   np.linalg.norm(push.force), rtol=1e-9)
        row = int(np.flatnonzero(during)[0])
        torque = wrenches[row].wrench.torque
        lever = np.cross([push.distance, 0.0, 0.0], force[row])
        np.testing.assert_allclose([torque.x, torque.y, torque.z], lever, atol=1e-9)


def test_same_seed_same_bytes(root: Path, tmp_path: Path) -> None:
    """Two recordings of one stimulus are equal byte by byte; another noise is not."""
    arm = load_arm(root / 'config' / 'tudor.yaml')
    for name, seed in (('a/bag', 2), ('b/bag', 2), ('c/bag', 5)):
        record_stimulus(arm, spec(noise_seed=seed), tmp_path / name)
    one, two, other = ((tmp_path / name / 'bag' / 'bag.mcap').read_bytes() for name in 'abc')
    assert one == two
    assert one != other


def test_pushes_fit_in(root: Path) -> None:
    """Pushes follow each other without overlap, on any link, and no more than fit are taken."""
    arm = load_arm(root / 'config' / 'tudor.yaml')
    mechanism = build_mechanism(arm)
    pushes = random_pushes(arm, mechanism, 20, 80.0, 1)
    ends = [push.time + push.duration for push in pushes]
    assert all(end < push.time for end, push in zip(ends, pushes[1:], strict=False))
    assert pushes[0].time >= 3.0 and ends[-1] <= 80.0
    assert {push.joint for push in pushes} == {'joint2', 'joint3'}
    # Across the joints' axis, which is y: no force out of the plane of motion.
    assert all(abs(push.force[1]) < 1e-9 for push in pushes)
    with pytest.raises(SimulationError, match='do not fit'):
        random_pushes(arm, mechanism, 50, 80.0, 1)


def test_seeds_and_rates() -> None:
    """Stimuli of a campaign differ in all seeds; rates divide that of the loop."""
    seeds = {value for k in range(20) for value in stimulus_seeds(0, k)}
    assert len(seeds) == 60
    assert steps_per_message(5e-4, 100.0) == 20
    for rate in (0.0, 300.0, 4000.0, -1.0):
        with pytest.raises(SimulationError, match='divided by a whole number'):
            steps_per_message(5e-4, rate)


@pytest.mark.parametrize('payload', [0.0, 0.4])
def test_recorded_motion_stays_within_the_limits(root: Path, payload: float) -> None:
    """Positions and speeds at every step; bench/recorded_limits.py has 20 seeds."""
    arm = load_arm(root / 'config' / 'tudor.yaml')
    limits = hard_limits(arm)
    loop = ClosedLoop(with_payload(arm, payload), seed=1)
    reference = stimulus_motion(arm, 25.0, stimulus_seeds(4, 0)[0], loop.dt)
    loop.reset(reference.q[0])
    seen = loop.run(reference.q, reference.dq)
    assert np.ptp(seen.q, axis=0).min() > np.radians(60.0)
    assert (seen.q >= limits.lower).all() and (seen.q <= limits.upper).all()
    assert (np.abs(seen.dq) <= limits.velocity).all()
