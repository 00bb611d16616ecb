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

"""An interrupt ends every long command at once, on one line, and leaves nothing half written."""

from __future__ import annotations

from pathlib import Path
import signal
import subprocess
import sys

import pytest

COMMANDS = {
    'fit': 'fit bags/two_blade_train_1 --arm config/two_blade_arm.yaml --out {out}',
    'stream': 'fit bags/two_blade_train_1 bags/two_blade_train_2 --stream --jobs 2 '
              '--arm config/two_blade_arm.yaml --out {out}',
    'record': 'record --arm config/tudor.yaml --stimuli 9 --seconds 900 --jobs 1 --out {out}',
    'excite': 'excite config/tudor.yaml --floor 0 --steps 100000 --out {out}',
}
PROGRAM = """
import signal
import sys
from tudor_dynamics.cli.main import main
signal.signal(signal.SIGINT, signal.default_int_handler)  # also where a shell ignores it
sys.argv[0] = 'tudor'
print('begins', flush=True)
sys.exit(main())
"""


@pytest.fixture(scope='module', autouse=True)
def compiled(root: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Compile what a fit needs: an interrupted compiler says more than one line."""
    words = COMMANDS['fit'].format(out=tmp_path_factory.mktemp('compiled') / 'out').split()
    subprocess.run([sys.executable, '-m', 'tudor_dynamics', *words], cwd=root, check=True,
                   stdout=subprocess.DEVNULL)


@pytest.mark.parametrize(('name', 'seconds'), [
    ('fit', 1.5), ('fit', 3.0), ('stream', 2.5), ('record', 2.0), ('excite', 2.0)])
def test_ends_at_once(name: str, seconds: float, root: Path, tmp_path: Path) -> None:
    """Exit code 130, as a shell has it, and one line."""
    words = COMMANDS[name].format(out=tmp_path / 'out').split()
    process = subprocess.Popen(
        [sys.executable, '-c', PROGRAM, *words], cwd=root, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == 'begins\n'
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode in (130, -signal.SIGINT), (out, err)
    lines = [line for line in err.splitlines() if not line.startswith('warning: ')]
    assert lines == [f'tudor {words[0]}: interrupted'] and out == ''
    assert not list(tmp_path.rglob('.*'))
