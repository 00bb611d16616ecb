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

"""Bodies as described and as identified, and loads that a model did not know of."""

from __future__ import annotations

import math
from typing import Any

from matplotlib.figure import Figure
import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.identification.fit import FitResult
from tudor_dynamics.load.offline import Leftover, PayloadEstimate
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.comparison import (
    body_row, described_bodies, described_parameters_of, full_parameters_of, relative_errors)
from tudor_dynamics.models.regressor import output_units
from tudor_dynamics.show.figures import (
    BLUE, label, new_cells, on_page, PAGE_MEASURED, thin)


def before_after(result: FitResult) -> dict[str, Any] | None:
    """
    Compare an arm as described with an arm as identified, for `before.html.j2`.

    Returns ``bodies``: both bodies of each joint, the standard error of the identified mass [kg],
    and how many of ten parameters the recordings fix; ``joints``: relative errors of effort [%] on
    motion that nothing was fitted to, by bodies as described with the drives that suit them best,
    by identified ones that can exist, and by base parameters; ``assumed``: whether torque is known
    up to a factor only, so that masses are not absolute.
    """
    arm = result.arm
    fitted = next((item for item in result.fitted
                   if (item.output, item.kind) == ('effort', 'analytical')), None)
    before = described_bodies(arm)
    if fitted is None or not any(body[0] > 0.0 for body in before.values()):
        return None
    models = [fitted.model, *(model for model, _ in fitted.validation.cases)]
    if len(models) < 2 or not all(isinstance(model, AnalyticalModel) and model.data_
                                  and model.payload_range is None for model in models):
        return None
    errors = np.zeros((3, len(arm.active_joints)))
    for model, data in fitted.validation.cases:
        assert isinstance(model, AnalyticalModel)
        own = result.blind or arm
        for kind, judged in enumerate((described_parameters_of(own, model).model,
                                       full_parameters_of(own, model).model, model)):
            # a joint that shows nothing in a bag has no part in the mean square
            found = np.nan_to_num(relative_errors(judged, data.stretches))
            errors[kind] += found ** 2 / (len(models) - 1)
    assert isinstance(fitted.model, AnalyticalModel)
    full = full_parameters_of(arm, fitted.model)
    sources, mass_errors = full.sources(), full.solution.body_errors[:, 0].tolist()
    return {
        'bodies': [(body_row(joint, (arm, arm), (before[joint], body)), mass_errors[place],
                    sources[10 * place:10 * (place + 1)].count('data'))
                   for place, (joint, body) in enumerate(full.bodies.items())],
        'joints': list(zip(arm.active_joints, (100.0 * np.sqrt(errors)).T.tolist(), strict=True)),
        'assumed': full.assumed}


WITH_LOAD: dict[str, Any] = {'color': BLUE, 'linewidth': 0.9, 'linestyle': '-'}
COLUMNS = 2
"""Channels beside each other."""


def load_values(load: PayloadEstimate) -> list[tuple[str, str, float, float]]:
    """List what is known of a load: name, unit, value, standard deviation."""
    if math.isnan(load.mass):
        found = [("Part of the arm's own moment", '%', 100.0 * load.relative,
                  100.0 * load.relative_std)]
    else:
        found = [('Mass beyond what the model knows', 'kg', load.mass - load.known,
                  load.mass_std)]
    found += [(f'Centre {axis}', 'm', float(value), float(std))
              for axis, value, std in zip('xyz', load.com, load.com_std, strict=True)]
    found += [(f'Inertia {axes}', 'kg m^2', float(value), float(std)) for axes, value, std in zip(
        ('xx', 'xy', 'yy', 'xz', 'yz', 'zz'), load.inertia, load.inertia_std, strict=True)]
    return [row for row in found if math.isfinite(row[2])]


def load_shares(arm: Arm, load: PayloadEstimate) -> list[tuple[str, str, float, float, float]]:
    """List channels: name, unit, residual (rms) without and with a load, its share [%]."""
    return [(name, output_units(arm, item.output)[name], float(before), float(after),
             100.0 * float(share))
            for item in load.outputs for name, before, after, share in zip(
                item.leftover.channels, *item.leftover.sizes(), item.leftover.shares(),
                strict=True)]


@on_page
def load_figure(arm: Arm, load: PayloadEstimate) -> Figure:
    """Draw the residual of each channel without and with the load."""
    panels: list[tuple[Leftover, int, str]] = []
    for item in load.outputs:
        units = output_units(arm, item.output)
        panels += [(item.leftover, place, units[name])
                   for place, name in enumerate(item.leftover.channels)]
    figure, cells = new_cells(len(panels), COLUMNS, 1.35, (0.45, 0.55), between=0.8)
    for one, (left, place, unit) in zip(cells, panels, strict=True):
        one.plot(*thin(left.t, left.before[:, place]), **PAGE_MEASURED, label='without the load')
        one.plot(*thin(left.t, left.after[:, place]), **WITH_LOAD, label='with the load')
        one.set_ylabel(label(left.channels[place], unit)).set_parse_math(False)
        one.set_xlabel('time [s]')
        one.margins(x=0.01)
    figure.legend(*cells[0].get_legend_handles_labels(), loc='upper right', ncol=2)
    return figure
