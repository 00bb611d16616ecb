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
The elastic model: strain and effort of a flexible arm with its oscillation in them.

Where the analytical model takes the links as rigid, this one lets them bend: the equivalent
rigid-link system of Gasparetto et al., its joints driven by measured positions through elastic
gears, carries the oscillation as its own state.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from copy import copy
from dataclasses import asdict, dataclass
import math
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.errors import ModelError, NotFittedError, SimulationError
from tudor_dynamics.models.base import (
    AGAIN, BundlePart, check_motion, check_payload, Coefficient, CoefficientPart, Flag, Model,
    Noise, Payloads, Range, read, SLIDING, Text)
from tudor_dynamics.models.elastic.arm import DrivenArm, NO_GAINS, Response
from tudor_dynamics.models.elastic.parameters import physical_unit
from tudor_dynamics.models.friction import (
    friction_columns, friction_names, has_constant, JointTerms, sliding)
from tudor_dynamics.models.regressor import output_units
from tudor_dynamics.models.settings import BANDWIDTH, OBSERVED
from tudor_dynamics.signals.preprocessing import Stretch
from tudor_dynamics.typing import FloatArray


# -- What makes up the effort of an elastic arm's motor: torque of its gear, its rotor, friction

def effort_rows(arm: Arm, response: Response, motion: FloatArray) -> list[FloatArray]:
    """Give what makes up each joint's effort, (samples, columns), of a motion and its response."""
    n = len(arm.joints)
    rows = []
    for i, joint in enumerate(arm.joints):
        dq, ddq = motion[:, n + i], motion[:, 2 * n + i]
        columns = [response.torque[:, i], ddq, *friction_columns(joint, dq).T]
        if not has_constant(joint):
            columns.append(np.ones(len(motion)))
        rows.append(np.column_stack(columns))
    return rows


Outputs = Callable[[Response, FloatArray], FloatArray]
"""Response and ``[q, dq, ddq]`` of the same samples to outputs, shape (n_samples, n_channels)."""


def effort_outputs(arm: Arm, coefficients: tuple[FloatArray, ...]) -> Outputs:
    """Prepare the effort, the sum of `effort_rows` times their coefficients."""
    joints = arm.joints
    n = len(joints)
    torque, inertia = np.array([values[:2] for values in coefficients]).T.copy()
    constant, table = np.zeros(n), np.zeros((n, max(len(values) for values in coefficients)))
    for i, (joint, values) in enumerate(zip(joints, coefficients, strict=True)):
        friction = values[2:]
        if not has_constant(joint):
            friction, constant[i] = values[2:-1], values[-1]
        table[i, :len(friction)] = friction
    # the inertia of the rotor is a column of every joint here, and added below
    terms = JointTerms([joint.model_copy(update={'rotor_inertia': False}) for joint in joints],
                       [0] * n, np.ones(n))

    def outputs(response: Response, motion: FloatArray) -> FloatArray:
        effort = response.torque * torque + motion[:, 2 * n:] * inertia + constant
        terms.add(motion, table, effort)
        return np.asarray(effort)
    return outputs


def follow_stretch(
    driven: DrivenArm, stretch: Stretch, gauges: FloatArray | None = None,
) -> Response:
    """
    Follow a stretch from rest; where it begins in motion, gauges show how its links oscillate.

    Gauges (gauges, 3): gain, offset and noise of their strain. They correct the state for
    OBSERVED seconds, each after its sample; what comes later follows from motion alone.
    """
    q, dt, before = stretch.states.q, stretch.dt, stretch.before
    if (gauges is None or stretch.strain is None or not stretch.past_unknown
            or not np.all(gauges[:, 0])):
        driven.begin(before)
        return driven.follow(q, dt)
    n = int(np.searchsorted(stretch.t, stretch.t[0] + OBSERVED))
    gain, offset, noise = gauges.T
    measured = (stretch.strain[:n] - offset) / gain
    gains = driven.gains_along(q[:n], dt[:n], measured, noise / np.abs(gain), BANDWIDTH, before)
    driven.begin(before)
    begun = driven.prompt(q[:n], dt[:n], driven.ahead(dt[:n], measured), gains)
    rest = driven.prompt(q[n:], dt[n:], np.zeros((len(q) - n, 0)), NO_GAINS)
    return Response(driven.late(np.vstack([begun.moment, rest.moment]), dt),
                    np.vstack([begun.torque, rest.torque]))


def driven_arm(arm: Arm, values: Mapping[str, float]) -> DrivenArm:
    """Build the driven arm of a model."""
    try:
        driven = DrivenArm(arm)
        driven.set_parameters(values)
    except SimulationError as err:
        raise ModelError(f'the elastic model cannot be used; {err}') from None
    return driven


# -- What an elastic model has learned, as it is kept in a bundle

@dataclass(frozen=True)
class PhysicalParameter:
    """One physical parameter of an elastic arm."""

    name: Text  # name, see `DrivenArm.parameters`
    value: Coefficient  # value in the unit below
    unit: Text  # unit of the value
    # Standard deviation of the value; NaN where it was not identified [unit].
    standard_error: Annotated[float, BeforeValidator(
        lambda value: math.nan if value is None else value)] = math.nan
    shown: Flag = False  # whether the recordings say more about it than the description did


class ChannelPart(BundlePart):
    """Coefficients of one channel of an elastic model."""

    channel: Text
    residual_std: Noise
    coefficients: tuple[CoefficientPart, ...]


class ElasticPart(BundlePart):
    """Elastic model, of one payload or of all."""

    physical: tuple[PhysicalParameter, ...]  # stiffness, damping, play, masses, with errors
    channels: tuple[ChannelPart, ...]  # gains, offsets, friction
    payload_range: Payloads | None = None  # of a model of all payloads [kg]


class ElasticModel(Model):
    """
    Parameters of an elastic arm, and coefficients of its strain or effort.

    Parameters
    ----------
    arm : Arm
        Arm with ``links``; friction with a state, or by the load, is left out.
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
    coefficients_, standard_errors_ : tuple of ndarray, or None
        Coefficients of each channel on its columns, and their standard deviations.
    noise_ : ndarray of shape (n_channels,), or None
        Standard deviation of what it leaves over of the training data, in their units.
    strain_model : ElasticModel or None
        Model of the strain by which measured strain corrects this one; a strain model's is itself.

    """

    def __init__(
        self, arm: Arm, output: str, physical: tuple[PhysicalParameter, ...] = (), *,
        payload_range: Range | None = None,
    ) -> None:
        self.arm = arm = sliding(arm, loaded=False)
        self.output = output
        self.physical = physical
        self.payload_range = payload_range
        self.n_joints = len(arm.active_joints)
        self.coefficients_: tuple[FloatArray, ...] | None = None
        self.standard_errors_: tuple[FloatArray, ...] | None = None
        self.noise_: FloatArray | None = None
        self.channels = arm.channels[output]
        self.columns: tuple[tuple[str, ...], ...] = (('moment', 'offset'),) * len(self.channels)
        if output == 'effort':
            self.columns = tuple(
                ('torque', f'Ia({joint.name})', *friction_names(joint),
                 *(() if has_constant(joint) else ('offset',))) for joint in arm.joints)
        self.strain_model: ElasticModel | None = self if output == 'strain' else None
        self._driven: DrivenArm | None = None

    def __repr__(self) -> str:
        """Write outputs and the physical parameters that were identified."""
        state = '' if self.coefficients_ is not None else ', not fitted'
        found = [f'  {parameter.name}: {parameter.value:.4g} {parameter.unit}'
                 for parameter in self.physical]
        return '\n'.join([f'{type(self).__name__}({", ".join(self.channels)}{state})', *found])

    @property
    def values(self) -> dict[str, float]:
        """Physical parameters by name, SI units."""
        return {parameter.name: parameter.value for parameter in self.physical}

    @property
    def gauges(self) -> FloatArray | None:
        """Gain, offset and noise of each gauge, (gauges, 3); None where no strain is known."""
        strain = self.strain_model
        if strain is None or strain.coefficients_ is None or strain.noise_ is None:
            return None
        return np.column_stack([np.array(strain.coefficients_), strain.noise_])

    def prepared(self) -> Outputs:
        """Prepare what turns moments and torques into outputs."""
        if self.coefficients_ is None:
            raise NotFittedError('the elastic model has no coefficients yet; fit it, or load one')
        if self.output == 'effort':
            return effort_outputs(self.arm, self.coefficients_)
        gains, offsets = np.array(self.coefficients_).T.copy()
        return lambda response, motion: np.asarray(response.moment * gains + offsets)

    def follow(self, stretch: Stretch) -> FloatArray:
        check_motion(stretch.motion, 3 * self.n_joints)
        if self._driven is None:
            self._driven = driven_arm(self.arm, self.values)
        response = follow_stretch(self._driven, stretch, self.gauges)
        return self.prepared()(response, stretch.motion)

    def observe(self, stretch: Stretch) -> FloatArray:
        if stretch.strain is None or self.gauges is None:
            return self.follow(stretch)
        live = LiveElastic({self.output: self})
        motion, dt = stretch.motion, stretch.dt
        dt[0] = 0.0  # an observer restarts
        predicted = np.full((len(motion), len(self.channels)), np.nan)
        for k in range(len(motion)):
            values = live.step(float(dt[k]), motion[k])
            if values is not None:
                predicted[k] = values[self.output]
            live.measure(stretch.strain[k])
        return predicted

    def stiction(self, q: FloatArray) -> FloatArray:
        if self.output != 'effort' or self.coefficients_ is None:
            return super().stiction(q)
        jumps = []
        for joint, values in zip(self.arm.joints, self.coefficients_, strict=True):
            forward, backward = friction_columns(joint, np.array([SLIDING, -SLIDING]))
            jumps.append(0.5 * abs(float((forward - backward) @ values[2:2 + len(forward)])))
        return np.array(jumps)

    def at(self, payload: float) -> ElasticModel:
        if self.payload_range is not None:
            check_payload(payload, self.payload_range)
        model = copy(self)
        model.physical = (*(p for p in self.physical if p.name != 'payload'),
                          PhysicalParameter('payload', payload, 'kg'))
        model.payload_range = model._driven = None
        return model

    @classmethod
    def live(cls, models: Mapping[str, ElasticModel]) -> LiveElastic:
        return LiveElastic(models)

    def to_dict(self, arm: Arm, output: str) -> dict[str, Any]:
        if self.coefficients_ is None or self.standard_errors_ is None or self.noise_ is None:
            raise NotFittedError('the elastic model has no coefficients yet; fit it, then save it')
        content: dict[str, Any] = {
            'units': output_units(arm, output),
            'physical': [
                {**asdict(p), 'value': float(p.value), 'standard_error': None if math.isnan(
                    p.standard_error) else float(p.standard_error)} for p in self.physical],
            'channels': [
                {'channel': channel, 'residual_std': float(noise),
                 'coefficients': [
                     {'column': column, 'value': float(value), 'standard_error': float(error)}
                     for column, value, error in zip(columns, values, errors, strict=True)]}
                for channel, columns, values, errors, noise in zip(
                    self.channels, self.columns, self.coefficients_, self.standard_errors_,
                    self.noise_, strict=True)]}
        if self.payload_range is not None:
            content['payload_range'] = [float(value) for value in self.payload_range]
        return content

    @classmethod
    def from_dict(cls, content: dict[str, Any], arm: Arm, output: str) -> ElasticModel:
        part = read(ElasticPart, content)
        model = cls(arm, output, part.physical, payload_range=part.payload_range)
        known = driven_arm(arm, model.values).parameters  # refuses unknown names and values
        for parameter in part.physical:
            if parameter.name in known and parameter.unit != physical_unit(arm, parameter.name):
                raise ModelError(f'{parameter.name} has the unit {parameter.unit!r}; expected '
                                 f'{physical_unit(arm, parameter.name)!r}', remedy=AGAIN)
        channels = tuple(item.channel for item in part.channels)
        columns = tuple(tuple(row.column for row in item.coefficients) for item in part.channels)
        if channels != model.channels or columns != model.columns:
            msg = (f'{output} channels {list(channels)} with the columns {list(columns)}; '
                   f'expected {list(model.channels)} with {list(model.columns)}')
            raise ModelError(msg, remedy=AGAIN)
        model.coefficients_, model.standard_errors_ = (tuple(
            np.array([getattr(row, value) for row in item.coefficients])
            for item in part.channels) for value in ('value', 'standard_error'))
        model.noise_ = np.array([item.residual_std for item in part.channels])
        return model


# -- Elastic models sample by sample, corrected by measured strain

class LiveElastic:
    """Elastic models of one arm, sample by sample, on one simulated arm."""

    # What a push leaves, an oscillation that no joint's motion explains, stays in the state of a
    # model that only follows the joints. The observer takes it over from measured strain: an
    # extended Kalman filter, slow enough that a collision shows in the innovation first.

    REMEMBERED = '_driven', '_moment', '_since', '_lost'

    def __init__(self, models: Mapping[str, ElasticModel]) -> None:
        if not models:
            raise ModelError('no elastic model was given; pass at least one')
        self._outputs = {output: model.prepared() for output, model in models.items()}
        first = next(iter(models.values()))
        if any(model.values != first.values for model in models.values()):
            raise ModelError('elastic models of effort and strain differ; fit both together again')
        self._n_joints = first.n_joints
        self._driven: DrivenArm = driven_arm(first.arm, first.values)
        self._gauges = gauges = models.get('strain', first).gauges
        self.observing = gauges is not None
        if gauges is not None:
            if np.any(gauges[:, 0] == 0.0):
                dead = first.arm.gauges[int(np.argmin(np.abs(gauges[:, 0])))].name
                raise ModelError(f'gauge {dead!r} has the gain 0; check this gauge and fit again')
            self._driven.start_observer(gauges[:, 2] / np.abs(gauges[:, 0]), BANDWIDTH)
        self._moment: FloatArray = np.zeros(len(first.arm.gauges))
        self._strain: FloatArray | None = None
        self._since = 0.0
        self._lost = False

    def measure(self, strain: FloatArray) -> None:
        """Take the strain of the newest sample (gauges,), NaN where none counts; see ``step``."""
        self._strain = strain

    def step(
        self, dt: float, row: FloatArray, wanted: Collection[str] | None = None,
    ) -> dict[str, FloatArray] | None:
        """Go to the next sample and predict; see ``Live``."""
        step = np.array([0.0 if self._lost else dt])
        self._lost = False
        try:
            if self._gauges is not None:
                self._observe(float(step[0]), self._gauges)
            response = self._driven.follow(row[None, :self._n_joints], step)
        except SimulationError:
            self._lost = True
            return None
        self._moment = response.moment[0]
        return {output: outputs(response, row[None])[0]
                for output, outputs in self._outputs.items()
                if wanted is None or output in wanted}

    def _observe(self, dt: float, gauges: FloatArray) -> None:
        """Correct the state after the sample before by what was measured there."""
        strain, self._strain = self._strain, None
        if dt <= 0.0:
            self._driven.forget()
            self._since = 0.0
            return
        if strain is not None and self._since > 0.0:
            measured = (strain - gauges[:, 1]) / gauges[:, 0]
            if not self._driven.correct(measured - self._moment, self._since):
                raise SimulationError('the elastic model diverged; fit it to more bags')
            self._since = 0.0
        self._since += dt
