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

"""The model bundle: nothing lost, nothing damaged accepted, nothing half written."""

from __future__ import annotations

from collections.abc import Callable
import hashlib
import io
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any
import zipfile

import numpy as np
import pytest
from sample_arms import gauge, planar_arm, random_states
from tudor_dynamics import files
from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import (
    CausalModels, check_bundle_target, load_bundle, MAX_BYTES, ModelBundle, save_bundle, unpack)
from tudor_dynamics.models.elm import ExtremeLearningMachine
from tudor_dynamics.models.regressor import EffortRegressor, StrainRegressor
import yaml

ARM = planar_arm(gauges=[gauge('g1', 'j1', 0.1), gauge('g2', 'j2', 0.1)])
SPEC = PreprocessingSpec(filter='zero_phase', rate=None, cutoff=7.3)
FACTS = {'validation': {'fit': 91.25}, 'training': [{'bag': 'runs/ä b: 1', 'samples': 3}]}


def _bundle(arm: Arm = ARM, facts: dict[str, Any] | None = None) -> ModelBundle:
    n = len(arm.active_joints)
    motion = random_states(300, n)
    models: dict[str, Any] = {}
    for output, regressor in (('effort', EffortRegressor(arm)), ('strain', StrainRegressor(arm))):
        rows = regressor.rows(motion)
        truth = np.random.default_rng(0).uniform(0, 1, rows.shape[2])
        values = rows @ truth + np.random.default_rng(1).normal(0, 0.1, rows.shape[:2])
        models[output] = {
            'analytical': AnalyticalModel(regressor, n).fit(motion, values),
            'elm': ExtremeLearningMachine(regressor.channels, hidden=5, clip=output == 'effort')
            .fit(motion, values)}
    return ModelBundle(arm, SPEC, models, FACTS if facts is None else facts)


@pytest.fixture(scope='module')
def saved(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Give the files of one bundle."""
    path = tmp_path_factory.mktemp('bundle') / 'model'
    save_bundle(_bundle(), path)
    return {file.name: file.read_bytes() for file in path.iterdir()}


@pytest.fixture
def model(saved: dict[str, bytes], tmp_path: Path) -> Path:
    """Give a fresh copy of the bundle."""
    path = tmp_path / 'model'
    path.mkdir()
    for name, data in saved.items():
        (path / name).write_bytes(data)
    return path


def _rewrite(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    """Change the head and give it a checksum that fits."""
    text = (path / 'model.yaml').read_text(encoding='utf-8')
    head = yaml.safe_load(text.rpartition('checksum: ')[0])
    change(head)
    body = yaml.safe_dump(head, sort_keys=False, allow_unicode=True)
    _write_body(path, body)


def _write_body(path: Path, body: str) -> None:
    checksum = hashlib.sha256(body.encode()).hexdigest()
    (path / 'model.yaml').write_text(f'{body}checksum: {checksum}\n', encoding='utf-8')


def _replace_file(path: Path, name: str, data: bytes) -> None:
    (path / name).write_bytes(data)
    digest = hashlib.sha256(data).hexdigest()
    _rewrite(path, lambda head: head['files'].update({name: digest}))


@pytest.mark.parametrize('source', ['dh', 'urdf'])
def test_round_trip(source: str, tmp_path: Path, root: Path) -> None:
    """Coefficients, arrays, facts, preprocessing and arm come back to the last bit."""
    arm = ARM if source == 'dh' else load_arm(root / 'config' / 'tudor.yaml')
    before = _bundle(arm)
    save_bundle(before, tmp_path / 'new' / 'model')
    after = load_bundle(tmp_path / 'new' / 'model', arm=arm)
    assert ((tmp_path / 'new' / 'model' / 'arm.urdf').exists()) == (source == 'urdf')
    assert after.facts == FACTS
    assert after.preprocessing == SPEC
    assert after.arm.digest == arm.digest
    assert after.arm.spec.motors == arm.spec.motors
    for output in ('effort', 'strain'):
        one, other = before.models[output], after.models[output]
        for a, b in zip(one['analytical'].groups_, other['analytical'].groups_, strict=True):
            assert np.array_equal(a.estimate.parameters, b.estimate.parameters)
            assert np.array_equal(a.estimate.standard_errors, b.estimate.standard_errors)
            assert a.estimate.condition == b.estimate.condition
            assert a.base.names == b.base.names and np.array_equal(a.base.kept, b.base.kept)
        for name in ('input_weights_', 'biases_', 'output_weights_', 'input_range_'):
            assert np.array_equal(getattr(one['elm'], name), getattr(other['elm'], name))
        assert one['elm'].clip == other['elm'].clip


def test_unexcited_survive(tmp_path: Path) -> None:
    """A parameter of unknown size is still one after loading, and prediction works."""
    motion = random_states(100, 2)
    motion[:, [3, 5]] = 0.0
    regressor = EffortRegressor(ARM)
    values = regressor.rows(motion).sum(axis=2)
    fitted = AnalyticalModel(regressor, 2).fit(motion, values)
    assert fitted.groups_[0].estimate.unexcited
    save_bundle(ModelBundle(ARM, SPEC, {'effort': {'analytical': fitted}}), tmp_path / 'model')
    loaded = load_bundle(tmp_path / 'model').models['effort']['analytical']
    assert loaded.groups_[0].estimate.unexcited == fitted.groups_[0].estimate.unexcited
    assert np.array_equal(loaded.groups_[0].estimate.standard_errors,
                          fitted.groups_[0].estimate.standard_errors)


@pytest.mark.parametrize('name', ['model.yaml', 'arm.yaml', 'elm.npz'])
def test_damage(name: str, model: Path, saved: dict[str, bytes]) -> None:
    """No file may be cut short or altered at any place; both ends are tried bit by bit."""
    whole = saved[name]
    size = len(whole)
    places = sorted({*range(0, size, max(1, size // 60)), *range(max(0, size - 90), size, 3),
                     0, 1, size - 1})
    for at in places:
        for damaged in (whole[:at], whole[:at] + bytes([whole[at] ^ (1 << at % 8)])
                        + whole[at + 1:]):
            (model / name).write_bytes(damaged)
            with pytest.raises(ModelError, match='model'):
                load_bundle(model)
    (model / name).write_bytes(whole + b'\n')
    with pytest.raises(ModelError):
        load_bundle(model)
    (model / name).unlink()
    with pytest.raises(ModelError, match='cannot be read'):
        load_bundle(model)
    (model / name).write_bytes(whole)
    load_bundle(model)


def test_nothing_there(tmp_path: Path) -> None:
    """A bundle that is not there is named."""
    with pytest.raises(ModelError, match='nowhere: no such folder; give the folder that'):
        load_bundle(tmp_path / 'nowhere')
    with pytest.raises(ModelError, match=': model.yaml cannot be read'):
        load_bundle(tmp_path)


@pytest.mark.skipif(not hasattr(os, 'mkfifo'), reason='no named pipes here')
def test_pipe_in_place_of_a_file(model: Path) -> None:
    """A pipe, which might never end, is not read."""
    (model / 'arm.yaml').unlink()
    os.mkfifo(model / 'arm.yaml')
    with pytest.raises(ModelError, match='pipe or socket, not a file'):
        load_bundle(model)


def test_other_arm(model: Path) -> None:
    """A model of another arm is refused, with both names."""
    longer = planar_arm(gauges=[gauge('g1', 'j1', 0.11), gauge('g2', 'j2', 0.1)])
    with pytest.raises(ModelError, match='fitted with another description .* or fit a model with'):
        load_bundle(model, arm=longer)
    assert load_bundle(model, arm=ARM).arm.name == 'sample'


def _hidden(value: Any) -> Callable[[dict[str, Any]], None]:
    return lambda head: head['outputs']['effort']['elm'].update(hidden=value)


def _coefficient(**changes: Any) -> Callable[[dict[str, Any]], None]:
    return lambda head: head['outputs']['effort']['analytical']['groups'][0]['coefficients'][
        0].update(changes)


@pytest.mark.parametrize(('change', 'message'), [
    (lambda head: head.update(version=2), 'format version 2, but this program reads version 1'),
    (lambda head: head.update(format='other'), 'the file is no model'),
    (lambda head: head.pop('outputs'),
     'model.yaml: outputs is missing; fit the model again'),
    (lambda head: head.update(preprocessing={'rate': -1}), 'must be above 0'),
    (lambda head: head['files'].update({'../x': 'y'}), 'lists an unknown file'),
    (lambda head: head['files'].pop('arm.yaml'), 'arm'),
    (lambda head: head['files'].pop('elm.npz'), 'found nothing'),
    (lambda head: head['arm'].update(digest='0'), 'does not match the model'),
    (lambda head: head['outputs'].update(colour={'elm': {}}),
     "'effort' or 'strain', found 'colour'"),
    (lambda head: head['outputs']['effort'].update(oracle={}), 'analytical, elm, elastic'),
    (lambda head: head['outputs']['strain']['analytical'].update(form='both'), 'strain form'),
    (lambda head: head['outputs']['effort']['analytical']['groups'].clear(), 'channels are'),
    (_coefficient(value=float('nan')), 'a finite number'),
    (_coefficient(value=float('inf')), 'a finite number'),
    (_coefficient(value=1e300), 'a finite number up to 1e.15'),
    (_coefficient(column='x' * 5000), 'has no parameter|xxx[.]{3}$'),
    (lambda head: head['outputs']['effort']['analytical']['groups'][0].update(
        residual_std=[1e200]), 'expected 0 to 1e.15'),
    (_coefficient(column='Izz(tail)'), 'has no parameter'),
    (_coefficient(value=[1]), 'fit the model again'),
    (_hidden(6), 'expected shape'),
    (_hidden(10**9), 'ELM of 1000000000 neurons'),
    (_hidden(float('inf')), 'fit the model again'),
    (_hidden(None), 'fit the model again'),
])
def test_wrong_content(
    model: Path, change: Callable[[dict[str, Any]], None], message: str,
) -> None:
    """Content that no fit writes is refused even where every checksum fits."""
    _rewrite(model, change)
    with pytest.raises(ModelError, match=message):
        load_bundle(model)


def _archive(**arrays: Any) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def test_pickle_is_refused(model: Path) -> None:
    """Objects in the array archive are not unpickled, whatever the checksum says."""
    _replace_file(model, 'elm.npz', _archive(effort_elm_biases=np.array([print, {}], object)))
    with pytest.raises(ModelError, match='allow_pickle=False'):
        load_bundle(model)


@pytest.mark.parametrize('counts', [-1.0, np.nan, np.inf, 1e300])
def test_sums_over_bags_that_count_nothing(counts: float) -> None:
    """What data.npz says was summed up is a number of samples."""
    group = SimpleNamespace(base=SimpleNamespace(kept=(0,), channels=(0,)))
    content = _archive(m_triangular=np.zeros(1), m_0=np.zeros((1, 1, 2, 2)),
                       m_0_n=np.full((1, 1), counts))
    with pytest.raises(ModelError, match='m_0_n no counts'):
        unpack({'m': SimpleNamespace(groups_=(group,))}, content,  # type: ignore[dict-item]
               Path('data.npz'))


def test_bombs(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither an archive nor YAML can unpack to much more than they are."""
    monkeypatch.setitem(MAX_BYTES, 'elm.npz', 100_000)
    bomb = _archive(a=np.zeros(1_000_000))
    assert len(bomb) < 100_000
    _replace_file(model, 'elm.npz', bomb)
    with pytest.raises(ModelError, match='more than the limit of 0.1 MB'):
        load_bundle(model)
    (model / 'elm.npz').write_bytes(bytes(100_001))
    with pytest.raises(ModelError, match='larger than 100000 bytes'):
        load_bundle(model)
    levels = '\n'.join(f'  {b}: &{b} [{", ".join([f"*{a}"] * 9)}]'
                       for a, b in zip('abcdefg', 'bcdefgh'))
    _write_body(model, f'format: x\nfacts:\n  a: &a [1]\n{levels}\n')
    with pytest.raises(ModelError, match='more than 300000 values'):
        load_bundle(model)
    _write_body(model, '- ' * 100_000)
    with pytest.raises(ModelError, match='more than 50 levels'):
        load_bundle(model)
    _write_body(model, 'a: [1, }\n')
    with pytest.raises(ModelError, match='no valid YAML'):
        load_bundle(model)


def test_weights_that_would_overflow(model: Path, saved: dict[str, bytes]) -> None:
    """An ELM whose weights are numbers, but none that a fit gives, is refused."""
    with np.load(io.BytesIO(saved['elm.npz'])) as archive:
        arrays = {name: archive[name] for name in archive.files}
    arrays['effort_elm_output_weights'][0, 0] = 1e300
    _replace_file(model, 'elm.npz', _archive(**arrays))
    with pytest.raises(ModelError, match='values beyond 1e.15'):
        load_bundle(model)


@pytest.mark.parametrize('data', [b'', b'PK', b'no archive', _archive(a=np.array(['x'])),
                                  _archive(a=np.array([1j])), _archive(a=np.array([True]))])
def test_no_archive(model: Path, data: bytes) -> None:
    """What is no archive of numbers is said to be none."""
    _replace_file(model, 'elm.npz', data)
    with pytest.raises(ModelError, match='elm.npz: .*(a valid NumPy archive|made of numbers)'):
        load_bundle(model)


def test_archive_that_lies_about_its_size(model: Path) -> None:
    """An array that claims more values than the archive holds ends in an error, not in memory."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {'descr': '<f8', 'fortran_order': False, 'shape': (10**13,)})
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, 'w') as archive:
        archive.writestr('effort_elm_biases.npy', header.getvalue() + bytes(80))
    _replace_file(model, 'elm.npz', buffer.getvalue())
    with pytest.raises(ModelError, match='not a valid NumPy archive'):
        load_bundle(model)


def test_urdf_outside(model: Path, saved: dict[str, bytes]) -> None:
    """The arm inside does not reach for files outside of the bundle."""
    content = yaml.safe_load(saved['arm.yaml'])
    content['kinematics'] = {'urdf': '../../etc/passwd'}
    _replace_file(model, 'arm.yaml', yaml.safe_dump(content).encode())
    with pytest.raises(ModelError, match='not arm.urdf'):
        load_bundle(model)


def test_overwrite(tmp_path: Path) -> None:
    """A bundle is replaced on request alone, anything else never; the message says what to do."""
    path = tmp_path / 'model'
    save_bundle(_bundle(), path)
    with pytest.raises(ModelError, match='exists already; choose another path=, or add overwrite'):
        save_bundle(_bundle(), path)
    (path / 'report.html').write_text('old')
    save_bundle(_bundle(facts={'new': True}), path, overwrite=True)
    assert load_bundle(path).facts == {'new': True}
    assert not (path / 'report.html').exists()
    other = tmp_path / 'thesis'
    other.mkdir()
    (other / 'chapter1.tex').write_text('years')
    with pytest.raises(ModelError, match='was not written by this command, so it is kept'):
        check_bundle_target(other, overwrite=True)
    assert sorted(p.name for p in tmp_path.iterdir()) == ['model', 'thesis']


@pytest.mark.parametrize('overwrite', [False, True])
@pytest.mark.parametrize('broken', ['write_bytes', 'replace'])
def test_failure_leaves_all_as_it_was(
    broken: str, overwrite: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A full disk or a refused rename leaves the old bundle, and nothing half written."""
    path = tmp_path / 'model'
    if overwrite:
        save_bundle(_bundle(facts={'old': True}), path)
    real = {'write_bytes': Path.write_bytes, 'replace': os.replace}[broken]

    def fail(first: Any, second: Any) -> Any:
        if (broken == 'write_bytes' and first.name == 'model.yaml') or (
                broken == 'replace' and second == path and '.old.' not in str(first)):
            raise OSError(28, 'No space left on device')
        return real(first, second)

    with monkeypatch.context() as patch:
        patch.setattr(Path if broken == 'write_bytes' else files.os, broken, fail)
        with pytest.raises(ModelError, match='cannot be written .No space left'):
            save_bundle(_bundle(), path, overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == (['model'] if overwrite else [])
    if overwrite:
        assert load_bundle(path).facts == {'old': True}


def test_reader_never_sees_half(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """While files are written a reader finds the bundle from before, whole."""
    path = tmp_path / 'model'
    save_bundle(_bundle(facts={'old': True}), path)
    seen = []
    real = Path.write_bytes

    def spy(file: Path, data: bytes) -> int:
        seen.append(load_bundle(path).facts)
        return real(file, data)

    monkeypatch.setattr(Path, 'write_bytes', spy)
    save_bundle(_bundle(facts={'new': True}), path, overwrite=True)
    assert seen == [{'old': True}] * len([*path.iterdir()])
    assert load_bundle(path).facts == {'new': True}


def test_place_that_cannot_be_written(tmp_path: Path) -> None:
    """A parent that is a file is an error with its name, not a traceback."""
    (tmp_path / 'file').write_text('')
    with pytest.raises(ModelError, match='file/model: cannot be written'):
        save_bundle(_bundle(), tmp_path / 'file' / 'model')


def test_causal_models_beside_the_others(tmp_path: Path) -> None:
    """What runs beside the robot comes back apart from what judges recordings, arrays included."""
    causal = PreprocessingSpec(filter='causal')
    bundle = _bundle()
    bundle.causal = CausalModels(causal, _bundle().models)
    save_bundle(bundle, tmp_path / 'model')
    loaded = load_bundle(tmp_path / 'model')
    assert loaded.preprocessing == SPEC
    beside = loaded.beside_robot()
    assert beside.preprocessing == causal and beside.causal is None and beside.facts == FACTS
    assert beside.beside_robot() is beside
    motion = random_states(20, 2)
    for output, kinds in bundle.causal.models.items():
        for kind, model in kinds.items():
            assert np.array_equal(beside.models[output][kind].predict(motion),
                                  model.predict(motion))


def test_chosen_friction_is_the_same_arm(tmp_path: Path) -> None:
    """A bundle whose friction was chosen fits the description that left it open, no other arm."""
    chosen = ARM.with_joints({'j1': {'friction': ('viscous', 'coulomb', 'offset')}})
    save_bundle(_bundle(chosen), tmp_path / 'model')
    loaded = load_bundle(tmp_path / 'model', arm=ARM)
    assert loaded.arm.joints[0].friction == ('viscous', 'coulomb', 'offset')
    with pytest.raises(ModelError, match='set arm= to that description, or fit a model with'):
        load_bundle(tmp_path / 'model', arm=planar_arm(gauges=[gauge('g1', 'j1', 0.2),
                                                               gauge('g2', 'j2', 0.1)]))
