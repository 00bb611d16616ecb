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

"""The report's section on the elastic model, with its modes and ring-downs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator
import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.identification.elastic_problem import CLUSTER, HUBER, Identified, RUN_IN, Start
from tudor_dynamics.identification.elastic_search import EXCERPT, FACTORS, STARTS
from tudor_dynamics.identification.fit import FitResult
from tudor_dynamics.identification.ringdowns import (
    find_ringdowns, LEAST_SECONDS, mode_map, ModeMap, Ringdown)
from tudor_dynamics.models.elastic.arm import INNER_STEP
from tudor_dynamics.models.elastic.model import driven_arm, PhysicalParameter
from tudor_dynamics.models.elastic.parameters import in_words
from tudor_dynamics.models.regressor import output_units
from tudor_dynamics.show.figures import (
    joint_axes, label, legend_above, new_figure, on_page, plain_text)
from tudor_dynamics.typing import FloatArray


COLOURS = 'cividis_r'
"""From pale to dark in grey as well, and for colour-blind readers."""
WIDE = 4.0
"""Ratio of largest to smallest from which levels are steps of a factor, not of a difference."""
STEPS = np.outer(10.0 ** np.arange(-4, 5), [1.0, 1.5, 2.0, 3.0, 5.0, 7.0]).ravel()
ORDINAL = ('First', 'Second')
LOOKS: tuple[dict[str, Any], ...] = (
    {'color': '#0072b2', 'linestyle': '-', 'marker': 'o', 'markersize': 2.5},
    {'color': '#d55e00', 'linestyle': '--', 'marker': 's', 'markersize': 2.5})
BAR, ROOM = 0.12, 0.62
"""Width of a colour bar, and of what it needs in all [inch]."""


def levels(values: FloatArray) -> FloatArray:
    """Choose round levels for the shades of a map; returns (levels,)."""
    known = values[np.isfinite(values)]
    if known.size == 0:
        return np.array([0.0, 1.0])
    low, high = float(known.min()), float(known.max())
    if low > STEPS[0] and high < STEPS[-1] and high > WIDE * low:
        first = int(np.searchsorted(STEPS, low, side='right')) - 1
        last = int(np.searchsorted(STEPS, high, side='left'))
        chosen = STEPS[first:last + 1]
        return np.asarray(chosen if len(chosen) <= 10 else
                          np.unique(np.append(chosen[::2], chosen[-1])))
    return np.asarray(MaxNLocator(7).tick_values(low, max(high, low + 1e-6)))


def mode_figure(
    found: ModeMap, axes_labels: Sequence[tuple[str, str]], ringdowns: Sequence[Ringdown],
) -> str:
    """Draw frequency and damping ratio of the first modes over the poses."""
    if len(found.joints) == 1:
        return _lines(found, axes_labels[0], ringdowns)
    return _maps(found, axes_labels, ringdowns)


@on_page
def _maps(
    found: ModeMap, axes_labels: Sequence[tuple[str, str]], ringdowns: Sequence[Ringdown],
) -> Figure:
    """Draw the modes over two joints."""
    figure, rows = new_figure(2, [2.1, 2.1], [0.45, 0.75], between=0.65)
    for k, row in enumerate(rows):
        for axes, values, title in ((row[0], found.frequency[k], 'frequency [Hz]'),
                                    (row[1], 100.0 * found.damping[k], 'damping ratio [%]')):
            steps = levels(values)
            box = axes.get_position()
            wide = ROOM / figure.get_figwidth()
            axes.set_position((box.x0, box.y0, box.width - wide, box.height))
            bar = figure.add_axes((box.x1 - 0.85 * wide, box.y0,
                                   BAR / figure.get_figwidth(), box.height))
            shades = matplotlib.colormaps[COLOURS].resampled(len(steps) - 1)
            mesh = axes.pcolormesh(
                *found.edges, np.ma.masked_invalid(values.T), cmap=shades,
                norm=BoundaryNorm(steps, shades.N), rasterized=True)
            # a bar of equal shades, whatever the steps between them
            figure.colorbar(mesh, cax=bar, spacing='uniform', ticks=steps,
                            format=FuncFormatter(lambda x, _: f'{x:.4g}'))
            bar.grid(visible=False)
            _mark(axes, [(r.q[found.joints[0]], r.q[found.joints[1]]) for r in ringdowns])
            axes.grid(visible=False)
            axes.set_title(f'{ORDINAL[k]} mode: {title}')
            plain_text(axes.set_xlabel, label(*axes_labels[0]))
            plain_text(axes.set_ylabel, label(*axes_labels[1]))
    if ringdowns:
        figure.legend(handles=[_handle('ring-down measured here')], loc='upper right',
                      borderpad=0.1)
    return figure


def _handle(words: str) -> Line2D:
    return Line2D([], [], linestyle='none', marker='o', markersize=5, markerfacecolor='white',
                  markeredgecolor='black', label=words)


def _mark(axes: Any, places: Sequence[tuple[float, float]]) -> None:
    if places:
        axes.plot(*np.array(places).T, linestyle='none', marker='o', markersize=4.5,
                  markerfacecolor='white', markeredgecolor='black', markeredgewidth=0.9)


@on_page
def _lines(found: ModeMap, name: tuple[str, str], ringdowns: Sequence[Ringdown]) -> Figure:
    """Draw the modes over one joint, with the ring-downs measured."""
    middle = 0.5 * (found.edges[0][1:] + found.edges[0][:-1])
    figure, rows = new_figure(2, [1.9], [0.45], between=0.75)
    for axes, values, title in (
            (rows[0][0], found.frequency, 'frequency [Hz]'),
            (rows[0][1], 100.0 * found.damping, 'damping ratio [%]')):
        for k, row in enumerate(values):
            axes.plot(middle, row, label=f'{ORDINAL[k].lower()} mode', linewidth=1.0,
                      **LOOKS[k])
        _mark(axes, [(r.q[found.joints[0]], r.measured.frequency if values is found.frequency
                      else 100.0 * r.measured.damping) for r in ringdowns])
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel(title)
        plain_text(axes.set_xlabel, label(*name))
    handles = rows[0][0].get_legend_handles_labels()[0]
    if ringdowns:
        handles.append(_handle('ring-down measured'))
    legend_above(rows[0][0], 3, handles=handles)
    return figure


def _logarithmic(axes: Any, low: float, high: float) -> None:
    """Scale both axes by factors, with the numbers that fall into the range."""
    ticks = [x for x in STEPS if low / 1.2 <= x <= 1.2 * high]
    axes.set_xscale('log')
    axes.set_yscale('log')
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(FixedLocator(ticks))
        axis.set_major_formatter(FuncFormatter(lambda x, _: f'{x:.4g}'))
        axis.set_minor_locator(NullLocator())


@on_page
def ringdown_figure(ringdowns: Sequence[Ringdown]) -> Figure:
    """Draw predicted against measured ring-downs."""
    looks: tuple[tuple[str, str, dict[str, Any]], ...] = (
        ('held', 'joints held', {'marker': 'o', 'markerfacecolor': 'none',
                                 'markeredgecolor': '#0072b2', 'markersize': 5.5}),
        ('simulated', 'along the measured motion', {
            'marker': 'x', 'markeredgecolor': '#d55e00', 'markersize': 5.5}))
    figure, rows = new_figure(2, [2.4], [0.4], between=0.75)
    for axes, what, scale, title in (
            (rows[0][0], 'frequency', 1.0, 'frequency [Hz]'),
            (rows[0][1], 'damping', 100.0, 'damping ratio [%]')):
        every = [scale * getattr(r.measured, what) for r in ringdowns]
        for name, words, look in looks:
            pairs = np.array([
                (scale * getattr(r.measured, what), scale * getattr(getattr(r, name), what))
                for r in ringdowns if getattr(r, name) is not None]).reshape(-1, 2)
            axes.plot(*pairs.T, linestyle='none', label=words, **look)
            every += list(pairs[:, 1])
        low, high = min(every), max(every)
        pad = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
        ends = (low - pad, high + pad)
        if low > 0.0 and high > WIDE * low:
            ends = (low / 1.2, high * 1.2)
            _logarithmic(axes, low, high)
        axes.plot(ends, ends, color='#555555', linewidth=0.8, label='as measured')
        axes.set_xlim(*ends)
        axes.set_ylim(*ends)
        axes.set_xlabel(f'measured {title}')
        axes.set_ylabel(f'model: {title}')
    legend_above(rows[0][0], 3)
    return figure


# -- Rows and section of the elastic arm, as the page takes them

@dataclass(frozen=True)
class ParameterRow:
    """A physical parameter; ``described`` is what the arm description says of it."""

    name: str
    symbol: str  # name as the bundle has it
    value: float  # identified value, in its unit
    unit: str  # unit of the value
    standard_error: float  # standard deviation, in the same unit
    described: float  # what the arm description says, in the same unit
    note: str  # what is odd about it


@dataclass(frozen=True)
class GaugeRow:
    """Gain and offset of a gauge, with their standard deviations."""

    name: str
    gain: float  # reading per bending moment, in the unit below
    gain_error: float  # its standard deviation
    gain_unit: str
    offset: float  # reading without load, in the unit of the gauge
    offset_error: float  # its standard deviation
    unit: str


@dataclass(frozen=True)
class StartRow:
    """A stiffness that the search began with; ``fit`` in percent, on the pieces compared."""

    factor: float  # factor on the stiffness
    share: str  # what the gears have of the compliance, in words
    fit: float  # fit on the pieces compared [%]
    note: str  # what became of it


@dataclass(frozen=True)
class RingRow:
    """A ring-down with its bag and pose as the page writes them."""

    bag: str  # bag as the page writes it
    pose: str  # pose as the page writes it
    unit: str  # unit of the amplitude
    ring: Ringdown  # ring-down that was measured and predicted


@dataclass(frozen=True, eq=False)
class ElasticSection:
    """All that the page shows of the elastic arm; figures as data URI."""

    parameters: tuple[ParameterRow, ...]  # physical parameters of the arm
    payload: float  # mass at the tip that was identified or given [kg]
    payloads: bool  # whether the model is of all payloads
    gauges: tuple[GaugeRow, ...]  # gain and offset of each gauge
    modes: str | None  # figure of the modes as data URI
    ringdowns: int  # number of ring-downs in all bags
    ringdown_rows: tuple[RingRow, ...]  # ring-downs that the table shows
    ringdown_figure: str | None  # figure of the ring-downs as data URI
    ringdown_summary: str  # how well they are predicted, in words
    shortest: float  # shortest standstill that counts [s]
    starts: tuple[StartRow, ...]  # starts of the search
    fit: float  # fit on the training bags [%]
    runs: int  # simulations done in all
    settings: str  # how it was identified, in words


# -- The report's section on the elastic model: what the bags say of the arm's physics

MOST_ROWS = 24
"""Ring-downs in the table; the figure has all."""
NOT_SHOWN = 'not shown by these bags'


def elastic_section(result: FitResult) -> ElasticSection | None:
    """
    Collect what the page shows of the elastic model.

    Returns None where no elastic model was fitted.
    """
    found, arm = result.elastic, result.arm
    if found is None:
        return None
    values = {p.name: p.value for p in found.physical}
    described = dict(driven_arm(arm, {}).parameters)
    if 'payload' not in values:
        values['payload'] = result.training[0].payload or 0.0
    driven = driven_arm(arm, values)
    axes = joint_axes(result)
    modes = mode_map(driven, np.column_stack([axis.training for axis in axes]))
    bags = [bag for bag in (*result.training, *result.test) if bag.has('strain')]
    ringdowns = find_ringdowns(driven, values, bags)
    units = output_units(arm, 'strain')
    return ElasticSection(
        tuple(_parameter(p, described[p.name]) for p in found.physical), values['payload'],
        result.settings.payloads is not None, gauge_rows(arm, found, units),
        None if modes is None else mode_figure(
            modes, [(axes[i].name, axes[i].unit) for i in modes.joints], ringdowns),
        len(ringdowns), ring_rows(ringdowns, units),
        ringdown_figure(ringdowns) if ringdowns else None, summary(ringdowns), LEAST_SECONDS,
        start_rows(found.starts), found.fit, found.runs, settings_text())


def _parameter(parameter: PhysicalParameter, described: float) -> ParameterRow:
    return ParameterRow(
        in_words(parameter.name), parameter.name, parameter.value, parameter.unit,
        parameter.standard_error, described, '' if parameter.shown else NOT_SHOWN)


def gauge_rows(
    arm: Arm, found: Identified, units: dict[str, str],
) -> tuple[GaugeRow, ...]:
    """List gains and offsets."""
    return tuple(
        GaugeRow(name, float(value[0]), float(error[0]), f'({units[name]})/(N m)',
                 float(value[1]), float(error[1]), units[name])
        for name, value, error in
        zip(arm.gauge_names, found.gauges, found.gauge_errors, strict=True))


def ring_rows(ringdowns: Sequence[Ringdown], units: dict[str, str]) -> tuple[RingRow, ...]:
    """List the ring-downs, of many the strongest."""
    strongest = sorted(ringdowns, key=lambda r: -r.amplitude)[:MOST_ROWS]
    return tuple(
        # rounded before it is written: no minus before zero
        RingRow(Path(ring.bag).name, ', '.join(f'{round(x, 2) + 0.0:.2f}' for x in ring.q),
                units[ring.gauge], ring)
        for ring in ringdowns if ring in strongest)


def start_rows(starts: Sequence[Start]) -> tuple[StartRow, ...]:
    """List the starts of the search, the best one marked."""
    rows = []
    best = max((start.fit for start in starts), default=0.0)
    for start in sorted(starts, key=lambda start: (start.share or 0.0, start.factor)):
        notes = ['best'] if start.fit == best else []
        if not FACTORS[0] * 1.01 < start.factor < FACTORS[-1] * 0.99:
            notes.append('at the edge of what was tried')
        share = 'as described' if start.share is None else f'{100.0 * start.share:g} %'
        rows.append(StartRow(start.factor, share, start.fit, ', '.join(notes)))
    return tuple(rows)


def summary(ringdowns: Sequence[Ringdown]) -> str:
    """
    Say in a sentence how far prediction and measurement are apart.

    Returns an empty string where there is nothing to compare.
    """
    parts = []
    for name, words in (('held', 'joints held'), ('simulated', 'along the measured motion')):
        pairs = [(r.measured, getattr(r, name)) for r in ringdowns
                 if getattr(r, name) is not None]
        if not pairs:
            continue
        frequency = np.median([abs(b.frequency / a.frequency - 1.0) for a, b in pairs])
        damping = np.median([b.damping - a.damping for a, b in pairs])
        sign = 'more' if damping > 0.0 else 'less'
        parts.append(f'{words} ({len(pairs)} of {len(ringdowns)}), the frequency is off by '
                     f'{100.0 * frequency:.1f} % and the damping ratio {sign} than measured by '
                     f'{100.0 * abs(damping):.2g} percentage points')
    if not parts:
        return ''
    text = 'In the median: ' + '; '.join(parts) + '.'
    return text


def settings_text() -> str:
    """Describe how the elastic model is searched."""
    low, high = FACTORS[0], FACTORS[-1]
    return (f'robust least squares on simulated against measured strain (Huber, from '
            f'{HUBER:g} standard deviations); {len(FACTORS)} stiffnesses from '
            f'{low:.2g} to {high:.2g} times the description tried on up to {EXCERPT:g} s, '
            f'with {len(STARTS)} shares of the gears in the compliance, the best '
            f'{sum(STARTS.values())} improved, two of them searched from; inner step '
            f'{1e3 * INNER_STEP:g} ms; {RUN_IN:g} s left out where a stretch begins in motion '
            f'without its past; standard errors from clusters of {CLUSTER:g} s')
