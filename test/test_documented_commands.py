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

Commands in the text, in tables, and below figures (``docs/figures``) are parsed: by the parser of
``tudor`` or of the script that they name; there, words in capitals stand for any value. Names in
the text are ones that the code knows.

Blocks of shell carry ``sh``. What follows, or a comment in the line above where the fence has to
stay plain, says why a block is not run here: ``long`` takes more than some seconds, ``own`` needs
bags of the reader, ``ros`` needs a running ROS or a workspace. Of those the ``tudor`` commands are
still parsed, so that no option in them is out of date.
"""

from __future__ import annotations

from argparse import _SubParsersAction, ArgumentParser
import ast
from collections import Counter
from importlib import import_module
import json
import os
from pathlib import Path
import re
import runpy
import shlex
import shutil
import signal
import subprocess
import sys
import textwrap
import time

from papers.__main__ import build_parser as papers_parser
import pytest
import tudor_dynamics
from tudor_dynamics.arm.schema import ArmSpec
from tudor_dynamics.cli.main import build_parser, SUBCOMMANDS
from tudor_dynamics.fleet.study import FleetPlan
from tudor_dynamics.nodes.common.interfaces import NODES
import yaml

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([ROOT / 'README.md', ROOT / 'bags' / 'README.md', ROOT / 'examples' / 'README.md',
                *(page for page in (ROOT / 'docs').rglob('*.md')
                  if 'generated' not in page.parts)])
REASONS = ('long', 'own', 'ros')
FENCE = re.compile(r'^(?: *<!-- (?P<why>\w+) -->\n)?(?P<indent> *)```(?P<info>[^\n]*)\n'
                   r'(?P<text>.*?)^(?P=indent)```$', re.MULTILINE | re.DOTALL)
"""A block, in the steps of a list too, where it is indented."""
BLOCK = re.compile(r'^ *(```|~~~).*?^ *\1 *$', re.MULTILINE | re.DOTALL)
STANDS_FOR = re.compile(r'[A-Z]+(\.\w+)?')
"""A word of a command in the text that stands for a value of the reader."""


KEYS = (ArmSpec, FleetPlan)
"""What YAML on a page describes, if not parameters of nodes."""
MOVEIT = 'moveit_simple_controller_manager'
"""What YAML is for MoveIt; ``test_ros2_control`` compares it with the relay."""
TRIALS = ('joint_test', 'damper_sign_test')
"""Programs for ROS that are no nodes: they have a parser of their own."""
OF_OTHERS = ('friction_model_controller', 'unit03_mult_lin_reg', 'out/figures.json',
             'docs/figures/NAME.json')
"""Names between backticks that belong to other software, or to the reader."""


def fenced(text: str) -> list[tuple[str, str]]:
    """Give info string and text of every fenced block of a page."""
    return [(f'{match["info"]} {match["why"] or ""}'.strip(), textwrap.dedent(match['text']))
            for match in FENCE.finditer(text)]


def blocks() -> list[tuple[str, str, str]]:
    """Give page, info string and text of every fenced block of all pages."""
    return [(str(page.relative_to(ROOT)), info, text) for page in PAGES
            for info, text in fenced(page.read_text(encoding='utf-8'))]


def is_output(page: str, info: str) -> bool:
    """Say whether a block is what commands of a tutorial print."""
    return page.startswith('docs/tutorials/') and info.split()[:1] == ['text']


def shell(*, run: bool) -> list[tuple[str, str]]:
    """Give the blocks of shell that are run here, or those that are not, and what output names."""
    named = [(page, '\n'.join(re.findall(r'^ *(?:tudor|ros2) (?:.*\\\n)*.*$', text, re.MULTILINE)))
             for page, info, text in blocks() if is_output(page, info)]
    return [(page, text) for page, info, text in blocks()
            if info.split()[:1] == ['sh'] and (info == 'sh') == run] + ([] if run else named)


def commands(text: str) -> list[list[str]]:
    """Split a block into commands and words."""
    lines = text.replace('\\\n', ' ').splitlines()
    return [words for words in (shlex.split(line, comments=True) for line in lines) if words]


def named() -> list[tuple[str, str]]:
    """Give page and text of what stands between backticks, in one line; of figures the command."""
    texts = [(page, BLOCK.sub('', page.read_text(encoding='utf-8')))
             for page in [*PAGES, ROOT / 'CONTRIBUTING.md', ROOT / 'QUALITY_DECLARATION.md']]
    for file in sorted((ROOT / 'docs' / 'figures').glob('*.json')):
        data = json.loads(file.read_text(encoding='utf-8'))
        texts.append((file, '\n'.join([f'`{command.strip()}`' for command in
                                      data['command'].split(';')] + sum(data['rows'], []))))
    return [(str(file.relative_to(ROOT)), ' '.join(match[1].split()))
            for file, text in texts for match in re.finditer(r'`([^`]+)`', text)]


def inline() -> list[tuple[str, list[str]]]:
    """Give page and words of the commands between backticks."""
    begins = rf'(tudor|ros2|python|make|{"|".join(NODES)}|bench/\S+ --\w+)( |$)'
    found = [(page, shlex.split(text)) for page, text in named() if re.match(begins, text)]
    return [(page, ['python'] * words[0].startswith('bench/') + words) for page, words in found]


def shown(start: str) -> list[tuple[str, list[str]]]:
    """Give page and words of each command that begins so, of blocks and text."""
    found = [(page, words) for run in (True, False) for page, text in shell(run=run)
             for words in commands(text)]
    return [(page, words) for page, words in (*found, *inline()) if words[0] == start]


@pytest.fixture
def any_value(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let parsers take words in capitals for any value."""
    get, check = ArgumentParser._get_value, ArgumentParser._check_value
    monkeypatch.setattr(ArgumentParser, '_get_value', lambda self, action, text: (
        text if STANDS_FOR.fullmatch(text) else get(self, action, text)))
    monkeypatch.setattr(ArgumentParser, '_check_value', lambda self, action, value: (
        None if STANDS_FOR.fullmatch(str(value)) else check(self, action, value)))


def lenient(parser: ArgumentParser) -> ArgumentParser:
    """Make a parser take a command that is only spoken of: nothing is required."""
    for action in parser._actions:
        action.required = False
        if isinstance(action, _SubParsersAction):
            for sub in action.choices.values():
                lenient(sub)
        elif action.nargs in (None, '+'):
            action.nargs = '*'
    return parser


def test_blocks_say_what_they_are() -> None:
    """No command stands in a block of another kind, and reasons are known ones."""
    for page, info, text in blocks():
        words = info.split()
        if words[:1] == ['sh']:
            assert len(words) == 1 or (len(words) == 2 and words[1] in REASONS), (page, info)
        elif not is_output(page, info):
            assert not re.search(r'^\s*(tudor|ros2|make) ', text, re.MULTILINE), (page, text)
    for page in PAGES:  # nor outside of one, where indented text is a block too
        outside = FENCE.sub('', page.read_text(encoding='utf-8'))
        assert not (found := re.search(r'^ {4,}(tudor|ros2) .*', outside, re.M)), (page, found)


def test_blocks_of_code_and_data_parse() -> None:
    """Python compiles and uses names of the library; YAML has keys of the arm or of parameters."""
    seen: Counter[str] = Counter()
    for page, kind, block in blocks():
        if kind == 'python':
            names = {node.attr for node in ast.walk(ast.parse(block))
                     if isinstance(node, ast.Attribute)
                     and isinstance(node.value, ast.Name) and node.value.id == 'td'}
            assert names and names <= set(tudor_dynamics.__all__), (page, names)
        elif kind == 'yaml':
            content = yaml.safe_load(block)
            assert any(set(content) <= set(known.model_fields) for known in KEYS) or all(
                'ros__parameters' in item or key == MOVEIT
                for key, item in content.items()), (page, content)
        seen[kind] += 1
    assert min(seen[kind] for kind in ('python', 'yaml')) > 2


def parsed(text: str) -> int:
    """Let parsers take the commands of ``tudor`` and of the papers in a block; count them."""
    count = 0
    for words in commands(text):
        if words[:3] == ['python', '-m', 'papers']:
            papers_parser().parse_args(words[3:])
        elif words[0] == 'tudor':
            assert words[1] in SUBCOMMANDS, words
            build_parser(words[1]).parse_args(words[1:])
        else:
            continue
        count += 1
    return count


@pytest.mark.parametrize('run', [True, False])
def test_options_are_known(run: bool, capsys: pytest.CaptureFixture[str]) -> None:
    """Every command of ``tudor`` and of the papers is one that its parser takes."""
    count = 0
    for page, text in shell(run=run):
        try:
            count += parsed(text)
        except SystemExit:
            pytest.fail(f'{page}: {text}: {capsys.readouterr().err}')
    assert count > (3 if run else 50)


@pytest.mark.parametrize('indent', ['', '   '])
def test_a_wrong_option_is_found(indent: str) -> None:
    """In a block of its own and in one of a step: a wrong option ends it, a right one is read."""
    block = '```sh own\ntudor fit run1 --arm arm.yaml --out model --WRONG\n```'
    page = f'1. Fit:\n\n{textwrap.indent(block, indent)}\n\n2. Next.\n'
    [(_, right)] = fenced(page.replace(' --WRONG', ''))
    assert parsed(right) == 1
    [(info, wrong)] = fenced(page.replace('WRONG', 'no-such-option'))
    assert info == 'sh own'
    with pytest.raises(SystemExit):
        parsed(wrong)


@pytest.mark.usefixtures('any_value')
def test_commands_in_the_text_are_known(capsys: pytest.CaptureFixture[str]) -> None:
    """What the text says of ``tudor`` is what its parsers take, if only a part of a command."""
    seen = 0
    for page, words in inline():
        if words[0] != 'tudor' or len(words) == 1:
            continue
        assert words[1] in SUBCOMMANDS or words[1:] in (['--help'], ['--version']), (page, words)
        try:
            lenient(build_parser(words[1])).parse_args(words[1:])
        except SystemExit as done:
            assert done.code == 0, f'{page}: {words}: {capsys.readouterr().err}'
        seen += 1
    assert seen > 50


def test_nodes_and_parameters_are_known() -> None:
    """Every node that a command starts is there, and so are the parameters that it sets."""
    seen = 0
    for page, words in [*shown('ros2'), *(pair for node in NODES for pair in shown(node))]:
        if words[0] == 'ros2':
            assert words[1:2] in (['run'], ['bag'], ['topic'], ['service'], ['action'],
                                  ['daemon'], ['param'], ['node'], ['control']), (page, words)
            if words[1:3] != ['run', 'tudor_dynamics']:
                continue
            words = words[3:]
            assert words[0] in (*NODES, *TRIALS, 'tudor', 'NAME', 'NODE'), (page, words)
        if words[0] in TRIALS:
            import_module(f'tudor_dynamics.nodes.{words[0]}').main.args[0].parse_args(words[1:])
        if words[0] in NODES:
            known = {'use_sim_time', *(param.name for param in NODES[words[0]])}
            assert {word.partition(':=')[0] for flag, word in zip(words, words[1:], strict=False)
                    if flag == '-p'} <= known, (page, words)
            seen += 1
    assert seen > 5


def test_targets_are_known() -> None:
    """Every target of make that a page names is there, and so is each variable."""
    text = (ROOT / 'Makefile').read_text(encoding='utf-8')
    targets = set(re.findall(r'^(\w+):', text, re.MULTILINE))
    variables = {'PYTHON', *re.findall(r'^(\w+) \?=', text, re.MULTILINE)}  # tools/find_python
    seen = shown('make')
    for page, words in seen:
        assert {word for word in words[1:] if '=' not in word} <= targets, (page, words)
        assert {word.split('=')[0] for word in words if '=' in word} <= variables, (page, words)
    assert len(seen) > 10


PARSES = r'\.parse_args\(|\bdata_directory\(|^ *(?:sys\.exit\()?main\(__doc__'
"""Whether a script of ``bench`` parses options, by itself or by what its likes share."""


class Parsed(Exception):  # noqa: N818
    """A script has parsed its options; it goes no further."""


def parse(words: list[str], patch: pytest.MonkeyPatch) -> None:
    """Let a script parse its words; those without a parser are imported, and take no option."""
    real = ArgumentParser.parse_args

    def stop(self: ArgumentParser, args: list[str] | None = None, *_: object) -> None:
        raise Parsed(real(self, args))

    patch.setattr(ArgumentParser, 'parse_args', stop)
    if words[0] == '-m':
        patch.setattr(sys, 'argv', words[1:])
        patch.delitem(sys.modules, f'{words[1]}.__main__', raising=False)
        with pytest.raises(Parsed):
            runpy.run_module(words[1], run_name='__main__', alter_sys=True)
        return
    script = ROOT / words[0]
    source = script.read_text(encoding='utf-8')
    patch.setattr(sys, 'argv', [str(script), *words[1:]])
    patch.syspath_prepend(str(script.parent))
    if re.search(PARSES, source, re.MULTILINE):
        with pytest.raises(Parsed):
            runpy.run_path(str(script), run_name='__main__')
    else:
        assert words[1:] == [] or ('sys.argv' in source and '--' not in ' '.join(words)), words
        runpy.run_path(str(script))


@pytest.mark.usefixtures('any_value')
def test_scripts_and_their_options_are_known(capsys: pytest.CaptureFixture[str]) -> None:
    """Every script that a page names is there, and its own parser takes what it is given."""
    seen: set[tuple[str, ...]] = set()
    for page, words in shown('python'):
        if tuple(words) in seen or words[1] in ('-', 'examples/NAME.py'):
            continue
        seen.add(tuple(words))
        try:
            with pytest.MonkeyPatch.context() as patch:
                parse(words[1:], patch)
        except SystemExit as done:
            assert done.code == 0, f'{page}: {words}: {capsys.readouterr().err}'
    assert len(seen) > 40


def test_names_are_known() -> None:
    """Options, files and names with an underscore, a slash or brackets are ones of the code."""
    code = '\n'.join(file.read_text(encoding='utf-8') for folder in (
        'tudor_dynamics', 'bench', 'papers', 'tools', 'examples', 'config', 'test')
        for file in (ROOT / folder).rglob('*') if file.suffix in ('.py', '.yaml', '.html'))
    code += ' '.join((ROOT / name).read_text(encoding='utf-8') for name in (
        'Makefile', 'setup.cfg', 'setup.py', 'package.xml'))
    words, options = set(re.findall(r'\w+', code)), set(re.findall(r"'(--[\w-]+)'", code))
    unknown = []
    for page, text in named():
        word = text.split()[0].partition(':=')[0].rstrip('[],:')
        word = word.rpartition('[].')[2].removeprefix('~/').removeprefix('/')
        if re.fullmatch(r'[\w./-]+/[\w.-]+\.(py|md|yaml|json|txt|cfg|ipynb)', word):
            known = any((ROOT / folder / word).exists() for folder in ('', 'tudor_dynamics'))
        elif re.fullmatch(r'--[a-z][\w-]*', word):
            known = word in options
        elif re.fullmatch(r'[a-z]\w*_\w+(\.\w+)*', word):
            known = words.issuperset(word.split('.'))
        else:
            continue
        if not known and text not in OF_OTHERS:
            unknown.append((page, text))
    assert unknown == []


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
                 'PYTHONPATH': str(ROOT), 'PYTHONDONTWRITEBYTECODE': '',
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
