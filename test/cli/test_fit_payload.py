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

from __future__ import annotations

from dataclasses import replace
import json
from pathlib import Path
import re

import numpy as np
from payload_making import true_outputs, two_gauge_arm
import pytest
from sample_arms import LENGTH_2, multisine, recording_of
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.writer import recording_series, write_bag
from tudor_dynamics.cli.main import main
import yaml


def bag(path: Path, payload: float, seed: int, *, stated: str | None = None) -> str:
    """Write a bag of an arm with a payload, which its metadata may state."""
    motion = multisine(np.arange(2000) * 0.01, 2, seed)
    outputs = true_outputs(two_gauge_arm(), motion, payload)
    recording = replace(recording_of(motion[:, :2], 100.0), **outputs)
    write_bag(path, recording_series(recording, two_gauge_arm()),
              custom=None if stated is None else {'payload': stated})
    return str(path)


@pytest.fixture
def arm(tmp_path: Path) -> str:
    """Describe the arm in a file."""
    path = tmp_path / 'arm.yaml'
    content = two_gauge_arm().spec.model_dump(mode='json', exclude_defaults=True)
    path.write_text(yaml.safe_dump(content))
    return str(path)


def test_bags_that_say_what_they_carry(arm: str, tmp_path: Path, capsys) -> None:
    """Two payloads in training, a third one to judge by; evaluated with what the bag says."""
    train = [bag(tmp_path / f'train{i}', mass, i, stated=str(mass))
             for i, mass in enumerate((0.0, 0.4, 0.0, 0.4))]
    test = bag(tmp_path / 'test', 0.25, 9, stated='0.25')
    model = str(tmp_path / 'model')
    assert main(['fit', *train, '--test', test, '--arm', arm, '--out', model, '--models',
                 'analytical', '--json', '--filter', 'zero_phase']) == 0
    said = json.loads(capsys.readouterr().out)
    # what is missing is the filter's: exact motion and moments went in
    assert said['strain']['analytical']['validation']['fit'] > 98.0
    assert main(['evaluate', '--model', model, test, '--json']) == 0
    right = json.loads(capsys.readouterr().out)
    # the bag is not as the model knows it with that payload
    assert main(['evaluate', '--model', model, test, '--payload', '0.1', '--json']) == 1
    wrong = json.loads(capsys.readouterr().out)
    assert wrong['as_it_was'] is False and right['as_it_was'] is True
    assert right['strain']['analytical']['fit'] > 98.0
    assert wrong['strain']['analytical']['fit'] < 90.0
    assert '0.25' in (tmp_path / 'model' / 'model.yaml').read_text()


def test_payload_of(arm: str, tmp_path: Path, capsys) -> None:
    """The command line says what the bags do not; one bag left unsaid is asked for."""
    empty, full = bag(tmp_path / 'a', 0.0, 1), bag(tmp_path / 'b', 0.4, 2)
    more = ['--arm', arm, '--models', 'analytical', '--exit-zero']
    assert main(['fit', empty, full, *more, '--out', str(tmp_path / 'm1'), '--payload-of',
                 f'{full}=0.4']) == 0  # one is known only: nothing to tell apart
    assert 'of all loads' not in capsys.readouterr().out
    third = bag(tmp_path / 'c', 0.2, 3)
    assert main(['fit', empty, full, third, *more, '--out', str(tmp_path / 'm2'), '--payload-of',
                 f'{empty}=0', f'{full}=0.4']) == 2
    assert f'but that of bag {third!r} is not known' in capsys.readouterr().err
    assert main(['fit', empty, full, '--test', third, *more, '--out', str(tmp_path / 'm3'),
                 '--payload-of', f'{empty}=0', f'{full}=0.4', f'{third}=0.2']) == 0
    assert 'one model of all loads from 0 to 0.4 kg' in capsys.readouterr().out
    assert main(['evaluate', '--model', str(tmp_path / 'm3'), third]) == 2
    assert "c' is not known, but the model needs it" in capsys.readouterr().err


@pytest.mark.parametrize(('text', 'said'), [
    ('none=0.2', "--payload-of none=0.2: 'none' is not among the bags"),
    ('bag', 'expected BAG=KG'),
    ('bag=-1', 'expected BAG=KG')])
def test_wrong_payloads(arm: str, tmp_path: Path, capsys, text: str, said: str) -> None:
    """A bag that is not there and what is no mass are refused in one line."""
    assert main(['fit', 'bag', '--arm', arm, '--out', str(tmp_path / 'm'), '--payload-of',
                 text]) == 2
    err = capsys.readouterr().err
    assert said in err and err.count('\n') == 1


def test_metadata_that_make_no_sense(arm: str, tmp_path: Path) -> None:
    """A payload that is no mass is told of and ignored."""
    path = bag(tmp_path / 'odd', 0.0, 1, stated='heavy')
    recording = read_recording(path, load_arm(arm))
    assert recording.payload is None
    assert any('not a mass in kg' in text for text in recording.warnings)


def test_a_load_that_the_model_does_not_know(arm: str, tmp_path: Path, capsys) -> None:
    """It is measured: in figures, a sentence, on the page; without one nothing is said."""
    model, page = str(tmp_path / 'model'), tmp_path / 'page.html'
    assert main(['fit', bag(tmp_path / 'empty', 0.0, 1), bag(tmp_path / 'other', 0.0, 2), '--arm',
                 arm, '--out', model, '--models', 'analytical', '--friction', 'viscous', 'coulomb',
                 '--filter', 'zero_phase']) == 0
    full, empty = bag(tmp_path / 'full', 0.25, 9), bag(tmp_path / 'free', 0.0, 9)
    capsys.readouterr()
    assert main(['evaluate', '--model', model, full, '--report', str(page), '--json']) == 1
    told = json.loads(capsys.readouterr().out)['loads'][full]
    assert told['mass'] == pytest.approx(0.25, abs=0.01) and told['scale'] == 'torque'
    assert told['com'][0] == pytest.approx(LENGTH_2, abs=0.02)
    channels = told['outputs']['effort']['channels']
    assert set(channels) == {'j1', 'j2'}
    for one in channels.values():
        assert one['after'] < 0.2 * one['before'] and one['share'] > 0.95
    text = page.read_text(encoding='utf-8')
    assert 'id="load"' in text and 'Centre x' in text
    # both joints and both gauges over time, their errors, and the load
    assert 'Effort over time' in text and text.count('type="application/json"') == 7
    assert 'The arm carries a load that the model lacks' in text
    assert main(['evaluate', '--model', model, full]) == 1
    printed = ' '.join(capsys.readouterr().out.replace('\\', '').split())
    assert re.search(rf'load in {full}: .*0\.2[45]', printed)
    assert f'tudor payload {full} --model {model}' in printed
    assert main(['evaluate', '--model', model, empty, '--report', str(page), '--json']) == 0
    assert json.loads(capsys.readouterr().out)['loads'] == {}
    text = page.read_text(encoding='utf-8')
    assert 'id="load"' not in text and text.count('type="application/json"') == 6
    assert main(['evaluate', '--model', model, empty, '--report', str(tmp_path)]) == 2
    assert '--report' in capsys.readouterr().err
