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

"""From an arm to the plan of a recording: the motion, what it keeps to, what it will show."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tudor_dynamics.arm import Arm, PreprocessingSpec
from tudor_dynamics.arm.schema import FRICTION_KEYS
from tudor_dynamics.arm.self_collision import SelfCollision
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import UsageError
from tudor_dynamics.excitation.bounds import Beyond, Bounds, known_efforts
from tudor_dynamics.excitation.expected import (
    expected_errors, ExpectedError, Noise, OUTPUTS)
from tudor_dynamics.excitation.information import Information, Subject
from tudor_dynamics.excitation.search import best_aprbs, best_series, Order
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.regressor import plain_regressor
from tudor_dynamics.signals.excitation import joint_range
from tudor_dynamics.signals.motion_profile import motion_limits, Reference
from tudor_dynamics.simulation.plant.modes import modes
from tudor_dynamics.typing import FloatArray

KINDS = ('fourier', 'aprbs')
HIGHEST = 2.0
"""Largest frequency of a series where links do not bend [Hz]."""


@dataclass(frozen=True, eq=False)
class Target:
    """What is to be identified, behind which filters, in which noise."""

    arm: Arm  # arm with the friction that is identified
    models: dict[str, AnalyticalModel]  # for each output the model that a fit would fit
    preprocessing: PreprocessingSpec  # filters and rate of that fit
    noise: Noise  # noise of the outputs
    parameters: FloatArray | None = None  # what is known of the efforts, (joints, columns)


@dataclass(frozen=True, eq=False)
class Plan:
    """A motion to record."""

    trajectory: Trajectory  # motion of the active joints, at the rate of the messages
    expected: list[ExpectedError]  # what it will show
    beyond: Beyond  # how far it goes to the limits
    noise: Noise  # noise that the standard errors are for


def target_of_arm(arm: Arm, noise: dict[str, FloatArray]) -> Target:
    """Say what a fit of an arm would identify."""
    spec = arm.spec.preprocessing
    if 'filter' not in spec.model_fields_set:
        spec = spec.model_copy(update={'filter': 'zero_phase'})
    outputs = OUTPUTS if arm.gauges else OUTPUTS[:1]
    return Target(arm, {output: _planned(arm, output) for output in outputs}, spec, Noise(noise))


def _planned(arm: Arm, output: str) -> AnalyticalModel:
    """Give the model that a motion is planned for: any reversal shows where friction gives way."""
    sliding = arm.with_joints({joint.name: {'friction': tuple(
        term for term in joint.friction if term != 'presliding')} for joint in arm.joints})
    return AnalyticalModel(plain_regressor(sliding, output, 'exact'), len(arm.active_joints))


def target_of_model(bundle: ModelBundle, arm: Arm) -> Target:
    """Say what a fit like an earlier one would identify, in the noise that it left."""
    found, noise = {}, {}
    known: FloatArray | None = None
    for output, kinds in bundle.models.items():
        model = kinds.get('analytical')
        if isinstance(model, AnalyticalModel) and model.payload_range is None:
            if output == 'effort':
                known = model.coefficients()
            found[output] = model if model.bristles is None else _planned(bundle.arm, output)
            noise[output] = np.zeros(len(model.channels))
            for group in model.groups_:
                noise[output][list(group.base.channels)] = np.sqrt(group.estimate.variances)
    if not found:
        raise UsageError('there is no analytical model for one payload in the bundle',
                         remedy='give --noise in place of --model')
    friction = {joint.name: {key: getattr(joint, key) for key in FRICTION_KEYS}
                for joint in bundle.arm.spec.joints}
    return Target(arm.with_joints(friction), found, bundle.preprocessing,
                  Noise(noise, residual=True), known)


def default_highest(arm: Arm) -> float:
    """Choose the largest frequency of a series: below what makes links swing [Hz]."""
    if any(link.flexible is not None for link in arm.spec.links):
        return min(HIGHEST, float(modes(arm, 1).frequency[0]) / 3.0)
    return HIGHEST


def bounds_of(target: Target, links: SelfCollision | None = None) -> Bounds:
    """Collect what motions of an arm keep to."""
    return Bounds(joint_range(target.arm), motion_limits(target.arm),
                  known_efforts(target.arm, target.parameters), links)


def information_of(target: Target) -> Information:
    """Give what judges motions by what they show."""
    return Information([Subject(model, target.noise.size[output])
                        for output, model in target.models.items()])


def make_plan(
    target: Target, order: Order, *, kind: str = 'fourier', links: SelfCollision | None = None,
    report: Callable[[float], bool] = lambda _: False,
) -> Plan:
    """Search for the motion that shows best what is to be identified."""
    bounds, information = bounds_of(target, links), information_of(target)
    search = best_series if kind == 'fourier' else best_aprbs
    reference = search(information, bounds, order, report)
    return plan_of(target, reference, bounds)


def plan_of(target: Target, reference: Reference, bounds: Bounds) -> Plan:
    """Say what a motion will show, and how far it goes."""
    trajectory = Trajectory(
        target.arm.active_joints, np.asarray(np.arange(len(reference.q)) * reference.dt),
        reference.q, reference.dq, reference.ddq)
    return Plan(trajectory, expected_errors(
        target.models, target.arm, trajectory, target.preprocessing, target.noise),
        bounds.beyond(reference.motion), target.noise)
