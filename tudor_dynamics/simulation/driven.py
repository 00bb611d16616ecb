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

"""
An arm whose joints follow measured positions: flexible links, elastic gears with play.

The plant of the simulator in the few coordinates that a recording shows: each gear's twist, and
each flexible link bent by one element in the planes that gauges see. One cubic element carries a
link's static shape under any end load exactly and its first mode within 0.5 %.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.kinematics import unit_vector
from tudor_dynamics.arm.links import InertiaPart
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.simulation import (
    driven_kernel as kernel, layout as at, observer_kernel as observer)
from tudor_dynamics.simulation.driven_linear import Linearised, tangents
from tudor_dynamics.simulation.loads import LOADS
from tudor_dynamics.simulation.mechanism import build_mechanism
from tudor_dynamics.simulation.stiffness import stiffness_matrix

FloatArray = NDArray[np.float64]

INNER_STEP = 2.5e-3
"""Longest inner step [s]: 1 % of phase at 15 Hz."""
EDGE = 0.1
"""The edge of a play is rounded over this part of it, where nothing better is known."""
SAMPLE = 0.01
"""Sample time that deviations of measurements belong to [s]."""
CONTACT_BANDWIDTH = 30.0
"""Rate at which the estimated force at the tip follows [1/s]."""
RIGID_GEAR = 30.0
"""A gear of unknown stiffness is this often as stiff as the link behind it."""


@dataclass(frozen=True, eq=False)
class Response:
    """
    What gauges and gears of a driven arm feel.

    Attributes
    ----------
    moment : ndarray of shape (n_samples, n_gauges)
        Moment that bends each gauge, positive for the load that the joint holds [N m].
    torque : ndarray of shape (n_samples, n_joints)
        Torque (or force) of each gear on the links [N m or N].

    """

    moment: FloatArray
    torque: FloatArray


def _reduced(arm: Arm) -> Arm:
    """Give the arm with one linear element a link; what lies within a link goes to its end."""
    links = []
    for link in arm.spec.links:
        beam = link.flexible
        if beam is not None:
            lumped = tuple(
                part if isinstance(part.node, str) else part.model_copy(
                    update={'node': 'tip' if 2 * part.node >= beam.elements else 'base'})
                for part in beam.lumped)
            beam = beam.model_copy(update={'elements': 1, 'stretch': False, 'lumped': lumped})
        links.append(link.model_copy(update={'flexible': beam}))
    payload = arm.spec.payload or InertiaPart(mass=0.0)
    return replace(arm, spec=arm.spec.model_copy(
        update={'links': tuple(links), 'payload': payload}))


class DrivenArm:
    """
    An arm driven by the measured positions of its active joints.

    Parameters
    ----------
    arm : Arm
        Description with ``links``; gears as in ``motors``, or ``joint_stiffness`` of the links.
    inner : float
        Longest inner step [s].

    Attributes
    ----------
    parameters : dict of str to float
        Physical parameters by name, in SI units: ``bending(link)`` [N m^2], ``density(link)``
        [kg/m], ``lumped(link,k)`` [kg], ``gear(joint)`` [N m/rad], ``play(joint)`` half of the
        backlash [rad], ``edge(joint)`` part of it over which the teeth come to bear, ``tight(joint)`` and ``loose(joint)``, damping of the gear where its teeth
        touch and inside the play [N m s/rad], ``alpha`` and ``beta``, structural damping by mass
        [1/s] and by stiffness [s], ``payload`` [kg].
    contact : ndarray of shape (3,)
        Force at the tip as the observer has it, base frame [N].

    Raises
    ------
    SimulationError
        If the description lacks links, no link is flexible, or a gauge sits on a rigid link.

    """

    def __init__(self, arm: Arm, *, inner: float = INNER_STEP) -> None:
        reduced = _reduced(arm)
        self.arm = arm
        self.inner = inner
        mechanism = self.mechanism = build_mechanism(reduced)
        if not mechanism.beams:
            msg = (f'{arm.source}: no link is flexible; give links with flexible: to use the '
                   'elastic model')
            raise SimulationError(msg)
        self._payload_body = len(mechanism.body_int) - 1
        self._payload_inertia = mechanism.body_float[
            self._payload_body, at.INERTIA:at.INERTIA + 6].copy()
        self._payload_mass = float(mechanism.body_float[self._payload_body, at.MASS])
        self._leaning = {link.joint for link in arm.spec.links
                         if link.flexible is not None and link.flexible.stretch}
        self._gauges(arm)
        self._gears(arm)
        n, bodies = mechanism.size, len(mechanism.body_int)
        m = self._free.size
        self._vectors = np.zeros((kernel.VECTORS, n))
        self._vectors[kernel.Z] = mechanism.initial
        self._matrices = np.zeros((kernel.MATRICES, n, n))
        self._factor, self._delta = np.zeros((m, m)), np.zeros(m)
        joints = self._spring_at.size
        self._path, self._past = np.zeros((joints, 3)), np.zeros((3, joints))
        self._aim, self._aim_rate = np.zeros(joints), np.zeros(joints)
        self._base = -mechanism.gravity
        self._wrench = np.zeros((mechanism.points, 6))
        self._loaded = False
        self.contact = np.zeros(observer.FORCES)
        self._columns, self._owner = np.zeros((n, 6)), np.zeros(n, dtype=np.int64)
        self._inertias = np.zeros((bodies + 1, 10))
        self._moving, self._reaction = np.zeros((bodies, at.MOVING)), np.zeros((bodies, 6))
        self._loads = np.zeros((len(arm.gauges), LOADS))
        self.parameters = self._described(arm)
        self.set_parameters({})

    @property
    def size(self) -> int:
        """Number of coordinates that move."""
        return int(self._free.size)

    def set_parameters(self, changes: Mapping[str, float]) -> None:
        """
        Change physical parameters.

        Parameters
        ----------
        changes : mapping of str to float
            Name to new value, see ``parameters``.

        Raises
        ------
        SimulationError
            If a name is unknown or a value not finite or negative.

        """
        for name, value in changes.items():
            if name not in self.parameters:
                msg = (f'{self.arm.name} has no parameter {name!r}; it has '
                       f'{", ".join(self.parameters)}')
                raise SimulationError(msg)
            if not (math.isfinite(value) and value >= 0.0):
                msg = f'parameter {name} of {self.arm.name}: {value}, expected 0 or more'
                raise SimulationError(msg)
            self.parameters[name] = float(value)
        mechanism, values = self.mechanism, self.parameters
        for joint in mechanism.beams:
            body, first = mechanism.body_of[joint], self._first_floats[joint]
            floats = mechanism.body_float[body]
            scale = values[f'bending({joint})'] / self._nominal[joint][0]
            floats[[at.EIY, at.EIZ, at.GJ]] = scale * first[[at.EIY, at.EIZ, at.GJ]]
            lighter = values[f'density({joint})'] / self._nominal[joint][1]
            floats[[at.DENSITY, at.POLAR]] = lighter * first[[at.DENSITY, at.POLAR]]
            floats[at.ALPHA], floats[at.BETA] = values['alpha'], values['beta']
            floats[at.EA] = 0.0  # beams keep their length: the kernel sees to it
            # below zero: linear beams, which nothing draws in
            floats[at.STRETCH] = 0.0 if joint in self._leaning else -1.0
        for name, (body, mass, inertia) in self._lumped.items():
            floats = mechanism.body_float[body]
            floats[at.MASS] = values[name]
            floats[at.INERTIA:at.INERTIA + 6] = inertia * (values[name] / mass)
        floats = mechanism.body_float[self._payload_body]
        floats[at.MASS] = values['payload']
        if self._payload_mass > 0.0:
            floats[at.INERTIA:at.INERTIA + 6] = self._payload_inertia * (
                values['payload'] / self._payload_mass)
        for row, joint in zip(self._springs, self.arm.active_joints, strict=True):
            play = values[f'play({joint})']
            row[:] = (values[f'gear({joint})'], play, max(values[f'edge({joint})'] * play, 1e-9),
                      values[f'tight({joint})'], values[f'loose({joint})'])
        for g, joint in enumerate(self._gauge_joint):
            self._gauge_gain[g, 1] = -self._gauge_gain[g, 0] * self._gauge_share[g] * (
                values['beta'] * values[f'bending({joint})'])
        stiffness_matrix(mechanism.body_int, mechanism.body_float, mechanism.coordinate,
                         self._matrices[kernel.STIFFNESS], self._matrices[kernel.DAMPING])

    def follow(self, q: FloatArray, dt: FloatArray) -> Response:
        """
        Follow motion; the state goes on from call to call.

        Parameters
        ----------
        q : ndarray of shape (n_samples, n_joints)
            Measured positions of the active joints [rad or m].
        dt : ndarray of shape (n_samples,)
            Time since the sample before [s]; 0 to begin anew, at rest.

        Returns
        -------
        Response
            At the samples.

        Raises
        ------
        SimulationError
            If no equilibrium is found where it begins, or the state grows without bounds.

        """
        n, gauges = len(q), len(self._gauge_body)
        moment, torque = np.zeros((n, gauges)), np.zeros((n, self._spring_at.size))
        done = kernel.follow(
            np.ascontiguousarray(q), np.ascontiguousarray(dt), self.inner, self._vectors,
            self._matrices, self._factor, self._delta, self._free, self._past, self._path,
            self._aim, self._aim_rate, self._springs, self._spring_at, self._base, self._wrench,
            self._loaded, self._columns, self._owner, self._inertias, self.mechanism.body_int,
            self.mechanism.body_float, self.mechanism.coordinate, self._moving, self._reaction,
            self._gauge_body, self._gauge_place, self._gauge_axis, self._gauge_gain, self._loads,
            moment, torque)
        if done < n:
            msg = (f'{self.arm.name}: the elastic model '
                   + (f'finds no equilibrium at q = {np.round(q[done], 3).tolist()}'
                      if dt[done] <= 0.0 else f'diverges after {done} of {n} samples')
                   + '; its parameters are impossible for this motion')
            raise SimulationError(msg)
        return Response(moment, torque)

    def linearised(self, q: FloatArray) -> Linearised:
        """
        Rest with the drives held at a pose, and linearise there; ``follow`` goes on from it.

        Parameters
        ----------
        q : ndarray of shape (n_joints,)
            Positions of the active joints [rad or m].

        Returns
        -------
        Linearised
            Mass, damping and stiffness of the coordinates that move.

        Raises
        ------
        SimulationError
            If there is no equilibrium.

        """
        self.follow(np.asarray(q, dtype=float)[None], np.zeros(1))
        result = np.zeros((3, self.size, self.size))
        tangents(self._vectors, self._free, self._aim, self._springs, self._spring_at,
                 self._base, self._wrench, self._loaded, self.mechanism.body_int,
                 self.mechanism.body_float, self.mechanism.coordinate, self._moving,
                 self._reaction, result)
        stiffness, damping, mass = result
        return Linearised(mass, damping, stiffness)

    def start_observer(
        self, deviation: FloatArray, bandwidth: float, *, contact: bool = False,
    ) -> None:
        """
        Let measured moments correct the state from now on, see ``correct``.

        Parameters
        ----------
        deviation : ndarray of shape (n_gauges,)
            Standard deviation of what a sample of 0.01 s measures [N m].
        bandwidth : float
            Rate at which an error of the first vibration dies out [1/s].
        contact : bool, default=False
            Estimate a lasting force at the tip as well.

        Raises
        ------
        SimulationError
            If the arm has no equilibrium where it starts.

        """
        m = self._free.size
        n = 2 * m + observer.FORCES
        self._deviation = np.maximum(np.asarray(deviation, dtype=float), 1e-12)
        self._covariance = np.zeros((n, n))
        self._small = np.zeros((3, m, m))
        self._pushed = np.zeros((m, observer.FORCES))
        self._shown = self._moment_rows()
        # how far a force at the tip shows, and the slowest vibration, where the arm starts
        start = self._vectors[kernel.Z, self._spring_at].copy()
        self.contact[:] = 0.0
        self._use_contact()
        self.follow(np.tile(start, (2, 1)), np.array([0.0, 1e-3]))
        self._linearise()
        mass, _, stiffness = self._small
        lever = float(np.linalg.norm(self._shown @ np.linalg.solve(stiffness, self._pushed)
                                     / self._deviation[:, None], 2))
        slowest = float(np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real.min()))
        # an oscillator that a white force of density q drives and white noise of density r hides
        # has a filter with the decay sqrt(q / r) lever w / 2 (spectral factorisation)
        self._noise = SAMPLE * (2.0 * bandwidth / max(lever * slowest, 1e-12)) ** 2
        self._walk = self._noise * CONTACT_BANDWIDTH**2 if contact else 0.0

    def forget(self) -> None:
        """Forget contact and uncertainty: the arm begins anew, at rest."""
        self._covariance[:] = 0.0
        self.contact[:] = 0.0
        self._use_contact()

    def correct(self, innovation: FloatArray, dt: float) -> bool:
        """
        Correct the state behind the newest sample.

        Parameters
        ----------
        innovation : ndarray of shape (n_gauges,)
            Measured less predicted moment at each gauge; NaN for one that does not count [N m].
        dt : float
            Time since the correction before [s].

        Returns
        -------
        bool
            False where the arm as it stands cannot be linearised.

        """
        self._linearise()
        mass, damping, stiffness = self._small
        good = observer.propagate(self._covariance, mass, damping, stiffness, self._pushed, dt,
                                  self._noise, self._walk)
        good = good and observer.correct(
            self._covariance, self._shown, self._deviation**2 * (SAMPLE / dt), innovation, mass,
            damping, stiffness, self._vectors, self._free, self.contact)
        self._use_contact()
        return bool(good)

    def _linearise(self) -> None:
        mechanism = self.mechanism
        observer.reduce_matrices(self._vectors, self._matrices, self._free, self._aim,
                                 self._springs, self._spring_at, *self._small)
        observer.tip_directions(
            self._vectors, self._free, mechanism.tip, self._base, self._wrench, self._loaded,
            mechanism.body_int, mechanism.body_float, mechanism.coordinate, self._moving,
            self._reaction, self._pushed)

    def _moment_rows(self) -> FloatArray:
        """Moment at each gauge by coordinate: stiffness times curvature of the cubic."""
        rows = np.zeros((len(self._gauge_body), self._free.size))
        floats = self.mechanism.body_float
        for g, body in enumerate(self._gauge_body):
            length = floats[body, at.LENGTH]
            place = self._gauge_place[g] / length
            bend = (12.0 * place - 6.0) / length**2
            turn = (6.0 * place - 2.0) / length
            first = int(self.mechanism.body_int[body, at.FIRST])
            if self._gauge_axis[g] == 2:
                stiff, parts = floats[body, at.EIZ], ((first + 1, -bend), (first + 5, turn))
            else:
                stiff, parts = floats[body, at.EIY], ((first + 2, bend), (first + 4, turn))
            for coordinate, factor in parts:
                rows[g, np.flatnonzero(self._free == coordinate)] = (
                    self._gauge_gain[g, 0] * stiff * factor)
        return rows

    def _use_contact(self) -> None:
        self._wrench[self.mechanism.tip, :3] = self.contact
        self._loaded = bool(np.any(self.contact != 0.0))

    def _gauges(self, arm: Arm) -> None:
        mechanism = self.mechanism
        bodies, places, axes, signs, shares, joints = [], [], [], [], [], []
        for gauge in arm.gauges:
            if gauge.joint not in mechanism.beams:
                msg = (f'{arm.source}: gauge {gauge.name!r} sits on the link of {gauge.joint!r}, '
                       'which is rigid here; make it flexible in links, or leave the gauge out')
                raise SimulationError(msg)
            body = mechanism.body_of[gauge.joint]
            floats, beam = mechanism.body_float[body], mechanism.beams[gauge.joint]
            frame = floats[at.BODY_ROTATION:at.BODY_ROTATION + 9].reshape(3, 3)
            start = floats[at.BODY_PLACE:at.BODY_PLACE + 3]
            axis = floats[at.AXIS:at.AXIS + 3] if gauge.axis is None else unit_vector(gauge.axis)
            local = frame.T @ axis
            column = 2 if abs(local[2]) >= abs(local[1]) else 1
            bodies.append(body)
            places.append(float(frame[:, 0] @ (
                gauge.distance * unit_vector(gauge.direction) - start)))
            axes.append(column)
            signs.append(-math.copysign(1.0, float(local[column])))
            shares.append((beam.EIz if column == 2 else beam.EIy) / beam.EIz)
            joints.append(gauge.joint)
        self._gauge_body = np.array(bodies, dtype=np.int64)
        self._gauge_place = np.array(places, dtype=float)
        self._gauge_axis = np.array(axes, dtype=np.int64)
        self._gauge_gain = np.column_stack([signs, np.zeros(len(signs))])
        self._gauge_share = shares
        self._gauge_joint = joints
        planes = {joint: {a for a, j in zip(axes, joints, strict=True) if j == joint}
                  for joint in mechanism.beams}
        seen = set(axes) or {1, 2}
        free = [int(mechanism.q_index[mechanism.joints.index(name)])
                for name in arm.active_joints]
        self._spring_at = np.array(free, dtype=np.int64)
        for joint in mechanism.beams:
            first = int(mechanism.body_int[mechanism.body_of[joint], at.FIRST])
            for plane in sorted(planes[joint] or seen):
                free += [first + 1, first + 5] if plane == 2 else [first + 2, first + 4]
        self._free = np.array(sorted(free), dtype=np.int64)

    def _gears(self, arm: Arm) -> None:
        self._springs = np.zeros((self._spring_at.size, kernel.SPRING_FLOATS))
        mechanism = self.mechanism
        self._first_floats = {joint: mechanism.body_float[mechanism.body_of[joint]].copy()
                              for joint in mechanism.beams}
        self._nominal = {joint: (beam.EIz, beam.density)
                         for joint, beam in mechanism.beams.items()}
        self._lumped: dict[str, tuple[int, float, FloatArray]] = {}
        carried = {body: joint for joint, body in mechanism.body_of.items()}
        for body in range(len(mechanism.body_int) - 1):
            joint = carried.get(int(mechanism.body_int[body, at.PARENT]))
            mass = float(mechanism.body_float[body, at.MASS])
            if body in carried or joint is None or mass <= 0.0:
                continue
            count = sum(name.startswith(f'lumped({joint},') for name in self._lumped)
            inertia = mechanism.body_float[body, at.INERTIA:at.INERTIA + 6].copy()
            self._lumped[f'lumped({joint},{count + 1})'] = body, mass, inertia

    def _described(self, arm: Arm) -> dict[str, float]:
        """Give the parameters as far as the description knows them."""
        values: dict[str, float] = {}
        stiffest = 0.0
        for joint, beam in self.mechanism.beams.items():
            values[f'bending({joint})'] = beam.EIz
            values[f'density({joint})'] = beam.density
            length = float(self._first_floats[joint][at.LENGTH])
            stiffest = max(stiffest, 3.0 * beam.EIz / length)
        for name, (_, mass, _) in self._lumped.items():
            values[name] = mass
        values['payload'] = self._payload_mass
        motors = {motor.joint: motor for motor in arm.spec.motors}
        links = {link.joint: link for link in arm.spec.links}
        for joint in arm.active_joints:
            motor, link = motors.get(joint), links.get(joint)
            stiffness = motor.stiffness if motor is not None else None
            damping = motor.damping if motor is not None else 0.0
            if stiffness is None and link is not None and link.joint_stiffness is not None:
                stiffness, damping = link.joint_stiffness, link.joint_damping
            values[f'gear({joint})'] = stiffness or RIGID_GEAR * stiffest
            values[f'play({joint})'] = 0.5 * motor.backlash if motor is not None else 0.0
            values[f'edge({joint})'] = EDGE
            values[f'tight({joint})'] = values[f'loose({joint})'] = damping
        rayleigh = arm.spec.simulation.rayleigh
        values['alpha'], values['beta'] = rayleigh.alpha, rayleigh.beta
        return values
