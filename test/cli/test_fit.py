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

"""``tudor fit`` and ``tudor evaluate`` from end to end, on the sample bags and on odd input."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
import json
from pathlib import Path
import shutil

import numpy as np
from papers.merit import main as import_merit
import pytest

from tudor_dynamics import library
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.cli import fit as command
from tudor_dynamics.cli.main import main
from tudor_dynamics.errors import TudorError
from tudor_dynamics.identification import loads
from tudor_dynamics.identification.fit import FitSettings
from tudor_dynamics.models.bundle import load_bundle
from tudor_dynamics.models.flexible_tool import FlexibleTool
import yaml


@pytest.fixture(scope='module')
def fitted(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fit the sample bags once."""
    out = tmp_path_factory.mktemp('fit') / 'model'
    with (out.parent / 'said.json').open('w') as said, redirect_stdout(said):
        assert main(['fit', str(root / 'bags/two_blade_train_1'),
                     str(root / 'bags/two_blade_train_2'), '--test',
                     str(root / 'bags/two_blade_test'), '--models', 'analytical', 'elm', '--arm',
                     str(root / 'config/two_blade_arm.yaml'), '--out', str(out), '--json']) == 0
    return out


def run_json(capsys: pytest.CaptureFixture[str], *words: object, code: int = 0) -> dict:
    """Run the command and read its JSON."""
    capsys.readouterr()
    assert main([str(word) for word in words]) == code
    return json.loads(capsys.readouterr().out)


def one_line(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """Run the command on wrong input and give the one line that it answers."""
    capsys.readouterr()
    assert main([str(word) for word in words]) == 2
    captured = capsys.readouterr()
    lines = [line for line in captured.err.splitlines() if not line.startswith('warning: ')]
    assert len(lines) == 1 and 'Traceback' not in captured.err
    return lines[0]


def test_evaluate_gives_the_contract_s_json(
    fitted: Path, root: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """Keys as design has them; the fit that the sample bags allow."""
    found = run_json(capsys, 'evaluate', '--model', fitted, root / 'bags/two_blade_test', '--json')
    assert set(found) == {'model', 'bags', 'samples', 'effort', 'strain', 'findings', 'loads',
                          'as_it_was', 'comparison'}
    assert found['as_it_was'] is True
    assert set(found['comparison']['strain']['elm']) == {'link2_hub', 'link3_hub'}
    assert found['samples'] == pytest.approx(24 * 20 - 20, abs=3)  # zero-phase settles twice
    for output in ('effort', 'strain'):
        for kind in ('analytical', 'elm'):
            figures = found[output][kind]
            assert set(figures) == {'rmse', 'sigma_e', 'fit', 'fit_printed', 'relative_error',
                                    'channels'}
    assert set(found['effort']['elm']['channels']) == {'joint2', 'joint3'}
    assert set(found['strain']['elm']['channels']['link2_hub']) == {
        'rmse', 'fit', 'relative_error', 'moving_rmse', 'standing_rmse'}
    assert found['strain']['analytical']['fit'] > 91.5
    assert found['effort']['analytical']['fit'] > 87.0


def test_fit_says_the_same_as_evaluate(
    fitted: Path, root: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """Validation during the fit and evaluation of the saved model agree."""
    said = json.loads((fitted.parent / 'said.json').read_text())
    found = run_json(capsys, 'evaluate', '--model', fitted, root / 'bags/two_blade_test', '--json')
    for output in ('effort', 'strain'):
        for kind in ('analytical', 'elm'):
            first = said[output][kind]['validation']['fit']
            assert first == pytest.approx(found[output][kind]['fit'], rel=1e-5)


def test_choices_are_said(
    fitted: Path, root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """What was chosen stands in page and bundle; what the command fixes is not chosen."""
    made = {item['what']: item for item in yaml.safe_load(
        (fitted / 'model.yaml').read_text())['facts']['choices']}
    assert made['filters']['chosen'].startswith('zero-phase')
    assert made['filters']['error'] < made['filters']['error_instead']
    assert 'What was chosen' in (fitted / 'report.html').read_text()
    words = ['fit', root / 'bags/two_blade_train_1', '--arm', root / 'config/two_blade_arm.yaml',
             '--models', 'analytical', '--out', tmp_path / 'fixed']
    found = run_json(capsys, *words, '--filter', 'causal', '--friction', 'viscous', '--currents',
                     'shared', '--estimator', 'ols', '--json')
    assert found['choices'] == []
    content = yaml.safe_load((tmp_path / 'fixed/model.yaml').read_text())
    assert content['preprocessing']['filter'] == 'causal' and 'causal' not in content
    group, = content['outputs']['effort']['analytical']['groups']
    assert {item['channel'] for item in group['torque_constants']} == {'joint2', 'joint3'}
    line = one_line(capsys, *words, '--overwrite', '--friction', 'auto', 'viscous')
    assert 'give auto alone' in line


def test_no_more_steps_than_announced(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The last step is the last of those that the bar has."""
    seen: list[str] = []

    @contextmanager
    def steps(total: int) -> Iterator[Callable[[str], None]]:
        yield seen.append
        assert len(seen) == total, seen

    monkeypatch.setattr(command, 'steps', steps)
    assert main(['fit', f'{root}/bags/two_blade_train_1@0-50%', '--arm',
                 f'{root}/config/two_blade_arm.yaml', '--out', str(tmp_path / 'model')]) in {0, 1}
    assert seen[-1] == 'report'


@pytest.mark.parametrize(('kinds', 'announced'), [
    ('analytical', 10), ('analytical vibration', 11), ('analytical elastic', None)])
def test_the_number_of_steps_is_right_or_left_out(
    root: Path, monkeypatch: pytest.MonkeyPatch, kinds: str, announced: int | None,
) -> None:
    """A search for an elastic model takes as many as it needs; a tool takes one more."""
    totals: list[int | None] = []

    @contextmanager
    def steps(total: int | None) -> Iterator[Callable[[str], None]]:
        totals.append(total)
        raise TudorError('far enough')
        yield print
    monkeypatch.setattr(command, 'steps', steps)
    main(['fit', f'{root}/bags/two_blade_train_1', '--arm', f'{root}/config/two_blade_arm.yaml',
          '--out', 'model', '--models', *kinds.split()])
    assert totals == [announced]


def test_report_and_bundle_are_there(fitted: Path) -> None:
    """One directory holds model, arm, arrays and report."""
    assert sorted(item.name for item in fitted.iterdir()) == [
        'arm.yaml', 'data.npz', 'elm.npz', 'model.yaml', 'report.html']
    assert '</html>' in (fitted / 'report.html').read_text()


def test_model_of_another_arm_is_refused(
    fitted: Path, root: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """An arm given to evaluate must be the one that was fitted."""
    line = one_line(capsys, 'evaluate', '--model', fitted, '--arm', root / 'config/tudor.yaml',
                    root / 'bags/two_blade_test')
    assert 'two_blade_arm' in line and 'tudor' in line


def test_altered_model_is_refused(
    fitted: Path, root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """A coefficient changed by hand, or a file cut short, is found out."""
    for name, change in (('model.yaml', lambda b: b.replace(b'1', b'2', 1)),
                         ('model.yaml', lambda b: b[:-40]),
                         ('elm.npz', lambda b: b[:-1]),
                         ('arm.yaml', lambda b: b + b' ')):
        copy = tmp_path / 'copy'
        shutil.copytree(fitted, copy)
        (copy / name).write_bytes(change((copy / name).read_bytes()))
        line = one_line(capsys, 'evaluate', '--model', copy, root / 'bags/two_blade_test')
        assert str(copy / name) in line and 'fit the model again' in line
        shutil.rmtree(copy)


def test_nothing_is_written_over(
    fitted: Path, root: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """A bundle is replaced only on request, anything else never."""
    words = ['fit', root / 'bags/two_blade_train_1', '--arm', root / 'config/two_blade_arm.yaml']
    before = (fitted / 'model.yaml').read_bytes()
    line = one_line(capsys, *words, '--out', fitted)
    assert 'exists already; choose another --out, or add --overwrite' in line
    assert (fitted / 'model.yaml').read_bytes() == before
    line = one_line(capsys, *words, '--out', root / 'config', '--overwrite')
    assert 'so it is kept' in line and (root / 'config/tudor.yaml').is_file()


def test_overlapping_parts_are_refused(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """The same samples in training and test would flatter the model."""
    bag = root / 'bags/two_blade_train_1'
    line = one_line(capsys, 'fit', f'{bag}@0-60%', '--test', f'{bag}@50-100%', '--arm',
                    root / 'config/two_blade_arm.yaml', '--out', tmp_path / 'm')
    assert 'overlap' in line
    assert not (tmp_path / 'm').exists()


def test_a_copy_is_no_test(
    fitted: Path, root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """The bytes of a training bag under another name: no test, nor a bag to be left out."""
    bag, copy = root / 'bags/two_blade_train_1', tmp_path / 'another_day'
    shutil.copytree(bag, copy)
    words = ['--arm', root / 'config/two_blade_arm.yaml', '--out', tmp_path / 'm']
    for bags in ([bag, '--test', copy], [bag, copy]):
        line = one_line(capsys, 'fit', *bags, *words)
        assert str(bag) in line and str(copy) in line
        assert 'so it does not test the model' in line
    assert not (tmp_path / 'm').exists()
    assert main([str(word) for word in (
        'fit', f'{bag}@0-60%', '--test', f'{copy}@60-100%', '--models', 'analytical',
        *words)]) == 0  # other samples
    capsys.readouterr()
    assert main(['evaluate', '--model', str(fitted), str(copy), '--json']) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)['trained_on'] == [str(copy)]
    assert 'trained on this bag' in said.err and said.err.count('\n') == 1


def test_a_dead_gauge(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """A gauge that never changes has no fit, its model is not good, and everything says why."""
    from dataclasses import replace

    from tudor_dynamics.arm.description import load_arm
    from tudor_dynamics.bags.reader import read_recording
    from tudor_dynamics.bags.writer import recording_series, write_bag
    arm = load_arm(root / 'config/two_blade_arm.yaml')
    bags = []
    for number in (1, 2):
        real = read_recording(root / f'bags/two_blade_train_{number}', arm)
        assert real.strain is not None
        strain = real.strain.copy()
        strain[:, 1] = 7.25
        bags.append(tmp_path / f'dead_{number}')
        write_bag(bags[-1], recording_series(replace(real, strain=strain), arm))
    found = run_json(capsys, 'fit', *bags, '--arm', root / 'config/two_blade_arm.yaml', '--models',
                     'analytical', '--out', tmp_path / 'm', '--json')['strain']['analytical']
    assert found['verdict'] == 'usable'
    assert 'link3_hub never changed on leave one bag out' in ' '.join(found['reasons'])
    assert found['validation']['channels']['link3_hub']['fit'] is None
    assert found['validation']['channels']['link2_hub']['fit'] > 85.0
    report = (tmp_path / 'm' / 'report.html').read_text()
    assert 'link3_hub never changed' in report and 'n/a' in report
    assert main(['evaluate', '--model', str(tmp_path / 'm'), str(bags[0])]) == 0
    assert 'n/a' in capsys.readouterr().out


@pytest.mark.parametrize(('words', 'expected'), [
    (['--rate', '-5'], 'rate'),
    (['--models', 'elm', '--elm-hidden', '0'], '--elm-hidden 0: give 1'),
    (['--filter', 'zero_phase', '--cutoff', '70'], 'half the sample rate; the arm may'),
])
def test_impossible_options(
    words: list[str], expected: str, root: Path, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """An impossible setting is answered by one line that names it."""
    line = one_line(capsys, 'fit', root / 'bags/two_blade_train_1', '--arm',
                    root / 'config/two_blade_arm.yaml', '--out', tmp_path / 'm', *words)
    assert expected in line


def test_missing_bag_and_arm(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """Paths that do not exist are named."""
    arm = root / 'config/two_blade_arm.yaml'
    assert 'nowhere' in one_line(capsys, 'fit', tmp_path / 'nowhere', '--arm', arm, '--out',
                                 tmp_path / 'm')
    assert 'noarm.yaml' in one_line(capsys, 'fit', root / 'bags/two_blade_train_1', '--arm',
                                    tmp_path / 'noarm.yaml', '--out', tmp_path / 'm')
    assert 'nomodel' in one_line(capsys, 'evaluate', '--model', tmp_path / 'nomodel',
                                 root / 'bags/two_blade_test')


def test_a_model_of_noise_is_not_good_enough(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """Outputs that have nothing to do with the motion give exit code 1, or 0 if forced."""
    from tudor_dynamics.arm.description import load_arm
    from tudor_dynamics.bags.reader import read_recording
    from tudor_dynamics.bags.recording import Recording
    from tudor_dynamics.bags.writer import recording_series, write_bag
    arm = load_arm(root / 'config/two_blade_arm.yaml')
    real = read_recording(root / 'bags/two_blade_train_1', arm)
    noise = np.random.default_rng(0).normal(size=real.q.shape)
    fake = Recording(real.path, real.stamp, real.q, None, noise, 100 * noise, real.segments,
                     real.dt)
    write_bag(tmp_path / 'noise', recording_series(fake, arm))
    words = ['fit', tmp_path / 'noise', '--arm', root / 'config/two_blade_arm.yaml', '--json']
    found = run_json(capsys, *words, '--out', tmp_path / 'm1', code=1)
    assert found['strain']['analytical']['verdict'] == 'do not use'
    run_json(capsys, *words, '--out', tmp_path / 'm2', '--exit-zero', code=0)


@pytest.mark.shared
def test_reference_recordings(
    laboratory: Path, root: Path, shared_data: Path, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Analytical fits on the 80 s recordings; floors as the package promises them."""
    bags = shared_data / 'bags'
    config = root / 'config'
    found = run_json(capsys, 'evaluate', '--model', laboratory, bags / 'arm_200g_free_4',
                     '--json')
    assert found['strain']['analytical']['fit'] >= 92.5
    assert found['effort']['analytical']['fit'] >= 88.5
    run_json(capsys, 'fit', bags / 'emps_estimation', '--test', bags / 'emps_validation', '--arm',
             config / 'emps.yaml', '--out', tmp_path / 'emps', '--json')
    found = run_json(capsys, 'evaluate', '--model', tmp_path / 'emps', bags / 'emps_validation',
                     '--json')
    assert found['effort']['analytical']['relative_error'] <= 0.031
    bag = bags / 'ur10_exciting'
    run_json(capsys, 'fit', f'{bag}@0-60%', '--test', f'{bag}@60-100%', '--arm',
             config / 'ur10.yaml', '--models', 'analytical', '--out', tmp_path / 'ur10', '--json')
    found = run_json(capsys, 'evaluate', '--model', tmp_path / 'ur10', f'{bag}@60-100%', '--json')
    assert found['effort']['analytical']['relative_error'] <= 0.045


@pytest.mark.shared
def test_real_arm_rings(
    root: Path, shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """The undamped TUDOR arm: strain fit of 78 %, and the report says how it rings."""
    assert import_merit([str(shared_data / 'merit_exp1.csv'), '--out', str(tmp_path / 'bag')]) == 0
    run_json(capsys, 'fit', f'{tmp_path}/bag@0-50%', '--test', f'{tmp_path}/bag@50-100%', '--arm',
             root / 'config/tudor.yaml', '--out', tmp_path / 'm', '--json')
    found = run_json(capsys, 'evaluate', '--model', tmp_path / 'm', f'{tmp_path}/bag@50-100%',
                     '--json')
    assert found['strain']['analytical']['fit'] >= 78.0
    report = (tmp_path / 'm' / 'report.html').read_text()
    assert 'rings' in report and 'Hz' in report


@pytest.mark.parametrize('where', ['directory', 'full disk'])
def test_traces_that_cannot_be_saved(
    fitted: Path, root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    request: pytest.FixtureRequest, where: str,
) -> None:
    """``--save`` to a directory or a full disk is one line, and leaves no scratch file."""
    place: Path = request.getfixturevalue('small_disk') if where == 'full disk' else tmp_path
    target = place / 'r.npz'
    if where == 'directory':
        target.mkdir()
    before = sorted(place.iterdir())
    line = one_line(capsys, 'evaluate', '--model', fitted, root / 'bags/two_blade_test', '--rate',
                    'full', '--save', target)
    assert line.startswith(
        f'tudor evaluate: --save {target}: cannot be written (' if where == 'full disk' else
        f'tudor evaluate: {target}: exists already; choose another --save')
    assert sorted(place.iterdir()) == before


def test_a_gauge_that_no_bag_has_is_left_out(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """A description may have more gauges than were recorded: models of the others, and a word."""
    content = yaml.safe_load((root / 'config/two_blade_arm.yaml').read_text(encoding='utf-8'))
    content['gauges'].append({'name': 'link3_mid', 'joint': 'joint3', 'distance': 0.2})
    content['sensors'] = [{'gauge': 'link3_mid', 'gain': 100.0, 'noise': 2.0}]
    arm, out = tmp_path / 'arm.yaml', tmp_path / 'model'
    arm.write_text(yaml.safe_dump(content), encoding='utf-8')
    bag = root / 'bags/two_blade_train_1'
    capsys.readouterr()
    assert main(['fit', str(bag), '--models', 'analytical', '--arm', str(arm), '--out', str(out),
                 '--exit-zero']) == 0
    said = capsys.readouterr()
    assert "no bag has the strain of 'link3_mid'" in said.err
    found = run_json(capsys, 'evaluate', '--model', out, bag, '--json')
    assert set(found['strain']['analytical']['channels']) == {'link2_hub', 'link3_hub'}


def test_a_flexible_tool_with_the_models(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Currents do not show its size, which is said before the fit; torques do."""
    words = ['fit', f'{root}/bags/two_blade_train_1@0-50%', '--models', 'vibration', '--arm',
             f'{root}/config/two_blade_arm.yaml', '--out', str(tmp_path / 'm'), '--exit-zero']
    assert main(words) == 2
    assert 'are in A, but the model of vibration needs torques' in capsys.readouterr().err
    tool = FlexibleTool.model_validate({
        'motion': 'measured', 'rests': 4, 'turn': [0.3, 0.2, 0.1], 'place': [0.1, 0.0, 0.3],
        'mass': 0.5, 'length': 0.3, 'frequencies': [3.0], 'damping': [0.02],
        'covariance': np.eye(10).tolist(), 'quiet': 0.02, 'scatter': 0.1,
        'pushed': np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]).tolist()})
    monkeypatch.setattr(library, 'check_efforts', lambda arm: None)
    monkeypatch.setattr(loads, 'tool_of_bags', lambda arm, bags, model: tool)
    assert main(words) == 0
    said = ' '.join(capsys.readouterr().out.split())
    assert ('tool: rings at 3 Hz without gravity, damping ratio 0.02, 0.5 kg at 0.3 m, by 4 rests '
            'after measured motion; these moves do not show rotation: see tudor excite '
            '--for vibration') in said
    assert load_bundle(tmp_path / 'm').tool == tool
    arm = load_arm(root / 'config/two_blade_arm.yaml')
    bare = library.fit(words[1], arm, settings=FitSettings(tool=True), bare=True)
    assert bare.tool == tool
