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

"""What no arm can be: negative inertias, and weights far from those of its own description."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm import Arm
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.models.base import Model
from tudor_dynamics.typing import FloatArray

POSES = 200
FEW = 0.02
"""Share of poses at which an inertia may be negative, where parameters are uncertain."""
FAR = 1.5
"""Factor between the identified weight and the described one that is worth a mark."""
SHOWS = 0.1
"""Share of the largest weight below which the weight of a joint is not compared."""


def marks(model: Model, arm: Arm, data: Sequence[BagData]) -> tuple[str, ...]:
    """Look for what no arm can be in a model of efforts."""
    if model.has_memory or not data:
        return ()
    q = np.vstack([bag.recording.q for bag in data])
    q = q[::max(1, len(q) // POSES)]
    n = q.shape[1]
    still = np.hstack([q, np.zeros((len(q), 2 * n))])
    rest = model.predict(still)
    return (*_inertias(model, still, rest), *_weights(model, arm, q, rest))


def _inertias(model: Model, still: FloatArray, rest: FloatArray) -> list[str]:
    """Accelerate each joint by itself: a positive mass matrix answers with the same sign."""
    n = rest.shape[1]
    found = []
    for joint, name in enumerate(model.channels):
        pushed = still.copy()
        pushed[:, 2 * n + joint] = 1.0
        inertia = model.predict(pushed)[:, joint] - rest[:, joint]
        share = float(np.mean(inertia < 0.0))
        if share > FEW:
            found.append(f'the inertia about {name} comes out negative at {100.0 * share:.0f} % '
                         f'of the poses (least {inertia.min():.2g} per unit of acceleration): '
                         'no arm has one; faster motion of this joint would show it')
    return found


def _weights(model: Model, arm: Arm, q: FloatArray, rest: FloatArray) -> list[str]:
    """Compare what weight makes with the masses of the description, where it has some."""
    data = arm.model.createData()
    described = np.array([pin.computeGeneralizedGravity(arm.model, data, row).copy()
                          for row in q])
    described -= described.mean(axis=0)
    identified = rest - rest.mean(axis=0)
    sizes = np.linalg.norm(described, axis=0)
    found = []
    for joint, name in enumerate(model.channels):
        if arm.joints[joint].effort.unit == 'A' or sizes[joint] <= SHOWS * sizes.max():
            continue
        slope = float(identified[:, joint] @ described[:, joint] / sizes[joint]**2)
        if not 1.0 / FAR <= slope <= FAR:
            found.append(f'the weight that {name} feels is {slope:.2g} times that of the '
                         'description: check masses, the unit of its effort, and what the arm '
                         'carries')
    return found
