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

"""A mechanism advanced step by step: dynamics, static equilibrium, energy, state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.errors import check_type, SimulationError
from tudor_dynamics.mechanics import chain as at, integrator as gen, settings
from tudor_dynamics.mechanics.chain import Chain, forward, rotation_at, vector_at
from tudor_dynamics.mechanics.equations import (
    along, hermite_mass, hermite_slope, hermite_stiffness, inner, inverse_dynamics, node_values)
from tudor_dynamics.mechanics.integrator import (
    Joints, PlantTables, report, reported_places, step_and_report)
from tudor_dynamics.mechanics.mass import mass_matrix, own_rigid, times_inertia, unit
from tudor_dynamics.mechanics.mechanism import Mechanism
from tudor_dynamics.mechanics.small_algebra import add, dot, times, turn
from tudor_dynamics.mechanics.stiffness import add_stretch, stiffness_matrix
from tudor_dynamics.typing import FloatArray


# -- Energy of a mechanism, and the forward pass that it needs

@compiled
def energy(
    z: NDArray, dz: NDArray, gravity: NDArray, chain: Chain,
) -> tuple[float, float, float]:
    """Give kinetic, elastic and gravitational energy [J]: z, dz (n,), gravity (3,) [m/s^2]."""
    body_int, body_float, coordinate = chain.body_int, chain.body_float, chain.coordinate
    kinetic, elastic, weight = 0.0, 0.0, 0.0
    for i in range(z.shape[0]):
        kinetic += 0.5 * coordinate[i, at.HUB] * dz[i] * dz[i]
        elastic += 0.5 * coordinate[i, at.STIFFNESS] * z[i] * z[i]
    own = np.zeros(10)
    for b in range(body_int.shape[0]):
        ints, floats, here = body_int[b], body_float[b], chain.moving[b]
        world, origin = rotation_at(here, at.WORLD), vector_at(here, at.ORIGIN)
        v, w = vector_at(here, at.VELOCITY), vector_at(here, at.OMEGA)
        if ints[at.FLEXIBLE] == 0:
            own[:] = 0.0
            own_rigid(floats, own)
            push, moment = times_inertia(own, v, w)
            kinetic += 0.5 * (dot(v, push) + dot(w, moment))
            place = add(times(own[0], origin), turn(world, (own[1], own[2], own[3])))
            weight -= dot(vector_at(gravity, 0), place)
            continue
        first, length, density = ints[at.FIRST], floats[at.LENGTH], floats[at.DENSITY]
        polar = floats[at.POLAR] * length
        for e in range(ints[at.ELEMENTS]):
            u1, u2 = node_values(z, first, e), node_values(z, first, e + 1)
            v1, v2 = node_values(dz, first, e), node_values(dz, first, e + 1)
            x = along(e * length + u1[0], (e + 1) * length + u2[0], length)
            y = (u1[1], u1[5], u2[1], u2[5])
            s = (u1[2], -u1[4], u2[2], -u2[4])
            dx, dy = along(v1[0], v2[0], length), (v1[1], v1[5], v2[1], v2[5])
            ds = (v1[2], -v1[4], v2[2], -v2[4])
            one = (1.0, 0.0, 1.0, 0.0)
            total = (0.0, 0.0, 0.0)
            for axis in range(3):
                if axis == 0:
                    a0, row, own_rate, field = v[0], (0.0, -w[2], w[1]), dx, x
                elif axis == 1:
                    a0, row, own_rate, field = v[1], (w[2], 0.0, -w[0]), dy, y
                else:
                    a0, row, own_rate, field = v[2], (-w[1], w[0], 0.0), ds, s
                p = (a0 * one[0] + row[0] * x[0] + row[1] * y[0] + row[2] * s[0] + own_rate[0],
                     row[0] * x[1] + row[1] * y[1] + row[2] * s[1] + own_rate[1],
                     a0 + row[0] * x[2] + row[1] * y[2] + row[2] * s[2] + own_rate[2],
                     row[0] * x[3] + row[1] * y[3] + row[2] * s[3] + own_rate[3])
                kinetic += 0.5 * inner(p, hermite_mass(p, length, density))
                h = hermite_mass(field, length, density)
                total = add(total, times(h[0] + h[2], unit(axis)))
            t1, t2 = w[0] + v1[3], w[0] + v2[3]
            kinetic += polar * (t1 * t1 + t1 * t2 + t2 * t2) / 6.0
            stretch = u2[0] - u1[0] + floats[at.STRETCH] * 0.5 * (
                inner(y, hermite_slope(y, length)) + inner(s, hermite_slope(s, length)))
            elastic += 0.5 * (
                floats[at.EA] / length * stretch**2
                + floats[at.GJ] / length * (u2[3] - u1[3]) ** 2
                + inner(y, hermite_stiffness(y, length, floats[at.EIZ]))
                + inner(s, hermite_stiffness(s, length, floats[at.EIY])))
            place = add(times(density * length, origin), turn(world, total))
            weight -= dot(vector_at(gravity, 0), place)
    return kinetic, elastic, weight


# -- What is handed to a plant: taken as it is, or refused in one line

def put(
    vector: FloatArray, places: NDArray[np.intp], values: ArrayLike, name: str,
    joints: Sequence[str],
) -> None:
    """
    Put a value of each joint where it belongs.

    places (joints,), values (joints,) [unit of the vector]; writes vector (n,).
    """
    try:
        vector[places] = values
    except (TypeError, ValueError):
        msg = (f'{name} is {repr(values)[:60]}; expected {places.size} numbers, for the '
               f'joints {list(joints)}')
        raise SimulationError(msg) from None


def put_force(wrench: FloatArray, force: FloatArray, tip: int) -> None:
    """
    Put an external force where it acts.

    force (3,) [N, N m]; writes wrench (points, 6) [N, N m].
    """
    if force.shape == wrench.shape:
        wrench[:] = force
    elif force.shape in ((3,), (6,)):
        wrench[:] = 0.0
        wrench[tip, :force.size] = force
    else:
        msg = (f'external_force has shape {force.shape}; expected (3,) or (6,) at the tip, '
               f'or {wrench.shape} for all points')
        raise SimulationError(msg)


# -- What a plant reports after a step, and after one that failed

DrivenBy = Literal['torque', 'motion', 'hold']


@dataclass(eq=False)
class PlantState:
    """State after a step; the arrays are overwritten by the next one."""

    t: float  # time of the state [s]
    # All joints of the mechanism, (joints,) [rad or m and their rates].
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    # Effort of each drive: as given where the joint is driven by a torque, the reaction where its
    # motion is given or held, (joints,) [N m or N].
    effort: FloatArray


@dataclass(frozen=True)
class Energy:
    """Kinetic, elastic and gravitational energy [J]."""

    kinetic: float  # energy of the motion [J]
    elastic: float  # energy of beams and joint springs [J]
    gravity: float  # energy of the masses in the field of gravity [J]

    @property
    def total(self) -> float:
        """Sum [J]."""
        return self.kinetic + self.elastic + self.gravity


@dataclass(frozen=True)
class Counts:
    """Newton iterations and factorisations since the last reset."""

    iterations: int  # Newton iterations since the last reset
    factorisations: int  # factorisations since the last reset


def failure_message(
    status: int, name: str, t: float, dt: float, energy: float, loose: list[str],
) -> str:
    """Put a failure into one line: t, dt [s], energy [J]."""
    if status == gen.BAD_INPUT:
        return f'{name}: a torque, force or motion at t = {t:.6g} s is not finite; check the input'
    if status == gen.SINGULAR:
        return (f'{name}: the mass matrix is singular: a joint or node moves nothing (joints free '
                f'to move: {loose}); give every moving link a mass, or a hub_inertia')
    if status == gen.TOO_BENT:
        return (f'{name}: at t = {t:.6g} s a link is bent by more than {settings.MAX_ROTATION} '
                f'rad, where a linear beam means nothing; energy before: {energy:.6g} J; check '
                'torques and sections')
    return (f'{name}: the run diverged at t = {t:.6g} s, energy before: {energy:.6g} J; take a '
            f'smaller step than {dt:g} s or check torques and masses')


# -- Static equilibrium of a mechanism, and whether a step can follow its links

Imbalance = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]


def find_equilibrium(
    mechanism: Mechanism, z: FloatArray, stiffness: FloatArray, imbalance: Imbalance,
) -> None:
    """
    Bend the links as they rest under weight and forces, joints where they are.

    Newton with the elastic tangent stiffness, which gravity hardly changes.

    z (n,) [rad, m], stiffness (n, n).
    """
    elastic = mechanism.elastic
    if not elastic.any():
        return
    pick = np.ix_(elastic, elastic)
    zero = np.zeros_like(z)
    for _ in range(100):
        tangent = np.tril(stiffness)
        add_stretch(z, mechanism.body_int, mechanism.body_float, 1.0, 0.0, tangent)
        tangent = tangent + np.tril(tangent, -1).T
        missing = imbalance(z, zero, zero)[elastic]
        change = np.linalg.solve(tangent[pick], missing)
        # Shorter first steps where a beam bends far: the normal force overshoots.
        largest = float(np.abs(change).max())
        if not np.isfinite(largest) or np.abs(z[elastic]).max() > 1e3:
            break
        z[elastic] -= change * min(1.0, 0.2 / max(largest, 1e-300))
        if largest < 1e-11:
            return
    msg = (f'{mechanism.name}: no static equilibrium was found, the links are too weak for their '
           'weight; check sections and material, or set simulation.start: undeformed')
    raise SimulationError(msg)


def check_step(
    mechanism: Mechanism, stiffness: FloatArray, mass: FloatArray, dt: float,
) -> None:
    """
    Refuse a step that cannot follow the slowest vibration of the links, joints held.

    stiffness, mass (n, n), dt [s].
    """
    free = np.flatnonzero(mechanism.elastic)
    if free.size == 0:
        return
    pick = np.ix_(free, free)
    flexibility = np.linalg.solve(stiffness[pick], mass[pick])
    slowest = 1.0 / np.sqrt(np.abs(np.linalg.eigvals(flexibility)).max()) / (2.0 * np.pi)
    # Links so stiff that 2 ms do not follow them are meant as rigid: they stay damped.
    if dt * slowest > 1.0 / 8.0 and dt > 2e-3:
        msg = (f'{mechanism.name}: a step of {dt:g} s is too large, the slowest '
               f'vibration of the links has {slowest:.3g} Hz; take at most '
               f'{1.0 / (8.0 * slowest):.2g} s, better {1.0 / (100.0 * slowest):.1g} s')
        raise SimulationError(msg)


# -- A mechanism that is advanced step by step: the plant of a control loop

__all__ = ['Counts', 'DrivenBy', 'Energy', 'Plant', 'PlantState']


class Plant:
    """
    A mechanism with its state and its integrator.

    Parameters
    ----------
    mechanism : Mechanism
        Tables, see ``build_mechanism``. Changes of them count from the next ``reset`` or
        ``parameters_changed``.
    dt : float
        Step of the integrator [s].
    rho : float
        Damping of the highest frequencies, 0 to 1 (1: none).
    tolerance : float
        Of Newton's iteration, relative to the accelerations.

    Raises
    ------
    SimulationError
        If the step is not positive, too large for the mechanism, or the mass matrix is singular.

    Attributes
    ----------
    tables : PlantTables
        Arrays of the plant, for compiled functions that advance or observe it.
    loaded : bool
        Whether forces act from outside.
    bodies : ndarray of int, shape (n_joints,)
        Body after each joint.

    """

    def __init__(
        self, mechanism: Mechanism, dt: float = 1e-3, *, rho: float = 0.9,
        tolerance: float = 1e-6,
    ) -> None:
        check_type(mechanism, Mechanism, 'mechanism', 'build_mechanism(arm)')
        if not (np.isfinite(dt) and dt > 0.0):
            msg = f'the step must be positive, found {dt} s'
            raise SimulationError(msg)
        if not 0.0 <= rho <= 1.0:
            msg = f'rho is the damping of the integrator, from 0 to 1, found {rho}'
            raise SimulationError(msg)
        self.mechanism = mechanism
        n = mechanism.size
        self.tables = PlantTables(
            vectors=np.zeros((gen.VECTORS, n)), matrices=np.zeros((gen.MATRICES, n, n)),
            settings=np.zeros(gen.SETTINGS), prescribed=np.zeros(n, dtype=bool),
            torque=np.zeros(n), motion=np.zeros((3, n)), chain=mechanism.chain(),
            composite=mechanism.composite())
        self.loaded = False
        self.tables.settings[[gen.STEP, gen.RHO, gen.TOLERANCE]] = dt, rho, tolerance
        self._q = mechanism.q_index
        self.bodies = np.array([mechanism.body_of[name] for name in mechanism.joints])
        self._drives = ['torque' if active else 'hold' for active in mechanism.driven]
        self._joints = Joints(self._q, self.bodies, np.zeros((4, self._q.size)))
        self._places = reported_places(self.tables, self._joints)
        self.state = PlantState(0.0, *self._joints.state)  # rows are views
        self.dt = dt
        self.reset()
        check_step(mechanism, self.stiffness, self.mass_matrix(), dt)

    def parameters_changed(self) -> None:
        """Take over changed tables of the mechanism: stiffness, damping, masses."""
        mechanism = self.mechanism
        stiffness_matrix(mechanism.body_int, mechanism.body_float, mechanism.coordinate,
                         self.tables.matrices[gen.STIFFNESS], self.tables.matrices[gen.DAMPING])
        self.tables.chain.base[:] = -mechanism.gravity
        self.tables.settings[gen.FACTORED] = 0.0

    @property
    def coordinates(self) -> FloatArray:
        """All coordinates, joints and nodes; a view [rad, m]."""
        return self.tables.vectors[gen.Z]

    @property
    def rates(self) -> FloatArray:
        """Rates of all coordinates; a view."""
        return self.tables.vectors[gen.DZ]

    @property
    def stiffness(self) -> FloatArray:
        """Elastic stiffness matrix of the straight links; a view."""
        return self.tables.matrices[gen.STIFFNESS]

    @property
    def prescribed(self) -> NDArray[np.bool_]:
        """Which coordinates follow a given motion; a view."""
        return self.tables.prescribed

    def energy(self) -> Energy:
        """Give the energy of the present state [J]."""
        tables = self.tables
        z, dz = tables.vectors[gen.Z], tables.vectors[gen.DZ]
        forward(z, dz, tables.vectors[gen.DDZ], tables.chain, 0.0)
        return Energy(*energy(z, dz, self.mechanism.gravity, tables.chain))

    def mass_matrix(self) -> FloatArray:
        """Give the mass matrix over all coordinates at the present state."""
        z, chain = self.tables.vectors[gen.Z], self.tables.chain
        result = np.empty((z.size, z.size))
        forward(z, z * 0.0, z * 0.0, chain, 0.0)
        mass_matrix(z, chain, self.tables.composite, result)
        return result

    def imbalance(
        self, z: FloatArray, dz: FloatArray, ddz: FloatArray, *, elastic: bool = True,
    ) -> FloatArray:
        """
        Give the generalised force that a motion needs.

        Parameters
        ----------
        z, dz, ddz : ndarray of shape (n,)
            Coordinates and rates.
        elastic : bool
            Whether the stiffness counts.

        Returns
        -------
        ndarray of shape (n,)
            Joint efforts, and what is missing at elastic coordinates.

        """
        result = np.empty(self.mechanism.size)
        inverse_dynamics(z, dz, ddz, self.tables.chain, self.loaded, float(elastic), result)
        return result

    def reset(
        self, q: ArrayLike | None = None, dq: ArrayLike | None = None, *,
        equilibrium: bool | None = None, external_force: ArrayLike | None = None,
    ) -> PlantState:
        """
        Restart.

        Parameters
        ----------
        q, dq : array of shape (n_joints,), optional
            Joint positions and velocities; as described, and at rest, by default.
        equilibrium : bool, optional
            Bend the links as they hang at rest at ``q``; as described by default.
        external_force : array of shape (3,), (6,) or (points, 6), optional
            Acts at the start, see ``step`` [N, N m].

        Returns
        -------
        PlantState
            State at t = 0.

        Raises
        ------
        SimulationError
            If there is no static equilibrium, or the mass matrix is singular.

        """
        self.tables.vectors[:] = 0.0
        self.tables.torque[:] = 0.0
        self.tables.chain.wrench[:] = 0.0
        self.loaded = False
        self.tables.vectors[gen.Z] = self.mechanism.initial
        if q is not None:
            self._put(self.tables.vectors[gen.Z], q, 'q')
        for index, drive in zip(self._q, self._drives, strict=True):
            self.tables.prescribed[index] = drive != 'torque'
        self.parameters_changed()
        if external_force is not None:
            self._set_force(np.asarray(external_force, dtype=float))
        if equilibrium is None:
            equilibrium = self.mechanism.start == 'equilibrium'
        if equilibrium:
            find_equilibrium(self.mechanism, self.coordinates, self.stiffness, self.imbalance)
        if dq is not None:
            self._put(self.tables.vectors[gen.DZ], dq, 'dq')
        self.tables.motion[0, self._q] = self.tables.vectors[gen.Z, self._q]
        self.tables.settings[[gen.FACTORED, gen.PEAK, gen.ITERATIONS, gen.FACTORS]] = 0.0
        self.tables.settings[[gen.CONTRACTION, gen.ORDER]] = 0.5, 1.0
        self._time_steps, self._t0 = 0, 0.0
        self._start_accelerations()
        self._read_state()
        return self.state

    def drive(self, joint: str, kind: DrivenBy) -> None:
        """
        Choose how a joint is driven from the next step on.

        Parameters
        ----------
        joint : str
            Name of the joint.
        kind : {'torque', 'motion', 'hold'}
            By its torque, by a motion given with each step, or held where it is.

        Raises
        ------
        SimulationError
            If there is no such joint or kind.

        """
        if joint not in self.mechanism.joints or kind not in ('torque', 'motion', 'hold'):
            msg = (f'joint {joint!r} cannot be driven by {kind!r}: joints are '
                   f'{list(self.mechanism.joints)}, drives torque, motion and hold')
            raise SimulationError(msg)
        number = self.mechanism.joints.index(joint)
        index = self._q[number]
        self._drives[number] = kind
        self.tables.prescribed[index] = kind != 'torque'
        if kind == 'hold':
            self.tables.motion[:, index] = self.tables.vectors[gen.Z, index], 0.0, 0.0
            self.tables.vectors[gen.DZ, index] = 0.0
        self._start_accelerations()

    def step(
        self, torque: ArrayLike | None = None, external_force: ArrayLike | None = None,
        motion: tuple[ArrayLike, ArrayLike, ArrayLike] | None = None,
    ) -> PlantState:
        """
        Advance by one step.

        Parameters
        ----------
        torque : array of shape (n_joints,), optional
            Torque of each joint at the end of the step; as before by default [N m or N].
        external_force : array of shape (3,), (6,) or (points, 6), optional
            Force, or force and moment, at the tip or at all points, in the base frame; none by
            default [N, N m].
        motion : tuple of 3 arrays of shape (n_joints,), optional
            Position, velocity and acceleration at the end of the step of joints driven by motion.

        Returns
        -------
        PlantState
            The state, the same object at every step.

        Raises
        ------
        SimulationError
            If an input is not finite or the run diverges; the state is that before the step.

        """
        tables = self.tables
        if torque is not None:
            self._put(tables.torque, torque, 'torque')
        if external_force is not None:
            self._set_force(np.asarray(external_force, dtype=float))
        elif self.loaded:
            tables.chain.wrench[:] = 0.0
            self.loaded = False
        if motion is not None:
            self._set_motion(motion)
        status = step_and_report(self.loaded, self._places)
        if status != gen.OK:
            self._fail(status)
        self._time_steps += 1
        self.state.t = self._t0 + self._time_steps * self.dt
        return self.state

    def taken(self, steps: int, status: int) -> None:
        """
        Take over what a compiled loop has done with the tables.

        Parameters
        ----------
        steps : int
            Steps since the last ``reset``.
        status : int
            Of the last step, see ``integrator.step``.

        Raises
        ------
        SimulationError
            If that step failed.

        """
        self._time_steps = steps
        if status != gen.OK:
            self._fail(status)

    def start_torque(self, torque: ArrayLike) -> None:
        """
        Give the torque that acts already at the start, for the first accelerations.

        Parameters
        ----------
        torque : array of shape (n_joints,)
            Torque of each joint at the start [N m or N].

        """
        self.tables.torque[self._q] = torque
        self._start_accelerations()
        self._read_state()

    def set_state(self, t: float, z: FloatArray, dz: FloatArray, torque: FloatArray) -> None:
        """
        Put the plant into a state, and solve for its accelerations.

        Parameters
        ----------
        t : float
            Time of the state [s].
        z, dz : ndarray of shape (n,)
            Coordinates and rates.
        torque : ndarray of shape (n_joints,)
            Torque of each joint [N m or N].

        """
        self.tables.vectors[gen.Z], self.tables.vectors[gen.DZ] = z, dz
        self.tables.torque[self._q] = torque
        self._t0, self._time_steps = t, 0
        self._start_accelerations()
        self._read_state()

    def counts(self) -> Counts:
        """Give the iterations and factorisations since the last reset."""
        counts = self.tables.settings
        return Counts(int(counts[gen.ITERATIONS]), int(counts[gen.FACTORS]))

    def solve_accelerations(
        self, z: FloatArray, dz: FloatArray, torque: FloatArray,
    ) -> FloatArray:
        """
        Solve the equations of motion for the accelerations: the right side of an ODE.

        Parameters
        ----------
        z, dz : ndarray of shape (n,)
            Coordinates and rates.
        torque : ndarray of shape (n_joints,)
            Torque of each joint [N m or N].

        Returns
        -------
        ndarray of shape (n,)
            Accelerations; those of prescribed coordinates as last given.

        Raises
        ------
        SimulationError
            If the mass matrix is singular.

        """
        tables = self.tables
        saved = tables.vectors.copy(), tables.torque.copy()
        tables.vectors[gen.Z], tables.vectors[gen.DZ] = z, dz
        tables.torque[self._q] = torque
        tables.vectors[gen.DDZ, tables.prescribed] = tables.motion[2, tables.prescribed]
        self._start_accelerations()
        result = tables.vectors[gen.DDZ].copy()
        tables.vectors[:], tables.torque[:] = saved
        return result

    def _start_accelerations(self) -> None:
        tables = self.tables
        tables.vectors[gen.DDZ, tables.prescribed] = tables.motion[2, tables.prescribed]
        regular = gen.accelerations(tables, self.loaded)
        tables.settings[gen.FACTORED] = 0.0
        if not regular:
            self._fail(gen.SINGULAR)
        tables.vectors[gen.ACC] = tables.vectors[gen.OLD_DDZ] = tables.vectors[gen.DDZ]

    def _put(self, vector: FloatArray, values: ArrayLike, name: str) -> None:
        put(vector, self._q, values, name, self.mechanism.joints)

    def _set_force(self, force: FloatArray) -> None:
        wrench = self.tables.chain.wrench
        put_force(wrench, force, self.mechanism.tip)
        if not np.isfinite(wrench).all():
            self._fail(gen.BAD_INPUT)
        self.loaded = True

    def _set_motion(self, motion: tuple[ArrayLike, ArrayLike, ArrayLike]) -> None:
        for row, values in enumerate(motion):
            given = np.asarray(values, dtype=float)
            for number, drive in enumerate(self._drives):
                if drive == 'motion':
                    self.tables.motion[row, self._q[number]] = given[number]

    def _read_state(self) -> None:
        self.state.t = self._t0 + self._time_steps * self.dt
        report(self.tables, self._joints)

    def _fail(self, status: int) -> NoReturn:
        loose = [joint for joint, index in zip(self.mechanism.joints, self._q, strict=True)
                 if not self.tables.prescribed[index]]
        t = self._t0 + (self._time_steps + 1) * self.dt
        raise SimulationError(failure_message(
            status, self.mechanism.name, t, self.dt, self.energy().total, loose))
