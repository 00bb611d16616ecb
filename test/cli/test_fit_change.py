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

"""Bags added to a model, and taken from it."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from tudor_dynamics.cli.main import main
from tudor_dynamics.models.bundle_io import load_bundle

ONE, TWO = 'two_blade_train_1', 'two_blade_train_2'
FIXED = ('--estimator', 'wls', '--currents', 'separate', '--friction', 'viscous', 'coulomb',
         '--filter', 'zero_phase')


@pytest.fixture(scope='module')
def models(root, tmp_path_factory):
    folder = tmp_path_factory.mktemp('change')
    arm = root / 'config' / 'two_blade_arm.yaml'
    for name, bags in (('one', [ONE]), ('both', [ONE, TWO])):
        assert main(['fit', *(str(root / 'bags' / bag) for bag in bags), '--arm', str(arm),
                     '--out', str(folder / name), *FIXED, '--force']) == 0
    return folder


@pytest.fixture()
def model(models, tmp_path):
    shutil.copytree(models / 'one', tmp_path / 'model')
    return tmp_path / 'model'


def coefficients(path):
    bundle = load_bundle(path)
    return [sets[output]['analytical'].coefficients() for sets in (
        bundle.models, bundle.causal.models) for output in ('effort', 'strain')]


def test_an_added_bag_gives_what_a_fit_to_both_gives(models, model, root, capsys):
    assert main(['fit', '--to', str(model), '--add', str(root / 'bags' / TWO)]) == 0
    told = capsys.readouterr().out
    assert 'relative error of a bag left out' in told
    for changed, whole in zip(coefficients(model), coefficients(models / 'both'), strict=True):
        assert np.allclose(changed, whole, rtol=1e-10, atol=1e-300)
    facts = load_bundle(model).facts
    assert [item['bag'].rpartition('/')[2] for item in facts['training']] == [ONE, TWO]
    assert (model / 'report.html').exists()


def test_a_dropped_bag_leaves_no_trace(models, model, root, tmp_path, capsys):
    other = str(root / 'bags' / TWO)
    assert main(['fit', '--to', str(models / 'both'), '--drop', other, '--out',
                 str(tmp_path / 'less'), '--json']) == 0
    told = json.loads(capsys.readouterr().out)
    assert [name.rpartition('/')[2] for name in told['training']] == [ONE]
    for changed, whole in zip(coefficients(tmp_path / 'less'), coefficients(model), strict=True):
        assert np.allclose(changed, whole, rtol=1e-10, atol=1e-300)


@pytest.mark.parametrize('arguments, message', [
    (['--drop', 'other'], 'the model was not fitted to it'),
    (['--drop', 'BAGS/two_blade_train_1'], 'no bag would be left'),
    (['--add', 'BAGS/two_blade_train_1'], 'fitted to it already'),
    ([], 'nothing is to be changed'),
    (['--arm', 'x.yaml', '--add', 'y'], '--add and --drop change'),
    (['--add', 'BAGS/none'], 'no such file')])
def test_wrong_changes_are_refused(model, root, capsys, arguments, message):
    before = (model / 'model.yaml').read_bytes()
    given = [word.replace('BAGS', str(root / 'bags')) for word in arguments]
    assert main(['fit', '--to', str(model), *given]) == 2
    assert message in capsys.readouterr().err
    assert (model / 'model.yaml').read_bytes() == before


def test_a_copy_of_a_bag_is_no_other_bag(model, root, tmp_path, capsys):
    shutil.copytree(root / 'bags' / ONE, tmp_path / 'copy')
    assert main(['fit', '--to', str(model), '--add', str(tmp_path / 'copy')]) == 2
    assert 'the same samples as' in capsys.readouterr().err


@pytest.mark.parametrize('arguments, message', [
    (['bag', '--out', 'x'], 'there is no --arm'), (['--arm', 'x', '--out', 'y'], 'no bag'),
    (['bag', '--arm', 'x'], 'no --out'), (['--add', 'bag'], '--add and --drop change')])
def test_what_lacks_is_named(capsys, arguments, message):
    assert main(['fit', *arguments]) == 2
    assert message in capsys.readouterr().err


def test_without_data_a_model_says_so(model, root, capsys):
    bundle = load_bundle(model)
    from tudor_dynamics.models.bundle_io import save_bundle
    save_bundle(bundle, model, overwrite=True)  # read without its data: none are written
    assert main(['fit', '--to', str(model), '--add', str(root / 'bags' / TWO)]) == 2
    assert 'has not kept what each of its bags came to' in capsys.readouterr().err
