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

"""From recordings to judged models, end to end in memory, on an arm whose parameters are known."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from sample_arms import gauge, multisine, planar_arm, random_states, recording_of

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.errors import FitError, TudorWarning
from tudor_dynamics.identification.dataset import BagChoice, BagData, cut
from tudor_dynamics.identification.fit import (
    _tell, fit_models, FitResult, FitSettings, HeldOut, left_out)
from tudor_dynamics.identification.loads import bundle_of, figures
from tudor_dynamics.identification.validation import Grade
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import load_bundle, save_bundle
from tudor_dynamics.models.regressor import EffortRegressor, Regressor, StrainRegressor
from tudor_dynamics.signals.preprocessing import prepare
from tudor_dynamics.typing import FloatArray

ARM = planar_arm([{'name': 'j1', 'friction': ['viscous', 'coulomb'], 'friction_velocity': 0.2},
                  {'name': 'j2', 'friction': ['viscous'], 'effort': {
                      'unit': 'A', 'torque_constant': 5.0}}],
                 [gauge('g2', 'j2', 0.05), gauge('g1', 'j1', 0.05)])
SPEC = PreprocessingSpec(filter='zero_phase', cutoff=40.0, rate=20.0, settle=1.0)
NOISE = {'effort': np.array([0.5, 0.1]), 'strain': np.array([3.0, 20.0])}
PLAIN = FitSettings(kinds=('analytical',))


def _regressor(output: str) -> Regressor:
    return EffortRegressor(ARM) if output == 'effort' else StrainRegressor(ARM)


def _truth(output: str) -> FloatArray:
    """Draw parameters of each channel; those of strain are all of one arm, times gauge scales."""
    regressor = _regressor(output)
    base = np.random.default_rng(7).uniform(0.2, 1.0, len(regressor.columns))
    scales = [1.0, 1.0] if output == 'effort' else [40.0, 65.0]
    return np.stack([s * base for s in scales])


def _outputs(motion: FloatArray, output: str, seed: int) -> FloatArray:
    clean = np.einsum('kcp,cp->kc', _regressor(output).rows(motion), _truth(output))
    generator = np.random.default_rng(1000 + seed)
    return np.asarray(clean + generator.normal(0, 1, clean.shape) * NOISE[output])


def _recording(seed: int, effort: bool = True, strain: bool = True) -> Recording:
    motion = multisine(np.arange(4000) / 200.0, 2, seed)
    return recording_of(motion[:, :2], 200.0, path=f'run{seed}',
                        effort=_outputs(motion, 'effort', seed) if effort else None,
                        strain=_outputs(motion, 'strain', seed) if strain else None)


def _bag(recording: Recording, begin: float = 0.0, end: float = 1.0) -> BagData:
    choice = BagChoice(recording.path, begin, end)
    part = cut(recording, choice)
    return BagData(choice, part, tuple(prepare(part, SPEC)))


def _fit(training: list[BagData], test: list[BagData], **more: Any) -> FitResult:
    settings = more.pop('settings', PLAIN)
    return fit_models(ARM, training, test, more.get('holdout'), SPEC, settings)


def _true_base(model: AnalyticalModel, output: str) -> list[tuple[FloatArray, Any]]:
    """Find the true base parameters of each group by a fit to outputs without noise."""
    motion = random_states(400, 2, seed=3)
    clean = np.einsum('kcp,cp->kc', _regressor(output).rows(motion), _truth(output))
    exact = AnalyticalModel(_regressor(output), 2).fit(motion, clean)
    return [(a.estimate.parameters, b.estimate) for a, b in zip(
        exact.groups_, model.groups_, strict=True)]


def test_parameters_are_recovered() -> None:
    """
    Base parameters lie within three standard errors of the truth.

    Nor are these merely large: the errors have the spread that they say.

    """
    result = _fit([_bag(_recording(s)) for s in range(3)], [_bag(_recording(3))])
    assert [(f.output, f.kind) for f in result.fitted] == [
        ('effort', 'analytical'), ('strain', 'analytical')]
    ratios: list[float] = []
    for item in result.fitted:
        assert isinstance(item.model, AnalyticalModel)
        for truth, estimate in _true_base(item.model, item.output):
            error = np.abs(estimate.parameters - truth)
            assert np.all(error < 3 * estimate.standard_errors)
            ratios += list(error / estimate.standard_errors)
            assert np.median(estimate.standard_errors / np.abs(truth)) < 0.02
            assert estimate.unexcited == ()
        assert item.validation.method == 'test bag run3'
        assert item.validation.score.fit > 97 and item.verdict.level is Grade.GOOD
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.35)
    assert result.ringing == () and result.warnings == ()


@pytest.mark.parametrize(('effort', 'strain'), [(True, False), (False, True)])
def test_one_output(effort: bool, strain: bool) -> None:
    """Bags with strain alone, or effort alone, give models of that; each bag left out once."""
    bags = [_bag(_recording(s, effort, strain)) for s in range(3)]
    result = _fit(bags, [], settings=FitSettings(kinds=('analytical', 'elm')))
    assert {f.output for f in result.fitted} == {'effort' if effort else 'strain'}
    assert [f.kind for f in result.fitted] == ['analytical', 'elm']
    for item in result.fitted:
        assert item.validation.method == 'leave one bag out, 3 bags'
        assert len(item.validation.traces) == 3
    assert result.fitted[0].verdict.level is Grade.GOOD


def test_one_bag() -> None:
    """With one bag its last part is held out; without even that there is no verdict."""
    whole = _recording(0)
    holdout = HeldOut(_bag(whole, 0.0, 0.6), _bag(whole, 0.6, 1.0), ARM, PLAIN)
    result = _fit([_bag(whole)], [], holdout=holdout)
    for item in result.fitted:
        assert item.validation.method == 'the last 40 % of the only bag, fitted to the rest'
        assert item.validation.traces[0].bag == 'run0@60-100%'
        assert item.validation.score.fit > 90
    with pytest.raises(FitError, match='cannot be judged'):
        _fit([_bag(whole)], [])


def test_test_bag_without_strain() -> None:
    """An output that a test bag lacks is not fitted, and that is said."""
    bags = [_bag(_recording(0)), _bag(_recording(1))]
    with pytest.warns(TudorWarning, match='only run0, run1 have strain: no strain model'):
        result = _fit(bags, [_bag(_recording(2, strain=False))])
    assert [f.output for f in result.fitted] == ['effort']
    assert any('no strain model' in warning for warning in result.warnings)
    with pytest.raises(FitError, match='share neither efforts nor strains'):
        _fit([_bag(_recording(0, strain=False))], [_bag(_recording(1, effort=False))])


def test_bundle_of_a_fit(tmp_path: Any) -> None:
    """What was fitted can be saved, loaded, and predicts the same; its figures travel along."""
    bags = [_bag(_recording(0)), _bag(_recording(1))]
    result = _fit(bags, [_bag(_recording(2))], settings=FitSettings(elm_hidden=10))
    save_bundle(bundle_of(result), tmp_path / 'model')
    loaded = load_bundle(tmp_path / 'model', arm=ARM)
    assert loaded.preprocessing == SPEC
    assert loaded.facts['validation'] == figures(result)
    assert [bag['bag'] for bag in loaded.facts['training']] == ['run0', 'run1']
    assert loaded.facts['training'][0]['samples'] == bags[0].samples
    motion = random_states(50, 2)
    for item in result.fitted:
        same = loaded.models[item.output][item.kind]
        assert np.array_equal(same.predict(motion), item.model.predict(motion))


def test_noise_free_channels() -> None:
    """Outputs without any noise do not upset the weights: the truth is found."""
    motion = multisine(np.arange(3000) / 100.0, 2, 0)
    clean = np.einsum('kcp,cp->kc', _regressor('effort').rows(motion), _truth('effort'))
    clean_model = AnalyticalModel(_regressor('effort'), 2).fit(motion, clean)
    for truth, estimate in _true_base(clean_model, 'effort'):
        assert np.allclose(estimate.parameters, truth, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize(('name', 'asked'), [
    ('two_blade_arm', 'a second gauge on the link'), ('elastic_arm', 'or other motion')])
def test_compliance_that_strain_does_not_separate(root: Path, name: str, asked: str) -> None:
    """A second gauge is asked for only where the link has none."""
    arm = load_arm(root / f'config/{name}.yaml')
    physical = [SimpleNamespace(name=f'{kind}(joint2)', shown=False, standard_error=1.0, value=1.0)
                for kind in ('gear', 'bending')]
    with pytest.warns(TudorWarning, match=asked):
        _tell(arm, SimpleNamespace(physical=physical, untold=()))  # type: ignore[arg-type]


def test_a_part_without_samples_is_not_left_out() -> None:
    """An only bag is judged by the parts in which something was recorded."""
    q = multisine(np.arange(2000) / 100.0, 2, 0)[:, :2]
    gapped = recording_of(q, 100.0, effort=q, gaps=(1000,), gap=15.0)
    bag = BagData(BagChoice('bag'), gapped, tuple(prepare(gapped, SPEC)))
    assert [str(part.choice) for _, part in left_out([bag], SPEC)] == [
        'bag@0-20%', 'bag@20-40%', 'bag@60-80%', 'bag@80-100%']
