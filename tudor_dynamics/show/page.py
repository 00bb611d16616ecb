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

from collections.abc import Sequence
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

import jinja2
from matplotlib.figure import Figure
import numpy as np

from tudor_dynamics._version import __version__
from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.identification.doctor.between import Evaluated
from tudor_dynamics.identification.fit import FitResult, FittedOutput
from tudor_dynamics.identification.next_steps import assess, Assessment, Comparison, ErrorChange
from tudor_dynamics.identification.validation import (
    GOOD_FIT, Grade, LARGEST_CONDITION, USABLE_FIT, Validation)
from tudor_dynamics.load.offline import Leftover, PayloadEstimate
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.comparison import (
    body_row, described_bodies, described_parameters_of, full_parameters_of, relative_errors)
from tudor_dynamics.models.elastic.parameters import in_words
from tudor_dynamics.models.kinds import KINDS
from tudor_dynamics.models.regressor import output_units
from tudor_dynamics.show import figures as report_data
from tudor_dynamics.show.elastic import elastic_section
from tudor_dynamics.show.figures import (
    BLUE, density_figure, error_figure, label, new_cells, number, on_page, PAGE_MEASURED,
    pair_figure, pretty_unit, signal_figure, thin)


UNCERTAIN = 30.0
"""Relative standard error above which a coefficient is marked [%]."""
SHOWN = 50
"""Bags that a page lists."""
GOOD_CONDITION = 100.0
"""Condition number up to which least squares is said to be well conditioned (Gautier)."""


@dataclass(frozen=True)
class Overall:
    """Verdict over all models: a level for the colour, a word, and a sentence."""

    level: str  # level of the worst output, for the colour
    word: str  # verdict in a word
    sentence: str  # verdict in a sentence


def headline(fitted: Sequence[FittedOutput]) -> list[FittedOutput]:
    """Leave kinds out that are there for comparison, unless they are all that there is."""
    return [item for item in fitted if not KINDS[item.kind].compared] or list(fitted)


def overall(
    fitted: Sequence[FittedOutput], detects: Grade | None = None,
) -> Overall:
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
            return Overall(Grade.USABLE.name.lower(), 'usable to detect collisions',
                           sentence[only] + ' But they detect collisions: see below.')
        return Overall(only.name.lower(), only.value, sentence[only])
    text = '; '.join(f'{level.value}: {", ".join(names[level])}' for level in levels) + '.'
    worst = Grade.USABLE
    word = 'usable in part' if names[Grade.DO_NOT_USE] else 'usable'
    return Overall(worst.name.lower(), word, text[0].upper() + text[1:])


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
        group['conditioning'] = _conditioning(group['condition'], excited)
    return groups


def _conditioning(condition: float, excited: bool) -> str:
    if not excited:
        return 'the motion does not show every parameter; the rest are determined'
    if condition <= GOOD_CONDITION:
        return 'well conditioned'
    if condition <= LARGEST_CONDITION:
        return 'some parameters are hard to tell apart; their standard errors say which'
    return 'badly conditioned: predictions hold on similar motion only'


def preprocessing_rows(spec: PreprocessingSpec, sample_rate: float) -> list[tuple[str, str]]:
    """Describe filters and rate: sample_rate [Hz]."""
    rows = []
    if spec.filter == 'causal':
        rows += [
            ('Filters', 'causal, as they run next to the robot'),
            ('Velocity', f'difference quotient, first-order low-pass {spec.velocity_cutoff:g} Hz'),
            ('Acceleration', 'difference quotient of the velocity, first-order low-pass '
                             f'{spec.acceleration_cutoff:g} Hz'),
            ('Low-pass over positions, velocities and outputs',
             'none' if spec.output_cutoff is None else f'{spec.output_cutoff:g} Hz')]
    else:
        cutoff = spec.cutoff or sample_rate / 10.0
        rows += [('Filters', f'zero-phase (offline only), Butterworth {cutoff:g} Hz')]
    rows += [
        ('Velocity of the driver', 'used where a bag has it' if spec.measured_velocity else
         'not used'),
        ('Rate', 'every sample' if spec.rate is None else f'decimated to {spec.rate:g} Hz'),
        ('Left out at the start of each stretch' +
         (', and at its end' if spec.filter == 'zero_phase' else ''), f'{spec.settle:g} s')]
    return rows


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


TITLES = {'effort': 'Effort', 'strain': 'Strain'}


def render(
    result: FitResult, assessment: Assessment | None = None, planned: Comparison | None = None,
) -> str:
    """Render the report of a fit: sections with their templates, and what all of them show."""
    assessment = assess(result) if assessment is None else assessment
    outputs = [_output(result, output) for output in
               dict.fromkeys(item.output for item in result.fitted)]
    elastic, before = elastic_section(result), before_after(result)
    bags = [('training', bag) for bag in result.learned]
    bags += [('validation', bag) for bag in result.judged]
    of_bags = {warning for _, bag in bags for warning in bag.warnings}
    warnings = [warning for warning in result.warnings if warning not in of_bags]
    axes = report_data.joint_axes(result)
    pairs = report_data.joint_pairs(axes)
    sections = [
        ('verdict', 'Verdict', True), ('doctor', 'Doctor', True), ('figures', 'Figures', True),
        *((output['key'], f'{output["title"]} over time', True) for output in outputs),
        ('coefficients', 'Coefficients', any(output['groups'] for output in outputs)),
        ('before', 'Before and after', before is not None),
        ('planned', 'What was planned', planned is not None),
        ('elastic', 'Elastic arm', elastic is not None),
        ('choices', 'What was chosen', bool(result.choices) or result.causal is not None),
        ('coverage', 'Coverage', True), ('bags', 'Bags and warnings', True),
        ('settings', 'Preprocessing and settings', True),
        ('reading', 'How to read this', True), ('next', 'What to do next', True)]
    return rendered(
        'page', arm=result.arm.name, joints=result.arm.active_joints,
        sections=[(anchor, title) for anchor, title, there in sections if there],
        overall=overall((result.causal or result).fitted, assessment.detects),
        ringing=_ringing(result),
        analytical=any(item.kind == 'analytical' for item in result.fitted),
        fitted=result.fitted, outputs=outputs, elastic=elastic, before=before,
        assessment=assessment, findings=result.findings, uncertain=UNCERTAIN,
        comparison=planned, ratios=None if planned is None else planned.ratios(),
        choices=result.choices, causal=() if result.causal is None else result.causal.fitted,
        separate=bool(result.test), coverage=report_data.coverage(result),
        density=density_figure(axes), pairs=pair_figure(pairs) if pairs else None,
        bags=bags, warnings=warnings,
        n_warnings=len(warnings) + sum(len(bag.warnings) for _, bag in bags),
        unused=result.unused, shown=SHOWN, trained=len(result.learned),
        sampled=len(result.training) if len(result.learned) > len(result.training) else 0,
        settings=result.settings, preprocessing=preprocessing_rows(
            result.preprocessing, 1.0 / result.training[0].recording.dt),
        good_fit=GOOD_FIT, usable_fit=USABLE_FIT, good_condition=GOOD_CONDITION,
        steps=assessment.steps)


def rendered(template: str, **values: Any) -> str:
    """Render a page; paths that are no UTF-8 do not stop it."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / 'templates'), autoescape=True,
        undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {'number': number, 'unit': pretty_unit, 'in_words': in_words,
                            'kind': lambda kind: KINDS[kind].label}
    text = environment.get_template(f'{template}.html.j2').render(version=__version__, **values)
    return text.encode('utf-8', errors='replace').decode()


def _output(result: FitResult, output: str) -> dict[str, Any]:
    """Collect what templates show of one output; ``unit`` is empty where channels differ in it."""
    fitted = tuple(item for item in result.fitted if item.output == output)
    units = output_units(result.arm, output)
    unit = units[fitted[0].validation.channels[0]]
    trace = fitted[0].validation.traces[0]
    stretch = report_data.liveliest(trace, (*result.test, *result.training))
    judged = {item.kind: item.validation for item in fitted}
    return {
        'key': output, 'title': TITLES[output], 'units': units,
        'unit': unit if set(units.values()) == {unit} else '', 'fitted': fitted, 'bag': trace.bag,
        'signals': [(name, signal_figure(series, stretch)) for name, series
                    in report_data.channel_series(result.arm, output, judged).items()],
        'errors': error_figure(result.arm, output, judged),
        'groups': [group for item in fitted for group in coefficient_groups(item, result.arm)]}


def _ringing(result: FitResult) -> list[dict[str, Any]]:
    """Vibrations with their units: they stand in the last output with an analytical model."""
    rigid = [item.output for item in result.fitted if item.kind == 'analytical']
    units = output_units(result.arm, rigid[-1]) if rigid else {}
    return [{'channel': item.channel, 'frequency': item.frequency, 'rms': item.rms,
             'share': 100.0 * item.share, 'unit': units[item.channel]}
            for item in result.ringing]


# -- The page of an evaluation, with loads that the model did not know of

WITH_LOAD: dict[str, Any] = {'color': BLUE, 'linewidth': 0.9, 'linestyle': '-'}
COLUMNS = 2
"""Channels beside each other."""


def load_values(load: PayloadEstimate) -> list[tuple[str, str, float, float]]:
    """List what is known of a load: name, unit, value, standard deviation."""
    if math.isnan(load.mass):
        found = [("Part of the arm's own moment", '%', 100.0 * load.relative,
                  100.0 * load.relative_std)]
    else:
        found = [('Mass beyond what the model knows', 'kg', load.mass - load.known,
                  load.mass_std)]
    found += [(f'Centre {axis}', 'm', float(value), float(std))
              for axis, value, std in zip('xyz', load.com, load.com_std, strict=True)]
    found += [(f'Inertia {axes}', 'kg m^2', float(value), float(std)) for axes, value, std in zip(
        ('xx', 'xy', 'yy', 'xz', 'yz', 'zz'), load.inertia, load.inertia_std, strict=True)]
    return [row for row in found if math.isfinite(row[2])]


def load_shares(arm: Arm, load: PayloadEstimate) -> list[tuple[str, str, float, float, float]]:
    """List channels: name, unit, residual (rms) without and with a load, its share [%]."""
    return [(name, output_units(arm, item.output)[name], float(before), float(after),
             100.0 * float(share))
            for item in load.outputs for name, before, after, share in zip(
                item.leftover.channels, *item.leftover.sizes(), item.leftover.shares(),
                strict=True)]


@on_page
def load_figure(arm: Arm, load: PayloadEstimate) -> Figure:
    """Draw the residual of each channel without and with the load."""
    panels: list[tuple[Leftover, int, str]] = []
    for item in load.outputs:
        units = output_units(arm, item.output)
        panels += [(item.leftover, place, units[name])
                   for place, name in enumerate(item.leftover.channels)]
    figure, cells = new_cells(len(panels), COLUMNS, 1.35, (0.45, 0.55), between=0.8)
    for one, (left, place, unit) in zip(cells, panels, strict=True):
        one.plot(*thin(left.t, left.before[:, place]), **PAGE_MEASURED, label='without the load')
        one.plot(*thin(left.t, left.after[:, place]), **WITH_LOAD, label='with the load')
        one.set_ylabel(label(left.channels[place], unit)).set_parse_math(False)
        one.set_xlabel('time [s]')
        one.margins(x=0.01)
    figure.legend(*cells[0].get_legend_handles_labels(), loc='upper right', ncol=2)
    return figure


def evaluation_page(
    bundle: ModelBundle, bags: Sequence[str], outputs: dict[str, dict[str, Validation]],
    evaluated: Evaluated, worse: Sequence[ErrorChange],
) -> str:
    """Render the page."""
    rows = [{'kind': kind, 'channel': name, 'score': score,
             'unit': output_units(bundle.arm, output)[name]}
            for output, kinds in outputs.items() for kind, item in kinds.items()
            for name, score in item.score.channels.items()]
    loads = [{'bag': bag, 'estimate': load, 'found': load_values(load),
              'channels': load_shares(bundle.arm, load), 'figure': load_figure(bundle.arm, load)}
             for bag, load in evaluated.loads.items()]
    return rendered('evaluation', arm=bundle.arm.name, bags=bags, rows=rows, worse=worse,
                    findings=evaluated.findings, loads=loads)
