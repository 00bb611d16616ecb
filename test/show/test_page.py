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

"""The report of a fit, on small arms simulated from their own regressors."""

from __future__ import annotations

import base64
from dataclasses import replace
import hashlib
from html.parser import HTMLParser
import json
from pathlib import Path
import re
from typing import Any

import numpy as np
from plotly.offline import get_plotlyjs
import pytest

from tudor_dynamics.arm.description import Arm, arm_from_dict
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification.dataset import BagChoice, BagData
from tudor_dynamics.identification.fit import fit_models, FitResult, FitSettings, FittedOutput
from tudor_dynamics.identification.loads import figures
from tudor_dynamics.identification.next_steps import assess
from tudor_dynamics.identification.ringdowns import Ringing
from tudor_dynamics.identification.uses import Use
from tudor_dynamics.identification.validation import Grade, Verdict
from tudor_dynamics.models.regressor import EffortRegressor, StrainRegressor
from tudor_dynamics.show.figures import (
    arm_figure, coverage, decimated, encoded, joint_pairs, JointPositions, liveliest, MAX_POINTS,
    number, panel, pretty_unit, trace)
from tudor_dynamics.show.page import coefficient_groups, LastFit, overall, render
from tudor_dynamics.signals.preprocessing import prepare

RATE = 100.0
SECONDS = 12.0
SMALL = FitSettings(kinds=('analytical', 'elm'), elm_hidden=20)
HOSTILE = '<script>alert(1)</script>"\' & $\\frac{x'


def planar_arm(n_joints: int = 2, *, gauges: int = 0, names: list[str] | None = None) -> Arm:
    """Build a planar arm of unit links with currents of unknown constants."""
    names = names or [f'axis{i + 1}' for i in range(n_joints)]
    return arm_from_dict({
        'name': 'planar', 'gravity': [0.0, -9.81, 0.0],
        'kinematics': {'dh': [[0.5, 0.0, 0.0, 0.0]] * n_joints},
        'joints': [{'name': name, 'effort': {'topic': 'motor_currents', 'unit': 'A'},
                    'rotor_inertia': False} for name in names],
        'gauges': [{'name': f'bridge{i + 1}', 'joint': names[i], 'distance': 0.05}
                   for i in range(gauges)],
    }, base=Path(), source='test')


def bag(
    arm: Arm, name: str, seed: int, *, effort: bool = True, strain: bool = False,
    warnings: tuple[str, ...] = (), noise: float = 0.02,
) -> BagData:
    """Simulate a bag: sums of sines, outputs from the regressor with all parameters one."""
    generator = np.random.default_rng(seed)
    n = len(arm.active_joints)
    t = np.arange(round(SECONDS * RATE)) / RATE
    q = np.zeros((len(t), n))
    dq, ddq = q.copy(), q.copy()
    for joint in range(n):
        for w in generator.uniform(0.5, 5.0, 4):
            size, phase = generator.uniform(0.3, 0.8), generator.uniform(0.0, 6.0)
            q[:, joint] += size * np.sin(w * t + phase)
            dq[:, joint] += size * w * np.cos(w * t + phase)
            ddq[:, joint] -= size * w * w * np.sin(w * t + phase)
    motion = np.hstack([q, dq, ddq])

    def output(rows: np.ndarray) -> np.ndarray:
        y = rows.sum(axis=2)
        return y + noise * y.std(axis=0) * generator.standard_normal(y.shape)

    recording = Recording(
        name, np.round(t * 1e9).astype(np.int64), q, dq,
        output(EffortRegressor(arm).rows(motion)) if effort else None,
        output(StrainRegressor(arm).rows(motion)) if strain else None,
        (slice(0, 600), slice(600, len(t))), 1.0 / RATE, {'backward stamps': 3}, warnings,
        'c0ffee')
    return BagData(BagChoice(name), recording,
                   tuple(prepare(recording, arm.spec.preprocessing)))


def fit(arm: Arm, settings: FitSettings = SMALL, *, test: bool = True,
        **kwargs: Any) -> FitResult:
    """Fit to two simulated bags, judged by a third one or by leaving each out once."""
    bags = [bag(arm, f'run{i}', i, **kwargs) for i in (1, 2, 3)]
    if test:
        return fit_models(arm, bags[:2], bags[2:], None, arm.spec.preprocessing, settings)
    return fit_models(arm, bags, [], None, arm.spec.preprocessing, settings)


class Page(HTMLParser):
    """What a browser would make of a page: tags, attributes, text, ids."""

    VOID = ('meta', 'img', 'br', 'link', 'input')

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.words: list[str] = []
        self.scripts: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        assert not self._open, f'not closed: {self._open}'

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note a tag."""
        self.tags.append(tag)
        self.attributes += [(name, value or '') for name, value in attrs]
        if tag not in self.VOID:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        """Close a tag; the last one opened it must be."""
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        """Note text."""
        (self.scripts if self._open and self._open[-1] == 'script' else self.words).append(data)

    @property
    def text(self) -> str:
        """All text, white space folded."""
        return ' '.join(' '.join(self.words).split())

    def values(self, name: str) -> list[str]:
        """Values of an attribute wherever it stands."""
        return [value for key, value in self.attributes if key == name]

    def figures(self) -> list[dict[str, Any]]:
        """Give what the figures are drawn from."""
        return [json.loads(text) for text in self.scripts if text.startswith('{')]


def texts(figure: dict[str, Any]) -> set[str]:
    """Give titles, labels and names of traces of a figure."""
    return {text for drawn in figure['panels'] for text in (
        drawn['title'], drawn['xlabel'], drawn['ylabel'],
        *(line['name'] for line in drawn['traces']))}


@pytest.fixture(scope='module')
def result() -> FitResult:
    """Effort and strain of a two-joint arm."""
    arm = planar_arm(gauges=2)
    return fit(arm, FitSettings(kinds=('analytical', 'elm'), elm_hidden=20), strain=True)


@pytest.fixture(scope='module')
def html(result: FitResult) -> str:
    """Page of that fit."""
    return render(result)


def test_page_needs_nothing_else(html: str) -> None:
    """No link out, no asset; only its two scripts may run, whatever else stands there."""
    page = Page(html)
    assert not {'link', 'iframe', 'object', 'img'} & set(page.tags)
    assert not page.values('src')
    assert all(value.startswith('#') for value in page.values('href'))
    ids = page.values('id')
    assert len(ids) == len(set(ids))
    assert {value[1:] for value in page.values('href')} <= set(ids)
    css = html.split('<style>')[1].split('</style>')[0]
    assert 'url(' not in css and '@import' not in css
    policy, = (value for value in page.values('content') if 'script-src' in value)
    assert "default-src 'none'" in policy
    code = [text for text in page.scripts if not text.startswith('{')]
    assert len(code) == 2 and re.findall("'sha256-([^']*)'", policy) == [
        base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in code]


def test_page_names_every_finding(result: FitResult, html: str) -> None:
    """Verdicts, channels, coefficients, bags and what was dropped are all there."""
    page = Page(html)
    for item in result.fitted:
        assert item.verdict.level.value in page.text
        assert item.verdict.reasons[0] in page.text
        for channel in item.validation.channels:
            assert channel in page.text
        for group in coefficient_groups(item, result.arm):
            for row in group['coefficients']:
                assert row['name'] in page.text
                assert number(row['value'], 4) in page.text
                assert pretty_unit(row['unit']) in page.text
        assert number(item.validation.score.rmse) in page.text
    assert 'run3' in page.text and '3 backward stamps' in page.text and 'c0ffee' in page.text
    assert 'No vibration stands out' in page.text
    # the arm, two channels each, two histograms, two of thresholds, density, pair
    assert len(page.figures()) == 1 + 2 * 2 + 2 + 2 + 2
    assert {'effort [A]', 'residual [A]', 'measured', 'analytical', 'elm'} <= texts(
        page.figures()[1])


def test_same_fit_gives_same_bytes(result: FitResult, html: str) -> None:
    """Made again, equal bytes; but for the library that draws, a page is small."""
    assert render(result) == html
    assert len(html) - len(get_plotlyjs()) < 5e5


def test_equal_fits_give_equal_pages(html: str) -> None:
    """There is no date in a page that is not told one."""
    assert not re.search(r'20\d\d-\d\d-\d\d', html.replace(get_plotlyjs().strip(), ''))


def test_hostile_names_stay_names() -> None:
    """Markup and mathematics in names of joints, bags and warnings come out as text."""
    arm = planar_arm(names=[HOSTILE, '$x_{$ \x01\u202e' + 'long' * 40])
    result = fit(arm, warnings=(HOSTILE,))
    result = replace(
        result, arm=replace(arm, spec=arm.spec.model_copy(update={'name': HOSTILE})),
        training=tuple(replace(b, choice=BagChoice(HOSTILE)) for b in result.training),
        warnings=(HOSTILE, '</main>'))
    page = Page(render(result))
    assert page.tags.count('script') == len(page.figures()) + 2
    assert page.tags.count('main') == 1
    assert page.text.count(' '.join(HOSTILE.split())) > 10
    assert not [name for name, _ in page.attributes if name.startswith('on')]
    assert any(HOSTILE in texts(figure) for figure in page.figures())


def test_lone_surrogates_can_be_written() -> None:
    """A path that is no UTF-8 does not stop the report."""
    result = fit(planar_arm(1), FitSettings(kinds=('analytical',)))
    bags = (replace(result.learned[0], bag='run\udcff'), *result.learned[1:])
    assert b'run?' in render(replace(result, learned=bags)).encode()


@pytest.mark.parametrize('kinds', [('analytical',), ('elm',)])
@pytest.mark.parametrize(('effort', 'strain'), [(True, False), (False, True)])
def test_single_outputs_and_models(kinds: tuple[str, ...], effort: bool, strain: bool) -> None:
    """One output, one kind of model: the rest is left out, not left empty."""
    arm = planar_arm(gauges=2 if strain else 0)
    settings = FitSettings(kinds=kinds, elm_hidden=20)
    page = Page(render(fit(arm, settings, effort=effort, strain=strain)))
    assert ('Strain over time' in page.text) == strain
    assert ('Effort over time' in page.text) == effort
    assert ('coefficients' in page.values('id')) == (kinds == ('analytical',))
    assert ('Extreme Learning Machine' in page.text) == (kinds == ('elm',))
    assert any('elm' in texts(figure) for figure in page.figures()) == (kinds == ('elm',))


def test_six_joints_without_test_bag() -> None:
    """Six joints, each bag left out once: six figures of signals, one of thresholds."""
    arm = planar_arm(6)
    result = fit(arm, test=False)
    page = Page(render(result))
    assert len(page.figures()) == 1 + 6 + 1 + 1 + 2
    assert len(page.figures()[-1]['panels']) == 3
    assert 'There is no separate test bag' in page.text
    assert 'leave one bag out' in page.text


def test_arrays_are_written_once() -> None:
    """In single precision, those that traces share once; texts stay texts."""
    t = np.array([0.0, 0.25, np.nan])
    plot = {'panels': [panel('</script>', '', '', trace('a', t, 2.0 * t), trace('b', t, t))]}
    text = encoded(plot)
    assert '</script>' not in text
    found = json.loads(text)
    first, second = found['panels'][0]['traces']
    assert first['x'] == second['x'] == second['y'] != first['y'] and len(found['data']) == 2
    assert np.frombuffer(base64.b64decode(found['data'][first['y']]), '<f4') == pytest.approx(
        [0.0, 0.5, np.nan], nan_ok=True)


def test_one_joint_has_no_pairs() -> None:
    """A single joint cannot be paired, and the page says nothing about pairs."""
    page = Page(render(fit(planar_arm(1))))
    assert len(page.figures()) == 1 + 1 + 1 + 1 + 1
    assert 'neighbouring joints' not in page.text


def test_ringing_is_said_with_unit_and_frequency() -> None:
    """A vibration stands at the top with its channel, frequency and unit."""
    result = fit(planar_arm(gauges=1), FitSettings(kinds=('analytical',)), effort=False,
                 strain=True)
    page = Page(render(replace(result, ringing=(Ringing('bridge1', 2.951, 30.0, 0.85),))))
    assert ('The arm rings: bridge1 at 2.95 Hz (30 µm/m rms, 85 % of the residual above 0.5 Hz).'
            in page.text)
    assert 'No vibration stands out' not in page.text


def test_unexcited_coefficients_are_marked() -> None:
    """A joint that never moves cannot show its friction, and the table says so."""
    arm = planar_arm()
    still = []
    for seed in (1, 2, 3):
        data = bag(arm, f'run{seed}', seed)
        q, dq = data.recording.q.copy(), data.recording.dq
        assert dq is not None
        q[:, 1], dq = 0.0, dq * [1.0, 0.0]
        recording = replace(data.recording, q=q, dq=dq)
        still.append(BagData(data.choice, recording,
                             tuple(prepare(recording, arm.spec.preprocessing))))
    result = fit_models(arm, still[:2], still[2:], None, arm.spec.preprocessing, SMALL)
    rows = [row for group in coefficient_groups(result.fitted[0], arm)
            for row in group['coefficients']]
    notes = {row['name']: row['note'] for row in rows}
    assert notes['viscous(axis2)'] == 'not excited'
    assert notes['viscous(axis1)'] != 'not excited'
    marked = [row for row in rows if row['note'] == 'not excited']
    assert Page(render(result)).values('class').count('unexcited') == len(marked)


def test_picture_of_the_arm() -> None:
    """Links as long as described, upright against the weight, gauges on them; and from above."""
    figure = arm_figure(planar_arm(gauges=2), np.array([0.0, np.pi / 2]))
    view, = figure['panels']  # a plane that stands: nothing to be seen from above
    links, _, gauges = view['traces']
    place = np.column_stack([links['x'], links['y']])
    assert place == pytest.approx(np.array([[0, 0], [0, 0], [0.5, 0], [0.5, 0.5]]), abs=1e-6)
    assert gauges['text'] == ['bridge1', 'bridge2']
    assert gauges['x'] == pytest.approx([0.05, 0.5], abs=1e-6)
    assert gauges['y'] == pytest.approx([0.0, 0.05], abs=1e-6)
    elsewhere = arm_from_dict({
        'name': 'turning', 'gravity': [0.0, 0.0, -9.81],
        'kinematics': {'dh': [[0.0, np.pi / 2, 0.4, 0.0], [0.3, np.pi / 2, 0.0, 0.0],
                              [0.2, 0.0, 0.1, 0.0]]},
        'joints': [{'name': f'j{i}', 'effort': {'unit': 'N m'}} for i in range(3)]},
        base=Path(), source='test')
    titles = [view['title'] for view in arm_figure(
        elsewhere, np.array([0.3, 0.4, 0.9]))['panels']]
    assert titles == ['from the side', 'from above']


def test_comparison_with_the_last_fit(result: FitResult) -> None:
    """Errors then and now, what made the other, and a word where it was judged otherwise."""
    facts = figures(result)
    facts['effort']['analytical']['validation']['channels']['axis1']['rmse'] *= 0.1
    last = LastFit('old', {'validation': facts, 'training': [{'bag': 'other'}], 'made': {
        'date': '2025-05-04', 'version': 'tudor_dynamics 0.1'}})
    text = Page(render(result, made={'commit': 'abc, changed'}, last=last)).text
    assert 'Then: old , 2025-05-04, tudor_dynamics 0.1, fitted to other. Now:' in text
    assert 'They were judged on different motion' in text
    assert 'axis1 effort, analytical' in text and 'worse (+' in text and 'as before (' in text
    assert 'Commit abc, changed' in text
    assert 'last fit' not in Page(render(result)).text


@pytest.mark.parametrize(('fit', 'shown'), [(88.57, '88.6'), (84.98, '84.9'), (84.93, '84.9')])
def test_a_fit_has_one_value(result: FitResult, fit: float, shown: str) -> None:
    """Verdict, table and printed result round alike, and none of them over a bound."""
    def changed(item: FittedOutput) -> FittedOutput:
        score = replace(item.validation.score, fit=fit)
        return replace(item, validation=replace(item.validation, score=score))
    other = replace(result, fitted=tuple(map(changed, result.fitted)))
    text = render(other)
    assert set(re.findall(r'fit ([\d.]+) %', text)) == {shown}
    table = text.partition('<section id="figures"')[2].partition('</section>')[0]
    assert table.count(f'<td class="n">{shown}</td>') >= len(other.fitted)
    assert repr(other.fitted[0].validation).count(f'fit {shown} %') == 1


def test_the_last_fit_is_compared_by_what_it_notices(result: FitResult) -> None:
    """The smallest touch of each channel then and now; nothing is said of bundles by hand."""
    def use(**noticed: str) -> Use:
        return Use('effort', 'analytical', 'collision detection (effort)', Grade.GOOD, 'why', {},
                   noticed)
    now = replace(assess(result), uses=(use(axis1='2.5 N m', axis2='4 N m (9 N at the tip)'),))
    then = replace(now, uses=(use(axis1='1.5 N m', gone='7 N m'),))
    last = LastFit('old', {'validation': figures(result), **then.as_dict()})
    text = Page(render(result, now, last=last)).text
    for row in ('axis1 effort, analytical 1.5 N m 2.5 N m',
                'axis2 effort, analytical not known 4 N m (9 N at the tip)',
                'gone effort, analytical 7 N m not known'):
        assert row in text
    for broken in ({}, {'uses': 1}, {'uses': {'effort': {'analytical': [{}]}}}):
        text = Page(render(result, now, last=LastFit('old', broken))).text
        assert 'axis1 effort, analytical not known 2.5 N m' in text


def said(item: FittedOutput, level: Grade) -> FittedOutput:
    """Give a model another verdict."""
    other = replace(item)
    vars(other)['verdict'] = Verdict(level, ('why',))
    return other


@pytest.mark.parametrize(('levels', 'word', 'colour'), [
    ((Grade.GOOD, Grade.GOOD), 'good', 'good'),
    ((Grade.GOOD, Grade.USABLE), 'usable', 'usable'),
    ((Grade.GOOD, Grade.DO_NOT_USE), 'usable in part', 'usable'),
    ((Grade.DO_NOT_USE, Grade.DO_NOT_USE), 'do not use', 'do_not_use'),
])
def test_overall_verdict(
    result: FitResult, levels: tuple[Grade, Grade], word: str, colour: str,
) -> None:
    """The whole is refused only where nothing may be used."""
    rigid = [item for item in result.fitted if item.kind == 'analytical']
    fitted = [said(item, level) for item, level in zip(rigid, levels, strict=True)]
    verdict = overall(fitted)
    assert (verdict.word, verdict.level) == (word, colour)
    if len(set(levels)) > 1:
        assert 'effort analytical' in verdict.sentence
        assert 'strain analytical' in verdict.sentence
    for elm in (Grade.GOOD, Grade.DO_NOT_USE):
        beside = said(replace(result.fitted[1], kind='elm'), elm)
        assert overall([*fitted, beside]) == verdict
    if word == 'do not use':
        assert overall(fitted, Grade.GOOD).word == 'usable to detect collisions'


def test_units_of_mixed_joints() -> None:
    """Friction is in its own joint's unit, also where a slide and a hinge share parameters."""
    arm = arm_from_dict({
        'name': 'mixed', 'kinematics': {'dh': [[0.0, 0.0, 0.0, 0.0], [0.5, 0.0, 0.0, 0.0]]},
        'joints': [
            {'name': 'slide', 'type': 'prismatic', 'effort': {'unit': 'N'},
             'rotor_inertia': False},
            {'name': 'hinge', 'effort': {'unit': 'A', 'torque_constant': 2.0}}]},
        base=Path(), source='test')
    result = fit(arm)
    units = {row['name']: row['unit'] for group in coefficient_groups(result.fitted[0], arm)
             for row in group['coefficients']}
    assert units['viscous(slide)'] == 'N s/m'
    assert units['coulomb(slide)'] == 'N'
    assert units['viscous(hinge)'] == 'N m s/rad'
    assert 'mix these' in Page(render(result)).text


def test_coverage_counts_what_lies_outside() -> None:
    """Ranges are those of the samples; a shifted test bag lies outside in part."""
    arm = planar_arm(1)
    inside = bag(arm, 'a', 1)
    q = inside.recording.q
    moved = replace(inside.recording, q=q + (q.max() - q.min()))
    outside = BagData(BagChoice('b'), moved, tuple(prepare(moved, arm.spec.preprocessing)))
    result = fit_models(arm, [inside, bag(arm, 'a2', 1)], [outside], None,
                        arm.spec.preprocessing, SMALL)
    row = coverage(result)[0]
    assert row['training'][0] >= q.min() and row['training'][1] <= q.max()
    assert row['outside'] > 99.0
    assert row['test'][0] == pytest.approx(row['training'][0] + q.max() - q.min())


def test_detail_is_where_the_arm_moves(result: FitResult) -> None:
    """The stretch in detail lies within the bag and has more motion than the others."""
    trace = result.fitted[0].validation.traces[0]
    begin, end = liveliest(trace, (*result.test, *result.training))
    assert trace.t[0] <= begin < end <= trace.t[-1] + 1e-9
    stretches = result.test[0].stretches
    t = np.concatenate([s.t for s in stretches])
    dq = np.vstack([s.states.dq for s in stretches])
    power = np.sum((dq / dq.std(axis=0)) ** 2, axis=1)

    def motion(first: float) -> float:
        return float(power[(t >= first) & (t <= first + end - begin)].sum())

    others = [motion(first) for first in np.linspace(trace.t[0], trace.t[-1] - (end - begin), 15)]
    assert motion(begin) >= 0.97 * max(others)


def test_decimation_keeps_extremes_of_all_and_breaks_at_gaps() -> None:
    """Long lines are drawn with the peaks of each at common times, a gap is not drawn over."""
    t = np.arange(50_000) * 0.01
    x = np.sin(t)
    x[12_345] = 7.0
    other = np.cos(t)
    other[777] = -9.0
    short, y, z = decimated(t, x, other)
    assert len(short) == len(z) <= 2 * MAX_POINTS + 2
    assert y.max() == 7.0 and z.min() == -9.0 and short[0] == 0.0 and short[-1] == t[-1]
    t = np.concatenate([np.arange(50.0), np.arange(200.0, 250.0)])
    _, y = decimated(t, np.ones(100))
    assert list(np.flatnonzero(np.isnan(y))) == [50]


def test_joints_at_rest_are_not_paired() -> None:
    """Pairs take joints that move only."""
    still = JointPositions('b', 'rad', np.zeros(9), np.zeros(0))
    moving = [JointPositions(name, 'rad', np.arange(9.0), np.zeros(0)) for name in 'ac']
    pairs = joint_pairs([moving[0], still, moving[1]])
    assert [(x.name, y.name) for x, y in pairs] == [('a', 'c')]


@pytest.mark.parametrize(('value', 'text'), [
    (0.0, '0'), (1234.5, '1234'), (0.012345, '0.0123'), (-1.0, '−1.00'), (9.999, '10.0'),
    (1.5e-7, '1.50e−07'), (2.5e8, '2.50e+08'), (float('inf'), '∞'), (float('nan'), 'n/a'),
])
def test_numbers_for_readers(value: float, text: str) -> None:
    """Three significant digits, no exponent where one can do without."""
    assert number(value) == text


def test_units_for_readers() -> None:
    """Plain units of tables and files become those of print."""
    assert pretty_unit('kg m^2 (um/m)/(N m)') == 'kg·m²·(µm/m)/(N·m)'
    assert pretty_unit('kg m (A)/(N m)') == 'kg·m·A/(N·m)'
