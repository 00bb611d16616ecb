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

"""``tudor fit --models elastic`` and what ``tudor evaluate`` does with its model."""

from __future__ import annotations

from dataclasses import replace
import json
from pathlib import Path
from typing import Any

from elastic_making import lone_arm, lone_recording, LONE_TRUTH
import pytest
from tudor_dynamics.arm.description import Arm
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.writer import recording_series, write_bag
from tudor_dynamics.cli.main import main
import yaml

RECORD = lone_recording(3, 9.0)
ALONE = ('--models', 'elastic', '--rate', 'full', '--payload-of')


def described(path: Path, arm: Arm, **changes: Any) -> Path:
    """Write the description of an arm, parts of it changed, or left out where None is given."""
    content = arm.spec.model_dump(mode='json', exclude_defaults=True) | changes
    path.write_text(yaml.safe_dump({k: v for k, v in content.items() if v is not None}))
    return path


def saved(path: Path, recording: Recording) -> Path:
    """Write a bag of a recording."""
    write_bag(path, recording_series(recording, lone_arm()))
    return path


@pytest.fixture(scope='module')
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Describe the blade, record it, fit it once."""
    place = tmp_path_factory.mktemp('elastic')
    arm = described(place / 'arm.yaml', lone_arm())
    bag = saved(place / 'bag', RECORD)
    assert main(['fit', str(bag), '--test', str(saved(place / 'test', lone_recording(4, 9.0))),
                 '--arm', str(arm), '--out', str(place / 'model'), *ALONE, f'{bag}=0.2',
                 f'{place / "test"}=0.2']) == 0
    return place


def one_line(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """Run the command on wrong input and give the one line that it answers."""
    capsys.readouterr()
    assert main([str(word) for word in words]) == 2
    captured = capsys.readouterr()
    lines = [line for line in captured.err.splitlines() if not line.startswith('warning: ')]
    assert len(lines) == 1 and 'Traceback' not in captured.err
    return lines[0]


def test_fit_and_evaluate(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The model on disk has the parameters that were found, and the figures of the fit."""
    head = yaml.safe_load((place / 'model' / 'model.yaml').read_text())
    physical = head['outputs']['strain']['elastic']['physical']
    assert {p['name']: p['value'] for p in physical}['gear(j1)'] == pytest.approx(
        LONE_TRUTH['gear(j1)'], rel=0.03)
    capsys.readouterr()
    assert main(['evaluate', '--model', str(place / 'model'), str(place / 'test'), '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert found['strain']['elastic']['fit'] > 97.0
    for output in ('effort', 'strain'):
        said = head['facts']['validation'][output]['elastic']['validation']['fit']
        assert found[output]['elastic']['fit'] == pytest.approx(said, rel=1e-5)
    assert 'elastic' in (place / 'model' / 'report.html').read_text()


def test_effort_without_strain(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Where a bag has no strain, the model still predicts its effort."""
    bag = saved(place / 'bare', replace(RECORD, strain=None))
    capsys.readouterr()
    assert main(['evaluate', '--model', str(place / 'model'), str(bag), '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert not found.get('strain')
    assert found['effort']['elastic']['fit'] > 90.0


def test_collisions_need_thresholds_of_that_kind(
    place: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """Seconds of free motion give thresholds; a kind that the model has not is told."""
    words = ('evaluate', '--collisions', '--model', place / 'model', place / 'test', '--kind')
    assert main([*map(str, words), 'elastic']) == 0
    line = one_line(capsys, *words, 'analytical')
    assert 'no model of kind analytical' in line and 'give --kind elastic' in line


@pytest.mark.parametrize(('changes', 'part'), [
    ({'links': None, 'motors': None}, 'elastic models need'),
    ({'gauges': None}, 'has no gauges, which the elastic model needs')])
def test_arms_that_do_not_allow_it(
    changes: dict[str, None], part: str, place: Path, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """An arm without links or without gauges is refused before any bag is read."""
    arm = described(tmp_path / 'less.yaml', lone_arm(), **changes)
    line = one_line(capsys, 'fit', tmp_path / 'nowhere', '--arm', arm, '--out', tmp_path / 'm',
                    '--models', 'analytical', 'elastic')
    assert part in line and 'less.yaml' in line and 'leave elastic out of --models' in line
    assert not (tmp_path / 'm').exists()


def test_a_bag_without_strain(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """There is nothing to identify it from; the bag is named."""
    bag = saved(tmp_path / 'bare', replace(RECORD, strain=None))
    line = one_line(capsys, 'fit', bag, '--arm', place / 'arm.yaml', '--out', tmp_path / 'm',
                    '--models', 'analytical', 'elastic')
    assert f'{bag}: no strain, which the elastic model needs; record' in line
    assert not (tmp_path / 'm').exists()
