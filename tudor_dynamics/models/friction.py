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

"""Friction terms, presliding, rotor inertia and coupled drives, as rows and in compiled code."""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import JointSpec
from tudor_dynamics.compiled import compiled
from tudor_dynamics.models.rigid_bodies import RigidBodies
from tudor_dynamics.signals.preprocessing import Stretch
from tudor_dynamics.typing import FloatArray


# -- Coupled drives in the rows: what is measured at motors, and what each effort feels of them.
#
# With the speeds of the motors ``w = C dq`` (those of uncoupled drives, behind their gears, are
# ``dq``), friction and rotor inertia f(w) of the motors reach the joints as ``C' f(w)``, since
# both sides do the same work; a motor feels ``C^-T`` of what the bodies ask of the joints.

class Coupling:
    """From what is measured to joints and motors, and back: speeds, reach (joints, joints)."""

    def __init__(self, arm: Arm) -> None:
        matrix, spec = arm.coupling, arm.spec.couplings
        n = len(arm.active_joints)
        self.speeds = np.eye(n) if matrix is None else matrix
        self.reach = np.eye(n)
        self._mixture: FloatArray | None = None
        self._joints: FloatArray | None = None
        self._alone = matrix is None
        if spec is None or matrix is None:
            return
        if spec.positions == 'motors':
            self._joints = np.asarray(np.linalg.inv(matrix))
        if spec.efforts == 'joints':
            self.reach = np.ascontiguousarray(matrix.T)
        else:
            self._mixture = np.asarray(np.linalg.inv(matrix).T)

    def of_joints(self, motion: FloatArray) -> FloatArray:
        """
        Give the motion of the joints.

        motion (samples, 3 joints): ``[q, dq, ddq]`` as measured
        [rad, rad/s, rad/s^2 or m, m/s, m/s^2].
        """
        if self._joints is None:
            return motion
        n = len(self._joints)
        return np.hstack([motion[:, i * n:(i + 1) * n] @ self._joints.T for i in range(3)])

    def drive_places(self, q: FloatArray) -> FloatArray:
        """
        Give what the motors have turned by, behind their gears.

        q (samples, joints) [rad or m].
        """
        if self._alone:
            return q
        joints = q if self._joints is None else q @ self._joints.T
        return joints @ self.speeds.T

    def mix(self, rows: FloatArray) -> None:
        """
        Turn rows of the joints into rows of what is measured, in place.

        rows (samples, joints, columns).
        """
        if self._mixture is not None:
            rows[:] = np.einsum('ij,kjp->kip', self._mixture, rows)

    def body_efforts(
        self, bodies: RigidBodies, motion: FloatArray, parameters: FloatArray,
    ) -> FloatArray:
        """
        Evaluate what the bodies ask of each effort.

        parameters (joints, columns); motion (samples, 3 joints): ``[q, dq, ddq]`` of the joints
        [rad, rad/s, rad/s^2 or m, m/s, m/s^2]; returns (samples, joints) [N m or N].
        """
        out = np.empty((len(motion), len(parameters)))
        bodies.outputs(motion, parameters, out)
        if self._mixture is None:
            return out
        mixed = out * np.diag(self._mixture)
        for i, j in np.argwhere((self._mixture != 0.0) & ~np.eye(len(out.T), dtype=bool)):
            # an effort has parameters of its own: those of i, at the joint j
            bodies.outputs(motion, np.tile(parameters[i], (len(parameters), 1)), out)
            mixed[:, i] += self._mixture[i, j] * out[:, j]
        return mixed


# -- Friction as regressor columns, continuous at standstill.
#
# Malzahn et al., Eq. (2), prints k_v+ as a constant, which makes two columns equal. What is meant
# is a viscous and a Coulomb coefficient for each direction: columns ``dq s+``, ``dq s-``, ``s+``,
# ``s-``. The switches are smoothed, ``s+ = (1 + tanh(dq / v0)) / 2``, because at standstill a
# plain sign chatters between the two directions with the encoder's last bit.

(_VISCOUS, _VISCOUS_FORWARD, _VISCOUS_BACKWARD, _COULOMB, _FORWARD, _BACKWARD, _OFFSET, _STRIBECK,
 _CUBE_ROOT, _SQUARE, LOAD, PRESLIDING) = range(12)
_TERMS = {'viscous': (_VISCOUS,), 'coulomb': (_COULOMB,), 'offset': (_OFFSET,),
          'stribeck': (_STRIBECK,), 'cube_root': (_CUBE_ROOT,), 'square': (_SQUARE,),
          'load': (LOAD,), 'presliding': (PRESLIDING,)}
_DIRECTED = {'viscous': (_VISCOUS_FORWARD, _VISCOUS_BACKWARD), 'coulomb': (_FORWARD, _BACKWARD)}


def friction_names(joint: JointSpec) -> tuple[str, ...]:
    """Name the friction parameters of a joint."""
    names: list[str] = []
    for term in joint.friction:
        if joint.asymmetric and term in ('viscous', 'coulomb'):
            names += [f'{term}+({joint.name})', f'{term}-({joint.name})']
        elif term == 'presliding':
            names += [f'{term}@{distance:g}({joint.name})' for distance in joint.bristles]
        else:
            names.append(f'{term}({joint.name})')
    return tuple(names)


def friction_columns(
    joint: JointSpec, dq: FloatArray, load: FloatArray | None = None,
    bent: FloatArray | None = None,
) -> FloatArray:
    """
    Evaluate the friction columns of a joint.

    dq (samples,) [rad/s or m/s], load (samples,) [N m or N]; bent (samples, bristles or more): as
    of a joint that slides by default; returns (samples, terms).
    """
    codes = friction_codes(joint)
    out = np.empty((len(dq), len(codes)))
    _fill(np.asarray(dq, dtype=float), codes, joint.friction_velocity, joint.stribeck_velocity,
          out)
    if bent is not None:
        out[:, codes == PRESLIDING] = bent[:, :len(joint.bristles)]
    if load is not None:
        out[:, codes == LOAD] *= np.abs(load)[:, None]
    return out


def friction_codes(joint: JointSpec) -> NDArray[np.intp]:
    """Give the terms of a joint as `friction_term` takes them, one a column."""
    return np.array([
        code for term in joint.friction for code in (
            _DIRECTED if joint.asymmetric and term in _DIRECTED else _TERMS)[term]
        for _ in (joint.bristles if code == PRESLIDING else (0.0,))], dtype=np.intp)


@compiled
def _fill(dq: FloatArray, codes: NDArray, sharp: float, stribeck: float, out: FloatArray) -> None:
    for k in range(len(dq)):
        for i in range(len(codes)):
            out[k, i] = friction_term(codes[i], dq[k], sharp, stribeck)


@compiled
def friction_term(code: int, dq: float, sharp: float, stribeck: float) -> float:
    """
    Evaluate one column at one speed; that of a load still wants its size as a factor.

    Friction that gives way is taken as that of a joint that slides.

    dq, sharp, stribeck [rad/s or m/s].
    """
    if code == _OFFSET:
        return 1.0
    if code == _VISCOUS:
        return dq
    if code == _SQUARE:
        return dq * abs(dq)
    if code == _CUBE_ROOT:
        # smoothed as the sign is: the root's slope at zero is infinite
        return dq / (dq * dq + sharp * sharp) ** (1.0 / 3.0)
    smooth = math.tanh(dq / sharp)
    if code == _COULOMB or code == LOAD or code == PRESLIDING:
        return smooth
    if code == _STRIBECK:
        return smooth * math.exp(-(dq / stribeck) ** 2)
    if code == _VISCOUS_FORWARD:
        return dq * 0.5 * (1.0 + smooth)
    if code == _VISCOUS_BACKWARD:
        return dq * 0.5 * (1.0 - smooth)
    return 0.5 * (1.0 + smooth) if code == _FORWARD else 0.5 * (1.0 - smooth)


# -- Friction before a joint breaks away: a bristle that bends with the drive, and slides at its
#    limit.
#
# Prandtl's element, the stop operator of hysteresis (Visintin, Differential Models of Hysteresis,
# 1994, Section III.1): ``z_k = min(1, max(-1, z_(k-1) + (q_k - q_(k-1)) / distance))``. It does
# not depend on the rate, and a sum of such elements, each with a coefficient of its own, is linear
# in these (Prandtl-Ishlinskii). Since ``z`` needs the motion before a sample, it follows the
# motion as a further input of the rows.

@compiled
def _bend(
    places: FloatArray, distance: FloatArray, last: FloatArray, bent: FloatArray, out: FloatArray,
) -> None:
    for k in range(len(places)):
        for i in range(len(distance)):
            bent[i] = min(1.0, max(-1.0, bent[i] + (places[k, i] - last[i]) / distance[i]))
            last[i] = places[k, i]
            out[k, i] = bent[i]


def bent_along(stretch: Stretch, coupling: Coupling, distance: FloatArray) -> FloatArray:
    """
    Follow bristles along a stretch, from what is known of the motion before it on.

    distance (bristles, joints) [rad or m]: infinite for one that is not there; returns
    (samples, bristles, joints), 0 where the motion begins.
    """
    q, earlier = stretch.states.q, 0
    if stretch.before is not None:
        earlier = len(stretch.before)
        q = np.vstack([stretch.before[:, 1:], q])
    places = np.tile(coupling.drive_places(q), len(distance))
    out = np.empty_like(places)
    _bend(places, distance.ravel(), places[0].copy(), np.zeros(distance.size), out)
    return out[earlier:].reshape(len(q) - earlier, *distance.shape)


class Bristles:
    """The bristles of an arm's drives."""

    def __init__(self, arm: Arm) -> None:
        self.coupling = Coupling(arm)
        most = max(len(joint.bristles) for joint in arm.joints)
        self.distance = np.full((most, len(arm.joints)), np.inf)
        for i, joint in enumerate(arm.joints):
            self.distance[:len(joint.bristles), i] = joint.bristles
        self.count = self.distance.size

    def follow(self, stretch: Stretch) -> FloatArray:
        """
        Give the motion of a stretch, and how far the bristles are bent.

        Returns (samples, 3 joints + count): ``[q, dq, ddq, z]``, the first bristle of each drive
        before the second ones.
        """
        bent = bent_along(stretch, self.coupling, self.distance)
        return np.hstack([stretch.motion, bent.reshape(len(bent), -1)])


class Trail:
    """Bristles beside a running robot."""

    def __init__(self, bristles: Bristles) -> None:
        self._bristles = bristles
        self._distance = bristles.distance.ravel()
        self._last = np.zeros(bristles.count)
        self._bent = np.zeros((1, bristles.count))

    def step(self, dt: float, row: FloatArray) -> FloatArray:
        """
        Go to the next sample.

        dt [s]; row (3 joints,): ``[q, dq, ddq]`` of one sample
        [rad, rad/s, rad/s^2 or m, m/s, m/s^2]; returns (3 joints + count,): ``[q, dq, ddq, z]``,
        as `Bristles.follow` gives it.
        """
        most, n = self._bristles.distance.shape
        places = np.tile(self._bristles.coupling.drive_places(row[None, :n]), most)
        if dt == 0.0:
            self._last, self._bent = places[0].copy(), np.zeros_like(self._bent)
        _bend(places, self._distance, self._last, self._bent[0], self._bent)
        return np.concatenate([row, self._bent[0]])


# -- Rotor inertia, friction and unit of each joint's effort, times their parameters, compiled

NOT_KNOWN = np.empty((0, 0))
"""What friction that gives way has done, where nothing is known of it."""


class JointTerms:
    """
    What the drives of the joints add to the efforts of the bodies.

    scale (joints,); speeds (joints, joints): each its own by default; reach (joints, joints): of
    its own by default.
    """

    def __init__(
        self, joints: Sequence[JointSpec], columns: Sequence[int], scale: FloatArray,
        speeds: FloatArray | None = None, reach: FloatArray | None = None,
    ) -> None:
        codes = [friction_codes(joint) for joint in joints]
        first = np.cumsum([0, *(len(terms) for terms in codes)])
        layout = [[column, joint.rotor_inertia, begin, len(terms)] for joint, column, begin, terms
                  in zip(joints, columns, first, codes, strict=False)]
        own = np.eye(len(joints))
        self._terms = (
            np.array(layout, dtype=np.intp), np.concatenate(codes, dtype=np.intp),
            np.array([[joint.friction_velocity, joint.stribeck_velocity] for joint in joints]),
            scale, own if speeds is None else speeds, own if reach is None else reach)

    def add(
        self, motion: FloatArray, parameters: FloatArray, out: FloatArray,
        bent: FloatArray | None = None,
    ) -> None:
        """
        Add rotor inertias and friction, and bring the sum to the unit of the measurement.

        parameters (joints, columns), bent (samples, bristles); motion (samples, 3 joints):
        ``[q, dq, ddq]`` of the active joints, in columns [rad, rad/s, rad/s^2 or m, m/s, m/s^2];
        writes out (samples, joints) [N m or N].
        """
        _add(self._terms, motion, NOT_KNOWN if bent is None else bent, parameters, out)


@compiled
def _add(
    terms: tuple, motion: FloatArray, bent: FloatArray, parameters: FloatArray, out: FloatArray,
) -> None:
    layout, codes, smoothing, scale, speeds, reach = terms
    n = len(layout)
    loads = np.empty(n)
    for k in range(len(motion)):
        for i in range(n):
            loads[i] = abs(out[k, i])
        for drive in range(n):
            dq, ddq = 0.0, 0.0
            for j in range(n):
                dq += speeds[drive, j] * motion[k, n + j]
                ddq += speeds[drive, j] * motion[k, 2 * n + j]
            for i in range(n):
                if reach[i, drive] == 0.0:
                    continue
                column, value, bristle = layout[drive, 0], 0.0, drive
                if layout[drive, 1] != 0:
                    value += parameters[i, column] * ddq
                    column += 1
                for term in range(layout[drive, 3]):
                    code = codes[layout[drive, 2] + term]
                    if code == PRESLIDING and len(bent) > 0:
                        part = parameters[i, column + term] * bent[k, bristle]
                        bristle += n
                    else:
                        part = parameters[i, column + term] * friction_term(
                            code, dq, smoothing[drive, 0], smoothing[drive, 1])
                    value += part * loads[drive] if code == LOAD else part
                out[k, i] += reach[i, drive] * value
        for i in range(n):
            out[k, i] /= scale[i]
