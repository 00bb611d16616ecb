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

"""What stands where a command writes: one rule for all of them."""

from __future__ import annotations

from errno import ENOSPC
import json
from pathlib import Path

from bag_making import make_bag, plain_arm
from matplotlib.figure import Figure
import pytest
from sample_arms import random_states
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags import writer
from tudor_dynamics.cli.main import main
from tudor_dynamics.errors import UsageError
from tudor_dynamics.files import check_target, write_figure
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import ModelBundle, save_bundle
from tudor_dynamics.models.regressor import EffortRegressor

REFUSED = 'exists already; choose another --{}, or add --overwrite'


@pytest.fixture(scope='module')
def given(root: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Make a bag, a model, a table and a plan of a fleet."""
    folder = tmp_path_factory.mktemp('given')
    arm, motion = plain_arm(), random_states(300, 2, 0)
    fitted = AnalyticalModel(EffortRegressor(arm), 2).fit(motion, 5.0 * motion[:, :2])
    save_bundle(ModelBundle(arm, PreprocessingSpec(), {'effort': {'analytical': fitted}}),
                folder / 'model')
    make_bag(folder / 'bag')
    (folder / 'table.csv').write_text('t,shoulder,elbow\n0,0,0\n1,0.2,0.1\n2,0,0\n')
    (folder / 'plan.yaml').write_text(json.dumps({
        'name': 'two', 'arm': str(root / 'config' / 'two_blade_arm.yaml'),
        'arms': [{'name': name, 'bags': {'2026-01-10': str(root / 'bags' / name)}}
                 for name in ('two_blade_train_1', 'two_blade_train_2')]}))
    return {**{name: str(folder / name) for name in ('bag', 'model')},
            'table': str(folder / 'table.csv'), 'plan': str(folder / 'plan.yaml')}


@pytest.fixture(autouse=True)
def here(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run commands where the configurations are; few poses for each schedule."""
    monkeypatch.setattr('tudor_dynamics.models.tuning.POSES', 3)
    monkeypatch.chdir(root)


SHORT = 'simulate config/single_flexible_link.yaml --torque 0 --seconds 0.1 --rate 100'
MOTION = '--noise 0.4 --seconds 10 --steps 1'
COMMANDS = {
    'evaluate --save': ('evaluate {bag} --model {model} --save', 'save', 'x.npz', ''),
    'evaluate --report': ('evaluate {bag} --model {model} --report', 'report', 'x.html', 'drawn'),
    'excite': (f'excite config/tudor.yaml --floor 0 {MOTION} --out', 'out', 'x', 'plan.json'),
    'export': ('export {model} --to csv --out', 'out', 'x.csv', ''),
    'feedforward': ('feedforward {table} --model {model} --out', 'out', 'x.csv', ''),
    'record': ('record --arm config/tudor.yaml --stimuli 1 --seconds 3 --jobs 1 --out', 'out',
               'stimulus_01', 'metadata.yaml'),
    'simulate': (f'{SHORT} --out', 'out', 'bag', 'metadata.yaml'),
    'simulate: arrays': (f'{SHORT} --out', 'out', 'run.npz', ''),
    'simulate --pictures': (f'{SHORT} --pictures --out', 'out', 'energy.png', 'drawn'),
    'simulate --picture': (f'{SHORT} --picture', 'picture', 'x.gif', ''),
    'tune': ('tune config/tudor.yaml --payloads 0 --out', 'out', 'x.yaml', ''),
    'tune --picture': ('tune config/tudor.yaml --payloads 0 --out', 'picture', 'x.png', 'drawn'),
    'watch --picture': ('watch {bag} --model {model} --picture', 'picture', 'x.svg', 'drawn'),
}
ABOVE = {'record', 'simulate', 'simulate: arrays', 'simulate --pictures'}  # --out is a folder


@pytest.mark.parametrize('name', COMMANDS)
def test_every_command(
    name: str, given: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """What a user has there stays; with --overwrite it goes, a foreign folder never."""
    command, option, file, kind = COMMANDS[name]
    out = tmp_path if name in ABOVE else tmp_path / file
    out = out.with_suffix('.yaml') if name == 'tune --picture' else out
    words = [*(word.format_map(given) for word in command.split()), str(out)]
    target = tmp_path / file
    if '.' in file:
        target.write_text('years of work')
    else:
        target.mkdir()
        (target / 'years_of_work').touch()

    def refused(*more: str) -> str:
        assert main([*words, *more]) == 2
        err = [line for line in capsys.readouterr().err.splitlines() if line.startswith('tudor ')]
        assert len(err) == 1 and str(target) in err[0], err
        return err[0]

    assert refused().endswith(REFUSED.format(option))
    if target.is_dir():
        assert 'exists already, but was not written by' in refused('--overwrite')
        assert (target / 'years_of_work').exists()
        (target / kind).touch()
        if name == 'excite':  # a plan that fits no arm is one all the same
            (target / kind).write_text('{}')
    else:
        assert target.read_text() == 'years of work'
    assert main([*words, '--overwrite']) in (0, 1)
    if target.is_dir():
        assert not (target / 'years_of_work').exists() and (target / kind).stat().st_size
    elif kind == 'drawn':  # and from now on it is one of tudor
        before = target.stat().st_ino
        free = words if name == 'watch --picture' or option == 'report' else [
            *words[:-1], str(tmp_path / 'new.yaml'), '--picture', str(target)]
        if name != 'simulate --pictures':
            assert main(free) in (0, 1) and target.stat().st_ino != before
        assert 'exists already' not in capsys.readouterr().err
    else:
        assert target.read_bytes()[:5] != b'years'


def test_fewer_stimuli_than_before(tmp_path: Path) -> None:
    """With --overwrite a folder of bags has one campaign, not the rest of another."""
    words = ['record', '--arm', 'config/tudor.yaml', '--seconds', '3', '--jobs', '1', '--out',
             str(tmp_path), '--stimuli']
    assert main([*words, '2']) == 0 and main([*words, '1']) == 2
    assert main([*words, '1', '--overwrite']) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ['campaign.yaml', 'stimulus_01']


@pytest.mark.parametrize(('words', 'name'), [
    (COMMANDS['record'][0], 'stimulus_01'), (COMMANDS['simulate'][0], 'bag')])
def test_a_bag_goes_when_the_next_one_is_whole(
    words: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Until then an error, as of a full disk, leaves the old one where it is."""
    out = tmp_path / 'out'
    assert main([*words.split(), str(out)]) == 0
    before = (out / name / 'metadata.yaml').read_bytes()

    def full(*_: object) -> None:
        raise OSError(ENOSPC, 'No space left on device')
    monkeypatch.setattr(writer.Writer, 'write', full)
    assert main([*words.split(), str(out), '--overwrite']) == 2
    assert (out / name / 'metadata.yaml').read_bytes() == before
    monkeypatch.undo()


def test_a_fleet_goes_on_where_it_was(
    given: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """Its own folder needs no --overwrite, numbers and pages of others do."""
    words = ['fleet', given['plan'], '--no-models', '--jobs', '1', '--out', str(tmp_path)]
    for name in ('fleet.json', 'fleet.html'):
        (tmp_path / name).write_text('mine')
        assert main(words) == 2
        assert capsys.readouterr().err.strip().endswith(
            f'{tmp_path / name}: {REFUSED.format("out")}')
        (tmp_path / name).unlink()
    assert main(words) in (0, 1) and main(words) in (0, 1)
    (tmp_path / 'fleet.html').write_text('mine')
    assert main(words) == 2 and main([*words, '--overwrite']) in (0, 1)


@pytest.mark.parametrize(('words', 'ending'), [
    ('evaluate {bag} --model {model} --save', '.npz'),
    ('evaluate {bag} --model {model} --report', '.html'),
    ('tune config/tudor.yaml --out', '.yaml or .yml'),
    ('tune config/tudor.yaml --out free.yaml --picture', '.png or .svg or .pdf'),
    ('watch {bag} --model {model} --picture', '.svg'), (f'{SHORT} --picture', '.gif or .mp4')])
def test_an_ending_that_does_not_fit(
    words: str, ending: str, given: dict[str, str], tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The error says which one does, and the file stays, also with --overwrite."""
    table = tmp_path / 'x.csv'
    table.write_text('t\n')
    words = words.format_map(given)
    assert main([*words.split(), str(table), '--overwrite']) == 2
    assert f'ends in {ending}' in capsys.readouterr().err and table.read_text() == 't\n'


@pytest.mark.parametrize('ending', ['png', 'svg', 'pdf'])
def test_a_picture_of_tudor_is_known_by_its_content(ending: str, tmp_path: Path) -> None:
    """It is replaced under any name; one that another program drew is not."""
    figure, path = Figure(), tmp_path / f'x.{ending}'
    figure.savefig(path)
    with pytest.raises(UsageError, match='exists already; choose another picture=, or add overw'):
        check_target(path, name='picture')
    write_figure(figure, path)
    assert check_target(path) == path
    with pytest.raises(UsageError, match='choose another debug=$'):
        check_target(tmp_path, overwrite=None, name='debug')


def test_a_bug_report(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An earlier one is replaced, any other file stays, and nothing is done for it."""
    words = ['info', str(root / 'bags' / 'two_blade_test'), '--debug', str(tmp_path / 'x.txt')]
    assert main(words) == main(words) == 0 and 'exit code: 0' in (tmp_path / 'x.txt').read_text()
    (tmp_path / 'x.txt').write_text('mine')
    capsys.readouterr()
    assert main(words) == 2
    said = capsys.readouterr()
    assert said.err.endswith('x.txt: exists already; choose another --debug\n') and not said.out


def test_a_dangling_link_is_something(tmp_path: Path) -> None:
    """What it names may be a disk that is not there today."""
    (tmp_path / 'link').symlink_to('away')
    with pytest.raises(UsageError, match='exists already'):
        check_target(tmp_path / 'link')


@pytest.mark.parametrize(('words', 'said'), [
    ('export m --force', '--force (did you mean --overwrite?)'),
    ('evaluate b --roc', '--roc (did you mean --report?)'),
    ('evaluate b --plot', '--plot (did you mean --report?)'),
    ('tune a.yaml --plot x', '--plot (did you mean --picture?)'),
    ('tune a.yaml --pictures', '--pictures (did you mean --picture?)'),
    ('tune a.yaml --animate x', '--animate (did you mean --picture?)'),
    ('simulate a.yaml --animate=x.gif', '--animate is now --picture; version 1.2'),
    ('excite a.yaml --kind moves', '--kind (did you mean --for?)'),
    ('export m --save x', '--save (did you mean --out?)')])
def test_options_that_other_commands_have(
    words: str, said: str, capsys: pytest.CaptureFixture[str],
) -> None:
    """One line names the option that is meant."""
    try:
        assert main(words.split()) == 2
    except SystemExit as ended:
        assert ended.code == 2
    assert said in capsys.readouterr().err
