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

"""
Every command that README and docs show is run, or at least understood.

Blocks of shell carry ``sh``. What follows, or a comment in the line above where the fence has to
stay plain, says why a block is not run here: ``long`` takes more than some seconds, ``own`` needs
bags of the reader, ``ros`` needs a running ROS or a workspace. Of those the ``tudor`` commands are
still parsed, so that no option in them is out of date.
"""

from __future__ import annotations

import os
from pathlib import Path
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time

from papers.__main__ import build_parser as papers_parser
import pytest

from tudor_dynamics.cli.main import build_parser, SUBCOMMANDS
from tudor_dynamics.nodes.common.interfaces import NODES

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([ROOT / 'README.md', ROOT / 'bags' / 'README.md', ROOT / 'examples' / 'README.md',
                *(page for page in (ROOT / 'docs').rglob('*.md')
                  if 'generated' not in page.parts)])
REASONS = ('long', 'own', 'ros')
FENCE = re.compile(r'^(?:<!-- (\w+) -->\n)?```([^\n]*)\n(.*?)^```$', re.MULTILINE | re.DOTALL)


def blocks() -> list[tuple[str, str, str]]:
    """Give page, info string and text of every fenced block."""
    return [(str(page.relative_to(ROOT)), f'{match[2]} {match[1] or ""}'.strip(), match[3])
            for page in PAGES for match in FENCE.finditer(page.read_text(encoding='utf-8'))]


def shell(*, run: bool) -> list[tuple[str, str]]:
    """Give the blocks of shell that are run here, or those that are not."""
    return [(page, text) for page, info, text in blocks()
            if info.split()[:1] == ['sh'] and (info == 'sh') == run]


def commands(text: str) -> list[list[str]]:
    """Split a block into commands and words."""
    lines = text.replace('\\\n', ' ').splitlines()
    return [words for words in (shlex.split(line, comments=True) for line in lines) if words]


def test_blocks_say_what_they_are() -> None:
    """No command stands in a block of another kind, and reasons are known ones."""
    for page, info, text in blocks():
        words = info.split()
        if words[:1] == ['sh']:
            assert len(words) == 1 or (len(words) == 2 and words[1] in REASONS), (page, info)
        else:
            assert not re.search(r'^\s*(tudor|ros2|make) ', text, re.MULTILINE), (page, text)
    for page in PAGES:  # nor in an indented block
        found = re.search(r'^ {4,}(tudor|ros2) .*', page.read_text(encoding='utf-8'), re.MULTILINE)
        outside = FENCE.sub('', page.read_text(encoding='utf-8'))
        assert not re.search(r'^ {4,}(tudor|ros2) ', outside, re.MULTILINE), (page, found)


@pytest.mark.parametrize('run', [True, False])
def test_options_are_known(run: bool, capsys: pytest.CaptureFixture[str]) -> None:
    """Every command of ``tudor`` and of the papers is one that its parser takes."""
    parsed = 0
    for page, text in shell(run=run):
        for words in commands(text):
            papers = words[:3] == ['python', '-m', 'papers']
            if words[0] != 'tudor' and not papers:
                continue
            assert papers or words[1] in SUBCOMMANDS, (page, words)
            try:
                if papers:
                    papers_parser().parse_args(words[3:])
                else:
                    build_parser(words[1]).parse_args(words[1:])
            except SystemExit:
                pytest.fail(f'{page}: {words}: {capsys.readouterr().err}')
            parsed += 1
    assert parsed > 3


def test_nodes_and_parameters_are_known() -> None:
    """Every node that a command starts is there, and so are the parameters that it sets."""
    seen = 0
    for page, text in shell(run=True) + shell(run=False):
        for words in commands(text):
            words = words[3:] if words[:3] == ['ros2', 'run', 'tudor_dynamics'] else words
            if words[0] not in NODES:
                continue
            known = {'use_sim_time', *(param.name for param in NODES[words[0]])}
            assert {word.partition(':=')[0] for flag, word in zip(words, words[1:], strict=False)
                    if flag == '-p'} <= known, (page, words)
            seen += 1
    assert seen > 5


def test_scripts_and_their_options_are_known() -> None:
    """Every script that a command runs is there, and speaks of each option that it is given."""
    seen = 0
    for page, text in shell(run=True) + shell(run=False):
        for words in commands(text):
            for at, word in enumerate(words):
                if not word.startswith(('bench/', 'tools/')) or words[at - 1] != 'python':
                    continue
                source = (ROOT / word).read_text(encoding='utf-8')
                unknown = [option for option in words[at + 1:]
                           if option.startswith('--') and f"'{option}'" not in source]
                assert not unknown, (page, words)
                seen += 1
    assert seen > 5


PAGE = 240.0
"""For the blocks of a page, on a busy machine; idle, the longest takes 20 s [s]."""
ENDING = 20.0
"""For helpers of a process that ends after it, on a busy machine [s]."""


def ended(group: int, patience: float) -> bool:
    """Wait until no process of a group is left [s]."""
    deadline = time.monotonic() + patience
    while time.monotonic() < deadline:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.02)
    return False


@pytest.fixture(scope='module')
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Place to run them in, with what a checkout has, and ``tudor`` on its path."""
    folder = tmp_path_factory.mktemp('checkout')
    for name in ('config', 'bags', 'papers', 'tools'):
        shutil.copytree(ROOT / name, folder / name)
    (folder / 'bin').mkdir()
    modules = {'tudor': 'tudor_dynamics',
               **{node: f'tudor_dynamics.nodes {node}' for node in NODES}}
    for tool, words in {'python': '', **{k: f'-m {v} ' for k, v in modules.items()}}.items():
        file = folder / 'bin' / tool
        file.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} {words}"$@"\n')
        file.chmod(0o755)
    return folder


@pytest.mark.parametrize('page', sorted({
    page for page, _ in shell(run=True) if 'tutorials' not in page}))  # test_tutorials.py has them
def test_commands_run(page: str, checkout: Path, tmp_path: Path) -> None:
    """The blocks of a page, one after the other, in a fresh copy: all of them end well."""
    place = tmp_path / 'work'
    shutil.copytree(checkout, place)
    script = 'set -e\n' + '\n'.join(text for own, text in shell(run=True) if own == page)
    with (tmp_path / 'stderr').open('w+') as told:
        process = subprocess.Popen(
            ['bash', '-c', script], cwd=place, stdout=subprocess.DEVNULL, stderr=told,
            start_new_session=True,
            env={**os.environ, 'PATH': f'{place}/bin:{os.environ["PATH"]}',
                 'PYTHONPATH': str(ROOT), 'PYTHONDONTWRITEBYTECODE': '1',
                 'PYTHONFAULTHANDLER': '1'})
        try:
            code = process.wait(PAGE)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGABRT)  # each says where it stands
            code = process.wait(ENDING)
        finally:
            left = not ended(process.pid, ENDING)
            if left:  # what the blocks started, too
                os.killpg(process.pid, signal.SIGKILL)
        told.seek(0)
        assert code == 0, f'{page}:\n{script}\n{told.read()[-8000:]}'
    assert not left, f'{page}: processes go on when all commands have ended'


def test_links_lead_somewhere() -> None:
    """Links and pictures of the pages are there, and so are the headings that they name."""
    for page in PAGES:
        text = page.read_text(encoding='utf-8')
        for target in re.findall(r'\]\(([^)\s]+)\)', text):
            if '://' in target:
                continue
            name, _, anchor = target.partition('#')
            file = (page.parent / name).resolve() if name else page
            assert file.exists(), (page, target)
            if anchor:
                headings = [re.sub(r'[^\w\- ]', '', line.lstrip('# ').lower()).replace(' ', '-')
                            for line in file.read_text(encoding='utf-8').splitlines()
                            if line.startswith('#')]
                assert anchor in headings, (page, target)


def test_the_readme_is_read_in_three_minutes() -> None:
    """At most 700 words, and fences that every Markdown renderer takes."""
    text = (ROOT / 'README.md').read_text(encoding='utf-8')
    assert len(text.split()) <= 700
    assert not re.search(r'^```\w+ ', text, re.MULTILINE)


def test_the_environment_has_the_command() -> None:
    """Whatever pip made it with, ``tudor`` is where the README says."""
    binaries = ROOT / '.venv' / 'bin'
    if Path(sys.executable).parent != binaries:
        pytest.skip('not run in the environment of make venv')
    done = subprocess.run([binaries / 'tudor', '--version'], stdout=subprocess.PIPE, check=False)
    assert done.returncode == 0 and done.stdout.startswith(b'tudor')
