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

"""Regressors: outputs linear in parameters, their base parameters, and their units."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
import pinocchio as pin

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.errors import ArmError, FitError
from tudor_dynamics.models.friction import (
    Coupling, friction_columns, friction_names, FrictionStates, JointTerms, term_names, term_of,
    TERMS)
from tudor_dynamics.models.rigid_bodies import BODY_PARAMETERS, RigidBodies
from tudor_dynamics.models.settings import RELATIVE_TOLERANCE
from tudor_dynamics.typing import FloatArray


# -- Regressors: outputs as linear functions of constant parameters, row by row.
#
# Effort: ``tau = Y(q, dq, ddq) chi`` with the joint torque regressor, the rotor inertia and
# the friction of each joint (Malzahn et al., Eqs. (2)-(6)). Strain: one row a gauge (Eq. (15)),
# either the joint's own row as the paper has it, or the exact bending moment at the gauge.

STRAIN_FORMS = ('paper', 'exact')


class Regressor(ABC):
    """Rows that are linear in constant parameters, for a fixed set of channels."""

    channels: tuple[str, ...]  # names of the outputs
    columns: tuple[str, ...]  # names of all parameters, base-parameter reduction not yet done
    groups: tuple[tuple[int, ...], ...]  # channels by shared parameters, each once
    unknown: tuple[int, ...] = ()  # channels that share up to a torque constant
    scaled: NDArray[np.bool_]  # columns whose parameters carry that constant
    loaded: bool = False  # whether rows depend on parameters, by friction under load
    states: FrictionStates | None = None  # of friction, inputs after the motion
    # Payloads that rows are for, the payload being the last input [kg]; None for rows of motion.
    payload_range: tuple[float, float] | None = None
    form: str | None = None  # of strain, see `STRAIN_FORMS`

    def assume(self, parameters: FloatArray | None) -> None:
        """
        Take parameters by which rows know the loads that friction grows with, where it does.

        With friction in proportion to what the bodies ask of a joint, the effort is no linear
        function of all parameters. For given loads it is: rows by the parameters of the last
        estimate (n_channels, n_columns), and an estimate by these rows, settle within a few
        turns. None stands for bodies whose parameters all are 1.
        """

    @abstractmethod
    def rows(self, motion: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """
        Evaluate rows, shape (n_samples, n_channels, n_columns), into ``out`` where it is given.

        motion: ``[q, dq, ddq]`` of the active joints, (n_samples, 3 n_joints); after it the
        states of friction, as of joints that slide where these are left out (`FrictionStates`).
        """

    @abstractmethod
    def outputs(self, motion: FloatArray, parameters: FloatArray) -> FloatArray:
        """Evaluate rows times parameters (n_channels, n_columns) of each channel; see ``rows``."""


class EffortRegressor(Regressor):
    """Joint effort rows: link inertias, rotor inertias, friction."""

    # Joints whose effort is a torque or force, or a current with a known constant, share the
    # inertial parameters and are stacked. A joint with a current of unknown torque constant has
    # parameters of its own, scaled by that constant, or shares those of the others as well: then
    # the constants are to be found with them (`estimation.find_constants`).

    def __init__(self, arm: Arm, *, shared: bool = False) -> None:
        self.channels = arm.active_joints
        self._joints = arm.joints
        self._scale = np.array([joint.effort.torque_constant or 1.0 for joint in arm.joints])
        known = [i for i, joint in enumerate(arm.joints)
                 if joint.effort.unit != 'A' or joint.effort.torque_constant is not None]
        alone: list[tuple[int, ...]] = [(i,) for i in range(len(arm.joints)) if i not in known]
        self.groups = tuple(([tuple(known)] if known else []) + alone)
        if shared and len(self.groups) > 1:
            self.groups = (tuple(range(len(arm.joints))),)
            self.unknown = tuple(i for i, in alone)
        names = [f'{parameter}({name})' for name in list(arm.model.names)[1:]
                 for parameter in BODY_PARAMETERS]
        self._n_bodies = len(names)
        self._local: list[slice] = []
        for joint in arm.joints:
            first = len(names)
            if joint.rotor_inertia:
                names.append(f'Ia({joint.name})')
            names += friction_names(joint)
            self._local.append(slice(first, len(names)))
        self.columns = tuple(names)
        self._coupling = Coupling(arm)
        self.scaled = np.array([i < self._n_bodies or name.startswith('Ia(')
                                for i, name in enumerate(names)])
        for i, part in enumerate(self._local):
            if np.count_nonzero(self._coupling.reach[:, i]) > 1:
                self.scaled[part] = True  # several efforts feel it, each in its own unit
        self.loaded = any(term_names(joint, loaded=True) for joint in arm.joints)
        if any(term_names(joint, state=True) for joint in arm.joints):
            self.states = FrictionStates(arm)
        self._assumed: FloatArray | None = None
        self._bodies = RigidBodies(arm.model, arm.velocity_index, arm.velocity_index)
        self._terms = JointTerms(arm.joints, [part.start for part in self._local], self._scale,
                                 self._coupling.speeds, self._coupling.reach)

    def assume(self, parameters: FloatArray | None) -> None:
        self._assumed = parameters

    def rows(self, motion: FloatArray, out: FloatArray | None = None) -> FloatArray:
        n = len(self.channels)
        motion, states = self._parted(motion)
        dq = motion[:, n:2 * n] @ self._coupling.speeds.T
        ddq = motion[:, 2 * n:] @ self._coupling.speeds.T
        rows = np.zeros((len(motion), n, len(self.columns))) if out is None else out
        bodies = rows[:, :, :self._n_bodies]
        self._bodies.rows(motion, bodies)
        self._coupling.mix(bodies)
        for i, joint in enumerate(self._joints):
            load = None
            if term_names(joint, loaded=True):
                load = (bodies[:, i].sum(axis=1) if self._assumed is None else
                        bodies[:, i] @ self._assumed[i, :self._n_bodies])
            columns = friction_columns(joint, dq[:, i], load,
                                       None if states is None else states[:, i::n])
            if joint.rotor_inertia:
                columns = np.column_stack([ddq[:, i], columns])
            for channel in np.flatnonzero(self._coupling.reach[:, i]):
                rows[:, channel, self._local[i]] = self._coupling.reach[channel, i] * columns
        if np.any(self._scale != 1.0):
            rows /= self._scale[None, :, None]  # what is zero in `out` stays zero
        return rows

    def outputs(self, motion: FloatArray, parameters: FloatArray) -> FloatArray:
        motion, states = self._parted(motion)
        out = self._coupling.body_efforts(self._bodies, motion, parameters)
        self._terms.add(motion, parameters, out, states)
        return out

    def _parted(self, motion: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """Give the motion of the joints, and the states of friction where they are known."""
        wide = 3 * len(self.channels)
        if motion.shape[1] == wide:
            return self._coupling.of_joints(motion), None
        # contiguous, as the compiled functions know it
        joints, states = (np.ascontiguousarray(part) for part in np.split(motion, [wide], axis=1))
        return self._coupling.of_joints(joints), states


class StrainRegressor(Regressor):
    """
    Gauge rows: the bending moment after a joint, and an offset; own parameters for each gauge.

    The form ``paper`` takes the regressor of the joint before the gauge (Malzahn et al., Eq. (15),
    in which the difference between gauge and joint is constant); ``exact`` the bending moment
    about the gauge's place x_s, for which the reaction force of the following link has the lever
    L - x_s and its moment the lever L.
    """

    def __init__(self, arm: Arm, form: str = 'exact') -> None:
        if form not in STRAIN_FORMS:
            raise ArmError(f'unknown strain form {form!r}; expected {" or ".join(STRAIN_FORMS)}')
        if not arm.gauges:
            msg = 'the arm has no gauges, so there is no strain to model'
            raise ArmError(msg, place=arm.source)
        self.channels = arm.gauge_names
        self.form = form
        model = arm.gauge_model if form == 'exact' else arm.model
        outputs = (arm.gauge_names if form == 'exact'
                   else tuple(gauge.joint for gauge in arm.gauges))
        missing = [name for name in outputs if not model.existJointName(name)]
        if missing:
            msg = ('the strain form paper needs the joint before each gauge among active_joints, '
                   f'which lack {", ".join(map(repr, missing))}')
            raise ArmError(msg, place=arm.source, remedy='use the strain form exact')
        names = [f'{parameter}({name})' for name in list(model.names)[1:]
                 for parameter in BODY_PARAMETERS]
        self.columns = (*names, 'offset')
        self.groups = tuple((i,) for i in range(len(self.channels)))
        self.scaled = np.zeros(len(self.columns), dtype=np.bool_)
        self._bodies = RigidBodies(model, *(np.array([
            model.joints[model.getJointId(name)].idx_v for name in group])
            for group in (arm.active_joints, outputs)))
        self._coupling = Coupling(arm)

    def rows(self, motion: FloatArray, out: FloatArray | None = None) -> FloatArray:
        shape = (len(motion), len(self.channels), len(self.columns))
        rows = np.zeros(shape) if out is None else out
        # virtual joints at the gauges stay at zero
        self._bodies.rows(self._coupling.of_joints(motion), rows[:, :, :-1])
        rows[:, :, -1] = 1.0
        return rows

    def outputs(self, motion: FloatArray, parameters: FloatArray) -> FloatArray:
        out = np.empty((len(motion), len(self.channels)))
        self._bodies.outputs(self._coupling.of_joints(motion), parameters, out)
        out += parameters[:, -1]
        return out


# -- Base parameters: the smallest set that the outputs depend on, found numerically.
#
# Gautier, "Numerical calculation of the base inertial parameters of robots", J. Robotic Systems
# 8(4), 1991, with one change: columns are taken in a fixed order of preference instead of by
# pivoting on their size, so that the choice is the same on every machine and every LAPACK, and
# depends on the arm alone. Random states take the place of measured ones; whether the measured
# motion excites the parameters is another question, answered where they are estimated.

SHOWN_TERMS = 4
PAYLOAD = 'payload*'  # begin of the names of columns that count for each kilogram of payload


@dataclass(frozen=True, eq=False)
class BaseSet:
    """Base parameters of one group of channels."""

    channels: tuple[int, ...]  # channels that share the parameters
    kept: NDArray[np.intp]  # columns of the regressor that span all of them, (base,)
    names: tuple[str, ...]  # the kept parameter and those grouped with it


def random_motion(n_joints: int, n_samples: int, seed: int) -> FloatArray:
    """Draw random states ``[q, dq, ddq]`` that excite every parameter, within +-pi, +-2, +-5."""
    # every second state is slow, down to 0.2 mrad/s, where friction terms differ that are alike
    # (or nothing) at speed
    generator = np.random.default_rng(seed)
    scale = np.repeat([np.pi, 2.0, 5.0], n_joints)
    motion = generator.uniform(-1.0, 1.0, (n_samples, 3 * n_joints)) * scale
    slow = generator.uniform(-4.0, 0.0, (n_samples, n_joints))
    motion[::2, n_joints:2 * n_joints] *= 10.0 ** slow[::2]
    return np.asarray(motion)


def random_inputs(regressor: Regressor, n_joints: int, n_samples: int, seed: int) -> FloatArray:
    """Draw random inputs of a regressor: motion, states, and the payload if it takes one."""
    motion = random_motion(n_joints, n_samples, seed)
    if regressor.states is not None:
        states = np.random.default_rng([seed, 2]).uniform(
            -1.0, 1.0, (n_samples, regressor.states.count))
        motion = np.hstack([motion, states])
    more = np.random.default_rng([seed, 1]).uniform(
        0.0, 1.0, (n_samples, int(regressor.payload_range is not None)))
    return np.hstack([motion, more])


def independent_columns(matrix: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Take each column that is no combination, mixture (kept, columns), of those before it."""
    largest = float(np.max(np.linalg.norm(matrix, axis=0), initial=0.0))
    basis = np.zeros((matrix.shape[0], 0))
    kept: list[int] = []
    for i in range(matrix.shape[1]):
        column = matrix[:, i]
        for _ in range(2):  # twice is enough (Kahan): orthogonal to rounding
            column = column - basis @ (basis.T @ column)
        norm = float(np.linalg.norm(column))
        if norm > RELATIVE_TOLERANCE * largest * np.sqrt(matrix.shape[1]):
            basis = np.column_stack([basis, column / norm])
            kept.append(i)
    if not kept:
        return np.zeros(0, dtype=np.intp), np.zeros((0, matrix.shape[1]))
    mixture: FloatArray = np.asarray(np.linalg.lstsq(matrix[:, kept], matrix, rcond=None)[0])
    mixture[np.abs(mixture) < 1e-7] = 0.0
    return np.array(kept, dtype=np.intp), mixture


def preference(columns: tuple[str, ...]) -> list[int]:
    """Order columns by how well one can read them as base parameters."""
    # friction and offsets first, for they are nobody else's; then first moments and inertias about
    # the joints' axes, as textbooks write them; then the rest; rotor inertias last, as they merge
    # with the inertia of the first link that they turn. What a payload adds comes after all that
    order = ['Izz', 'Iyy', 'Ixx', 'mx', 'my', 'mz', 'Ixy', 'Ixz', 'Iyz', 'm', 'Ia']

    def rank(i: int) -> tuple[int, int]:
        plain = columns[i].removeprefix(PAYLOAD)
        kind = plain.split('(')[0]
        place = order.index(kind) + 1 if kind in order else 0
        return (place + len(order) + 1 if plain != columns[i] else place, i)

    return sorted(range(len(columns)), key=rank)


def _name(columns: list[str], row: FloatArray, own: int) -> str:
    terms = [columns[own]]
    size_order = np.argsort(-np.round(np.abs(row), 7), kind='stable')  # ties are not rounding's
    others = [i for i in size_order if row[i] != 0.0 and i != own]
    for i in others[:SHOWN_TERMS - 1]:
        size = f'{abs(row[i]):.4g} ' if abs(abs(row[i]) - 1.0) > 1e-6 else ''
        terms.append(f'{"-" if row[i] < 0 else "+"} {size}{columns[i]}')
    if len(others) >= SHOWN_TERMS:
        terms.append(f'+ {len(others) - SHOWN_TERMS + 1} more')
    return ' '.join(terms)


def base_sets(regressor: Regressor, n_joints: int, *, seed: int = 0) -> tuple[BaseSet, ...]:
    """Find the base parameters of each group of channels."""
    n_states = len(regressor.columns) // min(len(group) for group in regressor.groups) + 20
    rows = regressor.rows(random_inputs(regressor, n_joints, n_states, seed))
    order = preference(regressor.columns)
    names = [regressor.columns[i] for i in order]
    sets = []
    for group in regressor.groups:
        kept, mixture = independent_columns(rows[:, list(group)].reshape(-1, len(order))[:, order])
        sets.append(BaseSet(
            group, np.array([order[i] for i in kept], dtype=np.intp),
            tuple(_name(names, mixture[k], int(own)) for k, own in enumerate(kept))))
    return tuple(sets)


# -- Units of outputs and of parameters, for tables and model files

_BODY = {'m': 'kg', 'mx': 'kg m', 'my': 'kg m', 'mz': 'kg m'}


def output_units(arm: Arm, output: str) -> dict[str, str]:
    """Give the unit of each channel of an output."""
    if output == 'effort':
        return {joint.name: joint.effort.unit for joint in arm.joints}
    return {gauge.name: gauge.unit for gauge in arm.gauges}


def parameter_unit(column: str, unit: str, *, scaled: bool, prismatic: bool) -> str:
    """Give the unit of a parameter."""
    kind = term_of(column)
    force, length = ('N', 'm') if prismatic else ('N m', 'rad')
    if kind in TERMS:
        return TERMS[kind].unit.format(f=unit, x=length)
    body = 'kg' if kind == 'Ia' and prismatic else _BODY.get(kind, 'kg m^2')
    return f'{body} ({unit})/({force})' if scaled else body


def column_unit(arm: Arm, output: str, channels: tuple[str, ...], column: str) -> str:
    """Give the unit of a parameter of an arm's model."""
    if column.startswith(PAYLOAD):
        return column_unit(arm, output, channels, column.removeprefix(PAYLOAD)) + ' / kg'
    if output == 'strain':
        unit = output_units(arm, output)[channels[0]]
        return unit if column == 'offset' else parameter_unit(
            column, unit, scaled=unit != 'N m', prismatic=False)
    owner = column.partition('(')[2][:-1]
    name = owner if owner in channels else channels[0]
    efforts = {joint.name: joint.effort for joint in arm.joints}
    effort, prismatic = efforts[name], arm.is_prismatic(name)
    absolute = effort.torque_constant is not None or (
        term_of(column) not in TERMS and any(
            efforts[other].unit != 'A' or efforts[other].torque_constant is not None
            for other in channels))
    unit = ('N' if prismatic else 'N m') if absolute else effort.unit
    return parameter_unit(column, unit, scaled=unit == 'A', prismatic=prismatic)


# -- Rows of all loads: parameters are affine in the mass at the tip.
#
# A payload of the mass m adds m times something fixed to the inertial parameters of the last body,
# so every base parameter is pi_0 + m pi_1 and the outputs stay linear in parameters: the rows
# ``[Y, m Y_last]`` with the payload as one more input. Bags with two payloads are enough to fit
# it. While a robot runs, the payload is fixed for a while: ``at`` of a model puts it in and gives
# a plain model.

def last_body(model: pin.Model) -> str:
    """Give the joint that moves the body at the end of the longest chain."""
    return str(model.names[int(np.argmax([len(chain) for chain in model.supports]))])


class PayloadRegressor(Regressor):
    """Rows of a regressor, and those of its last body once more for each kilogram of payload."""

    payload_range: tuple[float, float]

    def __init__(self, plain: Regressor, arm: Arm, payload_range: tuple[float, float]) -> None:
        if plain.loaded:
            raise FitError('the friction term `load` cannot be identified over several loads',
                           place=arm.source, remedy='remove `load` from joints[].friction, or fit '
                           'the bags of each load alone')
        self.plain, self.payload_range = plain, payload_range
        self.channels, self.groups, self.unknown = plain.channels, plain.groups, plain.unknown
        self.states, self.form = plain.states, plain.form
        self.scaled = np.append(plain.scaled, np.full(len(BODY_PARAMETERS), True))
        body = last_body(arm.gauge_model if plain.form == 'exact' else arm.model)
        own = [f'{name}({body})' for name in BODY_PARAMETERS]
        self.carried = np.array([plain.columns.index(name) for name in own], dtype=np.intp)
        self.columns = (*plain.columns, *(PAYLOAD + name for name in own))

    def rows(self, motion: FloatArray, out: FloatArray | None = None) -> FloatArray:
        n = len(self.plain.columns)
        shape = (len(motion), len(self.channels), len(self.columns))
        rows = np.zeros(shape) if out is None else out
        self.plain.rows(motion[:, :-1], out=rows[:, :, :n])
        np.multiply(rows[:, :, self.carried], motion[:, -1, None, None], out=rows[:, :, n:])
        return rows

    def outputs(self, motion: FloatArray, parameters: FloatArray) -> FloatArray:
        n = len(self.plain.columns)
        carried = np.zeros((len(parameters), n))
        carried[:, self.carried] = parameters[:, n:]
        states = np.ascontiguousarray(motion[:, :-1])
        return (self.plain.outputs(states, np.ascontiguousarray(parameters[:, :n]))
                + motion[:, -1:] * self.plain.outputs(states, carried))


def regressor_of(
    arm: Arm, output: str, strain_form: str, *, shared: bool = False,
    payloads: tuple[float, float] | None = None,
) -> Regressor:
    """Give the rows of an output, of all payloads where a range of these is given [kg]."""
    plain = (EffortRegressor(arm, shared=shared) if output == 'effort' else
             StrainRegressor(arm, strain_form))
    return plain if payloads is None else PayloadRegressor(plain, arm, payloads)
