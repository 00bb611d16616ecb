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
Regressors: outputs as linear functions of constant parameters, row by row.

Effort: ``tau = Y(q, dq, ddq) chi`` with the joint torque regressor, the rotor inertia and
the friction of each joint (Malzahn et al., Eqs. (2)-(6)). Strain: one row a gauge (Eq. (15)),
either the joint's own row as the paper has it, or the exact bending moment at the gauge.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import ArmError
from tudor_dynamics.models.coupling import Coupling
from tudor_dynamics.models.friction import friction_columns, friction_names
from tudor_dynamics.models.joint_terms import JointTerms
from tudor_dynamics.models.presliding import Bristles
from tudor_dynamics.models.rigid_bodies import BODY_PARAMETERS, RigidBodies
from tudor_dynamics.typing import FloatArray

STRAIN_FORMS = ('paper', 'exact')


class Regressor(Protocol):
    """Rows that are linear in constant parameters, for a fixed set of channels."""

    channels: tuple[str, ...]
    """Names of the outputs."""
    columns: tuple[str, ...]
    """Names of all parameters, base-parameter reduction not yet done."""
    groups: tuple[tuple[int, ...], ...]
    """Channels that share their parameters; each channel stands in one group."""
    unknown: tuple[int, ...]
    """Channels that share them up to a torque constant, which is not known."""
    scaled: NDArray[np.bool_]
    """Columns whose parameters carry that constant."""
    loaded: bool
    """Whether rows depend on parameters, through friction that grows with the load."""
    bristles: Bristles | None
    """What follows friction that gives way, for inputs behind the motion; None without any."""

    def assume(self, parameters: FloatArray | None) -> None:
        """
        Take parameters for the loads of the rows; see `EffortRegressor.assume`.

        Parameters
        ----------
        parameters : ndarray of shape (n_channels, n_columns) or None
            Parameters of each channel.

        """

    def rows(self, motion: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """
        Evaluate rows, shape (n_samples, n_channels, n_columns).

        Parameters
        ----------
        motion : ndarray of shape (n_samples, 3 n_joints)
            ``[q, dq, ddq]`` of the active joints, in columns [rad, rad/s, rad/s^2 or m, m/s,
            m/s^2]; behind it what friction that gives way has done, as of joints that slide where
            that is left out (`Bristles`).
        out : ndarray of shape (n_samples, n_channels, n_columns), optional
            Array to be filled, in place of a new one.

        """

    def outputs(self, motion: FloatArray, parameters: FloatArray) -> FloatArray:
        """
        Evaluate rows times the parameters of each channel, shape (n_samples, n_channels).

        Parameters
        ----------
        motion : ndarray of shape (n_samples, 3 n_joints)
            ``[q, dq, ddq]`` of the active joints, in columns [rad, rad/s, rad/s^2 or m, m/s,
            m/s^2].
        parameters : ndarray of shape (n_channels, n_columns)
            Parameters of each channel.

        """


class EffortRegressor:
    """
    Joint effort rows: link inertias, rotor inertias, friction.

    Joints whose effort is a torque or force, or a current with a known constant, share the
    inertial parameters and are stacked. A joint with a current of unknown torque constant has
    parameters of its own, scaled by that constant, or shares those of the others as well: then
    the constants are to be found with them (`torque_constants.find_constants`).

    scaled (columns,).
    """

    def __init__(self, arm: Arm, *, shared: bool = False) -> None:
        self.channels = arm.active_joints
        self._joints = arm.joints
        self._scale = np.array([joint.effort.torque_constant or 1.0 for joint in arm.joints])
        known = [i for i, joint in enumerate(arm.joints)
                 if joint.effort.unit != 'A' or joint.effort.torque_constant is not None]
        alone: list[tuple[int, ...]] = [(i,) for i in range(len(arm.joints)) if i not in known]
        self.groups: tuple[tuple[int, ...], ...] = tuple(([tuple(known)] if known else []) + alone)
        self.unknown: tuple[int, ...] = ()
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
        self.columns: tuple[str, ...] = tuple(names)
        self._coupling = Coupling(arm)
        self.scaled = np.array([i < self._n_bodies or name.startswith('Ia(')
                                for i, name in enumerate(names)])
        for i, part in enumerate(self._local):
            if np.count_nonzero(self._coupling.reach[:, i]) > 1:
                self.scaled[part] = True  # several efforts feel it, each in its own unit
        self.loaded = any('load' in joint.friction for joint in arm.joints)
        self.bristles: Bristles | None = (
            Bristles(arm) if any(joint.bristles for joint in arm.joints) else None)
        self._assumed: FloatArray | None = None
        self._bodies = RigidBodies(arm.model, arm.velocity_index, arm.velocity_index)
        self._terms = JointTerms(arm.joints, [part.start for part in self._local], self._scale,
                                 self._coupling.speeds, self._coupling.reach)

    def assume(self, parameters: FloatArray | None) -> None:
        """
        Take parameters by which rows know the loads that friction grows with.

        With friction in proportion to what the bodies ask of a joint, the effort is no linear
        function of all parameters. For given loads it is: rows by the parameters of the last
        estimate, and an estimate by these rows, settle within a few turns.

        parameters (joints, columns): None for bodies whose parameters all are 1.
        """
        self._assumed = parameters

    def rows(self, motion: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Evaluate rows, in effort units per parameter; see ``Regressor``."""
        n = len(self.channels)
        motion, bent = self._parted(motion)
        dq = motion[:, n:2 * n] @ self._coupling.speeds.T
        ddq = motion[:, 2 * n:] @ self._coupling.speeds.T
        rows = np.zeros((len(motion), n, len(self.columns))) if out is None else out
        self._bodies.rows(motion, rows[:, :, :self._n_bodies])
        self._coupling.mix(rows[:, :, :self._n_bodies])
        bodies = rows[:, :, :self._n_bodies]
        for i, joint in enumerate(self._joints):
            load = None
            if 'load' in joint.friction:
                load = (bodies[:, i].sum(axis=1) if self._assumed is None else
                        bodies[:, i] @ self._assumed[i, :self._n_bodies])
            columns = friction_columns(joint, dq[:, i], load,
                                       None if bent is None else bent[:, i::n])
            if joint.rotor_inertia:
                columns = np.column_stack([ddq[:, i], columns])
            for channel in np.flatnonzero(self._coupling.reach[:, i]):
                rows[:, channel, self._local[i]] = self._coupling.reach[channel, i] * columns
        if np.any(self._scale != 1.0):
            rows /= self._scale[None, :, None]  # what is zero in `out` stays zero
        return rows

    def outputs(self, motion: FloatArray, parameters: FloatArray) -> FloatArray:
        """Evaluate rows times parameters, without making the rows; see ``Regressor``."""
        motion, bent = self._parted(motion)
        out = self._coupling.body_efforts(self._bodies, motion, parameters)
        self._terms.add(motion, parameters, out, bent)
        return out

    def _parted(self, motion: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """Give the motion of the joints, and how far bristles are bent where that is known."""
        wide = 3 * len(self.channels)
        if motion.shape[1] == wide:
            return self._coupling.of_joints(motion), None
        # contiguous, as the compiled functions know it
        parts = (np.ascontiguousarray(part) for part in np.split(motion, [wide], axis=1))
        states, bent = parts
        return self._coupling.of_joints(states), bent


class StrainRegressor:
    """
    Gauge rows: the bending moment behind a joint, and an offset; own parameters for each gauge.

    Parameters
    ----------
    arm : Arm
        Arm with gauges.
    form : {'paper', 'exact'}
        ``paper``: the regressor of the joint before the gauge (Malzahn et al., Eq. (15), in which
        the difference between gauge and joint is taken for constant). ``exact``: the bending
        moment about the gauge's place x_s, for which the reaction force of the following link has
        the lever L - x_s and its moment the lever L.

    """

    def __init__(self, arm: Arm, form: str = 'exact') -> None:
        if form not in STRAIN_FORMS:
            msg = f'strain form {form!r}; expected one of {STRAIN_FORMS}'
            raise ArmError(msg)
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
            msg = ("the paper's strain form needs the joint before each gauge to be active; "
                   f'{missing} are not')
            raise ArmError(msg, place=arm.source, remedy='use --strain-form exact')
        names = [f'{parameter}({name})' for name in list(model.names)[1:]
                 for parameter in BODY_PARAMETERS]
        self.columns: tuple[str, ...] = (*names, 'offset')
        self.groups: tuple[tuple[int, ...], ...] = tuple((i,) for i in range(len(self.channels)))
        self.unknown: tuple[int, ...] = ()
        self.scaled = np.zeros(len(self.columns), dtype=np.bool_)
        self.loaded = False
        self.bristles: Bristles | None = None
        self._bodies = RigidBodies(model, *(np.array([
            model.joints[model.getJointId(name)].idx_v for name in group])
            for group in (arm.active_joints, outputs)))
        self._coupling = Coupling(arm)

    def rows(self, motion: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Evaluate rows, in N m per parameter (with the scale of the gauge); see ``Regressor``."""
        shape = (len(motion), len(self.channels), len(self.columns))
        rows = np.zeros(shape) if out is None else out
        # virtual joints at the gauges stay at zero
        self._bodies.rows(self._coupling.of_joints(motion), rows[:, :, :-1])
        rows[:, :, -1] = 1.0
        return rows

    def assume(self, parameters: FloatArray | None) -> None:
        """Take parameters that no row of a strain depends on; see ``Regressor``."""

    def outputs(self, motion: FloatArray, parameters: FloatArray) -> FloatArray:
        """Evaluate rows times parameters, without making the rows; see ``Regressor``."""
        out = np.empty((len(motion), len(self.channels)))
        self._bodies.outputs(self._coupling.of_joints(motion), parameters, out)
        out += parameters[:, -1]
        return out


def plain_regressor(
    arm: Arm, output: str, strain_form: str, *, shared: bool = False,
) -> EffortRegressor | StrainRegressor:
    """Give the rows of an output."""
    return (EffortRegressor(arm, shared=shared) if output == 'effort' else
            StrainRegressor(arm, strain_form))
