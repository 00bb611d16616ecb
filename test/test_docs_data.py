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


"""Figures of the documents as data, and pages of the reference that are written from the code."""

from __future__ import annotations

from dataclasses import replace
import importlib
from pathlib import Path
import re
import subprocess
import sys
from types import ModuleType

import pytest

import tudor_dynamics
from tudor_dynamics.cli.main import SUBCOMMANDS
from tudor_dynamics.nodes.common.interfaces import NODES

ROOT = Path(__file__).resolve().parents[1]
DATA = sorted((ROOT / 'docs' / 'figures').glob('*.json'))


def load(name: str, folder: str) -> ModuleType:
    """Load a module of the documents; skip the test where Sphinx is absent."""
    pytest.importorskip('sphinx')
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / folder))
        patch.delitem(sys.modules, name, raising=False)
        return importlib.import_module(name)


def test_each_table_is_whole_and_on_a_page() -> None:
    """Every file has rows of one width, code that exists, and a page; every page has its file."""
    read = load('figure_data', 'docs/_extensions').read
    pages = '\n'.join(page.read_text(encoding='utf-8') for page in (ROOT / 'docs').rglob('*.md'))
    assert sorted(re.findall(r'^```\{figures\} (\w+)', pages, re.MULTILINE)) == [
        file.stem for file in DATA]
    for file in DATA:
        figures = read(file.stem)
        assert figures.rows and {len(row) for row in figures.rows} == {len(figures.head)}, file
        assert all((ROOT / path).exists() for path in figures.paths), file
        scripts = re.findall(r'python (bench/\S+\.py)', figures.command)
        assert all((ROOT / script).exists() for script in scripts), file
        assert file.read_text(encoding='utf-8') == figures.text(), file


def test_a_change_of_the_code_makes_figures_old(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Commits that change what code computes count, others do not; some have no age."""
    module = load('figure_data', 'docs/_extensions')
    monkeypatch.setattr(module, 'ROOT', tmp_path)

    def git(*words: str) -> str:
        return subprocess.run(['git', '-c', 'user.name=x', '-c', 'user.email=x@x', *words],
                              cwd=tmp_path, check=True, capture_output=True, text=True).stdout

    def commit(name: str, text: str) -> str:
        (tmp_path / name).write_text(text)
        git('add', '-A')
        git('commit', '-q', '-m', text)
        return git('rev-parse', '--short', 'HEAD').strip()

    git('init', '-q')
    figures = module.Figures('python x', commit('code', 'one'), '', ['code'], ['a'], [['1']])
    commit('page', 'two')
    assert figures.changes() == 0
    commit('code', 'three')
    assert figures.changes() == 1
    assert module.Figures('python x', '0' * 7, '', ['code'], ['a'], [['1']]).changes() is None
    module.blob.cache_clear()
    text = 'from x import y\n\n\ndef f(a: int) -> int:\n    """Give."""\n    return a + 1\n'
    figures = replace(figures, commit=commit('code.py', text), paths=['code.py'])
    commit('code.py', text.replace('Give', 'Make').replace('x import', 'z import'))
    assert figures.changes() == 0  # it computes the same
    commit('code.py', text.replace('+ 1', '+ 2'))
    assert figures.changes() == 2
    commit('code.py', text)
    assert figures.changes() == 0


def test_figures_are_read_from_what_a_bench_prints() -> None:
    """The table with the head, among others; nothing where it is absent."""
    rows_below = load('figures', 'tools').rows_below
    printed = 'x\n| a |\n|---|\n| 1 |\n\n| a | b |\n|---|---|\n| 2 | 3 |\n| 4 | 5 |\nend\n'
    assert rows_below(['a', 'b'], printed) == [['2', '3'], ['4', '5']]
    assert rows_below(['a', 'b'], printed + printed)[2:] == [['2', '3'], ['4', '5']]
    assert rows_below(['c'], printed) == []


def test_a_command_is_run_and_its_table_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Rows, commit and day are new; code that is not committed is refused, folders are put in."""
    data, tool = load('figure_data', 'docs/_extensions'), load('figures', 'tools')
    monkeypatch.setattr(tool, 'ROOT', tmp_path)
    monkeypatch.setenv('TUDOR_SHARED_DATA', '/data')
    for words in ('init -q', 'add -A', 'commit -q -m one'):
        (tmp_path / 'code').write_text('one')
        subprocess.run(['git', '-c', 'user.name=x', '-c', 'user.email=x@x', *words.split()],
                       cwd=tmp_path, check=True)
    (tmp_path / 'page.md').write_text('| b |\n|---|\n| 3 |\n')
    old = data.Figures("printf '| a |\\n|---|\\n| 2 |\\n'; mkdir --parents out && "
                       'cp page.md --target-directory out', 'x', '', ['code'], ['a'], [['1']])
    assert not old.measured
    new, other = tool.measure([old, replace(old, head=['b'])])
    assert other.rows == [['3']] and new.measured
    assert new.rows == [['2']] and len(new.commit) >= 7 and new.date > '2026'
    (tmp_path / 'code').write_text('two')
    with pytest.raises(SystemExit, match='first commit these'):
        tool.measure([old])
    assert tool.whole('python x --data DATA --work DIR', Path('/t')) == (
        'python x --data /data --work /t/work')
    assert tool.whole('python x --model model', Path('/t')).endswith(
        '--out /t/model --overwrite >&2 && python x --model /t/model')


def test_no_figures_are_written_by_hand() -> None:
    """All of them were measured by their commands."""
    read = load('figure_data', 'docs/_extensions').read
    assert not [file.stem for file in DATA if not read(file.stem).measured]


def test_the_answer_for_40_ms_is_measured() -> None:
    """What the how-to promises of a slow loop is what the bench found over all loads."""
    figures = load('figure_data', 'docs/_extensions').read('damping_at_delay')
    [row] = [row for row in figures.rows if row[0] == '40 ms']
    ratios = [float(number) for number in re.findall(r'0\.\d+', ' '.join(row[1:]))]
    page = ' '.join((ROOT / 'docs/howto/damp.md').read_text(encoding='utf-8').split())
    said = re.search(r'damping ratios of (\S+) to (\S+)\]\(\S+\) are left at 40 ms', page)
    assert said is not None and (float(said[1]), float(said[2])) == (min(ratios), max(ratios))


def test_each_key_of_a_file_is_explained() -> None:
    """The page of formats has a meaning for every key, and names what folders hold."""
    text = load('code_pages', 'docs/_extensions').formats()
    rows = [line for line in text.splitlines() if line.startswith('| `')]
    assert len(rows) > 50 and not [line for line in rows if '` |  | `' in line]
    assert all(f'`{name}`' in text for name in (
        'model.yaml', 'arm.yaml', 'elm.npz', 'data.npz', 'plan.json', 'trajectory.csv', 'run.npz',
        'campaign.yaml', 'tudor_events', 'payload', 'damping_ratio', 'bags'))


def test_all_that_is_public_has_its_page() -> None:
    """A page for each node; the page of the library has each of its names."""
    listed = dict(re.findall(r'\[`(\w+)`\]\((\S+\.md)\)', (
        ROOT / 'docs/reference/nodes.md').read_text(encoding='utf-8')))
    assert set(listed) - {'joint_test', 'damper_sign_test'} == set(NODES)
    assert all((ROOT / 'docs/reference' / page).exists() for page in listed.values())
    assert all(getattr(tudor_dynamics, name).__module__.startswith('tudor_dynamics.')
               for name in tudor_dynamics.__all__)


def test_every_command_and_error_has_its_place() -> None:
    """Each subcommand with its options; each error that the package raises on purpose."""
    module = load('code_pages', 'docs/_extensions')
    text = module.commands()
    assert re.findall(r'^## tudor (\S+)', text, re.MULTILINE) == list(SUBCOMMANDS)
    assert '`--collisions`' in text
    assert all(line.count(' | ') >= 1 for line in text.splitlines() if line.startswith('| '))
    assert '`BagError`' in module.error_page() and '`UsageError`' in module.error_page()


def test_each_message_is_on_its_page() -> None:
    """Errors, diagnostics and findings of all parts, with names in place of code."""
    module = load('code_pages', 'docs/_extensions')
    text = "{arm.source}: of {len(x)} {' or '.join(kinds)} {a if b|c} {3} %"
    assert module.in_capitals(text) == 'ARM: of NUMBER KINDS (a if b / c) 3 %'
    page = module.message_page()
    rows = [line for line in page.splitlines()
            if line.startswith('| ') and line != '| kind | text |']
    found = {(message.kind, module._plain(module.in_capitals(message.text)))
             for message in module.messages() if message.kind in module.KINDS}
    assert {tuple(row[2:-2].split(' | ', 1)) for row in rows} == found
    assert not [row for row in rows if re.search(r'[{}]', row.replace('{mass: 0}', ''))]
    assert re.findall(r'^## (.*)', page, re.MULTILINE) == list(module.ROOMS.values())
