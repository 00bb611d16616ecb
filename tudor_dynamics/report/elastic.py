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

"""The report's section on the elastic model: what the bags say of the arm's physics."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.identification.elastic.modes import mode_map
from tudor_dynamics.identification.elastic.record import RUN_IN
from tudor_dynamics.identification.elastic.result import CLUSTER, HUBER, Identified, Start
from tudor_dynamics.identification.elastic.ringdowns import find_ringdowns, LEAST_SECONDS, Ringdown
from tudor_dynamics.identification.elastic.starts import EXCERPT, FACTORS, STARTS
from tudor_dynamics.identification.fit import FitResult
from tudor_dynamics.models.elastic.arm import INNER_STEP
from tudor_dynamics.models.elastic.fitted import driven_arm
from tudor_dynamics.models.elastic.fitted import PhysicalParameter
from tudor_dynamics.models.elastic.parameters import in_words
from tudor_dynamics.models.units import output_units
from tudor_dynamics.report.data import joint_axes
from tudor_dynamics.report.elastic_rows import (
    ElasticSection, GaugeRow, ParameterRow, RingRow, StartRow)
from tudor_dynamics.report.modes import mode_figure, ringdown_figure

MOST_ROWS = 24
"""Ring-downs in the table; the figure has all."""
NOT_SHOWN = 'not shown by these bags'


def elastic_section(result: FitResult) -> ElasticSection | None:
    """
    Collect what the page shows of the elastic model.

    Returns None where no elastic model was fitted.
    """
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
    units = output_units(arm, 'strain')
    return ElasticSection(
        tuple(_parameter(p, described[p.name]) for p in found.physical), values['payload'],
        result.settings.payloads is not None, gauge_rows(arm, found, units),
        None if modes is None else mode_figure(
            modes, [(axes[i].name, axes[i].unit) for i in modes.joints], ringdowns),
        len(ringdowns), ring_rows(ringdowns, units),
        ringdown_figure(ringdowns) if ringdowns else None, summary(ringdowns), LEAST_SECONDS,
        start_rows(found.starts), found.fit, found.runs, settings_text())


def _parameter(parameter: PhysicalParameter, described: float) -> ParameterRow:
    return ParameterRow(
        in_words(parameter.name), parameter.name, parameter.value, parameter.unit,
        parameter.standard_error, described, '' if parameter.shown else NOT_SHOWN)


def gauge_rows(
    arm: Arm, found: Identified, units: dict[str, str],
) -> tuple[GaugeRow, ...]:
    """List gains and offsets."""
    return tuple(
        GaugeRow(name, float(value[0]), float(error[0]), f'({units[name]})/(N m)',
                 float(value[1]), float(error[1]), units[name])
        for name, value, error in
        zip(arm.gauge_names, found.gauges, found.gauge_errors, strict=True))


def ring_rows(ringdowns: Sequence[Ringdown], units: dict[str, str]) -> tuple[RingRow, ...]:
    """List the ring-downs, of many the strongest."""
    strongest = sorted(ringdowns, key=lambda r: -r.amplitude)[:MOST_ROWS]
    return tuple(
        # rounded before it is written: no minus before zero
        RingRow(Path(ring.bag).name, ', '.join(f'{round(x, 2) + 0.0:.2f}' for x in ring.q),
                units[ring.gauge], ring)
        for ring in ringdowns if ring in strongest)


def start_rows(starts: Sequence[Start]) -> tuple[StartRow, ...]:
    """List the starts of the search, the best one marked."""
    rows = []
    best = max((start.fit for start in starts), default=0.0)
    for start in sorted(starts, key=lambda start: (start.share or 0.0, start.factor)):
        notes = ['best'] if start.fit == best else []
        if not FACTORS[0] * 1.01 < start.factor < FACTORS[-1] * 0.99:
            notes.append('at the edge of what was tried')
        share = 'as described' if start.share is None else f'{100.0 * start.share:g} %'
        rows.append(StartRow(start.factor, share, start.fit, ', '.join(notes)))
    return tuple(rows)


def summary(ringdowns: Sequence[Ringdown]) -> str:
    """
    Say in a sentence how far prediction and measurement are apart.

    Returns an empty string where there is nothing to compare.
    """
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
    if not parts:
        return ''
    text = 'In the median: ' + '; '.join(parts) + '.'
    return text


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
