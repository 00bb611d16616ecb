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

"""Outputs of a planar arm with any payload, exact to rounding."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from sample_arms import gauge, LENGTH_2, planar_arm, random_inertia

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.models.regressor import EffortRegressor, StrainRegressor
from tudor_dynamics.typing import FloatArray


def two_gauge_arm() -> Arm:
    """Give an arm with torques and a gauge on each link."""
    joints = [{'name': name, 'friction': ['viscous', 'coulomb']} for name in ('j1', 'j2')]
    return planar_arm(joints, [gauge('g1', 'j1', 0.05), gauge('g2', 'j2', 0.05)])


def true_outputs(arm: Arm, motion: FloatArray, payload: float) -> dict[str, FloatArray]:
    """
    Give efforts and strains of an arm that carries a point mass at the end of its last link.

    The parameters of the bodies are drawn once and for all; the payload is added to the last body
    by the mass, first moments and inertia of a point at its end.
    """
    generator = np.random.default_rng(5)
    bodies = [random_inertia(generator).toDynamicParameters() for _ in range(2)]
    tip = pin.Inertia(payload, np.array([LENGTH_2, 0.0, 0.0]), np.zeros((3, 3)))
    bodies[1] = bodies[1] + tip.toDynamicParameters()
    drives = [0.02, 0.3, 0.2, 0.01, 0.1, 0.05]  # rotor inertia, viscous, Coulomb
    effort = EffortRegressor(arm)
    outputs = {'effort': effort.rows(motion) @ np.concatenate([*bodies, drives])}
    # at the joints the moments are those of the bodies themselves
    strain = StrainRegressor(arm, 'paper')
    moments = strain.rows(motion)[:, :, :-1] @ np.concatenate(bodies)
    outputs['strain'] = moments * [100.0, 80.0] + [3.0, -2.0]
    return outputs
