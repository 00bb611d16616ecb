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

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
import math

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import JointSpec, STATE_KEYS
from tudor_dynamics.compiled import compiled
from tudor_dynamics.models.rigid_bodies import RigidBodies
from tudor_dynamics.models.settings import DISTANCES
from tudor_dynamics.signals.preprocessing import Stretch
from tudor_dynamics.typing import FloatArray


# -- Coupled drives in the rows: what is measured at motors, and what each effort feels of them.
#
# With the speeds of the motors ``w = C dq`` (those of uncoupled drives, after their gears, are
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
        """Give the motion of the joints from the motion (samples, 3 joints) as measured."""
        if self._joints is None:
            return motion
        n = len(self._joints)
        return np.hstack([motion[:, i * n:(i + 1) * n] @ self._joints.T for i in range(3)])

    def drive_places(self, q: FloatArray) -> FloatArray:
        """Give what the motors have turned by, after their gears: (samples, joints) [rad or m]."""
        if self._alone:
            return q
        return (q if self._joints is None else q @ self._joints.T) @ self.speeds.T

    def mix(self, rows: FloatArray) -> None:
        """Turn rows (samples, joints, columns) of joints into those of what is measured."""
        if self._mixture is not None:
            rows[:] = np.einsum('ij,kjp->kip', self._mixture, rows)

    def body_efforts(
        self, bodies: RigidBodies, motion: FloatArray, parameters: FloatArray,
    ) -> FloatArray:
        """Evaluate what the bodies ask of each effort, (samples, joints) [N m or N]."""
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
FIRST_STATE = PRESLIDING  # codes from here on are those of columns with a state


@dataclass(frozen=True)
class Term:
    """A friction term of the description: all that depends on which one it is."""

    code: int  # its column in `friction_term`; of a term with a state also in `_next_state`
    column: str  # what its column is, for docs/reference/arm_yaml.md
    use: str  # and what it is good for
    unit: str = '{f}'  # of its coefficient: {f} is that of the effort, {x} rad or m
    each_way: tuple[int, ...] = ()  # its columns where each direction has its own
    backward_sign: float = 1.0  # of a coefficient of the backward direction that takes energy
    switched: bool = True  # whether the smoothed sign of the speed is part of it
    decays: bool = False  # whether it depends on the Stribeck velocity
    constant: bool = False  # whether it is a constant
    loaded: bool = False  # whether it grows with what the bodies ask of the joint
    pair: str = ''  # what URDF and MJCF call it: damping or friction
    exported: str = ''  # what export says of it where that pair has no place for it
    tried: bool = False  # whether `tudor fit` tries it where friction is left open
    tried_values: tuple[float, ...] = ()  # of a term with a state: values of its key
    state_words: str = ''  # what comes before these values in texts

    @property
    def takes_energy(self) -> bool:
        """Say whether it is friction of its own, which takes energy from the motion."""
        return not (self.loaded or self.constant)


TERMS = {
    'viscous': Term(
        _VISCOUS, 'velocity; each direction its own with `asymmetric: true`', 'every joint',
        unit='{f} s/{x}', each_way=(_VISCOUS_FORWARD, _VISCOUS_BACKWARD), switched=False,
        pair='damping'),
    'coulomb': Term(
        _COULOMB, 'smoothed sign of the velocity; each direction its own with `asymmetric: true`, '
        'as Malzahn et al. have it', 'every joint', each_way=(_FORWARD, _BACKWARD),
        backward_sign=-1.0, pair='friction'),
    'load': Term(
        LOAD, 'smoothed sign of the velocity times the size of the rigid-body effort',
        'gears under load', unit='1', loaded=True, exported='load, but for its mean', tried=True),
    'offset': Term(
        _OFFSET, 'constant', 'spring balancers, current sensors with a bias', switched=False,
        constant=True, exported='offset', tried=True),
    'stribeck': Term(
        _STRIBECK, 'sign times exp(-(velocity / `stribeck_velocity`)²)',
        'harmonic drives: friction that falls after breakaway', decays=True, tried=True),
    'cube_root': Term(
        _CUBE_ROOT, 'signed cube root of the velocity', 'lubricated gears at low speed',
        unit='{f} (s/{x})^(1/3)', tried=True),
    'square': Term(
        _SQUARE, 'velocity times its magnitude', 'fans, oil', unit='{f} (s/{x})^2',
        switched=False, tried=True),
    'presliding': Term(
        PRESLIDING, 'for each of `presliding_distances`, a spring that bends with the joint up to '
        'that displacement and slides along bent: -1 to 1', 'gears that turn round often; takes '
        'the place of a part of `coulomb`, and remembers', tried_values=DISTANCES,
        state_words='gives way over')}
"""
Name of each term to what it is. A new one is a name in ``arm/schema.py``, with a key for the
values of its state where it has one; a code and an entry here; and its line in `friction_term`,
and in `_next_state`.
"""
DAMPING, FRICTION = (next(name for name, term in TERMS.items() if term.pair == word)
                     for word in ('damping', 'friction'))
"""Names of the two terms that URDF and MJCF have."""
BY_LOAD = next(name for name, term in TERMS.items() if term.loaded)
"""Name of the term that grows with the load."""


def term_names(joint: JointSpec, *, loaded: bool = False, state: bool = False) -> tuple[str, ...]:
    """Give the friction terms of a joint that grow with the load, or have a state."""
    return tuple(name for name in joint.friction
                 if loaded and TERMS[name].loaded or state and name in STATE_KEYS)


def sliding(arm: Arm, *, loaded: bool = True) -> Arm:
    """Give an arm whose friction has no state and, unless ``loaded``, no term of the load."""
    return arm.with_joints({joint.name: {'friction': tuple(
        name for name in joint.friction
        if name not in term_names(joint, loaded=not loaded, state=True))} for joint in arm.joints})


def term_of(parameter: str) -> str:
    """Give the term of a friction parameter, without its joint, direction or displacement."""
    return parameter.partition('(')[0].partition('@')[0].rstrip('+-')


def has_constant(joint: JointSpec) -> bool:
    """Say whether friction terms of a joint make a constant."""
    # the columns of Coulomb friction that act one way only make one together
    return any(TERMS[name].constant or joint.asymmetric and TERMS[name].backward_sign < 0.0
               for name in joint.friction)


def friction_names(joint: JointSpec) -> tuple[str, ...]:
    """Name the friction parameters of a joint."""
    return tuple(f'{name}({joint.name})' for name, _ in _columns(joint))


def friction_codes(joint: JointSpec) -> NDArray[np.intp]:
    """Give the terms of a joint as `friction_term` takes them, one a column."""
    return np.array([code for _, code in _columns(joint)], dtype=np.intp)


def _columns(joint: JointSpec) -> Iterator[tuple[str, int]]:
    """Give name and code of each column: of a direction, a value of a state, or a whole term."""
    for name in joint.friction:
        term = TERMS[name]
        if name in STATE_KEYS:
            yield from ((f'{name}@{value:g}', term.code) for value in joint.state_values(name))
        elif joint.asymmetric and term.each_way:
            yield from ((name + way, code) for way, code in zip('+-', term.each_way, strict=True))
        else:
            yield name, term.code


def friction_columns(
    joint: JointSpec, dq: FloatArray, load: FloatArray | None = None,
    states: FloatArray | None = None,
) -> FloatArray:
    """Evaluate the friction columns (samples, columns) of a joint, that slides by default."""
    codes = friction_codes(joint)
    out = np.empty((len(dq), len(codes)))
    fill_columns(np.asarray(dq, dtype=float), codes, joint.friction_velocity,
                 joint.stribeck_velocity, out)
    if states is not None:
        out[:, codes >= FIRST_STATE] = states[:, :np.count_nonzero(codes >= FIRST_STATE)]
    if load is not None:
        out[:, codes == LOAD] *= np.abs(load)[:, None]
    return out


@compiled
def fill_columns(
    dq: FloatArray, codes: NDArray, sharp: float, stribeck: float, out: FloatArray,
) -> None:
    """Evaluate columns (samples, codes) of a joint that slides, see `friction_term`."""
    for k in range(len(dq)):
        for i in range(len(codes)):
            out[k, i] = friction_term(codes[i], dq[k], sharp, stribeck)


@compiled
def friction_term(code: int, dq: float, sharp: float, stribeck: float) -> float:
    """Evaluate a column of a joint that slides; that of a load still wants its size as factor."""
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


# -- Friction with a state, such as that before a joint breaks away: a bristle that bends with the
#    drive, and slides at its limit.
#
# Presliding is Prandtl's element, the stop operator of hysteresis (Visintin, Differential Models
# of Hysteresis, 1994, Section III.1): ``z_k = min(1, max(-1, z_(k-1) + (q_k - q_(k-1)) / d))``
# with its displacement d. It does not depend on the rate, and a sum of such elements, each with a
# coefficient of its own, is linear in these (Prandtl-Ishlinskii). Since ``z`` needs the motion
# before a sample, states are further inputs of the rows, after the motion.

@compiled
def _next_state(code: int, state: float, move: float, dt: float, value: float) -> float:
    """Give the state of a column after a move of the drive [rad or m] in dt, from 0 at first."""
    if code == PRESLIDING:
        return min(1.0, max(-1.0, state + move / value))
    return state


@compiled
def _follow(
    dt: FloatArray, places: FloatArray, codes: NDArray, values: FloatArray, last: FloatArray,
    state: FloatArray, out: FloatArray,
) -> None:
    for k in range(len(places)):
        for i in range(len(codes)):
            state[i] = _next_state(codes[i], state[i], places[k, i] - last[i], dt[k], values[i])
            last[i] = places[k, i]
            out[k, i] = state[i]


def states_along(
    stretch: Stretch, coupling: Coupling, codes: NDArray[np.intp], values: FloatArray,
) -> FloatArray:
    """Follow states (samples, states, joints) along a stretch, from the motion before it on."""
    q, dt, earlier = stretch.states.q, stretch.dt, 0
    if stretch.before is not None:
        earlier = len(stretch.before)
        q = np.vstack([stretch.before[:, 1:], q])
        dt = np.concatenate([stretch.before[:, 0], dt])
    places = np.tile(coupling.drive_places(q), len(values))
    out = np.empty_like(places)
    _follow(dt, places, codes.ravel(), values.ravel(), places[0].copy(), np.zeros(values.size),
            out)
    return out[earlier:].reshape(len(q) - earlier, *values.shape)


class FrictionStates:
    """The states of friction of an arm's drives."""

    def __init__(self, arm: Arm) -> None:
        self.coupling = Coupling(arm)
        found = [[(TERMS[term].code, value) for term in joint.friction
                  for value in joint.state_values(term)] for joint in arm.joints]
        table = np.array([*zip_longest(*found, fillvalue=(FIRST_STATE, np.inf))])
        self.codes, self.values = table[..., 0].astype(np.intp), table[..., 1].copy()
        self.count = self.values.size

    def follow(self, stretch: Stretch) -> FloatArray:
        """Give ``[q, dq, ddq, z]`` of a stretch, first states of all drives before second ones."""
        states = states_along(stretch, self.coupling, self.codes, self.values)
        return np.hstack([stretch.motion, states.reshape(len(states), -1)])


class LiveFriction:
    """The states of friction of a running robot."""

    REMEMBERED = '_last', '_state'

    def __init__(self, states: FrictionStates) -> None:
        self._states = states
        self._codes, self._values = states.codes.ravel(), states.values.ravel()
        self._last = np.zeros(states.count)
        self._state = np.zeros((1, states.count))

    def step(self, dt: float, row: FloatArray) -> FloatArray:
        """Go to the next sample, dt 0 after a gap, as `FrictionStates.follow` goes through all."""
        most, n = self._states.values.shape
        places = np.tile(self._states.coupling.drive_places(row[None, :n]), most)
        if dt == 0.0:
            self._last, self._state = places[0].copy(), np.zeros_like(self._state)
        _follow(np.array([dt]), places, self._codes, self._values, self._last, self._state[0],
                self._state)
        return np.concatenate([row, self._state[0]])


# -- Rotor inertia, friction and unit of each joint's effort, times their parameters, compiled

NOT_KNOWN = np.empty((0, 0))  # states of friction where nothing is known of them


class JointTerms:
    """What the drives of the joints add to the efforts of the bodies."""

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
        states: FloatArray | None = None,
    ) -> None:
        """Add rotor inertias and friction to efforts (samples, joints), in the measured unit."""
        _add(self._terms, motion, NOT_KNOWN if states is None else states, parameters, out)


@compiled
def _add(
    terms: tuple, motion: FloatArray, states: FloatArray, parameters: FloatArray, out: FloatArray,
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
                column, value, own = layout[drive, 0], 0.0, drive
                if layout[drive, 1] != 0:
                    value += parameters[i, column] * ddq
                    column += 1
                for term in range(layout[drive, 3]):
                    code = codes[layout[drive, 2] + term]
                    if code >= FIRST_STATE and len(states) > 0:
                        part = parameters[i, column + term] * states[k, own]
                        own += n
                    else:
                        part = parameters[i, column + term] * friction_term(
                            code, dq, smoothing[drive, 0], smoothing[drive, 1])
                    value += part * loads[drive] if code == LOAD else part
                out[k, i] += reach[i, drive] * value
        for i in range(n):
            out[k, i] /= scale[i]
