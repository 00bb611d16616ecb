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

"""Figures of the report: style, signals over time, errors, coverage."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
import io
import math
import re
from typing import Any, ParamSpec

import matplotlib
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.identification.dataset import all_stretches, BagData
from tudor_dynamics.identification.fit import FitResult
from tudor_dynamics.identification.validation import Trace, Validation
from tudor_dynamics.models.kinds import KINDS
from tudor_dynamics.models.regressor import output_units
from tudor_dynamics.typing import FloatArray


P = ParamSpec('P')
LONGEST_NAME = 40
"""Characters of a name in a figure."""


def number(value: float, digits: int = 3) -> str:
    """Write a number for a reader."""
    if not math.isfinite(value):
        return 'n/a' if math.isnan(value) else ('∞' if value > 0 else '−∞')
    if value == 0.0:
        return '0'
    exponent = math.floor(math.log10(abs(float(f'{value:.{digits - 1}e}'))))
    if -4 <= exponent < 6:
        text = f'{value:.{max(0, digits - 1 - exponent)}f}'
    else:
        text = f'{value:.{digits - 1}e}'
    return text.replace('-', '−')


def pretty_unit(unit: str) -> str:
    """Write a unit as it is printed: µ, a dot between factors, raised exponents."""
    text = re.sub(r'\((\w)\)', r'\1', unit.replace('um/m', 'µm/m'))
    for plain, raised in (('^2', '²'), ('^(1/3)', '^⅓'), (' ', '·')):
        text = text.replace(plain, raised)
    return text


def pretty_name(name: str, longest: int = LONGEST_NAME) -> str:
    """Cut a name that would run out of a figure, and leave out what SVG cannot hold."""
    short = name if len(name) <= longest else name[:longest - 3] + '...'
    return ''.join(c if c.isprintable() else '?' for c in short)


# One style, on the page of a fit and for files of their own, in two sizes; drawn through
# matplotlib's object interface, without pyplot and its global state.
#
# Every series has a line style, width or marker of its own, so that prints in grey stay legible;
# the colours are those of Okabe and Ito, which colour-blind readers tell apart.

BLUE, VERMILION = '#0072b2', '#d55e00'

_COMMON: dict[str, Any] = {
    'axes.axisbelow': True, 'axes.grid': True, 'axes.spines.right': False,
    'axes.spines.top': False, 'axes.titlelocation': 'left', 'axes.titley': 1.0,  # not searched for
    'grid.color': '#dddddd', 'grid.linewidth': 0.6, 'legend.frameon': False, 'path.simplify': True,
    # ids come from the content alone, so that equal fits give equal files
    'svg.hashsalt': 'tudor_dynamics'}
PAGE: Any = {
    **_COMMON, 'font.family': 'sans-serif', 'font.sans-serif': ['DejaVu Sans', 'Verdana'],
    'font.size': 8.5, 'axes.titlesize': 9.0, 'axes.titleweight': 'bold',
    'axes.edgecolor': '#555555', 'axes.linewidth': 0.7, 'xtick.color': '#333333',
    'ytick.color': '#333333', 'path.simplify_threshold': 0.2,
    'svg.fonttype': 'none'}  # text stays text
"""For figures inside the report of a fit."""
PRINT: Any = {
    **_COMMON, 'font.size': 9.0, 'axes.titlesize': 9.5, 'axes.labelsize': 9.0,
    'legend.fontsize': 8.5, 'legend.handlelength': 2.8, 'xtick.labelsize': 8.5,
    'ytick.labelsize': 8.5, 'svg.fonttype': 'path'}
"""For figures that are files of their own, over two columns of a paper."""

PAGE_MEASURED: dict[str, Any] = {'color': '#a3a3a3', 'linewidth': 2.4, 'linestyle': '-',
                                 'solid_capstyle': 'round'}
PAGE_MODELS: dict[str, dict[str, Any]] = {
    'analytical': {'color': BLUE, 'linewidth': 1.0, 'linestyle': '-'},
    'elm': {'color': VERMILION, 'linewidth': 1.0, 'linestyle': (0, (3.5, 1.5))},
    'elastic': {'color': '#007a57', 'linewidth': 1.3, 'linestyle': (0, (1, 0.8))}}
OTHER: dict[str, Any] = {'color': '#7a4fa3', 'linewidth': 1.1, 'linestyle': (0, (6, 1.2))}
"""Of a kind that has no look of its own."""


def page_model(kind: str) -> dict[str, Any]:
    """Say how a kind of model is drawn on the page."""
    return PAGE_MODELS.get(kind, OTHER)


@contextmanager
def style(settings: Any) -> Iterator[None]:
    """Draw in one of the styles, whatever the user's matplotlibrc says."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(settings)
        yield


WIDTH = 8.2
"""Width of all figures [inch]; the page scales them to its column."""

METADATA = {'Date': None, 'Creator': None, 'Format': None, 'Type': None}


def label(name: str, unit: str = '') -> str:
    """Write a channel with its unit; unit: none if empty."""
    return f'{pretty_name(name)} [{pretty_unit(unit)}]' if unit else pretty_name(name)


def plain_text(setter: Any, text: str) -> None:
    """Set a text in which dollar signs are dollar signs: names are not ours."""
    setter(text).set_parse_math(False)


def to_uri(figure: Figure) -> str:
    """Write a figure as SVG into a data URI."""
    stream = io.BytesIO()
    # not savefig: it draws everything twice
    canvas: Any = FigureCanvasSVG(figure)
    canvas.print_svg(stream, metadata=METADATA)
    # a hundredth of a point is enough for a line, and half the size
    text = re.sub(rb' d="[^"]*"', lambda path: re.sub(rb'(\.\d\d)\d+', rb'\1', path[0]),
                  stream.getvalue())
    return 'data:image/svg+xml;base64,' + base64.b64encode(text).decode('ascii')


def on_page(draw: Callable[P, Figure]) -> Callable[P, str]:
    """Let a function that draws a figure give it for the page: in its style, as data URI."""
    @wraps(draw)
    def drawn(*args: P.args, **options: P.kwargs) -> str:
        with style(PAGE):
            return to_uri(draw(*args, **options))
    return drawn


def new_figure(
    columns: int, heights: Sequence[float], gaps: Sequence[float], *, between: float = 0.5,
) -> tuple[Figure, list[list[Any]]]:
    """Lay out a figure by lengths in inches; matplotlib's own layout is slow."""
    left, right, bottom = 0.75, 0.08, 0.45
    height = sum(heights) + sum(gaps) + bottom
    width = (WIDTH - left - right - between * (columns - 1)) / columns
    figure = Figure(figsize=(WIDTH, height))
    rows = []
    top = height
    for tall, gap in zip(heights, gaps, strict=True):
        top -= gap + tall
        begins = [left + k * (width + between) for k in range(columns)]
        rows.append([figure.add_axes(
            (begin / WIDTH, top / height, width / WIDTH, tall / height)) for begin in begins])
    return figure, rows


def new_cells(
    count: int, columns: int, tall: float, gaps: tuple[float, float], *, between: float = 0.5,
) -> tuple[Figure, list[Any]]:
    """Lay out cells row by row; gaps: above the first row, and above the others [inch]."""
    rows = -(-count // columns)
    figure, grid = new_figure(columns, [tall] * rows, [gaps[0]] + [gaps[1]] * (rows - 1),
                              between=between)
    cells = [axes for row in grid for axes in row]
    for axes in cells[count:]:
        axes.set_axis_off()
    return figure, cells[:count]


def legend_above(axes: Any, columns: int, *, right: bool = False, **more: Any) -> None:
    """Put a legend above axes."""
    axes.legend(loc='lower right' if right else 'lower left',
                bbox_to_anchor=(1.0 if right else 0.0, 1.0), ncol=columns, borderpad=0.1, **more)


MAX_POINTS = 2000
"""Points a line has at most; longer ones keep the extremes of each stretch of samples."""
SIGNAL_BINS = 60


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
    """Keep the extremes of each stretch of samples, and break the line at gaps."""
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
    legend_above(whole, 4, right=True)
    rest.set_title('Residual, measured - predicted')
    rest.set_xlabel('time [s]')
    detail.set_xlim(*stretch)
    detail.set_xlabel('time [s]')
    return figure


signal_figure = on_page(draw_signal)


@on_page
def error_figure(arm: Arm, output: str, judged: Mapping[str, Validation]) -> Figure:
    """Draw how the error of each channel is distributed over all validation bags."""
    channels, units = next(iter(judged.values())).channels, output_units(arm, output)
    figure, cells = new_cells(len(channels), min(len(channels), 3), 1.6, (0.5, 0.75))
    for i, (axes, name) in enumerate(zip(cells, channels, strict=True)):
        errors = {kind: np.concatenate([
            trace.measured[:, i] - trace.predicted[:, i] for trace in item.traces])
            for kind, item in judged.items()}
        bound = _reach(errors, 99.5)
        edges = np.linspace(-bound, bound, SIGNAL_BINS + 1)
        for kind, values in errors.items():
            # what lies beyond is counted in the outermost bins, not dropped
            share = np.histogram(np.clip(values, -bound, bound), edges)[0] / len(values)
            look = {key: page_model(kind)[key] for key in ('color', 'linestyle')}
            axes.stairs(100.0 * share, edges, linewidth=1.2, label=KINDS[kind].label,
                        fill=False, **look)
        axes.axvline(0.0, color='#555555', linewidth=0.6)
        axes.set_xlabel(label('error', units[name]))
        plain_text(axes.set_title, label(name))
        axes.set_ylim(bottom=0.0)
    cells[0].set_ylabel('share of samples [%]')
    handles, words = cells[0].get_legend_handles_labels()
    figure.legend(handles, words, loc='upper right', ncol=len(words), borderpad=0.1,
                  handlelength=1.6)
    return figure


DETAIL = 10.0
"""Length of the stretch shown in detail [s]."""
MAX_PAIRS = 3


def channel_series(
    arm: Arm, output: str, judged: Mapping[str, Validation],
) -> dict[str, ComparedSignal]:
    """Collect what the models of one output, by kind, say of the first validation bag."""
    first, units = next(iter(judged.values())), output_units(arm, output)
    t, measured = first.traces[0].t, first.traces[0].measured
    return {name: ComparedSignal(
        output, name, units[name], t, measured[:, i],
        {kind: item.traces[0].predicted[:, i] for kind, item in judged.items()})
        for i, name in enumerate(first.channels)}


def _speed(trace: Trace, data: Sequence[BagData]) -> FloatArray:
    """Squared speed over all joints at a trace's samples, each joint by its own spread."""
    for bag in sorted(data, key=lambda item: str(item.choice) != trace.bag):
        stamp = np.concatenate([s.stamp[s.decimation.keep] for s in bag.stretches])
        dq = np.vstack([s.states.dq[s.decimation.keep] for s in bag.stretches])
        # a part of a bag need not have been decimated to the same samples as the whole
        place = np.minimum(np.searchsorted(stamp, trace.stamp), len(stamp) - 1)
        if stamp[0] - 10**9 <= trace.stamp[0] and trace.stamp[-1] <= stamp[-1] + 10**9:
            spread = np.maximum(dq.std(axis=0), 1e-12)
            return np.sum((dq[place] / spread) ** 2, axis=1)
    return np.ones(len(trace.t))


def liveliest(trace: Trace, data: Sequence[BagData]) -> tuple[float, float]:
    """Find the stretch with the most motion [s]."""
    t = trace.t
    length = min(DETAIL, 0.5 * float(t[-1] - t[0]))
    total = np.concatenate([[0.0], np.cumsum(_speed(trace, data))])
    end = np.searchsorted(t, t + length)
    possible = t <= t[-1] - length
    best = int(np.argmax(np.where(possible, total[end] - total[:-1], -1.0)))
    return float(t[best]), float(t[best]) + length


def joint_axes(result: FitResult) -> list[JointPositions]:
    """Collect the positions of each joint at the samples used, in training and in validation."""
    training, test = _kept(result.training, 'q'), _kept(result.test, 'q')
    return [JointPositions(joint.name, 'm' if result.arm.is_prismatic(joint.name) else 'rad',
                           training[:, i], test[:, i] if len(test) else np.zeros(0))
            for i, joint in enumerate(result.arm.joints)]


def _kept(data: Sequence[BagData], signal: str) -> FloatArray:
    parts = [getattr(s.states, signal)[s.decimation.keep] for s in all_stretches(data)]
    return np.vstack(parts) if parts else np.zeros((0, 0))


def joint_pairs(axes: Sequence[JointPositions]) -> list[tuple[JointPositions, JointPositions]]:
    """Pair neighbours among the joints that move; their combinations matter most."""
    moving = [axis for axis in axes if np.ptp(axis.training) > 1e-3]
    return list(zip(moving, moving[1:], strict=False))[:MAX_PAIRS]


def coverage(result: FitResult) -> list[dict[str, Any]]:
    """
    Say where each joint has been and how fast, in training and, where there is a test bag, in it.

    The share of the validation samples ``outside`` the training range is in percent.
    """
    def peaks(data: Sequence[BagData], signal: str) -> list[float]:
        return np.max(np.abs(_kept(data, signal)), axis=0).tolist() if data else []

    rows = []
    for axis in joint_axes(result):
        low, high = float(axis.training.min()), float(axis.training.max())
        row: dict[str, Any] = {
            'joint': axis.name, 'unit': axis.unit, 'training': (low, high)}
        if len(axis.test):
            row['test'] = float(axis.test.min()), float(axis.test.max())
            row['outside'] = 100.0 * float(np.mean((axis.test < low) | (axis.test > high)))
        rows.append(row)
    for prefix, data in (('', result.training), ('test_', result.test)):
        for name, signal in (('speed', 'dq'), ('acceleration', 'ddq')):
            for row, peak in zip(rows, peaks(data, signal), strict=False):
                row[prefix + name] = peak
    return rows


COVERAGE_BINS = 40
MAX_DOTS = 700
"""Validation samples shown as dots, evenly chosen."""
TRAINING_COLOUR, TEST_COLOUR = '#b5b5b5', '#0072b2'


def _edges(axis: JointPositions) -> FloatArray:
    values = np.concatenate([axis.training, axis.test])
    low, high = float(values.min()), float(values.max())
    if high - low < 1e-9:
        low, high = low - 0.5, high + 0.5
    return np.linspace(low, high, COVERAGE_BINS + 1)


@on_page
def density_figure(joints: Sequence[JointPositions]) -> Figure:
    """Draw how often each position was visited."""
    figure, cells = new_cells(len(joints), min(len(joints), 3), 1.4, (0.3, 0.55))
    for axes, joint in zip(cells, joints, strict=True):
        edges = _edges(joint)
        share = np.histogram(joint.training, edges)[0] / len(joint.training)
        axes.stairs(100.0 * share, edges, fill=True, color=TRAINING_COLOUR, label='training')
        if len(joint.test):
            share = np.histogram(joint.test, edges)[0] / len(joint.test)
            axes.stairs(100.0 * share, edges, color=TEST_COLOUR, linewidth=1.2,
                        linestyle='--', label='validation')
        plain_text(axes.set_xlabel, label(joint.name, joint.unit))
    cells[0].set_ylabel('share of samples [%]')
    legend_above(cells[0], 2)
    return figure


@on_page
def pair_figure(pairs: Sequence[tuple[JointPositions, JointPositions]]) -> Figure:
    """Draw which combinations of two joints' positions were visited."""
    columns = max(len(pairs), 2)
    figure, cells = new_cells(len(pairs), columns, 2.9 if columns == 2 else 2.0, (0.3, 0.0),
                              between=0.75)
    for axes, (first, second) in zip(cells, pairs, strict=True):
        x, y = _edges(first), _edges(second)
        count = np.histogram2d(first.training, second.training, (x, y))[0]
        # from pale to mid grey: each cell visited shows, and dots stay visible on top
        shade = np.where(count > 0, np.log1p(count), np.nan).T
        axes.pcolormesh(x, y, shade, cmap='Greys', vmin=-0.4 * np.nanmax(shade),
                        vmax=1.7 * np.nanmax(shade), rasterized=True)
        if len(first.test):
            chosen = np.unique(np.linspace(0, len(first.test) - 1, MAX_DOTS).astype(int))
            axes.plot(first.test[chosen], second.test[chosen], linestyle='none', marker='o',
                      markersize=1.8, markeredgewidth=0.0, color=TEST_COLOUR, rasterized=True)
        axes.grid(visible=False)
        plain_text(axes.set_xlabel, label(first.name, first.unit))
        plain_text(axes.set_ylabel, label(second.name, second.unit))
    handles: list[Any] = [Patch(color=TRAINING_COLOUR, label='training')]
    if len(pairs[0][0].test):
        handles.append(Line2D([], [], linestyle='none', marker='o', markersize=3,
                              color=TEST_COLOUR, label='validation'))
    legend_above(cells[0], 2, handles=handles, handlelength=1.2)
    return figure
