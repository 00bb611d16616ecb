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

"""The nodes give the numbers of ``tudor evaluate``, sample for sample."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from papers.merit import main as import_merit
import pytest

from ros_world import feed, series, World
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.cli.main import main
from tudor_dynamics.identification.dataset import cut, parse_choice
from tudor_dynamics.nodes.collision_detector import CollisionDetectorNode
from tudor_dynamics.nodes.dynamics_predictor import DynamicsPredictorNode
from tudor_dynamics.nodes.joint_state_filter import JointStateFilterNode
from tudor_dynamics.nodes.monitor import MonitorNode

TOPICS = {'predicted_efforts': ('effort', 'predicted'),
          'predicted_strains': ('strain', 'predicted'),
          'effort_residuals': ('effort', 'residual'), 'strain_residuals': ('strain', 'residual')}
SENSORS = ('joint_states', 'motor_currents', 'link_strains')
EXACT = 1e-9
SETTLING = 50
"""Samples until the filters have settled: half a second at 100 Hz."""


def compare(world: World, reference: Path) -> None:
    """Every sample of the file, and none else, was heard, to 1e-9."""
    with np.load(reference) as saved:
        for topic, (output, what) in TOPICS.items():
            field = 'position' if output == 'strain' else 'effort'
            stamp, values = series(world.heard[topic], field)
            assert stamp.tolist() == saved[f'{output}_analytical_stamp'].tolist(), topic
            assert np.abs(values - saved[f'{output}_analytical_{what}']).max() < EXACT, topic


def start(world: World, chain: str, model: Path) -> Callable[[], int]:
    """Start the nodes of one way, and listen; gives a count of the samples that are through."""
    methods = ['strain', 'effort']
    if chain == 'monitor':
        first = world.add(MonitorNode, model=str(model), methods=methods)
        messages = len(SENSORS)
    else:
        messages = 1
        first = world.add(JointStateFilterNode, model=str(model))
        world.add(DynamicsPredictorNode, model=str(model))
        world.add(CollisionDetectorNode, model=str(model), methods=methods)
    for topic in TOPICS:
        world.listen(topic)
    world.meet(*SENSORS)
    residuals = world.heard['strain_residuals']

    def through() -> int:
        arrived = first.meter.count // messages
        return arrived if arrived <= SETTLING else min(arrived, len(residuals) + SETTLING)
    return through


@pytest.mark.parametrize('chain', ['monitor', 'separate'])
def test_sample_bag(
    chain: str, world: World, model: Path, root: Path, recording, tmp_path: Path,
) -> None:
    """The bag of the package, every sample."""
    bag = str(root / 'bags/two_blade_test')
    assert main(['evaluate', '--model', str(model), bag, '--causal', '--rate', 'full', '--save',
                 str(tmp_path / 'r.npz'), '--json']) == 0
    feed(world, recording, start(world, chain, model))
    world.spin(lambda: len(world.heard['effort_residuals']) >= len(recording.stamp) - SETTLING)
    compare(world, tmp_path / 'r.npz')


def same_numbers(world: World, bag: Path, config: Path, folder: Path) -> None:
    """Let the monitor and ``tudor evaluate`` judge half a minute of a bag by the model `m`."""
    part = f'{bag}@0-40%'
    assert main(['evaluate', '--model', str(folder / 'm'), part, '--causal', '--rate',
                 'full', '--save', str(folder / 'r.npz'), '--json']) == 0
    arm = load_arm(config)
    recording = cut(read_recording(bag, arm), parse_choice(part))
    assert len(recording.stamp) > 3000
    feed(world, recording, start(world, 'monitor', folder / 'm'), gauges=list(arm.gauge_names))
    with np.load(folder / 'r.npz') as saved:
        count = len(saved['effort_analytical_stamp'])
    assert world.spin(lambda: len(world.heard['effort_residuals']) >= count)
    compare(world, folder / 'r.npz')


@pytest.mark.shared
def test_reference_recording(world: World, shared_data: Path, root: Path, tmp_path: Path) -> None:
    """A part of a long recording through monitor, by a model of another one."""
    bags = shared_data / 'bags'
    config = root / 'config/two_blade_arm.yaml'
    assert main(['fit', f'{bags}/arm_200g_free_1', '--arm', str(config), '--models', 'analytical',
                 '--out', str(tmp_path / 'm'), '--exit-zero']) == 0
    same_numbers(world, bags / 'arm_200g_free_4', config, tmp_path)


@pytest.mark.shared
def test_real_arm(world: World, shared_data: Path, root: Path, tmp_path: Path) -> None:
    """A part of the recording of the real arm, with velocities, imported."""
    bag, config = tmp_path / 'bag', root / 'config/tudor.yaml'
    assert import_merit([str(shared_data / 'merit_exp1.csv'), '--out', str(bag)]) == 0
    assert main(['fit', f'{bag}@0-50%', '--test', f'{bag}@50-100%', '--models', 'analytical',
                 '--arm', str(config), '--out', str(tmp_path / 'm'), '--exit-zero']) == 0
    same_numbers(world, bag, config, tmp_path)
