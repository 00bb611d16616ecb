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

"""Figures of our own: damping and payload, one model for all, collisions, strain regressors."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure
import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.schema import GaugeSpec
from tudor_dynamics.identification.metrics import score
from tudor_dynamics.report.style import PRINT_MODELS
from tudor_dynamics.reproduction.figures import look
from tudor_dynamics.reproduction.result_cache import Cached
from tudor_dynamics.reproduction.table1 import LABELS, Shared
from tudor_dynamics.reproduction.table1_claims import TITLES

OUTPUTS = ('strain', 'effort')
METHODS = {'strain': 'strain', 'effort': 'current', 'momentum': 'momentum observer (current)',
           'elastic strain': 'strain, elastic model'}
METHOD_MARKERS = ('o', 's', '^', 'D')
MOST_ALARMS = 600.0
"""False alarms per hour beyond which a detector is of no use, and they run into each other."""


def _payload_axis(axes: Any, payloads: list[float]) -> None:
    axes.set_xticks([1000.0 * value for value in payloads])
    axes.set_xlabel('payload [g]')


def with_and_without_damping(damped: dict[float, Cached], undamped: dict[float, Cached]) -> Figure:
    """
    Draw the fit on test recordings over the payload, with and without damping.

    Parameters
    ----------
    damped, undamped : dict of float to Cached
        Payload [kg] to ``Fits.separate``.

    Returns
    -------
    Figure
        Strain and current.

    """
    figure, axes = look.new_figure(3.3, 1, 2, sharey=True)
    payloads = list(damped)
    for item, output in zip(axes[0], OUTPUTS, strict=True):
        for kind, how in PRINT_MODELS.items():
            for name, results, face in (('damped', damped, how['color']),
                                        ('undamped', undamped, 'white')):
                known = [p for p in payloads if kind in results[p].content.get(output, {})]
                if not known:
                    continue
                item.plot([1000.0 * p for p in known],
                          [results[p].content[output][kind]['test']['fit'] for p in known],
                          marker=look.MARKERS[kind], markersize=6, markerfacecolor=face,
                          **how, label=f'{LABELS[kind]}, {name}')
        item.set_title(TITLES[output])
        _payload_axis(item, payloads)
        item.set_ylim(30.0, 100.0)
    axes[0, 0].set_ylabel('fit on unseen stimuli [%]')
    look.legend_above(figure, axes[0, 0], 4)
    return figure


def one_model(shared: tuple[Shared, ...], trained_at: tuple[float, float]) -> Figure:
    """
    Draw the fit of one model for all payloads beside that of separate ones.

    Parameters
    ----------
    shared : tuple of Shared
        Test fits of one model and of separate ones.
    trained_at : (float, float)
        Payloads that the one model has seen [kg].

    Returns
    -------
    Figure
        Strain and current.

    """
    figure, axes = look.new_figure(3.3, 1, 2, sharey=True)
    for item, output in zip(axes[0], OUTPUTS, strict=True):
        payloads = list(next(entry.separate for entry in shared if entry.output == output))
        for entry in shared:
            if entry.output != output:
                continue
            how = PRINT_MODELS[entry.model]
            for values, name, face in ((entry.separate, 'a model for each', 'white'),
                                       (entry.together, 'one model', how['color'])):
                pairs = [(1000.0 * p, v) for p, v in values.items() if v is not None]
                if pairs:
                    item.plot(*zip(*pairs, strict=True), marker=look.MARKERS[entry.model],
                              markersize=7 if face == 'white' else 4.5, markerfacecolor=face,
                              **{**how, 'linewidth': 0.8 if face == 'white' else 1.4},
                              label=f'{LABELS[entry.model]}, {name}')
        for end in trained_at:
            item.axvline(1000.0 * end, color='#777777', linewidth=0.8, linestyle=(0, (1, 2)))
        item.set_title(TITLES[output])
        _payload_axis(item, payloads)
        item.set_ylim(40.0, 100.0)
    axes[0, 0].set_ylabel('fit on unseen stimuli [%]')
    look.legend_above(figure, axes[0, 0], 2)
    return figure


def collisions(found: Cached) -> Figure:
    """
    Draw how pushes are found: detection rate over false alarms, and how soon.

    Parameters
    ----------
    found : Cached
        As from ``pushes.collisions``.

    Returns
    -------
    Figure
        Two panels.

    """
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


def strain_forms(arm: Arm, moments: Cached, exact: Cached, paper: Cached) -> Figure:
    """
    Draw what the paper's strain regressor leaves out, and what that costs.

    Parameters
    ----------
    arm : Arm
        Arm that is simulated.
    moments : Cached
        As from ``experiments.gauge_moments``.
    exact, paper : Cached
        ``Fits.separate`` with either form, for the payload of the moments.

    Returns
    -------
    Figure
        Difference of the moments over time; fit of each gauge.

    """
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


def _moment(gauge: GaugeSpec) -> str:
    return f'{gauge.joint}_{1000 * gauge.distance:.0f}'


def _literal_fit(moments: Cached, gauge: GaugeSpec) -> float:
    """Fit a scale and an offset of the joint's moment to that at the gauge, free of noise."""
    at_joint, own = moments.arrays[f'{gauge.joint}_0'], moments.arrays[_moment(gauge)]
    rows = np.column_stack([at_joint, np.ones(len(own))])
    predicted = rows @ np.linalg.lstsq(rows, own, rcond=None)[0]
    return float(score(own[:, None], predicted[:, None], [gauge.name]).fit)
