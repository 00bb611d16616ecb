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

"""What a command says is to be run next can be run as it is printed."""

from __future__ import annotations

from argparse import ArgumentParser
import ast
from collections.abc import Iterator
from functools import cache
import json
from pathlib import Path
import re
import shlex
import shutil

import draft_making
from printed import unwrapped
import pytest
from tudor_dynamics.cli import evaluate
from tudor_dynamics.cli.main import build_parser, main, SUBCOMMANDS
from tudor_dynamics.identification.doctor.between import Evaluated
from tudor_dynamics.identification.doctor.findings import found


def commands(said: str) -> list[list[str]]:
    """Find the commands that were printed, as a shell would take them."""
    lines = [line.strip().removeprefix('next: ') for line in said.replace('\\\n', '').splitlines()]
    return [shlex.split(line) for line in lines if line.startswith(('tudor ', 'ros2 '))]


def are_declared(words: list[str]) -> bool:
    """Say whether ``ros2 run`` starts a node that there is, with parameters that it has."""
    nodes = pytest.importorskip('tudor_dynamics.nodes.common.interfaces').NODES
    node, *more = words[3:]
    return node in {*nodes, 'damper_sign_test', 'joint_test', 'NAME'} and {
        word.partition(':=')[0] for flag, word in zip(more, more[1:]) if flag == '-p'
    } <= {param.name for param in nodes.get(node, ())}


def texts(root: Path) -> Iterator[str]:
    """Give all texts of the package; what is put in later is a name there."""
    for file in sorted((root / 'tudor_dynamics').rglob('*.py')):
        parts: set[ast.AST] = set()  # of texts with names, which come before them
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.JoinedStr):
                parts.update(node.values)
                yield ''.join(str(item.value) if isinstance(item, ast.Constant) else 'NAME'
                              for item in node.values)
            elif node not in parts and isinstance(node, ast.Constant) and isinstance(
                    node.value, str):
                yield node.value


def test_every_command_in_a_text_is_one(
    root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    """Help, errors and logs name options that there are, of nodes those that are declared."""
    parser_of = cache(build_parser)
    get, check = ArgumentParser._get_value, ArgumentParser._check_value
    stands_for = re.compile('[A-Z0-9_.@:-]*[A-Z][A-Z0-9_.@:-]*')
    monkeypatch.setattr(ArgumentParser, '_get_value', lambda self, action, text: (
        text if stands_for.fullmatch(text) else get(self, action, text)))
    monkeypatch.setattr(ArgumentParser, '_check_value', lambda self, action, value: (
        None if stands_for.fullmatch(str(value)) else check(self, action, value)))
    seen = {'tudor': 0, 'ros2': 0}
    for text in texts(root):
        whole = text.replace('\\\n', ' ')
        for shown in (*re.findall('(?<!`)`(tudor [^`]*)`(?!`)', whole),
                      *re.findall('^ +(tudor .*?)(?: {3,}.*)?$', whole, re.MULTILINE),
                      *re.findall('(ros2 run tudor_dynamics [^`\n]*)', whole)):
            words = shlex.split(shown)
            seen[words[0]] += 1
            if words[0] == 'ros2':
                assert are_declared(words), shown
                continue
            assert words[1] in SUBCOMMANDS or words[1:] in (['COMMAND', '...'],), shown
            parser = parser_of(words[1])
            for action in parser._actions[-1].choices[words[1]]._actions:
                action.required = False
            try:
                parser.parse_args(words[1:])
            except SystemExit as ended:
                err = capsys.readouterr().err  # of an option alone its value is not said
                assert ended.code == 0 or words[-1][0] == '-' and 'expected' in err, err
    assert seen['tudor'] > 60 and seen['ros2'] > 2


@pytest.mark.parametrize('ros', [False, True])
def test_after_a_fit(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], ros: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Names with blanks, a model that is there, no ros2: each command ends with 0 or 1."""
    which = shutil.which
    monkeypatch.setattr(shutil, 'which', lambda name: (
        ('/bin/ros2' if ros else None) if name == 'ros2' else which(name)))
    place = tmp_path / "an arm's"
    place.mkdir()
    shutil.copytree(root / 'bags' / 'two_blade_test', place / 'a bag')
    arm = place / 'my arm.yaml'
    text = (root / 'config' / 'two_blade_arm.yaml').read_text()
    arm.write_text(text.partition('# From here on')[0])
    said = []
    words = ['fit', f'{place / "a bag"}@0-50%', '--arm', str(arm), '--out', str(place / 'model'),
             '--friction', 'viscous', '--test', f'{place / "a bag"}@50-100%']
    for _ in range(1 if ros else 2):
        assert main(words) in (0, 1)
        said.append(capsys.readouterr().out)
        for command in commands(said[-1]):
            if command[0] == 'ros2':
                assert command[-1] == f'model:={place / "model"}'
                assert ros and are_declared(command)
            else:
                assert main(command[1:]) in (0, 1), command
        capsys.readouterr()
        words += ['--overwrite']
    assert not any(word in text for text in said for word in ('MODEL', ' BAG', '--out none'))


def test_after_a_draft(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The first fit, unless something is still to be written into the description."""
    monkeypatch.chdir(tmp_path)
    Path('model').mkdir()
    Path('r 1.urdf').write_text(draft_making.urdf())
    draft_making.write(Path('a bag'), effort=draft_making.torques(draft_making.motion()[1]))
    assert main(['init', 'a bag', '--urdf', 'r 1.urdf', '--out', 'my arm.yaml']) == 0
    command, = commands(capsys.readouterr().out)
    assert command[-1] == 'model_2' and main(command[1:]) in (0, 1)
    capsys.readouterr()
    assert main(['init', 'a bag', '--out', 'open.yaml']) == 0
    said = capsys.readouterr().out
    assert "left as '?'" in said and not commands(said)


def test_from_a_plan_to_a_load(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each command reads what the one before wrote; whatever is printed as the next step runs."""
    (tmp_path / 'my arm.yaml').symlink_to(root / 'config' / 'tudor.yaml')
    (tmp_path / 'tudor.urdf').symlink_to(root / 'config' / 'tudor.urdf')
    monkeypatch.setattr('tudor_dynamics.models.tuning.POSES', 3)
    monkeypatch.chdir(tmp_path)
    brief = ['--seconds', '10', '--steps', '1', '--noise', '0.4']
    record = ['record', '--arm', 'my arm.yaml', '--stimuli', '1', '--jobs', '1', '--seconds',
              '10', '--out']
    printed: list[list[str]] = []

    def run(*words: str, codes: tuple[int, ...] = (0, 1)) -> str:
        assert main([*words]) in codes, capsys.readouterr().err
        said = capsys.readouterr()
        lines = commands(said.out)
        lines += [shlex.split(found) for found in re.findall('`(tudor [^`]*)`', said.err)]
        printed.extend(line for line in lines if line not in printed)
        return said.out + said.err

    Path('far.csv').write_text('t,joint2,joint3\n0,0,0\n1,0,9\n2,0,0\n')
    run(*record, 'none', '--trajectory', 'far.csv', codes=(2,))
    plan, = printed
    assert plan == ['tudor', 'excite', 'my arm.yaml', '--floor', '0', '--out', 'plan']
    run(*plan[1:], *brief)
    run(*record, 'run', '--trajectory', 'plan')
    run('fit', 'run', '--plan', 'plan', '--arm', 'my arm.yaml', '--out', 'a model', '--friction',
        'viscous')
    run(*record, 'loaded', '--payload', '0.4')
    run('compare', 'a model', 'a model', 'run/stimulus_01')
    run('payload', 'loaded/stimulus_01', '--model', 'a model')
    run('why', 'loaded/stimulus_01', '--model', 'a model')
    run('shape', 'plan/trajectory.csv', '--frequency', '8', '--out', 'shaped.csv')
    run('tune', 'my arm.yaml', '--payloads', '0', '--out', 's.yaml')
    run('simulate', 'my arm.yaml', '--torque', '0', '--seconds', '0.1', '--out', 'moved')
    said = run('evaluate', 'loaded/stimulus_01', '--model', 'a model')
    assert 'load in loaded/stimulus_01' in said
    assert ['tudor', 'payload', 'loaded/stimulus_01', '--model', 'a model'] in printed
    for command in printed[1:]:
        if command[0] == 'tudor' and command[1] != 'excite':  # a plan of a minute takes as long
            assert main(command[1:]) in (0, 1), command


@pytest.fixture(scope='module')
def judged(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fit one of the sample bags, judged by another."""
    out = tmp_path_factory.mktemp('judged') / 'a model'
    assert main(['fit', str(root / 'bags/two_blade_train_1'), '--test',
                 str(root / 'bags/two_blade_test'), '--arm',
                 str(root / 'config/two_blade_arm.yaml'), '--out', str(out)]) == 0
    return out


@pytest.mark.usefixtures('replayed_once')
@pytest.mark.parametrize('more', [[], ['--json']])
def test_more_false_alarms_than_promised(
    root: Path, judged: Path, capsys: pytest.CaptureFixture[str], more: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """How many times what was promised came, and the fit whose thresholds know that motion."""
    bags, model = root / 'bags', judged
    capsys.readouterr()
    # pushes that are called free motion: each is a false alarm
    words = ['evaluate', '--model', str(model), str(bags / 'two_blade_pushes')]
    assert main([*words, '--collisions', '--free', *more]) == 0
    said = capsys.readouterr().out
    if more:
        kept = json.loads(said)['collisions']['strain']['kept']
        assert kept['high'] > kept['ratio'] > kept['low'] > 1.0
        return
    assert 'times as many (90 % interval' in unwrapped(said) and 'of another kind or day' in said
    assert max(len(line.rstrip()) for line in said.splitlines() if line.startswith(
        ('strain  ', 'effort  ', 'momentum  '))) <= 80
    command, = commands(said)
    assert main(command[1:]) in (0, 1) and model.with_name('a model_2').exists()
    # 24 s without any alarm: even 400 times as many would be no surprise
    main([*words[:3], str(bags / 'two_blade_test'), '--collisions', '--free'])
    assert 'promised: too short to judge (' in capsys.readouterr().out
    # without --free the bag says itself that it was pushed: no cause for another fit
    main(words)
    said = capsys.readouterr().out
    assert 'fit again' not in said
    if 'has grown since the validation' in said:
        assert 'pushes (' not in said and 'holds' in said and '--collisions' in said
    # ends without motion are a fact about the bag, and no cause of an error
    monkeypatch.setattr(evaluate, 'examine_evaluation', lambda *_: Evaluated(
        (found('standstill', 'the arm stands'),), {}))
    main(words)
    stood = capsys.readouterr().out
    assert 'the arm stands' in stood and 'has grown since the validation' in stood
    assert 'holds 4 pushes: something touched' in stood and '--collisions' in stood
