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
Links that bend: where they really are, told by their own strain.

A model of rigid bodies takes the motors' motion for that of the links. Behind each move links ring
about it by angles that are proportional to their strains, so ``q + A e`` is nearer to where they
are, and its acceleration has the ringing in it, at whatever frequency the load lets it be. Rows of
rigid bodies, evaluated there, explain strain with and without a load several times as well.

It tells loads only. A touch makes links ring as well, so it would hide half of what a detector
looks for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.kinds import KINDS
from tudor_dynamics.models.storage.parts import BentPart, read
from tudor_dynamics.typing import FloatArray

FACT = 'bent_links'
"""Where facts of a bundle have it."""
KIND = 'analytical'
"""Kind of model that tells loads."""


@dataclass(frozen=True, eq=False)
class BentLinks:
    """How links bend, and a model of the strain that knows it."""

    cutoff: float  # of the filter that positions and strains go through [Hz]
    # Angle of a joint by which its link is ahead of it, per strain, (joints, gauges)
    # [rad or m per unit of the gauge].
    bending: FloatArray
    model: AnalyticalModel  # strain by where links are; of all payloads or of one
    # (gauges, gauges): what the model leaves over, as the mean square of its mean over a long
    # time, times that time: in the product of the gauges' units times seconds.
    density: FloatArray

    def motion(self, states: FloatArray) -> FloatArray:
        """
        Give how links move.

        states (3, samples, joints + gauges); returns (samples, 3 joints): ``[q, dq, ddq]`` of the
        links [rad, rad/s, rad/s^2 or m, m/s, m/s^2].
        """
        return links_of(states, self.bending)

    def as_dict(self, arm: Arm) -> dict[str, Any]:
        """Give it as plain values."""
        return {'cutoff': self.cutoff, 'bending': self.bending.tolist(),
                'density': self.density.tolist(), 'model': self.model.to_dict(arm, 'strain')}


def links_of(states: FloatArray, bending: FloatArray) -> FloatArray:
    """
    Give how links move that bend so; see `BentLinks.motion`.

    states (3, samples, joints + gauges), bending (joints, gauges).
    """
    joints = len(bending)
    moved = states[..., :joints] + states[..., joints:] @ bending.T
    return np.ascontiguousarray(np.moveaxis(moved, 0, 1)).reshape(moved.shape[1], 3 * joints)


def bent_links(facts: Mapping[str, Any], arm: Arm) -> BentLinks | None:
    """Read how links bend from the facts of a bundle; returns None where the facts do not say."""
    content = facts.get(FACT)
    if content is None:
        return None
    part = read(BentPart, content)
    made = KINDS[KIND].from_content(part.model).from_dict(part.model, arm, 'strain')
    assert isinstance(made, AnalyticalModel)
    bending, density = np.array(part.bending), np.array(part.density)
    joints, gauges = len(arm.active_joints), len(arm.gauge_names)
    if bending.shape != (joints, gauges) or density.shape != (gauges, gauges):
        msg = (f'{FACT}: bending of shape {bending.shape} and density of shape {density.shape}; '
               f'expected {(joints, gauges)} and {(gauges, gauges)}: fit the model again')
        raise ModelError(msg)
    try:
        np.linalg.cholesky(density)
    except np.linalg.LinAlgError:
        msg = f'{FACT}: the density is not positive definite; fit the model again'
        raise ModelError(msg) from None
    return BentLinks(part.cutoff, bending, made, density)
