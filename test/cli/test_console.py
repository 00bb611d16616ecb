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

from dataclasses import replace
import fcntl
import io
import json
import os
from pathlib import Path
import pty
import re
import shlex
import struct
import subprocess
import sys
import termios
import time

from hypothesis import given, HealthCheck, settings, strategies as st
import pytest
from rich.console import Console

from tudor_dynamics.cli import console
from tudor_dynamics.cli.console import (
    print_json, print_table, print_verdicts, say, say_command, score_table, steps)
from tudor_dynamics.cli.main import main
from tudor_dynamics.identification.uses import Use
from tudor_dynamics.identification.validation import ChannelScore, Grade, Score

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
    for figure in ('12.5', shown, '11.25', '93.46', '6.54'):
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
    first = ''.join(line[:29].strip() for line in text.splitlines())
    assert LONG in first
    for figure in ('-1.234e-05', '1.111e+07', '-123.46', '-800.00', '1.234e-09',
                   '-992.35', '700.00'):
        assert figure in text


def test_a_fit_is_not_rounded_up_over_a_bound(capsys: pytest.CaptureFixture[str]) -> None:
    """What is no good model does not look like one."""
    units = dict.fromkeys(SCORE.channels, 'V')
    print_table(score_table('run 4', [('strain', 'elm', replace(SCORE, fit=84.998), units)]))
    assert '84.99' in capsys.readouterr().out


def test_figures_come_before_the_width(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    """Where even the figures are too wide, lines are longer than the terminal."""
    monkeypatch.setenv('COLUMNS', '30')
    print_table(score_table('run 4', [('strain', 'analytical', LARGE, UNITS)]))
    text = capsys.readouterr().out
    assert '-1.234e-05' in text and '…' not in text and max(map(len, text.splitlines())) > 60


WORDS = st.lists(st.text('ab /*-."\'$', min_size=1, max_size=30), min_size=1, max_size=12)
EACH = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)


@EACH
@given(WORDS)
def test_commands_can_be_copied(capsys: pytest.CaptureFixture[str], words: list[str]) -> None:
    """A shell takes a command that goes on in the next line as it was given."""
    capsys.readouterr()
    say_command(shlex.join(words))
    assert shlex.split(capsys.readouterr().out.replace('\\\n', '')) == words


@EACH
@given(WORDS)
def test_texts_are_wrapped(capsys: pytest.CaptureFixture[str], words: list[str]) -> None:
    """No word is broken, and none is lost."""
    capsys.readouterr()
    text = '  ' + ' '.join(words)
    say(text)
    said = capsys.readouterr().out
    assert said.split() == text.split()
    assert all(len(line) <= 80 for line in said.splitlines())


def test_verdicts_come_by_grade(capsys: pytest.CaptureFixture[str]) -> None:
    """A use is named once where all models agree, otherwise with its output."""
    detect = 'collision detection'
    print_verdicts('arm', [
        Use('effort', 'analytical', 'prediction', Grade.GOOD, ''),
        Use('effort', 'analytical', f'{detect} (effort)', Grade.GOOD, ''),
        Use('strain', 'elm', f'{detect} (strain)', Grade.DO_NOT_USE, ''),
        Use('strain', 'elm', 'payload', None, '')])
    assert capsys.readouterr().out.splitlines() == [
        f'arm: good: prediction, {detect} (effort) by analytical effort',
        f'arm: do not use: {detect} (strain) by elm strain', 'arm: not known: payload']


def test_steps(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps show on a terminal; elsewhere a line names that which takes seconds, now and then."""
    with steps(2) as step:
        step('read run4')
        step('compare')
    assert capsys.readouterr() == ('', '')
    monkeypatch.setattr(console, 'SILENCE', 0.05)

    def heard(lines: int) -> set[str]:
        """Wait until so many lines came, however busy the machine is; without their seconds."""
        text = ''
        while text.count('\n') < lines:
            time.sleep(0.01)
            printed = capsys.readouterr()
            assert printed.out == ''
            text += printed.err
        return {line.partition(' s: ')[2] for line in text.splitlines()}
    with steps(2) as step:
        time.sleep(0.5)  # nothing has begun: nothing is said
        step('compare')
        assert heard(1) == {'compare: 0 %'}
    monkeypatch.setattr(console, 'PAUSE', 0.05)
    with steps(None) as step:
        step('search')
        assert heard(3) == {'search'}
    screen = io.StringIO()
    monkeypatch.setattr('tudor_dynamics.cli.console.Console',
                        lambda **_: Console(file=screen, force_terminal=True, width=100))
    with steps(2) as step:
        step('read run4')
        step('compare')
    assert 'compare' in screen.getvalue()


@pytest.mark.parametrize(('words', 'heard'), [
    ('record --arm config/tudor.yaml --stimuli 1 --seconds 3 --out OUT', 'simulate: '),
    ('excite config/tudor.yaml --seconds 10 --steps 20 --floor 0 --out OUT', 'search, '),
    ('tune config/tudor.yaml --payloads 0 --out OUT.yaml', 'tuning: '),
    ('simulate config/tudor.yaml --seconds 1 --torque joint2=0 --out OUT', 'simulating: '),
    ('payload bags/two_blade_test --model MODEL', ''),
    ('export MODEL --to csv --out OUT.csv', '')])
def test_long_commands_are_heard_without_a_terminal(
    words: str, heard: str, root: Path, model: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    """Where seconds pass, a line says what is done, and how far it is; all within 80 columns."""
    for name, place in (('config', root / 'config'), ('bags', root / 'bags'), ('MODEL', model)):
        (tmp_path / name).symlink_to(place)
    monkeypatch.setattr(console, 'SILENCE', 0.02)
    monkeypatch.setattr(console, 'PAUSE', 0.02)
    monkeypatch.setenv('COLUMNS', '80')
    monkeypatch.chdir(tmp_path)
    code = main(words.split())
    said = capsys.readouterr()
    assert code in (0, 1) and max(map(len, said.out.splitlines())) <= 80
    assert not heard or re.search(rf'^\d+ s: {heard}.*\d+ %$', said.err, re.MULTILINE), said


PLACE = '/no/such/folder/with/a/long/name/and/more/of/it/recording_1.25e+300'


@pytest.mark.parametrize(('words', 'text'), [
    (['info', PLACE], f'tudor info: {PLACE}: '),
    (['fit', '--frobnicate=1'], 'there is no option --frob'),
    (['evaluate', 'run', '--model', PLACE], f'tudor evaluate: {PLACE}: no such folder; '),
    (['simulate', PLACE, '--plot', '--out', 'x'], '--plot is now --pictures')])
def test_errors_on_a_terminal(words: list[str], text: str) -> None:
    """Wrapped at its width, no word, path or number in two; elsewhere they are lines."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack('4H', 30, 50, 0, 0))
    command = [sys.executable, '-m', 'tudor_dynamics', *words]
    env = {key: value for key, value in os.environ.items() if key != 'COLUMNS'}
    plain = subprocess.run(command, capture_output=True, text=True, env=env,
                           stdin=subprocess.DEVNULL)
    shown = subprocess.run(command, stdout=subprocess.PIPE, stderr=theirs, env=env,
                           stdin=subprocess.DEVNULL)
    os.close(theirs)
    said = os.read(ours, 10_000).decode().replace('\r', '')
    os.close(ours)
    assert shown.returncode == plain.returncode == 2
    assert said.split() == plain.stderr.split() and text in plain.stderr
    assert plain.stderr.count('\n') == 1 + text.startswith('--plot') < said.count('\n')
    assert all(len(line) <= 50 or len(line.split()) == 1 for line in said.splitlines())
