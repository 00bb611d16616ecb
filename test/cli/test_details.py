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

"""What ``-v`` adds in the commands that have more to say, and what pages say of their making."""

from __future__ import annotations

from html import unescape
import importlib
from pathlib import Path
import re

import pytest
import tudor_dynamics as td
from tudor_dynamics.cli.main import main, SUBCOMMANDS
from tudor_dynamics.files import provenance

BAGS = 'bags/two_blade_'
LOUD = {'doctor', 'evaluate', 'fit', 'info', 'why'}
pytestmark = pytest.mark.usefixtures('replayed_once')


@pytest.mark.parametrize(('words', 'more'), [
    (f'info {BAGS}test --arm config/two_blade_arm.yaml',
     ['2400 aligned samples; messages left out: none', 'two_blade_test.mcap: SHA-256']),
    (f'evaluate {BAGS}test --model MODEL', [
        f'{BAGS}test: ', 'effort analytical, joint2: the RMS error',
        'strain analytical, link3_hub: the RMS error']),
    (f'evaluate {BAGS}pushes --model MODEL --collisions', [
        'strain in ', 'times its threshold; pushes are known from ']),
    (f'why {BAGS}pushes --model MODEL', ['when it became certain, in thresholds: link2_hub '])])
def test_more_is_said(
    words: str, more: list[str], root: Path, model: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """All that stands there without the option, and more, within the width."""
    monkeypatch.chdir(root)
    command = words.replace('MODEL', str(model)).split()
    code = main(command)
    plain = capsys.readouterr().out
    assert main([*command, '-v']) == code
    said = capsys.readouterr().out
    added = ' '.join(said.split())
    assert all(text in added for text in more)
    assert not [text for text in more if text in ' '.join(plain.split())]
    rest = iter(said.splitlines())
    assert all(line in rest for line in plain.splitlines())
    assert max(map(len, said.splitlines())) <= max(80, len(str(model)) + 60)


GREEN, YELLOW, RED, DIM = '\x1b[32m', '\x1b[33m', '\x1b[31m', '\x1b[2m'


@pytest.mark.parametrize(('words', 'colour', 'line'), [
    (f'evaluate {BAGS}test --model MODEL', GREEN, 0),
    (f'evaluate {BAGS}pushes --model MODEL', RED, 0),
    (f'evaluate {BAGS}pushes --model MODEL --collisions', YELLOW, 0),
    (f'evaluate {BAGS}pushes --model MODEL --collisions --free', RED, 0),
    (f'why {BAGS}pushes --model MODEL', GREEN, 0),
    (f'why {BAGS}pushes --model MODEL --at 33:33', YELLOW, 0),
    (f'payload {BAGS}test --model MODEL', GREEN, 0),
    ('compare MODEL MODEL', DIM, 0), (f'compare MODEL MODEL {BAGS}test', GREEN, 0),
    ('doctor', '\x1b[3', 0), (f'info {BAGS}test', GREEN, 2)])
def test_verdicts_come_first_in_colour(
    words: str, colour: str, line: int, root: Path, model: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """In the colour of its grade on a terminal, unless NO_COLOR is set."""
    monkeypatch.chdir(root)
    monkeypatch.setenv('FORCE_COLOR', '1')
    monkeypatch.setenv('TERM', 'xterm-256color')
    monkeypatch.delenv('NO_COLOR', raising=False)
    main(words.replace('MODEL', str(model)).split())
    assert colour in capsys.readouterr().out.splitlines()[line]
    monkeypatch.setenv('NO_COLOR', '1')
    main(words.replace('MODEL', str(model)).split())
    assert not re.search('\x1b\\[3[123]m', capsys.readouterr().out)


@pytest.mark.parametrize('words', [
    f'evaluate {BAGS}test --model MODEL', f'evaluate {BAGS}pushes --model MODEL --collisions'])
def test_a_page_says_what_made_it(
    words: str, root: Path, model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Version, date, commit and libraries, the call, and the model with its digest."""
    monkeypatch.chdir(root)
    monkeypatch.setenv('SOURCE_DATE_EPOCH', '1700000000')
    call = [*words.replace('MODEL', str(model)).split(), '--report', str(tmp_path / 'r.html')]
    assert main(call) == 0
    said = unescape((tmp_path / 'r.html').read_text().partition('<h2>Provenance</h2>')[2])
    rows = dict(re.findall(r'row">(\w+)</th><td><code>(.*?)</code>', said))
    made = provenance()
    assert {what.lower(): text for what, text in rows.items()} == {
        **made, 'command': f'tudor {" ".join(call)}',
        'model': f'{model}, digest {td.load_bundle(model).digest}'}
    assert made['date'] == '2023-11-14 22:13 UTC' in said.partition('<footer>')[2]


def test_only_where_there_is_more(capsys: pytest.CaptureFixture[str]) -> None:
    """Other commands do not take the word, and nobody is loud and quiet at once."""
    assert LOUD == {name for name in SUBCOMMANDS if hasattr(
        importlib.import_module(f'tudor_dynamics.cli.{name}'), 'DETAILS')}
    for name in SUBCOMMANDS:
        with pytest.raises(SystemExit):
            main([name, '-v', '-q'])
        said = capsys.readouterr().err
        assert ('not allowed with argument' in said) == (name in LOUD)
