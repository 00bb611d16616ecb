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
The analytical model: rigid-body structure, linear in base parameters.

One class serves effort and strain; the regressor makes the difference. Its habits are
scikit-learn's: ``fit`` returns self, learned attributes end in an underscore, arrays are
``(samples, channels)``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any
import warnings

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.errors import FitError, ModelError, NotFittedError, TudorWarning
from tudor_dynamics.models.base import (
    AGAIN, Blocks, BundlePart, check_block, check_motion, check_payload, CoefficientPart,
    Conditioning, Flag, MAX_COEFFICIENT, MemorylessModel, ModelSettings, Noise, Payloads, read,
    Text)
from tudor_dynamics.models.estimation import (
    Constants, Estimate, ESTIMATORS, find_constants, Products, rescaled, solve, summed)
from tudor_dynamics.models.regressor import (
    base_sets, BaseSet, column_unit, output_units, PayloadRegressor, random_inputs, Regressor,
    regressor_of)
from tudor_dynamics.models.settings import (
    LARGEST_GRAM_CONDITION, LOAD_CHANGE, LOAD_PASSES, WEIGHT_PASSES)
from tudor_dynamics.typing import FloatArray

ROWS_AT_A_TIME = 1024
"""Samples for which rows are held in memory at once: 5.6 MB at 7 joints and 98 columns."""


class BasePart(CoefficientPart):
    """A base parameter."""

    name: Text
    excited: Flag


class ConstantPart(BundlePart):
    """Torque constant of a joint, relative to that of others."""

    channel: str
    value: Annotated[float, Field(ge=1.0 / MAX_COEFFICIENT, le=MAX_COEFFICIENT)]
    relative_error: Annotated[float, Field(ge=0.0)]


class GroupPart(BundlePart):
    """Base parameters of channels that share them."""

    channels: tuple[str, ...]
    condition: float
    residual_std: tuple[Noise, ...]
    coefficients: tuple[BasePart, ...]
    torque_constants: tuple[ConstantPart, ...] | None = None

    @model_validator(mode='after')
    def _each(self) -> GroupPart:
        if len(self.residual_std) != len(self.channels):
            raise ValueError(f'residual_std has {len(self.residual_std)} values; expected one for '
                             f'each of the channels {", ".join(self.channels)}')
        constants = self.torque_constants
        if constants is not None and tuple(item.channel for item in constants) != self.channels:
            raise ValueError(f'give torque_constants of {", ".join(self.channels)}, in this order')
        return self


class AnalyticalPart(BundlePart):
    """Analytical model."""

    estimator: Text  # `ols`, `wls` or `huber`
    form: Text | None = None  # of strain: `exact` or `paper`
    payload_range: Payloads | None = None  # of a model of all payloads [kg]
    groups: tuple[GroupPart, ...]  # channels with base parameters of their own

    @property
    def shared(self) -> bool:
        """Whether channels share their parameters up to torque constants."""
        return any(group.torque_constants is not None for group in self.groups)


# -- Base parameters with their estimates to plain values and back, checked on the way in

@dataclass(frozen=True, eq=False)
class Group:
    """Base parameters of a group of channels with their estimate."""

    base: BaseSet  # base parameters of the channels
    estimate: Estimate  # their values with standard errors
    constants: Constants | None = None  # where channels share parameters up to these

    def of(
        self, columns: Sequence[str], kept: NDArray[np.intp], parameters: FloatArray,
        constants: Constants | None,
    ) -> Group:
        """Give its channels other parameters, those kept of some columns, of unknown error."""
        return Group(
            BaseSet(self.base.channels, kept, tuple(columns[i] for i in kept)),
            replace(self.estimate, parameters=parameters[kept], unexcited=(),
                    standard_errors=np.full(len(kept), np.nan)), constants)


def groups_of(
    parts: tuple[GroupPart, ...], regressor: Regressor, arm: Arm, output: str,
) -> tuple[Group, ...]:
    """Make base parameters of what was read."""
    index = {name: i for i, name in enumerate(regressor.columns)}
    channels = {name: i for i, name in enumerate(regressor.channels)}
    listed = [name for part in parts for name in part.channels]
    if sorted(listed) != sorted(channels):
        raise ModelError(f'{output} channels are {", ".join(listed)}, not {", ".join(channels)}',
                         remedy=AGAIN)
    groups = []
    for part in parts:
        rows = part.coefficients
        unknown = [row.column for row in rows if row.column not in index]
        if unknown:
            raise ModelError(f'the arm has no parameter {unknown[0]!r}', remedy=AGAIN)
        constants = part.torque_constants and Constants(
            np.array([item.value for item in part.torque_constants]),
            np.array([item.relative_error for item in part.torque_constants]))
        groups.append(Group(
            BaseSet(tuple(channels[name] for name in part.channels),
                    np.array([index[row.column] for row in rows], dtype=np.intp),
                    tuple(row.name for row in rows)),
            Estimate(np.array([row.value for row in rows]),
                     np.array([row.standard_error for row in rows]), part.condition,
                     tuple(k for k, row in enumerate(rows) if not row.excited),
                     np.array(part.residual_std) ** 2), constants or None))
    return tuple(groups)


class AnalyticalModel(MemorylessModel):
    """Outputs as base regressor times base parameters; of all payloads where its rows are."""

    def __init__(
        self, regressor: Regressor, n_joints: int, *, estimator: str = 'wls',
        base: tuple[BaseSet, ...] | None = None, groups: Sequence[Group] = (),
    ) -> None:
        self.regressor = regressor
        self.payload_range = regressor.payload_range
        self.channels = regressor.channels
        self.n_joints = n_joints
        self.states = regressor.states
        self._n_states = 0 if self.states is None else self.states.count
        self.n_inputs = 3 * n_joints + self._n_states + (regressor.payload_range is not None)
        self.estimator = estimator
        self.groups_: tuple[Group, ...] = tuple(groups)
        self.base_: tuple[BaseSet, ...] = (
            base or tuple(group.base for group in groups) or base_sets(regressor, n_joints))
        self.data_: list[list[Products]] = []  # of each group and channel
        self._full: FloatArray | None = None
        self._full_of: tuple[Group, ...] | None = None

    def __repr__(self) -> str:
        """Write outputs, number of base parameters and conditioning."""
        state = ', '.join(f'condition {group.estimate.condition:.3g}' for group in self.groups_)
        return (f'{type(self).__name__}({", ".join(self.channels)}; '
                f'{sum(len(base.names) for base in self.base_)} base parameters by '
                f'{self.estimator}, {state or "not fitted"})')

    @classmethod
    def new(cls, arm: Arm, output: str, settings: ModelSettings) -> AnalyticalModel:
        return cls(
            regressor_of(arm, output, settings.strain_form, shared=bool(settings.shared),
                         payloads=settings.payloads),
            len(arm.active_joints), estimator=settings.estimator)

    def fit_blocks(self, blocks: Blocks) -> AnalyticalModel:
        self._begin()
        parts = {'all': blocks}
        triangular = self._least_squares(parts, {})
        for _ in range(LOAD_PASSES if self.regressor.loaded else 0):
            before = self.coefficients()
            self.regressor.assume(before)
            triangular = self._least_squares(parts, {})
            change = np.linalg.norm(self.coefficients() - before, axis=1)
            if np.all(change < LOAD_CHANGE * np.linalg.norm(before, axis=1)):
                break
        if ESTIMATORS[self.estimator].sample_weights is not None:
            self._fit_weighted(blocks, triangular=triangular)
        return self

    def fit_parts(
        self, parts: Mapping[str, Blocks], known: dict[tuple[str, bool], Any],
    ) -> AnalyticalModel:
        if (ESTIMATORS[self.estimator].sample_weights is not None
                or self.regressor.loaded):  # rows depend on all parts
            return super().fit_parts(parts, known)
        self._begin()
        self._least_squares(parts, known)
        return self

    def _begin(self) -> None:
        if self.estimator not in ESTIMATORS:
            raise FitError(f'unknown estimator {self.estimator!r}; use {" or ".join(ESTIMATORS)}')
        self.regressor.assume(np.zeros((len(self.channels), len(self.regressor.columns))))

    def _least_squares(
        self, parts: Mapping[str, Blocks], known: dict[tuple[str, bool], Any],
    ) -> bool:
        """Estimate in one pass, or in two where the first is too inaccurate; say which."""
        for triangular in (False, True):
            for name, blocks in parts.items():
                if (name, triangular) not in known:
                    known[name, triangular] = self.products(blocks, triangular=triangular)
            self.fit_data([known[name, triangular] for name in parts])
            if all(group.estimate.condition <= LARGEST_GRAM_CONDITION for group in self.groups_):
                break
        return triangular

    def products(
        self, blocks: Blocks, *, triangular: bool = False, weights: FloatArray | None = None,
    ) -> list[list[Products]]:
        """Accumulate the products of every group and channel: weights (kept, channels)."""
        # a joint does not feel the links before it nor the friction of others; leaving those zeros
        # out saves two thirds of the products of a seven-joint arm
        drawn = self.regressor.rows(random_inputs(self.regressor, self.n_joints, 16, 1))
        supports = [[np.flatnonzero(np.any(drawn[:, channel, base.kept] != 0.0, axis=0))
                     for channel in base.channels] for base in self.base_]
        sums = [[Products.empty(len(places), triangular=triangular) for places in support]
                for support in supports]
        done = 0
        for rows, output in self._rows(blocks):
            part = None if weights is None else weights[done:done + len(output)]
            done += len(output)
            for base, group, support in zip(self.base_, sums, supports, strict=True):
                for channel, product, places in zip(base.channels, group, support, strict=True):
                    product.add(rows[:, channel, base.kept[places]], output[:, channel],
                                None if part is None else part[:, channel])
        return [[product.spread(places, len(base.kept))
                 for product, places in zip(group, support, strict=True)]
                for base, group, support in zip(self.base_, sums, supports, strict=True)]

    def fit_data(self, parts: Iterable[list[list[Products]]]) -> AnalyticalModel:
        """Estimate from what parts of the data come to."""
        self.data_ = summed(parts)
        self.groups_ = tuple(self._estimate(base, group) for base, group in zip(
            self.base_, self.data_, strict=True))
        return self

    def _estimate(self, base: BaseSet, products: list[Products]) -> Group:
        unknown = [base.channels.index(i) for i in self.regressor.unknown]
        constants = None
        if unknown:
            scaled = self.regressor.scaled[base.kept]
            constants = find_constants(products, scaled, unknown)
            products = [rescaled(product, scaled, value) for product, value in
                        zip(products, constants.values, strict=True)]
        weighted = ESTIMATORS[self.estimator].weighted
        return Group(base, solve(products, weighted=weighted), constants)

    def predict(self, motion: FloatArray) -> FloatArray:
        coefficients = self.coefficients()
        motion = np.asarray(motion, dtype=float)
        check_motion(motion, self.n_inputs, self.n_inputs - self._n_states)
        return self.regressor.outputs(motion, coefficients)

    def coefficients(self) -> FloatArray:
        """Give the parameters on all columns, shape (n_channels, n_columns)."""
        if not self.groups_:
            raise NotFittedError('the analytical model has no parameters yet; fit it, or load one')
        if self._full is not None and self._full_of is self.groups_:
            return self._full
        full = np.zeros((len(self.channels), len(self.regressor.columns)))
        for group in self.groups_:
            for i, channel in enumerate(group.base.channels):
                full[channel, group.base.kept] = group.estimate.parameters
                if group.constants is not None:
                    full[channel, self.regressor.scaled] /= group.constants.values[i]
        # kept: beside a running robot this is asked for at every sample
        full.flags.writeable = False
        self._full, self._full_of = full, self.groups_
        return full

    def at(self, payload: float) -> AnalyticalModel:
        if not isinstance(self.regressor, PayloadRegressor):
            return self
        full = self.coefficients()
        check_payload(payload, self.regressor.payload_range)
        plain, n = self.regressor.plain, len(self.regressor.plain.columns)
        merged = full[:, :n].copy()
        merged[:, self.regressor.carried] += payload * full[:, n:]
        groups = []
        for group in self.groups_:
            shared = merged[group.base.channels[0]].copy()
            if group.constants is not None:
                shared[plain.scaled] *= group.constants.values[0]
            # what two parameters' errors come to together is in no single number
            groups.append(group.of(plain.columns, np.flatnonzero(shared), shared, group.constants))
        return AnalyticalModel(plain, self.n_joints, estimator=self.estimator, groups=groups)

    def deviations(self) -> FloatArray:
        """Give the standard deviation of the residual of each channel, (n_channels,)."""
        found = np.zeros(len(self.channels))
        for group in self.groups_:
            found[list(group.base.channels)] = np.sqrt(group.estimate.variances)
        return found

    def conditioning(self) -> Conditioning:
        """Give the largest condition number of its groups, and what they do not show."""
        return Conditioning(
            max((group.estimate.condition for group in self.groups_), default=1.0),
            tuple(group.base.names[i] for group in self.groups_
                  for i in group.estimate.unexcited))

    def estimated(self, arm: Arm, output: str) -> list[dict[str, Any]]:
        found = []
        for group in self.groups_:
            names = tuple(self.regressor.channels[i] for i in group.base.channels)
            found.append({
                'channels': list(names),
                'condition': float(group.estimate.condition),
                'residual_std': [float(np.sqrt(v)) for v in group.estimate.variances],
                **({} if group.constants is None else {'torque_constants': [
                    {'channel': name, 'value': float(value), 'relative_error': float(error)}
                    for name, value, error in zip(names, group.constants.values,
                                                  group.constants.relative_errors, strict=True)]}),
                'coefficients': [
                    {'name': name, 'column': self.regressor.columns[column],
                     'value': float(value), 'standard_error': float(error),
                     'unit': column_unit(arm, output, names, self.regressor.columns[column]),
                     'excited': k not in group.estimate.unexcited}
                    for k, (name, column, value, error) in enumerate(zip(
                        group.base.names, group.base.kept, group.estimate.parameters,
                        group.estimate.standard_errors, strict=True))]})
        return found

    def to_dict(self, arm: Arm, output: str) -> dict[str, Any]:
        self.coefficients()  # raises if there are none
        form = self.regressor.form
        return {'estimator': self.estimator, 'units': output_units(arm, output),
                **({} if form is None else {'form': form}),
                **({} if self.payload_range is None else
                   {'payload_range': [float(value) for value in self.payload_range]}),
                'groups': self.estimated(arm, output)}

    @classmethod
    def from_dict(cls, content: dict[str, Any], arm: Arm, output: str) -> AnalyticalModel:
        part = read(AnalyticalPart, content)
        regressor = regressor_of(arm, output, str(part.form), shared=part.shared,
                                 payloads=part.payload_range)
        return cls(regressor, len(arm.active_joints), estimator=part.estimator,
                   groups=groups_of(part.groups, regressor, arm, output))

    def _rows(self, blocks: Blocks) -> Iterable[tuple[FloatArray, FloatArray]]:
        """Give decimated rows with their outputs, few samples at a time; use before the next."""
        buffer: FloatArray | None = None
        for block in blocks():
            check_block(block, self.n_inputs, self.channels)
            if block.decimation is not None and block.decimation.sections is not None:
                # only what base parameters take of rows; the other columns are zero
                used = np.unique(np.concatenate([base.kept for base in self.base_]))
                found = block.decimation(self.regressor.rows(block.motion)[:, :, used])
                full = np.zeros((*found.shape[:2], len(self.regressor.columns)))
                full[:, :, used] = found
                yield full, block.output
                continue
            motion = block.motion if block.decimation is None else block.decimation(block.motion)
            for first in range(0, len(motion), ROWS_AT_A_TIME):
                part = slice(first, first + ROWS_AT_A_TIME)
                piece = motion[part]
                # one buffer for all pieces: fresh pages for each cost as much as filling them
                room = None if buffer is None or len(buffer) < len(piece) else buffer[:len(piece)]
                rows = self.regressor.rows(piece, room)
                buffer = rows if room is None else buffer
                yield rows, block.output[part]

    def _fit_weighted(self, blocks: Blocks, *, triangular: bool) -> None:
        estimator = ESTIMATORS[self.estimator]
        assert estimator.sample_weights is not None
        before = self.coefficients()
        for _ in range(WEIGHT_PASSES):
            residuals = np.vstack([
                output - np.einsum('kcp,cp->kc', rows, before)
                for rows, output in self._rows(blocks)])
            weights = np.column_stack([estimator.sample_weights(column) for column in residuals.T])
            self.fit_data([self.products(blocks, triangular=triangular, weights=weights)])
            after = self.coefficients()
            change = float(np.linalg.norm(after - before)
                           / max(float(np.linalg.norm(after)), 1e-300))
            before = after
            if change < 1e-6:
                return
        msg = (f'{estimator.words} has not settled after {WEIGHT_PASSES} passes '
               f'(last change {change:.1e}); its result is used as it is')
        warnings.warn(msg, TudorWarning, stacklevel=3)
