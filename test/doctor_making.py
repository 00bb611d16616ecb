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

"""Recordings of a known arm for the doctor: healthy ones, and faults to put into them."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from sample_arms import gauge, LENGTH_2, multisine, planar_arm, random_inertia, recording_of

from tudor_dynamics.arm.description import Arm, arm_from_dict
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification.dataset import BagChoice, BagData
from tudor_dynamics.models.regressor import EffortRegressor
from tudor_dynamics.typing import FloatArray

RATE = 100.0
SECONDS = 24.0


@lru_cache
def described(unit: str = 'N m', gravity: tuple[float, float, float] = (0.0, -9.81, 0.0)) -> Arm:
    """Give two links in a vertical plane with efforts, and a gauge on each link."""
    joints = [{'name': name, 'friction': ['viscous', 'coulomb'], 'rotor_inertia': True,
               'effort': {'topic': 'joint_states', 'unit': unit}} for name in ('j1', 'j2')]
    gauges = [gauge('g1', 'j1', 0.05), gauge('g2', 'j2', 0.05)]
    return altered(planar_arm(joints, gauges), gravity=list(gravity))


def altered(arm: Arm, **changes: Any) -> Arm:
    """Give an arm with other keys in its description."""
    content = arm.spec.model_dump(mode='json') | changes
    return arm_from_dict(content, base=Path('.'), source=arm.source)


@lru_cache(maxsize=64)
def healthy(
    *, seed: int = 0, seconds: float = SECONDS, noise: float = 1.0, payload: float = 0.0,
    velocity: bool = False, path: str = 'run',
) -> Recording:
    """Give what the arm shows that `described` describes, with noise of its sensors."""
    arm = described()
    motion = multisine(np.arange(round(seconds * RATE)) / RATE, 2, seed)
    random = np.random.default_rng(seed)
    n = len(motion)
    drives = [0.02, 0.3, 0.2, 0.01, 0.1, 0.05]  # rotor inertia, viscous, Coulomb
    model = _true_model(payload)
    state = np.zeros((3, n, model.nv))
    places = [model.joints[model.getJointId(name)].idx_v
              for name in (*arm.active_joints, *arm.gauge_names)]
    state[:, :, places[:2]] = np.split(motion, 3, axis=1)
    data = model.createData()
    moments = np.array([pin.rnea(model, data, *x) for x in zip(*state, strict=True)])[:, places]
    effort = moments[:, :2] + EffortRegressor(arm).rows(motion)[:, :, -6:] @ drives
    strain = moments[:, 2:] * [100.0, 80.0] + [3.0, -2.0]
    return recording_of(
        motion[:, :2], RATE, path=path,
        dq=motion[:, 2:4] + random.normal(0.0, 1e-3 * noise, (n, 2)) if velocity else None,
        effort=effort + random.normal(0.0, 0.02 * noise, (n, 2)),
        strain=strain + random.normal(0.0, noise, (n, 2)))


@lru_cache
def _true_model(payload: float) -> pin.Model:
    """Put all of a link, and the payload, after its gauge."""
    arm, random = described(), np.random.default_rng(5)
    model = pin.Model(arm.gauge_model)
    for joint, name in zip(arm.active_joints, arm.gauge_names, strict=True):
        link, place = random_inertia(random), model.getJointId(name)
        if joint == 'j2':
            link += pin.Inertia(payload, np.array([LENGTH_2, 0.0, 0.0]), np.zeros((3, 3)))
        model.inertias[model.getJointId(joint)] = pin.Inertia.Zero()
        model.inertias[place] = model.jointPlacements[place].actInv(link)
    return model


def bag(recording: Recording, name: str, payload: float | None = None) -> BagData:
    """Give a recording as a bag of a fit."""
    return BagData(BagChoice(name), replace(recording, path=name), (), payload)


def column(values: FloatArray | None, i: int, changed: Any) -> FloatArray:
    """Change one column by a function of its values."""
    assert values is not None
    result = values.copy()
    result[:, i] = changed(values[:, i])
    return result


def late(values: FloatArray | None, t: FloatArray, seconds: float) -> FloatArray:
    """Delay all columns."""
    assert values is not None
    return np.stack([np.interp(t - seconds, t, x) for x in values.T], axis=1)
