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

"""The report's section on the elastic model, with its modes and ring-downs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tudor_dynamics.identification.elastic_problem import CLUSTER, HUBER, RUN_IN, Start
from tudor_dynamics.identification.elastic_search import EXCERPT, FACTORS, STARTS
from tudor_dynamics.identification.fit import FitResult
from tudor_dynamics.identification.ringdowns import (
    find_ringdowns, LEAST_SECONDS, mode_map, ModeMap, Ringdown)
from tudor_dynamics.models.elastic.model import driven_arm
from tudor_dynamics.models.regressor import output_units
from tudor_dynamics.models.settings import INNER_STEP
from tudor_dynamics.show.figures import joint_axes, label, panel, Plot, shades, trace

WIDE = 4.0
"""Ratio of largest to smallest from which a scale is one of factors."""

ORDINAL = ('first', 'second')


def mode_figure(
    found: ModeMap, axes_labels: Sequence[tuple[str, str]], ringdowns: Sequence[Ringdown],
) -> Plot:
    """Draw frequency and damping ratio of the first modes over one joint or two."""
    names = [label(*names) for names in axes_labels]
    panels = []
    for values, title, what, factor in (
            (found.frequency, 'frequency [Hz]', 'frequency', 1.0),
            (100.0 * found.damping, 'damping ratio [%]', 'damping', 100.0)):
        if len(found.joints) == 1:
            middle = 0.5 * (found.edges[0][1:] + found.edges[0][:-1])
            panels.append(panel('', names[0], title, *(
                trace(look, middle, row, f'{order} mode', points=True)
                for look, order, row in zip(('analytical', 'elm'), ORDINAL, values, strict=False)),
                trace('ring', [r.q[found.joints[0]] for r in ringdowns],
                      [factor * getattr(r.measured, what) for r in ringdowns],
                      'ring-down measured'), low=0.0))
            continue
        panels += [panel(
            f'{order} mode: {title}', names[0], names[1],
            shades(found.edges[0], found.edges[1], row, ''), trace(
                'ring', [r.q[found.joints[0]] for r in ringdowns],
                [r.q[found.joints[1]] for r in ringdowns], 'ring-down measured here'), height=230)
            for order, row in zip(ORDINAL, values, strict=False)]
    return {'columns': 2, 'panels': panels}


def ringdown_figure(ringdowns: Sequence[Ringdown]) -> Plot:
    """Draw predicted against measured ring-downs."""
    panels = []
    for what, factor, title in (('frequency', 1.0, 'frequency [Hz]'),
                                ('damping', 100.0, 'damping ratio [%]')):
        every, traces = [factor * getattr(r.measured, what) for r in ringdowns], []
        for look, name, words in (('held', 'held', 'joints held'),
                                  ('moved', 'simulated', 'along the measured motion')):
            known = [r for r in ringdowns if getattr(r, name) is not None]
            x, y = ([factor * getattr(mode, what) for mode in modes] for modes in (
                [r.measured for r in known], [getattr(r, name) for r in known]))
            traces.append(trace(look, x, y, words))
            every += y
        ends = [min(every), max(every)]
        panels.append(panel(
            '', f'measured {title}', f'model: {title}', trace('limit', ends, ends, 'as measured'),
            *traces, height=240,
            **({'scale': 'log'} if 0.0 < WIDE * ends[0] < ends[1] else {})))
    return {'columns': 2, 'panels': panels}


MOST_ROWS = 24
"""Ring-downs in the table; the figure has all."""
NOT_SHOWN = 'not shown by these bags'


def elastic_section(result: FitResult) -> dict[str, Any] | None:
    """Collect what `elastic.html.j2` shows of the elastic model; None where none was fitted."""
    found, arm = result.elastic, result.arm
    if found is None:
        return None
    values = {p.name: p.value for p in found.physical}
    described = dict(driven_arm(arm, {}).parameters)
    if 'payload' not in values:
        values['payload'] = result.training[0].payload or 0.0
    driven = driven_arm(arm, values)
    axes = joint_axes(result)
    modes = mode_map(driven, np.column_stack([axis.training for axis in axes]))
    bags = [bag for bag in (*result.training, *result.test) if bag.has('strain')]
    ringdowns = find_ringdowns(driven, values, bags)
    return {
        'parameters': found.physical, 'described': described, 'not_shown': NOT_SHOWN,
        'payload': values['payload'], 'payloads': result.settings.payloads is not None,
        'gauges': list(zip(arm.gauge_names, found.gauges, found.gauge_errors, strict=True)),
        'units': output_units(arm, 'strain'),
        'modes': None if modes is None else mode_figure(
            modes, [(axes[i].name, axes[i].unit) for i in modes.joints], ringdowns),
        'ringdowns': len(ringdowns), 'strongest': strongest(ringdowns),
        'ringdown_figure': ringdown_figure(ringdowns) if ringdowns else None,
        'ringdown_summary': summary(ringdowns), 'shortest': LEAST_SECONDS,
        'starts': start_rows(found.starts), 'fit': found.fit, 'runs': found.runs,
        'settings': settings_text()}


def strongest(ringdowns: Sequence[Ringdown]) -> list[tuple[Ringdown, str, str]]:
    """List the ring-downs, of many the strongest, with bag and pose for people."""
    chosen = sorted(ringdowns, key=lambda r: -r.amplitude)[:MOST_ROWS]
    # rounded before it is written: no minus before zero
    return [(ring, Path(ring.bag).name, ', '.join(f'{round(x, 2) + 0.0:.2f}' for x in ring.q))
            for ring in ringdowns if ring in chosen]


def start_rows(starts: Sequence[Start]) -> list[tuple[Start, str, str]]:
    """List the starts of the search with their shares and notes, the best one marked."""
    rows = []
    best = max((start.fit for start in starts), default=0.0)
    for start in sorted(starts, key=lambda start: (start.share or 0.0, start.factor)):
        notes = ['best'] if start.fit == best else []
        if not FACTORS[0] * 1.01 < start.factor < FACTORS[-1] * 0.99:
            notes.append('at the edge of what was tried')
        share = 'as described' if start.share is None else f'{100.0 * start.share:g} %'
        rows.append((start, share, ', '.join(notes)))
    return rows


def summary(ringdowns: Sequence[Ringdown]) -> str:
    """Say how far prediction and measurement are apart; empty where nothing can be compared."""
    parts = []
    for name, words in (('held', 'joints held'), ('simulated', 'along the measured motion')):
        pairs = [(r.measured, getattr(r, name)) for r in ringdowns
                 if getattr(r, name) is not None]
        if not pairs:
            continue
        frequency = np.median([abs(b.frequency / a.frequency - 1.0) for a, b in pairs])
        damping = np.median([b.damping - a.damping for a, b in pairs])
        sign = 'more' if damping > 0.0 else 'less'
        parts.append(f'{words} ({len(pairs)} of {len(ringdowns)}), the frequency is off by '
                     f'{100.0 * frequency:.1f} % and the damping ratio {sign} than measured by '
                     f'{100.0 * abs(damping):.2g} percentage points')
    return f'In the median: {"; ".join(parts)}.' if parts else ''


def settings_text() -> str:
    """Describe how the elastic model is searched."""
    low, high = FACTORS[0], FACTORS[-1]
    return (f'robust least squares on simulated against measured strain (Huber, from '
            f'{HUBER:g} standard deviations); {len(FACTORS)} stiffnesses from '
            f'{low:.2g} to {high:.2g} times the description tried on up to {EXCERPT:g} s, '
            f'with {len(STARTS)} shares of the gears in the compliance, the best '
            f'{sum(STARTS.values())} improved, two of them searched from; inner step '
            f'{1e3 * INNER_STEP:g} ms; {RUN_IN:g} s left out where a stretch begins in motion '
            f'without its past; standard errors from clusters of {CLUSTER:g} s')
