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

"""Strains in a Float64MultiArray: the nodes take them, and find what they find offline."""

from __future__ import annotations

from pathlib import Path

from carrier_making import ARRAY, array, Topic, topic_of, write
import numpy as np
import pytest
from ros_world import feed, series, World
from std_msgs.msg import Float64MultiArray

from tudor_dynamics.arm.description import load_arm, refuse_interfaces
from tudor_dynamics.bags.writer import recording_series
from tudor_dynamics.cli.main import main
from tudor_dynamics.errors import ArmError
from tudor_dynamics.nodes.arm_simulator import ArmSimulatorNode
from tudor_dynamics.nodes.monitor import MonitorNode
import yaml

SAMPLES = 150
PLACES = (2, 0)
"""Of the two gauges in the array."""


def values(row: np.ndarray) -> np.ndarray:
    """Lay two readings out among others."""
    found = np.full(4, 7.0)
    found[list(PLACES)] = row
    return found


@pytest.fixture(scope='module')
def arrays(root: Path, tmp_path_factory: pytest.TempPathFactory, recording) -> Path:
    """Folder with arm, bag and model of the arm whose gauges come in an array."""
    out = tmp_path_factory.mktemp('arrays')
    content = yaml.safe_load((root / 'config/two_blade_arm.yaml').read_text())
    for gauge, place in zip(content['gauges'], PLACES, strict=True):
        gauge |= {'topic': 'bridge', 'index': place}
    (out / 'arm.yaml').write_text(yaml.safe_dump(content))
    plain = load_arm(root / 'config/two_blade_arm.yaml')
    states, currents, _ = recording_series(recording, plain)
    strain = [array(values(row)) for row in recording.strain]
    write(out / 'bag', topic_of(states), topic_of(currents),
          Topic('/bridge', ARRAY, topic_of(states).log_time, strain))
    assert main(['fit', str(out / 'bag'), '--arm', str(out / 'arm.yaml'), '--models',
                 'analytical', '--out', str(out / 'model'), '--exit-zero']) == 0
    assert main(['evaluate', '--model', str(out / 'model'), str(out / 'bag'), '--causal', '--rate',
                 'full', '--save', str(out / 'r.npz'), '--json']) == 0
    return out


def test_same_numbers(world: World, arrays: Path, recording) -> None:
    """Residuals of every sample where arrays arrive with the joint states, equal to 1e-9."""
    node = world.add(MonitorNode, model=str(arrays / 'model'), methods=['strain'], timeout=5.0)
    assert not node.fault
    world.listen('strain_residuals')
    world.output('bridge', Float64MultiArray)
    world.meet('joint_states', 'bridge')
    at = 0

    def change(k: int, messages: dict) -> None:
        nonlocal at
        at = int(recording.stamp[k])
        del messages['motor_currents'], messages['link_strains']
        messages['bridge'] = Float64MultiArray(data=values(recording.strain[k]).tolist())
    node.ros_time = lambda: at
    feed(world, recording, lambda: node.meter.count // 2, last=SAMPLES, batch=1, change=change)
    count = SAMPLES - 50
    assert world.spin(lambda: len(world.heard['strain_residuals']) >= count)
    stamp, found = series(world.heard['strain_residuals'], 'position')
    with np.load(arrays / 'r.npz') as saved:
        assert stamp[:count].tolist() == saved['strain_analytical_stamp'][:count].tolist()
        wanted = saved['strain_analytical_residual'][:count]
        assert np.abs(found[:count] - wanted).max() < 1e-9


def test_short_arrays_are_counted(world: World, arrays: Path) -> None:
    """An array without the place of a gauge is left out, and the cause is told."""
    node = world.add(MonitorNode, model=str(arrays / 'model'), methods=['strain'], timeout=5.0)
    world.output('bridge', Float64MultiArray)
    world.meet('bridge')
    for _ in range(5):
        world.output('bridge').publish(Float64MultiArray(data=[1.0, 2.0]))
    assert world.spin(lambda: node.drops['short_array'] == 5)


def test_who_does_not_take_them_says_so(world: World, arrays: Path) -> None:
    """A simulated arm publishes joint states; nodes have no DynamicJointState."""
    node = world.add(ArmSimulatorNode, arm=str(arrays / 'arm.yaml'))
    assert 'link2_hub comes on bridge as Float64MultiArray, but a simulated arm' in node.fault
    content = yaml.safe_load((arrays / 'arm.yaml').read_text())
    for joint in content['joints']:
        joint['effort'] |= {'topic': 'dynamic_joint_states', 'interface': 'current'}
    (arrays / 'other.yaml').write_text(yaml.safe_dump(content))
    with pytest.raises(ArmError, match='as DynamicJointState, but a node supports only'):
        refuse_interfaces(load_arm(arrays / 'other.yaml'), 'a node', arrays=True)


def test_one_topic_has_one_type(arrays: Path) -> None:
    """What is described as an array for one gauge is none for another."""
    text = (arrays / 'arm.yaml').read_text().replace('index: 0', 'unit: um/m')
    (arrays / 'mixed.yaml').write_text(text)
    with pytest.raises(ArmError, match='topic bridge are described with different message types'):
        load_arm(arrays / 'mixed.yaml')
