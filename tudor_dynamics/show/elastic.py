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
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator
import numpy as np

from tudor_dynamics.identification.elastic_problem import CLUSTER, HUBER, RUN_IN, Start
from tudor_dynamics.identification.elastic_search import EXCERPT, FACTORS, STARTS
from tudor_dynamics.identification.fit import FitResult
from tudor_dynamics.identification.ringdowns import (
    find_ringdowns, LEAST_SECONDS, mode_map, ModeMap, Ringdown)
from tudor_dynamics.models.elastic.model import driven_arm
from tudor_dynamics.models.regressor import output_units
from tudor_dynamics.models.settings import INNER_STEP
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


MOST_ROWS = 24
"""Ring-downs in the table; the figure has all."""
NOT_SHOWN = 'not shown by these bags'


def elastic_section(result: FitResult) -> dict[str, Any] | None:
    """Collect what `elastic.html.j2` shows of the elastic model; None where none was fitted."""
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
    return {
        'parameters': found.physical, 'described': described, 'not_shown': NOT_SHOWN,
        'payload': values['payload'], 'payloads': result.settings.payloads is not None,
        'gauges': list(zip(arm.gauge_names, found.gauges, found.gauge_errors, strict=True)),
        'units': output_units(arm, 'strain'),
        'modes': None if modes is None else mode_figure(
            modes, [(axes[i].name, axes[i].unit) for i in modes.joints], ringdowns),
        'ringdowns': len(ringdowns), 'strongest': strongest(ringdowns),
        'ringdown_figure': ringdown_figure(ringdowns) if ringdowns else None,
        'ringdown_summary': summary(ringdowns), 'shortest': LEAST_SECONDS,
        'starts': start_rows(found.starts), 'fit': found.fit, 'runs': found.runs,
        'settings': settings_text()}


def strongest(ringdowns: Sequence[Ringdown]) -> list[tuple[Ringdown, str, str]]:
    """List the ring-downs, of many the strongest, with bag and pose for people."""
    chosen = sorted(ringdowns, key=lambda r: -r.amplitude)[:MOST_ROWS]
    # rounded before it is written: no minus before zero
    return [(ring, Path(ring.bag).name, ', '.join(f'{round(x, 2) + 0.0:.2f}' for x in ring.q))
            for ring in ringdowns if ring in chosen]


def start_rows(starts: Sequence[Start]) -> list[tuple[Start, str, str]]:
    """List the starts of the search with their shares and notes, the best one marked."""
    rows = []
    best = max((start.fit for start in starts), default=0.0)
    for start in sorted(starts, key=lambda start: (start.share or 0.0, start.factor)):
        notes = ['best'] if start.fit == best else []
        if not FACTORS[0] * 1.01 < start.factor < FACTORS[-1] * 0.99:
            notes.append('at the edge of what was tried')
        share = 'as described' if start.share is None else f'{100.0 * start.share:g} %'
        rows.append((start, share, ', '.join(notes)))
    return rows


def summary(ringdowns: Sequence[Ringdown]) -> str:
    """Say how far prediction and measurement are apart; empty where nothing can be compared."""
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
    return f'In the median: {"; ".join(parts)}.' if parts else ''


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
