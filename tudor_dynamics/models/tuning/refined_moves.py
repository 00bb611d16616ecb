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
Planned moves refined by an elastic model with the play of its gears.

Small motion knows nothing of play: a gear that is unloaded on the way lets its link fall, and that
rings. The model in full foresees it, and what it foresees is planned against.
"""

from __future__ import annotations

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.elastic.model import elastic_of
from tudor_dynamics.models.tuning.small_motion import TunedArm
from tudor_dynamics.signals.motion_profile import MotionLimits
from tudor_dynamics.signals.refined_profile import refine
from tudor_dynamics.signals.shaped_profile import Profile
from tudor_dynamics.typing import FloatArray

SAMPLE = 2.5e-3
"""Between samples of a simulated move [s]."""
EVERY = 3
"""Of them, those behind a move that are compared."""
BEHIND = 0.02
"""Time behind the end of a move from which swings count [s]."""
NOTHING = 2e-6
"""A swing that gauges hardly show [m/m]."""


class MoveRefiner:
    """
    Refines moves by simulating them.

    Parameters
    ----------
    tuned : TunedArm
        Arm with its model; nobody else uses it meanwhile.

    """

    def __init__(self, tuned: TunedArm) -> None:
        self._tuned = tuned
        # compiled now, not when a robot waits for its first move
        tuned.strains(0.0, np.zeros((1, 2, len(tuned.arm.active_joints))), SAMPLE)

    def __call__(
        self, profile: Profile, limits: MotionLimits, payload: float, period: float,
    ) -> Profile:
        """Refine a move: payload [kg], period [s]."""
        t = np.arange(0.0, profile.duration + BEHIND + period, SAMPLE)
        behind = np.flatnonzero(t > profile.duration + BEHIND)[::EVERY]

        def swings(moves: list[Profile]) -> FloatArray:
            motions = np.array([move.at(t)[0] for move in moves])
            return self._tuned.strains(payload, motions, SAMPLE)[:, behind] / NOTHING
        return refine(profile, limits, swings)


def refiner_of(arm: Arm, bundle: ModelBundle) -> MoveRefiner:
    """Give what refines moves by the elastic model of a bundle."""
    model = elastic_of(bundle, 'strain')
    if model is None:
        raise ModelError('moves are refined by an elastic model of strain, and there is none',
                         remedy='fit one with `tudor fit --models elastic`')
    return MoveRefiner(TunedArm(arm, model))
