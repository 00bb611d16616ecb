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

"""An arm of four joints whose description is not quite true, with the efforts that it shows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
from tudor_dynamics.arm.description import Arm, arm_from_dict
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.regressor import EffortRegressor
from tudor_dynamics.typing import FloatArray

JOINTS = ('turn', 'lift', 'bend', 'roll')
VISCOUS, COULOMB, ROTOR = (3.0, 2.0, 1.0, 0.5), (4.0, 3.0, 1.5, 0.6), (0.8, 0.6, 0.3, 0.05)
TOOL_MASS = 0.7
CONSTANTS = (9.0, 10.0, 6.0, 4.0)

URDF = """<?xml version="1.0" encoding="utf-8"?>
<!-- the maker's own, with a comment > that ends nothing -->
<robot name="robot" xmlns:xacro="http://ros.org/wiki/xacro">
  <link name="base"><inertial><mass value="5"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" \
izz="1"/></inertial></link>
  <link name="column">
    <visual><geometry><mesh filename="package://robot/column.dae"/></geometry></visual>
    <inertial>
      <origin xyz="0 0.01 -0.05" rpy="0 0 0.3"/>
      <mass value="6.0"/>
      <inertia ixx="0.05" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.03"/>
    </inertial>
  </link>
  <link name="upper"><!-- heavy -->
    <inertial><mass value="5.0"/><origin xyz="0.2 0 0.05"/>
      <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.12" iyz="0" izz="0.12"/></inertial>
  </link>
  <link name="lower">
    <inertial><mass value="2.5"/><origin xyz="0.15 0 0"/>
      <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.05"/></inertial>
  </link>
  <link name="hand"/>
  <link name="tool">
    <inertial><mass value="0.5"/><origin xyz="0.02 0 0.03"/>
      <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial>
  </link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="column"/>
    <origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="100" velocity="2"/></joint>
  <joint name="lift" type="revolute"><parent link="column"/><child link="upper"/>
    <origin xyz="0.05 0 0.1" rpy="0 0.2 0"/><axis xyz="0 1 0"/>
    <dynamics damping='0.0' friction="0"/>
    <limit lower="-3" upper="3" effort="100" velocity="2"/></joint>
  <joint name="bend" type="revolute"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="100" velocity="2"/></joint>
  <joint name="roll" type="revolute"><parent link="lower"/><child link="hand"/>
    <origin xyz="0.3 0 0"/><axis xyz="1 0 0"/>
    <limit lower="-3" upper="3" effort="100" velocity="2"/></joint>
  <joint name="mount" type="fixed"><parent link="hand"/><child link="tool"/>
    <origin xyz="0.1 0 0" rpy="0 0 1.0"/></joint>
</robot>
"""


def described_arm(directory: Path, *, currents: bool = False) -> Arm:
    """Give the arm as it is described; efforts in N m, or as currents of unknown constants."""
    (directory / 'robot.urdf').write_text(URDF)
    effort = {'topic': 'joint_states', 'unit': 'A' if currents else 'N m'}
    return arm_from_dict({
        'name': 'robot', 'kinematics': {'urdf': 'robot.urdf'}, 'gravity': [0.0, 0.0, -9.81],
        'joints': [{'name': name, 'effort': effort, 'rotor_inertia': True,
                    'friction': ['viscous', 'coulomb']} for name in JOINTS]},
        base=directory, source='robot.yaml')


def true_model(arm: Arm) -> pin.Model:
    """Give the bodies as they are: heavier, lighter, elsewhere than described."""
    model = arm.model.copy()
    for index, (factor, shift) in enumerate(
            [(1.2, (0.0, 0.0, 0.01)), (0.8, (0.03, 0.01, 0.0)), (1.3, (-0.02, 0.0, 0.01)),
             (1.4, (0.01, 0.0, 0.005))], start=1):
        old = model.inertias[index]
        model.inertias[index] = pin.Inertia(
            factor * old.mass, old.lever + np.array(shift), factor * old.inertia)
    return model


def motion_of(seconds: float, seed: int, rate: float = 20.0) -> FloatArray:
    """Give smooth motion of all joints, columns q, dq, ddq [rad, rad/s, rad/s^2]."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1.0 / rate)[:, None]
    n = len(JOINTS)
    parts = np.zeros((3, len(t), n))
    for _ in range(6):
        w, size, phase = (random.uniform(0.4, 4.0, n), random.uniform(0.1, 0.5, n),
                          random.uniform(0.0, 2 * np.pi, n))
        parts += np.array([size * np.sin(w * t + phase), size * w * np.cos(w * t + phase),
                           -size * w ** 2 * np.sin(w * t + phase)])
    return np.hstack(list(parts))


def efforts_of(arm: Arm, motion: FloatArray, noise: float = 0.0, seed: int = 0) -> FloatArray:
    """Give what the true arm shows, in its unit."""
    model = true_model(arm)
    data, n = model.createData(), len(JOINTS)
    bodies = np.array([pin.rnea(model, data, row[:n], row[n:2 * n], row[2 * n:])
                       for row in motion])
    dq, ddq = motion[:, n:2 * n], motion[:, 2 * n:]
    smooth = np.tanh(dq / np.array([joint.friction_velocity for joint in arm.joints]))
    torque = bodies + ddq * ROTOR + dq * VISCOUS + smooth * COULOMB
    torque = torque + noise * np.random.default_rng(seed).standard_normal(torque.shape)
    return np.asarray(torque / (CONSTANTS if arm.joints[0].effort.unit == 'A' else 1.0))


def fitted(arm: Arm, *, seconds: float = 120.0, noise: float = 0.3) -> AnalyticalModel:
    """Fit a model to what the true arm shows."""
    motion = motion_of(seconds, 1)
    model = AnalyticalModel(EffortRegressor(arm), len(JOINTS))
    model.fit(motion, efforts_of(arm, motion, noise))
    return model
