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
Friction before a joint breaks away: a bristle that bends with the drive, and slides at its limit.

Prandtl's element, the stop operator of hysteresis (Visintin, Differential Models of Hysteresis,
1994, Section III.1): ``z_k = min(1, max(-1, z_(k-1) + (q_k - q_(k-1)) / distance))``. It does not
depend on the rate, and a sum of such elements, each with a coefficient of its own, is linear in
these (Prandtl-Ishlinskii). Since ``z`` needs the motion before a sample, it follows the motion as
a further input of the rows.
"""

from __future__ import annotations

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.compiled import compiled
from tudor_dynamics.models.coupling import Coupling
from tudor_dynamics.signals import Stretch
from tudor_dynamics.typing import FloatArray


@compiled
def _bend(
    places: FloatArray, distance: FloatArray, last: FloatArray, bent: FloatArray, out: FloatArray,
) -> None:
    for k in range(len(places)):
        for i in range(len(distance)):
            bent[i] = min(1.0, max(-1.0, bent[i] + (places[k, i] - last[i]) / distance[i]))
            last[i] = places[k, i]
            out[k, i] = bent[i]


def bent_along(stretch: Stretch, coupling: Coupling, distance: FloatArray) -> FloatArray:
    """
    Follow bristles along a stretch, from what is known of the motion before it on.

    distance (bristles, joints) [rad or m]: infinite for one that is not there; returns
    (samples, bristles, joints), 0 where the motion begins.
    """
    q, earlier = stretch.states.q, 0
    if stretch.before is not None:
        earlier = len(stretch.before)
        q = np.vstack([stretch.before[:, 1:], q])
    places = np.tile(coupling.drive_places(q), len(distance))
    out = np.empty_like(places)
    _bend(places, distance.ravel(), places[0].copy(), np.zeros(distance.size), out)
    return out[earlier:].reshape(len(q) - earlier, *distance.shape)


class Bristles:
    """The bristles of an arm's drives."""

    def __init__(self, arm: Arm) -> None:
        self.coupling = Coupling(arm)
        most = max(len(joint.bristles) for joint in arm.joints)
        self.distance = np.full((most, len(arm.joints)), np.inf)
        for i, joint in enumerate(arm.joints):
            self.distance[:len(joint.bristles), i] = joint.bristles
        self.count = self.distance.size

    def follow(self, stretch: Stretch) -> FloatArray:
        """
        Give the motion of a stretch, and how far the bristles are bent.

        Returns (samples, 3 joints + count): ``[q, dq, ddq, z]``, the first bristle of each drive
        before the second ones.
        """
        bent = bent_along(stretch, self.coupling, self.distance)
        return np.hstack([stretch.motion, bent.reshape(len(bent), -1)])


class Trail:
    """Bristles beside a running robot."""

    def __init__(self, bristles: Bristles) -> None:
        self._bristles = bristles
        self._distance = bristles.distance.ravel()
        self._last = np.zeros(bristles.count)
        self._bent = np.zeros((1, bristles.count))

    def step(self, dt: float, row: FloatArray) -> FloatArray:
        """
        Go to the next sample.

        dt [s]; row (3 joints,): ``[q, dq, ddq]`` of one sample
        [rad, rad/s, rad/s^2 or m, m/s, m/s^2]; returns (3 joints + count,): ``[q, dq, ddq, z]``,
        as `Bristles.follow` gives it.
        """
        most, n = self._bristles.distance.shape
        places = np.tile(self._bristles.coupling.drive_places(row[None, :n]), most)
        if dt == 0.0:
            self._last, self._bent = places[0].copy(), np.zeros_like(self._bent)
        _bend(places, self._distance, self._last, self._bent[0], self._bent)
        return np.concatenate([row, self._bent[0]])
