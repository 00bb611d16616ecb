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

"""The report of a fit: one HTML file that needs nothing else, neither network nor scripts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jinja2

from tudor_dynamics._version import __version__
from tudor_dynamics.identification.fit import FitResult, FittedOutput
from tudor_dynamics.identification.planned import Comparison
from tudor_dynamics.identification.verdict import GOOD_FIT, USABLE_FIT
from tudor_dynamics.identification.worth.assessment import assess, Assessment
from tudor_dynamics.models.kinds import KINDS
from tudor_dynamics.models.units import output_units
from tudor_dynamics.report import data as report_data, tables as report_tables
from tudor_dynamics.report.before_after import before_after
from tudor_dynamics.report.coverage import density_figure, pair_figure
from tudor_dynamics.report.elastic import elastic_section
from tudor_dynamics.report.elastic_rows import ElasticSection
from tudor_dynamics.report.plots import error_figure, signal_figure
from tudor_dynamics.report.wording import number, pretty_unit

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
    groups: tuple[report_tables.CoefficientGroup, ...]  # coefficients of the analytical model


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
        overall=report_tables.overall(result.fitted, assessment.detects), ringing=ringing,
        elastic=elastic, joints=result.arm.active_joints, bags=report_tables.bag_rows(result))


def sections(
    result: FitResult, assessment: Assessment, outputs: Sequence[OutputSection],
    elastic: ElasticSection | None, ringing: bool, planned: Comparison | None = None,
) -> list[PageSection]:
    """List the sections of the page, each with all that it shows."""
    bags, warnings = report_tables.bag_rows(result), report_tables.other_warnings(result)
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
            'outputs': outputs, 'uncertain': report_tables.UNCERTAIN}))
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
            'unused': result.unused, 'shown': report_tables.SHOWN,
            'sampled': len(result.training) if len(result.learned) > len(result.training) else 0
        }),
        PageSection('settings', 'Preprocessing and settings', 'settings', {
            **kinds, 'outputs': outputs, 'settings': result.settings,
            'preprocessing': report_tables.preprocessing_rows(
                result.preprocessing, report_tables.sample_rate(result))}),
        PageSection('reading', 'How to read this', 'reading', {
            **kinds, 'good_fit': GOOD_FIT, 'usable_fit': USABLE_FIT,
            'good_condition': report_tables.GOOD_CONDITION}),
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
              for group in report_tables.coefficient_groups(item, result.arm)))


def _ringing(result: FitResult) -> list[dict[str, Any]]:
    """Vibrations with their units: they stand in the last output with an analytical model."""
    rigid = [item.output for item in result.fitted if item.kind == 'analytical']
    units = output_units(result.arm, rigid[-1]) if rigid else {}
    return [{'channel': item.channel, 'frequency': item.frequency, 'rms': item.rms,
             'share': 100.0 * item.share, 'unit': units[item.channel]}
            for item in result.ringing]
