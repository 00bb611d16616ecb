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

"""The simulated arm, damped and watched over topics, as the same objects do it in lock-step."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_world import feed, series, values_of, World
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.mechanics.rig import Rig
from tudor_dynamics.models.bundle import load_bundle, ModelBundle, save_bundle
from tudor_dynamics.models.elastic.model import ElasticModel, PhysicalParameter
from tudor_dynamics.nodes.common.messages import nanoseconds
from tudor_dynamics.nodes.monitor import MonitorNode
from tudor_dynamics.online.monitor import Monitor, MonitorSettings
from tudor_dynamics.online.settings import LAGS, WINDOW
from tudor_dynamics.online.threshold_learning import thresholds_to_dict
from tudor_dynamics.online.thresholds import MethodThresholds, Tail

PAYLOAD, RATE, START = 0.2, 100.0, 1_000_000_000
PUSH = (6.0, 6.4)  # s
GAIN = 121.4  # um/m per N m, that of the sensors in config/tudor.yaml


@pytest.fixture(scope='module')
def arm(root: Path) -> Arm:
    """Give the reference arm."""
    return load_arm(root / 'config/tudor.yaml')


@pytest.fixture(scope='module')
def seen(arm: Arm) -> Recording:
    """Let controller and reference move the arm, commands held for a sample, and push it once."""
    rig = Rig(arm, rate=RATE, payload=PAYLOAD, seed=5)
    rig.start_source('none')
    assert rig.source is not None
    rig.source.wander(5)
    samples: list[Any] = []

    def keep(sample: Any) -> Any:
        samples.append(sample)
        return sample

    rig.alter = keep
    for _ in range(round(10.0 * RATE)):
        pushing = PUSH[0] <= rig.t < PUSH[1]
        rig.process.force = np.array([0.0, 0.0, -4.0 if pushing else 0.0])
        rig.step()
    t, *signals = (np.array([getattr(s, name) for s in samples])
                   for name in ('t', 'q', 'dq', 'current', 'strain'))
    stamp = START + np.round(t * 1e9).astype(np.int64)
    return Recording('', stamp, *signals, (slice(0, len(stamp)),), 1.0 / RATE)


@pytest.fixture(scope='module')
def bundle(arm: Arm, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a bundle of the arm's own parameters, with thresholds above the noise of gauges."""
    n = len(arm.gauges)
    model = ElasticModel(arm, 'strain', (PhysicalParameter('payload', PAYLOAD, 'kg'),))
    model.coefficients_ = tuple(np.array([GAIN, 0.0]) for _ in range(n))
    model.standard_errors_ = tuple(np.full(2, 0.01) for _ in range(n))
    model.noise_ = np.full(n, 4.0)
    taps = np.zeros((LAGS + WINDOW, n, n))
    taps[0] = np.eye(n)
    profile = np.zeros((2 * n, 1 + 4 * len(arm.active_joints)))
    profile[:, 0] = 6.0
    tail, never = (Tail(location, 0.5, 0.0, 0.2, 6.0, 50.0) for location in (3.0, 1e9))
    thresholds = MethodThresholds(
        arm.gauge_names, 0.01, taps, profile, (tail,) * (2 * n) + (never,) * n, 120.0,
        np.full(n, 1.0), np.full(2, 1.8), np.zeros(n))
    out = tmp_path_factory.mktemp('elastic') / 'model'
    save_bundle(ModelBundle(arm, arm.spec.preprocessing, {'strain': {'elastic': model}}, {
        'thresholds': {'strain': {'elastic': thresholds_to_dict(thresholds)}}}), out)
    return out


def lock_step(bundle: Path, seen: Recording) -> tuple[dict[int, np.ndarray], list[int]]:
    """Watch with the object of the node; give residuals by stamp, and onsets of events."""
    monitor = Monitor(load_bundle(bundle), MonitorSettings(kind='elastic'))
    residuals: dict[int, np.ndarray] = {}
    events: list[int] = []
    assert seen.strain is not None and seen.dq is not None
    for k, stamp in enumerate(seen.stamp.tolist()):
        for found in (monitor.add_measured('strain', stamp, seen.strain[k]),
                      monitor.add_joints(stamp, seen.q[k], seen.dq[k])):
            residuals |= {r.motion.stamp: r.value for _, r in found.residuals}
            events += [event.onset for event in found.events]
    return residuals, events


def strain_first(_: int, messages: dict[str, JointState]) -> None:
    """Order the messages of a sample as arm_simulator publishes them."""
    messages['joint_states'] = messages.pop('joint_states')


def test_over_topics_as_in_lock_step(
    world: World, bundle: Path, seen: Recording, arm: Arm,
) -> None:
    """Residuals to 1e-9 and the same events: one for the push, and the model follows again."""
    node = world.add(MonitorNode, model=str(bundle), kind='elastic')
    world.listen('strain_residuals')
    world.listen('collision_event', Header)
    world.meet('joint_states', 'link_strains')
    feed(world, seen, lambda: node.meter.count // 2, change=strain_first, batch=1,
         gauges=list(arm.gauge_names))
    residuals, events = lock_step(bundle, seen)
    world.spin(lambda: len(world.heard['strain_residuals']) >= len(residuals))
    stamp, values = series(world.heard['strain_residuals'], 'position')
    assert stamp.tolist() == list(residuals)
    assert np.abs(values - np.array(list(residuals.values()))).max() < 1e-9
    assert [nanoseconds(event.stamp) for event in world.heard['collision_event']] == events
    begin, end = (START + round(1e9 * t) for t in PUSH)
    assert [begin <= event <= end for event in events] == [True]
    assert (values[stamp > end + 10**9].std(axis=0) < 6.0).all()
    assert not node.watch.level
    assert 'link' in values_of(world.status('monitor'))['thresholds widened: strain']
