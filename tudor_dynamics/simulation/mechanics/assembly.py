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

"""From an arm description to the tables of a mechanism, link by link."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.kinematics import joint_axis, unit_vector
from tudor_dynamics.arm.links import BeamSpec, InertiaPart, LinkSpec, six_components
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.simulation.mechanics.section import beam_properties, BeamProperties
from tudor_dynamics.typing import FloatArray, IntArray


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


class Builder:
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

    def attach(self, parent: int, place: pin.SE3) -> tuple[int, FloatArray, FloatArray]:
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
        """
        Fix a rigid part to a link, at a placement in the link's joint frame.

        place: its placement in the link's joint frame [m]; part: none for a mere point.
        """
        node, rotation, origin = self.attach(parent, place)
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
        node, rotation, place = self.attach(parent, model.jointPlacements[index])
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
        named = [frame for frame in model.frames if frame.name == 'tip']
        if named:  # a joint and the link behind it may share the name: the link comes last
            return named[-1]
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
