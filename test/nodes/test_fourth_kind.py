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

"""A kind of model that the package does not know, in the predictor node."""

from __future__ import annotations

from pathlib import Path

from harmonic_kind import fourth_kind  # noqa: F401
import numpy as np
from ros_world import feed, series, World
from tudor_dynamics.cli.main import main
from tudor_dynamics.models.bundle import load_bundle
from tudor_dynamics.nodes.dynamics_predictor import DynamicsPredictorNode
from tudor_dynamics.nodes.joint_state_filter import JointStateFilterNode
from tudor_dynamics.signals.preprocessing import prepare

SETTLING = 50
"""Samples until the filters have settled."""


def test_predictions_over_topics(
    world: World, fourth_kind: str, root: Path, recording, tmp_path: Path,  # noqa: F811
) -> None:
    """What the node publishes is what the model says of the recording, to 1e-9."""
    bags = [str(root / f'bags/two_blade_train_{i}') for i in (1, 2)]
    assert main(['fit', *bags, '--models', fourth_kind, '--arm',
                 str(root / 'config/two_blade_arm.yaml'), '--out', str(tmp_path / 'm')]) == 0
    bundle = load_bundle(tmp_path / 'm').beside_robot()
    filtering = world.add(JointStateFilterNode, model=str(tmp_path / 'm'))
    node = world.add(DynamicsPredictorNode, model=str(tmp_path / 'm'), kind=fourth_kind)
    assert not node.fault
    heard = world.listen('predicted_strains')
    world.meet('joint_states')
    feed(world, recording, lambda: filtering.meter.count, last=300)
    assert world.spin(lambda: len(heard) >= 300 - SETTLING)
    stamp, values = series(heard, 'position')
    spec = bundle.preprocessing.model_copy(update={'filter': 'causal', 'rate': None})
    (stretch,) = prepare(recording, spec)
    at = np.searchsorted(stretch.stamp, stamp)
    assert np.array_equal(stretch.stamp[at], stamp)
    expected = bundle.models['strain'][fourth_kind].follow(stretch)[at]
    assert np.abs(values - expected).max() < 1e-9
