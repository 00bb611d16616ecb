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

"""Counterparts of the figures of Malzahn et al.: damping, responses, measured and predicted."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure
import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.models.units import output_units
from tudor_dynamics.report.style import PRINT_MEASURED, PRINT_MODELS
from tudor_dynamics.reproduction.figures import look
from tudor_dynamics.reproduction.judging import hub_gauges
from tudor_dynamics.reproduction.plan import grams
from tudor_dynamics.reproduction.result_cache import Cached

DETAIL = 20.0
"""Length of the stretch in which measured and predicted values are compared [s]."""


def damping(arm: Arm, moves: dict[float, Cached]) -> Figure:
    """
    Show moves with and without the damper, as Figure 2 does.

    Parameters
    ----------
    arm : Arm
        Arm that is simulated.
    moves : dict of float to Cached
        Payload [kg] to `damping_move`.

    Returns
    -------
    Figure
        Angle of the first joint, strains near the hubs; a column a payload.

    """
    hubs = hub_gauges(arm)
    units = output_units(arm, 'strain')
    figure, axes = look.new_figure(4.9, 1 + len(hubs), len(moves), sharex=True, sharey='row')
    for column, (payload, move) in enumerate(moves.items()):
        a = move.arrays
        t = a['t'] - move.content['end']
        for name, how in (('undamped', look.UNDAMPED), ('damped', look.DAMPED)):
            axes[0, column].plot(t, np.degrees(a[f'{name}_q'][:, 0]), **how)
            for row, gauge in enumerate(hubs):
                axes[1 + row, column].plot(t, a[f'{name}_strain'][:, gauge], **how)
        axes[0, column].plot(t, np.degrees(a['q_ref'][:, 0]), color='#111111', linewidth=0.8,
                             linestyle=(0, (1, 1.2)), label='reference')
        axes[0, column].set_title(grams(payload).replace('g', ' g'))
        axes[-1, column].set_xlabel('time from the end of the move [s]')
        for item in axes[:, column]:
            item.axvspan(t[0], 0.0, color='#000000', alpha=0.05, linewidth=0)
            item.set_xlim(-2.2, 6.0)
    axes[0, 0].set_ylabel(f'{arm.active_joints[0]} [°]')
    for row, gauge in enumerate(hubs):
        name = arm.gauge_names[gauge]
        axes[1 + row, 0].set_ylabel(f'{name} [{look.unit(units[name])}]')
    figure.align_ylabels()
    look.legend_above(figure, axes[0, 0], 3)
    return figure


def stimuli(arm: Arm, bags: Sequence[BagData]) -> Figure:
    """
    Draw how the first joint moves in each stimulus, as Figure 5 does.

    Parameters
    ----------
    arm : Arm
        Arm that is simulated.
    bags : sequence of BagData
        Recordings of the stimuli.

    Returns
    -------
    Figure
        Angle, velocity and acceleration, as models are given them; a column a stimulus.

    """
    figure, axes = look.new_figure(5.2, 3, len(bags), sharex=True, sharey='row')
    joint = arm.active_joints[0]
    labels = ('angle [°]', 'velocity [°/s]', 'acceleration [°/s²]')
    for column, bag in enumerate(bags):
        for stretch in bag.stretches:
            states = stretch.states
            for item, values in zip(axes[:, column], (states.q, states.dq, states.ddq),
                                    strict=True):
                item.plot(stretch.t, np.degrees(values[:, 0]), linewidth=0.9, **look.CURVES[0])
        axes[0, column].set_title(f'{joint}, stimulus {column + 1}')
        axes[-1, column].set_xlabel('time [s]')
        axes[-1, column].set_xlim(0.0, float(bag.recording.t[-1]))
    for item, label in zip(axes[:, 0], labels, strict=True):
        item.set_ylabel(label)
    figure.align_ylabels()
    return figure


def measured_and_predicted(arm: Arm, output: str, fit: Cached) -> Figure:
    """
    Draw measured and predicted values and what is left over (Figures 6 and 7).

    Parameters
    ----------
    arm : Arm
        Arm that is simulated.
    output : {'strain', 'effort'}
        Output that is drawn.
    fit : Cached
        As from ``Fits.separate``.

    Returns
    -------
    Figure
        A stretch of a test recording for each channel, and the residuals below.

    """
    names = list(arm.active_joints if output == 'effort' else arm.gauge_names)
    chosen = range(len(names)) if output == 'effort' else hub_gauges(arm)
    units = output_units(arm, output)
    t = fit.arrays['t']
    begin = max(float(t[0]), 0.4 * float(t[-1]))
    part = (t >= begin) & (t <= begin + DETAIL)
    measured = fit.arrays[f'{output}_measured'][part]
    kinds = [kind for kind in PRINT_MODELS if f'{output}_{kind}' in fit.arrays]
    figure, axes = look.new_figure(5.6, 2 * len(list(chosen)), sharex=True,
                                   height_ratios=[1.0, 0.45] * len(list(chosen)))
    for row, channel in enumerate(chosen):
        upper, lower = axes[2 * row, 0], axes[2 * row + 1, 0]
        upper.plot(t[part], measured[:, channel], **PRINT_MEASURED)
        lower.axhline(0.0, color='#777777', linewidth=0.7)
        for kind in kinds:
            predicted = fit.arrays[f'{output}_{kind}'][part, channel]
            fits = fit.content[output][kind]['test']['channels'][names[channel]]['fit']
            label = 'ELM' if kind == 'elm' else kind
            upper.plot(t[part], predicted, label=f'{label} ({fits:.1f} %)', **PRINT_MODELS[kind])
            lower.plot(t[part], measured[:, channel] - predicted,
                       **{**PRINT_MODELS[kind], 'linewidth': 0.9})
        unit = look.unit(units[names[channel]])
        upper.set_ylabel(f'{names[channel]} [{unit}]')
        lower.set_ylabel(f'residual\n[{unit}]', fontsize=8.0)
        upper.legend(loc='lower right', bbox_to_anchor=(1.0, 0.98), ncols=4, borderpad=0.0)
    axes[-1, 0].set_xlabel('time [s]')
    axes[-1, 0].set_xlim(begin, float(t[part][-1]))
    figure.align_ylabels()
    return figure
