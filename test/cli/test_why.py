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

"""``tudor why``: bags of events, other bags, and what it refuses."""

from __future__ import annotations

from dataclasses import replace
import json
from pathlib import Path

import numpy as np
import pytest

from tudor_dynamics.bags.storage import open_bag, RawMessages
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.cli.main import main
from tudor_dynamics.online.black_box import EVENTS

TOPICS = ('/joint_states', '/motor_currents', '/link_strains')


@pytest.fixture(scope='module')
def model(tmp_path_factory: pytest.TempPathFactory, root: Path) -> str:
    """Fit a model to the sample bags."""
    out = tmp_path_factory.mktemp('why') / 'model'
    assert main(['fit', *(str(root / f'bags/two_blade_train_{k}') for k in (1, 2)), '--arm',
                 str(root / 'config/two_blade_arm.yaml'), '--filter', 'causal', '--estimator',
                 'wls', '--friction', 'viscous', 'coulomb', '--currents', 'separate', '--out',
                 str(out), '--force']) == 0
    return str(out)


def events(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[dict]:
    """Give the events of a run."""
    capsys.readouterr()
    assert main(['why', *arguments, '--json']) in (0, 1)
    return list(json.loads(capsys.readouterr().out)['events'])


def some(root: Path, kept: slice, gaps: int = 0) -> list[RawMessages]:
    """Take a part of the messages of the pushes; with a gap of 0.12 s after so many samples."""
    found = []
    for raw in open_bag(root / 'bags/two_blade_pushes').read(TOPICS).values():
        rows = np.arange(len(raw.data))[kept]
        rows = rows[rows % gaps >= 12] if gaps else rows
        found.append(replace(raw, log_time=raw.log_time[rows],
                             data=[raw.data[row] for row in rows.tolist()]))
    return found


def test_pushes(model: str, root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each event of a bag has a time of day, a cause, evidence, and something to do."""
    bag = str(root / 'bags/two_blade_pushes')
    found = events(capsys, bag, '--model', model)
    assert len(found) >= 3 and {item['cause'] for item in found} == {'touch'}
    assert main(['why', bag, '--model', model, '--at', found[1]['time'][11:19]]) == 0
    out = capsys.readouterr().out
    assert found[1]['evidence'] in out and found[0]['time'] not in out
    assert all(len(line) <= 100 for line in out.splitlines())


def test_gaps(model: str, root: Path, tmp_path: Path,
              capsys: pytest.CaptureFixture[str]) -> None:
    """A bag in which nothing lasts a second without a gap is no reason to refuse it."""
    bag = tmp_path / 'gaps'
    write_bag(bag, some(root, slice(1200, 1800), gaps=95))
    first = int(open_bag(bag).read(TOPICS)['/joint_states'].log_time[0])
    record = {'onset': first + 3_100_000_000, 'stamp': first + 3_110_000_000, 'method': 'strain',
              'link': 'link3', 'residual': {'link3_hub': 166.0}, 'ratio': {'link3_hub': 1.5},
              'settings': {'model': model, 'payload': 0.0}}
    write_bag(tmp_path / 'event', some(root, slice(1200, 1800), gaps=95),
              custom={EVENTS: json.dumps([record])})
    (found,) = events(capsys, str(tmp_path / 'event'))
    assert found['cause'] and 'not the same' in found['replay']


@pytest.mark.parametrize(('custom', 'arguments', 'words'), [
    ({}, [], '--model'), ({EVENTS: '[{"onset": 1}]'}, [], 'no record'),
    ({EVENTS: '{'}, [], 'no record'), ({}, ['--model', 'MODEL', '--at', 'noon'], '14:03:12')])
def test_refused(
    model: str, root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    custom: dict[str, str], arguments: list[str], words: str,
) -> None:
    """Bags without a record, with a broken one, and times that are none."""
    write_bag(tmp_path / 'bag', some(root, slice(0, 300)), custom=custom)
    assert main(['why', str(tmp_path / 'bag'),
                 *(model if word == 'MODEL' else word for word in arguments)]) == 2
    assert words in capsys.readouterr().err


def test_nothing(model: str, root: Path, tmp_path: Path) -> None:
    """A bag without an event is said to have none."""
    write_bag(tmp_path / 'bag', some(root, slice(0, 300)))
    assert main(['why', str(tmp_path / 'bag'), '--model', model]) == 1
