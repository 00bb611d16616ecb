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

"""What is no file stays what it is, whatever a command is asked to write there."""

from __future__ import annotations

import json
import os
from pathlib import Path
import re
import stat

from bag_making import make_bag, plain_arm
import pytest
from sample_arms import random_states
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.writer import LiveWriter
from tudor_dynamics.cli.main import main
from tudor_dynamics.errors import TudorError
from tudor_dynamics.files import whole, write_directory, write_whole
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import ModelBundle, save_bundle
from tudor_dynamics.models.regressor import EffortRegressor

LINK = 'config/single_flexible_link.yaml'
COMMANDS = {
    'export': 'export {model} --to csv --overwrite --out {pipe}',
    'export to a description': 'export {model} --to yaml --overwrite --out {pipe}',
    'evaluate --save': 'evaluate {bag} --model {model} --overwrite --save {pipe}.npz',
    'evaluate --report': 'evaluate {bag} --model {model} --overwrite --report {pipe}.html',
    'fit': 'fit {bag} --arm config/two_blade_arm.yaml --overwrite --out {pipe}',
    'feedforward': 'feedforward {table} --model {model} --overwrite --out {pipe}.csv',
    'feedforward to a bag': 'feedforward {bag} --model {model} --overwrite --out {pipe}',
    'excite': 'excite config/two_blade_arm.yaml --floor 0 --out {pipe}',
    'fleet': 'fleet {plan} --out {pipe}',
    'init': 'init {bag} --overwrite --out {pipe}.yaml',
    'record': 'record --arm config/tudor.yaml --seconds 3 --out {pipe}',
    'simulate': f'simulate {LINK} --torque 0 --seconds 0.01 --out {{pipe}}',
    'simulate --picture': f'simulate {LINK} --torque 0 --seconds 0.1 --overwrite '
                          '--picture {pipe}.gif',
    'simulate --pictures': f'simulate {LINK} --pictures --overwrite --out {{folder}}',
    'watch --picture': 'watch {bag} --model {model} --overwrite --picture {pipe}.svg',
    'tune': 'tune config/tudor.yaml --payloads 0 --overwrite --out {pipe}.yaml',
    'tune --picture': 'tune config/tudor.yaml --payloads 0 --overwrite --out {free}.yaml '
                      '--picture {pipe}.png',
}


@pytest.fixture(scope='module')
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Save a model of the efforts of a plain arm."""
    arm, motion = plain_arm(), random_states(300, 2, 0)
    fitted = AnalyticalModel(EffortRegressor(arm), 2).fit(motion, 5.0 * motion[:, :2])
    path = tmp_path_factory.mktemp('model') / 'model'
    save_bundle(ModelBundle(arm, PreprocessingSpec(), {'effort': {'analytical': fitted}}), path)
    return path


@pytest.mark.parametrize(('name', 'linked'), [
    *((name, False) for name in COMMANDS), ('export', True), ('feedforward to a bag', True)])
def test_every_command(
    name: str, linked: bool, model: Path, root: Path, tmp_path: Path,
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A pipe, or a link to one, is refused on one line and is a pipe afterwards."""
    monkeypatch.setattr('tudor_dynamics.models.tuning.POSES', 3)
    places = {'model': model, 'bag': make_bag(tmp_path / 'bag'), 'table': tmp_path / 't.csv',
              'free': tmp_path / 'free', 'folder': tmp_path / 'folder', 'pipe': tmp_path / 'pipe',
              'plan': tmp_path / 'plan.yaml'}
    arms = [{'name': name, 'bags': {'2026-01-10': str(places['bag'])}} for name in 'ab']
    places['plan'].write_text(json.dumps(
        {'name': 'two', 'arm': str(root / 'config' / 'two_blade_arm.yaml'), 'arms': arms}))
    places['table'].write_text('t,shoulder,elbow\n0,0,0\n1,0.2,0.1\n2,0,0\n')
    places['folder'].mkdir()
    words = COMMANDS[name].split()
    at = next(word for word in words if '{pipe}' in word or '{folder}' in word)
    target = Path(at.format_map(places))
    target = target / 'initial.png' if '{folder}' in at else target
    os.mkfifo(tmp_path / 'behind' if linked else target)
    if linked:
        target.symlink_to('behind' if '{pipe}' in at else '../behind')
    monkeypatch.chdir(root)
    assert main([word.format_map(places) for word in words]) == 2
    err = [line for line in capsys.readouterr().err.splitlines() if line.startswith('tudor ')]
    assert len(err) == 1 and target.name in err[0], err
    assert stat.S_ISFIFO(target.stat().st_mode) and target.is_symlink() == linked
    assert not list(tmp_path.rglob('.*'))


def test_every_way_of_writing(tmp_path: Path) -> None:
    """Files, folders and bags; a link to a file or folder stays, what it leads to is written."""
    os.mkfifo(tmp_path / 'pipe')
    for write in (lambda path: write_whole(path, b'x'), lambda path: write_directory(path, {})):
        with pytest.raises(OSError, match='is a device, pipe or socket, not a file'):
            write(tmp_path / 'pipe')
    with pytest.raises(TudorError, match='exists already'):
        LiveWriter(tmp_path / 'pipe')
    with pytest.raises(OSError, match='not a file'), whole(tmp_path / 'late') as scratch:
        os.mkfifo(tmp_path / 'late')
        scratch.write_bytes(b'x')
    assert stat.S_ISFIFO((tmp_path / 'late').stat().st_mode)
    (tmp_path / 'deep').mkdir()
    for name in ('file', 'new'):
        (tmp_path / 'deep' / 'file').write_bytes(b'old')
        (tmp_path / name).symlink_to(f'deep/{name}')
        write_whole(tmp_path / name, b'new')
        assert (tmp_path / name).is_symlink()
        assert (tmp_path / 'deep' / name).read_bytes() == b'new'
    write_directory(tmp_path / 'deep' / 'folder', {'a': b'1'})
    (tmp_path / 'folder').symlink_to('deep/folder')
    write_directory(tmp_path / 'folder', {'b': b'2'})
    assert (tmp_path / 'folder').is_symlink()
    assert [item.name for item in (tmp_path / 'deep' / 'folder').iterdir()] == ['b']
    assert not list(tmp_path.rglob('.*'))


def test_nobody_else_writes(root: Path) -> None:
    """Files are renamed and opened for writing in one place; the others write scratch files."""
    writes = re.compile(
        r'os\.(replace|rename)\(|\.rename\(|write_text\(|write_bytes\(|savefig\(|np\.savez?\(|'
        r'open\([^)]*\'[wax]b?\'')
    known = {
        'bags/writer.py': 2,  # a bag as it grows in its scratch folder; refused where one is
        'cli/main.py': 2,  # what to report of a defect, a new temporary file; the null device
        'compiled.py': 1,  # empty files that are locked, beside what numba keeps
        'files.py': 7,
    }
    found = {}
    for file in (root / 'tudor_dynamics').rglob('*.py'):
        lines = [line for line in file.read_text().splitlines() if writes.search(line)
                 and not re.search(r'(buffer|stream|write_bytes\)|not savefig)', line)]
        if lines:
            found[file.relative_to(root / 'tudor_dynamics').as_posix()] = len(lines)
    assert found == known
