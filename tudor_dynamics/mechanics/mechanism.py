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

"""From an arm description to a mechanism: bodies, beam sections, nodes, gauges, coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
import pinocchio as pin

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.kinematics import gauge_point, is_prismatic, joint_axis, unit_vector
from tudor_dynamics.arm.schema import BeamSpec, GaugeSpec, InertiaPart, LinkSpec, SectionSpec
from tudor_dynamics.errors import check_type, SimulationError
from tudor_dynamics.mechanics import chain as at
from tudor_dynamics.mechanics.chain import Chain
from tudor_dynamics.mechanics.matrices import Composite
from tudor_dynamics.typing import FloatArray, IntArray, Shown


@dataclass(frozen=True)
class BeamProperties:
    """Stiffness and mass per length of a beam; y is the height axis of the section."""

    density: float  # mass per length [kg/m]
    polar: float  # polar moment of inertia per length [kg m]
    # Stiffness against stretch [N], bending about y and z, torsion [N m^2].
    EA: float
    EIy: float
    EIz: float
    GJ: float
    # Distance of the surface from the neutral line along y and z [m].
    surface_y: float
    surface_z: float


def rectangle_torsion(height: float, width: float) -> float:
    """Give the torsion constant of a rectangle of two sides [m] in m^4."""
    # Saint-Venant's series (Timoshenko and Goodier, Theory of Elasticity, 1970, Eq. 169) by its
    # first terms; 0.1406 h^4 for a square.
    short, long = min(height, width), max(height, width)
    total = sum(math.tanh(n * math.pi * long / (2.0 * short)) / n**5 for n in range(1, 30, 2))
    return long * short**3 / 3.0 * (1.0 - 192.0 / math.pi**5 * short / long * total)


def _geometry(section: SectionSpec) -> tuple[float, float, float, float, float, float]:
    if section.shape == 'rectangle':
        assert section.height is not None and section.width is not None
        h, b = section.height, section.width
        return (b * h, h * b**3 / 12.0, b * h**3 / 12.0, rectangle_torsion(h, b), h / 2, b / 2)
    if section.shape == 'tube':
        assert section.outer is not None and section.inner is not None
        ro, ri = section.outer / 2.0, section.inner / 2.0
        second = math.pi / 4.0 * (ro**4 - ri**4)
        return math.pi * (ro**2 - ri**2), second, second, 2.0 * second, ro, ro
    assert section.area is not None and section.Iy is not None and section.Iz is not None
    # Without a surface, that of the rectangle with the same second moments.
    height = math.sqrt(12.0 * section.Iz / section.area)
    width = math.sqrt(12.0 * section.Iy / section.area)
    return section.area, section.Iy, section.Iz, section.J or 0.0, height / 2, width / 2


def beam_properties(beam: BeamSpec) -> BeamProperties:
    """Give the numbers of a beam."""
    area, second_y, second_z, torsion, surface_y, surface_z = _geometry(beam.section)
    torsion = beam.section.J or torsion
    material, shear = beam.material, beam.material.G
    if shear is None:
        assert material.nu is not None  # the schema has one of the two
        shear = material.E / (2.0 * (1.0 + material.nu))
    return BeamProperties(
        density=material.rho * area, polar=material.rho * (second_y + second_z),
        EA=material.E * area, EIy=material.E * second_y, EIz=material.E * second_z,
        GJ=shear * torsion,
        surface_y=beam.section.surface or surface_y, surface_z=surface_z)


# -- Drives as parts of the links: rotor, gear and viscous friction of ``motors``

def with_motors(arm: Arm) -> Arm:
    """Put what ``motors`` say of each joint into its link, for a mechanism driven by torques."""
    if not arm.spec.motors:
        return arm
    links = {link.joint: link for link in arm.spec.links}
    for motor in arm.spec.motors:
        link = links.get(motor.joint, LinkSpec(joint=motor.joint))
        links[motor.joint] = link.model_copy(update={
            'hub_inertia': motor.reflected_inertia,
            'joint_stiffness': motor.stiffness,
            'joint_damping': motor.damping if motor.stiffness is not None else 0.0,
            'viscous_friction': motor.joint_torque_constant * sum(motor.viscous) / 2})
    return arm.changed(links=tuple(links.values()), motors=())


def left_out(arm: Arm) -> dict[str, list[str]]:
    """Name what ``with_motors`` leaves out of each joint's drive, where there is anything."""
    found = {motor.joint: [name for name, there in (
        ('Coulomb friction', any(motor.coulomb) or motor.load_friction > 0.0),
        ('backlash', motor.backlash > 0.0),
        ('current limit', motor.current_limit is not None)) if there]
        for motor in arm.spec.motors}
    return {joint: parts for joint, parts in found.items() if parts}


# -- From an arm description to the tables of a mechanism, link by link

def beam_axes(floats: FloatArray) -> FloatArray:
    """Give the axes of a body in the moved joint frame, as columns: a row of ``body_float``."""
    return np.asarray(floats[at.BODY_ROTATION:at.BODY_ROTATION + 9].reshape(3, 3))


def _put_inertia(
    floats: FloatArray, mass: float, center: ArrayLike, components: ArrayLike,
) -> None:
    """Write mass, centre and moments of inertia (xx yy zz xy xz yz) of a rigid body."""
    floats[at.MASS] = mass
    floats[at.CENTER:at.CENTER + 3] = center
    floats[at.INERTIA:at.INERTIA + 6] = components


class Builder:
    """Collects bodies and coordinates in the order of the chain."""

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self.model = arm.full_model
        self.links = {link.joint: link for link in arm.spec.links}
        self.ints: list[IntArray] = []
        self.floats: list[FloatArray] = []
        self.coordinates: list[tuple[float, float, float]] = []
        self.initial: list[float] = []
        self.points = 0
        self.body_of: dict[str, int] = {}
        self.beams: dict[str, BeamProperties] = {}
        self.q_index: list[int] = []

    def _coordinate(self, hub: float, stiffness: float, damping: float, start: float) -> int:
        self.coordinates.append((hub, stiffness, damping))
        self.initial.append(start)
        return len(self.coordinates) - 1

    def _blank(self, parent: int, place: pin.SE3) -> tuple[IntArray, FloatArray]:
        """Give the rows of a body that is welded to a parent at a placement in its joint frame."""
        node, rotation, origin = self.attach(parent, place)
        ints = np.full(at.INTS, -1, dtype=np.int64)
        ints[[at.FLEXIBLE, at.JOINT, at.ELEMENTS]] = 0, at.WELD, 0
        ints[at.PARENT], ints[at.NODE], ints[at.POINT] = parent, node, self.points
        floats = np.zeros(at.FLOATS)
        floats[at.JOINT_ROTATION:at.JOINT_ROTATION + 9] = rotation.ravel()
        floats[at.JOINT_PLACE:at.JOINT_PLACE + 3] = origin
        floats[at.BODY_ROTATION:at.BODY_ROTATION + 9] = np.eye(3).ravel()
        return ints, floats

    def _append(self, ints: IntArray, floats: FloatArray) -> int:
        self.ints.append(ints)
        self.floats.append(floats)
        self.points += int(ints[at.ELEMENTS]) + 1
        return len(self.ints) - 1

    def attach(self, parent: int, place: pin.SE3) -> tuple[int, FloatArray, FloatArray]:
        """Node of a parent that carries something, and its placement from that node."""
        if parent < 0 or self.ints[parent][at.FLEXIBLE] == 0:
            return 0, place.rotation, place.translation
        floats, axes = self.floats[parent], beam_axes(self.floats[parent])
        local = axes.T @ (place.translation - floats[at.BODY_PLACE:at.BODY_PLACE + 3])
        length = floats[at.LENGTH]
        node = int(np.clip(np.rint(local[0] / length), 0, self.ints[parent][at.ELEMENTS]))
        local[0] -= node * length
        return node, axes.T @ place.rotation, local

    def rigid_part(self, parent: int, place: pin.SE3, part: InertiaPart | None) -> int:
        """Fix a rigid part, or a mere point, to a link at a place in its joint frame [m]."""
        ints, floats = self._blank(parent, place)
        if part is not None:
            _put_inertia(floats, part.mass, part.center, part.components)
        return self._append(ints, floats)

    def link(self, index: int) -> None:
        """Add the link after joint ``index`` of the Pinocchio model."""
        model, name = self.model, self.model.names[index]
        spec = self.links.get(name)
        urdf_mass = model.inertias[index].mass
        if (spec is None or (spec.rigid is None and spec.flexible is None)) and urdf_mass <= 0:
            msg = (f"{self.arm.source}: the key 'links' has no entry for the link after {name!r}; "
                   'add one with rigid or flexible, or `rigid: {mass: 0}` for a link without mass')
            raise SimulationError(msg)
        spec = spec or LinkSpec(joint=name)
        parent_joint = int(model.parents[index])
        parent = self.body_of[model.names[parent_joint]] if parent_joint else -1
        ints, floats = self._blank(parent, model.jointPlacements[index])
        axis = joint_axis(model, name)
        floats[at.AXIS:at.AXIS + 3] = axis
        ints[at.JOINT] = at.PRISMATIC if is_prismatic(model, name) else at.REVOLUTE
        hold = {joint.name: joint.hold for joint in self.arm.spec.joints}.get(name, 0.0)
        start = self.arm.spec.simulation.initial.get(name, hold)
        ints[at.Q] = self._coordinate(spec.hub_inertia, 0.0, spec.viscous_friction, start)
        self.q_index.append(int(ints[at.Q]))
        if spec.joint_stiffness is not None:
            ints[at.SPRING] = self._coordinate(0.0, spec.joint_stiffness, spec.joint_damping, 0.0)
        if spec.flexible is not None:
            self._beam(index, spec.flexible, axis, ints, floats)
        elif spec.rigid is not None:
            _put_inertia(floats, spec.rigid.mass, spec.rigid.center, spec.rigid.components)
        else:
            inertia = model.inertias[index]
            _put_inertia(floats, inertia.mass, inertia.lever,
                         inertia.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
        body = self._append(ints, floats)
        self.body_of[name] = body
        for part in spec.flexible.lumped if spec.flexible is not None else ():
            node = {'base': 0, 'tip': int(ints[at.ELEMENTS])}.get(str(part.node), part.node)
            place = (floats[at.BODY_PLACE:at.BODY_PLACE + 3]
                     + beam_axes(floats)[:, 0] * int(node) * floats[at.LENGTH])
            self.rigid_part(body, pin.SE3(np.eye(3), place), part)

    def _end(self, index: int, beam: BeamSpec, where: str) -> FloatArray:
        if beam.end is not None:
            return np.asarray(beam.end, dtype=float)
        if beam.length is not None:
            return np.asarray(beam.length * unit_vector(beam.direction) + beam.start)
        model = self.model
        children = [i for i in range(1, model.njoints) if model.parents[i] == index]
        if len(children) == 1:
            return np.array(model.jointPlacements[children[0]].translation)
        tip = self.tip_frame()
        if not children and tip is not None and tip.parentJoint == index:
            return np.array(tip.placement.translation)
        raise SimulationError(f"the end of {where} is not known; add the key 'end' or "
                              "'length' to it")

    def tip_frame(self) -> pin.Frame | None:
        """Frame at the end of the chain: ``tip``, or the last one on the last joint."""
        model = self.model
        named = [frame for frame in model.frames if frame.name == 'tip']
        if named:  # a joint and the link after it may share the name: the link comes last
            return named[-1]
        frames = [f for f in model.frames if f.parentJoint == model.njoints - 1]
        return frames[-1] if frames else None

    def _beam(self, index: int, beam: BeamSpec, axis: FloatArray, ints: IntArray,
              floats: FloatArray) -> None:
        name = self.model.names[index]
        where = f'{self.arm.source}: the beam after {name!r}'
        start = np.asarray(beam.start, dtype=float)
        span = self._end(index, beam, where) - start
        length = float(np.linalg.norm(span))
        if length < 1e-9:
            raise SimulationError(f'{where} starts and ends at {start.tolist()} m of the joint '
                                  'frame; give another end, or length and direction')
        # axes in the joint frame: x along the beam, y up the section
        x = span / length
        if beam.height_axis is not None:
            y = unit_vector(beam.height_axis)
        else:
            # Bending in the plane of motion; for a beam along the axis any direction across.
            y = np.cross(axis, x)
            if np.linalg.norm(y) < 1e-6:
                y = np.eye(3)[int(np.argmin(np.abs(x)))]
        y = y - (y @ x) * x
        if np.linalg.norm(y) < 1e-6:
            raise SimulationError(f'{where}: height_axis is parallel to the beam; give an axis '
                                  'that is not')
        y = y / np.linalg.norm(y)
        self.beams[name] = properties = beam_properties(beam)
        floats[at.BODY_ROTATION:at.BODY_ROTATION + 9] = np.column_stack(
            [x, y, np.cross(x, y)]).ravel()
        floats[at.BODY_PLACE:at.BODY_PLACE + 3] = start
        floats[at.LENGTH] = length / beam.elements
        floats[[at.DENSITY, at.POLAR, at.EA, at.EIY, at.EIZ, at.GJ]] = (
            properties.density, properties.polar, properties.EA, properties.EIy,
            properties.EIz, properties.GJ)
        rayleigh = self.arm.spec.simulation.rayleigh
        floats[[at.ALPHA, at.BETA]] = rayleigh.alpha, rayleigh.beta
        floats[at.STRETCH] = 1.0 if beam.stretch else 0.0
        ints[at.FLEXIBLE], ints[at.ELEMENTS] = 1, beam.elements
        ints[at.FIRST] = len(self.coordinates)
        for _ in range(6 * beam.elements):
            self._coordinate(0.0, 0.0, 0.0, 0.0)


# -- A mechanism: the bodies, nodes and coordinates that compiled code works on

@dataclass(frozen=True, eq=False, repr=False)
class Mechanism(Shown):
    """A mechanism as arrays, see ``layout``; parameters may be changed in place between steps."""

    name: str  # name of the arm
    joints: tuple[str, ...]  # all joints, base first
    driven: NDArray[np.bool_]  # joints that are active in the description; the others are held
    q_index: IntArray  # coordinate of each joint
    body_of: dict[str, int]  # body after each joint
    beams: dict[str, BeamProperties]  # beam after each joint that has one
    # Tables for compiled code.
    body_int: IntArray
    body_float: FloatArray
    coordinate: FloatArray
    initial: FloatArray  # coordinates before the elastic state is found, (n,)
    gravity: FloatArray  # gravity in the base frame, (3,) [m/s^2]
    points: int  # number of nodes and rigid bodies
    tip: int  # point at the tip
    start: str  # 'equilibrium' or 'undeformed'

    @property
    def size(self) -> int:
        """Give the number of coordinates."""
        return int(self.coordinate.shape[0])

    @property
    def elastic(self) -> NDArray[np.bool_]:
        """Which coordinates are no joint positions."""
        mask = np.ones(self.size, dtype=bool)
        mask[self.q_index] = False
        return mask

    @cached_property
    def rotations(self) -> IntArray:
        """Coordinates of the rotations of all nodes of beams, shape (n_nodes, 3)."""
        rows = [row[at.FIRST] + 6 * node + np.arange(3, 6) for row in self.body_int
                for node in range(int(row[at.ELEMENTS]))]
        return np.array(rows, dtype=np.int64).reshape(-1, 3)

    def chain(self) -> Chain:
        """Make the tables for compiled code: those of the mechanism are shared, others new."""
        bodies = len(self.body_int)
        return Chain(self.body_int, self.body_float, self.coordinate, -self.gravity,
                     np.zeros((self.points, 6)), np.zeros((bodies, at.MOVING)),
                     np.zeros((bodies, 6)))

    def composite(self) -> Composite:
        """Make working memory for the mass matrix."""
        return Composite(np.zeros((self.size, 6)), np.zeros(self.size, dtype=np.int64),
                         np.zeros((len(self.body_int) + 1, 10)))

    @property
    def coordinate_names(self) -> list[str]:
        """Name of each coordinate, for messages and tables."""
        names = [''] * self.size
        for joint, body in self.body_of.items():
            row = self.body_int[body]
            names[row[at.Q]] = joint
            if row[at.SPRING] >= 0:
                names[row[at.SPRING]] = f'spring of {joint}'
            for i in range(6 * int(row[at.ELEMENTS])):
                kind = ('ux', 'uy', 'uz', 'rx', 'ry', 'rz')[i % 6]
                names[row[at.FIRST] + i] = f'{kind} of node {i // 6 + 1} after {joint}'
        return names

    def length(self, joint: str) -> float:
        """Give the length of the beam after a joint, 0 for a rigid link [m]."""
        body = self.body_of[joint]
        return float(self.body_int[body, at.ELEMENTS] * self.body_float[body, at.LENGTH])

    def body_at(self, point: int) -> int:
        """Give the body that a point belongs to."""
        return int(np.flatnonzero(self.body_int[:, at.POINT] <= point)[-1])

    def point(self, joint: str, node: int = -1) -> int:
        """Give the number of a node after a joint."""
        row = self.body_int[self.body_of[joint]]
        return int(row[at.POINT] + (node + row[at.ELEMENTS] + 1 if node < 0 else node))


def build_mechanism(arm: Arm) -> Mechanism:
    """
    Build the mechanism of an arm description.

    Parameters
    ----------
    arm : Arm
        Description with ``links`` filled in.

    Raises
    ------
    SimulationError
        If a link is missing or has no length, the mechanism has no mass where it can move, or
        its drives are coupled.

    """
    check_type(arm, Arm, 'arm', "read a description with load_arm('arm.yaml')")
    builder = Builder(arm)
    if arm.spec.couplings is not None:
        raise SimulationError(f'{arm.source}: the simulator does not model couplings; remove them '
                              'from a copy of the description to simulate the arm without them')
    if not arm.spec.links and not any(i.mass > 0 for i in list(arm.full_model.inertias)[1:]):
        raise SimulationError(f"{arm.source}: the key 'links' is missing; simulation and "
                              'elastic models need it; add it as in docs/reference/arm_yaml.md')
    for index in range(1, arm.full_model.njoints):
        builder.link(index)
    tip = builder.tip_frame()
    parent = builder.body_of[arm.full_model.names[tip.parentJoint if tip else -1]]
    place = pin.SE3(tip.placement) if tip else pin.SE3.Identity()
    node, rotation, offset = builder.attach(parent, place)
    if arm.spec.payload is None and node > 0 and np.linalg.norm(offset) < 1e-9:
        tip_point = int(builder.ints[parent][at.POINT]) + node
    else:
        body = builder.rigid_part(parent, place, arm.spec.payload)
        tip_point = int(builder.ints[body][at.POINT])
    joints = tuple(arm.full_model.names)[1:]
    return Mechanism(
        name=arm.name, joints=joints,
        driven=np.array([name in arm.active_joints for name in joints]),
        q_index=np.array(builder.q_index, dtype=np.int64), body_of=builder.body_of,
        beams=builder.beams, body_int=np.array(builder.ints),
        body_float=np.array(builder.floats), coordinate=np.array(builder.coordinates),
        initial=np.array(builder.initial), gravity=np.array(arm.spec.gravity, dtype=float),
        points=builder.points, tip=tip_point, start=arm.spec.simulation.start)


# -- Where a gauge sits on the beam of its link, and which bending it measures

@dataclass(frozen=True)
class GaugePlace:
    """A gauge on a mechanism."""

    body: int  # number of the beam's body
    distance: float  # from the beam's start [m]
    axis: int  # component of the moment that bends the beam there: 1 or 2
    sign: float  # makes the moment positive for the load that the joint holds
    joint: str  # joint before the beam
    bending: float  # stiffness of the beam about that axis [N m^2]


def place_gauge(mechanism: Mechanism, arm: Arm, gauge: GaugeSpec) -> GaugePlace:
    """Find a gauge's place on a mechanism."""
    if gauge.joint not in mechanism.beams:
        msg = (f'{arm.source}: gauge {gauge.name!r} sits on the link of {gauge.joint!r}, '
               'which is rigid here; make it flexible in links, or leave the gauge out')
        raise SimulationError(msg)
    body, beam = mechanism.body_of[gauge.joint], mechanism.beams[gauge.joint]
    floats = mechanism.body_float[body]
    frame = beam_axes(floats)
    start = floats[at.BODY_PLACE:at.BODY_PLACE + 3]
    distance = float(frame[:, 0] @ (gauge_point(gauge) - start))
    axis = floats[at.AXIS:at.AXIS + 3] if gauge.axis is None else unit_vector(gauge.axis)
    local = frame.T @ axis
    column = 2 if abs(local[2]) >= abs(local[1]) else 1
    # Positive for the load that the joint holds: the moment of the inboard part counts.
    return GaugePlace(body, distance, column, -math.copysign(1.0, float(local[column])),
                      gauge.joint, beam.EIz if column == 2 else beam.EIy)
