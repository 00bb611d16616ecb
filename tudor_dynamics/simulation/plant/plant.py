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

"""A mechanism that is advanced step by step: the plant of a control loop."""

from __future__ import annotations

from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike

from tudor_dynamics.errors import check_type, SimulationError
from tudor_dynamics.simulation.mechanics.mechanism import Mechanism
from tudor_dynamics.simulation.plant import integrator as gen
from tudor_dynamics.simulation.plant.dynamics import Dynamics
from tudor_dynamics.simulation.plant.inputs import check_settings, put, put_force
from tudor_dynamics.simulation.plant.reported_step import (
    Joints, report, reported_places, step_and_report)
from tudor_dynamics.simulation.plant.state import (
    Counts, Drive, Energy, failure_message, PlantState)
from tudor_dynamics.simulation.plant.statics import check_step, find_equilibrium
from tudor_dynamics.typing import FloatArray

__all__ = ['Counts', 'Drive', 'Energy', 'Plant', 'PlantState']


class Plant(Dynamics):
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
    bodies : ndarray of int, shape (n_joints,)
        Body behind each joint.

    """

    def __init__(
        self, mechanism: Mechanism, dt: float = 1e-3, *, rho: float = 0.9,
        tolerance: float = 1e-6,
    ) -> None:
        check_type(mechanism, Mechanism, 'mechanism', 'build_mechanism(arm)')
        check_settings(dt, rho)
        super().__init__(mechanism)
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

    def reset(
        self, q: ArrayLike | None = None, dq: ArrayLike | None = None, *,
        equilibrium: bool | None = None, external_force: ArrayLike | None = None,
    ) -> PlantState:
        """
        Start anew.

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

    def drive(self, joint: str, kind: Drive) -> None:
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
        settings = self.tables.settings
        return Counts(int(settings[gen.ITERATIONS]), int(settings[gen.FACTORS]))

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
