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

"""What subcommands print: JSON that every reader takes, tables that are whole, no stray bars."""

from __future__ import annotations

import io
import json

import pytest
from rich.console import Console

from tudor_dynamics.cli.console import print_json, print_table, score_table, steps
from tudor_dynamics.identification.validation import ChannelScore, Score

SCORE = Score(1580, 12.5, 11.25, 93.456, 93.2, 0.0654,
              {'hub': ChannelScore(15.0, 92.345, 0.07), 'mid': ChannelScore(9.0, 95.0, 0.05)})


def test_json(capsys: pytest.CaptureFixture[str]) -> None:
    """Numbers that JSON does not know become null; anything else stays."""
    content = {'fit': float('-inf'), 'list': [1, float('nan'), (2.5, float('inf'))], 'name': 'a'}
    print_json(content)
    assert json.loads(capsys.readouterr().out) == {
        'fit': None, 'list': [1, None, [2.5, None]], 'name': 'a'}


@pytest.mark.parametrize(('units', 'shown'), [
    ({'hub': 'um/m', 'mid': 'um/m'}, 'um/m'), ({'hub': 'um/m', 'mid': 'V'}, 'mixed')])
def test_table(
    units: dict[str, str], shown: str, capsys: pytest.CaptureFixture[str],
) -> None:
    """Each figure stands in the row of its channel, whole, also where no terminal is."""
    print_table(score_table('run 4', [('strain', 'analytical', SCORE, units)]))
    text = capsys.readouterr().out
    total = next(line for line in text.splitlines() if 'strain, analytical' in line)
    for figure in ('12.5', shown, '11.25', '93.46', '93.20', '6.54'):
        assert figure in total
    hub = next(line for line in text.splitlines() if ' hub ' in line)
    assert '92.3' in hub and '7.00' in hub and '15' in hub
    assert '…' not in text


LONG = 'left_arm_shoulder_pan_joint_of_the_first_robot'
LARGE = Score(1580, -1.2345e-05, 1.1111e+07, -123.456, -993.2, -8.0, {
    LONG: ChannelScore(1.234e-09, -992.345, 7.0), 'mid': ChannelScore(9.0, 95.0, 0.05)})

UNITS = {LONG: 'um/m', 'mid': 'V'}


def test_figures_are_whole_on_a_narrow_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    """Long names go on in the next line; every digit of large and small figures is there."""
    monkeypatch.setenv('COLUMNS', '80')
    print_table(score_table('run 4', [('strain', 'analytical', LARGE, UNITS)]))
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= 80 and '…' not in text
    first = ''.join(line[:20].strip() for line in text.splitlines())
    assert LONG in first
    for figure in ('-1.234e-05', '1.111e+07', '-123.46', '-993.20', '-800.00', '1.234e-09',
                   '-992.35', '700.00'):
        assert figure in text


def test_figures_come_before_the_width(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    """Where even the figures are too wide, lines are longer than the terminal."""
    monkeypatch.setenv('COLUMNS', '30')
    print_table(score_table('run 4', [('strain', 'analytical', LARGE, UNITS)]))
    text = capsys.readouterr().out
    assert '-1.234e-05' in text and '…' not in text and max(map(len, text.splitlines())) > 60


def test_steps(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps show on a terminal, and nothing anywhere else."""
    with steps(2) as step:
        step('read run4')
    assert capsys.readouterr() == ('', '')
    screen = io.StringIO()
    monkeypatch.setattr('tudor_dynamics.cli.console.Console',
                        lambda **_: Console(file=screen, force_terminal=True, width=100))
    with steps(2) as step:
        step('read run4')
        step('compare')
    assert 'compare' in screen.getvalue()
