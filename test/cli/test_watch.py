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

"""``tudor watch`` as a user calls it, and its refusals."""

from __future__ import annotations

from html import unescape
import json
import os
from pathlib import Path
import re
import shlex
import sys
from typing import Any

import pytest
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.cli import watch
from tudor_dynamics.cli.main import main
from tudor_dynamics.identification.causes import explain
from tudor_dynamics.models.bundle import load_bundle
from tudor_dynamics.online.detector import time_of_day
from tudor_dynamics.online.monitor import MonitorSettings
from tudor_dynamics.show.live import LiveView


def test_a_bag(
    root: Path, model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """Events are those that `tudor why` explains: as lines, as JSON, and in the picture."""
    bag = root / 'bags/two_blade_pushes'
    found = explain(open_bag(bag), load_bundle(model), MonitorSettings(methods=()), 'parameter',
                    0.0, [])
    assert len(found) >= 2
    onsets = [cause.event.event.onset for cause in found]
    command = ['watch', str(bag), '--model', str(model)]
    assert main([*command, '--picture', str(tmp_path / 'view.svg')]) == 0
    *lines, last = capsys.readouterr().out.splitlines()
    assert [line[:27] for line in lines] == [time_of_day(onset) for onset in onsets]
    assert last == f'{len(found)} events'
    picture = (tmp_path / 'view.svg').read_text()
    lines = drawn_lines(picture)
    assert max(map(len, lines)) <= 80 and 'no load assumed' in lines
    assert lines[1].startswith('free') and re.fullmatch(r'free +9\d % judged', lines[1])
    rows = [line.split() for line in lines if line.startswith('  ') and line.endswith(' ok')]
    assert [(row[0], row[3]) for row in rows] == [
        ('link2_hub', 'um/m'), ('link3_hub', 'um/m'), *[('joint2', 'A'), ('joint3', 'A')] * 2]
    assert all(abs(float(row[1])) < float(row[2]) for row in rows)
    why = next(line for line in lines if line.startswith('  tudor why '))
    assert lines[lines.index(why) - 1].startswith(time_of_day(onsets[-1]))
    assert picture.startswith('<svg') and 'threshold' in picture and time_of_day(
        onsets[-1])[11:23] in picture
    assert 'url(' not in picture.replace('url(#', ''), 'it loads something from elsewhere'
    assert main([*command, '--false-alarms', '1e-4']) == 0
    assert capsys.readouterr().out.splitlines()[1:] == ['1 event']
    assert main([*command, '--json']) == 0
    assert [item['onset'] for item in json.loads(capsys.readouterr().out)['events']] == onsets


def drawn_lines(picture: str) -> list[str]:
    """Give the lines of a picture of a terminal, from the third on: those of the view."""
    texts = re.findall(r'<text [^>]*x="([\d.]+)" y="([\d.]+)" [^>]*>(.*?)</text>', picture)
    rows: dict[float, str] = {}
    for x, y, text in sorted(texts, key=lambda item: (float(item[1]), float(item[0]))):
        rows[float(y)] = rows.get(float(y), '').ljust(round(float(x) / 12.2)) + unescape(text)
    return [line.replace('\xa0', ' ').rstrip() for line in rows.values()
            if not line.startswith(' ' * 20 + 'tudor watch')]


def test_each_event_has_its_command(
    root: Path, model: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    """It runs as it stands, and explains that event, at the rate of false alarms asked for."""
    commands: list[str] = []
    taken = LiveView.event

    def event(*given: Any) -> str:
        commands.append(given[-1])
        return taken(*given)
    monkeypatch.setattr(LiveView, 'event', event)
    assert main(['watch', str(root / 'bags/two_blade_pushes'), '--model', str(model),
                 '--false-alarms', '1000']) == 0
    *lines, _ = capsys.readouterr().out.splitlines()
    assert len(commands) == len(lines) > 3
    for line, command in zip(lines[:1] + lines[-1:], commands[:1] + commands[-1:], strict=True):
        words = shlex.split(command)
        assert words[:2] == ['tudor', 'why'] and '--payload' not in words
        assert main([*words[1:], '--json']) in (0, 1)
        (cause,) = json.loads(capsys.readouterr().out)
        assert line.startswith(cause['time_of_day'])


def test_a_gauge_that_stands_still(root: Path, model: Path, tmp_path: Path) -> None:
    """The view names it, as the diagnostics of the node do."""
    arm = load_arm(root / 'config/two_blade_arm.yaml')
    whole = read_recording(root / 'bags/two_blade_test', arm)
    whole.strain[-300:, 1] = whole.strain[-300, 1]
    write_bag(tmp_path / 'bag', whole, arm=arm)
    assert main(['watch', str(tmp_path / 'bag'), '--model', str(model), '--picture',
                 str(tmp_path / 'view.svg')]) == 0
    picture = (tmp_path / 'view.svg').read_text().replace('&#160;', ' ')
    assert f'the reading of {arm.gauge_names[1]} has not changed' in picture
    assert f'the reading of {arm.gauge_names[0]}' not in picture
    states = [line.split()[-1] for line in drawn_lines((tmp_path / 'view.svg').read_text())
              if line.startswith('  ') and '\u2502' in line]
    assert states == ['ok', 'stuck', *['ok'] * 4]


@pytest.mark.parametrize('options, said', [
    (['run'], 'give --model'),
    (['run', '--model', 'm', '--speed', '-1'], '--speed -1'),
    (['run', '--model', 'm', '--speed', 'nan'], '--speed nan'),
    (['run', '--model', 'm', '--false-alarms', '0'], 'more than 0'),
    (['--picture', 'v.svg'], 'need a BAG; give a BAG, or omit them'), (['--json'], 'need a BAG'),
    (['--web', '0'], 'port of 1 to 65535')])
def test_refusals(options: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    """One line each."""
    assert main(['watch', *options]) == 2
    assert said in capsys.readouterr().err


def test_topics(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Without a bag the command becomes the node, in the namespace of the monitor."""
    called: list[list[str]] = []

    def become(path: str, words: list[str]) -> None:
        called.append(words)
        raise SystemExit(0)
    monkeypatch.setattr(os, 'execv', become)
    with pytest.raises(SystemExit):
        main(['watch', '--namespace', 'left', '--web', '8081'])
    words = called[0]
    assert words[:4] == [sys.executable, '-m', 'tudor_dynamics.nodes', 'watch']
    assert '__ns:=/left' in words and 'web:=8081' in words
    monkeypatch.setattr(watch, 'find_spec', lambda name: None)
    assert main(['watch']) == 2
    assert 'source its setup.bash' in capsys.readouterr().err
