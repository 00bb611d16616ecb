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

"""Where on the links a contact is looked for, and what gauges of a rigid arm feel of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.kinematics import gauge_axis, gauge_point, unit_vector
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.elastic.model import ElasticModel
from tudor_dynamics.online.settings import PUSH_DEVIATION, SPAN_LENGTH
from tudor_dynamics.typing import FloatArray


ACROSS, MOMENT, ALONG = range(3)
PRESSING = 3
"""How many there are."""


def gauge_gain(arm: Arm, model: Model | None) -> FloatArray:
    """Give reading per moment [unit per N m], (gauges,); NaN where nobody knows."""
    if isinstance(model, ElasticModel) and model.coefficients_ is not None:
        return np.array([values[0] for values in model.coefficients_])
    sensors = {sensor.gauge: sensor.gain for sensor in arm.spec.sensors}
    return np.array([sensors.get(name, np.nan) for name in arm.gauge_names])


def validation_rmse(bundle: ModelBundle, output: str, kind: str) -> FloatArray | None:
    """Give the RMSE of each channel in the validation of a fit; None where there was none."""
    facts: Any = bundle.facts.get('validation')
    try:
        channels = facts[output][kind]['validation']['channels']
        return np.array([float(channels[name]['rmse']) for name in bundle.arm.channels[output]])
    except (KeyError, TypeError, ValueError):
        return None


def strain_deviation(bundle: ModelBundle, kind: str) -> FloatArray:
    """Give the standard deviation of strain residuals in free motion (gauges,), NaN if unknown."""
    noise = getattr(bundle.models['strain'][kind], 'noise_', None)
    if noise is not None:
        return np.array(noise, dtype=float)
    found = validation_rmse(bundle, 'strain', kind)
    if found is not None:
        return found
    sensors = {sensor.gauge: sensor.noise for sensor in bundle.arm.spec.sensors}
    return np.array([sensors.get(name) or np.nan for name in bundle.arm.gauge_names])


def torque_scale(arm: Arm) -> FloatArray:
    """Give the torque at active joints per unit of effort [N m or N]; NaN where unknown."""
    motors = {motor.joint: motor for motor in arm.spec.motors}
    return np.array([
        1.0 if joint.effort.unit != 'A' else
        motors[joint.name].joint_torque_constant if joint.name in motors else np.nan
        for joint in arm.joints])


# Where on the links a contact is looked for.
#
# What is estimated on a span is (F, F a, A): the force across the link, its moment about the
# joint, and the force along the link. Forces at the two ends of the span stand for a push between
# them, so all that lies inboard or outboard of the span feels the push itself: spans end at
# gauges.


@dataclass(frozen=True)
class Span:
    """A part of a link, and what is known of a contact there before anything was measured."""

    joint: str  # joint that moves the link
    # Ends, from the joint along the link; equal where the place is known [m].
    inner: float
    outer: float
    along: float = 0.0  # standard deviation of the force along the link [N]

    @property
    def middle(self) -> float:
        """Mean of the place before anything is known [m]."""
        return 0.5 * (self.inner + self.outer)

    @property
    def ends(self) -> tuple[float, float]:
        """Two different places that stand for all between them [m]."""
        return min(self.inner, self.outer - SPAN_LENGTH), self.outer

    @property
    def spread(self) -> float:
        """Give the standard deviation of the place before anything is known [m]."""
        return (self.outer - self.inner) / math.sqrt(12.0)

    @property
    def weight(self) -> float:
        """How likely a contact is here before anything is known, up to a factor [m]."""
        return max(self.outer - self.inner, SPAN_LENGTH)

    @property
    def covariance(self) -> FloatArray:
        """Covariance of what presses, any place as likely as another [N, N m, N]."""
        across, middle = PUSH_DEVIATION**2, self.middle
        return np.array([[across, across * middle, 0.0],
                         [across * middle, across * (middle**2 + self.spread**2), 0.0],
                         [0.0, 0.0, self.along**2]])


@dataclass(frozen=True, eq=False)
class LinkAxes:
    """Directions of a link in the frame of its joint."""

    # (3,): along the link, across it in the plane that its gauges see, and the axis they bend
    # about.
    along: FloatArray
    across: FloatArray
    bending: FloatArray


def link_axes(arm: Arm, joint: str) -> LinkAxes:
    """Give the directions of a link that has gauges."""
    gauge = next(gauge for gauge in arm.gauges if gauge.joint == joint)
    along, bending = unit_vector(gauge.direction), gauge_axis(arm.full_model, gauge)
    return LinkAxes(along, np.cross(bending, along), bending)


def link_end(arm: Arm, joint: str) -> float | None:
    """Give how far a link with gauges reaches from its joint [m]; None where nobody knows."""
    model, axes = arm.full_model, link_axes(arm, joint)
    index = model.getJointId(joint)
    ends = [model.jointPlacements[child].translation @ axes.along
            for child in range(index + 1, model.njoints) if model.parents[child] == index]
    ends += [frame.placement.translation @ axes.along for frame in model.frames
             if frame.parentJoint == index and frame.type.name != 'JOINT']
    farthest = max((gauge.distance for gauge in arm.gauges if gauge.joint == joint))
    end = max(ends, default=0.0)
    return float(end) if end > farthest + SPAN_LENGTH else None


def spans_of(arm: Arm, known: Sequence[bool]) -> tuple[Span, ...]:
    """
    Divide the links at their gauges; none where no gauge has a scale, or no link a length.

    A contact inboard of a link's first gauge is felt by the gauges of links before it alone, as a
    contact of those. With one gauge a link, two of them in one plane show a force at the tip.
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
        along = PUSH_DEVIATION if number else 0.0
        if len(own) == 1 and joint == order[-1]:
            spans.append(Span(joint, end, end, along=along))
            continue
        spans += [Span(joint, near, far, along=along)
                  for near, far in zip(own, [*own[1:], end], strict=True)]
    return tuple(spans)


class RigidFront:
    """A rigid arm: levers of forces on spans about the gauges, gain (gauges,) [unit per N m]."""

    modes = 0

    def __init__(self, arm: Arm, spans: Sequence[Span], gain: FloatArray) -> None:
        self._arm, self._spans, self._gain = arm, spans, gain
        self._model = arm.full_model
        self._data = self._model.createData()
        self._q, self._columns = arm.held_pose()
        self._gauges = [
            (self._model.getJointId(gauge.joint), gauge_point(gauge),
             gauge_axis(self._model, gauge), gauge.distance) for gauge in arm.gauges]
        self._axes = [link_axes(arm, span.joint) for span in spans]

    def residual(
        self, dt: float, row: FloatArray, measured: FloatArray, residual: FloatArray | None,
    ) -> FloatArray | None:
        """Give the residual as moments (gauges,) [N m]; None where the model has none."""
        if residual is None:
            return None
        self._now = self.rows(row)
        return np.asarray(residual / self._gain)

    def carry(
        self, number: int, state: FloatArray, covariance: FloatArray, dt: float, fade: float,
        rise: FloatArray, calm: float,
    ) -> FloatArray:
        """Carry what presses on a span to the newest sample; see `ElasticFront.carry`."""
        state *= fade
        covariance *= fade * fade
        covariance += rise
        return self._now[number]

    def settle(self, left: FloatArray, dt: float, states: FloatArray) -> None:
        """Do nothing: a rigid arm has no state of its own."""

    def rows(self, row: FloatArray) -> list[FloatArray]:
        """Give the moment at gauges by what presses, span by span: (gauges, PRESSING)."""
        self._q[self._columns] = row[:len(self._columns)]
        pin.forwardKinematics(self._model, self._data, self._q)
        return [self._levers(span, axes)
                for span, axes in zip(self._spans, self._axes, strict=True)]

    def _levers(self, span: Span, axes: LinkAxes) -> FloatArray:
        own = self._model.getJointId(span.joint)
        near, far = span.ends
        result = np.zeros((len(self._gauges), PRESSING))
        for g, (joint, _, _, distance) in enumerate(self._gauges):
            if joint not in self._model.supports[own]:
                continue
            # inboard of a gauge on the same link nothing bends it
            inner = 0.0 if joint == own and near <= distance else self._moment(
                g, own, near * axes.along, axes.across)
            outer = self._moment(g, own, far * axes.along, axes.across)
            slope = (outer - inner) / (far - near)
            result[g] = (inner - near * slope, slope,
                         self._moment(g, own, far * axes.along, axes.along))
        return result

    def _moment(self, g: int, own: int, at: FloatArray, direction: FloatArray) -> float:
        """Give the moment at a gauge by a unit force at a point of a link."""
        joint, point, axis, _ = self._gauges[g]
        link, carrier = self._data.oMi[own], self._data.oMi[joint]
        lever = link.act(at) - carrier.act(point)
        return -float((carrier.rotation @ axis) @ np.cross(lever, link.rotation @ direction))
