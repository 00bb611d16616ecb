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
One model for all payloads: parameters that are affine in the mass at the tip.

A payload of the mass m adds m times something fixed to the inertial parameters of the last body,
so every base parameter is pi_0 + m pi_1 and the outputs stay linear in parameters: the regressor
``[Y, m Y_last]`` with the payload as one more input. Bags with two payloads are enough to fit it.
While a robot runs, the payload is fixed for a while: ``at`` puts it in and gives a plain model.
"""

from __future__ import annotations

from typing import Any
import warnings

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.errors import FitError, TudorWarning
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import Range
from tudor_dynamics.models.bundle_parts import Group, groups_of, PayloadElmPart, PayloadPart, read
from tudor_dynamics.models.elm import channels_of, ExtremeLearningMachine, restored
from tudor_dynamics.models.estimation import Estimate
from tudor_dynamics.models.memoryless import ModelSettings
from tudor_dynamics.models.regressor import (
    BaseSet, EffortRegressor, PAYLOAD, plain_regressor, Regressor, StrainRegressor)
from tudor_dynamics.models.rigid_bodies import BODY_PARAMETERS
from tudor_dynamics.typing import FloatArray

SAME = 1e-6
"""Payloads that differ by less are the same [kg]."""


def last_body(model: pin.Model) -> str:
    """Give the joint that moves the body at the end of the longest chain."""
    depth = [0] * model.njoints
    for index in range(1, model.njoints):
        depth[index] = depth[int(model.parents[index])] + 1
    return str(model.names[int(np.argmax(depth))])


class PayloadRegressor:
    """Rows of a regressor, and those of its last body once more for each kilogram of payload."""

    extra_inputs = 1
    """The payload follows the motion [kg]."""

    def __init__(self, plain: EffortRegressor | StrainRegressor, body: str) -> None:
        if plain.loaded:
            msg = ('friction that grows with the load (the term load) is not identified over '
                   'several payloads')
            raise FitError(msg, remedy='leave it out of joints[].friction, or fit each payload '
                                       'apart')
        self.plain = plain
        self.body = body
        self.loaded = False
        self.states = plain.states
        self.channels = plain.channels
        self.groups = plain.groups
        self.unknown = plain.unknown
        self.scaled = np.append(plain.scaled, np.full(len(BODY_PARAMETERS), True))
        self.form = getattr(plain, 'form', None)
        own = [f'{name}({body})' for name in BODY_PARAMETERS]
        self.carried = np.array([plain.columns.index(name) for name in own], dtype=np.intp)
        self.columns: tuple[str, ...] = (*plain.columns, *(PAYLOAD + name for name in own))

    def rows(self, motion: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Evaluate rows; see ``Regressor``."""
        n = len(self.plain.columns)
        shape = (len(motion), len(self.channels), len(self.columns))
        rows = np.zeros(shape) if out is None else out
        self.plain.rows(motion[:, :-1], out=rows[:, :, :n])
        np.multiply(rows[:, :, self.carried], motion[:, -1, None, None], out=rows[:, :, n:])
        return rows

    def assume(self, parameters: FloatArray | None) -> None:
        """Take parameters that no row depends on; see ``Regressor``."""

    def outputs(self, motion: FloatArray, parameters: FloatArray) -> FloatArray:
        """Evaluate rows times parameters, without making the rows; see ``Regressor``."""
        n = len(self.plain.columns)
        carried = np.zeros((len(parameters), n))
        carried[:, self.carried] = parameters[:, n:]
        states = np.ascontiguousarray(motion[:, :-1])
        return (self.plain.outputs(states, np.ascontiguousarray(parameters[:, :n]))
                + motion[:, -1:] * self.plain.outputs(states, carried))


def payload_regressor(plain: EffortRegressor | StrainRegressor, arm: Arm) -> PayloadRegressor:
    """Let a regressor know of a payload at the end of its arm."""
    exact = getattr(plain, 'form', None) == 'exact'
    return PayloadRegressor(plain, last_body(arm.gauge_model if exact else arm.model))


def check_payload(payload: float, known: Range) -> None:
    """Refuse what is no mass, and warn beyond the payloads that a model was fitted to."""
    if not 0.0 <= payload < float('inf'):
        msg = f'a payload of {payload} kg is impossible; give 0 or more'
        raise FitError(msg)
    low, high = known
    if not low - 1e-9 <= payload <= high + 1e-9:
        msg = (f'the payload {payload:g} kg is outside the {low:g} to {high:g} kg that the model '
               'was fitted to: it extrapolates')
        warnings.warn(msg, TudorWarning, stacklevel=3)


class PayloadModel(AnalyticalModel):
    """
    Analytical model of all payloads; its input is ``[q, dq, ddq, payload]``.

    payload_range [kg].
    """

    def __init__(
        self,
        regressor: PayloadRegressor,
        n_joints: int,
        payload_range: Range,
        *,
        estimator: str = 'wls',
        base: tuple[BaseSet, ...] | None = None,
    ) -> None:
        super().__init__(regressor, n_joints, estimator=estimator, base=base)
        self.payload_range: Range = payload_range
        self._plain: Regressor = regressor.plain
        self._carried = regressor.carried

    def like(self) -> PayloadModel:
        """Give one of the same rows, base parameters and payloads that is not fitted yet."""
        regressor = self.regressor
        assert isinstance(regressor, PayloadRegressor)
        return PayloadModel(regressor, self.n_joints, self.payload_range,
                            estimator=self.estimator, base=self.base_)

    @classmethod
    def new(cls, arm: Arm, output: str, settings: ModelSettings) -> PayloadModel:
        """Build one for the payloads of the fit; see ``MemorylessModel``."""
        assert settings.payloads is not None
        plain = plain_regressor(arm, output, settings.strain_form, shared=bool(settings.shared))
        return cls(payload_regressor(plain, arm), len(arm.active_joints), settings.payloads,
                   estimator=settings.estimator)

    @classmethod
    def from_dict(cls, content: dict[str, Any], arm: Arm, output: str) -> PayloadModel:
        """Build it from its coefficients; see ``Model``."""
        part = read(PayloadPart, content)
        regressor = payload_regressor(
            plain_regressor(arm, output, str(part.form), shared=part.shared), arm)
        groups = groups_of(part.groups, regressor, arm, output)
        model = cls(regressor, len(arm.active_joints), part.payload_range,
                    estimator=part.estimator,
                    base=tuple(group.base for group in groups))
        model.groups_ = groups
        return model

    def at(self, payload: float) -> AnalyticalModel:
        """Put a payload in; see ``Model``."""
        full = self.coefficients()
        check_payload(payload, self.payload_range)
        n = len(self._plain.columns)
        merged = full[:, :n].copy()
        merged[:, self._carried] += payload * full[:, n:]
        groups = []
        for group in self.groups_:
            channels = group.base.channels
            shared = merged[channels[0]].copy()
            if group.constants is not None:
                shared[self._plain.scaled] *= group.constants.values[0]
            kept = np.flatnonzero(shared)
            values = shared[kept]
            # what two parameters' errors come to together is in no single number
            unknown = np.full(len(kept), np.nan)
            base = BaseSet(channels, kept, tuple(self._plain.columns[i] for i in kept))
            groups.append(Group(base, Estimate(values, unknown, group.estimate.condition, (),
                                               group.estimate.variances), group.constants))
        model = AnalyticalModel(self._plain, self.n_joints, estimator=self.estimator,
                                base=tuple(group.base for group in groups))
        model.groups_ = tuple(groups)
        return model


class PayloadELM(ExtremeLearningMachine):
    """
    ELM of all payloads: the payload is one more input, ``[q, dq, ddq, payload]``.

    payload_range [kg].
    """

    def __init__(
        self, channels: tuple[str, ...], payload_range: Range, *, hidden: int = 100,
        ridge: float = 1e-6, seed: int = 0, clip: bool = True,
    ) -> None:
        super().__init__(channels, hidden=hidden, ridge=ridge, seed=seed, clip=clip)
        self.payload_range: Range = payload_range

    @classmethod
    def new(cls, arm: Arm, output: str, settings: ModelSettings) -> PayloadELM:
        """Build one for the payloads of the fit; see ``MemorylessModel``."""
        assert settings.payloads is not None
        return cls(channels_of(arm, output), settings.payloads, hidden=settings.elm_hidden,
                   ridge=settings.elm_ridge, seed=settings.elm_seed)

    @classmethod
    def from_dict(cls, content: dict[str, Any], arm: Arm, output: str) -> PayloadELM:
        """Build it from settings and arrays; see ``Model``."""
        payloads = read(PayloadElmPart, content).payload_range
        return restored(lambda channels, more: cls(channels, payloads, **more),
                        content, arm, output, extra=1)

    def at(self, payload: float) -> ExtremeLearningMachine:
        """Put a payload in; see ``Model``."""
        if self.output_weights_ is None:
            self.predict(np.zeros((1, 0)))  # says what is missing
        check_payload(payload, self.payload_range)
        plain = ExtremeLearningMachine(self.channels, hidden=self.hidden, ridge=self.ridge,
                                       seed=self.seed, clip=self.clip)
        low, high = self.input_range_[:, -1]
        normal = 2.0 * (payload - low) / (high - low) - 1.0 if high > low else 0.0
        if self.clip:
            normal = min(max(normal, -1.0), 1.0)
        plain.input_range_, plain.output_range_ = self.input_range_[:, :-1], self.output_range_
        plain.input_weights_ = self.input_weights_[:-1]
        plain.biases_ = self.biases_ + normal * self.input_weights_[-1]
        plain.output_weights_ = self.output_weights_
        return plain
