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

"""The report of a fit or an evaluation: one HTML file that needs nothing else."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import hashlib
import math
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup
import numpy as np

from tudor_dynamics._version import __version__
from tudor_dynamics.arm.description import Arm
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.identification.detection import (
    EVENT_NAMES, event_notes, event_table, MethodResult)
from tudor_dynamics.identification.doctor.between import Evaluated
from tudor_dynamics.identification.elastic_problem import CLUSTER, HUBER, RUN_IN, Start
from tudor_dynamics.identification.elastic_search import EXCERPT, FACTORS, STARTS
from tudor_dynamics.identification.fit import FitResult, FittedOutput, headline
from tudor_dynamics.identification.next_steps import (
    assess, Assessment, changes, Comparison, ErrorChange)
from tudor_dynamics.identification.ringdowns import (
    find_ringdowns, LEAST_SECONDS, mode_map, Ringdown)
from tudor_dynamics.identification.validation import (
    GOOD_FIT, Grade, LARGEST_CONDITION, shown_fit, USABLE_FIT, Validation)
from tudor_dynamics.load.offline import PayloadEstimate
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import KINDS, ModelBundle
from tudor_dynamics.models.comparison import (
    body_row, described_bodies, described_parameters_of, full_parameters_of, relative_errors)
from tudor_dynamics.models.elastic.model import driven_arm
from tudor_dynamics.models.elastic.parameters import in_words
from tudor_dynamics.models.regressor import output_units
from tudor_dynamics.models.settings import INNER_STEP, OBSERVED
from tudor_dynamics.show.figures import (
    arm_figure, coverage, decimated, density_figure, encoded, error_figure,
    event_figure, joint_axes, joint_pairs, label, liveliest, mode_figure, number, pair_figure,
    panel, Plot, pretty_unit, ringdown_figure, roc_figure, signal_figure, threshold_figure, trace)


UNCERTAIN = 30.0  # relative standard error above which a coefficient is marked [%]
SHOWN = 50  # bags that a page lists
GOOD_CONDITION = 100.0
"""Condition number up to which least squares is said to be well conditioned (Gautier)."""


@dataclass(frozen=True)
class LastFit:
    """A fit that another one is compared with."""

    path: str  # of its bundle
    facts: Mapping[str, Any]  # of its bundle


@dataclass(frozen=True)
class Overall:
    """Verdict over all models: a level for the colour, a word, and a sentence."""

    level: str  # level of the worst output, for the colour
    word: str  # verdict in a word
    sentence: str  # verdict in a sentence


def overall(fitted: Sequence[FittedOutput], detects: Grade | None = None) -> Overall:
    """Sum the verdicts up."""
    fitted = headline(fitted)
    names = {level: [f'{item.output} {KINDS[item.kind].label}' for item in fitted
                     if item.verdict.level is level] for level in Grade}
    levels = [level for level in Grade if names[level]]
    if len(levels) == 1:
        sentence = {
            Grade.GOOD: 'Every model may be used on motion like that of the bags.',
            Grade.USABLE: 'Every model may be used with care: mind the reasons below.',
            Grade.DO_NOT_USE: 'None of the models predicts well enough to be relied on.'}
        only = levels[0]
        if only is Grade.DO_NOT_USE and detects is Grade.GOOD:
            return Overall('usable', 'usable to detect collisions',
                           sentence[only] + ' But they detect collisions: see below.')
        return Overall(only.name.lower(), only.value, sentence[only])
    text = '; '.join(f'{level.value}: {", ".join(names[level])}' for level in levels) + '.'
    word = 'usable in part' if names[Grade.DO_NOT_USE] else 'usable'
    return Overall('usable', word, text[0].upper() + text[1:])


def coefficient_groups(item: FittedOutput, arm: Arm) -> list[dict[str, Any]]:
    """List coefficients as `Model.estimated` does, in words, with errors [%] and notes."""
    groups = item.model.estimated(arm, item.output)
    for group in groups:
        for row in group['coefficients']:
            value, error = row['value'], row['standard_error']
            row['relative_error'] = 100.0 * error / abs(value) if value else math.inf
            row['note'] = ('not excited' if not row['excited'] else
                           'uncertain' if row['relative_error'] > UNCERTAIN else '')
        excited = all(row['excited'] for row in group['coefficients'])
        group['conditioning'] = (
            'the motion does not show every parameter; the rest are determined'
            if not excited else 'well conditioned' if group['condition'] <= GOOD_CONDITION else
            'some parameters are hard to separate; their standard errors say which'
            if group['condition'] <= LARGEST_CONDITION else
            'badly conditioned: predictions hold on similar motion only')
    return groups


def before_after(result: FitResult) -> dict[str, Any] | None:
    """
    Compare an arm as described with an arm as identified, for `before.html.j2`.

    Returns ``bodies``: both bodies of each joint, the standard error of the identified mass [kg],
    and how many of ten parameters the recordings fix; ``joints``: relative errors of effort [%] on
    motion that nothing was fitted to, by bodies as described with the drives that suit them best,
    by identified ones that can exist, and by base parameters; ``assumed``: whether torque is known
    up to a factor only, so that masses are not absolute.
    """
    arm = result.arm
    fitted = next((item for item in result.fitted
                   if (item.output, item.kind) == ('effort', 'analytical')), None)
    before = described_bodies(arm)
    if fitted is None or not any(body[0] > 0.0 for body in before.values()):
        return None
    models = [fitted.model, *(model for model, _ in fitted.validation.cases)]
    if len(models) < 2 or not all(isinstance(model, AnalyticalModel) and model.data_
                                  and model.payload_range is None for model in models):
        return None
    errors = np.zeros((3, len(arm.active_joints)))
    for model, data in fitted.validation.cases:
        assert isinstance(model, AnalyticalModel)
        own = result.blind or arm
        for kind, judged in enumerate((described_parameters_of(own, model).model,
                                       full_parameters_of(own, model).model, model)):
            # a joint that shows nothing in a bag has no part in the mean square
            found = np.nan_to_num(relative_errors(judged, data.stretches))
            errors[kind] += found ** 2 / (len(models) - 1)
    assert isinstance(fitted.model, AnalyticalModel)
    full = full_parameters_of(arm, fitted.model)
    sources, mass_errors = full.sources(), full.solution.body_errors[:, 0].tolist()
    return {
        'bodies': [(body_row(joint, (arm, arm), (before[joint], body)), mass_errors[place],
                    sources[10 * place:10 * (place + 1)].count('data'))
                   for place, (joint, body) in enumerate(full.bodies.items())],
        'joints': list(zip(arm.active_joints, (100.0 * np.sqrt(errors)).T.tolist(), strict=True)),
        'assumed': full.assumed}


def render(
    result: FitResult, assessment: Assessment | None = None, planned: Comparison | None = None,
    made: Mapping[str, str] | None = None, last: LastFit | None = None,  # made: provenance
) -> str:
    """Render the report of a fit: what all of its sections show."""
    assessment = assess(result) if assessment is None else assessment
    outputs = [_output(result, assessment, output) for output in
               dict.fromkeys(item.output for item in result.fitted)]
    # vibrations stand in the last output with an analytical model
    rigid = [item.output for item in result.fitted if item.kind == 'analytical']
    units = output_units(result.arm, rigid[-1]) if rigid else {}
    elastic, before = elastic_section(result), before_after(result)
    bags = [('training', bag) for bag in result.learned]
    bags += [('validation', bag) for bag in result.judged]
    of_bags = {warning for _, bag in bags for warning in bag.warnings}
    warnings = [warning for warning in result.warnings if warning not in of_bags]
    axes = joint_axes(result)
    pairs = joint_pairs(axes)
    live = () if result.causal is None else result.causal.fitted
    return rendered(
        'page', arm=result.arm.name, joints=result.arm.active_joints,
        overall=overall((result.causal or result).fitted, assessment.detects),
        picture=arm_figure(result.arm, np.array([np.median(axis.training) for axis in axes])),
        ringing=[(item, units[item.channel]) for item in result.ringing], analytical=bool(rigid),
        judged=[*((item, 'beside the robot') for item in live),
                *((item, 'offline' if live else '') for item in result.fitted)],
        fitted=result.fitted, outputs=outputs, elastic=elastic, before=before,
        assessment=assessment, findings=result.findings, uncertain=UNCERTAIN,
        comparison=planned, ratios=None if planned is None else planned.ratios(),
        choices=result.choices, separate=bool(result.test), coverage=coverage(result),
        density=density_figure(axes), pairs=pair_figure(pairs) if pairs else None,
        bags=bags, warnings=warnings,
        n_warnings=len(warnings) + sum(len(bag.warnings) for _, bag in bags),
        unused=result.unused, shown=SHOWN, trained=len(result.learned),
        sampled=len(result.training) if len(result.learned) > len(result.training) else 0,
        settings=result.settings, spec=result.preprocessing,
        sample_rate=1.0 / result.training[0].recording.dt, good_fit=GOOD_FIT,
        usable_fit=USABLE_FIT, good_condition=GOOD_CONDITION, steps=assessment.steps,
        made=made or {}, last=last,
        judged_by=[bag.bag for bag in result.judged or result.learned],
        changes=() if last is None else changes(last.facts, {
            output['key']: {item.kind: item.validation for item in output['fitted']}
            for output in outputs}))


def rendered(template: str, **values: Any) -> str:
    """Render a page; paths that are no UTF-8 do not stop it."""
    from plotly.offline import get_plotlyjs  # slow to import

    folder = Path(__file__).parent / 'templates'
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder), autoescape=True,
        undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {'encoded': encoded, 'number': number, 'unit': pretty_unit,
                            'in_words': in_words, 'shown_fit': shown_fit,
                            'kind': lambda kind: KINDS[kind].label}
    # only these two scripts run, whatever stands in names
    scripts = [get_plotlyjs().strip(), (folder / 'report.js').read_text().strip()]
    allowed = [f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"
               for script in scripts]
    text = environment.get_template(f'{template}.html.j2').render(
        version=__version__, allowed=' '.join(allowed),
        scripts=[Markup(script) for script in scripts], **values)
    return text.encode('utf-8', errors='replace').decode()


def _output(result: FitResult, assessment: Assessment, output: str) -> dict[str, Any]:
    """Collect what templates show of one output; ``unit`` is empty where channels differ in it."""
    fitted = tuple(item for item in result.fitted if item.output == output)
    units = output_units(result.arm, output)
    unit = units[fitted[0].validation.channels[0]]
    limits = (threshold_figure(result, assessment, output, item.kind) for item in fitted)
    return {
        **over_time(result.arm, output, {item.kind: item.validation for item in fitted}),
        'units': units, 'unit': unit if set(units.values()) == {unit} else '', 'fitted': fitted,
        'limits': next((found for found in limits if found is not None), None),
        'groups': [group for item in fitted for group in coefficient_groups(item, result.arm)]}


def over_time(arm: Arm, output: str, judged: Mapping[str, Validation]) -> dict[str, Any]:
    """Collect what `signals.html.j2` shows of one output: its first bag, and all errors."""
    first = next(iter(judged.values()))
    stretch = liveliest(first.traces[0], [bag for _, bag in first.cases])
    return {
        'key': output, 'title': output.capitalize(), 'bag': first.traces[0].bag,
        'signals': [(name, signal_figure(arm, output, judged, name, stretch))
                    for name in first.channels],
        'errors': error_figure(arm, output, judged)}


# -- The section on the elastic model, with its modes and ring-downs

MOST_ROWS = 24  # ring-downs in the table; the figure has all
NOT_SHOWN = 'not shown by these bags'
SEARCHED = (
    f'robust least squares on simulated against measured strain (Huber, from {HUBER:g} standard '
    f'deviations); {len(FACTORS)} stiffnesses from {FACTORS[0]:.2g} to {FACTORS[-1]:.2g} times '
    f'the description tried on up to {EXCERPT:g} s, with {len(STARTS)} shares of the gears in the '
    f'compliance, the best {sum(STARTS.values())} improved, two of them searched from; inner step '
    f'{1e3 * INNER_STEP:g} ms; where a stretch begins in motion, its first {RUN_IN:g} s are not '
    f'fitted, and its validation takes the links from its first {OBSERVED:g} s of strain; '
    f'standard errors from clusters of {CLUSTER:g} s')
"""How the elastic model is searched."""


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
    gauges = np.column_stack([found.gauges, found.noise])
    ringdowns = find_ringdowns(driven, values, bags, gauges)
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
        'starts': start_rows(found.starts), 'fit': found.fit,
        'settings': SEARCHED}


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
        pairs = [(r.measured, getattr(r, name)) for r in ringdowns if getattr(r, name) is not None]
        if not pairs:
            continue
        frequency = np.median([abs(b.frequency / a.frequency - 1.0) for a, b in pairs])
        damping = np.median([b.damping - a.damping for a, b in pairs])
        sign = 'more' if damping > 0.0 else 'less'
        parts.append(f'{words} ({len(pairs)} of {len(ringdowns)}), the frequency is off by '
                     f'{100.0 * frequency:.1f} % and the damping ratio {sign} than measured by '
                     f'{100.0 * abs(damping):.2g} percentage points')
    return f'In the median: {"; ".join(parts)}.' if parts else ''


# -- The page of an evaluation, with loads that the model did not know of

def load_values(load: PayloadEstimate) -> list[tuple[str, str, float, float]]:
    """List what is known of a load: name, unit, value, standard deviation."""
    if math.isnan(load.mass):
        found = [("Part of the arm's own moment", '%', 100.0 * load.relative,
                  100.0 * load.relative_std)]
    else:
        found = [('Mass beyond that of the model', 'kg', load.mass - load.known, load.mass_std)]
    found += [(f'Centre {axis}', 'm', float(value), float(std))
              for axis, value, std in zip('xyz', load.com, load.com_std, strict=True)]
    found += [(f'Inertia {axes}', 'kg m^2', float(value), float(std)) for axes, value, std in zip(
        ('xx', 'xy', 'yy', 'xz', 'yz', 'zz'), load.inertia, load.inertia_std, strict=True)]
    return [row for row in found if math.isfinite(row[2])]


def load_figure(arm: Arm, load: PayloadEstimate) -> Plot:
    """Draw the residual of each channel without and with the load."""
    panels = []
    for item in load.outputs:
        left, units = item.leftover, output_units(arm, item.output)
        for place, name in enumerate(left.channels):
            t, before, after = decimated(left.t, left.before[:, place], left.after[:, place])
            panels.append(panel('', 'time [s]', label(name, units[name]),
                                trace('measured', t, before, 'without the load'),
                                trace('analytical', t, after, 'with the load')))
    return {'columns': 2, 'panels': panels, 'linked': True}


def evaluation_page(
    bundle: ModelBundle, bags: Sequence[str], outputs: dict[str, dict[str, Validation]],
    evaluated: Evaluated, worse: Sequence[ErrorChange], made: dict[str, str],
) -> str:
    """Render the page; made: provenance."""
    rows = [{'kind': kind, 'channel': name, 'score': score,
             'unit': output_units(bundle.arm, output)[name]}
            for output, kinds in outputs.items() for kind, item in kinds.items()
            for name, score in item.score.channels.items()]
    loads = [{'bag': bag, 'estimate': load, 'found': load_values(load),
              # name, unit, residual (rms) without and with the load, its share [%]
              'channels': [
                  (name, output_units(bundle.arm, item.output)[name], *map(float, sizes),
                   100.0 * float(share)) for item in load.outputs for name, *sizes, share in zip(
                       item.leftover.channels, *item.leftover.sizes(), item.leftover.shares(),
                       strict=True)],
              'figure': load_figure(bundle.arm, load)}
             for bag, load in evaluated.loads.items()]
    return rendered('evaluation', arm=bundle.arm.name, bags=bags, rows=rows, worse=worse,
                    findings=evaluated.findings, loads=loads, made=made, outputs=[
                        over_time(bundle.arm, *item) for item in outputs.items()])


MOST = 6  # bags whose ratios a page draws


def collision_page(
    bundle: ModelBundle, data: Sequence[BagData], results: Sequence[MethodResult], allowed: float,
    made: dict[str, str],
) -> str:
    """Render the page of what a detector found; allowed: false alarms per hour; made: as above."""
    bags = [str(bag.choice) for bag in data]
    curves = {item.method: item.roc for item in results if item.roc.pushes}
    pictures = [(f'{item.method}: {item.watched[bag].bag}', event_figure(item, bag))
                for bag in range(min(len(bags), MOST)) for item in results]
    return rendered(
        'collisions', arm=bundle.arm.name, picture=arm_figure(
            bundle.arm, np.median(np.vstack([bag.recording.q for bag in data]), axis=0)),
        bags=bags, results=results, per_hour=allowed, best=results[0], pictures=pictures,
        roc=roc_figure(curves) if curves else None, made=made, notes=event_notes(results),
        names=EVENT_NAMES,
        tables=[(bag, *event_table(results, place)) for place, bag in enumerate(bags)])
