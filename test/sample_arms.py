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

"""Arms, motions and recordings that several tests are made of."""

from __future__ import annotations

from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.description import Arm, arm_from_dict
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.mechanics.integrator import DZ, Z
from tudor_dynamics.mechanics.plant import Plant
from tudor_dynamics.typing import FloatArray

SIX_ROWS = [[0.0, pi / 2, 0.13, 0.0], [-0.61, 0.0, 0.0, 0.3], [-0.57, 0.0, 0.0, 0.0],
            [0.0, pi / 2, 0.16, -0.2], [0.0, -pi / 2, 0.12, 0.0], [0.0, 0.0, 0.09, 0.0]]
LENGTH_1, LENGTH_2 = 0.42, 0.35


def arm_of(rows: list[list[float]], joints: list[dict[str, Any]], **more: Any) -> Arm:
    """Describe an arm by D-H rows."""
    return arm_from_dict({'name': 'sample', 'kinematics': {'dh': rows}, 'joints': joints, **more},
                         base=Path('.'), source='sample.yaml')


def planar_arm(
    joints: list[dict[str, Any]] | None = None, gauges: list[dict[str, Any]] | None = None,
    **more: Any,
) -> Arm:
    """Describe two links that move in a vertical plane, horizontal at zero."""
    joints = joints or [{'name': 'j1'}, {'name': 'j2'}]
    return arm_of([[LENGTH_1, 0.0, 0.0, 0.0], [LENGTH_2, 0.0, 0.0, 0.0]], joints,
                  gravity=[0.0, -9.81, 0.0], gauges=gauges or [], **more)


def gauge(name: str, joint: str, distance: float) -> dict[str, Any]:
    """Describe a gauge."""
    return {'name': name, 'joint': joint, 'distance': distance}


def random_inertia(generator: np.random.Generator) -> pin.Inertia:
    """Draw the inertia of a body that could exist: a few point masses."""
    inertia = pin.Inertia.Zero()
    for _ in range(4):
        inertia += pin.Inertia(float(generator.uniform(0.1, 1.0)),
                               generator.uniform(-0.3, 0.3, 3), np.zeros((3, 3)))
    return inertia


def random_states(n: int, n_joints: int, seed: int = 0) -> FloatArray:
    """Draw ``[q, dq, ddq]``."""
    scale = np.repeat([pi, 2.0, 5.0], n_joints)
    generator = np.random.default_rng(seed)
    return np.asarray(generator.uniform(-1, 1, (n, 3 * n_joints)) * scale)


def multisine(t: FloatArray, n_joints: int, seed: int = 0) -> FloatArray:
    """Give ``[q, dq, ddq]`` of a smooth motion, derivatives exact."""
    generator = np.random.default_rng(seed)
    q, dq, ddq = (np.zeros((len(t), n_joints)) for _ in range(3))
    for w in 2 * pi * np.array([0.11, 0.23, 0.37, 0.53, 0.71]):
        a, phase = generator.uniform(0.1, 0.4, n_joints), generator.uniform(0, 2 * pi, n_joints)
        angle = w * t[:, None] + phase
        q += a * np.sin(angle)
        dq += a * w * np.cos(angle)
        ddq -= a * w * w * np.sin(angle)
    return np.hstack([q, dq, ddq])


def recording_of(
    q: FloatArray,
    rate: float,
    *,
    dq: FloatArray | None = None,
    effort: FloatArray | None = None,
    strain: FloatArray | None = None,
    gaps: tuple[int, ...] = (),
    gap: float = 2.0,
    path: str = 'bag',
) -> Recording:
    """Make a recording; before each sample in ``gaps`` some seconds are missing."""
    step = np.full(len(q), round(1e9 / rate), dtype=np.int64)
    step[list(gaps)] += round(gap * 1e9)
    edges = [0, *gaps, len(q)]
    return Recording(
        path=path, stamp=1_700_000_000_000_000_000 + np.cumsum(step), q=q, dq=dq, effort=effort,
        strain=strain, segments=tuple(map(slice, edges[:-1], edges[1:])), dt=1.0 / rate)


def put_into_state(
    plant: Plant, t: float, z: FloatArray, dz: FloatArray, torque: FloatArray,
) -> None:
    """Put a plant into a state at a time [s], and solve its accelerations."""
    plant.tables.vectors[Z], plant.tables.vectors[DZ] = z, dz
    plant.tables.torque[plant._q] = torque
    plant._t0, plant._time_steps = t, 0
    plant._start()
