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

"""Payload: what the arm carries, from strains and currents."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure
import numpy as np

from tudor_dynamics.report.style import BLUE, VERMILION
from tudor_dynamics.reproduction.figures import look
from tudor_dynamics.reproduction.figures.pictures import Picture
from tudor_dynamics.reproduction.outlook.part import Floor, Section, Setting
from tudor_dynamics.reproduction.outlook.payload_trials import (
    fitted, offline, picked_up, pushed, size_of)
from tudor_dynamics.reproduction.result_cache import Cached

CLOSE, CLOSE_SOON, CLOSE_LATER = 0.005, 0.020, 0.010
"""Errors of a mass that are asked for: of a recording, a second behind a change, later [kg]."""


def section(setting: Setting) -> Section:
    """
    Compute the section.

    Parameters
    ----------
    setting : Setting
        What it is computed with.

    """
    campaign = setting.campaign
    depends: dict[str, Any] = {'of': campaign.described(0.0, damped=True),
                               'quick': setting.quick, 'size': str(size_of(setting))}
    content = campaign.stages.result('payload', depends, lambda: _computed(setting)).content
    true, mass, std = np.array(content['offline']).T
    off, inside = np.abs(mass - true), np.abs(mass - true) < 2.0 * std
    expected, sudden = content['announced'], content['unannounced']
    errors = np.abs(np.array(expected['errors']))
    soon, later = errors[:, 0], errors[:, 1]
    free, followed = content['pushed_without'], content['pushed']
    changes = len(sudden['errors'])
    floors = (
        Floor(f'{len(off)} recordings of 100, 200, 300 g, model of 0 and 400 g', 'within 5 g',
              f'{1000 * np.sqrt(np.mean(off ** 2)):.1f} g (root mean square), largest '
              f'{1000 * off.max():.1f} g, {np.mean(off < CLOSE):.0%} within 5 g',
              bool(off.max() < CLOSE)),
        Floor('the same: truth within two standard deviations', '90 %',
              f'{np.mean(inside):.0%}', bool(np.mean(inside) >= 0.9)),
        Floor(f'{len(soon)} announced pick-ups and drops: 1 s later', 'within 20 g',
              f'median {1000 * np.median(soon):.0f} g, {np.mean(soon < CLOSE_SOON):.0%} within '
              f'20 g; {expected["events"]} collisions',
              bool((soon < CLOSE_SOON).all() and not expected['events'])),
        Floor('the same: 5 s later', 'within 10 g',
              f'median {1000 * np.median(later):.0f} g, {np.mean(later < CLOSE_LATER):.0%} within '
              '10 g', bool((later < CLOSE_LATER).all())),
        Floor(f'{changes} unannounced: told as payload within 1 s', '96 %',
              f'{sudden["told"]} (and {sudden["corrections"]} corrections later)',
              bool(sudden['told'] >= 0.96 * changes)),
        Floor(f'{followed["pushes"]} pushes, half of them held: told as payload', 'at most 2 %',
              f'{followed["told"]}', bool(followed['told'] <= 0.02 * followed['pushes'])),
        Floor('the same: found, median latency', 'as without the estimator',
              f'{_pushes(followed)}; without {_pushes(free)}',
              bool(followed['found'] >= free['found'])))
    return Section(
        ('A model of two payloads knows what each further kilogram does to every output. Offline '
         'the mass is what explains, by least squares, what the model without payload leaves '
         'over; online a Kalman filter does so sample by sample, by where links are that bend, '
         'which their strain tells. The instant at which a load comes is sought, and it is told '
         'from a touch by how little it leaves unexplained.',), floors,
        (Picture('payload_offline', 'Payload', 'Masses of recordings',
                 'Each recording by itself, with two standard deviations; the model has seen 0 '
                 'and 400 g.', lambda: _draw_offline(true, mass, std)),
         Picture('payload_online', 'Payload', 'Loads that are picked up and put down',
                 'One recording, unannounced. The arm moves at random.',
                 lambda: _draw_online(sudden))),
        {key: value for key, value in content.items() if key != 'offline'})


def _pushes(found: dict[str, Any]) -> str:
    latency = found['latency']
    return f'{found["found"]}' + ('' if latency is None else f', {1000 * latency:.0f} ms')


def _computed(setting: Setting) -> Cached:
    setting.progress('model of 0 and 400 g', 0.0)
    bundle = fitted(setting)
    setting.progress('recordings between', 0.2)
    content: dict[str, Any] = {'offline': offline(setting, bundle)}
    for share, name, announced in ((0.4, 'announced', True), (0.55, 'unannounced', False)):
        setting.progress(f'loads, {name}', share)
        content[name] = picked_up(setting, bundle, announced=announced)
    for share, name, estimate in ((0.7, 'pushed', True), (0.85, 'pushed_without', False)):
        setting.progress('pushes', share)
        content[name] = pushed(setting, bundle, estimate=estimate)
    return Cached(content, {})


def _draw_offline(true: Any, mass: Any, std: Any) -> Figure:
    figure, axes = look.new_figure(3.0, 1)
    spread = np.linspace(-12.0, 12.0, len(true))
    axes[0, 0].axhspan(-1000.0 * CLOSE, 1000.0 * CLOSE, color='#dddddd', zorder=0)
    axes[0, 0].errorbar(1000.0 * true + spread, 1000.0 * (mass - true), 2000.0 * std, fmt='o',
                        color=BLUE, markersize=3, linewidth=0.8)
    axes[0, 0].set_xlabel('payload [g]')
    axes[0, 0].set_ylabel('error of the mass [g]')
    return figure


def _draw_online(found: dict[str, Any]) -> Figure:
    figure, axes = look.new_figure(3.0, 1)
    axes[0, 0].plot(found['t'], 1000.0 * np.array(found['true']), color='#111111', linewidth=1.0,
                    label='carried')
    axes[0, 0].plot(found['t'], 1000.0 * np.array(found['mass']), color=VERMILION, linewidth=1.0,
                    label='estimated')
    axes[0, 0].set_xlabel('time [s]')
    axes[0, 0].set_ylabel('payload [g]')
    look.legend_above(figure, axes[0, 0], 2)
    return figure
