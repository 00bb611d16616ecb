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
Which link is touched, and with what torque about its joint, from efforts alone.

The momentum observer gives the external effort of each joint. A contact loads the joints inboard
of it: the outermost joint that feels one moves the link that is touched. Where on it, and with
what force, efforts do not tell.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tudor_dynamics.arm.kinematics import joint_axis, link_frame
from tudor_dynamics.contact.estimate import ContactEstimate, ContactRecord
from tudor_dynamics.contact.scale import torque_scale
from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.typing import FloatArray

FELT, LEFT = 5.0, 3.0
"""Standard deviations of free motion from which, and until which, a joint feels a contact."""


class TorqueEstimator:
    """Estimates link and external torque of a contact."""

    source = 'momentum'  # whose residuals it takes

    def __init__(self, bundle: ModelBundle) -> None:
        arm = bundle.arm
        self._joints = arm.active_joints
        self._gain = torque_scale(arm)
        facts: Any = bundle.facts.get('validation')
        try:
            channels = facts['effort']['analytical']['validation']['channels']
            usual = [float(channels[name]['rmse']) for name in self._joints]
        except (KeyError, TypeError, ValueError):
            msg = ('the model does not say what efforts are left over in free motion: fit it with '
                   'bags to be judged by')
            raise ModelError(msg) from None
        if not np.isfinite(self._gain).any():
            msg = (f'{arm.name}: no torque constant is known; give motors: with torque_constant '
                   'and gear_ratio to have contacts in N m')
            raise ModelError(msg)
        self._deviation = np.array(usual) * self._gain
        self._links = tuple(link_frame(arm.full_model, name) for name in self._joints)
        self._axes = [joint_axis(arm.full_model, name) for name in self._joints]
        self.felt = False

    def record(self) -> ContactRecord:
        """Give a record for a contact that begins; efforts tell no force."""
        return ContactRecord((), ())

    def step(
        self, stamp: int, begins: bool, row: FloatArray, measured: FloatArray,
        residual: FloatArray | None,
    ) -> ContactEstimate | None:
        """
        Take a sample into account; arguments as in ``ContactEstimator.step``.

        stamp [ns], row (3 joints,), measured, residual (joints,).
        """
        if residual is None:
            self.felt = False
            return None
        torque = -residual * self._gain
        size = np.nan_to_num(np.abs(torque) / self._deviation)
        bound = LEFT if self.felt else FELT
        feeling = np.flatnonzero(size > bound)
        self.felt = bool(len(feeling))
        place = int(feeling[-1]) if self.felt else int(np.argmax(size))
        nowhere = np.full(3, np.nan)
        return ContactEstimate(
            stamp, self._links[place], self._joints[place], self.felt, np.zeros(3),
            float(np.nan_to_num(torque[place])) * self._axes[place], float('nan'),
            float(self._deviation[place]), float('nan'), float('nan'), nowhere,
            np.zeros((0, 3)), np.zeros(0))
