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

"""Write identified parameters as tables: for controllers, and for people."""

from __future__ import annotations

import csv
import io
from typing import Any

import numpy as np
import pinocchio as pin
from tudor_dynamics._version import __version__
from tudor_dynamics.exporting.friction import simple_frictions
from tudor_dynamics.models.consistent.full import FullParameters
from tudor_dynamics.models.units import column_unit
import yaml

DIGITS = 6
"""Significant digits of what is for people."""


def yaml_of(full: FullParameters) -> str:
    """Give what a controller needs, joint by joint, as a ROS parameter file does."""
    joints: dict[str, Any] = {}
    constants, frictions = full.torque_constants, simple_frictions(full)
    for spec in full.arm.joints:
        terms = full.drives[spec.name]
        simple = frictions[spec.name]
        friction = {name: value for name, value in terms.items() if name != 'Ia'}
        joints[spec.name] = {
            'effort_unit': spec.effort.unit,
            'torque_constant': constants[spec.name],
            'rotor_inertia': terms.get('Ia', 0.0),
            'viscous_friction': simple.damping, 'coulomb_friction': simple.friction,
            'friction_terms': friction, 'friction_velocity': spec.friction_velocity,
            'stribeck_velocity': spec.stribeck_velocity,
            'presliding_distances': list(spec.presliding_distances)}
    feed = {name: {'ff_velocity_scale': simple.damping} for name, simple in frictions.items()}
    head = (f'# Drives of {full.arm.name}, as identified by tudor_dynamics {__version__}.\n'
            '# viscous_friction [N m s/rad] and coulomb_friction [N m] are what URDF and MJCF\n'
            '# know; friction_terms are all of it, see docs/theory.md for their formulas.\n'
            '# joint_trajectory_controller multiplies the wanted speed by ff_velocity_scale,\n'
            '# where it commands efforts; Coulomb friction has to come with the trajectory.\n')
    if full.assumed:
        head += ('# Torque constants are not known: all torques and masses are scaled so that\n'
                 '# bodies weigh about what the description says of them.\n')
    content = {'tudor_dynamics_drives': {'ros__parameters': {
        'joints': list(full.arm.active_joints), **joints}},
        'joint_trajectory_controller': {'ros__parameters': {'gains': feed}}}
    return head + yaml.safe_dump(content, sort_keys=False)


def csv_of(full: FullParameters) -> str:
    """Give every parameter with standard error, unit and source."""
    solution = full.solution
    values = np.concatenate([solution.bodies.ravel(), solution.drives])
    errors = np.concatenate([solution.body_errors.ravel(), solution.drive_errors])
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow(['parameter', 'value', 'standard_error', 'unit', 'source', 'described'])
    described = np.concatenate([
        np.asarray(pin.Inertia(inertia).toDynamicParameters())
        for inertia in list(full.arm.model.inertias)[1:]])
    channels = full.model.channels
    for i, (name, value, error, source) in enumerate(zip(
            full.columns, values.tolist(), errors.tolist(), full.sources(), strict=True)):
        unit = column_unit(full.arm, 'effort', channels, name).split(' (')[0]
        before = f'{described[i]:.{DIGITS}g}' if i < len(described) else ''
        writer.writerow([name, f'{value:.{DIGITS}g}', f'{error:.2g}', unit, source, before])
    return text.getvalue()
