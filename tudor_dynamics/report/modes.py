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

"""Figures of the report on an elastic arm: modes over the poses, ring-downs against the model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib
from matplotlib.colors import BoundaryNorm
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator
import numpy as np

from tudor_dynamics.identification.elastic.modes import ModeMap
from tudor_dynamics.identification.elastic.ringdowns import Ringdown
from tudor_dynamics.report.figure import label, new_figure, plain_text, to_uri
from tudor_dynamics.report.style import PAGE, style
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
    with style(PAGE):
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
            handle = Line2D([], [], linestyle='none', marker='o', markersize=5,
                            markerfacecolor='white', markeredgecolor='black',
                            label='ring-down measured here')
            figure.legend(handles=[handle], loc='upper right', borderpad=0.1)
        return to_uri(figure)


def _mark(axes: Any, places: Sequence[tuple[float, float]]) -> None:
    if places:
        axes.plot(*np.array(places).T, linestyle='none', marker='o', markersize=4.5,
                  markerfacecolor='white', markeredgecolor='black', markeredgewidth=0.9)


def _lines(found: ModeMap, name: tuple[str, str], ringdowns: Sequence[Ringdown]) -> str:
    """Draw the modes over one joint, with the ring-downs measured."""
    middle = 0.5 * (found.edges[0][1:] + found.edges[0][:-1])
    with style(PAGE):
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
            handles.append(Line2D([], [], linestyle='none', marker='o', markersize=5,
                                  markerfacecolor='white', markeredgecolor='black',
                                  label='ring-down measured'))
        rows[0][0].legend(handles=handles, loc='lower left', bbox_to_anchor=(0.0, 1.0), ncol=3,
                          borderpad=0.1)
        return to_uri(figure)


def _logarithmic(axes: Any, low: float, high: float) -> None:
    """Scale both axes by factors, with the numbers that fall into the range."""
    ticks = [x for x in STEPS if low / 1.2 <= x <= 1.2 * high]
    axes.set_xscale('log')
    axes.set_yscale('log')
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(FixedLocator(ticks))
        axis.set_major_formatter(FuncFormatter(lambda x, _: f'{x:.4g}'))
        axis.set_minor_locator(NullLocator())


def ringdown_figure(ringdowns: Sequence[Ringdown]) -> str:
    """Draw predicted against measured ring-downs."""
    looks: tuple[tuple[str, str, dict[str, Any]], ...] = (
        ('held', 'joints held', {'marker': 'o', 'markerfacecolor': 'none',
                                 'markeredgecolor': '#0072b2', 'markersize': 5.5}),
        ('simulated', 'along the measured motion', {
            'marker': 'x', 'markeredgecolor': '#d55e00', 'markersize': 5.5}))
    with style(PAGE):
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
        rows[0][0].legend(loc='lower left', bbox_to_anchor=(0.0, 1.0), ncol=3, borderpad=0.1)
        return to_uri(figure)
