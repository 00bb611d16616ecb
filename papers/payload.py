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

"""Payload: what the arm carries, from strains and currents, by the bag and sample by sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from papers import look
from papers.campaign import Cached, Campaign, fit, stimulus_seeds
from papers.following import follow_load
from papers.look import BLUE, Picture, VERMILION
from papers.outlook import Floor, Section, Setting
import tudor_dynamics as td
from tudor_dynamics.mechanics.campaign import random_loads, random_pushes

CLOSE, CLOSE_SOON, CLOSE_LATER = 0.005, 0.020, 0.010
"""Errors of a mass that are asked for: of a recording, a second after a change, later [kg]."""
ENDS = (0.0, 0.4)
"""Payloads that the model is fitted to [kg]."""
BETWEEN = (0.1, 0.2, 0.3)
EARLY = 0.2
"""Time before a load for which it is announced [s]."""
SOON, LATER = 1.0, 5.0
"""Times after a change at which the mass is judged [s]."""
LOADED, PUSHED = 5000, 6000
"""Seeds of the recordings: others than those that windows and limits were chosen on."""


def section(setting: Setting) -> Section:
    """Compute the section."""
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
        Floor(f'{changes} unannounced: reported as payload within 1 s', '96 %',
              f'{sudden["told"]} (and {sudden["corrections"]} corrections later)',
              bool(sudden['told'] >= 0.96 * changes)),
        Floor(f'{followed["pushes"]} pushes, half of them held: reported as payload',
              'at most 2 %',
              f'{followed["told"]}', bool(followed['told'] <= 0.02 * followed['pushes'])),
        Floor('the same: found, median latency', 'as without the estimator',
              f'{_pushes(followed)}; without {_pushes(free)}',
              bool(followed['found'] >= free['found'])))
    return Section(
        ('A model of two payloads knows what each further kilogram does to every output. Offline '
         'the mass is what explains, by least squares, what the model without payload leaves '
         'over; online a Kalman filter does so sample by sample, by where links are that bend, '
         'which their strain shows. The instant at which a load comes is sought, and a load '
         'differs from a touch by how little it leaves unexplained.',), floors,
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
    models = fitted(setting)
    setting.progress('recordings between', 0.2)
    content: dict[str, Any] = {'offline': offline(setting, models)}
    for share, name, announced in ((0.4, 'announced', True), (0.55, 'unannounced', False)):
        setting.progress(f'loads, {name}', share)
        content[name] = picked_up(setting, models, announced=announced)
    for share, name, estimate in ((0.7, 'pushed', True), (0.85, 'pushed_without', False)):
        setting.progress('pushes', share)
        content[name] = pushed(setting, models, estimate=estimate)
    return Cached(content)


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


@dataclass(frozen=True)
class Size:
    """How much is recorded."""

    training: int  # recordings of each payload that the model is fitted to
    runs: int  # recordings of each payload between
    bags: int  # recordings with loads that change; twice as many with pushes
    seconds: float  # length of each [s]
    each: int  # loads or pushes in each


def size_of(setting: Setting) -> Size:
    """Give the size of the trials."""
    return Size(1, 1, 1, 20.0, 2) if setting.quick else Size(5, 14, 5, 80.0, 10)


def _campaign(setting: Setting, stimuli: int) -> Campaign:
    plan = replace(setting.campaign.plan, stimuli=stimuli, seconds=size_of(setting).seconds)
    return Campaign(plan, setting.campaign.stages, setting.campaign.progress)


def fitted(setting: Setting) -> td.ModelBundle:
    """Fit a model to the least and the largest payload."""
    campaign = _campaign(setting, size_of(setting).training)
    return fit(campaign.arm, [path for end in ENDS for path in campaign.record(end)], [],
               td.FitSettings(kinds=('analytical',), payloads=ENDS), bare=False)


def offline(setting: Setting, models: td.ModelBundle) -> list[list[float]]:
    """Give true mass, estimate and standard deviation of recordings between the ends [kg]."""
    campaign = _campaign(setting, size_of(setting).runs)
    found = []
    for payload in BETWEEN:
        for path in campaign.record(payload):
            estimate = td.carried(models, path)
            found.append([payload, estimate.mass, estimate.mass_std])
    return found


def _recorded(setting: Setting, name: str, specs: Sequence[td.StimulusSpec]) -> list[Path]:
    campaign = setting.campaign
    folder = campaign.stages.folder(name, {
        **campaign.described(0.0, damped=True), 'specs': [str(spec) for spec in specs]})
    paths = [folder / f'stimulus_{k + 1:02d}' for k in range(len(specs))]
    missing = [k for k, path in enumerate(paths) if not path.exists()]
    if missing:
        td.record_stimuli(campaign.plan.arm, [specs[k] for k in missing],
                          [paths[k] for k in missing], campaign.plan.jobs)
    return paths


def picked_up(setting: Setting, models: td.ModelBundle, *, announced: bool) -> dict[str, Any]:
    """Let loads be picked up and put down while the arm moves."""
    size = size_of(setting)
    seeds = [stimulus_seeds(LOADED + setting.campaign.plan.seed, k) for k in range(size.bags)]
    changes = [random_loads(size.each, size.seconds, 0.0, seed[2]) for seed in seeds]
    paths = _recorded(setting, 'bags_payload_loads', [
        td.StimulusSpec(0.0, size.seconds, 100.0, 1.0, *seed, loads=loads)
        for seed, loads in zip(seeds, changes, strict=True)])
    errors, reported, events, corrections = [], 0, 0, 0
    for path, loads in zip(paths, changes, strict=True):
        seen = follow_load(models, td.read_recording(path, models.arm), 0.0, announced=[
            change.time - EARLY for change in loads] if announced else ())
        for change in loads:
            at = np.searchsorted(seen.t, [change.time + SOON, change.time + LATER])
            errors.append([float(seen.mass[min(i, len(seen.mass) - 1)] - change.mass)
                           for i in at])
            reported += any(change.time <= t <= change.time + SOON for t in seen.times)
            events += any(change.time - EARLY <= t <= change.time + SOON for t in seen.events)
        corrections += sum(not any(c.time <= t <= c.time + SOON for c in loads)
                           for t in seen.times)
    masses = np.array([0.0, *(change.mass for change in loads)])
    return {'errors': errors, 'told': reported, 'events': events, 'corrections': corrections,
            't': seen.t[::10].tolist(), 'mass': seen.mass[::10].tolist(),
            'true': masses[np.searchsorted([change.time for change in loads], seen.t[::10],
                                           'right')].tolist()}


def pushed(setting: Setting, models: td.ModelBundle, *, estimate: bool) -> dict[str, Any]:
    """Push the arm, every second time for seconds."""
    size = size_of(setting)
    count = 2 * size.bags
    arm = setting.campaign.arm
    mechanism = td.ClosedLoop(arm).plant.mechanism
    seeds = [stimulus_seeds(PUSHED + setting.campaign.plan.seed, k) for k in range(count)]
    known = [0.0 if k % 2 else 0.2 for k in range(count)]
    paths = _recorded(setting, 'bags_payload_pushes', [
        td.StimulusSpec(mass, size.seconds, 100.0, 1.0, *seed, size.each, held=True)
        for mass, seed in zip(known, seeds, strict=True)])
    total = found = reported = 0
    latency = []
    for path, mass, seed in zip(paths, known, seeds, strict=True):
        pushes = random_pushes(arm, mechanism, size.each, size.seconds, seed[2], held=True)
        seen = follow_load(models, td.read_recording(path, models.arm), mass, estimate=estimate)
        for push in pushes:
            total += 1
            end = push.time + push.duration
            hits = [t - push.time for t in seen.events if push.time <= t <= end + 0.5]
            found += bool(hits)
            latency += hits[:1]
            reported += any(push.time <= t <= end + 0.7 for t in seen.times)
    return {'pushes': total, 'found': found, 'told': reported,
            'latency': float(np.median(latency)) if latency else None}
