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

"""Nodes as a user starts them: parameters, files, remapping, namespaces, signals."""

from __future__ import annotations

from multiprocessing.process import BaseProcess
from pathlib import Path
import signal
import time

from node_processes import finish, fork, launch
from patience import PATIENCE
import pytest
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter
from ros_world import joint_message, JOINTS, node_class, World
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory
from tudor_dynamics.nodes.common.interfaces import NODES
import yaml

QOS = ('qos_overrides.', 'use_sim_time', 'start_type_description_service')


@pytest.mark.parametrize(('executor', 'number'), [
    ('events', signal.SIGINT), ('events', signal.SIGTERM), ('single', signal.SIGTERM)])
def test_filter_process(executor: str, number: int, world: World, root: Path) -> None:
    """Namespace, remapping, parameter file; data flow; exit code 0 on signals."""
    process = launch('joint_state_filter', '-r', '__ns:=/arm', '-r', 'joint_states:=sensed',
                     '--params-file', str(root / 'config/nodes.yaml'), '-p',
                     'velocity_cutoff:=33.0', executor=executor)
    try:
        heard = world.listen('/arm/joint_motion', JointTrajectory)
        world.output('/arm/sensed')
        assert world.spin(lambda: world.output('/arm/sensed').get_subscription_count() > 0)
        for k in range(1000):  # the first may come before the other side hears
            world.output('/arm/sensed').publish(joint_message(
                10**18 + 10_000_000 * k, JOINTS, position=[0.1 * k, 0.0]))
            world.rest(0.01)
            if len(heard) >= 15:
                break
        assert len(heard) >= 15
        values = world.call(GetParameters, '/arm/joint_state_filter/get_parameters',
                            GetParameters.Request(names=['velocity_cutoff', 'gap'])).values
        assert [value.double_value for value in values] == [33.0, 0.0]
    finally:
        finish(process, number)


def test_wrong_parameter_ends_with_code_2() -> None:
    """A value that no node can take is one line and exit code 2."""
    process = launch('dynamics_predictor', '-p', 'kind:=neural')
    out, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 2
    assert 'kind' in out and 'analytical' in out and 'Traceback' not in out


def test_use_sim_time(world: World) -> None:
    """With use_sim_time a node starts and stops as well."""
    process = launch('dynamics_predictor', '-p', 'use_sim_time:=true')
    try:
        assert world.spin(lambda: 'dynamics_predictor' in world.probe.get_node_names())
        time.sleep(0.3)
    finally:
        finish(process, signal.SIGINT)


@pytest.mark.parametrize('name', sorted(NODES))
def test_parameters_are_those_of_table_and_file(name: str, world: World, root: Path) -> None:
    """What a node declares stands in nodes.yaml with the same values, and is described."""
    node = world.add(node_class(name))
    declared = {p: node.get_parameter(p).value for p in
                node.list_parameters([], 10).names if not p.startswith(QOS)}
    content = yaml.safe_load((root / 'config/nodes.yaml').read_text())
    assert declared == content[f'/**/{name}']['ros__parameters']
    for param in NODES[name]:
        descriptor = node.describe_parameter(param.name)
        assert param.text in descriptor.description
        assert descriptor.read_only is not param.dynamic


def test_parameters_over_services(world: World, model: Path) -> None:
    """List, describe, get and set as the ros2 command does; refusals give their reason."""
    node = world.add(node_class('monitor'), model=str(model))

    def call(kind, name, request):
        return world.call(kind, f'monitor/{name}', request)

    names = call(ListParameters, 'list_parameters', ListParameters.Request()).result.names
    assert {param.name for param in NODES['monitor']} <= set(names)
    found = call(DescribeParameters, 'describe_parameters',
                 DescribeParameters.Request(names=['debounce'])).descriptors[0]
    assert '[s]' in found.description and found.floating_point_range[0].to_value == 1.0

    def change(key: str, value: object):
        message = Parameter(key, value=value).to_parameter_msg()
        return call(SetParameters, 'set_parameters',
                    SetParameters.Request(parameters=[message])).results[0]
    assert change('false_alarms_per_hour', 7.0).successful
    assert node.watch.settings is not None
    assert change('debounce', 0.02).successful
    assert node.watch.detector.settings.debounce == 0.02
    assert not change('debounce', 5.0).successful
    assert not change('model', 'other').successful
    refused = change('contact_alarms_per_hour', 0.5)
    assert not refused.successful and 'raise the first parameter or lower' in refused.reason


def test_queues_are_made_deeper(world: World, root: Path, tmp_path: Path) -> None:
    """Standard parameters for quality of service, as docs/reference/nodes.md shows them."""
    shown = (root / 'docs/reference/nodes.md').read_text().split('```yaml\n')[1].split('```')[0]
    assert 'depth: 1000' in shown
    (tmp_path / 'deep.yaml').write_text(shown.replace('/**/monitor:', '/**/joint_state_filter:'))
    process = launch('joint_state_filter', '--params-file', str(tmp_path / 'deep.yaml'))
    try:
        name = 'qos_overrides./joint_states.subscription.depth'

        def depth() -> int:
            answer = world.call(GetParameters, 'joint_state_filter/get_parameters',
                                GetParameters.Request(names=[name]))
            return answer.values[0].integer_value
        assert world.spin(lambda: depth() == 1000)
    finally:
        finish(process, signal.SIGINT)


def test_play_and_record(world: World, root: Path, tmp_path: Path) -> None:
    """A bag that is played and recorded comes out with the same messages, byte for byte."""
    from tudor_dynamics.bags.storage import read_track
    recorder = world.add(node_class('bag_recorder'), bag=str(tmp_path / 'copy'),
                         topics=['joint_states', 'link_strains'])
    player = world.add(node_class('bag_player'), bag=str(root / 'bags/two_blade_test'), rate=2.0,
                       start_offset=20.0, topics=['joint_states', 'link_strains'],
                       wait_for_subscribers=1)
    assert world.spin(lambda: player.finished)
    world.spin(lambda: recorder.meter.count >= player.meter.count)
    world.end(recorder)
    sent = read_track(root / 'bags/two_blade_test', ['joint_states', 'link_strains'])
    got = read_track(tmp_path / 'copy')
    assert got.topics == sent.topics
    for topic in sent.topics:
        wanted = [d for d, t, at in zip(sent.data, sent.topic, sent.time, strict=True)
                  if t == topic and at >= sent.time[0] + 20 * 10**9]
        heard = [d for d, t in zip(got.data, got.topic, strict=True) if t == topic]
        assert len(heard) >= 350 and heard == wanted


CHAIN = {'arm_simulator': 'joint_states', 'reference_generator': 'joint_reference',
         'oscillation_damper': 'velocity_commands', 'joint_state_filter': 'joint_motion',
         'dynamics_predictor': 'predicted_strains', 'collision_detector': 'strain_residuals',
         'monitor': 'monitor/strain_residuals'}
KINDS = {'velocity_commands': Float64MultiArray, 'joint_motion': JointTrajectory}


def test_each_is_killed_and_restarted(world: World, root: Path, model: Path) -> None:
    """One after the other dies by SIGKILL and comes back: the others live, and all flows again."""
    def begin(node: str) -> BaseProcess:
        names = [param.name for param in NODES[node]]
        words = [] if node != 'monitor' else ['-r', 'strain_residuals:=monitor/strain_residuals',
                                              '-r', 'joint_motion:=monitor/joint_motion']
        for name, value in (('arm', root / 'config/tudor.yaml'), ('model', model),
                            ('rate', 100.0), ('reaction', 'none')):
            if name in names:  # no reaction, because the model is that of another arm
                words += ['-p', f'{name}:={value}']
        return fork(node, *words)

    heard = {topic: world.listen(topic, KINDS.get(topic, JointState)) for topic in CHAIN.values()}

    def flows() -> bool:
        for messages in heard.values():
            messages.clear()
        return world.spin(lambda: all(len(m) > 20 for m in heard.values()), 180.0)

    def said() -> dict[str, object]:
        last = {status.name: status.message for array in world.heard['/diagnostics'][-100:]
                for status in array.status}
        return {**{topic: len(messages) for topic, messages in heard.items()}, **last}
    processes = {node: begin(node) for node in CHAIN}
    try:
        assert flows(), said()
        for node in CHAIN:
            processes[node].kill()
            processes[node].join()
            world.rest(0.3)
            processes[node] = begin(node)
        assert flows(), said()
        assert all(process.is_alive() for process in processes.values())
    finally:
        for process in processes.values():
            process.kill()
            process.join()
