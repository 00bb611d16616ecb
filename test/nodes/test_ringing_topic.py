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

"""The monitor says on a topic, and in its diagnostics, how a tool of its model rings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from ros_world import feed, JOINTS, values_of, World
from sensor_msgs.msg import JointState
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.models.bundle import load_bundle, save_bundle
from tudor_dynamics.models.flexible_tool import FlexibleTool
from tudor_dynamics.nodes.monitor import MonitorNode


def test_amplitudes_of_all_joints(world: World, root: Path, model: Path, tmp_path: Path) -> None:
    """A swing of the efforts at the frequency of the tool is heard, and called so."""
    bundle = load_bundle(model)
    bundle.tool = FlexibleTool.model_validate({
        'motion': 'planned', 'rests': 9, 'turn': [0.3, 0.2, 0.1], 'place': [0.1, 0.0, 0.3],
        'mass': 0.5, 'length': 0.3, 'frequencies': [3.0, 3.0], 'damping': [0.02, 0.02],
        'covariance': np.eye(12).tolist(), 'quiet': 1e-4, 'scatter': 0.1,
        'pushed': np.eye(6).tolist()})
    save_bundle(bundle, tmp_path / 'model')
    recording = read_recording(root / 'bags/two_blade_test',
                               load_arm(root / 'config/two_blade_arm.yaml'))
    assert recording.effort is not None
    t = 1e-9 * (recording.stamp - recording.stamp[0])
    recording.effort[:] += 0.3 * np.sin(6.0 * np.pi * t)[:, None]
    node = world.add(MonitorNode, model=str(tmp_path / 'model'), methods=['effort'],
                     event_bags='none')
    rings = world.listen('ringing', JointState)
    world.meet('joint_states', 'motor_currents')
    feed(world, recording, lambda: node.meter.count // 2 + 1, last=600)
    assert world.spin(lambda: len(rings) > 300)
    assert list(rings[-1].name) == JOINTS
    efforts = np.array([message.effort for message in rings[-200:]])
    assert np.isfinite(efforts).all() and (efforts.max(axis=1) > 0.05).all()
    assert ', quiet in ' in values_of(world.status('monitor'))['rings']
