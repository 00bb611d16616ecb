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

"""Verdicts by use, marks, and what to do next, on arms whose truth is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sample_arms import gauge, LENGTH_1, LENGTH_2, multisine, planar_arm, recording_of

from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.cli.fit import _print
from tudor_dynamics.identification.dataset import BagChoice, BagData
from tudor_dynamics.identification.doctor.findings import found
from tudor_dynamics.identification.fit import fit_models, FitResult, FitSettings
from tudor_dynamics.identification.next_steps import assess, Assessment, next_steps
from tudor_dynamics.identification.ringdowns import Ringing
from tudor_dynamics.identification.uses import short, Use, uses_of
from tudor_dynamics.identification.validation import Grade, noise_floor
from tudor_dynamics.models.regressor import EffortRegressor, StrainRegressor
from tudor_dynamics.online.thresholds import MethodThresholds, Tail
from tudor_dynamics.signals.preprocessing import prepare

ARM = planar_arm([{'name': 'j1', 'friction': ['viscous', 'coulomb']},
                  {'name': 'j2', 'friction': ['viscous']}],
                 [gauge('g2', 'j2', 0.05), gauge('g1', 'j1', 0.05)])
SPEC = PreprocessingSpec(filter='zero_phase', cutoff=40.0, rate=20.0, settle=1.0)
NOISE = 0.5


def _bag(seed: int, seconds: float = 20.0, sign: float = 1.0) -> BagData:
    motion = multisine(np.arange(round(200 * seconds)) / 200.0, 2, seed)
    rng, outputs = np.random.default_rng(seed), {}
    for output, regressor in (('effort', EffortRegressor(ARM)), ('strain', StrainRegressor(ARM))):
        base = np.random.default_rng(7).uniform(0.2, 1.0, len(regressor.columns))
        if output == 'effort':
            for place, name in enumerate(regressor.columns):
                base[place] *= sign if name.startswith('Ia(') else 1.0
        clean = np.einsum('kcp,p->kc', regressor.rows(motion), base)
        outputs[output] = clean + NOISE * rng.normal(size=clean.shape)
    recording: Recording = recording_of(motion[:, :2], 200.0, path=f'run{seed}', **outputs)
    return BagData(BagChoice(recording.path), recording, tuple(prepare(recording, SPEC)))


def _fit(*seeds: int, **more: Any) -> FitResult:
    bags = [_bag(seed, **more) for seed in seeds]
    return fit_models(ARM, bags[:-1], bags[-1:], None, SPEC, FitSettings())


@pytest.fixture(scope='module')
def result() -> FitResult:
    """Fit of two bags, judged by a third."""
    return _fit(0, 1, 2)


@pytest.fixture(scope='module')
def assessment(result: FitResult) -> Assessment:
    """Judge what it is good enough for."""
    return assess(result)


def test_uses(assessment: Assessment) -> None:
    """Each model is judged for prediction, feed-forward, collisions and payload, with figures."""
    names = [(use.output, use.name) for use in assessment.uses]
    assert names == [
        ('effort', 'prediction'), ('effort', 'feed-forward'),
        ('effort', 'collision detection (effort)'),
        ('effort', 'collision detection (momentum)'), ('effort', 'payload'),
        ('strain', 'prediction'), ('strain', 'collision detection (strain)'),
        ('strain', 'payload')]
    assert assessment.missing == () and assessment.detects is Grade.GOOD
    by_name = {(use.output, use.name): use for use in assessment.uses}
    # gauges of unknown gain show no newtons, and no kilograms
    said = by_name['strain', 'collision detection (strain)']
    assert said.level is None and 'forces in N need' in said.why
    assert 'g1' in said.why and 'um/m' in said.why and 's without contact' in said.why
    assert by_name['strain', 'payload'].level is None
    said = by_name['effort', 'collision detection (effort)']
    assert said.level is Grade.GOOD and 'N at the tip)' in said.why
    assert set(said.channels.values()) == {Grade.GOOD}
    left = by_name['effort', 'feed-forward']
    assert left.level is Grade.GOOD
    assert 'use it at all joints; share of effort left to the controller: j1' in left.why
    plain = assessment.as_dict()
    first, _, detection, *_ = plain['uses']['effort']['analytical']
    assert first['use'] == 'prediction' and 'noticed' not in first
    assert list(detection['noticed']) == ['j1', 'j2']
    assert all(f'{name} {touch}' in said.why and touch.endswith(' N at the tip)')
               for name, touch in detection['noticed'].items())


def test_a_joint_that_keeps_most_of_its_effort_is_not_fed(result: FitResult) -> None:
    """No verdict is better than its worst joint, and joints to feed are named."""
    item = result.fitted[0]
    score = item.validation.score

    def judged(*left: float) -> Use:
        channels = {name: replace(own, relative_error=value) for (name, own), value in zip(
            score.channels.items(), left, strict=True)}
        one = replace(item, validation=replace(
            item.validation, score=replace(score, channels=channels)))
        return next(use for use in uses_of(one, ARM, {}, {}) if use.name == 'feed-forward')

    use = judged(0.05, 0.59)
    assert use.level is Grade.USABLE and use.why.startswith('use it at j1; share of effort left')
    assert use.channels == {'j1': Grade.GOOD, 'j2': Grade.DO_NOT_USE}
    assert judged(2.14, 0.59).level is Grade.DO_NOT_USE
    assert judged(float('nan'), 0.1).channels['j1'] is Grade.DO_NOT_USE
    assert judged(0.05, 0.4).level is Grade.USABLE and 'all joints' in judged(0.05, 0.4).why


@pytest.mark.parametrize(('size', 'level'), [
    (10.0, Grade.GOOD), (70.0, Grade.USABLE), (400.0, Grade.DO_NOT_USE)])
def test_detection_by_the_force_that_is_noticed(
    result: FitResult, size: float, level: Grade,
) -> None:
    """A step is as large as the threshold, its force that over the lever of the joint."""
    n, tail = 2, Tail(1.0, 1e-9, 0.0, 0.2, 1.0, 20.0)
    profile = np.zeros((2 * n, 1 + 4 * n))
    profile[:n, 0], profile[n:, 0] = size, 1e9
    learned = MethodThresholds(
        ('j1', 'j2'), 0.01, np.zeros((20, n, n)), profile, (tail,) * 6, 3600.0, np.ones(n),
        np.ones(n), np.array([0.0, 1.0]))
    use = next(use for use in uses_of(result.fitted[0], ARM, {
        ('effort', 'analytical'): learned}, {}) if use.name == 'collision detection (effort)')
    assert use.level is level and f'j1 {short(size)} N m' in use.why
    assert f'j2 {short(size + 1)} N m' in use.why
    # stretched along joint 2's way: by whichever joint notices it first
    force = float(use.why.partition('j2 ')[2].partition('(')[2].partition(' N at')[0])
    assert size / (LENGTH_1 + LENGTH_2) * 0.9 < force < 1.05 * (size + 1) / LENGTH_2
    # an onset that comes in over ten steps notices a tenth of its threshold
    profile[n:, 0] = size
    learned = replace(learned, taps=np.repeat(np.eye(n)[None], 20, axis=0))
    use = next(use for use in uses_of(result.fitted[0], ARM, {
        ('effort', 'analytical'): learned}, {}) if use.name == 'collision detection (effort)')
    assert f'j1 {short(size / 10)} N m' in use.why


def test_a_payload_in_kilograms(result: FitResult) -> None:
    """The error of a mean over what a kilogram at the tip adds."""
    use = next(use for use in uses_of(result.fitted[0], ARM, {}, {}) if use.name == 'payload')
    kilograms = float(use.why.removeprefix('uncertain by ').split(' kg')[0])
    item = result.fitted[0].validation
    error = 2.0 * np.concatenate([trace.measured - trace.predicted for trace in item.traces])
    means = error[:len(error) // 20 * 20].reshape(-1, 20, 2).mean(axis=1)
    most = 9.81 * np.array([LENGTH_1 + LENGTH_2, LENGTH_2])
    assert (np.sqrt(np.mean(means**2, axis=0)) / most).min() * 0.95 < kilograms < 0.2


@pytest.mark.parametrize(('kind', 'words'), [
    ('effort_unit', 'efforts are in another unit'),
    ('joint_scale', 'positions of a joint have a wrong scale')])
def test_no_verdict_beside_a_finding_of_units(result: FitResult, kind: str, words: str) -> None:
    """Newtons, kilograms and efforts to feed are in doubt, and that is all that is said."""
    said = assess(replace(result, findings=(found(kind, 'N m, not A'),)))
    levels = {use.name: use.level for use in said.uses if use.output == 'effort'}
    assert levels.pop('prediction') is Grade.GOOD and set(levels.values()) == {None}
    assert words in next(use for use in said.uses if use.level is None).why
    assert said.detects is None


def test_noise_floor(result: FitResult) -> None:
    """White noise is found after the filters of the fit, whatever the motion."""
    full = PreprocessingSpec(filter='causal', rate=None, settle=1.0)
    bag = _bag(3)
    causal = replace(bag, stretches=tuple(prepare(bag.recording, full)))
    assert noise_floor([causal], 'effort', full) == pytest.approx(NOISE, rel=0.1)
    # the zero-phase decimation to 20 Hz keeps a tenth of the band up to 0.8 of it
    assert noise_floor([bag], 'strain', SPEC) == pytest.approx(
        NOISE * np.sqrt(0.8 * 20.0 / 200.0), rel=0.2)
    for item in result.fitted:
        rmse = np.array([score.rmse for score in item.validation.score.channels.values()])
        assert (rmse < 1.25 * item.noise).all()
        assert 'is near the noise' in str(item.verdict)


def test_missing_thresholds_are_a_step() -> None:
    """Too little motion for thresholds stands in the report, with why and what to do."""
    bags = [_bag(seed, 4.0) for seed in (0, 1)]
    short = fit_models(ARM, bags, [], None, SPEC, FitSettings())
    assessment = assess(short)
    assert assessment.missing and assessment.detects is None
    assert all('too little for thresholds' in text for text in assessment.missing)
    first = assessment.steps[0]
    assert 'no collision thresholds' in first.what
    assert 'add that bag to the fit' in first.what and first.command == ''
    use = next(use for use in assessment.uses if use.name.startswith('collision'))
    assert use.level is None and 'not known: no thresholds' in str(use)


def test_ringing_sends_to_the_elastic_model(result: FitResult) -> None:
    """A strain that a rigid model misses is a step, with the command for the elastic model."""
    ringing = (Ringing('g1', 2.0, 30.0, 0.9),)
    rings = replace(result, ringing=ringing)
    steps = next_steps(rings, [], {}, ())
    described = replace(rings, arm=replace(ARM, spec=ARM.spec.model_copy(update={'links': (1,)})))
    assert not next(step for step in steps if 'rings at 2.00 Hz' in step.what).command
    steps = next_steps(described, [], {}, ())
    said = next(step for step in steps if 'rings at 2.00 Hz' in step.what)
    assert '--models analytical elastic' in said.command
    assert 'run0 run1 --test run2' in said.command
    assert [step.gain for step in steps] == sorted((step.gain for step in steps), reverse=True)


def test_a_negative_inertia_is_marked(assessment: Assessment) -> None:
    """An arm whose joint would be pushed backwards is none, and that is said."""
    assert assessment.marks == ()
    odd = assess(_fit(0, 1, 2, sign=-40.0))
    assert any('the inertia about j1 is negative' in mark for mark in odd.marks)


@pytest.mark.parametrize(('value', 'text'), [
    (123.4, '120'), (0.04567, '0.046'), (98765.0, '99000'), (-7.0, '-7'), (0.0, '0')])
def test_two_digits_without_a_power_of_ten(value: float, text: str) -> None:
    """As people write thresholds."""
    assert short(value) == text


def test_what_runs_beside_the_robot_comes_first(
    result: FitResult, assessment: Assessment, capsys: pytest.CaptureFixture[str],
) -> None:
    """The headline is that of the causal models; the offline figure follows."""
    _print(replace(result, causal=result), assessment, Path('report.html'), verbose=True)
    said = capsys.readouterr().out
    places = [said.index(f'effort analytical {where}, prediction: good') for where in (
        'beside the robot', '(offline)')]
    assert places == sorted(places)
    _print(result, assessment, Path('report.html'), verbose=True)
    assert 'offline' not in capsys.readouterr().out
    # in short: nothing of recordings, and no verdict that is good
    _print(replace(result, causal=result), assessment, Path('report.html'), verbose=False)
    said = capsys.readouterr().out
    assert 'as the monitor filters' in said and 'report: report.html' in said
    assert 'offline' not in said and 'prediction: good' not in said
