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

"""A schedule of gains as a figure: what changes with the payload, and how much with the pose."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
import numpy as np

from tudor_dynamics.control.schedule import Schedule
from tudor_dynamics.report.figure import plain_text, write_figure
from tudor_dynamics.report.style import BLUE, PRINT, style, VERMILION
from tudor_dynamics.typing import FloatArray

LOOKS: tuple[dict[str, Any], ...] = (
    {'color': BLUE, 'linestyle': '-', 'marker': 'o'},
    {'color': VERMILION, 'linestyle': (0, (4, 1.6)), 'marker': 's'},
    {'color': '#111111', 'linestyle': (0, (1, 1.2)), 'marker': '^'})


def draw_schedule(schedule: Schedule, fixed: FloatArray) -> Figure:
    """
    Draw a schedule; to be called within a style.

    Parameters
    ----------
    schedule : Schedule
        Schedule to be drawn.
    fixed : ndarray of the grid's shape
        Damping ratios that fixed gains have.

    Returns
    -------
    Figure
        Four panels over the payload: median over the poses, and all of them as a band.

    """
    figure = Figure(figsize=(7.2, 5.0))
    axes = figure.subplots(2, 2, sharex=True)
    asked = schedule.content.damping_ratio
    panels = (
        ('frequency of the links [Hz]', [(f'mode {m}', schedule.column(f'frequency({m})'))
                                         for m in range(1, schedule.modes + 1)]),
        ('gain of the damper [rad/s per m/m]', [(joint, schedule.column(f'gain({joint})'))
                                                for joint in schedule.content.damped]),
        ('damping ratio, first mode', [('scheduled gains', schedule.column('reached')),
                                       ('fixed gains', fixed)]),
        ('position gain [1/s]', [('position loop', schedule.column('position_gain'))]))
    for axis, (label, series) in zip(axes.flat, panels, strict=True):
        for number, (name, values) in enumerate(series):
            look = LOOKS[number % len(LOOKS)]
            flat = values.reshape(len(schedule.payload), -1)
            grams = 1e3 * schedule.payload
            axis.plot(grams, np.median(flat, axis=1), linewidth=1.3, markersize=4,
                      label=name.replace('$', r'\$'), **look)
            axis.fill_between(grams, flat.min(axis=1), flat.max(axis=1), color=look['color'],
                              alpha=0.15, linewidth=0.0)
        axis.set_ylabel(label)
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


def write_schedule_figure(schedule: Schedule, fixed: FloatArray, path: Path) -> None:
    """Write the figure, whole or not at all."""
    with style(PRINT):
        write_figure(draw_schedule(schedule, fixed), path)
