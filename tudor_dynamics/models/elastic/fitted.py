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
What an elastic model has learned, and what it makes of motion.

What a gauge reads is a gain times the moment that bends it, and an offset. What a motor needs is
the torque of its gear, the inertia of its rotor and friction, each times a coefficient that
carries the unit of the effort.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import ModelError, NotFittedError, SimulationError
from tudor_dynamics.models.base import Range
from tudor_dynamics.models.elastic.arm import DrivenArm, Response
from tudor_dynamics.models.elastic.effort import effort_columns, effort_rows
from tudor_dynamics.models.training import check_motion
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True)
class PhysicalParameter:
    """One physical parameter of an elastic arm."""

    name: str  # name, see `DrivenArm.parameters`
    value: float  # value in the unit below
    unit: str  # unit of the value
    # Standard deviation of the value; NaN where it was not identified [unit].
    standard_error: float = float('nan')
    shown: bool = False  # whether the recordings say more about it than the description did


class FittedElastic:
    """
    Parameters of an elastic arm, and coefficients of its strain or effort.

    Parameters
    ----------
    arm : Arm
        Arm with ``links``.
    output : {'effort', 'strain'}
        What it predicts.
    physical : tuple of PhysicalParameter
        Physical parameters that differ from the description.
    payload_range : (float, float), optional
        Least and largest payload of the training bags [kg]; None where it was one payload, which
        is then part of ``physical``.

    Attributes
    ----------
    columns : tuple of tuple of str
        Columns of each channel.
    coefficients_ : tuple of ndarray, or None
        Coefficients of each channel on its columns.
    standard_errors_ : tuple of ndarray, or None
        Their standard deviations.
    noise_ : ndarray of shape (n_channels,), or None
        Standard deviation of what it leaves over of the training data, in their units.

    """

    def __init__(
        self, arm: Arm, output: str, physical: tuple[PhysicalParameter, ...] = (), *,
        payload_range: Range | None = None,
    ) -> None:
        self.arm = arm
        self.output = output
        self.physical = physical
        self.payload_range = payload_range
        self.n_joints = len(arm.active_joints)
        self.coefficients_: tuple[FloatArray, ...] | None = None
        self.standard_errors_: tuple[FloatArray, ...] | None = None
        self.noise_: FloatArray | None = None
        if output == 'strain':
            self.channels = arm.gauge_names
            self.columns: tuple[tuple[str, ...], ...] = (
                ('moment', 'offset'),) * len(self.channels)
        else:
            self.channels = arm.active_joints
            self.columns = effort_columns(arm)
        self._driven: DrivenArm | None = None

    def __repr__(self) -> str:
        """Write outputs and the physical parameters that were identified."""
        state = '' if self.coefficients_ is not None else ', not fitted'
        found = [f'  {parameter.name} = {parameter.value:.4g} {parameter.unit}'
                 for parameter in self.physical]
        return '\n'.join([f'{type(self).__name__}({", ".join(self.channels)}{state})', *found])

    @property
    def values(self) -> dict[str, float]:
        """Physical parameters by name, SI units."""
        return {parameter.name: parameter.value for parameter in self.physical}

    def along(
        self, motion: FloatArray, dt: FloatArray, before: FloatArray | None = None,
    ) -> FloatArray:
        """
        Predict the outputs along a gapless motion that begins at rest.

        Parameters
        ----------
        motion : ndarray of shape (n_samples, 3 n_joints)
            ``[q, dq, ddq]`` of the active joints, in columns [rad, rad/s, rad/s^2 or m, m/s,
            m/s^2].
        dt : ndarray of shape (n_samples,)
            Time since the sample before [s]; the first counts only with ``before``.
        before : ndarray of shape (n_earlier, 1 + n_joints), optional
            ``[dt, q]`` of the motion just before, without which oscillations that began there
            are unknown.

        Returns
        -------
        ndarray of shape (n_samples, n_channels)
            Outputs in their units.

        Raises
        ------
        NotFittedError
            If the model has no coefficients yet.
        FitError
            If the motion is that of another number of joints.
        SimulationError
            If the parameters are impossible for this motion.

        """
        motion = np.asarray(motion, dtype=float)
        check_motion(motion, 3 * self.n_joints)
        if self._driven is None:
            self._driven = driven_arm(self.arm, self.values)
        response = follow_motion(self._driven, motion[:, :self.n_joints], dt, before)
        return self.outputs(response, motion)

    def outputs(self, response: Response, motion: FloatArray) -> FloatArray:
        """
        Turn moments and torques into outputs.

        Parameters
        ----------
        response : Response
            What gauges and gears feel.
        motion : ndarray of shape (n_samples, 3 n_joints)
            ``[q, dq, ddq]`` of the same samples [rad, rad/s, rad/s^2 or m, m/s, m/s^2].

        Returns
        -------
        ndarray of shape (n_samples, n_channels)
            Outputs in their units.

        """
        if self.coefficients_ is None:
            msg = 'the elastic model has no coefficients yet: fit it, or load a bundle'
            raise NotFittedError(msg)
        if self.output == 'strain':
            gains = np.array(self.coefficients_)
            return np.asarray(response.moment * gains[:, 0] + gains[:, 1])
        return np.column_stack([
            rows @ values for rows, values in
            zip(effort_rows(self.arm, response, motion), self.coefficients_, strict=True)])


def follow_motion(
    driven: DrivenArm, q: FloatArray, dt: FloatArray, before: FloatArray | None = None,
) -> Response:
    """
    Follow a gapless motion from rest.

    q (samples, joints) [rad or m], dt (samples,) [s]; before (earlier, 1 + joints): ``[dt, q]`` of
    the motion just before.
    """
    q, dt = np.asarray(q, dtype=float), np.array(dt, dtype=float)
    if before is not None and len(before):
        earlier = before[:, 0].copy()
        earlier[0] = 0.0
        driven.follow(before[:, 1:], earlier)
    else:
        dt[0] = 0.0
    return driven.follow(q, dt)


def driven_arm(arm: Arm, values: Mapping[str, float]) -> DrivenArm:
    """Build the driven arm of a model."""
    try:
        driven = DrivenArm(arm)
        driven.set_parameters(values)
    except SimulationError as err:
        msg = f'the elastic model cannot be used: {err}'
        raise ModelError(msg) from None
    return driven
