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

"""``tudor payload``: loads of bags, with what is known to compare with."""

from __future__ import annotations

import json
from pathlib import Path

from printed import unwrapped
import pytest

from tudor_dynamics.cli.main import main


@pytest.fixture(scope='module')
def model(tmp_path_factory: pytest.TempPathFactory, root: Path) -> Path:
    """Fit a model of an empty arm to a part of the sample recording."""
    out = tmp_path_factory.mktemp('payload') / 'model'
    assert main(['fit', str(root / 'bags/two_blade_train_1'), '--arm',
                 str(root / 'config/two_blade_arm.yaml'), '--filter', 'causal', '--estimator',
                 'wls', '--friction', 'viscous', 'coulomb', '--currents', 'separate', '--out',
                 str(out), '--exit-zero']) == 0
    return out


def test_the_same_load_is_none(model: Path, root: Path, capsys) -> None:
    """A bag with the load of the model has none beyond it, told in parts of the arm's moment."""
    capsys.readouterr()
    assert main(['payload', str(root / 'bags/two_blade_test'), '--model', str(model),
                 '--json']) == 0
    found = next(iter(json.loads(capsys.readouterr().out)['bags'].values()))
    assert found['verdict'] == 'no load' and found['scale'] == 'nothing'
    assert found['mass'] is None and abs(found['relative']) < 0.05
    assert set(found['outputs']) == {'effort', 'strain'}
    assert main(['payload', str(root / 'bags/two_blade_test'), '--model', str(model)]) == 0
    said = capsys.readouterr().out
    assert 'kilograms need' in unwrapped(said) and said.count('+-') == 1, 'one estimate'


def test_wrong_input(model: Path, root: Path, capsys) -> None:
    """A kind that the bundle has not, and a mass of another bag, are said in a line."""
    bag = str(root / 'bags/two_blade_test')
    assert main(['payload', bag, '--model', str(model), '--kind', 'elastic']) == 2
    assert 'the load is to be estimated by the model of kind elastic' in capsys.readouterr().err
    assert main(['payload', bag, '--model', str(model), '--payload-of', 'other=0.1']) == 2
    assert 'is not among the bags of the command' in capsys.readouterr().err


@pytest.mark.shared
def test_two_known_payloads(shared_data: Path, root: Path, tmp_path: Path, capsys) -> None:
    """A model of 0 and 200 g tells both on other bags, damped or not, to 5 g (undamped 10)."""
    bags = shared_data / 'bags'
    known = [f'{bags}/arm_000g_free_1=0', f'{bags}/arm_200g_free_1=0.2']
    assert main(['fit', *(text.split('=')[0] for text in known), '--payload-of', *known, '--arm',
                 str(root / 'config/two_blade_arm.yaml'), '--out', str(tmp_path / 'model'),
                 '--exit-zero']) == 0
    true = {f'{bags}/arm_200g_free_2': 0.2, f'{bags}/arm_200g_free_4': 0.2,
            f'{bags}/arm_000g_undamped_1': 0.0}
    capsys.readouterr()
    assert main(['payload', *true, '--model', str(tmp_path / 'model'), '--payload-of',
                 *(f'{bag}={mass}' for bag, mass in true.items()), '--json']) == 0
    found = json.loads(capsys.readouterr().out)['bags']
    for bag, mass in true.items():
        limit = 0.01 if 'undamped' in bag else 0.005
        assert abs(found[bag]['mass'] - mass) < limit and found[bag]['scale'] == 'payloads'
        assert found[bag]['verdict'] == ('load' if mass else 'no load')
