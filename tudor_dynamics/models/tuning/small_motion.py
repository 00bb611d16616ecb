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
Small motion of an elastic arm about rest, its drives moving it: what a controller has before it.

With z the coordinates of gears and links, theta the drives and z0(theta) where the arm rests,
``M z'' + D (z' - J theta') + K (z - J theta) = 0``, J = dz0/dtheta: weight is in K and J. About
the rest that goes along with the drives the links are driven by ``-M J theta''`` alone.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from scipy.linalg import eigh

from tudor_dynamics.arm import Arm
from tudor_dynamics.control.damper import STRAIN_SCALE
from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.models.elastic.fitted import driven_arm
from tudor_dynamics.models.elastic.fitted import FittedElastic
from tudor_dynamics.models.elastic.setup import moment_rows, place_gauges
from tudor_dynamics.models.elastic.several import follow_motions
from tudor_dynamics.models.elastic.statics import Z
from tudor_dynamics.typing import FloatArray

NUDGE = 1e-4
"""Of a drive, for differences [rad]."""


@dataclass(frozen=True, eq=False)
class SmallMotion:
    """An arm about rest at one pose; strains are those of the damped joints' gauges, in m/m."""

    # Of gears and links, with weight, (m, m).
    mass: FloatArray
    damping: FloatArray
    stiffness: FloatArray
    rest: FloatArray  # where they rest by the positions of the drives, (m, joints)
    strain: FloatArray  # strain by coordinate, (damped, m) [1/coordinate]
    load: FloatArray  # strain at rest, (damped,)
    slope: FloatArray  # the same by the positions of the drives, (damped, joints) [1/rad]
    # Torque of the links on each drive by coordinates and positions of the drives,
    # (joints, m + joints) [N m/rad].
    reaction: FloatArray

    @property
    def inertia(self) -> FloatArray:
        """Strain by slow accelerations of the drives, shape (n_damped, n_joints) [s^2/rad]."""
        return np.asarray(-self.strain @ np.linalg.solve(self.stiffness, self.mass @ self.rest))

    def modes(self, count: int, signs: FloatArray | None = None) -> Vibrations:
        """Solve for the slowest modes, drives held: signs (modes, m)."""
        symmetric = 0.5 * (self.stiffness + self.stiffness.T)
        values, vectors = eigh(symmetric, 0.5 * (self.mass + self.mass.T))
        shape = vectors[:, :count].T
        if signs is None:
            signs = shape * np.sign((shape @ self.strain.T).sum(axis=1))[:, None]
        turn = np.where(np.einsum('im,mk,ik->i', shape, self.mass, signs) < 0.0, -1.0, 1.0)
        shape = shape * turn[:, None]
        omega = np.sqrt(np.maximum(values[:count], 1e-6))
        modal = np.einsum('im,mk,ik->i', shape, self.damping, shape)
        return Vibrations(
            omega / (2.0 * math.pi), modal / (2.0 * omega), shape,
            -shape @ self.mass @ self.rest, shape @ self.strain.T)


@dataclass(frozen=True, eq=False)
class Vibrations:
    """Modes of small motion, drives held."""

    # (modes,): undamped frequencies [Hz] and damping ratios.
    frequency: FloatArray
    damping: FloatArray
    shape: FloatArray  # coordinates of each mode, mass-normalised, (modes, m)
    # (modes, joints): right side of each mode's equation by accelerations of the drives.
    drive: FloatArray
    strain: FloatArray  # strain of each, (modes, damped) [m/m]


class TunedArm:
    """
    An elastic arm whose small motion is asked for by payload and pose.

    Small motion is that without the play of gears: in it an arm has no frequency of its own, and
    where gears bear, none is felt. The load at rest has it, which turns the links.

    Parameters
    ----------
    arm : Arm
        Description with a damper.
    model : FittedElastic, optional
        Elastic model of the strain; without one, links, gears and gauges are those described.

    Raises
    ------
    ModelError
        If the arm has no damper, no flexible links, or gauges of unknown gain.

    """

    def __init__(self, arm: Arm, model: FittedElastic | None = None) -> None:
        if arm.spec.damper is None:
            raise ModelError('there is no damper', place=arm.source,
                             remedy='add damper: with gauges and gains of the joints')
        self.arm = arm
        self.dampers = [item for item in arm.spec.damper.joints
                        if item.joint in arm.active_joints]
        units = {gauge.name: gauge.unit for gauge in arm.gauges}
        self._scale = np.array([STRAIN_SCALE.get(units[item.gauge], 0.0)
                                for item in self.dampers])
        if not self._scale.all():
            raise ModelError('a gauge of the damper measures no strain', place=arm.source,
                             remedy=f'give it one of the units {list(STRAIN_SCALE)}')
        values = model.values if model is not None else {}
        self._driven, self._loose = driven_arm(arm, values), driven_arm(arm, values)
        plays = {name: 0.0 for name in self._driven.parameters if name.startswith('play(')}
        self._driven.set_parameters(plays)
        index = [arm.gauge_names.index(item.gauge) for item in self.dampers]
        gains, offsets = self._gauges(model)
        self._index, self._gain = index, gains[index] / self._scale
        self._offset = offsets[index] / self._scale
        motors = {motor.joint: motor.reflected_inertia for motor in arm.spec.motors}
        self.rotor = np.array([motors.get(name, 0.0) for name in arm.active_joints])
        """Inertia of each drive, 0 where it is not known [kg m^2]."""

    def _gauges(self, model: FittedElastic | None) -> tuple[FloatArray, FloatArray]:
        if model is not None and model.coefficients_ is not None:
            gain, offset = np.array(model.coefficients_).T
            return gain, offset
        sensors = {sensor.gauge: sensor for sensor in self.arm.spec.sensors}
        missing = [name for name in self.arm.gauge_names if name not in sensors]
        if missing:
            raise ModelError(f'the gains of the gauges {missing} are not known',
                             place=self.arm.source,
                             remedy='give --model, or the gains under sensors:')
        return (np.array([sensors[name].gain for name in self.arm.gauge_names]),
                np.array([sensors[name].offset for name in self.arm.gauge_names]))

    @property
    def scale(self) -> FloatArray:
        """Units of the gauges per m/m, shape (n_damped,)."""
        return self._scale

    def at(self, payload: float, q: FloatArray) -> SmallMotion:
        """
        Linearise at rest.

        Parameters
        ----------
        payload : float
            Mass at the tip [kg].
        q : ndarray of shape (n_joints,)
            Positions of the drives [rad].

        Returns
        -------
        SmallMotion
            About rest there.

        Raises
        ------
        SimulationError
            If there is no equilibrium.

        """
        driven = self._driven
        self._carry(payload)
        rests = [[self._rest(driven, q + side * NUDGE * unit) for side in (1.0, -1.0)]
                 for unit in np.eye(len(q))]
        rest = np.array([(up[0] - down[0]) / (2.0 * NUDGE) for up, down in rests]).T
        slope = np.array([(up[1] - down[1]) / (2.0 * NUDGE) for up, down in rests]).T
        small = driven.linearised(q)
        _, load = self._rest(self._loose, q)
        free = driven.tables.equations.free
        rows = moment_rows(driven.mechanism, place_gauges(driven.mechanism, self.arm), free)
        own = np.array([int(np.flatnonzero(free == place)[0])
                        for place in driven.tables.gears.place])
        push = small.stiffness @ rest  # of the gears, by the positions of the drives
        reaction = np.hstack([push.T, -np.diag(push[own, np.arange(len(q))])])
        return SmallMotion(small.mass, small.damping, small.stiffness, rest,
                           rows[self._index] * self._gain[:, None],
                           load * self._gain + self._offset, slope * self._gain[:, None], reaction)

    def strains(self, payload: float, motions: FloatArray, dt: float) -> FloatArray:
        """
        Simulate large motions, with the play of the gears.

        Parameters
        ----------
        payload : float
            Mass at the tip [kg].
        motions : ndarray of shape (n_motions, n_samples, n_joints)
            Positions of the drives, from rest at one pose [rad].
        dt : float
            Time between samples [s].

        Returns
        -------
        ndarray of shape (n_motions, n_samples, n_damped)
            Strain [m/m].

        Raises
        ------
        SimulationError
            If there is no equilibrium where they begin, or one of them diverges.

        """
        self._carry(payload)
        moments = follow_motions(self._loose, motions, dt)
        return moments[..., self._index] * self._gain + self._offset

    def _carry(self, payload: float) -> None:
        for each in (self._driven, self._loose):
            if each.parameters['payload'] != payload:
                each.set_parameters({'payload': payload})

    def _rest(self, driven: DrivenArm, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        moment = driven.follow(q[None], np.zeros(1)).moment[0]
        z = driven.tables.equations.vectors[Z][driven.tables.equations.free].copy()
        return z, moment[self._index]
