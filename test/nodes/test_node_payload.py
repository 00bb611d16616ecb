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

from __future__ import annotations

from pathlib import Path

import numpy as np
from payload_making import true_outputs, two_gauge_arm
import pytest
from rclpy.parameter import Parameter
from ros_world import World
from sample_arms import random_states
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import ModelBundle, save_bundle
from tudor_dynamics.models.regressor import EffortRegressor, PayloadRegressor
from tudor_dynamics.nodes.dynamics_predictor import DynamicsPredictorNode
from tudor_dynamics.nodes.monitor import MonitorNode


@pytest.fixture
def all_payloads(tmp_path: Path) -> Path:
    """Model of the efforts from 0 to 400 g."""
    arm, motion = two_gauge_arm(), random_states(300, 2, 0)
    inputs = np.vstack([np.column_stack([motion, np.full(300, m)]) for m in (0.0, 0.4)])
    values = np.vstack([true_outputs(arm, motion, m)['effort'] for m in (0.0, 0.4)])
    model = AnalyticalModel(PayloadRegressor(EffortRegressor(arm), arm, (0.0, 0.4)), 2).fit(
        inputs, values)
    save_bundle(ModelBundle(arm, PreprocessingSpec(), {'effort': {'analytical': model}}),
                tmp_path / 'model')
    return tmp_path / 'model'


def test_payload_changes_while_running(world: World, all_payloads: Path) -> None:
    """The parameter puts another payload in; beyond the range the diagnosis warns."""
    node = world.add(DynamicsPredictorNode, model=str(all_payloads), payload=0.1)
    motion = random_states(1, 2, 4)
    for payload in (0.1, 0.3):
        assert node.set_parameters([Parameter('payload', value=payload)])[0].successful
        expected = true_outputs(two_gauge_arm(), motion, payload)['effort']
        assert np.allclose(node.predictor.models['effort'].predict(motion), expected, rtol=1e-6)
    assert dict(node.status()[2])['payload [kg]'] == '0.3'
    assert node.status()[2]['load'] == 'load 0.3 kg assumed (parameter payload)'
    assert node.set_parameters([Parameter('payload', value=0.0)])[0].successful
    assert node.status()[2]['load'] == 'no load assumed'
    monitor = world.add(MonitorNode, model=str(all_payloads), methods=['effort'])
    assert monitor.set_parameters([Parameter('payload', value=0.2)])[0].successful
    assert np.allclose(monitor.monitor.predictor.models['effort'].predict(motion),
                       true_outputs(two_gauge_arm(), motion, 0.2)['effort'], rtol=1e-6)


def test_a_model_of_one_payload_takes_its_own(world: World, tmp_path: Path) -> None:
    """At the start and while it runs; the diagnosis tells it, and another one is refused."""
    arm, motion = two_gauge_arm(), random_states(300, 2, 0)
    model = AnalyticalModel(EffortRegressor(arm), 2).fit(
        motion, true_outputs(arm, motion, 0.2)['effort'])
    save_bundle(ModelBundle(arm, PreprocessingSpec(), {'effort': {'analytical': model}},
                            {'training': [{'bag': 'run', 'payload': 0.2}]}), tmp_path / 'model')
    for factory, more in ((DynamicsPredictorNode, {}), (MonitorNode, {'methods': ['effort']})):
        node = world.add(factory, model=str(tmp_path / 'model'), payload=0.2, **more)
        assert not node.fault
        assert dict(node.status()[2])['payload [kg]'] == '0.2'
        assert node.status()[2]['load'] == 'load 0.2 kg assumed (of the model)'
        result = node.set_parameters([Parameter('payload', value=0.4)])[0]
        assert not result.successful and '0.2 kg; give that' in result.reason
        assert '--payload-of' in result.reason
        assert node.set_parameters([Parameter('payload', value=0.0)])[0].successful


def test_a_model_of_one_payload_takes_none(world: World, model: Path) -> None:
    """The parameter is refused, and at the start it is a fault that says what to do."""
    node = world.add(DynamicsPredictorNode, model=str(model))
    result = node.set_parameters([Parameter('payload', value=0.2)])[0]
    assert not result.successful and 'one load' in result.reason
    other = world.add(MonitorNode, model=str(model), payload=0.2)
    assert 'one load' in other.fault
