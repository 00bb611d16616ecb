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

"""What is drawn: counterparts of the figures of both papers, and some of our own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from papers import look
from papers.campaign import Cached, channels, grams, hub_gauges, KINDS, OUTPUTS, units
from papers.table1 import Shared, TITLES
import tudor_dynamics as td

DETAIL = 20.0
"""Length of the stretch in which measured and predicted values are compared [s]."""
HIGHEST = 150.0
"""Highest frequency that is shown [Hz]."""
SIGNALS = {'effort:motor': 'torque of the motor',
           'acceleration:motor': 'acceleration of the elbow',
           'acceleration:tip': 'acceleration of the tip',
           'moment:corner': 'moment in the middle of link 2'}
METHODS = {'strain': 'strain', 'effort': 'current', 'momentum': 'momentum observer (current)',
           'elastic strain': 'strain, elastic model'}
METHOD_MARKERS = ('o', 's', '^', 'D')
MOST_ALARMS = 600.0
"""False alarms per hour beyond which a detector is of no use, and they run into each other."""


def damping(arm: td.Arm, moves: dict[float, Cached]) -> Figure:
    """Show moves with and without the damper, as Figure 2 does."""
    hubs = hub_gauges(arm)
    unit_of = units(arm, 'strain')
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
        axes[1 + row, 0].set_ylabel(f'{name} [{look.unit(unit_of[name])}]')
    figure.align_ylabels()
    look.legend_above(figure, axes[0, 0], 3)
    return figure


def stimuli(arm: td.Arm, bags: Sequence[td.Recording]) -> Figure:
    """Draw how the first joint moves in each stimulus, as Figure 5 does."""
    figure, axes = look.new_figure(5.2, 3, len(bags), sharex=True, sharey='row')
    joint = arm.active_joints[0]
    labels = ('angle [°]', 'velocity [°/s]', 'acceleration [°/s²]')
    for column, bag in enumerate(bags):
        for stretch in td.prepare(bag, arm.spec.preprocessing):
            states = stretch.states
            for item, values in zip(axes[:, column], (states.q, states.dq, states.ddq),
                                    strict=True):
                item.plot(stretch.t, np.degrees(values[:, 0]), linewidth=0.9, **look.CURVES[0])
        axes[0, column].set_title(f'{joint}, stimulus {column + 1}')
        axes[-1, column].set_xlabel('time [s]')
        axes[-1, column].set_xlim(0.0, float(bag.t[-1]))
    for item, label in zip(axes[:, 0], labels, strict=True):
        item.set_ylabel(label)
    figure.align_ylabels()
    return figure


def measured_and_predicted(arm: td.Arm, output: str, fit: Cached) -> Figure:
    """Draw measured and predicted values and what is left over (Figures 6 and 7)."""
    names, chosen = channels(arm, output)
    unit_of = units(arm, output)
    t = fit.arrays['t']
    begin = max(float(t[0]), 0.4 * float(t[-1]))
    part = (t >= begin) & (t <= begin + DETAIL)
    measured = fit.arrays[f'{output}_measured'][part]
    kinds = [kind for kind in look.MODELS if f'{output}_{kind}' in fit.arrays]
    figure, axes = look.new_figure(5.6, 2 * len(chosen), sharex=True,
                                   height_ratios=[1.0, 0.45] * len(chosen))
    for row, channel in enumerate(chosen):
        upper, lower = axes[2 * row, 0], axes[2 * row + 1, 0]
        upper.plot(t[part], measured[:, channel], **look.MEASURED)
        lower.axhline(0.0, color='#777777', linewidth=0.7)
        for kind in kinds:
            predicted = fit.arrays[f'{output}_{kind}'][part, channel]
            fits = fit.content[output][kind]['test']['channels'][names[channel]]['fit']
            label = 'ELM' if kind == 'elm' else kind
            upper.plot(t[part], predicted, label=f'{label} ({fits:.1f} %)', **look.MODELS[kind])
            lower.plot(t[part], measured[:, channel] - predicted,
                       **{**look.MODELS[kind], 'linewidth': 0.9})
        unit = look.unit(unit_of[names[channel]])
        upper.set_ylabel(f'{names[channel]} [{unit}]')
        lower.set_ylabel(f'residual\n[{unit}]', fontsize=8.0)
        upper.legend(loc='lower right', bbox_to_anchor=(1.0, 0.98), ncols=4, borderpad=0.0)
    axes[-1, 0].set_xlabel('time [s]')
    axes[-1, 0].set_xlim(begin, float(t[part][-1]))
    figure.align_ylabels()
    return figure


def over_time(run: Cached, signal: str) -> Figure:
    """Draw a signal over time."""
    figure, axes = look.new_figure(2.6, 1)
    _curves(axes[0, 0], run, signal, run.arrays['t'], run.arrays[signal])
    axes[0, 0].set(xlabel='time [s]', xlim=(0.0, float(run.arrays['t'][-1])))
    return figure


def over_frequency(run: Cached, signal: str) -> Figure:
    """Draw the amplitudes of a signal over frequency."""
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
    getattr(axes, 'set_title')(SIGNALS[signal])
    if len(labels) > 1:
        getattr(axes, 'legend')(loc='lower right', bbox_to_anchor=(1.0, 0.98), ncols=4,
                                borderpad=0.0)


def _payload_axis(axes: Any, payloads: list[float]) -> None:
    axes.set_xticks([1000.0 * value for value in payloads])
    axes.set_xlabel('payload [g]')


def with_and_without_damping(damped: dict[float, Cached], undamped: dict[float, Cached]) -> Figure:
    """Draw the fit on test recordings over the payload, with and without damping."""
    figure, axes = look.new_figure(3.3, 1, 2, sharey=True)
    payloads = list(damped)
    for item, output in zip(axes[0], OUTPUTS, strict=True):
        for kind, how in look.MODELS.items():
            for name, results, face in (('damped', damped, how['color']),
                                        ('undamped', undamped, 'white')):
                known = [p for p in payloads if kind in results[p].content.get(output, {})]
                if not known:
                    continue
                item.plot([1000.0 * p for p in known],
                          [results[p].content[output][kind]['test']['fit'] for p in known],
                          marker=look.MARKERS[kind], markersize=6, markerfacecolor=face,
                          **how, label=f'{KINDS[kind]}, {name}')
        item.set_title(TITLES[output])
        _payload_axis(item, payloads)
        item.set_ylim(30.0, 100.0)
    axes[0, 0].set_ylabel('fit on unseen stimuli [%]')
    look.legend_above(figure, axes[0, 0], 4)
    return figure


def one_model(shared: tuple[Shared, ...], trained_at: tuple[float, float]) -> Figure:
    """Draw the fit of one model for all payloads beside that of separate ones."""
    figure, axes = look.new_figure(3.3, 1, 2, sharey=True)
    for item, output in zip(axes[0], OUTPUTS, strict=True):
        payloads = list(next(entry.separate for entry in shared if entry.output == output))
        for entry in shared:
            if entry.output != output:
                continue
            how = look.MODELS[entry.model]
            for values, name, face in ((entry.separate, 'a model for each', 'white'),
                                       (entry.together, 'one model', how['color'])):
                pairs = [(1000.0 * p, v) for p, v in values.items() if v is not None]
                if pairs:
                    item.plot(*zip(*pairs, strict=True), marker=look.MARKERS[entry.model],
                              markersize=7 if face == 'white' else 4.5, markerfacecolor=face,
                              **{**how, 'linewidth': 0.8 if face == 'white' else 1.4},
                              label=f'{KINDS[entry.model]}, {name}')
        for end in trained_at:
            item.axvline(1000.0 * end, color='#777777', linewidth=0.8, linestyle=(0, (1, 2)))
        item.set_title(TITLES[output])
        _payload_axis(item, payloads)
        item.set_ylim(40.0, 100.0)
    axes[0, 0].set_ylabel('fit on unseen stimuli [%]')
    look.legend_above(figure, axes[0, 0], 2)
    return figure


def collisions(found: Cached) -> Figure:
    """Draw how pushes are found: detection rate over false alarms, and how soon."""
    figure, axes = look.new_figure(3.4, 1, 2)
    left, right = axes[0]
    for (method, item), how, marker in zip(found.content['methods'].items(), look.CURVES,
                                           METHOD_MARKERS, strict=False):
        roc = np.array(sorted(item['roc'], reverse=True))  # from high thresholds to low ones
        beyond = np.flatnonzero(roc[:, 1] > MOST_ALARMS)
        roc = roc[:beyond[0] if len(beyond) else len(roc)]
        score = item['score']
        left.plot(roc[:, 1], 100.0 * roc[:, 2], drawstyle='steps-post', linewidth=1.3, **how,
                  label=METHODS[method])
        left.plot(score['false_alarms_per_hour'], 100.0 * (score['detection_rate'] or 0.0),
                  marker, color=how['color'], markersize=7, clip_on=False)
        latency = np.sort([1000.0 * push['latency'] for push in item['pushes']
                           if push['latency'] is not None])
        share = 100.0 * np.arange(1, len(latency) + 1) / max(len(item['pushes']), 1)
        right.plot(np.append(latency, 1e4), np.append(share, share[-1:] if len(share) else 0.0),
                   drawstyle='steps-post', linewidth=1.3, **how)
        if len(latency):
            middle = float(np.median(latency))
            right.plot(middle, share[np.searchsorted(latency, middle)], marker,
                       color=how['color'], markersize=7)
    left.set_xscale('symlog', linthresh=10.0)
    left.set(xlabel='false alarms per hour', ylabel='pushes found [%]', ylim=(0.0, 103.0),
             title='marker: threshold in force')
    left.set_xlim(0.0, MOST_ALARMS)
    left.set_xticks([0, 5, 10, 50, 100, 500], ['0', '5', '10', '50', '100', '500'])
    right.set(xlabel='time since the begin of the push [ms]', ylabel='pushes found [%]',
              xlim=(0.0, 600.0), ylim=(0.0, 103.0), title='marker: median latency')
    look.legend_above(figure, left, 4)
    return figure


def strain_forms(arm: td.Arm, moments: Cached, exact: Cached, paper: Cached) -> Figure:
    """Draw what the paper's strain regressor leaves out, and what that costs."""
    figure, axes = look.new_figure(3.6, 1, 2, width_ratios=[1.15, 1.0])
    left, right = axes[0]
    joint = arm.gauges[0].joint
    own = sorted((gauge for gauge in arm.gauges if gauge.joint == joint),
                 key=lambda gauge: gauge.distance)
    t = moments.arrays['t']
    shown = t <= 20.0
    for gauge, how in zip(own, look.CURVES, strict=False):
        delta = moments.arrays[f'{joint}_0'] - moments.arrays[_moment(gauge)]
        left.plot(t[shown], delta[shown], linewidth=1.1, **how,
                  label=f'{gauge.name}, {1000 * gauge.distance:.0f} mm from the joint')
    left.set(xlabel='time [s]', ylabel='Δτ [N m]', title='moment at the joint minus at the gauge')
    left.legend(loc='upper right', fontsize=7.5)
    left.set_ylim(top=left.get_ylim()[1] + 0.22 * np.ptp(left.get_ylim()))
    places = np.arange(len(arm.gauges))
    rows = [('paper, taken literally: k τ(joint) + b', '^', look.CURVES[1], 'white',
             [_literal_fit(moments, gauge) for gauge in arm.gauges])]
    for name, marker, how, face, result in (
            ("paper's form, parameters free", 'o', look.CURVES[2], 'white', paper),
            ('moment at the gauge, parameters free', 'o', look.CURVES[0],
             look.CURVES[0]['color'], exact)):
        channels = result.content['strain']['analytical']['test']['channels']
        rows.append((name, marker, how, face, [channels[g]['fit'] for g in arm.gauge_names]))
    for (name, marker, how, face, values), size in zip(rows, (8, 9, 4.5), strict=True):
        right.plot(places, values, linestyle='', marker=marker, markersize=size, label=name,
                   markerfacecolor=face, color=how['color'])
    right.set_xticks(places, arm.gauge_names)
    right.set(ylabel='fit [%]', xlim=(-0.5, len(places) - 0.5), ylim=(50.0, 101.0))
    right.grid(axis='x', visible=False)
    right.legend(fontsize=7.5, loc='lower left')
    return figure


def _moment(gauge: Any) -> str:
    return f'{gauge.joint}_{1000 * gauge.distance:.0f}'


def _literal_fit(moments: Cached, gauge: Any) -> float:
    """Fit a scale and an offset of the joint's moment to that at the gauge, free of noise."""
    at_joint, own = moments.arrays[f'{gauge.joint}_0'], moments.arrays[_moment(gauge)]
    rows = np.column_stack([at_joint, np.ones(len(own))])
    predicted = rows @ np.linalg.lstsq(rows, own, rcond=None)[0]
    return float(td.score(own[:, None], predicted[:, None], [gauge.name]).fit)
