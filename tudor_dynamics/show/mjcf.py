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

"""Write an identified arm as MJCF, rigid or with springs."""

from __future__ import annotations

from collections.abc import Sequence
import math
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.kinematics import joint_axis
from tudor_dynamics.mechanics import chain as at
from tudor_dynamics.models.comparison import FullParameters
from tudor_dynamics.models.elastic import kernel
from tudor_dynamics.models.elastic.model import driven_arm, ElasticModel
from tudor_dynamics.models.elastic.parameters import in_words, physical_unit
from tudor_dynamics.show.description import (
    elastic_friction, ElasticDrive, row, Simple, simple_frictions)
from tudor_dynamics.typing import FloatArray


# -- Elements of MJCF that all arms are made of

def new_file(arm: Arm, options: dict[str, str] | None = None) -> ElementTree.Element:
    """Begin a file."""
    root = ElementTree.Element('mujoco', model=arm.name)
    ElementTree.SubElement(root, 'compiler', angle='radian', balanceinertia='false')
    ElementTree.SubElement(root, 'option', gravity=row(np.array(arm.spec.gravity)),
                           attrib=options or {})
    return root


def new_body(parent: ElementTree.Element, name: str, place: pin.SE3) -> ElementTree.Element:
    """Put a body into another; place: its frame in that of the parent [m]."""
    return ElementTree.SubElement(parent, 'body', name=name, pos=row(place.translation),
                                  quat=quaternion(place.rotation))


def add_inertial(body: ElementTree.Element, inertia: pin.Inertia) -> None:
    """Give a body its mass."""
    tensor = np.asarray(inertia.inertia)
    # MuJoCo takes the inertia of a point in this form alone, and that of any body in the other
    element = ElementTree.SubElement(body, 'inertial', pos=row(inertia.lever),
                                     mass=repr(float(inertia.mass)))
    if np.any(tensor):
        element.set('fullinertia', row(tensor[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]))
    else:
        element.set('diaginertia', '0 0 0')


def add_joint(
    body: ElementTree.Element, arm: Arm, name: str, axis: FloatArray, rotor: float,
    friction: Simple,
) -> None:
    """Give a body the joint that moves it, with its drive: axis (3,), rotor [kg m^2 or kg]."""
    ElementTree.SubElement(
        body, 'joint', name=name, type=kind_of(arm, name), axis=row(axis), armature=repr(rotor),
        damping=repr(friction.damping), frictionloss=repr(friction.friction))


def kind_of(arm: Arm, joint: str) -> str:
    """Say how MuJoCo calls a joint of this kind."""
    return 'slide' if arm.is_prismatic(joint) else 'hinge'


def finished(root: ElementTree.Element, joints: Sequence[str]) -> str:
    """Put a motor on each joint, and write the file."""
    motors = ElementTree.SubElement(root, 'actuator')
    for name in joints:
        ElementTree.SubElement(motors, 'motor', name=name, joint=name)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='unicode') + '\n'


def quaternion(rotation: FloatArray) -> str:
    """Write a rotation (3, 3): w, x, y, z."""
    x, y, z, w = pin.Quaternion(rotation).coeffs()
    return row(np.array([w, x, y, z]))


# -- Write an elastic arm as MJCF: gears and bending links as joints with springs.
#
# A link is cut at the two points of Gauss's quadrature and hinged there, each hinge as stiff as
# half of the link: forces and moments at its end then move and turn that end as they do the
# beam's, for the compliance is an integral of squares of the moment, which these two points give
# exactly.

HINGES = (0.5 - math.sqrt(3.0) / 6.0, 0.5 + math.sqrt(3.0) / 6.0)
"""Where a link is hinged, as parts of its length."""
LONGEST_STEP = 1e-3
"""Time step that the file asks for, unless the fastest vibration needs a shorter one [s]."""
STAND_IN = 0.01
"""Rotor where none is known, as a part of what the gear carries: without any, the drive's side of
a gear has no mass, and MuJoCo cannot move it."""


def not_in_mjcf(model: ElasticModel, drives: dict[str, ElasticDrive]) -> tuple[str, ...]:
    """Name what was identified and has no place in MJCF."""
    values = driven_arm(model.arm, model.values).parameters
    unknown = [joint for joint in model.arm.active_joints if _rotor(drives, joint) <= 0.0]
    found = [f'rotor of {joint}, which is not known: {STAND_IN:.0%} of what its gear carries '
             'stands in' for joint in unknown]
    found += [f'{in_words(name)}: {value:.4g} {physical_unit(model.arm, name)}'
              for name, value in values.items()
              if name.partition('(')[0] in ('play', 'alpha', 'lag') and value > 0.0]
    for joint, drive in drives.items():
        simple = elastic_friction(model.arm, joint, drive.terms)
        found += [f'friction of {joint}: {what}' for what in simple.left_out]
    return tuple(found)


class ElasticFile:
    """An elastic arm with its drives as a tree of bodies; drives: none without efforts."""

    def __init__(self, model: ElasticModel, drives: dict[str, ElasticDrive]) -> None:
        self.driven = driven_arm(model.arm, model.values)
        self.arm, self.drives = model.arm, drives
        tables, mechanism = self.driven.tables, self.driven.mechanism
        small = self.driven.linearised(mechanism.initial[tables.gears.place])
        fastest = float(np.max(np.abs(np.linalg.eigvals(
            np.linalg.solve(small.mass, small.stiffness)))))
        # a radian of the fastest vibration, half of what is stable
        step = min(LONGEST_STEP, 1.0 / math.sqrt(fastest))
        self.carried = np.diag(small.mass)[np.searchsorted(tables.equations.free,
                                                           tables.gears.place)]
        self.root = new_file(self.arm, {'timestep': f'{step:.0e}', 'integrator': 'implicitfast'})
        world = ElementTree.SubElement(self.root, 'worldbody')
        self.nodes: dict[tuple[int, int], tuple[ElementTree.Element, pin.SE3]] = {
            (-1, 0): (world, pin.SE3.Identity())}
        self.sensors = ElementTree.Element('sensor')
        self.readings = {} if model.output != 'strain' or model.coefficients_ is None else dict(
            zip(model.channels, model.coefficients_, strict=True))
        self.joint_of = {body: name for name, body in self.driven.mechanism.body_of.items()}
        self.parts: dict[str, int] = {}

    def text(self) -> str:
        """Write all bodies, base first, then motors and sensors."""
        mechanism = self.driven.mechanism
        for body in range(len(mechanism.body_int)):
            self._body(body, mechanism.body_int[body], mechanism.body_float[body])
        if len(self.sensors):
            self.root.append(self.sensors)
        if self.readings:
            custom = ElementTree.SubElement(self.root, 'custom')
            for name, values in self.readings.items():
                ElementTree.SubElement(custom, 'numeric', name=name, data=row(values))
        return finished(self.root, self.arm.active_joints)

    def _body(self, body: int, ints: FloatArray, floats: FloatArray) -> None:
        parent, where = self.nodes[int(ints[at.PARENT]), max(int(ints[at.NODE]), 0)]
        place = where * _placement(floats, at.JOINT_ROTATION, at.JOINT_PLACE)
        joint = self.joint_of.get(body)
        last = body == len(self.driven.mechanism.body_int) - 1
        if joint in self.arm.held_joints:
            move = floats[at.AXIS:at.AXIS + 3] * self.arm.held_joints[joint]
            place = place * (pin.SE3(np.eye(3), move) if self.arm.is_prismatic(joint)
                             else pin.SE3(pin.exp3(move), np.zeros(3)))
        if joint is None and not last and floats[at.MASS] <= 0.0:
            self.nodes[body, 0] = parent, place
            return
        element = new_body(parent, 'payload' if last else self._name(joint, ints), place)
        if joint in self.arm.active_joints:
            self._joints(element, joint, floats[at.AXIS:at.AXIS + 3])
        if ints[at.FLEXIBLE]:
            assert joint is not None  # beams follow joints
            self._link(element, body, joint, floats)
            return
        frame = _placement(floats, at.BODY_ROTATION, at.BODY_PLACE)
        tensor = floats[at.INERTIA:at.INERTIA + 6][[0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(3, 3)
        add_inertial(element, frame.act(pin.Inertia(
            float(floats[at.MASS]), floats[at.CENTER:at.CENTER + 3], tensor)))
        self.nodes[body, 0] = element, frame
        if last:
            ElementTree.SubElement(element, 'site', name='tip')

    def _name(self, joint: str | None, ints: FloatArray) -> str:
        if joint is not None:
            return f'{joint}_link'
        owner = self.joint_of[int(ints[at.PARENT])]
        self.parts[owner] = self.parts.get(owner, 0) + 1
        return f'{owner}_part{self.parts[owner]}'

    def _joints(self, element: ElementTree.Element, joint: str, axis: FloatArray) -> None:
        """Put the drive's side and the gear into one body: the link turns by their sum."""
        terms = self.drives[joint].terms if joint in self.drives else {}
        index = self.arm.active_joints.index(joint)
        simple = elastic_friction(self.arm, joint, terms)
        spring = self.driven.tables.gears.springs[index]
        rotor = _rotor(self.drives, joint) or STAND_IN * float(self.carried[index])
        add_joint(element, self.arm, joint, axis, rotor, simple)
        ElementTree.SubElement(
            element, 'joint', name=f'{joint}_gear', type=kind_of(self.arm, joint), axis=row(axis),
            stiffness=repr(float(spring[kernel.STIFF])), damping=repr(float(spring[kernel.TIGHT])))

    def _link(
        self, element: ElementTree.Element, body: int, joint: str, floats: FloatArray,
    ) -> None:
        """Cut a link at its hinges and gauges; each piece is a body in the one before."""
        length, frame = floats[at.LENGTH], _placement(floats, at.BODY_ROTATION, at.BODY_PLACE)
        self.nodes[body, 0] = element, frame
        gauges = {float(np.clip(gauge.distance, 0.0, length)): number
                  for number, gauge in enumerate(self.driven.gauges) if gauge.body == body}
        hinges = [part * length for part in HINGES]
        cuts = sorted({0.0, *gauges, *hinges})
        for number, (begin, end) in enumerate(zip(cuts, [*cuts[1:], length], strict=True)):
            if begin > 0.0:
                element = new_body(element, f'{joint}_link{number + 1}', frame * pin.SE3(
                    np.eye(3), np.array([begin - cuts[number - 1], 0.0, 0.0])))
                frame = pin.SE3.Identity()
            if begin in hinges:
                self._hinge(element, body, f'{joint}_bend{hinges.index(begin) + 1}', floats)
            piece = end - begin  # x along it, from the origin
            mass, polar = float(floats[at.DENSITY]) * piece, float(floats[at.POLAR]) * piece
            across = mass * piece**2 / 12.0 + 0.5 * polar
            add_inertial(element, frame.act(pin.Inertia(
                mass, np.array([0.5 * piece, 0.0, 0.0]), np.diag([polar, across, across]))))
            if begin in gauges:
                self._gauge(element, frame, gauges[begin])
        self.nodes[body, 1] = element, frame * pin.SE3(
            np.eye(3), np.array([length - cuts[-1], 0.0, 0.0]))

    def _hinge(
        self, element: ElementTree.Element, body: int, name: str, floats: FloatArray,
    ) -> None:
        first = int(self.driven.mechanism.body_int[body, at.FIRST])
        for axis, column, slope in (('0 0 1', at.EIZ, 5), ('0 1 0', at.EIY, 4)):
            if first + slope in self.driven.tables.equations.free:
                stiffness = 2.0 * float(floats[column] / floats[at.LENGTH])
                ElementTree.SubElement(
                    element, 'joint', name=name if slope == 5 else f'{name}_across',
                    type='hinge', axis=axis, stiffness=repr(stiffness),
                    damping=repr(float(floats[at.BETA]) * stiffness))

    def _gauge(self, element: ElementTree.Element, frame: pin.SE3, number: int) -> None:
        gauge, name = self.driven.gauges[number], self.arm.gauge_names[number]
        # z against the bending axis: MuJoCo gives what the outer part does to the inner one
        turn = np.eye(3) if gauge.axis == 2 else np.eye(3)[:, [1, 2, 0]]
        if gauge.sign > 0.0:
            turn = turn @ np.diag([1.0, -1.0, -1.0])
        placed = frame * pin.SE3(turn, np.zeros(3))
        ElementTree.SubElement(element, 'site', name=name, pos=row(placed.translation),
                               quat=quaternion(placed.rotation))
        ElementTree.SubElement(self.sensors, 'torque', name=name, site=name)


def _rotor(drives: dict[str, ElasticDrive], joint: str) -> float:
    return max(drives[joint].terms.get('Ia', 0.0), 0.0) if joint in drives else 0.0


def _placement(floats: FloatArray, rotation: int, place: int) -> pin.SE3:
    return pin.SE3(floats[rotation:rotation + 9].reshape(3, 3).copy(),
                   floats[place:place + 3].copy())


# -- Write an identified arm as MJCF, for MuJoCo

def mjcf_of(full: FullParameters) -> str:
    """Give the active joints of the arm with their bodies and drives as MJCF."""
    arm, model = full.arm, full.arm.model
    root = new_file(arm)
    places = [ElementTree.SubElement(root, 'worldbody')]
    drives, frictions = full.drives, simple_frictions(full)
    for index, parameters in enumerate(full.bodies.values(), start=1):
        name = str(model.names[index])
        body = new_body(places[int(model.parents[index])], f'{name}_link',
                        model.jointPlacements[index])
        add_inertial(body, pin.Inertia.FromDynamicParameters(parameters))
        add_joint(body, arm, name, joint_axis(model, name), drives[name].get('Ia', 0.0),
                  frictions[name])
        places.append(body)
    return finished(root, arm.active_joints)
