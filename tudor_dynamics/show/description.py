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

"""Write what was identified into the user's URDF, into an arm description, or as tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import csv
from dataclasses import dataclass, field
from functools import partial
import io
import math
from pathlib import Path
import re
from typing import Any
from xml.etree import ElementTree
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import jinja2
import numpy as np
import pinocchio as pin
from pydantic import ValidationError
from scipy import optimize

from tudor_dynamics._version import __version__
from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.kinematics import base_frame, joint_axis
from tudor_dynamics.arm.schema import (
    ArmSpec, FRICTION_TERMS, InertiaPart, JointSpec, MotorSpec, SensorSpec, STATE_KEYS,
    validation_message)
from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.bundle import elastic_of, ModelBundle
from tudor_dynamics.models.comparison import described_bodies, FullParameters
from tudor_dynamics.models.consistent import pseudo_inertia
from tudor_dynamics.models.elastic.model import driven_arm, ElasticModel
from tudor_dynamics.models.elastic.parameters import in_words, physical_unit
from tudor_dynamics.models.friction import (
    DAMPING, FRICTION, friction_columns, friction_names, term_of, TERMS)
from tudor_dynamics.models.regressor import column_unit
from tudor_dynamics.online.monitor import FIELD, METHODS, SOURCE
from tudor_dynamics.typing import FloatArray
import yaml


# -- Numbers as URDF and MJCF have them

def row(values: FloatArray) -> str:
    """Write numbers one after the other, with all their digits: values (n,)."""
    return ' '.join(repr(float(value)) for value in np.asarray(values).tolist())


# -- Friction as most programs know it: damping, and a torque against the motion

SPEEDS = 20  # evenly over those of a joint, at which friction is compared, in each direction
CLOSE = 0.01  # part of friction by which two numbers may miss it without a word


@dataclass(frozen=True)
class Simple:
    """Friction as most programs know it."""

    damping: float  # torque for each unit of speed, both ways [N m s/rad or N s/m]
    friction: float  # torque against the motion at any speed, likewise [N m or N]
    left_out: tuple[str, ...]  # what the two do not express, one phrase each


def simple_friction(
    joint: JointSpec, terms: dict[str, float], speed: float, load: float = 0.0,
) -> Simple:
    """Bring friction to the two numbers of URDF and MJCF that are nearest to it, both ways."""
    forward = np.linspace(0.0, speed, SPEEDS + 1)[1:]
    speeds = np.concatenate([-forward, forward])
    names = [name.partition('(')[0] for name in friction_names(joint)]
    own = np.array([0.0 if TERMS[term_of(name)].constant else terms.get(name, 0.0)
                    for name in names])
    wanted = friction_columns(joint, speeds, np.full(len(speeds), load)) @ own
    pair = joint.model_copy(update={'friction': (DAMPING, FRICTION), 'asymmetric': False})
    columns = friction_columns(pair, speeds)
    (damping, friction), _ = optimize.nnls(columns, wanted)  # both take energy
    size = float(np.linalg.norm(wanted))
    missed = float(np.linalg.norm(columns @ (damping, friction) - wanted))
    return Simple(float(damping), float(friction), (
        *(TERMS[name].exported for name in FRICTION_TERMS if terms.get(name)
          and TERMS[name].exported),
        *((f'{missed / size:.0%} of the rest',) if missed > CLOSE * size else ())))


def simple_frictions(full: FullParameters) -> dict[str, Simple]:
    """Bring the friction of all joints to two numbers, see `simple_friction`."""
    solution, drives = full.solution, full.drives
    return {joint.name: simple_friction(joint, drives[joint.name], speed, load)
            for joint, speed, load in zip(full.arm.joints, solution.speeds.tolist(),
                                          solution.loads.tolist(), strict=True)}


def both_ways(terms: dict[str, float], term: str) -> tuple[float, float]:
    """Give a coefficient of friction for each direction, positive where it takes energy."""
    if f'{term}+' not in terms:
        return terms.get(term, 0.0), terms.get(term, 0.0)
    return terms[f'{term}+'], terms[f'{term}-'] * TERMS[term].backward_sign


# -- From bodies that move as one to the links of a URDF.
#
# Links that fixed or held joints connect move as one body, of which data show the sum alone. The
# sum is reached by moving and scaling their mass as little as possible: one linear map of all of
# it, the same for each link (the optimal transport between two distributions of mass). So links
# keep their proportions, and each remains a body that can exist.

LEAST = 1e-12
"""Of the largest value of a pseudo-inertia, below which it is that of a point, line or plate."""


def link_inertias(arm: Arm, bodies: Mapping[str, FloatArray]) -> dict[str, pin.Inertia]:
    """Share bodies out among the links of the arm's URDF: bodies (10,)."""
    assert arm.urdf is not None
    described = {}  # of each link, in its own frame, as Pinocchio reads it
    for link in ElementTree.fromstring(arm.urdf).iter('link'):
        alone = ElementTree.Element('robot', name='one')
        ElementTree.SubElement(alone, 'link', name='one').extend(link.findall('inertial'))
        text = ElementTree.tostring(alone, encoding='unicode')
        described[str(link.get('name'))] = pin.buildModelFromXML(text).inertias[0]
    model = arm.model
    found: dict[str, pin.Inertia] = {}
    for joint, parameters in bodies.items():
        index = model.getJointId(joint)
        frames = [frame for frame in model.frames
                  if frame.type == pin.FrameType.BODY and frame.parentJoint == index]
        old = [pseudo_inertia(np.asarray(frame.placement.act(
            described[frame.name]).toDynamicParameters())) for frame in frames]
        new = pseudo_inertia(parameters)
        total = np.sum(old, axis=0)
        total = total + LEAST * np.trace(new) * np.eye(4)
        root = _root(total)
        inverse = np.linalg.inv(root)
        way = inverse @ _root(root @ new @ root) @ inverse  # symmetric, ``way total way = new``
        shares = [way @ part @ way.T for part in old]
        shares[0] = shares[0] + new - np.sum(shares, axis=0)  # rounding, or all where all is new
        for frame, share in zip(frames, shares, strict=True):
            if frame is frames[0] or described[frame.name].mass > 0.0:
                inertia = pin.PseudoInertia.FromMatrix(share).toInertia()
                found[frame.name] = frame.placement.actInv(inertia)
    return found


def _root(matrix: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


# -- Write what was identified into the user's URDF, and touch nothing else in it

REACH = 2.0 * np.pi  # limits of the joints of a new URDF, which needs some [rad or m]
TAG = re.compile(rb'<(?:[^>"\']|"[^"]*"|\'[^\']*\')*>')  # A '>' in quotes does not end it


@dataclass
class _Element:
    """Where an element stands in the text, in bytes, and those directly in it."""

    name: str
    attributes: dict[str, str]
    begin: int
    inside: int = 0
    end: int = 0
    parts: list[_Element] = field(default_factory=list)


def urdf_of(full: FullParameters) -> str:
    """Give the arm as URDF: the user's own, with identified values, or a new one."""
    if full.arm.urdf is None:
        return _new(full)
    text = full.arm.urdf.encode()
    root = _elements(text)
    inertias = link_inertias(full.arm, full.bodies)
    frictions = simple_frictions(full)
    changes: list[tuple[int, int, bytes]] = []
    for element in root.parts:
        name = element.attributes.get('name')
        if element.name == 'link' and name in inertias:
            changes.append(_change(text, element, 'inertial', _inertial(inertias[name])))
        elif element.name == 'joint' and name in frictions and element.attributes.get('type'):
            changes.append(_change(text, element, 'dynamics', _dynamics(frictions[name])))
    for begin, end, content in sorted(changes, reverse=True):
        text = text[:begin] + content + text[end:]
    return text.decode()


def _elements(text: bytes) -> _Element:
    """Find out where elements stand; the text was checked when the arm was read."""
    parser = expat.ParserCreate()
    top = _Element('', {}, 0)
    stack = [top]

    def tag_end() -> int:
        found = TAG.match(text, parser.CurrentByteIndex)
        assert found is not None  # the parser has read it
        return found.end()

    def start(name: str, attributes: dict[str, str]) -> None:
        element = _Element(name, attributes, parser.CurrentByteIndex, inside=tag_end())
        stack[-1].parts.append(element)
        stack.append(element)

    def end(name: str) -> None:
        element = stack.pop()
        empty = text[element.inside - 2:element.inside] == b'/>'
        element.end = element.inside if empty else tag_end()

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(text, True)
    return top.parts[0]


def _change(text: bytes, element: _Element, name: str, content: str) -> tuple[int, int, bytes]:
    """Say what to put where, so that an element has one part of that name, with that content."""
    old = next((part for part in element.parts if part.name == name), None)
    if old is not None:
        return old.begin, old.end, content.encode()
    if element.parts:  # before the first part, indented as that is
        place = element.parts[0].begin
        line = text.rfind(b'\n', 0, place) + 1
        indent = text[line:place] if not text[line:place].strip() else b''
        return place, place, content.encode() + (b'\n' + indent if indent else b'')
    tag = text[element.begin:element.inside]
    if tag.endswith(b'/>'):
        whole = tag[:-2].rstrip() + b'>' + content.encode() + f'</{element.name}>'.encode()
        return element.begin, element.inside, whole
    return element.inside, element.inside, content.encode()


def _inertial(inertia: pin.Inertia) -> str:
    tensor = np.asarray(inertia.inertia)
    values = ' '.join(f'{key}="{float(tensor[i, j])!r}"' for key, i, j in (
        ('ixx', 0, 0), ('ixy', 0, 1), ('ixz', 0, 2), ('iyy', 1, 1), ('iyz', 1, 2), ('izz', 2, 2)))
    return (f'<inertial><origin xyz="{row(inertia.lever)}" rpy="0 0 0"/>'
            f'<mass value="{float(inertia.mass)!r}"/><inertia {values}/></inertial>')


def _dynamics(simple: Simple) -> str:
    return f'<dynamics damping="{simple.damping!r}" friction="{simple.friction!r}"/>'


def _new(full: FullParameters) -> str:
    """Make a URDF of an arm that was described by D-H rows; held joints are rigid in it."""
    arm, model = full.arm, full.arm.model
    bodies, frictions = full.bodies, simple_frictions(full)
    lines = ['<?xml version="1.0"?>', f'<robot name={quoteattr(arm.name)}>',
             *(f'  <!-- {name} is held at {place:.6g} -->'
               for name, place in arm.held_joints.items()), '  <link name="base"/>']
    for index in range(1, model.njoints):
        name, parent = str(model.names[index]), int(model.parents[index])
        place = model.jointPlacements[index]
        axis = joint_axis(model, name)
        kind = 'prismatic' if arm.is_prismatic(name) else 'revolute'
        before = 'base' if parent == 0 else f'{model.names[parent]}_link'
        inertia = pin.Inertia.FromDynamicParameters(bodies[name])
        lines += [
            f'  <link name={quoteattr(f"{name}_link")}>{_inertial(inertia)}</link>',
            f'  <joint name={quoteattr(name)} type="{kind}">',
            f'    <origin xyz="{row(place.translation)}" '
            f'rpy="{row(pin.rpy.matrixToRpy(place.rotation))}"/>',
            f'    <parent link={quoteattr(before)}/>',
            f'    <child link={quoteattr(f"{name}_link")}/>',
            f'    <axis xyz="{row(axis)}"/>',
            f'    <limit lower="{-REACH!r}" upper="{REACH!r}" effort="0" velocity="0"/>',
            f'    {_dynamics(frictions[name])}', '  </joint>']
    return '\n'.join([*lines, '</robot>', ''])


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
        raise ModelError('an arm description is made from an elastic model, but this fit has '
                         'none', remedy='fit one with tudor fit --models analytical elastic')
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
        raise ModelError(f'the identified values are not valid, as {validation_message(err)}',
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


# -- Layouts of programs that plot topics

LAYOUTS = {'plotjuggler': 'plotjuggler.xml', 'foxglove': 'foxglove.json'}


def layout_of(arm: Arm, program: str) -> str:
    """Lay out what a monitor of an arm publishes."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / 'templates'), trim_blocks=True,
        autoescape=jinja2.select_autoescape(['xml.j2']), undefined=jinja2.StrictUndefined)
    return environment.get_template(f'{LAYOUTS[program]}.j2').render(
        arm=arm.name, base=base_frame(arm.full_model), methods={
            method: (FIELD[method], names) for method in METHODS
            if (names := arm.channels[SOURCE[method]])}) + '\n'
