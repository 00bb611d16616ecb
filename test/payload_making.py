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

"""A planar arm with any payload, exact to rounding: its outputs, a model, a pick-up on the way."""

from __future__ import annotations

from math import inf
from pathlib import Path

import numpy as np
import pinocchio as pin
from sample_arms import gauge, LENGTH_2, multisine, planar_arm, random_inertia, recording_of
from threshold_making import plain_thresholds

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import ModelBundle, save_bundle
from tudor_dynamics.models.regressor import EffortRegressor, PayloadRegressor, StrainRegressor
from tudor_dynamics.online.threshold_learning import thresholds_to_dict
from tudor_dynamics.typing import FloatArray

RATE, PICKED_UP, LOAD = 100.0, 4.0, 0.3
"""Samples a second, when the arm picks up a load [s], and how heavy that is [kg]."""


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


def payload_bundle(out: Path) -> Path:
    """Write a model of the strains from 0 to 400 g, with thresholds."""
    arm = two_gauge_arm()
    t = np.arange(0.0, 60.0, 0.05)
    moved = multisine(t, 2, 1)
    inputs = np.vstack([np.column_stack([moved, np.full(len(t), m)]) for m in (0.0, 0.4)])
    values = np.vstack([true_outputs(arm, moved, m)['strain'] for m in (0.0, 0.4)])
    rows = PayloadRegressor(StrainRegressor(arm, 'paper'), arm, (0.0, 0.4))
    model = AnalyticalModel(rows, 2).fit(inputs, values)
    thresholds = plain_thresholds(arm.gauge_names)
    facts = {'validation': {'strain': {'analytical': {'training': {'channels': {
        'g1': {'rmse': 5.0}, 'g2': {'rmse': 3.0}}}}}},
        'thresholds': {'strain': {'analytical': thresholds_to_dict(thresholds)}}}
    save_bundle(ModelBundle(arm, PreprocessingSpec(measured_velocity=True),
                            {'strain': {'analytical': model}}, facts), out)
    return out


def moving(seconds: float, before: float = 0.0, put_down: float = inf) -> Recording:
    """Move the arm, which carries a load before, picks up LOAD in its place, and puts it down."""
    arm = two_gauge_arm()
    t = np.arange(0.0, seconds, 1.0 / RATE)
    moved = multisine(t, 2, 3)
    empty, full = (true_outputs(arm, moved, m)['strain'] for m in (before, LOAD))
    noise = np.random.default_rng(0).standard_normal(empty.shape)
    strain = np.where(((t < PICKED_UP) | (t >= put_down))[:, None], empty, full) + noise
    return recording_of(moved[:, :2], RATE, dq=moved[:, 2:4], strain=strain)
