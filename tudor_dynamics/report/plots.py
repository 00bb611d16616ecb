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

"""Figures of the report: signals over time, and errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.figure import Figure
import numpy as np

from tudor_dynamics.models.kinds import KINDS
from tudor_dynamics.report.figure import label, new_figure, plain_text, to_uri
from tudor_dynamics.report.style import PAGE, PAGE_MEASURED, page_model, style
from tudor_dynamics.report.wording import pretty_name
from tudor_dynamics.typing import FloatArray

MAX_POINTS = 2000
"""Points a line has at most; longer ones keep the extremes of each stretch of samples."""
BINS = 60


@dataclass(frozen=True, eq=False)
class ComparedSignal:
    """One channel of a bag with what the models say of it."""

    # Output, channel and its unit.
    output: str
    name: str
    unit: str
    t: FloatArray  # time since the start of the bag, (samples,) [s]
    measured: FloatArray  # measured output of the channel, (samples,)
    predicted: dict[str, FloatArray]  # prediction of each kind of model


@dataclass(frozen=True, eq=False)
class JointPositions:
    """One joint's positions, in training and in validation."""

    name: str
    unit: str
    # (samples,): positions; `test` is empty where there is no test bag.
    training: FloatArray
    test: FloatArray


def thin(t: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """
    Keep the extremes of each stretch of samples, and break the line at gaps.

    t (samples,) [s], x (samples,).
    """
    if len(t) > MAX_POINTS:
        parts = np.array_split(np.arange(len(t)), MAX_POINTS // 2)
        index = np.unique([k for part in parts
                           for k in (part[np.argmin(x[part])], part[np.argmax(x[part])])])
        t, x = t[index], x[index]
    if len(t) < 3:
        return t, x
    step = np.diff(t)
    breaks = np.flatnonzero(step > 8.0 * np.median(step)) + 1
    return np.insert(t, breaks, np.nan), np.insert(x, breaks, np.nan)


def _limit(axes: Any, reference: FloatArray, others: Sequence[FloatArray]) -> bool:
    """Scale by the measured signal; a model that runs away does not squash the rest."""
    low, high = float(np.min(reference)), float(np.max(reference))
    room = 0.5 * (high - low) or 1.0
    low_all = min([low, *(float(np.min(x)) for x in others)])
    high_all = max([high, *(float(np.max(x)) for x in others)])
    bottom, top = max(low_all, low - room), min(high_all, high + room)
    pad = 0.04 * (top - bottom) or 1.0
    axes.set_ylim(bottom - pad, top + pad)
    return low_all < low - room or high_all > high + room


def _reach(errors: dict[str, FloatArray], percentile: float) -> float:
    """Scale that shows nearly all errors, unless one model's are far larger than another's."""
    sizes = [float(np.percentile(np.abs(x), percentile)) for x in errors.values()]
    return min(max(sizes), 4.0 * min(sizes)) or max(sizes) or 1.0


def signal_figure(series: ComparedSignal, stretch: tuple[float, float]) -> str:
    """Draw a channel for the report: stretch [s]."""
    with style(PAGE):
        return to_uri(draw_signal(series, stretch))


def draw_signal(series: ComparedSignal, stretch: tuple[float, float]) -> Figure:
    """Draw measured against predicted, the residual, and a stretch in detail: stretch [s]."""
    # low enough for two on a printed page
    figure, grid = new_figure(1, [1.3, 0.8, 1.3], [0.3, 0.34, 0.66])
    whole, rest, detail = (row[0] for row in grid)
    rest.sharex(whole)
    window = (series.t >= stretch[0]) & (series.t <= stretch[1])
    for axes, part, title in (
            (whole, slice(None), f'{pretty_name(series.name, 20)}, whole bag'),
            (detail, window, 'Stretch with the most motion (shaded above)')):
        t, measured = series.t[part], series.measured[part]
        axes.plot(*thin(t, measured), label='measured', **PAGE_MEASURED)
        for kind, values in series.predicted.items():
            axes.plot(*thin(t, values[part]), label=KINDS[kind].label, **page_model(kind))
        if _limit(axes, measured, [values[part] for values in series.predicted.values()]):
            title += '; a prediction leaves the scale'
        plain_text(axes.set_title, title)
        axes.set_ylabel(label(series.output, series.unit))
    residuals = {kind: series.measured - values for kind, values in series.predicted.items()}
    for kind, values in residuals.items():
        rest.plot(*thin(series.t, values), **{**page_model(kind), 'linewidth': 0.8})
    rest.axhline(0.0, color='#555555', linewidth=0.6)
    bound = 1.1 * _reach(residuals, 99.8)
    rest.set_ylim(-bound, bound)
    rest.set_ylabel(label('residual', series.unit))
    for axes in (whole, rest):
        axes.axvspan(*stretch, color='#f0e442', alpha=0.25, linewidth=0)
    whole.set_xlim(float(series.t[0]), float(series.t[-1]))
    whole.tick_params(labelbottom=False)
    whole.legend(loc='lower right', bbox_to_anchor=(1.0, 1.0), ncol=4, borderpad=0.1)
    rest.set_title('Residual, measured - predicted')
    rest.set_xlabel('time [s]')
    detail.set_xlim(*stretch)
    detail.set_xlabel('time [s]')
    return figure


def error_figure(channels: Sequence[tuple[str, str, dict[str, FloatArray]]]) -> str:
    """Draw the distribution of the error of each channel."""
    columns = min(len(channels), 3)
    n_rows = -(-len(channels) // columns)
    with style(PAGE):
        figure, rows = new_figure(columns, [1.6] * n_rows, [0.5] + [0.75] * (n_rows - 1))
        cells = [axes for row in rows for axes in row]
        for axes in cells[len(channels):]:
            axes.set_axis_off()
        for axes, (name, unit, errors) in zip(cells, channels, strict=False):
            bound = _reach(errors, 99.5)
            edges = np.linspace(-bound, bound, BINS + 1)
            for kind, values in errors.items():
                # what lies beyond is counted in the outermost bins, not dropped
                share = np.histogram(np.clip(values, -bound, bound), edges)[0] / len(values)
                look = {key: page_model(kind)[key] for key in ('color', 'linestyle')}
                axes.stairs(100.0 * share, edges, linewidth=1.2, label=KINDS[kind].label,
                            fill=False, **look)
            axes.axvline(0.0, color='#555555', linewidth=0.6)
            axes.set_xlabel(label('error', unit))
            plain_text(axes.set_title, label(name))
            axes.set_ylim(bottom=0.0)
        cells[0].set_ylabel('share of samples [%]')
        handles, words = cells[0].get_legend_handles_labels()
        figure.legend(handles, words, loc='upper right', ncol=len(words), borderpad=0.1,
                      handlelength=1.6)
        return to_uri(figure)
