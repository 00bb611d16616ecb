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
Whether the wheel brings all that it needs, and how long that takes.

The wheel of this checkout is installed with its dependencies, from the package index that pip is
configured for, into an environment that has nothing else. There `tudor --version`, `tudor doctor`
and a fit of one recording run. Any that fails ends this with its output and exit code 1.

    python bench/empty_environment.py
"""

from __future__ import annotations

import os
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory
import time

ROOT = Path(__file__).resolve().parents[1]


def main() -> int:
    """Install, run, and print seconds."""
    bag = ROOT / 'bags' / 'two_blade_train_1'
    with TemporaryDirectory() as name:
        folder = Path(name)
        empty, tudor = folder / 'empty', folder / 'empty' / 'bin' / 'tudor'
        for what, command in {
            'make the environment': [sys.executable, '-m', 'venv', empty],
            'install': [empty / 'bin' / 'python', '-m', 'pip', 'install', '-q', '--use-pep517',
                        ROOT],
            'tudor --version': [tudor, '--version'],
            'tudor doctor': [tudor, 'doctor'],
            'tudor fit, the first': [
                tudor, 'fit', f'{bag}@0-50%', '--test', f'{bag}@50-100%', '--out', 'model',
                '--arm', empty / 'share/tudor_dynamics/config/two_blade_arm.yaml'],
        }.items():
            begun = time.perf_counter()
            done = subprocess.run([*map(str, command)], cwd=folder, text=True, check=False,
                                  capture_output=True, env={**os.environ, 'PYTHONPATH': ''})
            print(f'{what}: {time.perf_counter() - begun:.1f} s', flush=True)
            # a machine without ROS 2, or a model that is not good enough, is no failure here
            if done.returncode not in (0, 1) or 'Traceback' in done.stdout + done.stderr or (
                    done.returncode and what in ('install', 'make the environment')):
                print(done.stdout + done.stderr)
                return 1
        return int(not (folder / 'model' / 'report.html').is_file())


if __name__ == '__main__':
    sys.exit(main())
