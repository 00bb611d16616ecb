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

"""A kind of model that the package does not know: fitted, judged, saved, read, evaluated."""

from __future__ import annotations

import json
from pathlib import Path

from harmonic_kind import fourth_kind, HarmonicModel  # noqa: F401
import numpy as np
import pytest
from sample_arms import random_states

from tudor_dynamics.cli.main import main
from tudor_dynamics.errors import ModelError, UsageError
from tudor_dynamics.identification.fit import FitSettings
from tudor_dynamics.models.bundle import KINDS, load_bundle, save_bundle


@pytest.fixture
def model(fourth_kind: str, root: Path, tmp_path: Path) -> Path:  # noqa: F811
    """Fit it to the sample bags beside the analytical model."""
    bags = [str(root / f'bags/two_blade_train_{i}') for i in (1, 2)]
    assert main(['fit', *bags, '--models', 'analytical', fourth_kind, '--arm',
                 str(root / 'config/two_blade_arm.yaml'), '--out', str(tmp_path / 'm')]) == 0
    return tmp_path / 'm'


def test_from_fit_to_evaluation(
    model: Path, root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """Fit, report, bundle and evaluation take it as any other; so does the detector."""
    bundle = load_bundle(model)
    assert 'harmonic' in (model / 'report.html').read_text()
    save_bundle(bundle, tmp_path / 'again')
    assert (tmp_path / 'again/elm.npz').read_bytes() == (model / 'elm.npz').read_bytes()
    motion = random_states(50, 2, 1)
    again = load_bundle(tmp_path / 'again').models
    for output, kinds in bundle.models.items():
        assert isinstance(kinds['harmonic'], HarmonicModel)
        assert np.array_equal(again[output]['harmonic'].predict(motion),
                              kinds['harmonic'].predict(motion))
    bag = str(root / 'bags/two_blade_test')
    capsys.readouterr()
    assert main(['evaluate', bag, '--model', str(model), '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert found['effort']['harmonic']['fit'] > 60.0 and found['strain']['harmonic']['fit'] > 60.0
    assert main(['evaluate', bag, '--model', str(model), '--collisions', '--kind', 'harmonic',
                 '--json']) == 0
    assert 'strain' in capsys.readouterr().out


def test_a_bundle_of_a_kind_that_is_gone(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the entry the bundle is refused with what this version knows."""
    monkeypatch.delitem(KINDS, 'harmonic')
    with pytest.raises(ModelError, match="'harmonic'; this version reads analytical, elm, ela"):
        load_bundle(model)
    with pytest.raises(UsageError, match='harmonic'):
        FitSettings(kinds=('harmonic',))
