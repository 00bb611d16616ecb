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

"""Figures of the report that show where the joints have been: in training, in validation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.lines import Line2D
from matplotlib.patches import Patch
import numpy as np

from tudor_dynamics.report.figure import label, new_figure, plain_text, to_uri
from tudor_dynamics.report.plots import JointPositions
from tudor_dynamics.report.style import PAGE, style
from tudor_dynamics.typing import FloatArray

BINS = 40
MAX_DOTS = 700
"""Validation samples shown as dots, evenly chosen."""
TRAINING_COLOUR, TEST_COLOUR = '#b5b5b5', '#0072b2'


def _edges(axis: JointPositions) -> FloatArray:
    values = np.concatenate([axis.training, axis.test])
    low, high = float(values.min()), float(values.max())
    if high - low < 1e-9:
        low, high = low - 0.5, high + 0.5
    return np.linspace(low, high, BINS + 1)


def density_figure(joints: Sequence[JointPositions]) -> str:
    """Draw how often each position was visited."""
    columns = min(len(joints), 3)
    n_rows = -(-len(joints) // columns)
    with style(PAGE):
        figure, rows = new_figure(columns, [1.4] * n_rows, [0.3] + [0.55] * (n_rows - 1))
        cells = [axes for row in rows for axes in row]
        for axes in cells[len(joints):]:
            axes.set_axis_off()
        for axes, joint in zip(cells, joints, strict=False):
            edges = _edges(joint)
            share = np.histogram(joint.training, edges)[0] / len(joint.training)
            axes.stairs(100.0 * share, edges, fill=True, color=TRAINING_COLOUR, label='training')
            if len(joint.test):
                share = np.histogram(joint.test, edges)[0] / len(joint.test)
                axes.stairs(100.0 * share, edges, color=TEST_COLOUR, linewidth=1.2,
                            linestyle='--', label='validation')
            plain_text(axes.set_xlabel, label(joint.name, joint.unit))
        cells[0].set_ylabel('share of samples [%]')
        cells[0].legend(loc='lower left', bbox_to_anchor=(0.0, 1.0), ncol=2, borderpad=0.1)
        return to_uri(figure)


def pair_figure(pairs: Sequence[tuple[JointPositions, JointPositions]]) -> str:
    """Draw which combinations of two joints' positions were visited."""
    with style(PAGE):
        columns = max(len(pairs), 2)
        height = 2.9 if columns == 2 else 2.0
        figure, rows = new_figure(columns, [height], [0.3], between=0.75)
        for axes in rows[0][len(pairs):]:
            axes.set_axis_off()
        for axes, (first, second) in zip(rows[0], pairs, strict=False):
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
        rows[0][0].legend(handles=handles, loc='lower left', bbox_to_anchor=(0.0, 1.0),
                          ncol=2, borderpad=0.1, handlelength=1.2)
        return to_uri(figure)
