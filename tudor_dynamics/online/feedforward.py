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

"""Feed-forward: efforts and motor positions that a wanted motion needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.limits import hard_limits
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.compiled import compiled, unowned
from tudor_dynamics.errors import ModelError, SignalError, SimulationError
from tudor_dynamics.load.rows import load_worth
from tudor_dynamics.mechanics import chain as at
from tudor_dynamics.mechanics.chain import (
    add, Chain, cholesky, cross, forward, rotation_at, solve, sub, turn, Vector, vector_at)
from tudor_dynamics.mechanics.equations import point_motion
from tudor_dynamics.models.base import Model, SAME, SLIDING
from tudor_dynamics.models.bundle import elastic_of, ModelBundle
from tudor_dynamics.models.elastic.arm import Response
from tudor_dynamics.models.elastic.kernel import (
    DDZ, driven_of, DZ, FORCE, gear, Gears, needed, shorten, STIFFNESS, Z)
from tudor_dynamics.models.elastic.model import driven_arm, ElasticModel
from tudor_dynamics.online.settings import HELD_WITHIN, LEAST_LEVER, NEWTON_SETTLED, NEWTON_STEPS
from tudor_dynamics.signals.motion_profile import states
from tudor_dynamics.typing import finite_array, FloatArray, Shown


Unit = Literal['model', 'current', 'torque']
UNITS: tuple[Unit, ...] = ('model', 'current', 'torque')
"""As the model has it; currents [A]; torques of the motors at the joints [N m, or N]."""


def factors(arm: Arm, unit: Unit) -> FloatArray:
    """Give what efforts of a model are multiplied by, gear and efficiency in it; (joints,)."""
    result = np.ones(len(arm.joints))
    for i, (joint, constant) in enumerate(zip(arm.joints, arm.torque_constants, strict=True)):
        is_current = joint.effort.unit == 'A'
        if unit == 'model' or is_current == (unit == 'current'):
            continue
        if np.isnan(constant):
            msg = (f'joint {joint.name!r}: efforts cannot be converted from '
                   f'{joint.effort.unit} to {unit}, as the joint has no torque constant')
            raise ModelError(msg, remedy='add joints[].effort.torque_constant to the arm descrip'
                                         'tion and fit again, or give unit= model')
        result[i] = constant if unit == 'torque' else 1.0 / constant
    return result


AtRest = Literal['none', 'kept']
AT_REST: tuple[AtRest, ...] = ('none', 'kept')
"""None; or that of the last motion, until the joint moves the other way."""


def kept_speeds(speed: FloatArray, turning: ArrayLike) -> FloatArray:
    """
    Give speeds at which friction is what a joint keeps at rest, in place of slow ones.

    A bristle that was bent by sliding stays bent when the joint stops, and straightens only when
    it moves back (Dupont et al., "Single state elastoplastic friction models", IEEE TAC 47(5),
    2002). So below the speed of sliding the sign is that of the last motion that was faster than
    where the sign of friction turns.
    """
    moves = np.abs(speed) >= np.asarray(turning)
    latest = np.maximum.accumulate(np.where(moves, np.arange(len(speed))[:, None], -1), axis=0)
    signs = np.where(latest >= 0, np.sign(
        np.take_along_axis(speed, np.maximum(latest, 0), axis=0)), 0.0)
    slow = (np.abs(speed) < SLIDING) & (signs != 0.0)
    return np.where(slow, signs * SLIDING, speed)


# Which motor positions put bent links where they are wanted, point by point, compiled.
#
# Links and gears follow their load at once: the load of the wanted motion, weight and inertia,
# bends them as if it were at rest (the rigid load). For springs in the joints with masses after
# them that is the inversion of De Luca, "Decoupling and feedback linearization of robots with
# mixed rigid/ elastic joints", IEEE ICRA 1996, Eq. (8), without the inertia of what bends:
# vibrations are none of its business, but a motion that follows it does not begin any, as far as
# they are slower than it.
#
# Bending is found by Newton's steps with the stiffness of the links alone; the joints turn by what
# brings the ends of the flexible links, and the tip, nearest to where those of a rigid arm are.
# All ends count, not the tip alone: of a stretched arm that could be had by large turns only.


class Inverse(NamedTuple):
    """What the inversion needs of the arm."""

    bends: NDArray  # coordinates of the links that bend, (bends,)
    # (ends,): bodies whose ends are put where they are wanted: flexible links, and what is at the
    # tip.
    ends: NDArray
    joint: NDArray  # body after each driven joint, (joints,)
    moved: NDArray  # 1 where a joint moves an end, (ends, joints)


@compiled
def twist_of(row: NDArray, torque: float) -> float:
    """Give the twist at which a gear with play holds a torque at rest [rad]; inverse of `gear`."""
    edge = row[1] if torque > 0.0 else -row[1]
    twist = torque / row[0] + edge
    for _ in range(50):
        found, slope, _ = gear(row, twist, 0.0)
        change = (torque - found) / max(slope, 0.02 * row[0])
        twist += change
        if abs(change) < 1e-12:
            break
    return twist


@compiled
def _end(tables: Inverse, e: int, vectors: NDArray, chain: Chain) -> Vector:
    """Give where the end of a beam of one element, or the frame of a rigid body, is [m]."""
    body = tables.ends[e]
    return point_motion(vectors[Z], vectors[DZ], chain, body, chain.body_int[body, at.FLEXIBLE])[0]


@compiled
def _aim(tables: Inverse, vectors: NDArray, chain: Chain, wanted: NDArray, turns: NDArray) -> bool:
    """Find the turns (joints,) by which the ends are nearest to where wanted (ends, 3) [m]."""
    n, ends = len(turns), len(tables.ends)
    levers, missing = np.zeros((n, 3 * ends)), np.zeros(3 * ends)
    for e in range(ends):
        end = _end(tables, e, vectors, chain)
        for i in range(3):
            missing[3 * e + i] = wanted[e, i] - end[i]
        for j in range(n):
            if tables.moved[e, j] > 0.0:
                lever = _lever(chain, tables.joint[j], end)
                for i in range(3):
                    levers[j, 3 * e + i] = lever[i]
    normal = levers @ levers.T
    normal += (LEAST_LEVER * normal.max() + 1e-30) * np.eye(n)
    turns[:] = levers @ missing
    if not cholesky(normal):
        return False
    solve(normal, turns)
    return True


@compiled
def _lever(chain: Chain, body: int, end: Vector) -> Vector:
    """Give how fast an end moves with the joint in front of a body [m/rad, or 1]."""
    here, parent = chain.moving[body], chain.body_int[body, at.PARENT]
    axis, place = vector_at(here, at.AXIS_AT), vector_at(here, at.JOINT_AT)
    if parent >= 0:
        frame = rotation_at(chain.moving[parent], at.WORLD)
        axis = turn(frame, axis)
        place = add(vector_at(chain.moving[parent], at.ORIGIN), turn(frame, place))
    if chain.body_int[body, at.JOINT] == at.PRISMATIC:
        return axis
    return cross(axis, sub(end, place))


@compiled
def _solve_point(
    tables: Inverse, factor: NDArray, vectors: NDArray, gears: Gears, chain: Chain, reach: bool,
    q: NDArray, wanted: NDArray,
) -> bool:
    """Bend the links under their load, and turn the joints; the state begins at the last point."""
    z, force, bends = vectors[Z], vectors[FORCE], tables.bends
    turns = np.zeros(len(tables.joint))
    for _ in range(NEWTON_STEPS):
        needed(vectors, chain, False)
        largest = 0.0
        if reach and not _aim(tables, vectors, chain, wanted, turns):
            return False
        for s in range(gears.place.shape[0]):
            i = gears.place[s]
            if reach:
                change = turns[s]
            else:
                change = q[s] + twist_of(gears.springs[s], -force[i]) - z[i]
            z[i] += change
            largest = max(largest, abs(change))
        bent = -force[bends]
        solve(factor, bent)
        for a in range(len(bends)):
            z[bends[a]] += bent[a]
            largest = max(largest, abs(bent[a]))
        if largest < NEWTON_SETTLED:
            return True
        if not largest < 10.0:
            return False
    return False


@compiled
def invert(
    q: NDArray, dq: NDArray, ddq: NDArray, reach: bool, motor: NDArray, torque: NDArray,
    tables: tuple[NDArray, ...], *arrays: NDArray,
) -> int:
    """Invert points, each by itself: places of motors and torques of gears, (points, joints)."""
    driven, own = driven_of(arrays), Inverse(*unowned(tables))
    equations, gears, chain = driven.equations, driven.gears, driven.chain
    vectors, bends = equations.vectors, own.bends
    z = vectors[Z]
    factor = equations.matrices[STIFFNESS][bends][:, bends]
    if not cholesky(factor):
        return 0
    wanted = np.zeros((len(own.ends), 3))
    for k in range(q.shape[0]):
        for row in (DZ, DDZ):
            vectors[row, :] = 0.0
        # the bends of the point before are where the search begins
        before = z[bends]
        z[bends] = 0.0
        for s in range(gears.place.shape[0]):
            i = gears.place[s]
            z[i], vectors[DZ, i], vectors[DDZ, i] = q[k, s], dq[k, s], ddq[k, s]
        if reach:
            shorten(z, vectors[DZ], vectors[DDZ], chain.body_int, chain.body_float)
            forward(z, vectors[DZ], vectors[DDZ], chain, 0.0)
            for e in range(own.ends.shape[0]):
                end = _end(own, e, vectors, chain)
                for i in range(3):
                    wanted[e, i] = end[i]
        if k > 0:
            z[bends] = before
        if not _solve_point(own, factor, vectors, gears, chain, reach, q[k], wanted):
            return k
        needed(vectors, chain, False)
        for s in range(gears.place.shape[0]):
            i = gears.place[s]
            torque[k, s] = vectors[FORCE, i]
            motor[k, s] = z[i] - twist_of(gears.springs[s], -vectors[FORCE, i])
    return q.shape[0]


class DeflectedArm:
    """An elastic arm under the load of a wanted motion."""

    def __init__(self, arm: Arm, values: Mapping[str, float]) -> None:
        self._driven = driven_arm(arm, values)
        mechanism, gears = self._driven.mechanism, self._driven.tables.gears
        joint = np.array([mechanism.body_of[name] for name in arm.active_joints], dtype=np.int64)
        springs = set(gears.place.tolist())
        bends = np.array([i for i in self._driven.tables.equations.free.tolist()
                          if i not in springs], dtype=np.int64)
        ends = np.array([*(mechanism.body_of[name] for name in mechanism.beams),
                         len(mechanism.body_int) - 1], dtype=np.int64)
        carriers: dict[int, set[int]] = {-1: set()}  # a body, and all that carry it
        for body, parent in enumerate(mechanism.body_int[:, at.PARENT].tolist()):
            carriers[body] = {*carriers[parent], body}
        moved = np.array([[float(body in carriers[end]) for body in joint.tolist()]
                          for end in ends.tolist()])
        self._tables = tuple(Inverse(bends, ends, joint, moved))
        self._name = arm.name

    @property
    def payload(self) -> float:
        """Give the mass at the tip [kg]."""
        return self._driven.parameters['payload']

    def carry(self, payload: float) -> None:
        """Put another mass at the tip: payload [kg]."""
        self._driven.set_parameters({'payload': payload})

    def under(self, motion: FloatArray, *, reach: bool) -> tuple[FloatArray, FloatArray]:
        """
        Bend the arm under the load of a motion (points, 3 joints), each point by itself.

        Returns positions of the motors, as their encoders show them [rad or m], and the torque (or
        force) of each gear on the links [N m or N], (points, joints).
        """
        q, dq, ddq = (np.ascontiguousarray(part) for part in np.split(motion, 3, axis=1))
        motor, torque = np.zeros_like(q), np.zeros_like(q)
        done = invert(q, dq, ddq, reach, motor, torque, self._tables, *self._driven.arrays)
        if done < len(q):
            msg = (f'{self._name}: links and gears cannot hold point {done + 1} of {len(q)} of '
                   f'the motion, at the positions {np.round(q[done], 3).tolist()}')
            raise SimulationError(msg, remedy='move more slowly there, or correct the stiffness '
                                              'of links and gears in the arm description')
        return motor, torque


# Efforts that a wanted motion needs, for controllers that add them to what errors ask for.
#
# The model is that of the bundle, asked at the wanted motion in place of the measured one: nothing
# of it is noisy or late, and friction has the sign of the wanted speed. That sign is smoothed
# about standstill as the model was fitted (``friction_velocity``): at rest friction is zero, since
# a joint that stands keeps what friction it came to rest with, and a plain sign would shake it.

Positions = Literal['wanted', 'motor']
POSITIONS: tuple[Positions, ...] = ('wanted', 'motor')


class Feedforward(Shown):
    """
    Feed-forward of one arm.

    Parameters
    ----------
    bundle : ModelBundle
        Models with efforts.
    kind : str, default='analytical'
        Kind of model that gives the efforts; 'elastic' bends the links under their load.
    unit : {'model', 'current', 'torque'}
        What efforts are given as.
    positions : {'wanted', 'motor'}
        Whether a wanted motion is that of the motors, which is passed on; or that of the links,
        for which the motors are led further.
    friction_at_rest : {'none', 'kept'}
        What friction is at rest along a trajectory: none, so that the weight alone is held; or
        that of the last motion, which real joints keep.
    payload : float, optional
        Mass at the tip [kg]; by default that of the training bags, or that of the elastic arm.

    Attributes
    ----------
    joints : tuple of str
        Joints, in the order of all arrays.
    units : tuple of str
        Unit of each joint's effort.
    payload : float
        Mass at the tip [kg].

    Raises
    ------
    ModelError
        If the bundle has no such model of efforts, a torque constant is not known, the model knows
        nothing of the payload, or the arm has no flexible links.

    """

    def __init__(
        self, bundle: ModelBundle, *, kind: str = 'analytical', unit: Unit = 'model',
        positions: Positions = 'wanted', friction_at_rest: AtRest = 'none',
        payload: float | None = None,
    ) -> None:
        arm, efforts = bundle.arm, bundle.models.get('effort', {})
        if kind not in efforts:
            msg = (f'kind= {kind}: for efforts the model has the kinds '
                   f'{", ".join(efforts) or "none"}')
            raise ModelError(msg, remedy=f'choose one of these, or run tudor fit --models {kind}')
        self.joints = arm.active_joints
        self.units = tuple(
            joint.effort.unit if unit == 'model' else 'A' if unit == 'current' else
            'N' if arm.is_prismatic(joint.name) else 'N m' for joint in arm.joints)
        self._held = {joint.name: joint.hold for joint in arm.spec.joints
                      if joint.name not in self.joints}
        self._factor = factors(arm, unit)
        self._turning = np.array([joint.friction_velocity for joint in arm.joints])
        self._keeps = friction_at_rest == 'kept'
        self._of_all = efforts[kind]
        self._deflected: DeflectedArm | None = None
        self._leads = positions == 'motor'
        self._limits = hard_limits(arm)
        self._unit = arm.position_units
        if self._leads or kind == 'elastic':
            identified = elastic_of(bundle, 'strain') or elastic_of(bundle, 'effort')
            self._deflected = DeflectedArm(arm, {} if identified is None else identified.values)
        known = self._of_all.payload_range
        of_bags = bundle.payload if known is None else known[0]
        described = 0.0 if self._deflected is None else self._deflected.payload
        self._known = described if of_bags is None else of_bags
        # what a kilogram adds, for a model of one payload that does not know itself
        self._per_kilogram = None if known is not None or kind != 'analytical' else load_worth(
            arm, {'effort': {kind: self._of_all}}).get('effort')
        self._model: Model = self._of_all
        self.carry(self._known if payload is None else payload)

    def carry(self, payload: float) -> None:
        """
        Take another mass at the tip [kg].

        A ModelError if it is no mass, or if the model is of one payload and nothing says what a
        kilogram more changes.
        """
        more = payload - self._known
        if not 0.0 <= payload < float('inf'):
            raise ModelError(f'payload= {payload:g} kg: give 0 or more')
        elastic = self._of_all.has_memory
        if self._of_all.payload_range is not None or (elastic and abs(more) > SAME):
            self._model = self._of_all.at(payload)
        elif self._per_kilogram is None and abs(more) > SAME:
            msg = (f'the model was fitted to a load of {self._known:g} kg, and cannot '
                   f'convert its efforts to {payload:g} kg')
            raise ModelError(msg, remedy='fit a model to bags of two known loads, or '
                                         'add torque constants to the arm description')
        if self._deflected is not None:
            self._deflected.carry(payload)
        self.payload = payload

    def efforts(self, motion: FloatArray) -> FloatArray:
        """Give the efforts, in ``units``, of states ``[q, dq, ddq]`` of motors, each by itself."""
        motion = finite_array(motion, 'motion', None, 3 * len(self.joints))
        return self._asked(motion, motion)

    def _asked(
        self, motion: FloatArray, felt: FloatArray, torque: FloatArray | None = None,
    ) -> FloatArray:
        """Ask the model for the motion of the joints; torque of gears of bent links."""
        if isinstance(self._model, ElasticModel):
            assert self._deflected is not None
            if torque is None:
                _, torque = self._deflected.under(motion, reach=False)
            found = self._model.prepared()(Response(np.zeros((len(motion), 0)), torque), felt)
        else:
            found = self._model.predict(felt)
            more = self.payload - self._known
            if self._per_kilogram is not None and abs(more) > SAME:
                found = found + more * self._per_kilogram.along(felt)
        return np.asarray(found * self._factor)

    def along(self, trajectory: Trajectory) -> Trajectory:
        """
        Give a trajectory of ``joints``, in any order, with the efforts that it needs.

        Joints that the description holds may be in it, as long as they stay where it holds them;
        they get no efforts. Where motors are led, it has their positions, velocities and
        accelerations. A SignalError says which joints are missing or unknown, which held one
        moves, or which motor would have to be led beyond its limits; a SimulationError, that
        links are too weak for the load.
        """
        self._check_held(trajectory)
        motion = states(trajectory.of(self.joints))
        places = [trajectory.joints.index(name) for name in self.joints]
        torque: FloatArray | None = None
        led: dict[str, Any] = {}
        if self._leads:
            assert self._deflected is not None
            wanted, speed, change = np.split(motion, 3, axis=1)
            motor, torque = self._deflected.under(motion, reach=True)
            self._check_limits(motor, wanted)
            rate, rise = _derivatives(trajectory.t, motor - wanted, speed)
            motion = np.hstack([motor, speed + rate, change + rise])
            led = {name: _put(trajectory, getattr(trajectory, name), places, own) for name, own
                   in zip(('q', 'dq', 'ddq'), np.split(motion, 3, axis=1), strict=True)}
        felt = motion
        if self._keeps:
            n, felt = len(self.joints), motion.copy()
            felt[:, n:2 * n] = kept_speeds(motion[:, n:2 * n], self._turning)
        effort = self._asked(motion, felt, torque)
        return replace(trajectory, effort=_put(trajectory, None, places, effort), **led)

    def _check_limits(self, motor: FloatArray, wanted: FloatArray) -> None:
        """Refuse to lead a motor beyond a limit that the wanted motion keeps to."""
        low, high = self._limits.lower, self._limits.upper
        beyond = ((motor < low) | (motor > high)) & (wanted >= low) & (wanted <= high)
        if beyond.any():
            point, joint = np.argwhere(beyond)[0]
            name = self.joints[joint]
            msg = (f'at point {point + 1} of {len(motor)}, the motor of {name!r} has to be at '
                   f'{motor[point, joint]:.4g} to compensate bending, beyond its position limits '
                   f'{low[joint]:.4g} to {high[joint]:.4g} {self._unit[name]}')
            raise SignalError(msg, remedy='keep the wanted motion further from these limits')

    def _check_held(self, trajectory: Trajectory) -> None:
        """Refuse joints that the model knows nothing of, and held ones that move."""
        for name, column in zip(trajectory.joints, trajectory.q.T, strict=True):
            if name in self.joints:
                continue
            if name not in self._held:
                msg = (f'the trajectory has the joint {name!r}, but the model has the joints '
                       f'{", ".join((*self.joints, *self._held))}')
                raise SignalError(msg, remedy='name joints as the arm description does')
            off = np.abs(column - self._held[name])
            if off.max() > HELD_WITHIN:
                msg = (f'the model holds {name!r} at {self._held[name]:g} {self._unit[name]}, but '
                       f'point {int(off.argmax()) + 1} moves it to {column[off.argmax()]:g}')
                raise SignalError(msg, remedy=f'hold {name!r} at {self._held[name]:g}, or fit a '
                                              'model with it among active_joints')


def _put(
    trajectory: Trajectory, given: FloatArray | None, places: list[int], own: FloatArray,
) -> FloatArray:
    """Put columns of the model's joints among those of a trajectory, zero where none are given."""
    whole = np.zeros_like(trajectory.q) if given is None else given.copy()
    whole[:, places] = own
    return whole


def _derivatives(
    t: FloatArray, values: FloatArray, speed: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Differentiate along the points twice; a single point rests."""
    if len(t) < 2:
        return np.zeros_like(values), np.zeros_like(values)
    ends = tuple((1, np.zeros(values.shape[1])) if not speed[row].any() else
                 (2, np.zeros(values.shape[1])) for row in (0, -1))
    spline = CubicSpline(t, values, bc_type=ends)
    rate, rise = spline(t, 1), spline(t, 2)
    rise[[row for row in (0, -1) if not speed[row].any()]] = 0.0  # what rests is held as it is
    return np.asarray(rate), np.asarray(rise)
