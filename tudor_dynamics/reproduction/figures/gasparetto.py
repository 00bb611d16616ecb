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

"""Counterparts of Figures 4 to 9 of Gasparetto et al.: the L-shaped mechanism."""

from __future__ import annotations

from matplotlib.figure import Figure
import numpy as np

from tudor_dynamics.reproduction.figures import look
from tudor_dynamics.reproduction.result_cache import Cached

HIGHEST = 150.0
"""Highest frequency that is shown [Hz]."""
LABELS = {'effort:motor': 'torque of the motor', 'acceleration:motor': 'acceleration of the elbow',
          'acceleration:tip': 'acceleration of the tip',
          'moment:corner': 'moment in the middle of link 2'}


def over_time(run: Cached, signal: str) -> Figure:
    """
    Draw a signal over time.

    Parameters
    ----------
    run : Cached
        As from `l_shape_run`.
    signal : str
        Of its signals.

    Returns
    -------
    Figure
        Figure.

    """
    figure, axes = look.new_figure(2.6, 1)
    _curves(axes[0, 0], run, signal, run.arrays['t'], run.arrays[signal])
    axes[0, 0].set(xlabel='time [s]', xlim=(0.0, float(run.arrays['t'][-1])))
    return figure


def over_frequency(run: Cached, signal: str) -> Figure:
    """
    Draw the amplitudes of a signal over frequency.

    Parameters
    ----------
    run : Cached
        As from `l_shape_run`.
    signal : str
        Of its signals.

    Returns
    -------
    Figure
        Figure.

    """
    figure, axes = look.new_figure(2.6, 1)
    frequency, amplitude = run.arrays['f'][1:], run.arrays[f'{signal} spectrum'][1:]
    _curves(axes[0, 0], run, signal, frequency, np.maximum(amplitude, 1e-12))
    inside = amplitude[frequency <= HIGHEST]
    top = float(inside.max())
    axes[0, 0].set(xlabel='frequency [Hz]', xlim=(0.0, HIGHEST), yscale='log',
                   ylim=(1e-4 * top, 2.0 * top))
    return figure


def _curves(axes: object, run: Cached, signal: str, x: object, y: object) -> None:
    values = np.asarray(y)
    labels, unit = run.content[signal]['labels'], run.content[signal]['unit']
    for column, label in enumerate(labels):
        if np.abs(values[:, column]).max() <= 1e-3 * np.abs(values).max():
            continue  # nothing happens there
        getattr(axes, 'plot')(x, values[:, column], linewidth=0.9,
                              label=label if len(labels) > 1 else None,
                              **look.CURVES[column % len(look.CURVES)])
    getattr(axes, 'set_ylabel')(f'[{unit}]')
    getattr(axes, 'set_title')(LABELS[signal])
    if len(labels) > 1:
        getattr(axes, 'legend')(loc='lower right', bbox_to_anchor=(1.0, 0.98), ncols=4,
                                borderpad=0.0)
