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

"""Whatever comes in, the nodes go on, and one diagnosis names the cause."""

from __future__ import annotations

from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
import pytest
from ros_world import feed, GAUGES, joint_message, JOINTS, series, values_of, World
from std_msgs.msg import Bool, Header
from std_srvs.srv import Trigger
from tudor_dynamics.cli.main import main
from tudor_dynamics.nodes.common.base import latched
from tudor_dynamics.nodes.joint_state_filter import JointStateFilterNode
from tudor_dynamics.nodes.monitor import MonitorNode

SENSORS = ('joint_states', 'motor_currents', 'link_strains')


def start(world: World, model: Path, **more: object) -> MonitorNode:
    """Start a monitor, and hear its residuals."""
    node = world.add(MonitorNode, model=str(model), methods=['strain'], timeout=60.0, **more)
    world.listen('strain_residuals')
    world.listen('collision_event', Header)
    world.listen('collision', Bool, latched())
    world.meet('joint_states', 'link_strains')
    return node


def counter(node: MonitorNode, messages: int = 2):
    """Give a count of samples that a monitor has taken."""
    before = node.meter.count
    return lambda: (node.meter.count - before) // messages


def test_order_and_names(world: World, model: Path, recording) -> None:
    """Joints in another order and foreign ones change nothing; a missing one is counted."""
    plain = World()  # ends before the other begins: both would hear the same sensors
    try:
        other = start(plain, model)
        feed(plain, recording, counter(other), last=120)
        assert plain.wait('strain_residuals', 70) == 70
        _, wanted = series(plain.heard['strain_residuals'], 'position')
    finally:
        plain.close()
    node = start(world, model)

    def shuffle(k: int, messages: dict) -> None:
        q = recording.q[k]
        messages['joint_states'] = joint_message(
            int(recording.stamp[k]), ['gripper', 'joint3', 'joint1', 'joint2'],
            position=np.array([7.0, q[1], 0.0, q[0]]))
        if k % 10 == 9:
            world.output('joint_states').publish(joint_message(
                int(recording.stamp[k]), ['joint3'], position=q[:1]))
    feed(world, recording, counter(node), last=120, change=shuffle)
    assert world.wait('strain_residuals', 70) == 70
    _, values = series(world.heard['strain_residuals'], 'position')
    assert np.array_equal(values, wanted)
    assert int(values_of(world.status('monitor'))['dropped: unknown_names']) == 12


def test_a_gripper_on_the_same_topic(world: World, model: Path, recording) -> None:
    """Its messages change nothing, and are no fault."""
    node = start(world, model)

    def with_gripper(k: int, messages: dict) -> None:
        world.output('joint_states').publish(joint_message(
            int(recording.stamp[k]), ['left_finger', 'right_finger'], position=[0.01, 0.01]))
    feed(world, recording, counter(node), last=120, change=with_gripper)
    assert world.wait('strain_residuals', 70) == 70
    status = world.status('monitor')
    assert int(values_of(status)['dropped: other_names']) == 120
    assert 'names' not in status.message


def test_a_parameter_that_no_node_has(world: World, model: Path, recording) -> None:
    """A typo is named, with what was meant; what a file holds for other nodes is not."""
    node = start(world, model, fasle_alarms_per_hour=2.0, damping=0.5)
    status = world.status('monitor', lambda status: status.level == DiagnosticStatus.STALE and (
        '(1 more problem in the values on /diagnostics)' in status.message))
    assert values_of(status)['problem 2'].startswith('the unknown parameter fasle_alarms_per_hour')
    assert 'fasle' not in status.message
    feed(world, recording, counter(node), last=60)
    world.status('monitor', lambda status: status.message == (
        'the unknown parameter fasle_alarms_per_hour is ignored '
        '(did you mean false_alarms_per_hour?)'))


@pytest.mark.parametrize(('name', 'spoil', 'cause'), [
    ('NaN', lambda m: m.position.__setitem__(0, float('nan')), 'not_finite'),
    ('short', lambda m: m.position.pop(), 'short_array'),
    ('again', lambda m: None, 'duplicate_stamp')])
def test_bad_messages_are_counted(
    name: str, spoil, cause: str, world: World, model: Path, recording,
) -> None:
    """A bad message leaves no trace but a count."""
    node = start(world, model)

    def disturb(k: int, messages: dict) -> None:
        if k in (60, 80, 100):
            good = messages['joint_states']
            world.output('joint_states').publish(good)
            bad = joint_message(int(recording.stamp[k]), JOINTS, position=recording.q[k])
            spoil(bad)
            world.output('joint_states').publish(bad)
            del messages['joint_states']
    feed(world, recording, counter(node), last=120, change=disturb)
    assert world.wait('strain_residuals', 70) == 70
    assert values_of(world.status('monitor'))[f'dropped: {cause}'] == '3'


def test_lost_and_late_messages(world: World, model: Path, recording) -> None:
    """30 % lost at random, and the clock set back: residuals go on, finite, nothing crashes."""
    node = start(world, model)
    lost = np.random.default_rng(3).random(400) < 0.3

    def lose(k: int, messages: dict) -> None:
        if lost[k]:
            messages.clear()
    came = counter(node)

    def through() -> int:  # what was lost does not come
        done = came()
        return 400 if done >= 400 - lost.sum() else int(np.flatnonzero(~lost)[done])
    feed(world, recording, through, last=400, change=lose, batch=8)
    assert world.spin(lambda: len(world.heard['strain_residuals']) > 150)
    world.rest(0.1)
    stamps, values = series(world.heard['strain_residuals'], 'position')
    assert np.isfinite(values).all()
    assert (np.diff(stamps) > 0).all()
    before = len(values)
    feed(world, recording, counter(node), last=120)
    assert world.spin(lambda: len(world.heard['strain_residuals']) > before + 30)
    assert int(values_of(world.status('monitor'))['dropped: clock_set_back']) >= 1
    assert node.meter.count > 300


@pytest.mark.parametrize('rate', [10.0, 2000.0])
def test_other_rates(rate: float, world: World, model: Path, recording) -> None:
    """Input at 10 Hz and at 2 kHz by its stamps: residuals for all that is settled."""
    node = start(world, model)
    count = 60 if rate < 100 else 1500
    t = np.arange(count) / rate
    t0 = int(recording.stamp[0])

    def resample(k: int, messages: dict) -> None:
        s, source = t0 + round(t[k] * 1e9), (recording.stamp - recording.stamp[0]) * 1e-9
        q = np.array([np.interp(t[k], source, x) for x in recording.q.T])
        e = np.array([np.interp(t[k], source, x) for x in recording.strain.T])
        messages.clear()
        messages['joint_states'] = joint_message(s, JOINTS, position=q)
        messages['link_strains'] = joint_message(s, GAUGES, position=e)
    feed(world, recording, counter(node), last=count, change=resample)
    settled = count - round(0.5 * rate)
    assert world.wait('strain_residuals', settled) == settled
    _, values = series(world.heard['strain_residuals'], 'position')
    assert np.isfinite(values).all()


def test_dead_gauge_is_named(world: World, model: Path, recording) -> None:
    """A gauge that keeps its value while the arm moves is an ERROR with its name."""
    node = start(world, model, stuck_time=0.5)
    kept = float(recording.strain[200][1])

    def kill(k: int, messages: dict) -> None:
        if k > 200:
            messages['link_strains'].position[1] = kept
    feed(world, recording, counter(node), last=500, change=kill)
    status = world.status('monitor')
    assert status.level == DiagnosticStatus.ERROR
    assert 'link3_hub' in status.message and 'link2_hub' not in status.message


def test_jump_of_a_gauge_is_an_event_with_its_residuals(
    world: World, model: Path, recording,
) -> None:
    """A sudden load: latched state, event with onset and link, diagnosis with the residuals."""
    if not start(world, model).watch.stages:
        pytest.skip('the sample bags are too short for thresholds')
    node = world.nodes[0]
    node.set_parameters([])

    def push(k: int, messages: dict) -> None:
        if k >= 300:
            messages['link_strains'].position[0] += 400.0
            messages['link_strains'].position[1] += 300.0
    feed(world, recording, counter(node), last=340, change=push)
    assert world.spin(lambda: bool(world.heard['collision_event']))
    event = world.heard['collision_event'][0]
    onset = event.stamp.sec * 10**9 + event.stamp.nanosec
    assert onset == int(recording.stamp[300]) and event.frame_id == 'link3'
    assert [m.data for m in world.heard['collision']][-1] is True
    told: list = []

    def heard() -> bool:
        told[:] = [s for a in world.heard['/diagnostics'] for s in a.status
                   if s.name == 'monitor: collision']
        return bool(told)
    assert world.spin(heard) and 'link3' in told[0].message
    assert float(values_of(told[0])['residual link3_hub']) > 100.0
    before = len(world.heard['collision'])
    late = world.listen('collision', Bool, latched())
    assert world.spin(lambda: len(late) > before) and late[-1].data is True


def test_model_of_another_arm_and_reload(
    world: World, model: Path, root: Path, recording, tmp_path: Path,
) -> None:
    """Reload leaves no gap; a model of another arm is refused, named, and output goes on."""
    link = tmp_path / 'current'
    link.symlink_to(model)
    node = start(world, link)

    def reload() -> None:
        assert world.call(Trigger, 'monitor/reload').success
    count = counter(node)
    feed(world, recording, count, last=100)
    before = node.monitor
    reload()
    feed(world, recording, count_from(node, 0), first=100, last=140)
    assert world.spin(lambda: node.monitor is not before)
    feed(world, recording, count_from(node, 0), first=140, last=240)
    world.wait('strain_residuals', 190)
    stamps, _ = series(world.heard['strain_residuals'], 'position')
    assert stamps.tolist() == recording.stamp[50:240].tolist()
    other = tmp_path / 'other.yaml'
    other.write_text((root / 'config/two_blade_arm.yaml').read_text().replace(
        'name: two_blade_arm', 'name: another_arm'))
    assert main(['fit', str(root / 'bags/two_blade_train_1'), '--models', 'analytical', '--arm',
                 str(other), '--out', str(tmp_path / 'm'), '--exit-zero']) == 0
    link.unlink()
    link.symlink_to(tmp_path / 'm')
    now = node.monitor
    reload()
    assert world.spin(lambda: node._loader is None)
    feed(world, recording, count_from(node, 0), first=240, last=300)
    status = world.status('monitor')
    assert node.monitor is now and 'another_arm' in status.message
    assert status.level == DiagnosticStatus.ERROR
    assert world.wait('strain_residuals', 250) == 250


def count_from(node: MonitorNode, samples: int):
    """Count samples from now on."""
    before = node.meter.count
    return lambda: (node.meter.count - before) // 2 + samples


def test_without_model(world: World) -> None:
    """No model: the node stays and says what to do."""
    world.add(MonitorNode)
    status = world.status('monitor')
    assert status.level == DiagnosticStatus.ERROR
    assert "the parameter 'model' is empty" in status.message


def test_restart_is_a_gap_for_others(world: World, model: Path, recording) -> None:
    """A filter that is killed and restarted: the predictor goes on after the settling."""
    from tudor_dynamics.nodes.dynamics_predictor import DynamicsPredictorNode
    first = world.add(JointStateFilterNode, model=str(model))
    world.add(DynamicsPredictorNode, model=str(model), timeout=60.0)
    heard = world.listen('predicted_strains')
    world.meet('joint_states')
    feed(world, recording, lambda: first.meter.count, last=100)
    assert world.wait('predicted_strains', 50) == 50
    world.end(first)
    again = world.add(JointStateFilterNode, model=str(model))
    world.meet('joint_states')
    feed(world, recording, lambda: again.meter.count, first=150, last=250)
    world.wait('predicted_strains', 100)
    stamps, _ = series(heard, 'position')
    assert stamps.tolist() == [*recording.stamp[50:100], *recording.stamp[200:250]]
