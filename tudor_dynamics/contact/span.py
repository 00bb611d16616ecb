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
Where on the links a contact is looked for.

What is estimated on a span is (F, F a, A): the force across the link, its moment about the joint,
and the force along the link. Forces at the two ends of the span stand for a push between them, so
all that lies inboard or outboard of the span feels the push itself: spans end at gauges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.kinematics import joint_axis, unit_vector
from tudor_dynamics.arm.schema import GaugeSpec
from tudor_dynamics.typing import FloatArray

SHORTEST = 1e-3
"""Ends of a span are at least so far apart, also where the place is known [m]."""
PUSH = 10.0
"""Standard deviation of a force of which nothing is known [N]."""


@dataclass(frozen=True)
class Span:
    """A part of a link, and what is known of a contact there before anything was measured."""

    joint: str  # joint that moves the link
    # Ends, from the joint along the link; equal where the place is known [m].
    inner: float
    outer: float
    # Standard deviation of the force across and along the link [N].
    across: float = PUSH
    along: float = 0.0

    @property
    def middle(self) -> float:
        """Mean of the place before anything is known [m]."""
        return 0.5 * (self.inner + self.outer)

    @property
    def ends(self) -> tuple[float, float]:
        """Two different places that stand for all between them [m]."""
        return min(self.inner, self.outer - SHORTEST), self.outer

    @property
    def covariance(self) -> FloatArray:
        """Covariance of what presses, any place as likely as another [N, N m, N]."""
        spread = (self.outer - self.inner) / math.sqrt(12.0)
        return np.array([
            [self.across**2, self.across**2 * self.middle, 0.0],
            [self.across**2 * self.middle, self.across**2 * (self.middle**2 + spread**2), 0.0],
            [0.0, 0.0, self.along**2]])


@dataclass(frozen=True, eq=False)
class LinkAxes:
    """Directions of a link in the frame of its joint."""

    # (3,): along the link, across it in the plane that its gauges see, and the axis they bend
    # about.
    along: FloatArray
    across: FloatArray
    bending: FloatArray


def gauge_axis(arm: Arm, gauge: GaugeSpec) -> FloatArray:
    """Give the axis that a gauge's link bends about, in the frame of its joint."""
    return (joint_axis(arm.full_model, gauge.joint) if gauge.axis is None
            else unit_vector(gauge.axis))


def link_axes(arm: Arm, joint: str) -> LinkAxes:
    """Give the directions of a link that has gauges."""
    gauge = next(gauge for gauge in arm.gauges if gauge.joint == joint)
    along, bending = unit_vector(gauge.direction), gauge_axis(arm, gauge)
    return LinkAxes(along, np.cross(bending, along), bending)


def link_end(arm: Arm, joint: str) -> float | None:
    """Give how far a link with gauges reaches from its joint [m]; None where nothing tells."""
    model, axes = arm.full_model, link_axes(arm, joint)
    index = model.getJointId(joint)
    ends = [model.jointPlacements[child].translation @ axes.along
            for child in range(index + 1, model.njoints) if model.parents[child] == index]
    ends += [frame.placement.translation @ axes.along for frame in model.frames
             if frame.parentJoint == index and frame.type.name != 'JOINT']
    farthest = max((gauge.distance for gauge in arm.gauges if gauge.joint == joint))
    end = max(ends, default=0.0)
    return float(end) if end > farthest + SHORTEST else None


def spans_of(arm: Arm, known: Sequence[bool]) -> tuple[Span, ...]:
    """
    Divide the links at their gauges.

    A contact inboard of a link's first gauge is felt by the gauges of links before it alone, as a
    contact of those. With one gauge a link, two of them in one plane tell a force at the tip.

    Returns an empty tuple where no gauge has a scale, or no link a length.
    """
    places: dict[str, list[float]] = {}
    for gauge, counts in zip(arm.gauges, known, strict=True):
        if counts:
            places.setdefault(gauge.joint, []).append(gauge.distance)
    order = sorted(places, key=arm.full_model.getJointId)
    spans = []
    for number, joint in enumerate(order):
        end = link_end(arm, joint)
        if end is None:
            continue
        own = sorted(set(places[joint]))
        along = PUSH if number else 0.0
        if len(own) == 1 and joint == order[-1]:
            spans.append(Span(joint, end, end, along=along))
            continue
        spans += [Span(joint, near, far, along=along)
                  for near, far in zip(own, [*own[1:], end], strict=True)]
    return tuple(spans)
