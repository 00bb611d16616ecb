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

"""Efforts and strains on several topics give the numbers of a single one."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
import pytest
from ros_world import feed, Hand, joint_message, JOINTS, series, values_of, World
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.bags.writer import recording_series, write_bag
from tudor_dynamics.cli.main import main
from tudor_dynamics.models.bundle import load_bundle
from tudor_dynamics.nodes.arm_simulator import ArmSimulatorNode
from tudor_dynamics.nodes.collision_detector import CollisionDetectorNode
from tudor_dynamics.nodes.dynamics_predictor import DynamicsPredictorNode
from tudor_dynamics.nodes.joint_state_filter import JointStateFilterNode
from tudor_dynamics.nodes.monitor import MonitorNode
from tudor_dynamics.online.black_box import messages_of, replayed
from tudor_dynamics.online.monitor import Monitor, MonitorSettings
import yaml

TOPICS = ('joint_states', 'motor_currents', 'elbow_current', 'link_strains', 'link3_strains')
SAMPLES = 150


@pytest.fixture(scope='module')
def several(root: Path, tmp_path_factory: pytest.TempPathFactory, recording) -> Path:
    """Folder with bags, arm and model of the arm whose elbow has topics of its own."""
    out = tmp_path_factory.mktemp('several')
    content = yaml.safe_load((root / 'config/two_blade_arm.yaml').read_text())
    content['joints'][2]['effort']['topic'] = 'elbow_current'
    content['gauges'][1]['topic'] = 'link3_strains'
    (out / 'arm.yaml').write_text(yaml.safe_dump(content))
    arm = load_arm(out / 'arm.yaml')
    write_bag(out / 'bag', recording_series(recording, arm))
    assert main(['fit', str(out / 'bag'), '--arm', str(out / 'arm.yaml'), '--models',
                 'analytical', '--out', str(out / 'model'), '--exit-zero']) == 0
    assert main(['evaluate', '--model', str(out / 'model'), str(out / 'bag'), '--causal', '--rate',
                 'full', '--save', str(out / 'r.npz'), '--json']) == 0
    return out


def split(recording, offset: int = 0):
    """Give a change of messages that lays them out on several topics."""
    def change(k: int, messages: dict) -> None:
        stamp = int(recording.stamp[k])
        current, strain = recording.effort[k], recording.strain[k]
        messages['motor_currents'] = joint_message(stamp, ['joint2'], effort=current[:1])
        messages['elbow_current'] = joint_message(stamp + offset, ['joint3'], effort=current[1:])
        messages['link_strains'] = joint_message(stamp, ['link2_hub'], position=strain[:1])
        messages['link3_strains'] = joint_message(
            stamp + offset, ['link3_hub'], position=strain[1:])
    return change


@pytest.mark.parametrize('chain', ['monitor', 'separate'])
def test_same_numbers(chain: str, world: World, several: Path, recording) -> None:
    """Residuals of every sample, equal to those of ``tudor evaluate`` to 1e-9."""
    model = str(several / 'model')
    how = {'model': model, 'methods': ['strain', 'effort'], 'timeout': 5.0}
    if chain == 'monitor':
        first, each = world.add(MonitorNode, **how), len(TOPICS)
    else:
        first, each = world.add(JointStateFilterNode, model=model), 1
        world.add(DynamicsPredictorNode, model=model)
        world.add(CollisionDetectorNode, **how)
    for topic in ('strain_residuals', 'effort_residuals'):
        world.listen(topic)
    world.meet(*TOPICS)
    feed(world, recording, lambda: first.meter.count // each, last=SAMPLES, batch=2,
         change=split(recording))
    assert world.spin(lambda: all(len(world.heard[f'{output}_residuals']) >= SAMPLES - 50
                                  for output in ('strain', 'effort')))
    with np.load(several / 'r.npz') as saved:
        for output, field in (('strain', 'position'), ('effort', 'effort')):
            stamp, values = series(world.heard[f'{output}_residuals'], field)
            count = SAMPLES - 50
            assert stamp.tolist() == saved[f'{output}_analytical_stamp'][:count].tolist()
            wanted = saved[f'{output}_analytical_residual'][:count]
            assert np.abs(values - wanted).max() < 1e-9


def test_a_silent_topic_names_its_own_channels(several: Path) -> None:
    """Of those on other topics it is said that they are read, and that no ratio comes."""
    bundle = load_bundle(several / 'model')
    monitor = Monitor(bundle, MonitorSettings(methods=('strain', 'effort')))
    messages = messages_of(open_bag(several / 'bag'), bundle.arm)[:5 * 600]
    watch = monitor.watch
    assert set(watch.sensors(1.0).values()) == {'silent'}
    judged = set(bundle.facts.get('thresholds', {}))
    for topic, dead in (('', []), ('link3_strains', ['link3_hub'])):
        begin = watch.stamp
        for _ in replayed([item for item in messages if item.topic != topic and (
                begin == 0 or item.stamp > begin)][:5 * 300], bundle.arm, monitor):
            pass
        assert watch.stamp > begin + 2.5e9
        assert watch.sensors(1.0) == {
            name: 'silent' if name in dead else 'ok'
            for name in ('link2_hub', 'link3_hub', 'joint2', 'joint3')}
        assert {key.split()[2]: value for key, value in watch.figures(1.0).items()
                if key.startswith('state: strain')} == {
            name: 'silent' if name in dead else 'ok' if 'strain' in judged and not dead else
            'not judged' for name in ('link2_hub', 'link3_hub')}


def test_a_topic_of_both_outputs_counts_once(
    world: World, root: Path, recording, tmp_path: Path,
) -> None:
    """Efforts and strains in one message, in a bag and over topics."""
    content = yaml.safe_load((root / 'config/two_blade_arm.yaml').read_text())
    for joint in content['joints'][1:]:
        joint['effort']['topic'] = 'sensors'
    for gauge in content['gauges']:
        gauge['topic'] = 'sensors'
    (tmp_path / 'arm.yaml').write_text(yaml.safe_dump(content))
    arm = load_arm(tmp_path / 'arm.yaml')
    write_bag(tmp_path / 'bag', recording_series(recording, arm))
    assert main(['fit', str(tmp_path / 'bag'), '--arm', str(tmp_path / 'arm.yaml'), '--models',
                 'analytical', '--out', str(tmp_path / 'model'), '--exit-zero']) == 0
    model = str(tmp_path / 'model')
    first = world.add(JointStateFilterNode, model=model)
    world.add(DynamicsPredictorNode, model=model)
    node = world.add(CollisionDetectorNode, model=model, methods=['strain', 'effort'],
                     timeout=5.0)
    for topic in ('strain_residuals', 'effort_residuals'):
        world.listen(topic)
    world.meet('joint_states', 'sensors')

    def change(k: int, messages: dict) -> None:
        stamp, gap = int(recording.stamp[k]), [float('nan')] * 2
        del messages['motor_currents'], messages['link_strains']
        messages['sensors'] = joint_message(
            stamp, ['joint2', 'joint3', 'link2_hub', 'link3_hub'],
            effort=[*recording.effort[k], *gap], position=[*gap, *recording.strain[k]])
    feed(world, recording, lambda: first.meter.count, last=SAMPLES, batch=2, change=change)
    assert world.spin(lambda: all(len(world.heard[f'{output}_residuals']) >= SAMPLES - 50
                                  for output in ('strain', 'effort')))
    assert node.meter.count == SAMPLES


def test_a_silent_topic_is_named(world: World, several: Path, recording) -> None:
    """Without the second topic there is no residual, and the diagnosis says which is missing."""
    hand = Hand()
    node = world.add(partial(MonitorNode, steady=hand), model=str(several / 'model'),
                     methods=['strain'], timeout=60.0)
    world.meet('joint_states', 'link_strains', 'link3_strains')
    layout = split(recording)

    def change(k: int, messages: dict) -> None:
        hand.now += recording.dt
        layout(k, messages)
        for topic in ('link3_strains', 'motor_currents', 'elbow_current'):
            del messages[topic]
    feed(world, recording, lambda: node.meter.count // 2, last=120, change=change)
    status = world.status('monitor')
    assert status.level == DiagnosticStatus.ERROR
    assert 'no message came on link3_strains' in status.message
    assert node.watch.level == 0


def test_the_simulator_lays_them_out(world: World, root: Path, tmp_path: Path) -> None:
    """Each topic carries its own joints and gauges; what comes with positions is one message."""
    content = yaml.safe_load((root / 'config/tudor.yaml').read_text())
    content['kinematics']['urdf'] = str(root / 'config/tudor.urdf')
    content['joints'][2]['effort'] = {'topic': 'joint_states', 'unit': 'A'}
    for gauge, topic in zip(content['gauges'], ('a', 'b', 'joint_states', 'b'), strict=True):
        gauge['topic'] = topic
    path = tmp_path / 'arm.yaml'
    path.write_text(yaml.safe_dump(content))
    for topic in ('joint_states', 'motor_currents', 'a', 'b'):
        world.listen(topic)
    node = world.add(ArmSimulatorNode, arm=str(path), rate=100.0)
    assert not node.fault
    topics = ('joint_states', 'a', 'b', 'motor_currents')
    assert world.spin(lambda: all(world.heard[topic] for topic in topics))
    names = {topic: list(world.heard[topic][-1].name) for topic in world.heard
             if topic != '/diagnostics'}
    assert names == {'joint_states': ['joint1', *JOINTS, 'link2_mid'],
                     'motor_currents': ['joint2'], 'a': ['link2_hub'],
                     'b': ['link3_hub', 'link3_mid']}
    own = world.heard['joint_states'][-1]
    assert np.isnan(own.effort).tolist() == [True, True, False, True]
    assert np.isnan(own.velocity).tolist() == [False, False, False, True]
    assert 'gave up real time' in values_of(world.status('arm_simulator'))
