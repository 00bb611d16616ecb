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
from dataclasses import dataclass, replace
import math
from pathlib import Path
from typing import Any

import jinja2

from tudor_dynamics._version import __version__
from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.identification.dataset import BagFacts
from tudor_dynamics.identification.doctor.between import Evaluated
from tudor_dynamics.identification.fit import FitResult, FittedOutput
from tudor_dynamics.identification.next_steps import assess, Assessment, Comparison, ErrorChange
from tudor_dynamics.identification.validation import (
    GOOD_FIT, Grade, LARGEST_CONDITION, USABLE_FIT, Validation)
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.kinds import KINDS
from tudor_dynamics.models.regressor import output_units
from tudor_dynamics.show import figures as report_data
from tudor_dynamics.show.bodies import before_after, load_section
from tudor_dynamics.show.elastic import elastic_section, ElasticSection
from tudor_dynamics.show.figures import (
    density_figure, error_figure, number, pair_figure, pretty_unit, signal_figure)


# -- Rows of the report's tables, and the words for verdict, conditioning and preprocessing

UNCERTAIN = 30.0
"""Relative standard error above which a coefficient is marked [%]."""
SHOWN = 50
"""Bags that a page lists."""
GOOD_CONDITION = 100.0
"""Condition number up to which least squares is said to be well conditioned (Gautier)."""


@dataclass(frozen=True)
class Coefficient:
    """One row of the table of coefficients; ``relative_error`` in percent."""

    name: str  # name of the parameter
    value: float  # estimate in its unit
    unit: str  # unit of the value
    standard_error: float  # standard deviation, in the same unit
    relative_error: float  # standard deviation over value [%]
    note: str  # whether it is uncertain, or not excited


@dataclass(frozen=True)
class CoefficientGroup:
    """Coefficients that some channels share, with their conditioning in words."""

    channels: tuple[str, ...]  # channels that share them
    condition: float  # condition number of the scaled regressor
    conditioning: str  # what that number means, in words
    rows: tuple[Coefficient, ...]  # a row for each parameter


@dataclass(frozen=True)
class BagRow:
    """A bag of the fit; times in seconds."""

    name: str  # bag, or part of one
    role: str  # whether it was learned from or judged by
    recorded: int  # samples as recorded
    used: int  # samples that are left after decimation
    duration: float  # length of the bag [s]
    rate: float  # samples per second as recorded [Hz]
    gaps: int  # number of gaps
    longest_gap: float  # length of the longest gap [s]
    dropped: str  # messages that were left out, in words
    checksum: str  # SHA-256 over the storage files
    warnings: tuple[str, ...]  # what is odd about the bag


@dataclass(frozen=True)
class Overall:
    """Verdict over all models: a level for the colour, a word, and a sentence."""

    level: str  # level of the worst output, for the colour
    word: str  # verdict in a word
    sentence: str  # verdict in a sentence


def model_name(item: FittedOutput) -> str:
    """Name a model: its output and kind."""
    return f'{item.output} {KINDS[item.kind].label}'


def headline(fitted: Sequence[FittedOutput]) -> list[FittedOutput]:
    """Leave kinds out that are there for comparison, unless they are all that there is."""
    return [item for item in fitted if not KINDS[item.kind].compared] or list(fitted)


def overall(
    fitted: Sequence[FittedOutput], detects: Grade | None = None,
) -> Overall:
    """Sum the verdicts up."""
    fitted = headline(fitted)
    names = {level: [model_name(item) for item in fitted if item.verdict.level is level]
             for level in Grade}
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


def coefficient_groups(item: FittedOutput, arm: Arm) -> list[CoefficientGroup]:
    """List the coefficients of a model that mean something by themselves."""
    groups = []
    for group in item.model.estimated(arm, item.output):
        rows = []
        for row in group['coefficients']:
            value, error = row['value'], row['standard_error']
            relative = 100.0 * error / abs(value) if value else math.inf
            note = ('not excited' if not row['excited'] else
                    'uncertain' if relative > UNCERTAIN else '')
            rows.append(Coefficient(row['name'], value, row['unit'], error, relative, note))
        excited = all(row['excited'] for row in group['coefficients'])
        groups.append(CoefficientGroup(
            tuple(group['channels']), group['condition'],
            _conditioning(group['condition'], excited), tuple(rows)))
    return groups


def _conditioning(condition: float, excited: bool) -> str:
    if not excited:
        return 'the motion does not show every parameter; the rest are determined'
    if condition <= GOOD_CONDITION:
        return 'well conditioned'
    if condition <= LARGEST_CONDITION:
        return 'some parameters are hard to tell apart; their standard errors say which'
    return 'badly conditioned: predictions hold on similar motion only'


def bag_rows(result: FitResult) -> list[BagRow]:
    """List the bags of a fit, training first."""
    return [_bag_row(bag, role) for role, bags in
            (('training', result.learned), ('validation', result.judged)) for bag in bags]


def _bag_row(bag: BagFacts, role: str) -> BagRow:
    dropped = ', '.join(f'{count} {cause}' for cause, count in sorted(bag.dropped.items())
                        if count)
    return BagRow(bag.bag, role, bag.recorded, bag.used, bag.duration, bag.rate, bag.gaps,
                  bag.longest_gap, dropped or 'none', bag.checksum[:12], bag.warnings)


def other_warnings(result: FitResult) -> list[str]:
    """Give the warnings that no single bag is to blame for."""
    of_bags = {warning for bag in (*result.learned, *result.judged) for warning in bag.warnings}
    return [warning for warning in result.warnings if warning not in of_bags]


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


def sample_rate(result: FitResult) -> float:
    """Give the rate of the first training bag [Hz]."""
    return 1.0 / result.training[0].recording.dt


# -- The report of a fit: one HTML file that needs nothing else, neither network nor scripts

TITLES = {'effort': 'Effort', 'strain': 'Strain'}


@dataclass(frozen=True, eq=False)
class PageSection:
    """A section of the page."""

    # Its place, and what the contents call it.
    anchor: str
    title: str
    template: str  # file of `templates/` without its suffix
    context: dict[str, Any]  # what the template shows
    html: str = ''  # what it came to


@dataclass(frozen=True, eq=False)
class SignalPlot:
    """Figure of one channel, as data URI."""

    channel: str  # name of the channel
    figure: str  # the figure as data URI


@dataclass(frozen=True, eq=False)
class OutputSection:
    """All that the page shows of one output; ``unit`` is empty where channels differ in it."""

    key: str  # output, `effort` or `strain`
    title: str  # heading of the section
    unit: str  # unit of all channels; empty where they differ
    units: dict[str, str]  # unit of each channel
    fitted: tuple[FittedOutput, ...]  # models of the output
    bag: str  # bag that is drawn
    signals: tuple[SignalPlot, ...]  # a figure for each channel
    errors: str  # figure of the errors as data URI
    groups: tuple[CoefficientGroup, ...]  # coefficients of the analytical model


def report_bytes(
    result: FitResult, assessment: Assessment | None = None, *, date: str | None = None,
    planned: Comparison | None = None,
) -> bytes:
    """
    Render the report as the file that it becomes; paths that are no UTF-8 do not stop it.

    date: today by default.
    """
    return render(result, assessment, date=date, planned=planned).encode('utf-8', errors='replace')


def render(
    result: FitResult, assessment: Assessment | None = None, *, date: str | None = None,
    planned: Comparison | None = None,
) -> str:
    """Render the report of a fit."""
    environment = _environment()
    assessment = assess(result) if assessment is None else assessment
    outputs = [_output(result, output) for output in
               dict.fromkeys(item.output for item in result.fitted)]
    elastic, ringing = elastic_section(result), _ringing(result)
    parts = [replace(section, html=environment.get_template(
        f'{section.template}.html.j2').render(section.context))
        for section in sections(result, assessment, outputs, elastic, bool(ringing), planned)]
    return environment.get_template('page.html.j2').render(
        arm=result.arm.name, date=date, version=__version__, sections=parts, outputs=outputs,
        overall=overall(result.fitted, assessment.detects), ringing=ringing,
        elastic=elastic, joints=result.arm.active_joints, bags=bag_rows(result))


def sections(
    result: FitResult, assessment: Assessment, outputs: Sequence[OutputSection],
    elastic: ElasticSection | None, ringing: bool, planned: Comparison | None = None,
) -> list[PageSection]:
    """List the sections of the page, each with all that it shows."""
    bags, warnings = bag_rows(result), other_warnings(result)
    analytical = any(item.kind == 'analytical' for item in result.fitted)
    kinds = {'analytical': analytical, 'elastic': elastic, 'fitted': result.fitted}
    number_of_warnings = len(warnings) + sum(len(bag.warnings) for bag in bags)
    axes = report_data.joint_axes(result)
    pairs = report_data.joint_pairs(axes)
    found = [
        PageSection('verdict', 'Verdict', 'verdict', {
            **kinds, 'ringing': ringing, 'n_warnings': number_of_warnings,
            'assessment': assessment}),
        PageSection('doctor', 'Doctor', 'doctor', {'findings': result.findings}),
        PageSection('figures', 'Figures', 'figures', {'outputs': outputs}),
        *(PageSection(output.key, f'{output.title} over time', 'signals', {'output': output})
          for output in outputs)]
    if any(output.groups for output in outputs):
        found.append(PageSection('coefficients', 'Coefficients', 'coefficients', {
            'outputs': outputs, 'uncertain': UNCERTAIN}))
    before = before_after(result)
    if before is not None:
        found.append(PageSection('before', 'Before and after', 'before', {'before': before}))
    if planned is not None:
        found.append(PageSection('planned', 'What was planned', 'planned', {
            'comparison': planned, 'ratios': planned.ratios()}))
    if elastic is not None:
        found.append(PageSection('elastic', 'Elastic arm', 'elastic', {
            'elastic': elastic, 'joints': result.arm.active_joints}))
    if result.choices or result.causal is not None:
        found.append(PageSection('choices', 'What was chosen', 'choices', {
            'choices': result.choices,
            'causal': () if result.causal is None else result.causal.fitted}))
    return [
        *found,
        PageSection('coverage', 'Coverage', 'coverage', {
            'separate': bool(result.test), 'coverage': report_data.coverage(result),
            'density': density_figure(axes), 'pairs': pair_figure(pairs) if pairs else None}),
        PageSection('bags', 'Bags and warnings', 'bags', {
            'bags': bags, 'warnings': warnings, 'n_warnings': number_of_warnings,
            'unused': result.unused, 'shown': SHOWN,
            'sampled': len(result.training) if len(result.learned) > len(result.training) else 0
        }),
        PageSection('settings', 'Preprocessing and settings', 'settings', {
            **kinds, 'outputs': outputs, 'settings': result.settings,
            'preprocessing': preprocessing_rows(
                result.preprocessing, sample_rate(result))}),
        PageSection('reading', 'How to read this', 'reading', {
            **kinds, 'good_fit': GOOD_FIT, 'usable_fit': USABLE_FIT,
            'good_condition': GOOD_CONDITION}),
        PageSection('next', 'What to do next', 'next', {'steps': assessment.steps})]


def rendered(template: str, **values: Any) -> str:
    """Render another page of the same style."""
    return _environment().get_template(f'{template}.html.j2').render(
        version=__version__, **values)


def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / 'templates'), autoescape=True,
        undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters['number'] = number
    environment.filters['unit'] = pretty_unit
    environment.filters['kind'] = lambda kind: KINDS[kind].label
    return environment


def _output(result: FitResult, output: str) -> OutputSection:
    fitted = tuple(item for item in result.fitted if item.output == output)
    units = output_units(result.arm, output)
    unit = units[fitted[0].validation.channels[0]]
    trace = fitted[0].validation.traces[0]
    stretch = report_data.liveliest(trace, (*result.test, *result.training))
    return OutputSection(
        output, TITLES[output], unit if set(units.values()) == {unit} else '', units, fitted,
        trace.bag,
        tuple(SignalPlot(series.name, signal_figure(series, stretch))
              for series in report_data.channel_series(fitted, result.arm)),
        error_figure(report_data.channel_errors(fitted, result.arm)),
        tuple(group for item in fitted
              for group in coefficient_groups(item, result.arm)))


def _ringing(result: FitResult) -> list[dict[str, Any]]:
    """Vibrations with their units: they stand in the last output with an analytical model."""
    rigid = [item.output for item in result.fitted if item.kind == 'analytical']
    units = output_units(result.arm, rigid[-1]) if rigid else {}
    return [{'channel': item.channel, 'frequency': item.frequency, 'rms': item.rms,
             'share': 100.0 * item.share, 'unit': units[item.channel]}
            for item in result.ringing]


# -- The page of an evaluation: figures of a model on other bags, and a load where one is found

def evaluation_page(
    bundle: ModelBundle, bags: Sequence[str], outputs: dict[str, dict[str, Validation]],
    evaluated: Evaluated, worse: Sequence[ErrorChange],
) -> str:
    """Render the page."""
    rows = [{'output': output, 'kind': kind, 'channel': name, 'score': score,
             'unit': output_units(bundle.arm, output)[name]}
            for output, kinds in outputs.items() for kind, item in kinds.items()
            for name, score in item.score.channels.items()]
    return rendered('evaluation', arm=bundle.arm.name, bags=bags, rows=rows, worse=worse,
                    findings=evaluated.findings,
                    loads=[load_section(bundle.arm, bag, told)
                           for bag, told in evaluated.loads.items()])
