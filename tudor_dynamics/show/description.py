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

"""Write identified values into an arm description, or as tables."""

from __future__ import annotations

from collections.abc import Callable
import csv
from dataclasses import dataclass
from functools import partial
import io
import math
from typing import Any

import numpy as np
from pydantic import ValidationError

from tudor_dynamics._version import __version__
from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import (
    ArmSpec, InertiaPart, MotorSpec, SensorSpec, STATE_KEYS, validation_message)
from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.bundle import elastic_of, ModelBundle
from tudor_dynamics.models.comparison import described_bodies, FullParameters
from tudor_dynamics.models.elastic.model import driven_arm, ElasticModel
from tudor_dynamics.models.elastic.parameters import in_words, physical_unit
from tudor_dynamics.models.friction import DAMPING, FRICTION
from tudor_dynamics.models.regressor import column_unit
from tudor_dynamics.show.urdf import both_ways, Simple, simple_friction, simple_frictions
import yaml


# -- What an elastic model says of the drives of an arm: torque constants, rotors, friction

SPEED = 1.0  # up to which friction counts, where a description has no limit [rad/s or m/s]


@dataclass(frozen=True)
class ElasticDrive:
    """Drive of one joint."""

    constant: float  # torque at the joint per unit of the measured effort
    # Rotor inertia `Ia` and friction as the joint feels them, by the names of their terms
    # [kg m^2, N m s/rad, N m; for prismatic joints kg, N s/m, N].
    terms: dict[str, float]


def elastic_drives(bundle: ModelBundle) -> dict[str, ElasticDrive]:
    """Read the drives out of the elastic model of efforts; empty where there is none."""
    model = elastic_of(bundle, 'effort')
    if model is None or model.coefficients_ is None:
        return {}
    found = {}
    for joint, columns, values in zip(
            model.channels, model.columns, model.coefficients_, strict=True):
        by_torque = float(values[0])
        if by_torque <= 0.0:
            raise ModelError(
                f'in the elastic model of {bundle.arm.name!r}, effort of {joint!r} falls as gear '
                f'torque rises (slope {by_torque:.3g}), so the drive cannot be described',
                remedy='fit again with bags in which this joint carries a larger load')
        found[joint] = ElasticDrive(1.0 / by_torque, {
            column.partition('(')[0]: float(value) / by_torque
            for column, value in zip(columns[1:], values[1:], strict=True)})
    return found


def elastic_friction(arm: Arm, joint: str, terms: dict[str, float]) -> Simple:
    """Bring the friction of a joint to two numbers."""
    spec = arm.joints[arm.active_joints.index(joint)]
    limit = None if spec.limits is None else spec.limits.velocity
    return simple_friction(spec, terms, limit or SPEED)


# -- Write an arm description with the values that an elastic model has found.
#
# What the elastic model knows and a description has no key for is not guessed into another one: it
# is left out, and named.

KEYS = {'joints': 'name', 'links': 'joint', 'motors': 'joint', 'sensors': 'gauge'}
"""What the entries of the lists of a description go by."""
LIKE = 1e-3
"""Part by which damping inside the play may differ from that of the teeth and be left unsaid."""


def description_of(bundle: ModelBundle, urdf: str = 'arm.urdf') -> tuple[str, tuple[str, ...]]:
    """Describe an arm as its elastic model has found it, as YAML; name what has no place there."""
    model = elastic_of(bundle, 'strain') or elastic_of(bundle, 'effort')
    if model is None:
        raise ModelError('an arm description needs an elastic model, and the bundle has none',
                         remedy='fit one with tudor fit --models analytical elastic')
    writer = _Writer(model)
    writer.physical()
    for joint, drive in elastic_drives(bundle).items():
        writer.drive(joint, drive)
    strain = elastic_of(bundle, 'strain')
    if strain is not None:
        writer.sensors(strain)
    try:
        spec = ArmSpec.model_validate(writer.content)
    except ValidationError as err:
        raise ModelError(f'the identified values are not valid: {validation_message(err)}',
                         remedy='fit again with more motion') from None
    content = spec.model_dump(mode='json', exclude_defaults=True)
    if bundle.arm.urdf is not None:
        content['kinematics'] = {'urdf': urdf}
    head = [f'# {bundle.arm.name} as its elastic model found it, by tudor_dynamics '
            f'{__version__}.', '# Identified, with standard errors; the rest stands as it was '
            'described:', *writer.said]
    head += [f'# Not in here: {what}.' for what in writer.left_out]
    text = '\n'.join(head) + '\n' + yaml.safe_dump(content, sort_keys=False,
                                                   default_flow_style=None, width=99)
    return text, tuple(writer.left_out)


class _Writer:
    """A description as plain values, while identified ones are written into it."""

    def __init__(self, model: ElasticModel) -> None:
        self.model, self.arm = model, model.arm
        self.described = driven_arm(model.arm, {}).parameters
        self.content: dict[str, Any] = model.arm.spec.model_dump(mode='json', exclude_unset=True)
        self.said: list[str] = []
        self.left_out: list[str] = []

    def _found(self, section: str, name: str) -> dict[str, Any] | None:
        return next((entry for entry in self.content.get(section, ())
                     if entry[KEYS[section]] == name), None)

    def _entry(self, section: str, name: str) -> dict[str, Any]:
        """Give an entry of a list; a new one where there is none."""
        entry = self._found(section, name)
        if entry is None:
            entry = {KEYS[section]: name}
            self.content.setdefault(section, []).append(entry)
        return entry

    def physical(self) -> None:
        """Write the physical parameters."""
        writers: dict[str, Callable[[str, float], None]] = {
            'bending': self._bending, 'density': self._density,
            'lumped': lambda owner, mass: _weigh(self._part(owner), mass),
            'gyration': self._gyration, 'payload': self._payload, 'play': self._play,
            'gear': partial(self._gear, 'stiffness'), 'tight': partial(self._gear, 'damping'),
            'alpha': partial(self._rayleigh, 'alpha'), 'beta': partial(self._rayleigh, 'beta')}
        values = {**self.described, **self.model.values}
        for parameter in self.model.physical:
            kind, _, owner = parameter.name.rstrip(')').partition('(')
            unit = physical_unit(self.arm, parameter.name)
            error = ('' if math.isnan(parameter.standard_error)
                     else f' +- {parameter.standard_error:.2g}')
            line = f'{in_words(parameter.name)}: {parameter.value:.5g}{error} {unit}'
            if kind in writers:
                self.said.append(f'#   {line}')
                writers[kind](owner, parameter.value)
            elif kind == 'loose':
                tight = values[f'tight({owner})']
                if abs(parameter.value - tight) > LIKE * tight and values[f'play({owner})'] > 0.0:
                    self.left_out.append(line)
            elif parameter.value > 0.0 and (kind != 'edge' or values[f'play({owner})'] > 0.0):
                self.left_out.append(line)

    def _beam(self, joint: str) -> dict[str, Any]:
        return self._entry('links', joint)['flexible']

    def _bending(self, joint: str, value: float) -> None:
        material = self._beam(joint)['material']
        for key in ('E', 'G'):
            if material.get(key) is not None:
                material[key] *= value / self.described[f'bending({joint})']

    def _density(self, joint: str, value: float) -> None:
        self._beam(joint)['material']['rho'] *= value / self.described[f'density({joint})']

    def _part(self, owner: str) -> dict[str, Any]:
        joint, _, number = owner.partition(',')
        parts = [part for part in self._beam(joint)['lumped'] if part['mass'] > 0.0]
        return parts[int(number) - 1]

    def _gyration(self, owner: str, value: float) -> None:
        part, radius = self._part(owner), self.described[f'gyration({owner})']
        part['inertia'] = ([(value / radius)**2 * item for item in part['inertia']] if radius
                           and isinstance(part['inertia'], list) else part['mass'] * value**2)

    def _payload(self, _: str, value: float) -> None:
        self.content['payload'] = self.content.get('payload') or {'mass': 0.0}
        _weigh(self.content['payload'], value)

    def _gear(self, key: str, joint: str, value: float) -> None:
        motor = self._found('motors', joint)
        if motor is None:
            self._entry('links', joint)[f'joint_{key}'] = value
        else:
            motor[key] = value

    def _play(self, joint: str, value: float) -> None:
        motor = self._found('motors', joint)
        if motor is not None:
            motor['backlash'] = 2.0 * value
        elif value > 0.0:
            self.left_out.append(f'backlash of {joint}, {2.0 * value:.4g} rad, without a motor')

    def _rayleigh(self, key: str, _: str, value: float) -> None:
        self.content.setdefault('simulation', {}).setdefault('rayleigh', {})[key] = value

    def drive(self, joint: str, drive: ElasticDrive) -> None:
        """Write rotor, friction and torque constant of a joint, and say what has no place."""
        terms, motor = drive.terms, self._found('motors', joint)
        ways = {name: both_ways(terms, name) for name in (DAMPING, FRICTION)}
        used = {'Ia', DAMPING, f'{DAMPING}+', f'{DAMPING}-'}
        rotor = max(terms.get('Ia', 0.0), 0.0)
        viscous = [max(value, 0.0) for value in ways[DAMPING]]
        if motor is None:
            self._entry('links', joint).update(hub_inertia=rotor,
                                               viscous_friction=sum(viscous) / 2.0)
        else:
            used |= {FRICTION, f'{FRICTION}+', f'{FRICTION}-'}
            unit = self._found('joints', joint)
            if unit is not None and unit.get('effort', {}).get('unit') == 'A':
                motor['torque_constant'] = drive.constant / (
                    motor['gear_ratio'] * motor.get('efficiency', 1.0))
            # the effort model has it in its torque constant and friction
            motor.pop('load_friction', None)
            by_ampere = MotorSpec.model_validate(motor).joint_torque_constant
            motor['rotor_inertia'] = rotor / motor['gear_ratio']**2
            motor['viscous'] = [value / by_ampere for value in viscous]
            motor['coulomb'] = [max(value, 0.0) / by_ampere for value in ways[FRICTION]]
        negative = [name for name, value in (('Ia', terms.get('Ia', 0.0)), *(
            (name, min(ways[name])) for name in ways)) if value < 0.0]
        self.left_out += [f'{name} of {joint}, which is below zero' for name in negative]
        self.left_out += [f'{name} of {joint}, {value:.3g} in N, m and s'
                          for name, value in terms.items() if name not in used and value]

    def sensors(self, strain: ElasticModel) -> None:
        """Write gain and offset of each gauge."""
        assert strain.coefficients_ is not None
        for gauge, (gain, offset) in zip(strain.channels, strain.coefficients_, strict=True):
            sensor = self._entry('sensors', gauge)
            sensor.update(gain=float(gain), offset=float(offset))
            SensorSpec.model_validate(sensor)


def _weigh(part: dict[str, Any], mass: float) -> None:
    """Set the mass of a part, its inertia in proportion."""
    before, inertia = part['mass'], part.get('inertia', 0.0)
    if before > 0.0 and inertia:
        part['inertia'] = ([value * mass / before for value in inertia]
                           if isinstance(inertia, list) else inertia * mass / before)
    part['mass'] = mass
    InertiaPart.model_validate(part)


# -- Write identified parameters as tables: for controllers, and for people

DIGITS = 6  # significant digits of what is for people


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
            **{key: list(getattr(spec, key)) for key in STATE_KEYS.values()}}
    feed = {name: {'ff_velocity_scale': simple.damping} for name, simple in frictions.items()}
    head = (f'# Drives of {full.arm.name}, as identified by tudor_dynamics {__version__}.\n'
            '# viscous_friction [N m s/rad] and coulomb_friction [N m] are what URDF and MJCF\n'
            '# know; friction_terms are all of it, formulas in docs/explanation/models.md.\n'
            '# joint_trajectory_controller multiplies the wanted speed by ff_velocity_scale,\n'
            '# where it commands efforts; Coulomb friction has to come with the trajectory.\n')
    if full.assumed:
        head += ('# Torque constants are not known: all torques and masses are scaled so that\n'
                 '# bodies weigh about what the description says of them.\n')
    if loose := full.loose_constants():
        head += f'# Torque constants that the data do not fix: {loose}\n'
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
    described = np.concatenate(list(described_bodies(full.arm).values()))
    channels = full.model.channels
    for i, (name, value, error, source) in enumerate(zip(
            full.columns, values.tolist(), errors.tolist(), full.sources(), strict=True)):
        unit = column_unit(full.arm, 'effort', channels, name).split(' (')[0]
        before = f'{described[i]:.{DIGITS}g}' if i < len(described) else ''
        writer.writerow([name, f'{value:.{DIGITS}g}', f'{error:.2g}', unit, source, before])
    return text.getvalue()
