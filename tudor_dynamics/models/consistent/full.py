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

"""What a fitted model says of every body and drive, for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base_parameters import BaseSet
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.consistent.bodies import Prior, prior_of
from tudor_dynamics.models.consistent.problem import Solution
from tudor_dynamics.models.consistent.solve import full_of, solve_consistent, solve_drives
from tudor_dynamics.models.estimation.products import summed
from tudor_dynamics.models.estimation.torque_constants import Constants
from tudor_dynamics.models.regressor import EffortRegressor
from tudor_dynamics.models.storage.coefficients import Group
from tudor_dynamics.typing import FloatArray

FROM_DATA, FROM_BOTH = 0.3, 0.8
"""Standard error over that before any data, up to which a parameter comes from the data, or from
both."""


@dataclass(frozen=True, eq=False)
class FullParameters:
    """Parameters of every body and drive of an arm."""

    arm: Arm
    solution: Solution  # parameters, in the order of `model`'s columns, with their errors
    columns: tuple[str, ...]  # names of all parameters, bodies first
    model: AnalyticalModel  # the model of efforts that they make

    @property
    def bodies(self) -> dict[str, FloatArray]:
        """Mass, first moments, inertia about the joint, by the joint that moves a body."""
        names = list(self.arm.model.names)[1:]
        return dict(zip(names, self.solution.bodies, strict=True))

    @property
    def drives(self) -> dict[str, dict[str, float]]:
        """
        Give rotor inertia and friction of each joint in N m or N, by the names of their terms.

        Where a current's constant is not known, that which was found along with the bodies counts.
        """
        constants = dict(zip(self.model.channels, self.solution.constants.tolist(), strict=True))
        found: dict[str, dict[str, float]] = {name: {} for name in self.arm.active_joints}
        first = self.solution.bodies.size
        for column, value in zip(self.columns[first:], self.solution.drives.tolist(),
                                 strict=True):
            term, _, joint = column[:-1].partition('(')
            own = 1.0 if term in ('Ia', 'load') else constants[joint]
            found[joint][term] = value * own
        return found

    @property
    def torque_constants(self) -> dict[str, float]:
        """Torque for each unit of what is measured, by joint; 1 where that is torque [N m/A]."""
        return {joint.name: (joint.effort.torque_constant or 1.0) * float(constant)
                for joint, constant in zip(self.arm.joints, self.solution.constants, strict=True)}

    @property
    def assumed(self) -> bool:
        """Whether torque is known up to a factor only, for which masses as described stand."""
        return bool(np.all(self.solution.constant_errors > 0.0))

    def sources(self) -> list[str]:
        """Say of each parameter whether it comes from ``data``, ``description`` or ``both``."""
        errors = np.concatenate([self.solution.body_errors.ravel(), self.solution.drive_errors])
        widths = np.concatenate([self.solution.body_widths.ravel(), np.full(
            len(self.solution.drives), np.inf)])
        ratio = errors / widths
        return ['data' if r <= FROM_DATA else 'both' if r <= FROM_BOTH else 'description'
                for r in ratio.tolist()]


def full_parameters(bundle: ModelBundle, prior: Prior | None = None) -> FullParameters:
    """
    Find full parameters that can exist behind the effort model of a bundle.

    prior: from the description by default.
    """
    return full_parameters_of(bundle.arm, effort_model(bundle), prior)


def effort_model(bundle: ModelBundle) -> AnalyticalModel:
    """Find the model of efforts behind which there are full parameters."""
    model = bundle.models.get('effort', {}).get('analytical')
    if not isinstance(model, AnalyticalModel) or model.payload_range is not None:
        raise ModelError(
            'there is no analytical model of efforts for one payload in the bundle',
            remedy='fit one, from bags with efforts (tudor fit BAG --arm ARM.yaml --out MODEL)')
    if not model.data_:
        raise ModelError('the bundle has not kept what its bags came to',
                         remedy='fit the model again with this version')
    return model


def full_parameters_of(
    arm: Arm, model: AnalyticalModel, prior: Prior | None = None,
) -> FullParameters:
    """
    Find full parameters that can exist behind a model of efforts.

    prior: from the description by default.
    """
    return _full(arm, model, solve_consistent(arm, model, summed(model.data_.values()), prior))


def described_parameters_of(
    arm: Arm, model: AnalyticalModel, prior: Prior | None = None,
) -> FullParameters:
    """
    Take bodies as they are described, with the drives that suit them best.

    prior: those of the description by default.
    """
    return _full(arm, model, solve_drives(
        arm, model, summed(model.data_.values()), prior or prior_of(arm)))


def _full(arm: Arm, model: AnalyticalModel, solution: Solution) -> FullParameters:
    columns = model.regressor.columns
    return FullParameters(arm, solution, columns,
                          _model(model, solution, scaled_columns(arm, columns)))


def scaled_columns(arm: Arm, columns: Sequence[str]) -> NDArray[np.bool_]:
    """
    Say which parameters unknown torque constants divide, where there are such.

    Returns (columns,).
    """
    together = EffortRegressor(arm, shared=True)
    return together.scaled if together.unknown else np.zeros(len(columns), dtype=np.bool_)


def _model(
    model: AnalyticalModel, solution: Solution, scaled: NDArray[np.bool_],
) -> AnalyticalModel:
    """Give the model of efforts with full parameters in place of base parameters."""
    full = full_of(solution, scaled)
    groups = []
    for group in model.groups_:
        channels = list(group.base.channels)
        constants = None
        values = full[channels[0]]
        if group.constants is not None:
            constants = Constants(solution.constants[channels],
                                  solution.constant_errors[channels])
            values = np.concatenate([solution.bodies.ravel(), solution.drives])
        kept = np.flatnonzero(np.any(full[channels] != 0.0, axis=0))
        estimate = replace(group.estimate, parameters=values[kept], unexcited=(),
                           standard_errors=np.full(len(kept), np.nan))
        groups.append(Group(BaseSet(group.base.channels, kept, tuple(
            model.regressor.columns[i] for i in kept)), estimate, constants))
    made = AnalyticalModel(model.regressor, model.n_joints, estimator=model.estimator,
                           base=tuple(group.base for group in groups))
    made.groups_ = tuple(groups)
    return made
