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

"""Limits of the joints, hard and planned, and distances between links."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
import itertools
import math
import os
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
import pinocchio as pin

from pinocchio import hppfcl as fcl
from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.kinematics import adapt, check_numbers, parse
from tudor_dynamics.arm.schema import DRIVE_TIMEOUT, JointSpec, LimitSpec, PlannedSpec
from tudor_dynamics.errors import ArmError
from tudor_dynamics.files import read_text
from tudor_dynamics.typing import FloatArray, Shown


# Hard limits come from the description's ``limits``, the URDF and the motors, whichever is
# tighter. Planned motion stays below, so that the damper of the links has room for its share.

UNLIMITED = 1e8
"""From here on a limit is not used: continuous joints of a URDF have 1e9 [rad, rad/s or N m]."""
PLANNED_SPEED = 2.0 / 3.0
"""Part of the speed limit that is planned where the description does not say."""
PLANNED_ACCELERATION = 1.0 / 3.0  # the same of the acceleration, of which the damper needs more


@dataclass(frozen=True, eq=False, repr=False)
class Limits(Shown):
    """Limits of the active joints; infinite where none is known."""

    # Smallest and largest positions, (joints,) [rad or m].
    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray  # largest speed in either direction, (joints,) [rad/s or m/s]
    acceleration: FloatArray  # largest in either direction, (joints,) [rad/s^2 or m/s^2]
    missing: tuple[str, ...] = ()  # what is not known, one phrase each

    def outside(self, q: FloatArray) -> NDArray[np.bool_]:
        """Say which positions [rad or m] are beyond a limit: q (joints,) [rad or m]."""
        return np.asarray((q < self.lower) | (q > self.upper))


@dataclass(frozen=True, eq=False)
class DriveStop:
    """How drives stop by themselves where no command comes."""

    timeout: float  # time without a command from which on they do [s]
    acceleration: FloatArray  # with which they brake, (joints,) [rad/s^2 or m/s^2]


def unlimited(joints: int) -> Limits:
    """Give the limits of joints that have none."""
    without = np.full(joints, np.inf)
    return Limits(-without, without, without, without)


def _of_joint(arm: Arm, joint: JointSpec) -> tuple[float, float, float, float]:
    """Give lower, upper, velocity and acceleration of one joint; infinite where unknown."""
    given = joint.limits or LimitSpec()
    lower = -math.inf if given.lower is None else given.lower
    upper, speed, acceleration = (math.inf if value is None else value for value in (
        given.upper, given.velocity, given.acceleration))
    if arm.urdf is not None:
        inner = arm.full_model.joints[arm.full_model.getJointId(joint.name)]
        described = (float(arm.full_model.lowerPositionLimit[inner.idx_q]),
                     float(arm.full_model.upperPositionLimit[inner.idx_q]))
        if described[0] < described[1] and max(-described[0], described[1]) < UNLIMITED:
            lower, upper = max(lower, described[0]), min(upper, described[1])
        fastest = float(arm.full_model.velocityLimit[inner.idx_v])
        if 0.0 < fastest < UNLIMITED:
            speed = min(speed, fastest)
    motor = next((motor for motor in arm.spec.motors if motor.joint == joint.name), None)
    if motor is not None and motor.current_limit and motor.reflected_inertia > 0.0:
        acceleration = min(acceleration, motor.current_limit * motor.joint_torque_constant
                           / motor.reflected_inertia)
    return lower, upper, speed, acceleration


def hard_limits(arm: Arm) -> Limits:
    """Give what the joints of an arm never exceed."""
    rows = np.array([_of_joint(arm, joint) for joint in arm.joints]).reshape(-1, 4)
    missing = [f'{joint.name}: no limit of {what}'
               for joint, row in zip(arm.joints, rows, strict=True)
               for what, value in zip(('position downwards', 'position upwards', 'velocity',
                                       'acceleration'), row, strict=True)
               if not math.isfinite(value)]
    return Limits(rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3], tuple(missing))


def planned_limits(arm: Arm) -> Limits:
    """
    Give what planned motion of an arm keeps to.

    Parameters
    ----------
    arm : Arm
        Description; where ``planned`` says nothing, parts of the hard limits are taken, and a
        range that leaves the way in which the hard acceleration stops the planned speed twice.

    """
    hard = hard_limits(arm)
    given = [joint.planned or PlannedSpec() for joint in arm.joints]

    def chosen(key: str, default: FloatArray) -> FloatArray:
        return np.array([value if getattr(item, key) is None else getattr(item, key)
                         for item, value in zip(given, default, strict=True)], dtype=float)
    velocity = np.minimum(chosen('velocity', PLANNED_SPEED * hard.velocity), hard.velocity)
    acceleration = np.minimum(chosen('acceleration', PLANNED_ACCELERATION * hard.acceleration),
                              hard.acceleration)
    with np.errstate(invalid='ignore'):
        room = np.nan_to_num(velocity**2 / hard.acceleration, nan=0.0, posinf=0.0)
    room = np.minimum(room, 0.1 * np.where(np.isfinite(hard.upper - hard.lower),
                                           hard.upper - hard.lower, 0.0))
    return Limits(chosen('lower', hard.lower + room), chosen('upper', hard.upper - room),
                  velocity, acceleration, hard.missing)


def effort_limits(arm: Arm) -> FloatArray:
    """Give the largest effort (joints,) [A, N m or N] of active joints, infinite where unknown."""
    largest = np.full(len(arm.joints), np.inf)
    for i, joint in enumerate(arm.joints):
        constant = joint.effort.torque_constant
        motor = next((motor for motor in arm.spec.motors if motor.joint == joint.name), None)
        if motor is not None and motor.current_limit:
            largest[i] = motor.current_limit * (
                1.0 if joint.effort.unit == 'A' else motor.joint_torque_constant)
        if arm.urdf is not None and (joint.effort.unit != 'A' or constant is not None):
            inner = arm.full_model.joints[arm.full_model.getJointId(joint.name)]
            described = float(arm.full_model.effortLimit[inner.idx_v])
            if 0.0 < described < UNLIMITED:
                largest[i] = min(largest[i], described / (constant or 1.0))
    return largest


def drive_stop(arm: Arm) -> DriveStop:
    """Give how the drives of an arm stop by themselves."""
    damper = arm.spec.damper
    return DriveStop(DRIVE_TIMEOUT if damper is None else damper.drive_timeout,
                     planned_limits(arm).acceleration)


# Distances between links use the shapes that the URDF has for collisions. Meshes are replaced by
# their convex hulls, which enclose them and make distances cheap and signed. Links that a joint
# connects touch always, and are no pair; neither are those that an SRDF takes out, nor hulls that
# overlap in nearly all poses. Links without shapes are capsules between the frames of joints. What
# surrounds the arm is a floor or a box, of walls that all links that move keep away from.

MAX_MESH_BYTES = 50_000_000
MAX_SRDF_BYTES = 20_000_000
MESHES = ('.stl', '.dae', '.obj')
POSES, ALWAYS = 200, 0.9
"""Random poses, and the part of them at which a pair overlaps that is left out."""
RADIUS = 0.05  # of capsules in place of links without shapes [m]
THICK = 20.0  # of walls, which are boxes [m]
Wall = tuple[FloatArray, FloatArray]
"""Normal that points to the arm's side (3,), and a point (3,) [m], in the base frame."""


def walls_of(arm: Arm, floor: float | None, box: Sequence[float] | None) -> list[Wall]:
    """Give the walls of a floor [m above the base] and of a box [x, x, y, y, z, z in m]."""
    gravity = np.array(arm.spec.gravity, dtype=float)
    up = -gravity / np.linalg.norm(gravity) if gravity.any() else np.array([0.0, 0.0, 1.0])
    found = [] if floor is None else [(up, floor * up)]
    for axis, low, high in () if box is None else zip(np.eye(3), box[::2], box[1::2], strict=True):
        found += [(axis, low * axis), (-axis, high * axis)]
    return found


@dataclass(frozen=True, eq=False)
class Nearness:
    """Pairs of links that are near to each other, at one pose."""

    distance: FloatArray  # of pairs nearer than asked for, negative if they overlap, (pairs,) [m]
    slope: FloatArray  # its derivatives by the active joints, (pairs, joints) [m/rad or m/m]
    names: tuple[tuple[str, str], ...]  # links of each pair


class SelfCollision:
    """Pairs of links of an arm whose shapes are known."""

    def __init__(
        self, arm: Arm, folders: tuple[Path, ...] = (), srdf: Path | None = None,
        walls: Sequence[Wall] = (), radius: float | None = None,
    ) -> None:
        self._model = arm.model
        self._index = arm.velocity_index
        self._q = np.zeros(arm.model.nq)
        self._geometry = pin.GeometryModel()
        missing: list[str] = []
        if arm.urdf is not None:
            self._geometry = _shapes(arm, folders, missing)
        shapes = len(self._geometry.geometryObjects)
        capsules = 0 if radius is None else self._add_capsules(radius)
        self._walls = len(walls)
        for number, (normal, point) in enumerate(walls):
            self._add(f'wall {number + 1}_', 0, fcl.Box(THICK, THICK, THICK),
                      point - 0.5 * THICK * normal, normal)
        left_out = self._add_pairs(srdf)
        self._renew()
        if self.pairs:
            left_out += self._drop_always(arm)
        self.note = (
            'no shapes of links in the description: self-collisions are not looked at' if not
            shapes and not missing and not capsules else
            f'self-collisions: {self.pairs} pairs of links and walls, by {shapes} shapes')
        if capsules:
            self.note += f' and {capsules} capsules of {radius:g} m from joint to joint'
        if missing:
            self.note += (f'; {len(missing)} shapes are left out, as their meshes are not there ('
                          f'{missing[0]}{", ..." if len(missing) > 1 else ""}): name their folder')
        if left_out:
            self.note += f'; {left_out} pairs overlap always, or are taken out by the SRDF'

    @property
    def pairs(self) -> int:
        """Count the pairs of shapes that are looked at."""
        return len(self._geometry.collisionPairs)

    def _add(
        self, name: str, joint: int, shape: Any, centre: FloatArray, axis: FloatArray,
    ) -> None:
        """Add a shape whose z axis points along another one."""
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).matrix()
        self._geometry.addGeometryObject(
            pin.GeometryObject(name, joint, pin.SE3(turn, centre), shape))

    def _add_capsules(self, radius: float) -> int:
        """Let links without shapes be capsules from joint to joint, the last one to the tip."""
        model = self._model
        shaped = {item.parentJoint for item in self._geometry.geometryObjects}
        ends: dict[int, list[FloatArray]] = {
            k: [] for k in range(model.njoints) if k not in shaped}
        for k in range(1, model.njoints):
            ends.get(model.parents[k], []).append(model.jointPlacements[k].translation)
        for k in (k for k, found in ends.items() if k and not found):
            frames = [frame.placement.translation for frame in model.frames
                      if frame.parentJoint == k]
            ends[k] = [max(frames, key=np.linalg.norm)] if frames else [np.zeros(3)]
        found = [(k, end) for k, places in ends.items() for end in places if k or end.any()]
        for k, end in found:
            length = float(np.linalg.norm(end))
            shape = fcl.Capsule(radius, length) if length > radius else fcl.Sphere(radius)
            self._add(f'{model.names[k]}_', k, shape, 0.5 * end,
                      end if length > radius else np.array([0.0, 0.0, 1.0]))
        return len(found)

    def _renew(self) -> None:
        self._data = self._model.createData()
        self._seen = pin.GeometryData(self._geometry)

    def _add_pairs(self, srdf: Path | None) -> int:
        disabled = set() if srdf is None else {
            frozenset((item.get('link1', ''), item.get('link2', ''))) for item in parse(
                read_text(srdf, MAX_SRDF_BYTES, 'the SRDF', ArmError),
                str(srdf)).iter('disable_collisions')}
        objects, parents = self._geometry.geometryObjects, self._model.parents
        left_out = 0
        for i, k in itertools.combinations(range(len(objects)), 2):
            a, b = objects[i].parentJoint, objects[k].parentJoint
            wall = k >= len(objects) - self._walls  # stands at the end, and at the base
            if a == b or not wall and (parents[a] == b and a > 0 or parents[b] == a and b > 0):
                continue
            if frozenset((self._link(i), self._link(k))) in disabled:
                left_out += 1
            else:
                self._geometry.addCollisionPair(pin.CollisionPair(i, k))
        return left_out

    def _drop_always(self, arm: Arm) -> int:
        generator = np.random.default_rng(0)
        count = np.zeros(self.pairs)
        for _ in range(POSES):
            self._look(generator.uniform(-np.pi, np.pi, len(arm.active_joints)))
            count += [result.min_distance <= 0.0 for result in self._seen.distanceResults]
        always = [pin.CollisionPair(pair.first, pair.second)  # what is removed moves the others
                  for pair, times in zip(self._geometry.collisionPairs, count, strict=True)
                  if times >= ALWAYS * POSES]
        for pair in always:
            self._geometry.removeCollisionPair(pair)
        self._renew()
        return len(always)

    def _link(self, place: int) -> str:
        return str(self._geometry.geometryObjects[place].name).rsplit('_', 1)[0]

    def _look(self, q: FloatArray) -> None:
        self._q[self._index] = q
        pin.computeDistances(self._model, self._data, self._geometry, self._seen, self._q)

    def near(self, q: FloatArray, margin: float) -> Nearness:
        """Find the pairs that are nearer than a margin: q (joints,) [rad or m], margin [m]."""
        self._look(q)
        found = [(pair, result) for pair, result in zip(
            self._geometry.collisionPairs, self._seen.distanceResults, strict=True)
            if result.min_distance < margin]
        slope = np.zeros((len(found), len(q)))
        if found:
            pin.computeJointJacobians(self._model, self._data, self._q)
        for row, (pair, result) in zip(slope, found, strict=True):
            for sign, place, point in ((-1.0, pair.first, result.getNearestPoint1()),
                                       (1.0, pair.second, result.getNearestPoint2())):
                joint = self._geometry.geometryObjects[place].parentJoint
                jacobian = pin.getJointJacobian(
                    self._model, self._data, joint, pin.ReferenceFrame.WORLD)
                normal = np.asarray(result.normal).ravel()
                # n (v + w x p) = n v + w (p x n)
                lever = np.cross(np.asarray(point).ravel(), normal)
                row += sign * (normal @ jacobian[:3] + lever @ jacobian[3:])[self._index]
        return Nearness(
            np.array([result.min_distance for _, result in found]), slope,
            tuple((self._link(pair.first), self._link(pair.second)) for pair, _ in found))


def _shapes(arm: Arm, folders: tuple[Path, ...], missing: list[str]) -> pin.GeometryModel:
    """Build the shapes of the reduced arm; names of meshes that are not there are appended."""
    assert arm.urdf is not None
    root = parse(arm.urdf, arm.source)
    home = Path(arm.source).parent / (arm.spec.kinematics.urdf or '')
    for link in root.iter('link'):
        for collision in link.findall('collision'):
            mesh = collision.find('geometry/mesh')
            if mesh is None:
                continue
            path = _mesh(mesh.get('filename', ''), (home.parent, *folders))
            if path is None:
                missing.append(mesh.get('filename', ''))
                link.remove(collision)
            else:
                mesh.set('filename', str(path))
    adapt(root, arm.source, drawn=('visual',))
    check_numbers(root, arm.source)
    text = ElementTree.tostring(root, encoding='unicode')
    try:
        geometry = pin.buildGeomFromUrdfString(arm.full_model, text, pin.GeometryType.COLLISION)
    except (ValueError, RuntimeError) as err:
        raise ArmError(f'the <collision> elements of the URDF cannot be read ({err})',
                       place=arm.source, remedy='correct them in the URDF') from None
    for item in geometry.geometryObjects:
        if hasattr(item.geometry, 'buildConvexHull'):
            with suppress(RuntimeError, ValueError):  # flat ones stay what they are
                item.geometry.buildConvexHull(True, 'Qt')
                item.geometry = item.geometry.convex
    locked = [arm.full_model.getJointId(name) for name in arm.held_joints]
    if not locked:
        return geometry
    return pin.buildReducedModel(arm.full_model, geometry, locked, arm.held_pose()[0])[1]


def _mesh(name: str, folders: tuple[Path, ...]) -> Path | None:
    """Find a mesh of bounded size, by the longest end of its path that is there; or None."""
    parts = Path(name.removeprefix('package://').removeprefix('file://')).parts
    shared = [Path(part) / 'share' for part in os.environ.get(
        'AMENT_PREFIX_PATH', '').split(os.pathsep) if part]
    for first in range(len(parts)):
        for folder in (*folders, *shared):
            candidate = folder.joinpath(*parts[first:])
            if (candidate.suffix.lower() in MESHES and candidate.is_file()
                    and candidate.stat().st_size <= MAX_MESH_BYTES):
                return candidate.resolve()
    return None
