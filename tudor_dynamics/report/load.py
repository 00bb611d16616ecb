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

"""A load that a model did not know of: what became known of it, and what it explains."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

from matplotlib.figure import Figure

from tudor_dynamics.arm import Arm
from tudor_dynamics.models.units import output_units
from tudor_dynamics.payload.estimate import Leftover, PayloadEstimate
from tudor_dynamics.report.figure import label, new_figure, to_uri
from tudor_dynamics.report.plots import thin
from tudor_dynamics.report.style import BLUE, PAGE, PAGE_MEASURED, style

WITH_LOAD: dict[str, Any] = {'color': BLUE, 'linewidth': 0.9, 'linestyle': '-'}
COLUMNS = 2
"""Channels beside each other."""


@dataclass(frozen=True)
class LoadValue:
    """A value that became known."""

    name: str
    unit: str
    # Value with its standard deviation.
    value: float
    std: float


@dataclass(frozen=True)
class ChannelShare:
    """What a load explains of a channel."""

    # Output, its joint or gauge, and the unit of that.
    output: str
    channel: str
    unit: str
    # Root mean square of the residual without and with the load.
    before: float
    after: float
    share: float  # part of its squares that the load explains [%]


@dataclass(frozen=True, eq=False)
class LoadSection:
    """All that the page shows of a load."""

    bag: str  # bag that it was found in
    estimate: PayloadEstimate  # what is known of it
    values: tuple[LoadValue, ...]  # mass, centre and inertia, as far as they are shown
    channels: tuple[ChannelShare, ...]  # joints and gauges
    figure: str  # residuals without and with the load, as data URI


def load_section(arm: Arm, bag: str, told: PayloadEstimate) -> LoadSection:
    """Collect what the page shows of a load."""
    with style(PAGE):
        figure = to_uri(draw_load(arm, told))
    return LoadSection(bag, told, load_values(told), load_shares(arm, told), figure)


def load_values(told: PayloadEstimate) -> tuple[LoadValue, ...]:
    """List what is known of a load."""
    if math.isnan(told.mass):
        first = LoadValue("Part of the arm's own moment", '%', 100.0 * told.relative,
                          100.0 * told.relative_std)
    else:
        first = LoadValue('Mass beyond what the model knows', 'kg', told.mass - told.known,
                          told.mass_std)
    named = [(f'Centre {axis}', 'm', value, std)
             for axis, value, std in zip('xyz', told.com, told.com_std, strict=True)]
    named += [(f'Inertia {axes}', 'kg m^2', value, std) for axes, value, std in zip(
        ('xx', 'xy', 'yy', 'xz', 'yz', 'zz'), told.inertia, told.inertia_std, strict=True)]
    return (first, *(LoadValue(name, unit, float(value), float(std))
                     for name, unit, value, std in named if math.isfinite(value)))


def load_shares(arm: Arm, told: PayloadEstimate) -> tuple[ChannelShare, ...]:
    """Say what a load explains of each channel."""
    rows = []
    for item in told.outputs:
        left, units = item.leftover, output_units(arm, item.output)
        for name, before, after, share in zip(
                left.channels, *left.sizes(), left.shares(), strict=True):
            rows.append(ChannelShare(item.output, name, units[name], float(before), float(after),
                                     100.0 * float(share)))
    return tuple(rows)


def draw_load(arm: Arm, told: PayloadEstimate) -> Figure:
    """Draw what each channel leaves over without and with the load."""
    panels: list[tuple[Leftover, int, str]] = []
    for item in told.outputs:
        units = output_units(arm, item.output)
        panels += [(item.leftover, place, units[name])
                   for place, name in enumerate(item.leftover.channels)]
    rows = -(-len(panels) // COLUMNS)
    figure, axes = new_figure(COLUMNS, [1.35] * rows, [0.45] + [0.55] * (rows - 1), between=0.8)
    flat = [one for row in axes for one in row]
    for one, (left, place, unit) in zip(flat, panels, strict=False):
        one.plot(*thin(left.t, left.before[:, place]), **PAGE_MEASURED, label='without the load')
        one.plot(*thin(left.t, left.after[:, place]), **WITH_LOAD, label='with the load')
        one.set_ylabel(label(left.channels[place], unit)).set_parse_math(False)
        one.set_xlabel('time [s]')
        one.margins(x=0.01)
    for one in flat[len(panels):]:
        one.set_visible(False)
    figure.legend(*flat[0].get_legend_handles_labels(), loc='upper right', ncol=2)
    return figure
