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

"""Pictures of events, rates, schedules and planned motion."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, ParamSpec

from matplotlib.figure import Figure
from matplotlib.style import context
import numpy as np

from tudor_dynamics.arm.limits import Limits
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.control.schedule import Schedule
from tudor_dynamics.files import write_figure
from tudor_dynamics.show.figures import Plot
from tudor_dynamics.signals.motion_profile import states
from tudor_dynamics.typing import FloatArray


# -- One style for files of their own, over two columns of a paper; drawn through matplotlib's
# object interface, without pyplot and its global state.
#
# Every series has a line style, width or marker of its own, so that prints in grey stay legible;
# the colours are those of Okabe and Ito, which colour-blind readers tell apart.

P = ParamSpec('P')
BLUE, VERMILION = '#0072b2', '#d55e00'
PRINT: Any = {
    'axes.axisbelow': True, 'axes.grid': True, 'axes.spines.right': False,
    'axes.spines.top': False, 'axes.titlelocation': 'left', 'axes.titley': 1.0,  # not searched for
    'grid.color': '#dddddd', 'grid.linewidth': 0.6, 'legend.frameon': False, 'path.simplify': True,
    # ids come from the content alone, so that equal fits give equal files
    'svg.hashsalt': 'tudor_dynamics', 'font.size': 9.0, 'axes.titlesize': 9.5,
    'axes.labelsize': 9.0, 'legend.fontsize': 8.5, 'legend.handlelength': 2.8,
    'xtick.labelsize': 8.5, 'ytick.labelsize': 8.5, 'svg.fonttype': 'path'}
LINES: dict[str, dict[str, Any]] = {
    'measured': {'color': '#a3a3a3', 'linewidth': 2.4},
    'analytical': {'color': BLUE, 'linewidth': 1.0},
    'elm': {'color': VERMILION, 'linewidth': 1.0, 'linestyle': (0, (3.5, 1.5))},
    'elastic': {'color': '#007a57', 'linewidth': 1.3, 'linestyle': (0, (1, 0.8))}}
OTHER: dict[str, Any] = {'color': '#7a4fa3', 'linewidth': 1.1, 'linestyle': (0, (6, 1.2))}
"""Of a look that is not among these."""


def style() -> AbstractContextManager[None]:
    """Draw in that style, whatever the user's matplotlibrc says."""
    return context(PRINT, after_reset=True)


def plain_text(setter: Any, text: str) -> None:
    """Set a text in which dollar signs are dollar signs: names are not ours."""
    setter(text).set_parse_math(False)


# -- Figures of a page, as files

SUFFIXES = ('.png', '.svg', '.pdf')


def draw(plot: Plot) -> Figure:
    """Draw the signals of a page's figure, panels below each other; to be called in a style."""
    panels = plot['panels']
    heights = [panel.get('height', 190) / 110.0 for panel in panels]
    figure = Figure(figsize=(7.2, 0.6 + sum(heights)), layout='constrained')
    rows = figure.subplots(len(panels), 1, squeeze=False, height_ratios=heights)[:, 0]
    for axes, panel in zip(rows, panels, strict=True):
        for item in panel['traces']:
            axes.plot(item['x'], item['y'], **LINES.get(item['look'], OTHER), label=item['name'])
        axes.axvspan(*plot['stretch'], color='#f0e442', alpha=0.25, linewidth=0)
        axes.set(ylim=panel['ylim'])
        for setter, text in ((axes.set_title, panel['title']), (axes.set_xlabel, panel['xlabel']),
                             (axes.set_ylabel, panel['ylabel'])):
            plain_text(setter, text)
    handles, names = rows[0].get_legend_handles_labels()
    if len(names) > 1:
        for text in figure.legend(handles, names, loc='outside upper right', ncols=3).get_texts():
            text.set_parse_math(False)
    return figure


def write_picture(
    path: Path, draw: Callable[P, Figure], *args: P.args, **options: P.kwargs,
) -> None:
    """Draw in the style of figures that are files of their own; written whole or not at all."""
    with style():
        write_figure(draw(*args, **options), path)


# -- A schedule of gains as a figure: what changes with the payload, and how much with the pose

LOOKS: tuple[dict[str, Any], ...] = (
    {'color': BLUE, 'linestyle': '-', 'marker': 'o'},
    {'color': VERMILION, 'linestyle': (0, (4, 1.6)), 'marker': 's'},
    {'color': '#111111', 'linestyle': (0, (1, 1.2)), 'marker': '^'})


def draw_schedule(schedule: Schedule, fixed: FloatArray) -> Figure:
    """Draw a schedule, and the damping ratios of fixed gains on its grid; within a style."""
    figure = Figure(figsize=(7.2, 5.0))
    axes = figure.subplots(2, 2, sharex=True)
    asked = schedule.content.damping_ratio
    panels = (
        ('frequency of the links [Hz]', [(f'mode {m}', schedule.column(f'frequency({m})'))
                                         for m in range(1, schedule.modes + 1)]),
        ('damper gain [rad/s per m/m]', [(joint, schedule.column(f'gain({joint})'))
                                         for joint in schedule.content.damped]),
        ('damping ratio, first mode', [('scheduled gains', schedule.column('reached')),
                                       ('fixed gains', fixed)]),
        ('position gain [1/s]', [('position loop', schedule.column('position_gain'))]))
    for axis, (title, series) in zip(axes.flat, panels, strict=True):
        for number, (name, values) in enumerate(series):
            look = LOOKS[number % len(LOOKS)]
            flat = values.reshape(len(schedule.payload), -1)
            grams = 1e3 * schedule.payload
            axis.plot(grams, np.median(flat, axis=1), linewidth=1.3, markersize=4,
                      label=name.replace('$', r'\$'), **look)
            axis.fill_between(grams, flat.min(axis=1), flat.max(axis=1), color=look['color'],
                              alpha=0.15, linewidth=0.0)
        axis.set_ylabel(title)
        axis.set_ylim(bottom=0.0)
        axis.legend(loc='best')
    axes[1, 0].set_ylim(0.0, max(1.3 * asked, 1.1 * float(fixed.max())))
    axes[1, 0].axhspan(0.8 * asked, 1.2 * asked, facecolor='none', edgecolor='#777777',
                       hatch='///', linewidth=0.0, alpha=0.5)
    for axis in axes[1]:
        axis.set_xlabel('payload [g]')
    plain_text(figure.suptitle, f'{schedule.content.arm}: damping ratio {asked:g} at a delay of '
               f'{1e3 * schedule.content.delay:g} ms; bands: all poses, hatched: 20 %')
    figure.tight_layout()
    return figure


SHOWN = 20.0  # samples a second that are drawn [Hz]


def draw_motion(
    trajectory: Trajectory, bounds: Limits, limits: Limits, units: dict[str, str],
) -> Figure:
    """Draw a motion; to be called within a style."""
    names = trajectory.joints
    _, dq, ddq = np.split(states(trajectory), 3, axis=1)
    figure = Figure(figsize=(7.2, 0.6 + 1.25 * len(names)))
    axes = figure.subplots(len(names), 2, sharex=True, squeeze=False,
                           gridspec_kw={'width_ratios': (1.0, 1.6)})
    every = max(int(round(1.0 / (SHOWN * float(np.median(np.diff(trajectory.t)))))), 1)
    t = trajectory.t[::every]
    for j, (name, (left, right)) in enumerate(zip(names, axes, strict=True)):
        left.plot(t, trajectory.q[::every, j], color='#111111', linewidth=1.0)
        for limit in (bounds.lower[j], bounds.upper[j]):
            left.axhline(limit, color='#777777', linewidth=0.9, linestyle=(0, (4, 2)))
        plain_text(left.set_ylabel, f'{name} [{units[name]}]')
        for look, values, what in (
                (LOOKS[0], dq[::every, j] / limits.velocity[j], 'speed'),
                (LOOKS[1], ddq[::every, j] / limits.acceleration[j], 'acceleration')):
            right.plot(t, values, color=look['color'], linestyle=look['linestyle'],
                       linewidth=1.0, label=what)
        right.set_ylim(-1.15, 1.15)
        right.set_yticks((-1.0, 0.0, 1.0))
    axes[0, 0].set_title('position, and its limits (dashed)')
    axes[0, 1].set_title('in parts of the limits')
    axes[0, 1].legend(loc='lower right', bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.0)
    for axis in axes[-1]:
        axis.set_xlabel('time [s]')
    figure.tight_layout()
    return figure
