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

"""The load over topics: as offline, announced, and to those who follow it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from geometry_msgs.msg import InertiaStamped
import numpy as np
from payload_making import true_outputs, two_gauge_arm
import pytest
from ros_world import feed, values_of, World
from sample_arms import LENGTH_2, multisine, recording_of
from std_srvs.srv import Trigger

from tudor_dynamics.arm import PreprocessingSpec
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.payload import payload_regressor, PayloadModel
from tudor_dynamics.models.regressor import StrainRegressor
from tudor_dynamics.models.storage.bundle_io import load_bundle, save_bundle
from tudor_dynamics.monitoring.monitor import Monitor
from tudor_dynamics.monitoring.payload_stage import PayloadStage
from tudor_dynamics.monitoring.settings import MonitorSettings
from tudor_dynamics.nodes.common.base import latched
from tudor_dynamics.nodes.dynamics_predictor import DynamicsPredictorNode
from tudor_dynamics.nodes.payload_estimator import PayloadEstimatorNode

RATE, SECONDS, PICKED_UP, LOAD = 100.0, 8.0, 4.0, 0.3


@pytest.fixture(scope='module')
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a model of the strains from 0 to 400 g."""
    arm = two_gauge_arm()
    t = np.arange(0.0, 60.0, 0.05)
    moved = multisine(t, 2, 1)
    inputs = np.vstack([np.column_stack([moved, np.full(len(t), m)]) for m in (0.0, 0.4)])
    values = np.vstack([true_outputs(arm, moved, m)['strain'] for m in (0.0, 0.4)])
    model = PayloadModel(payload_regressor(StrainRegressor(arm, 'paper'), arm), 2,
                         (0.0, 0.4)).fit(inputs, values)
    out = tmp_path_factory.mktemp('payload') / 'model'
    facts = {'validation': {'strain': {'analytical': {'training': {'channels': {
        'g1': {'rmse': 5.0}, 'g2': {'rmse': 3.0}}}}}}}
    save_bundle(ModelBundle(arm, PreprocessingSpec(measured_velocity=True),
                            {'strain': {'analytical': model}}, facts), out)
    return out


@pytest.fixture(scope='module')
def seen() -> Recording:
    """Pick up a load while the arm moves."""
    arm = two_gauge_arm()
    t = np.arange(0.0, SECONDS, 1.0 / RATE)
    moved = multisine(t, 2, 3)
    empty, full = (true_outputs(arm, moved, m)['strain'] for m in (0.0, LOAD))
    noise = np.random.default_rng(0).standard_normal(empty.shape)
    strain = np.where(t[:, None] < PICKED_UP, empty, full) + noise
    return recording_of(moved[:, :2], RATE, dq=moved[:, 2:4], strain=strain)


def offline(bundle: Path, seen: Recording) -> list[tuple[float, float]]:
    """Follow the load with the object of the node."""
    models = load_bundle(bundle)
    stage = PayloadStage(models, 0.0)
    monitor = Monitor(models.at(0.0), MonitorSettings(), payload=stage)
    assert seen.strain is not None and seen.dq is not None
    found = []
    for k, stamp in enumerate(seen.stamp.tolist()):
        monitor.add_joints(stamp, seen.q[k], seen.dq[k])
        monitor.add_measured('strain', stamp, seen.strain[k])
        found.append((stage.mass, stage.std))
    return found


def test_picked_up(bundle: Path, seen: Recording) -> None:
    """A load is recognised within a second, and known to 10 g soon; before, there is none."""
    found = np.array(offline(bundle, seen))
    at = np.searchsorted(np.arange(len(found)) / RATE, [PICKED_UP, PICKED_UP + 1.0, SECONDS])
    assert abs(found[at[0] - 1, 0]) < 0.01
    assert abs(found[at[1], 0] - LOAD) < 0.03
    assert abs(found[-1, 0] - LOAD) < 0.01
    assert abs(found[-1, 0] - LOAD) < 3.0 * found[-1, 1] < 0.1


def test_over_topics(world: World, bundle: Path, seen: Recording) -> None:
    """The node knows the load that the same object knows offline, and tells it to a predictor."""
    node = world.add(PayloadEstimatorNode, model=str(bundle))
    predictor = world.add(DynamicsPredictorNode, model=str(bundle), payload_source='topic')
    world.listen('payload', InertiaStamped, latched())
    world.meet('joint_states', 'link_strains')

    def named(_: int, messages: dict[str, Any]) -> None:
        messages['joint_states'].name = ['j1', 'j2']
    feed(world, seen, lambda: node.meter.count // 2, change=named, batch=1, gauges=['g1', 'g2'])
    mass, std = offline(bundle, seen)[-1]
    assert node.port.load.mass == pytest.approx(mass, abs=1e-9)
    assert node.port.load.std == pytest.approx(std, abs=1e-9)
    own = {item.topic_name for item in node.publishers}
    assert '/payload' in own and '/payload_estimator/collision' in own
    assert '/collision' not in own and '/strain_residuals' not in own
    told = world.heard['payload']
    assert told[-1].header.frame_id == node.port.load.frame
    assert told[-1].inertia.com.x == pytest.approx(LENGTH_2)
    assert told[-1].inertia.m == pytest.approx(mass, abs=0.1 * std + 1e-9)
    assert world.spin(lambda: abs(predictor._port.load.mass - told[-1].inertia.m) < 1e-12)
    status = values_of(world.status('payload_estimator'))
    assert status['payload told by'] == 'strain' and float(status['payload std [kg]']) > 0.0


def test_expected(world: World, bundle: Path) -> None:
    """A load is announced by a service; without a model that tells kilograms it is refused."""
    node = world.add(PayloadEstimatorNode, model=str(bundle))
    answer = node.port._expect()
    assert 'without being a collision' in answer and node.port.load is not None
    client = world.probe.create_client(Trigger, 'payload_estimator/expect_payload')
    assert world.spin(client.service_is_ready)
    future = client.call_async(Trigger.Request())
    assert world.spin(future.done) and future.result().success


def test_without_a_scale(world: World, model: Path) -> None:
    """Strains of unknown gain tell no kilograms: the diagnosis says what would."""
    node = world.add(PayloadEstimatorNode, model=str(model))
    assert 'two payloads' in node.fault
