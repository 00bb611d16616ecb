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

"""Faulty input of the separate nodes, of the reference and of the simulator."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
import numpy as np
import pytest
from ros_world import feed, joint_message, JOINTS, series, values_of, World
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from tudor_dynamics.nodes.arm_simulator import ArmSimulatorNode
from tudor_dynamics.nodes.collision_detector import CollisionDetectorNode
from tudor_dynamics.nodes.common.messages import floats, nanoseconds
from tudor_dynamics.nodes.dynamics_predictor import DynamicsPredictorNode
from tudor_dynamics.nodes.joint_state_filter import JointStateFilterNode
from tudor_dynamics.nodes.monitor import MonitorNode
from tudor_dynamics.nodes.reference_generator import ReferenceGeneratorNode

OTHER = 'name no joint or gauge of the model'


def chain(world: World, model: Path) -> JointStateFilterNode:
    """Start filter, predictor and detector, and hear the residuals."""
    first = world.add(JointStateFilterNode, model=str(model), timeout=60.0)
    world.add(DynamicsPredictorNode, model=str(model), timeout=60.0)
    world.add(CollisionDetectorNode, model=str(model), timeout=60.0)
    world.listen('strain_residuals')
    world.meet('joint_states', 'link_strains')
    return first


def test_chain_in_another_order_with_losses(world: World, model: Path, recording) -> None:
    """Other order, 30 % lost, bursts of eight, the clock set back: finite residuals, in order."""
    first = chain(world, model)
    sent = [0]
    lost = np.random.default_rng(4).random(500) < 0.3

    def spoil(k: int, messages: dict[str, Any]) -> None:
        q, strain = recording.q[k], recording.strain[k]
        stamp = int(recording.stamp[k])
        messages.clear()
        if not lost[k]:
            sent[0] += 1
            messages['joint_states'] = joint_message(
                stamp, ['joint3', 'x', 'joint2'], position=[q[1], 0.0, q[0]])
            messages['link_strains'] = joint_message(
                stamp, ['link3_hub', 'link2_hub'], position=strain[::-1])

    def through() -> int:  # what was lost does not come
        return 10**9 if first.meter.count >= sent[0] else 0
    feed(world, recording, through, last=300, batch=8, change=spoil)
    world.wait('strain_residuals', 61)
    stamps, values = series(world.heard['strain_residuals'], 'position')
    assert len(values) > 60 and np.isfinite(values).all() and (np.diff(stamps) > 0).all()
    count = len(values)
    feed(world, recording, through, first=0, last=200, batch=8, change=spoil)
    world.wait('strain_residuals', count + 31)
    stamps, values = series(world.heard['strain_residuals'], 'position')
    assert len(values) > count + 30 and np.isfinite(values).all()
    assert stamps[-1] < stamps[count - 1]
    assert first.filter.drops['clock_set_back'] == 1


@pytest.mark.parametrize('rate', [10.0, 2000.0])
def test_chain_at_other_rates(rate: float, world: World, model: Path, recording) -> None:
    """10 Hz and 2 kHz by the stamps: residuals, all finite."""
    first = chain(world, model)
    count = 40 if rate < 100 else 1300
    begin = int(recording.stamp[0])
    source = (recording.stamp - begin) * 1e-9

    def resample(k: int, messages: dict[str, Any]) -> None:
        stamp = begin + round(k / rate * 1e9)
        messages.clear()
        messages['joint_states'] = joint_message(
            stamp, JOINTS, position=[np.interp(k / rate, source, x) for x in recording.q.T])
        messages['link_strains'] = joint_message(
            stamp, ['link2_hub', 'link3_hub'],
            position=[np.interp(k / rate, source, x) for x in recording.strain.T])
    feed(world, recording, lambda: first.meter.count, last=count, change=resample)
    assert world.spin(lambda: len(world.heard['strain_residuals']) >= count - 0.5 * rate - 2)
    assert np.isfinite(series(world.heard['strain_residuals'], 'position')[1]).all()


@pytest.mark.parametrize('node', [MonitorNode, JointStateFilterNode])
def test_model_of_another_arm(node: Any, world: World, model: Path, recording) -> None:
    """Joints that the model does not know: no output, a warning or an error with the cause."""
    started = world.add(node, model=str(model), timeout=60.0)
    motions = world.listen('joint_motion', JointTrajectory)
    world.meet('joint_states')
    told = told_by(world, started.get_name())
    for k in range(len(recording.stamp)):
        world.output('joint_states').publish(joint_message(
            int(recording.stamp[k]), ['shoulder', 'elbow'], position=recording.q[k]))
        world.rest(0.005)
        if k > 60 and any(OTHER in status.message for status in told()):
            break
    assert not motions
    status = next(status for status in told() if OTHER in status.message)
    assert status.level in (DiagnosticStatus.WARN, DiagnosticStatus.ERROR)
    assert re.search('messages on /?joint_(states|motion) ', status.message)


def told_by(world: World, node: str) -> Callable[[], list[DiagnosticStatus]]:
    """Give all diagnoses of a node that were heard."""
    return lambda: [status for array in world.heard['/diagnostics'] for status in array.status
                    if status.name.startswith(f'{node}: /')]


def test_predictor_and_detector_of_another_arm(world: World, model: Path) -> None:
    """A motion of joints that the model does not know is counted by both, and no output comes."""
    nodes = [world.add(kind, model=str(model), timeout=60.0)
             for kind in (DynamicsPredictorNode, CollisionDetectorNode)]
    heard = world.listen('predicted_strains')
    output = world.output('joint_motion', JointTrajectory)
    world.meet('joint_motion')
    sent = 0

    def send() -> None:
        nonlocal sent
        point = JointTrajectoryPoint(positions=floats(np.zeros(2)), velocities=floats(np.zeros(2)),
                                     accelerations=floats(np.zeros(2)))
        message = JointTrajectory(joint_names=['shoulder', 'elbow'], points=[point])
        message.header.stamp.sec = 1 + sent
        output.publish(message)
        sent += 1
        assert world.spin(lambda: all(
            sum(drops['other_names'] for drops in node.counters()) == sent for node in nodes))

    def found_wrong(node: str) -> bool:
        send()  # what was told before the probe heard is told again
        return any(status.level in (DiagnosticStatus.WARN, DiagnosticStatus.ERROR)
                   for status in told_by(world, node)())
    for _ in range(40):
        send()
    assert not heard
    for node in nodes:
        assert world.spin(lambda: found_wrong(node.get_name()))  # noqa: B023
        assert int(values_of(world.status(node.get_name()))['dropped: other_names']) >= 40


def test_simulator_takes_no_impossible_command(world: World, root: Path) -> None:
    """NaN, too few speeds and an impossible force are counted, and the arm stays where it is."""
    node = world.add(ArmSimulatorNode, arm=str(root / 'config/tudor.yaml'), rate=100.0)
    world.output('velocity_commands', Float64MultiArray)
    world.output('external_wrench', WrenchStamped)
    world.meet('velocity_commands', 'external_wrench')
    wrench = WrenchStamped()
    wrench.wrench.force.x = float('inf')
    for data in ([float('nan'), 0.0], [1.0], [1.0, 1.0, 1.0]):
        world.output('velocity_commands').publish(Float64MultiArray(data=floats(np.array(data))))
        world.output('external_wrench').publish(wrench)
    assert world.spin(lambda: node.drops['impossible_command'] == 3
                      and node.drops['impossible_wrench'] == 3)
    heard = world.listen('joint_states')
    assert world.spin(lambda: len(heard) > 20)
    assert np.ptp([message.position[0] for message in heard]) < 1e-3
    assert not node.fault


def test_simulator_stays_with_the_clock(world: World, root: Path) -> None:
    """A process that was held up for half a second goes on with stamps of now, and tells it."""
    node = world.add(ArmSimulatorNode, arm=str(root / 'config/tudor.yaml'), rate=100.0)
    heard = world.listen('joint_states')
    assert world.spin(lambda: len(heard) > 20)
    with node._lock:
        time.sleep(0.5)
    heard.clear()
    assert world.spin(lambda: len(heard) > 20)

    def behind() -> float:
        now = node.get_clock().now().nanoseconds
        return abs(now - nanoseconds(heard[-1].header.stamp))
    assert world.spin(lambda: behind() < 0.25e9)
    stamps, _ = series(heard, 'position')
    assert (np.diff(stamps) > 0).all()
    assert int(values_of(world.status('arm_simulator'))['gave up real time']) >= 1


def test_reference_refuses_goals(world: World, root: Path) -> None:
    """Goals before the joints are known, of unknown joints, outside, NaN or infinite: counted."""
    node = world.add(ReferenceGeneratorNode, arm=str(root / 'config/tudor.yaml'))
    node.steady = lambda: 0.0
    output = world.output('joint_trajectory', JointTrajectory)
    world.meet('joint_trajectory', 'joint_states')

    def refuse(names: list[str], places: list[float]) -> None:
        before = node.drops['goal_refused']
        output.publish(JointTrajectory(joint_names=names, points=[
            JointTrajectoryPoint(positions=floats(np.array(places)))]))
        assert world.spin(lambda: node.drops['goal_refused'] == before + 1), (names, places)
    refuse(JOINTS, [1.0, 0.0])
    world.output('joint_states').publish(joint_message(10**18, JOINTS, position=[0.8, 0.0]))
    assert world.spin(lambda: node.source.motion is not None)
    refuse(['wrist'], [0.5])
    refuse(JOINTS, [1.0])
    refuse(JOINTS, [9.0, 0.0])
    refuse(JOINTS, [np.inf, 0.0])
    motion = node.source.motion
    assert motion.remaining < 1e-6 and motion.q == pytest.approx([0.8, 0.0])
