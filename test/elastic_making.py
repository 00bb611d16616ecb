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

"""Elastic arms whose truth is known, motions for them, and what their gauges say."""

from __future__ import annotations

from typing import Any

import numpy as np
from sample_arms import gauge, planar_arm, recording_of

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.elastic.arm import DrivenArm, Response
from tudor_dynamics.models.elastic.model import driven_arm, ElasticModel, PhysicalParameter
from tudor_dynamics.models.elastic.parameters import physical_unit
from tudor_dynamics.typing import FloatArray

STIFFNESS, DAMPING, BACKLASH = {'j1': 220.0, 'j2': 160.0}, 0.2, 0.01
"""Of the gears [N m/rad, N m s/rad, rad]."""
GAINS = np.array([70.0, 90.0])
"""Of the gauges of ``recorded`` [um/m per N m]."""
OFFSETS = np.array([12.0, -7.0])
"""[um/m]"""


def blade(**more: Any) -> dict[str, Any]:
    """Describe a steel blade of 4 mm x 15 mm as a flexible link."""
    return {'section': {'shape': 'rectangle', 'height': 0.004, 'width': 0.015},
            'material': {'E': 2.06e11, 'nu': 0.29, 'rho': 7850}, 'elements': 1,
            'stretch': False, **more}


def blade_arm(*, backlash: float = BACKLASH, **more: Any) -> Arm:
    """Describe two blades in a vertical plane, an elbow mass between them, one at the tip."""
    return planar_arm(**{
        'gauges': [gauge('g1', 'j1', 0.05), gauge('g2', 'j2', 0.05)],
        'links': [{'joint': 'j1', 'flexible': blade(lumped=[{'mass': 0.8}])},
                  {'joint': 'j2', 'flexible': blade()}],
        'motors': [{'joint': name, 'gear_ratio': 200, 'torque_constant': 0.05,
                    'stiffness': stiffness, 'damping': DAMPING, 'backlash': backlash}
                   for name, stiffness in STIFFNESS.items()],
        'payload': {'mass': 0.2}, 'simulation': {'rayleigh': {'beta': 5e-4}}, **more})


def lone_arm(**more: Any) -> Arm:
    """Describe one blade with two masses, driven through a gear: few parameters to be found."""
    return planar_arm(**{
        'joints': [{'name': 'j1'}, {'name': 'j2', 'hold': 0.0}], 'active_joints': ['j1'],
        'gauges': [gauge('g1', 'j1', 0.05)],
        'links': [{'joint': 'j1', 'flexible': blade(lumped=[{'mass': 0.8}])},
                  {'joint': 'j2', 'rigid': {'mass': 0.0}}],
        'motors': [{'joint': 'j1', 'gear_ratio': 200, 'torque_constant': 0.05,
                    'stiffness': STIFFNESS['j1'], 'damping': DAMPING, 'backlash': BACKLASH}],
        'payload': {'mass': 0.2}, 'simulation': {'rayleigh': {'beta': 5e-4}}, **more})


LONE_TRUTH = {'bending(j1)': 15.0, 'gear(j1)': 190.0, 'play(j1)': 0.004, 'beta': 8e-4}
"""What the blade of ``lone_recording`` really is, where it differs from the description."""
LONE_EFFORT = {'torque': 0.2, 'Ia(j1)': 0.1, 'offset': 0.3}
"""What its motor needs by gear torque and acceleration, and an offset [A, SI]."""


def lone_recording(
    seed: int, seconds: float = 12.0, rate: float = 100.0, payload: float = 0.2,
) -> Recording:
    """Record the blade: strain with noise of 2 um/m, current with noise of 5 mA."""
    driven = DrivenArm(lone_arm())
    driven.set_parameters({**LONE_TRUTH, 'payload': payload})
    q = travel(seconds, rate, seed)[:, :1]
    response = driven.follow(q, even(len(q), rate))
    ddq = np.gradient(np.gradient(q, 1.0 / rate, axis=0), 1.0 / rate, axis=0)
    random = np.random.default_rng(seed)
    effort = (LONE_EFFORT['torque'] * response.torque + LONE_EFFORT['Ia(j1)'] * ddq
              + LONE_EFFORT['offset'] + random.normal(0.0, 5e-3, q.shape))
    strain = response.moment * GAINS[0] + OFFSETS[0] + random.normal(0.0, 2.0, q.shape)
    return recording_of(q, rate, strain=strain, effort=effort, path=f'runs/{seed}')


def stepwise(t: FloatArray, targets: FloatArray, ramp: float = 1.0) -> FloatArray:
    """Go from target to target, evenly over the time, each by a minimum-jerk ramp [s]."""
    hold = t[-1] / (len(targets) - 1)
    q = np.tile(targets[0], (len(t), 1))
    for k, (last, now) in enumerate(zip(targets[:-1], targets[1:], strict=True)):
        s = np.clip((t - (k + 0.3) * hold) / ramp, 0.0, 1.0)
        q += (s**3 * (10.0 - s * (15.0 - 6.0 * s)))[:, None] * (now - last)
    return q


def travel(seconds: float, rate: float, seed: int = 0, hold: float = 2.5) -> FloatArray:
    """Move both joints over their workspace, shoulder from level to beyond upright [rad]."""
    n = round(seconds * rate) + 1
    t = np.arange(n) / rate
    targets = np.random.default_rng(seed).uniform(
        [0.2, -1.2], [2.9, 1.2], (max(2, round(seconds / hold) + 1), 2))
    return stepwise(t, targets)


def even(n: int, rate: float) -> FloatArray:
    """Give even times between samples, the first 0, which begins again [s]."""
    dt = np.full(n, 1.0 / rate)
    dt[0] = 0.0
    return dt


def recorded(
    arm: Arm, values: dict[str, float], q: FloatArray, rate: float, noise: float = 2.0,
    seed: int = 0,
) -> tuple[FloatArray, Response]:
    """Give strain with noise [um/m], and the moments and torques that cause it."""
    driven = DrivenArm(arm)
    driven.set_parameters(values)
    response = driven.follow(q, even(len(q), rate))
    random = np.random.default_rng(seed).normal(0.0, noise, response.moment.shape)
    return response.moment * GAINS + OFFSETS + random, response


def along(
    model: ElasticModel, motion: FloatArray, dt: FloatArray, before: FloatArray | None = None,
) -> FloatArray:
    """Predict along a motion from rest, or after one before."""
    driven, dt = driven_arm(model.arm, model.values), dt.copy()
    if not driven.begin(before):
        dt[0] = 0.0
    return model.prepared()(driven.follow(motion[:, :len(model.arm.joints)], dt), motion)


def pushed(
    arm: Arm, q: FloatArray, rate: float, force: FloatArray,
    values: dict[str, float] | None = None,
) -> FloatArray:
    """Give the moments at the gauges of an arm with a force at its tip, (samples, 3) [N m]."""
    truth = DrivenArm(arm)
    truth.set_parameters(values or {})
    dt = even(len(q), rate)
    found = []
    for k in range(len(q)):
        truth.tables.chain.wrench[truth.mechanism.tip, :3] = force[k]
        truth.loaded = bool(np.any(force[k]))
        found.append(truth.follow(q[k:k + 1], dt[k:k + 1]).moment[0])
    return np.array(found)


def identified(
    arm: Arm, values: dict[str, float], effort: dict[str, dict[str, float]] | None = None,
) -> ModelBundle:
    """
    Make the bundle of an elastic arm that was identified.

    ``effort`` has the coefficients of each joint by the names of their terms; without, strain
    alone was recorded.
    """
    physical = tuple(PhysicalParameter(name, value, physical_unit(arm, name), 0.01 * value, True)
                     for name, value in values.items())
    strain = ElasticModel(arm, 'strain', physical)
    strain.coefficients_ = tuple(np.column_stack([GAINS, OFFSETS])[:len(strain.channels)])
    models = {'strain': strain}
    if effort is not None:
        models['effort'] = ElasticModel(arm, 'effort', physical)
        models['effort'].coefficients_ = tuple(
            np.array([effort[joint][name.partition('(')[0]] for name in columns])
            for joint, columns in zip(arm.active_joints, models['effort'].columns, strict=True))
    for model in models.values():
        assert model.coefficients_ is not None
        model.standard_errors_ = tuple(np.full(len(c), 0.01) for c in model.coefficients_)
        model.noise_ = np.ones(len(model.channels))
    return ModelBundle(arm, PreprocessingSpec(), {
        output: {'elastic': model} for output, model in models.items()})
