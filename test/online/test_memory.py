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

"""What a monitor remembers for longer than the recording of an event: with it, the same ratios."""

from __future__ import annotations

from collections.abc import Callable
import json
from typing import Any

from elastic_making import blade_arm, identified, recorded, STIFFNESS, travel
import numpy as np
from payload_making import true_outputs, two_gauge_arm
import pytest
from sample_arms import multisine, planar_arm, recording_of
from threshold_making import plain_thresholds

from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.load.live import carried_load
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.regressor import EffortRegressor, PayloadRegressor, StrainRegressor
from tudor_dynamics.online.monitor import Monitor, MonitorSettings
from tudor_dynamics.online.settings import RING_TIME
from tudor_dynamics.online.threshold_learning import thresholds_to_dict
from tudor_dynamics.typing import FloatArray

RATE, SECONDS = 100.0, 75.0
T = np.arange(0.0, SECONDS, 1.0 / RATE)
CAUSAL = PreprocessingSpec(filter='causal', rate=None, measured_velocity=False)


def _bundle(arm: Any, output: str, kind: str, model: Any, *, size: float) -> ModelBundle:
    known = thresholds_to_dict(plain_thresholds(model.channels, len(arm.active_joints), size))
    return ModelBundle(arm, CAUSAL, {output: {kind: model}}, {
        'thresholds': {output: {kind: known}, **(
            {'momentum': {kind: known}} if output == 'effort' else {})}}, digest='1')


def _noise(channels: int) -> FloatArray:
    return np.random.default_rng(3).normal(size=(len(T), channels))


def picked_up() -> tuple[ModelBundle, MonitorSettings, str, Recording]:
    """Carry an estimated load that was picked up long ago."""
    arm = two_gauge_arm()
    t = np.arange(0.0, 60.0, 0.05)
    moved = multisine(t, 2, 1)
    inputs = np.vstack([np.column_stack([moved, np.full(len(t), m)]) for m in (0.0, 0.4)])
    values = np.vstack([true_outputs(arm, moved, m)['strain'] for m in (0.0, 0.4)])
    model = AnalyticalModel(PayloadRegressor(StrainRegressor(arm, 'paper'), arm, (0.0, 0.4)), 2)
    own = multisine(T, 2, 3)
    empty, full = (true_outputs(arm, own, m)['strain'] for m in (0.0, 0.3))
    strain = np.where(T[:, None] < 20.0, empty, full) + _noise(2)
    return (_bundle(arm, 'strain', 'analytical', model.fit(inputs, values), size=6.0),
            MonitorSettings(), 'estimate', recording_of(own[:, :2], RATE, strain=strain))


def standing() -> tuple[ModelBundle, MonitorSettings, str, Recording]:
    """Stand on bristles that were bent long ago."""
    arm = planar_arm([{'name': name, 'friction': ['viscous', 'presliding'],
                       'presliding_distances': [0.3]} for name in ('j1', 'j2')])
    model = AnalyticalModel(EffortRegressor(arm), 2)
    moved = multisine(T, 2, 3)
    q = moved[np.minimum(np.arange(len(T)), round(30.0 * RATE)), :2]
    q = q + 1e-3 * np.sin(7.0 * T)[:, None]  # less than bristles slide by
    inputs = np.hstack([moved, np.sign(moved[:, 2:4])])
    effort = np.random.default_rng(1).normal(size=(len(T), 2))
    return (_bundle(arm, 'effort', 'analytical', model.fit(inputs, effort + 9.0 * inputs[:, 6:]),
                    size=0.5),
            MonitorSettings(methods=('effort', 'momentum')), 'parameter',
            recording_of(q, RATE, effort=_noise(2)))


def elastic() -> tuple[ModelBundle, MonitorSettings, str, Recording]:
    """Swing as only the state of an elastic model knows."""
    arm = blade_arm()
    model = identified(arm, {'gear(j1)': STIFFNESS['j1']}).models['strain']['elastic']
    q = travel(SECONDS, RATE, 3)[:len(T)]
    strain = recorded(arm, {'gear(j1)': 200.0}, q, RATE)[0]
    return (_bundle(arm, 'strain', 'elastic', model, size=6.0),
            MonitorSettings(kind='elastic'), 'parameter', recording_of(q, RATE, strain=strain))


def _ratios(
    bundle: ModelBundle, settings: MonitorSettings, source: str, recording: Recording, first: int,
    memories: dict[str, list[dict[str, Any]]],
) -> tuple[FloatArray, Monitor]:
    """Hear a recording from a sample on; ratios of its last five seconds."""
    monitor = Monitor(bundle.at(0.0), settings, payload=carried_load(source, bundle, 0.0))
    for name, memory in monitor.memories.items():
        memory.recall(memories.get(name, ()))
    output, = monitor.wanted
    measured, found = getattr(recording, output), []
    for k in range(first, len(recording.stamp)):
        stamp = int(recording.stamp[k])
        for one in (monitor.add_joints(stamp, recording.q[k]),
                    monitor.add_measured(output, stamp, measured[k])):
            if k > len(recording.stamp) - 5.0 * RATE:
                found += [excess.collision for _, excess in one.excesses]
    return np.array(found), monitor


@pytest.mark.parametrize(('make', 'needed'), [
    (picked_up, 'load'), (standing, 'model'), (standing, 'observer'), (elastic, 'model')])
def test_with_its_memory_to_the_last_bit(
    make: Callable[[], tuple[ModelBundle, MonitorSettings, str, Recording]], needed: str,
) -> None:
    """A monitor that hears the last 30 s alone is as one that heard more, with its memory."""
    bundle, settings, source, recording = make()
    expected, monitor = _ratios(bundle, settings, source, recording, 0, {})
    memories = json.loads(json.dumps({
        name: memory.before(int(recording.stamp[-1]))
        for name, memory in monitor.memories.items()}))
    first = len(recording.stamp) - round(RING_TIME * RATE)
    assert len(expected) and len(memories[needed]) == 2
    assert np.array_equal(_ratios(bundle, settings, source, recording, first, memories)[0],
                          expected)
    memories[needed] = []
    assert not np.array_equal(
        _ratios(bundle, settings, source, recording, first, memories)[0], expected)
