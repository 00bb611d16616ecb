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
import re
import signal
import subprocess
import sys

from patience import PATIENCE
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

SWALLOWED = """
import ctypes
import os
import signal
import time
from types import SimpleNamespace
from tudor_dynamics.cli import main
signal.signal(signal.SIGINT, signal.default_int_handler)

@ctypes.CFUNCTYPE(None)
def called_by_c():
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(1.0)

def run(args):
    called_by_c()
    time.sleep(1000.0)
    return 0

main._subcommand = lambda name: SimpleNamespace(run=run)
parsed = SimpleNamespace(command='fit', quiet=False, debug=None)
main.build_parser = lambda only: SimpleNamespace(parse_args=lambda words: parsed)
raise SystemExit(main.main(['fit']))
"""
"""An interrupt in a callback of a C library, as those of a compiler; ctypes lets it get lost."""


@pytest.fixture(scope='module', autouse=True)
def compiled(root: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Compile what a fit needs, so that not the compiler alone is interrupted."""
    words = COMMANDS['fit'].format(out=tmp_path_factory.mktemp('compiled') / 'out').split()
    subprocess.run([sys.executable, '-m', 'tudor_dynamics', *words], cwd=root, check=True,
                   stdout=subprocess.DEVNULL)


@pytest.mark.parametrize(('name', 'seconds'), [
    ('fit', 0.7), ('fit', 1.5), ('stream', 2.5), ('record', 2.0), ('excite', 2.0)])
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
    lines = [line for line in err.splitlines()
             if not re.match(r'warning: |\d+ (of \d+|s): ', line)]  # steps, on a slow machine
    assert lines == [f'tudor {words[0]}: interrupted'] and out == ''
    assert not list(tmp_path.rglob('.*'))


def test_an_interrupt_that_a_callback_swallows() -> None:
    """It comes again, also where Python waits: numba's compiler asks Python in such callbacks."""
    done = subprocess.run([sys.executable, '-c', SWALLOWED], capture_output=True, text=True,
                          timeout=PATIENCE)
    assert (done.returncode, done.stderr) == (130, 'tudor fit: interrupted\n')
