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

import json
from pathlib import Path
import shlex
import shutil

import draft_making
from printed import unwrapped
import pytest
from tudor_dynamics.cli import evaluate
from tudor_dynamics.cli.main import main
from tudor_dynamics.identification.doctor.between import Evaluated
from tudor_dynamics.identification.doctor.findings import found


def commands(said: str) -> list[list[str]]:
    """Find the commands that were printed, as a shell would take them."""
    lines = [line.strip().removeprefix('next: ') for line in said.replace('\\\n', '').splitlines()]
    return [shlex.split(line) for line in lines if line.startswith(('tudor ', 'ros2 '))]


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
    for _ in range(2):
        assert main(words) in (0, 1)
        said.append(capsys.readouterr().out)
        for command in commands(said[-1]):
            if command[0] == 'ros2':
                assert command[-1] == f'model:={place / "model"}'
                assert ros
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


@pytest.mark.parametrize('more', [[], ['--json']])
def test_more_false_alarms_than_promised(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """How many times what was promised came, and the fit whose thresholds know that motion."""
    bags, model = root / 'bags', tmp_path / 'a model'
    assert main(['fit', str(bags / 'two_blade_train_1'), '--test', str(bags / 'two_blade_test'),
                 '--arm', str(root / 'config/two_blade_arm.yaml'), '--out', str(model)]) == 0
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
    assert main(command[1:]) in (0, 1) and (tmp_path / 'a model_2').exists()
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
