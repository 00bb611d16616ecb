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

from dataclasses import dataclass
from typing import Literal, NamedTuple, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from tudor_dynamics.errors import check_type, SimulationError
from tudor_dynamics.mechanics import chain as at, integrator as gen, settings
from tudor_dynamics.mechanics.chain import forward
from tudor_dynamics.mechanics.equations import inverse_dynamics
from tudor_dynamics.mechanics.integrator import Joints, PlantTables, report, step_and_report
from tudor_dynamics.mechanics.matrices import (
    add_stretch, mass_matrix, stiffness_matrix, stretch_energy)
from tudor_dynamics.mechanics.mechanism import Mechanism
from tudor_dynamics.typing import FloatArray, Shown


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


class Energy(NamedTuple):
    """Kinetic, elastic and gravitational energy [J]."""

    kinetic: float  # energy of the motion [J]
    elastic: float  # energy of beams and joint springs [J]
    gravity: float  # energy of the masses in the field of gravity [J]

    @property
    def total(self) -> float:
        """Sum [J]."""
        return self.kinetic + self.elastic + self.gravity


class Plant(Shown):
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
    coordinates, rates : ndarray of shape (n,)
        All coordinates, joints and nodes, and their rates; views of the tables [rad, m].
    loaded : bool
        Whether forces act from outside.
    bodies : ndarray of int, shape (n_joints,)
        Body after each joint.

    """

    def __init__(
        self, mechanism: Mechanism, dt: float = 1e-3, *, rho: float = 0.9, tolerance: float = 1e-6,
    ) -> None:
        check_type(mechanism, Mechanism, 'mechanism', 'build_mechanism(arm)')
        if not (np.isfinite(dt) and dt > 0.0):
            raise SimulationError(f'dt= {dt}: give more than 0 s')
        if not 0.0 <= rho <= 1.0:
            raise SimulationError(f'rho, damping of the integrator, is {rho}; give 0 to 1')
        self.mechanism = mechanism
        n = mechanism.size
        self.tables = PlantTables(
            vectors=np.zeros((gen.VECTORS, n)), matrices=np.zeros((gen.MATRICES, n, n)),
            settings=np.zeros(gen.SETTINGS), prescribed=np.zeros(n, dtype=bool),
            torque=np.zeros(n), motion=np.zeros((3, n)), chain=mechanism.chain(),
            composite=mechanism.composite())
        self.coordinates, self.rates = self.tables.vectors[gen.Z], self.tables.vectors[gen.DZ]
        self._stiffness = self.tables.matrices[gen.STIFFNESS]  # of the straight links
        self.loaded = False
        self.tables.settings[[gen.STEP, gen.RHO, gen.TOLERANCE]] = dt, rho, tolerance
        self._q = mechanism.q_index
        self.bodies = np.array([mechanism.body_of[name] for name in mechanism.joints])
        self._drives = ['torque' if active else 'hold' for active in mechanism.driven]
        self._joints = Joints(self._q, self.bodies, np.zeros((4, self._q.size)))
        self.state = PlantState(0.0, *self._joints.state)  # rows are views
        self.dt = dt
        self.reset()
        self._check_step()

    def parameters_changed(self) -> None:
        """Take over changed tables of the mechanism: stiffness, damping, masses."""
        mechanism = self.mechanism
        stiffness_matrix(mechanism.body_int, mechanism.body_float, mechanism.coordinate,
                         self.tables.matrices[gen.STIFFNESS], self.tables.matrices[gen.DAMPING])
        self.tables.chain.base[:] = -mechanism.gravity
        self.tables.settings[gen.FACTORED] = 0.0

    def energy(self) -> Energy:
        """Give the energy of the present state [J]."""
        mechanism, chain, z, dz = self.mechanism, self.tables.chain, self.coordinates, self.rates
        kinetic = 0.5 * dz @ self.mass_matrix() @ dz
        elastic = 0.5 * z @ self._stiffness @ z + stretch_energy(
            z, mechanism.body_int, mechanism.body_float)
        gravity = 0.0
        for b in np.flatnonzero(mechanism.body_int[:, at.PARENT] < 0):
            mass, *moment = self.tables.composite.inertias[b, :4]  # of all that the body carries
            here = chain.moving[b]
            gravity -= float(mechanism.gravity @ (
                mass * here[at.ORIGIN:][:3] + here[at.WORLD:][:9].reshape(3, 3) @ moment))
        return Energy(float(kinetic), float(elastic), gravity)

    def mass_matrix(self) -> FloatArray:
        """Give the mass matrix over all coordinates at the present state."""
        z, chain = self.tables.vectors[gen.Z], self.tables.chain
        result = np.empty((z.size, z.size))
        forward(z, z * 0.0, z * 0.0, chain, 0.0)
        mass_matrix(z, chain, self.tables.composite, result)
        return result

    def bent_stiffness(self) -> FloatArray:
        """Give the tangent stiffness over all coordinates at the present state, (n, n)."""
        bent = self._stiffness.copy()
        add_stretch(self.coordinates, self.mechanism.body_int, self.mechanism.body_float, 1.0, 0.0,
                    bent)
        return np.tril(bent) + np.tril(bent, -1).T

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
        self.tables.prescribed[self._q] = [drive != 'torque' for drive in self._drives]
        self.parameters_changed()
        if external_force is not None:
            self._set_force(external_force)
        if equilibrium is None:
            equilibrium = self.mechanism.start == 'equilibrium'
        if equilibrium:
            self._find_equilibrium()
        if dq is not None:
            self._put(self.tables.vectors[gen.DZ], dq, 'dq')
        self.tables.motion[0, self._q] = self.tables.vectors[gen.Z, self._q]
        self.tables.settings[[gen.FACTORED, gen.PEAK, gen.ITERATIONS, gen.FACTORS]] = 0.0
        self.tables.settings[[gen.CONTRACTION, gen.ORDER]] = 0.5, 1.0
        self._time_steps, self._t0 = 0, 0.0
        self._start()
        return self.state

    def drive(self, joint: str, kind: DrivenBy) -> None:
        """Choose how a joint is driven from now on: by torque, by a given motion, or held."""
        if joint not in self.mechanism.joints or kind not in ('torque', 'motion', 'hold'):
            raise SimulationError(f'joint {joint!r} cannot be driven by {kind!r}; give a joint '
                                  f'of {list(self.mechanism.joints)}, and torque, motion or hold')
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
            self._set_force(external_force)
        elif self.loaded:
            tables.chain.wrench[:] = 0.0
            self.loaded = False
        if motion is not None:
            follows = [number for number, kind in enumerate(self._drives) if kind == 'motion']
            for row, values in zip(tables.motion, motion, strict=True):
                row[self._q[follows]] = np.asarray(values, dtype=float)[follows]
        status = step_and_report(self.loaded, self.tables, self._joints)
        if status != gen.OK:
            self._fail(status)
        self._time_steps += 1
        self.state.t = self._t0 + self._time_steps * self.dt
        return self.state

    def taken(self, steps: int, status: int) -> None:
        """Take over what a compiled loop did since ``reset``: its steps, and its last status."""
        self._time_steps = steps
        if status != gen.OK:
            self._fail(status)

    def start_torque(self, torque: ArrayLike) -> None:
        """Give the torque, shape (n_joints,), that acts already at the start [N m or N]."""
        self.tables.torque[self._q] = torque
        self._start()

    def _start_accelerations(self) -> None:
        tables = self.tables
        tables.vectors[gen.DDZ, tables.prescribed] = tables.motion[2, tables.prescribed]
        regular = gen.accelerations(tables, self.loaded)
        tables.settings[gen.FACTORED] = 0.0
        if not regular:
            self._fail(gen.SINGULAR)
        tables.vectors[gen.ACC] = tables.vectors[gen.OLD_DDZ] = tables.vectors[gen.DDZ]

    def _put(self, vector: FloatArray, values: ArrayLike, name: str) -> None:
        """Write a value of each joint at its coordinate."""
        try:
            vector[self._q] = values
        except (TypeError, ValueError):
            msg = (f'{name} is {repr(values)[:60]}; expected {self._q.size} numbers, for the '
                   f'joints {list(self.mechanism.joints)}')
            raise SimulationError(msg) from None

    def _set_force(self, given: ArrayLike) -> None:
        """Take an external force [N, N m] at the tip, or forces at all points."""
        wrench, force = self.tables.chain.wrench, np.asarray(given, dtype=float)
        if force.shape not in ((3,), (6,), wrench.shape):
            raise SimulationError(f'external_force has shape {force.shape}; expected (3,) or (6,) '
                                  f'at the tip, or {wrench.shape} for all points')
        if force.ndim == 1:
            wrench[:] = 0.0
            wrench[self.mechanism.tip, :force.size] = force
        else:
            wrench[:] = force
        if not np.isfinite(wrench).all():
            self._fail(gen.BAD_INPUT)
        self.loaded = True

    def _start(self) -> None:
        """Solve for the accelerations of the present state, and report it."""
        self._start_accelerations()
        self.state.t = self._t0 + self._time_steps * self.dt
        report(self.tables, self._joints)

    def _find_equilibrium(self) -> None:
        """Bend the links as they rest at these joints: Newton, elastic tangent stiffness."""
        mechanism, z = self.mechanism, self.coordinates
        elastic = mechanism.elastic
        if not elastic.any():
            return
        pick, zero = np.ix_(elastic, elastic), np.zeros_like(z)
        for _ in range(100):
            missing = self.imbalance(z, zero, zero)[elastic]
            change = np.linalg.solve(self.bent_stiffness()[pick], missing)
            # Shorter first steps where a beam bends far: the normal force overshoots.
            largest = float(np.abs(change).max())
            if not np.isfinite(largest) or np.abs(z[elastic]).max() > 1e3:
                break
            z[elastic] -= change * min(1.0, 0.2 / max(largest, 1e-300))
            if largest < 1e-11:
                return
        raise SimulationError(f'arm {mechanism.name!r}: links are too weak for their weight; '
                              'correct their section and material, or set simulation.start: '
                              'undeformed in the arm description')

    def _check_step(self) -> None:
        """Refuse a step that cannot follow the slowest vibration of the links, joints held."""
        free = np.flatnonzero(self.mechanism.elastic)
        if free.size == 0:
            return
        pick = np.ix_(free, free)
        flexibility = np.linalg.solve(self._stiffness[pick], self.mass_matrix()[pick])
        slowest = 1.0 / np.sqrt(np.abs(np.linalg.eigvals(flexibility)).max()) / (2.0 * np.pi)
        # Links so stiff that 2 ms do not follow them are meant as rigid: they stay damped.
        if self.dt * slowest > 1.0 / 8.0 and self.dt > 2e-3:
            msg = (f'arm {self.mechanism.name!r}: dt= {self.dt:g} s is too large, as links '
                   f'vibrate at {slowest:.3g} Hz and above; give at most '
                   f'{1.0 / (8.0 * slowest):.2g} s, better {1.0 / (100.0 * slowest):.1g} s')
            raise SimulationError(msg)

    def _fail(self, status: int) -> NoReturn:
        """Put a failure into one line."""
        name, t = f'arm {self.mechanism.name!r}', self._t0 + (self._time_steps + 1) * self.dt
        if status == gen.BAD_INPUT:
            msg = (f'{name}: a torque, force or motion at t = {t:.6g} s is not finite; check the '
                   'input')
        elif status == gen.SINGULAR:
            loose = [joint for joint, index in zip(self.mechanism.joints, self._q, strict=True)
                     if not self.tables.prescribed[index]]
            msg = (f'{name}: joint {" or ".join(map(repr, loose))}, or a beam, moves no mass; in '
                   "the key 'links', add mass or hub_inertia to the entry of what lacks it")
        elif status == gen.TOO_BENT:
            msg = (f'{name}: at {t:.4g} s a link bends by more than {settings.MAX_ROTATION} rad, '
                   'where the model of a beam is wrong; lower the torques, or give links a '
                   'stiffer section in the arm description')
        else:
            msg = (f'{name}: the simulation diverged at {t:.4g} s; lower the torques, correct '
                   'masses that are too small in the arm description, or take time '
                   f'steps below {self.dt:g} s')
        raise SimulationError(msg)
