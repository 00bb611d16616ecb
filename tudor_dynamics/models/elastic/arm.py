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
from dataclasses import dataclass
import math

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.models.elastic import kernel, observer
from tudor_dynamics.models.elastic.gear import Gears, SPRING_FLOATS
from tudor_dynamics.models.elastic.kernel import Driven, Drives, Gauges
from tudor_dynamics.models.elastic.observer import seen_rows, white_force
from tudor_dynamics.models.elastic.parameters import apply, change, described
from tudor_dynamics.models.elastic.physics import Physics
from tudor_dynamics.models.elastic.setup import (
    moment_rows, moving_coordinates, place_gauges, reduced_mechanism, spring_coordinates)
from tudor_dynamics.models.elastic.small_motion import Linearised, tangents
from tudor_dynamics.models.elastic.statics import (
    DAMPING, Equations, MATRICES, STIFFNESS, VECTORS, Z)
from tudor_dynamics.signals.filters import low_pass
from tudor_dynamics.simulation.mechanics.loads import LOADS
from tudor_dynamics.simulation.mechanics.stiffness import stiffness_matrix
from tudor_dynamics.typing import FloatArray

INNER_STEP = 2.5e-3
"""Longest inner step [s]: 1 % of phase at 15 Hz."""
SAMPLE = 0.01
"""Sample time that deviations of measurements belong to [s]."""
NO_GAINS = np.zeros((1, 3, 0, 0))
"""Of an arm that follows positions alone."""


@dataclass(frozen=True, eq=False)
class Response:
    """What gauges and gears of a driven arm feel."""

    # Moment that bends each gauge, positive for the load that the joint holds, (samples, gauges)
    # [N m].
    moment: FloatArray
    torque: FloatArray  # torque (or force) of each gear on the links, (samples, joints) [N m or N]


class DrivenArm:
    """An arm driven by the measured positions of its active joints: inner [s]."""

    def __init__(self, arm: Arm, *, inner: float = INNER_STEP) -> None:
        self.arm, self.inner = arm, inner
        mechanism = self.mechanism = reduced_mechanism(arm)
        gauges = self.gauges = place_gauges(mechanism, arm)
        place = spring_coordinates(mechanism, arm)
        free = moving_coordinates(mechanism, gauges, place)
        n, m, joints = mechanism.size, free.size, place.size
        self.tables = Driven(
            Equations(np.zeros((VECTORS, n)), np.zeros((MATRICES, n, n)), np.zeros((m, m)),
                      np.zeros(m), free),
            Gears(np.zeros((joints, SPRING_FLOATS)), place, np.zeros(joints), np.zeros(joints)),
            Drives(np.zeros((3, joints)), np.zeros((joints, 3))),
            mechanism.chain(), mechanism.composite(),
            Gauges(gauges.body, gauges.place, gauges.axis,
                   np.column_stack([gauges.sign, np.zeros(len(gauges.sign))]),
                   np.zeros((len(gauges.body), LOADS))))
        self.arrays = tuple(array for table in self.tables for array in table)
        self._vectors = self.tables.equations.vectors
        self._vectors[Z] = mechanism.initial
        self.loaded = False
        self._reading = np.zeros(len(gauges.body))
        self._physics = Physics(arm, mechanism, self.tables.gears.springs)
        self.parameters = described(self._physics)
        self.set_parameters({})

    @property
    def size(self) -> int:
        """Give the number of coordinates that move."""
        return int(self.tables.equations.free.size)

    def set_parameters(self, changes: Mapping[str, float]) -> None:
        """Change physical parameters."""
        change(self.parameters, changes, self.arm.name)
        apply(self._physics, self.parameters)
        mechanism, matrices = self.mechanism, self.tables.equations.matrices
        stiffness_matrix(mechanism.body_int, mechanism.body_float, mechanism.coordinate,
                         matrices[STIFFNESS], matrices[DAMPING])
        gain = self.tables.gauges.gain
        gain[:, 1] = -gain[:, 0] * self.gauges.damping(self.parameters)

    def follow(self, q: FloatArray, dt: FloatArray) -> Response:
        """
        Follow motion; the state goes on from call to call.

        q (samples, joints) [rad or m]; dt (samples,) [s]: 0 to begin anew, at rest.
        """
        found = self.prompt(q, dt, np.zeros((len(q), 0)), NO_GAINS)
        return Response(self.late(found.moment, dt), found.torque)

    def prompt(
        self, q: FloatArray, dt: FloatArray, measured: FloatArray, gains: FloatArray,
    ) -> Response:
        """Follow motion with readings that do not lag, drawn towards measured moments."""
        n = len(q)
        moment = np.zeros((n, len(self.gauges.body)))
        torque = np.zeros((n, len(self.arm.active_joints)))
        done = kernel.follow(
            np.ascontiguousarray(q), np.ascontiguousarray(dt), self.inner, self.loaded,
            np.ascontiguousarray(measured), gains, moment, torque, *self.arrays)
        if done < n:
            msg = (f'{self.arm.name}: the elastic model '
                   + (f'finds no equilibrium at q = {np.round(q[done], 3).tolist()}'
                      if dt[done] <= 0.0 else f'diverges after {done} of {n} samples')
                   + '; its parameters are impossible for this motion')
            raise SimulationError(msg)
        return Response(moment, torque)

    def late(self, moment: FloatArray, dt: FloatArray) -> FloatArray:
        """
        Let readings lag, as behind the low-pass of an amplifier; goes on from call to call.

        moment (samples, gauges) [N m], dt (samples,) [s].
        """
        lag = self._physics.lag
        if lag <= 0.0 or not len(moment):
            return moment
        if len(moment) == 1 and dt[0] > 0.0:  # live
            self._reading += -math.expm1(-float(dt[0]) / lag) * (moment[0] - self._reading)
            return self._reading[None].copy()
        late = moment.copy()
        ends = [*np.flatnonzero(dt <= 0.0).tolist(), len(dt)]
        for first, end in zip([0, *ends[:-1]], ends, strict=True):
            if end > first:
                start = moment[first] if dt[first] <= 0.0 else self._reading
                late[first:end] = low_pass(
                    moment[first:end], dt[first:end], 1.0 / (2.0 * math.pi * lag), start)
                self._reading = late[end - 1].copy()
        return late

    def linearised(self, q: FloatArray) -> Linearised:
        """
        Rest with the drives held at a pose, and linearise there; ``follow`` goes on from it.

        q (joints,) [rad or m].
        """
        self.follow(np.asarray(q, dtype=float)[None], np.zeros(1))
        result = np.zeros((3, self.size, self.size))
        tables = self.tables
        tangents(tables.equations, tables.gears, tables.chain, self.loaded, result)
        return Linearised(*result[::-1])

    def start_observer(self, deviation: FloatArray, bandwidth: float) -> None:
        """
        Let measured moments correct the state from now on, see ``correct``.

        deviation (gauges,) [N m], bandwidth [1/s].
        """
        m, lag = self.size, self._physics.lag
        self._deviation = np.maximum(np.asarray(deviation, dtype=float), 1e-12)
        self._small, self._pushed = np.zeros((3, m, m)), np.zeros((m, observer.FORCES))
        self._shown = moment_rows(self.mechanism, self.gauges, self.tables.equations.free)
        self._seen = seen_rows(self._shown, lags=lag > 0.0)
        self._covariance = np.zeros((self._seen.shape[1],) * 2)
        self.follow(np.tile(self._vectors[Z, self.tables.gears.place], (2, 1)),
                    np.array([0.0, 1e-3]))
        self._linearise()
        self._noise = SAMPLE * white_force(
            Linearised(*self._small), self._pushed, self._shown / self._deviation[:, None],
            bandwidth, lag)

    def forget(self) -> None:
        """Forget all uncertainty: the arm begins anew, at rest."""
        self._covariance[:] = 0.0

    def correct(self, innovation: FloatArray, dt: float) -> bool:
        """
        Correct the state behind the newest sample.

        dt [s]; innovation (gauges,) [N m]: NaN for one that does not count; returns False where
        the arm as it stands cannot be linearised.
        """
        self._linearise()
        mass, damping, stiffness = self._small
        good = observer.propagate(
            self._covariance, mass, damping, stiffness, self._pushed, self._shown, dt,
            self._noise, self._physics.lag)
        good = good and observer.correct(
            self._covariance, self._seen, self._deviation**2 * (SAMPLE / dt), innovation, mass,
            damping, stiffness, self._vectors, self.tables.equations.free, self._reading)
        return bool(good)

    def _linearise(self) -> None:
        observer.linearise(self.loaded, self.mechanism.tip, *self._small, self._pushed,
                           *self.arrays)
