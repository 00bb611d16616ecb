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

"""From an arm description to the bodies, nodes and coordinates that compiled code works on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
import pinocchio as pin

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.kinematics import joint_axis, unit_vector
from tudor_dynamics.arm.links import BeamSpec, InertiaPart, LinkSpec, six_components
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.simulation import layout as at
from tudor_dynamics.simulation.section import beam_properties, BeamProperties

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Mechanism:
    """
    A mechanism as arrays, see ``layout``; parameters may be changed in place between steps.

    Attributes
    ----------
    name : str
        Name of the arm.
    joints : tuple of str
        All joints, base first.
    driven : ndarray of bool
        Joints that are active in the description; the others are held.
    q_index : ndarray of int
        Coordinate of each joint.
    body_of : dict of str to int
        Body behind each joint.
    beams : dict of str to BeamProperties
        Beam behind each joint that has one.
    body_int, body_float, coordinate : ndarray
        Tables for compiled code.
    initial : ndarray of shape (n,)
        Coordinates before the elastic state is found.
    gravity : ndarray of shape (3,)
        [m/s^2]
    points : int
        Number of nodes and rigid bodies.
    tip : int
        Point at the tip.
    start : str
        'equilibrium' or 'undeformed'.

    """

    name: str
    joints: tuple[str, ...]
    driven: NDArray[np.bool_]
    q_index: IntArray
    body_of: dict[str, int]
    beams: dict[str, BeamProperties]
    body_int: IntArray
    body_float: FloatArray
    coordinate: FloatArray
    initial: FloatArray
    gravity: FloatArray
    points: int
    tip: int
    start: str

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return int(self.coordinate.shape[0])

    @property
    def elastic(self) -> NDArray[np.bool_]:
        """Which coordinates are no joint positions."""
        mask = np.ones(self.size, dtype=bool)
        mask[self.q_index] = False
        return mask

    @property
    def coordinate_names(self) -> list[str]:
        """Name of each coordinate, for messages and tables."""
        names = [''] * self.size
        bodies = {body: joint for joint, body in self.body_of.items()}
        for body, joint in bodies.items():
            row = self.body_int[body]
            names[row[at.Q]] = joint
            if row[at.SPRING] >= 0:
                names[row[at.SPRING]] = f'spring of {joint}'
            for i in range(6 * int(row[at.ELEMENTS])):
                kind = ('ux', 'uy', 'uz', 'rx', 'ry', 'rz')[i % 6]
                names[row[at.FIRST] + i] = f'{kind} of node {i // 6 + 1} behind {joint}'
        return names

    def point(self, joint: str, node: int = -1) -> int:
        """
        Give the number of a node behind a joint.

        Parameters
        ----------
        joint : str
            Joint.
        node : int
            Node of its beam; -1 for the last one.

        Returns
        -------
        int
            Row in arrays over the points of the mechanism.

        """
        row = self.body_int[self.body_of[joint]]
        count = int(row[at.ELEMENTS]) + 1 if row[at.FLEXIBLE] else 1
        return int(row[at.POINT]) + (node + count if node < 0 else node)


def _body_frame(beam: BeamSpec, end: FloatArray, axis: FloatArray, where: str) -> FloatArray:
    """Axes of a beam in the joint frame: x along, y up the section."""
    start = np.asarray(beam.start, dtype=float)
    length = float(np.linalg.norm(end - start))
    if length < 1e-9:
        msg = (f'{where} has no length: it starts and ends at {start.tolist()} m of the joint '
               'frame; give its end, or length and direction')
        raise SimulationError(msg)
    x = (end - start) / length
    if beam.height_axis is not None:
        y = unit_vector(beam.height_axis)
    else:
        # Bending in the plane of motion; for a beam along the axis any direction across.
        y = np.cross(axis, x)
        if np.linalg.norm(y) < 1e-6:
            y = np.eye(3)[int(np.argmin(np.abs(x)))]
    y = y - (y @ x) * x
    if np.linalg.norm(y) < 1e-6:
        msg = f'{where}: height_axis points along the beam; give a direction across'
        raise SimulationError(msg)
    y = y / np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])


class _Builder:
    """Collects bodies and coordinates in the order of the chain."""

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self.model = arm.full_model
        self.links = {link.joint: link for link in arm.spec.links}
        self.ints: list[IntArray] = []
        self.floats: list[FloatArray] = []
        self.coordinates: list[FloatArray] = []
        self.initial: list[float] = []
        self.points = 0
        self.body_of: dict[str, int] = {}
        self.beams: dict[str, BeamProperties] = {}
        self.q_index: list[int] = []

    def _coordinate(self, hub: float, stiffness: float, damping: float, start: float) -> int:
        self.coordinates.append(np.array([hub, stiffness, damping]))
        self.initial.append(start)
        return len(self.coordinates) - 1

    def _blank(self, parent: int, node: int) -> tuple[IntArray, FloatArray]:
        ints = np.full(at.INTS, -1, dtype=np.int64)
        ints[[at.FLEXIBLE, at.JOINT, at.ELEMENTS]] = 0, at.WELD, 0
        ints[at.PARENT], ints[at.NODE], ints[at.POINT] = parent, node, self.points
        floats = np.zeros(at.FLOATS)
        floats[at.JOINT_ROTATION:at.JOINT_ROTATION + 9] = np.eye(3).ravel()
        floats[at.BODY_ROTATION:at.BODY_ROTATION + 9] = np.eye(3).ravel()
        return ints, floats

    def _append(self, ints: IntArray, floats: FloatArray) -> int:
        self.ints.append(ints)
        self.floats.append(floats)
        self.points += int(ints[at.ELEMENTS]) + 1
        return len(self.ints) - 1

    def _attach(self, parent: int, place: pin.SE3) -> tuple[int, FloatArray, FloatArray]:
        """Node of a parent that carries something, and its placement from that node."""
        if parent < 0 or self.ints[parent][at.FLEXIBLE] == 0:
            return 0, place.rotation, place.translation
        floats = self.floats[parent]
        axes = floats[at.BODY_ROTATION:at.BODY_ROTATION + 9].reshape(3, 3)
        origin = floats[at.BODY_PLACE:at.BODY_PLACE + 3]
        local = axes.T @ (place.translation - origin)
        length = floats[at.LENGTH]
        node = int(np.clip(np.rint(local[0] / length), 0, self.ints[parent][at.ELEMENTS]))
        local[0] -= node * length
        return node, axes.T @ place.rotation, local

    def rigid_part(self, parent: int, place: pin.SE3, part: InertiaPart | None) -> int:
        """Fix a rigid part to a link, at a placement in the link's joint frame."""
        node, rotation, origin = self._attach(parent, place)
        ints, floats = self._blank(parent, node)
        floats[at.JOINT_ROTATION:at.JOINT_ROTATION + 9] = rotation.ravel()
        floats[at.JOINT_PLACE:at.JOINT_PLACE + 3] = origin
        if part is not None:
            floats[at.MASS] = part.mass
            floats[at.CENTER:at.CENTER + 3] = part.center
            floats[at.INERTIA:at.INERTIA + 6] = six_components(part.inertia)
        return self._append(ints, floats)

    def link(self, index: int) -> None:
        """Add the link behind joint ``index`` of the Pinocchio model."""
        model, name = self.model, self.model.names[index]
        spec = self.links.get(name)
        urdf_mass = model.inertias[index].mass
        if (spec is None or (spec.rigid is None and spec.flexible is None)) and urdf_mass <= 0:
            msg = (f'{self.arm.source}: nothing is known of the link behind {name!r}; add an '
                   f'entry with rigid: or flexible: to links (rigid: {{mass: 0}} for none)')
            raise SimulationError(msg)
        spec = spec or LinkSpec(joint=name)
        parent_joint = int(model.parents[index])
        parent = self.body_of[model.names[parent_joint]] if parent_joint else -1
        node, rotation, place = self._attach(parent, model.jointPlacements[index])
        ints, floats = self._blank(parent, node)
        floats[at.JOINT_ROTATION:at.JOINT_ROTATION + 9] = rotation.ravel()
        floats[at.JOINT_PLACE:at.JOINT_PLACE + 3] = place
        axis = joint_axis(model, name)
        floats[at.AXIS:at.AXIS + 3] = axis
        prismatic = 'P' in model.joints[index].shortname().removeprefix('JointModel')[:1]
        ints[at.JOINT] = at.PRISMATIC if prismatic else at.REVOLUTE
        hold = {joint.name: joint.hold for joint in self.arm.spec.joints}.get(name, 0.0)
        start = self.arm.spec.simulation.initial.get(name, hold)
        ints[at.Q] = self._coordinate(spec.hub_inertia, 0.0, spec.viscous_friction, start)
        self.q_index.append(int(ints[at.Q]))
        if spec.joint_stiffness is not None:
            ints[at.SPRING] = self._coordinate(
                0.0, spec.joint_stiffness, spec.joint_damping, 0.0)
        if spec.flexible is not None:
            self._beam(index, spec.flexible, axis, ints, floats)
        elif spec.rigid is not None:
            floats[at.MASS] = spec.rigid.mass
            floats[at.CENTER:at.CENTER + 3] = spec.rigid.center
            floats[at.INERTIA:at.INERTIA + 6] = six_components(spec.rigid.inertia)
        else:
            inertia = model.inertias[index]
            tensor = inertia.inertia
            floats[at.MASS] = inertia.mass
            floats[at.CENTER:at.CENTER + 3] = inertia.lever
            floats[at.INERTIA:at.INERTIA + 6] = tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        body = self._append(ints, floats)
        self.body_of[name] = body
        if spec.flexible is not None:
            for part in spec.flexible.lumped:
                self._lumped(body, part.node, part)

    def _lumped(self, body: int, node: int | str, part: InertiaPart) -> None:
        floats = self.floats[body]
        axes = floats[at.BODY_ROTATION:at.BODY_ROTATION + 9].reshape(3, 3)
        number = {'base': 0, 'tip': int(self.ints[body][at.ELEMENTS])}.get(str(node))
        number = int(node) if number is None else number
        place = (floats[at.BODY_PLACE:at.BODY_PLACE + 3]
                 + axes[:, 0] * number * floats[at.LENGTH])
        self.rigid_part(body, pin.SE3(np.eye(3), place), part)

    def _end(self, index: int, beam: BeamSpec, where: str) -> FloatArray:
        start = np.asarray(beam.start, dtype=float)
        if beam.end is not None:
            return np.asarray(beam.end, dtype=float)
        if beam.length is not None:
            return np.asarray(start + beam.length * unit_vector(beam.direction))
        model = self.model
        children = [i for i in range(1, model.njoints) if model.parents[i] == index]
        if len(children) == 1:
            return np.array(model.jointPlacements[children[0]].translation)
        tip = self.tip_frame()
        if not children and tip is not None and tip.parentJoint == index:
            return np.array(tip.placement.translation)
        msg = f'{where}: where it ends does not follow from the kinematics; give end or length'
        raise SimulationError(msg)

    def tip_frame(self) -> pin.Frame | None:
        """Frame at the end of the chain: ``tip``, or the last one on the last joint."""
        model = self.model
        if model.existFrame('tip'):
            return model.frames[model.getFrameId('tip')]
        last = model.njoints - 1
        frames = [f for f in model.frames if f.parentJoint == last]
        return frames[-1] if frames else None

    def _beam(self, index: int, beam: BeamSpec, axis: FloatArray, ints: IntArray,
              floats: FloatArray) -> None:
        name = self.model.names[index]
        where = f'{self.arm.source}: the beam behind {name!r}'
        end = self._end(index, beam, where)
        start = np.asarray(beam.start, dtype=float)
        axes = _body_frame(beam, end, axis, where)
        properties = beam_properties(beam)
        self.beams[name] = properties
        floats[at.BODY_ROTATION:at.BODY_ROTATION + 9] = axes.ravel()
        floats[at.BODY_PLACE:at.BODY_PLACE + 3] = start
        floats[at.LENGTH] = np.linalg.norm(end - start) / beam.elements
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


def build_mechanism(arm: Arm) -> Mechanism:
    """
    Build the mechanism of an arm description.

    Parameters
    ----------
    arm : Arm
        Description with ``links`` filled in.

    Returns
    -------
    Mechanism
        Tables for compiled code.

    Raises
    ------
    SimulationError
        If a link is missing or has no length, or the mechanism has no mass where it can move.

    """
    builder = _Builder(arm)
    if not arm.spec.links and not any(i.mass > 0 for i in list(arm.full_model.inertias)[1:]):
        msg = (f'{arm.source}: the description has no links; add links: with a rigid or flexible '
               'entry a joint to simulate it')
        raise SimulationError(msg)
    for index in range(1, arm.full_model.njoints):
        builder.link(index)
    tip = builder.tip_frame()
    parent = builder.body_of[arm.full_model.names[tip.parentJoint if tip else -1]]
    place = pin.SE3(tip.placement) if tip else pin.SE3.Identity()
    node, rotation, offset = builder._attach(parent, place)
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
