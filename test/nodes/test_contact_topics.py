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

"""Contacts over real topics: wrench, point and diagnosis as offline, and free again after one."""

from __future__ import annotations

from pathlib import Path

from geometry_msgs.msg import PointStamped, WrenchStamped
import numpy as np
import pytest
from ros_world import feed, values_of, World
from sample_arms import recording_of

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.mechanics.closed_loop import ClosedLoop
from tudor_dynamics.mechanics.hardware import Push
from tudor_dynamics.models.bundle import load_bundle, ModelBundle, save_bundle
from tudor_dynamics.models.elastic.model import ElasticModel
from tudor_dynamics.nodes.common.messages import nanoseconds
from tudor_dynamics.nodes.monitor import MonitorNode
from tudor_dynamics.online.contact import ContactEstimate
from tudor_dynamics.online.monitor import Monitor, MonitorSettings
from tudor_dynamics.typing import FloatArray
from visualization_msgs.msg import Marker

POSE = np.array([0.7, -0.5])
RATE = 100.0
EXACT = 1e-9
FIRST, SECOND = (2.0, 0.8), (4.4, 0.8)
"""Begin and length of the two pushes [s]."""


@pytest.fixture(scope='module')
def elastic(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Store an elastic model with the values of the description."""
    arm = load_arm(Path(__file__).parents[2] / 'config' / 'tudor.yaml')
    model = ElasticModel(arm, 'strain')
    model.coefficients_ = tuple(np.array([121.4, 0.0]) for _ in arm.gauges)
    model.standard_errors_ = tuple(np.zeros(2) for _ in arm.gauges)
    model.noise_ = np.full(len(arm.gauges), 3.0)
    spec = arm.spec.preprocessing.model_copy(update={'filter': 'causal', 'rate': None})
    path = tmp_path_factory.mktemp('contact') / 'model'
    save_bundle(ModelBundle(arm, spec, {'strain': {'elastic': model}}, {}), path)
    return path


@pytest.fixture(scope='module')
def pushed(elastic: Path) -> Recording:
    """Record an undamped arm that is pushed on its outer link, let go, and on its inner one."""
    loop = ClosedLoop(load_bundle(elastic).arm, damping=0.0, seed=4)
    loop.reset(POSE)
    loop.set_pushes([
        Push(*begin, joint, place, (-size * np.sin(angle), 0.0, size * np.cos(angle)))
        for begin, joint, place, size, angle in (
            (FIRST, 'joint3', 0.33, 5.0, POSE.sum()), (SECOND, 'joint2', 0.30, -7.0, POSE[0]))])
    steps = round(5.4 / loop.dt)
    seen = loop.run(np.tile(POSE, (steps, 1)), np.zeros((steps, 2)), every=20)
    return recording_of(seen.q, RATE, strain=seen.strain)


def offline(path: Path, recording: Recording) -> list[ContactEstimate]:
    """Give what the same recording comes to without ROS."""
    monitor, found = Monitor(load_bundle(path), MonitorSettings(
        kind='elastic', methods=('strain',), contact=True)), []
    assert recording.strain is not None
    for k, stamp in enumerate(recording.stamp.tolist()):
        found += monitor.add_joints(stamp, recording.q[k]).contacts
        found += monitor.add_measured('strain', stamp, recording.strain[k]).contacts
    return found


def vector(message: object) -> FloatArray:
    """Give the components of a vector or point."""
    return np.array([getattr(message, axis) for axis in 'xyz'])


def test_wrench_point_and_diagnosis(world: World, elastic: Path, pushed: Recording) -> None:
    """As offline to 1e-9; nothing after a push, and the next one is told again."""
    node = world.add(MonitorNode, model=str(elastic), kind='elastic', methods=['strain'],
                     estimate_contact=True)
    wrenches = world.listen('contact_wrench', WrenchStamped)
    points = world.listen('contact_point', PointStamped)
    markers = world.listen('contact_marker', Marker)
    world.meet('joint_states', 'link_strains')
    gauges = list(load_bundle(elastic).arm.gauge_names)
    first = node.meter.count

    def through() -> int:
        return (node.meter.count - first) // 2

    def say(until: float, begun: int, wanted: str) -> dict[str, str]:
        end = round(until * RATE)
        feed(world, pushed, lambda: through() - begun, first=begun, last=end, gauges=gauges)
        assert world.spin(lambda: through() >= end)
        return values_of(world.status('monitor', lambda item: wanted in values_of(item)))

    during = say(FIRST[0] + 0.7, 0, 'contact link')
    assert during['contact link'] == 'link3' and during['contact'] == 'by strain, now'
    assert float(during['contact force [N]']) > 3.0
    assert abs(float(during['contact place [m]']) - 0.33) < 0.03
    assert 0.0 < float(during['contact force deviation [N]']) < 3.0
    behind = say(SECOND[0] - 0.1, round((FIRST[0] + 0.7) * RATE), 'last contact')
    assert 0.0 < float(during['contact place deviation [m]']) < 0.06
    assert behind['contact'] == 'by strain' and 'contact link' not in behind
    assert 'N) on link3' in behind['last contact']
    again = say(SECOND[0] + 0.7, round((SECOND[0] - 0.1) * RATE), 'contact link')
    assert again['contact link'] == 'link2'

    expected = offline(elastic, pushed)[:len(wrenches)]
    assert len(wrenches) > 480
    for message, item in zip(wrenches, expected, strict=True):
        assert nanoseconds(message.header.stamp) == item.stamp
        assert message.header.frame_id == item.link
        felt = float(item.felt)
        assert np.abs(vector(message.wrench.force) - felt * item.force).max() < EXACT
        assert np.abs(vector(message.wrench.torque) - felt * item.torque).max() < EXACT
    across = [item.force[2] for item in expected if item.felt and FIRST[0] + 0.3 < (
        item.stamp - expected[0].stamp) * 1e-9 < FIRST[0] + 0.7]
    assert abs(np.median(across) - 5.0) < 0.5
    located = [item for item in expected if np.isfinite(item.place)]
    assert len(points) == len(located) > 50
    for message, item in zip(points, located, strict=True):
        assert nanoseconds(message.header.stamp) == item.stamp
        assert message.header.frame_id == item.link
        assert np.abs(vector(message.point) - item.point).max() < EXACT
    shown = [message for message in markers if message.action == Marker.ADD]
    felt = [item for item in located if item.felt]
    assert len(shown) == len(felt) > 50 and len(markers) > len(shown)
    for message, item in zip(shown, felt, strict=True):
        tail, head = (vector(point) for point in message.points)
        assert message.header.frame_id == item.link
        assert np.abs(head - item.point).max() < EXACT
        assert np.abs(head - tail - 0.01 * item.force).max() < EXACT
