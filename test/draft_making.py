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

"""A URDF arm with masses, and bags of its motion in the unit that a test wants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.kinematics import model_from_urdf
from tudor_dynamics.bags.messages import joint_signals
from tudor_dynamics.bags.writer import write_bag

JOINTS = ('shoulder', 'elbow')
LINK = """<link name="{name}"><inertial><origin xyz="0.2 0 0"/><mass value="{mass}"/>
<inertia ixx="0.01" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{name}" type="{kind}"><origin xyz="{place} 0 0" rpy="{angle} 0 0"/>
<parent link="{parent}"/><child link="{child}"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="{effort}" velocity="3"/></joint>"""


def urdf(*, effort: float = 60.0, masses: bool = True, finger: bool = False) -> str:
    """Write a two-link arm that moves in a vertical plane, with a finger if need be."""
    parts = ['<robot name="pair"><link name="base"/>',
             *(LINK.format(name=name, mass=mass if masses else 0.0)
               for name, mass in (('upper', 4.0), ('lower', 3.0))),
             JOINT.format(name='shoulder', kind='revolute', place=0, angle=1.5708, parent='base',
                          child='upper', effort=effort),
             JOINT.format(name='elbow', kind='revolute', place=0.4, angle=0, parent='upper',
                          child='lower', effort=effort)]
    if finger:
        parts += ['<link name="tip"/>',
                  JOINT.format(name='finger', kind='prismatic', place=0.4, angle=0,
                               parent='lower', child='tip', effort=5)]
    return '\n'.join([*parts, '</robot>'])


def motion(seconds: float = 12.0, rate: float = 100.0) -> tuple[np.ndarray, np.ndarray]:
    """Give stamps [ns] and positions of both joints [rad]."""
    t = np.arange(int(seconds * rate)) / rate
    q = np.column_stack([0.4 + 0.7 * np.sin(1.3 * t) + 0.2 * np.sin(3.1 * t),
                         -0.5 + 0.8 * np.sin(1.9 * t + 1.0)])
    return 1_700_000_000_000_000_000 + np.round(t * 1e9).astype(np.int64), q


def torques(
    q: np.ndarray, rate: float = 100.0, *, text: str = '',
    gravity: Sequence[float] = (0, 0, -9.81),
) -> np.ndarray:
    """Give the torques of the motion, with friction [N m]."""
    model = model_from_urdf(text or urdf(), 'pair.urdf')
    model.gravity = pin.Motion(np.array(gravity, dtype=float), np.zeros(3))
    data = model.createData()
    dq, ddq = (np.gradient(q, 1 / rate, axis=0),
               np.gradient(np.gradient(q, 1 / rate, axis=0), 1 / rate, axis=0))
    tau = np.array([pin.rnea(model, data, *row) for row in zip(q, dq, ddq, strict=True)])
    noise = np.random.default_rng(3).normal(0.0, 0.05, tau.shape)
    return tau + 0.8 * np.sign(dq) + 0.5 * dq + noise


def write(
    path: Path, *, effort: np.ndarray | None, topic: str = '/joint_states',
    names: Sequence[str] = JOINTS, strains: Mapping[str, np.ndarray] | None = None,
    **options: Any,
) -> Path:
    """Write a bag of the motion."""
    stamp, q = motion()
    q = np.column_stack([q, *([np.zeros(len(q))] * (len(names) - 2))])
    own = topic == '/joint_states'
    series = [joint_signals('/joint_states', stamp, names, q, effort=effort if own else None)]
    if not own and effort is not None:
        series.append(joint_signals(topic, stamp, names, effort=effort))
    if strains:
        series.append(joint_signals('/link_strains', stamp, list(strains),
                                    np.column_stack(list(strains.values()))))
    write_bag(path, series, **options)
    return path
