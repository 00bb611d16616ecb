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

"""Contact: force and place from two gauges a link, at rest and in motion without damping."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure
import numpy as np
from papers import look
from papers.campaign import arm_content, Cached, ELASTIC, FloatArray
from papers.look import BLUE, Picture
from papers.outlook import Floor, Section, Setting
from papers.tuned import elastic_models, ENDS
import tudor_dynamics as td
from tudor_dynamics.mechanics.campaign import random_pushes

EVERY = 10
"""Steps of the loop between two samples: 200 Hz."""
SLOT = 2.0
"""Time for each push in motion [s]."""
BEFORE, AFTER = 0.2, 0.3
"""What a record of an event has before and after a push in motion [s]."""
FELT = 1.0
"""Pushes with less across the link are none that its gauges could tell [N]."""
RUNS, PUSHES, RESTING = 5, 40, 12
CLOSE, STRONG = 0.010, 0.2
FAR, WEAK, SURE = 0.030, 0.10, 0.9
"""Errors asked for at rest [m, N], and in motion [m, 1]; part of places within two deviations."""


def section(setting: Setting) -> Section:
    """Compute the section."""
    campaign = setting.campaign
    runs, pushes, resting = (1, 4, 2) if setting.quick else (RUNS, PUSHES, RESTING)
    depends: dict[str, Any] = {
        'arm': arm_content(campaign.arm), 'runs': runs, 'pushes': pushes, 'resting': resting,
        'seed': campaign.plan.seed, 'quick': setting.quick,
        'of': None if setting.quick else [campaign.described(payload, damped=True)
                                          for payload in ENDS]}

    def compute() -> Cached:
        models = elastic_models(setting)
        at_rest = [row for k in range(resting) for row in _rest(setting, models, k, resting)]
        moving = [row for k in range(runs) for row in _move(setting, models, k, runs, pushes)]
        return Cached({'rest': at_rest, 'motion': moving})

    content = campaign.stages.result('contact_places', depends, compute).content
    rest, motion = content['rest'], content['motion']
    beyond = [row for row in rest if row['told']]
    place = float(np.median([row['place_error'] for row in beyond])) if beyond else np.nan
    force = float(np.median([row['force_error'] for row in beyond])) if beyond else np.nan
    far = _median(motion, 'place_error')
    weak = _median(motion, 'relative_error')
    right = float(np.mean([row['link_right'] for row in motion]))
    placed, felt = (float(np.mean([row[name] for row in motion])) for name in ('told', 'felt'))
    sure = float(np.mean([row['place_error'] <= 2.0 * row['deviation']
                          for row in motion if row['told']] or [0.0]))
    return Section(
        ('Each span between gauges has a Kalman filter of its own that looks for a force there; '
         'their likelihoods say which link and span it is. Truth and estimate are the force '
         'across the link, which is what its gauges feel, and its place; a push of which the '
         'wrong link, or no place, is found counts as one that is off by the whole link.',
         f'In motion the right link is found for {100.0 * right:.0f} % of the pushes, and a place '
         f'for {100.0 * placed:.0f} %; while it lasts, {100.0 * felt:.0f} % are felt.'),
        (Floor('at rest, beyond the second gauge: median error of the place', 'within 10 mm',
               f'{1e3 * place:.1f} mm', place <= CLOSE),
         Floor('the same: of the force', 'within 0.2 N', f'{force:.2f} N', force <= STRONG),
         Floor(f'{len(motion)} pushes in motion, no damping: median error of the place',
               'within 30 mm', f'{1e3 * far:.1f} mm', far <= FAR),
         Floor('the same: of the force', 'within 10 %', f'{100.0 * weak:.0f} %', weak <= WEAK),
         Floor('the same: places within two of their deviations', '90 %',
               f'{100.0 * sure:.0f} %', sure >= SURE)),
        (Picture('contact_places', 'Contact', 'Places of contacts',
                 'Pushes of a moving arm without damping: where they were, and where they were '
                 'found, from the joint of their link.', lambda: _draw(motion)),), content,
        _by_place(motion))


def _by_place(motion: list[dict[str, Any]]) -> tuple[tuple[str, ...], ...]:
    """Say how well pushes in motion are placed: all of them, by link, within and beyond gauges."""
    parts = {'anywhere': motion}
    for link in sorted({row['link'] for row in motion}):
        for name, beyond in (('inboard of its last gauge', False), ('beyond it', True)):
            parts[f'{link}, {name}'] = [row for row in motion if (row['link'], row['beyond']) == (
                link, beyond)]
    return (('pushes in motion', 'n', 'right link', 'a place', 'median error of the place',
             'of the force'), *(
                 (name, f'{len(rows)}', *(f'{np.mean([row[key] for row in rows]):.0%}'
                                          for key in ('link_right', 'told')),
                  f'{1e3 * _median(rows, "place_error"):.1f} mm',
                  f'{_median(rows, "relative_error"):.1%}')
                 for name, rows in parts.items() if rows))


def _median(rows: list[dict[str, Any]], name: str) -> float:
    return float(np.median([row[name] for row in rows])) if rows else float('nan')


def _rest(
    setting: Setting, models: td.ModelBundle, number: int, total: int,
) -> list[dict[str, Any]]:
    """Push an arm that stands, across a link, somewhere beyond its second gauge."""
    setting.progress('at rest', 0.2 + 0.2 * number / total)
    random = np.random.default_rng([setting.campaign.plan.seed, number])
    loop = td.ClosedLoop(models.arm, damping=0.0, seed=number)
    limits = np.array([[0.3, 2.5], [-1.0, 1.0]])
    pose = random.uniform(limits[:, 0], limits[:, 1])
    joint = ('joint2', 'joint3')[number % 2] if 'joint2' in models.arm.active_joints else (
        models.arm.active_joints[number % len(models.arm.active_joints)])
    order = models.arm.active_joints.index(joint)
    angle = float(pose[:order + 1].sum())
    size = float(random.choice((-1.0, 1.0)) * random.uniform(2.0, 5.0))
    place = float(random.uniform(0.26, 0.39))
    loop.reset(pose)
    push = td.Push(3.0, 9.0, joint, place, (-size * np.sin(angle), 0.0, size * np.cos(angle)), 0.2)
    loop.set_pushes([push])
    steps = round(6.0 / loop.dt)
    seen = loop.run(np.tile(pose, (steps, 1)), np.zeros((steps, len(pose))), every=EVERY)
    return _judge(models, seen, [push], within=(2.0, 3.0))


def _move(
    setting: Setting, models: td.ModelBundle, number: int, total: int, pushes: int,
) -> list[dict[str, Any]]:
    """Push a moving arm without damping anywhere on its links."""
    setting.progress('in motion', 0.4 + 0.6 * number / total)
    seed = 1000 * setting.campaign.plan.seed + number + 17
    loop = td.ClosedLoop(models.arm, damping=0.0, seed=seed)
    seconds = 3.0 + SLOT * pushes
    motion = td.stimulus_motion(models.arm, seconds, seed, loop.dt)
    chosen = random_pushes(models.arm, loop.plant.mechanism, pushes, seconds, seed)
    loop.reset(motion.q[0])
    loop.set_pushes(chosen)
    return _judge(models, loop.run(motion.q, motion.dq, every=EVERY), list(chosen))


def _judge(
    models: td.ModelBundle, seen: Any, pushes: list[td.Push],
    within: tuple[float, float] | None = None,
) -> list[dict[str, Any]]:
    """Estimate sample by sample, and compare what each push comes to with the truth."""
    estimator = td.ContactEstimator(models, ELASTIC)
    found = [estimator.step(round(t * 1e9) + 1, k == 0,
                            np.concatenate([seen.q[k], seen.dq[k], np.zeros_like(seen.q[k])]),
                            seen.strain[k], None) for k, t in enumerate(seen.t)]
    rows = []
    for push in pushes:
        begin, end = within or (0.0, push.duration)
        part = np.flatnonzero((seen.t > push.time + begin) & (seen.t < push.time + end))
        # an event begins and ends by itself
        first, last = (begin, end) if within else (begin - BEFORE, end + AFTER)
        record = estimator.record()
        for t, estimate in zip(seen.t, found, strict=True):
            if estimate and push.time + first < t < push.time + last:
                record.add(estimate)
        truth = _across(models.arm, push, seen.q_true[part], seen.t[part])
        if not len(part) or abs(truth.mean()) < FELT:
            continue
        during = [item for item in found[part[0]:part[-1] + 1] if item]
        gauges = [gauge.distance for gauge in models.arm.gauges if gauge.joint == push.joint]
        rows.append({'felt': any(item.felt for item in during),
                     'beyond': push.distance > max(gauges)} | _row(
                         push, float(truth.mean()), record.summary(), estimator))
    return rows


def _across(arm: td.Arm, push: td.Push, q: FloatArray, t: FloatArray) -> FloatArray:
    """Give the force across the link of a planar arm over time [N]."""
    order = arm.active_joints.index(push.joint)
    angle = q[:, :order + 1].sum(axis=1)
    since = np.minimum(t - push.time, push.time + push.duration - t)
    rise = np.sin(0.5 * np.pi * np.clip(since / max(push.rise, 1e-9), 0.0, 1.0)) ** 2
    return rise * (-np.sin(angle) * push.force[0] + np.cos(angle) * push.force[2])


def _row(
    push: td.Push, truth: float, found: dict[str, Any], estimator: td.ContactEstimator,
) -> dict[str, Any]:
    links = {span.joint: link for span, link in zip(estimator.spans, estimator.links, strict=True)}
    reach = max(span.outer for span in estimator.spans if span.joint == push.joint)
    right = bool(found) and found['link'] == links[push.joint]
    placed = right and found['place'] is not None
    force = found['across'] if right else 0.0
    return {'link': links[push.joint], 'place': push.distance, 'force': truth,
            'link_right': right, 'told': placed, 'found': found['place'] if placed else None,
            'place_error': abs(found['place'] - push.distance) if placed else reach,
            'deviation': found['place_deviation'] if placed else None,
            'force_error': abs(force - truth), 'relative_error': abs(force / truth - 1.0)}


def _draw(rows: list[dict[str, Any]]) -> Figure:
    links = sorted({row['link'] for row in rows})
    figure, axes = look.new_figure(3.0, 1, max(len(links), 1), sharey=True)
    for axis, link in zip(axes[0], links, strict=False):
        own = [row for row in rows if row['link'] == link and row['told']]
        axis.plot([1e3 * row['place'] for row in own], [1e3 * row['found'] for row in own], 'o',
                  color=BLUE, markersize=3)
        axis.axline((0.0, 0.0), slope=1.0, color='#888888', linewidth=0.8)
        axis.set_title(link)
        axis.set_xlabel('pushed at [mm]')
    axes[0, 0].set_ylabel('found at [mm]')
    return figure
