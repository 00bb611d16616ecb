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

"""What a release holds: the sources, the wheel made of them, and the commands it installs."""

from __future__ import annotations

import os
from pathlib import Path
import shutil
import subprocess
import sys

from tudor_dynamics._version import __version__


def run(*words: str | Path, cwd: Path, **environment: str) -> str:
    """Run a command; give what it prints."""
    done = subprocess.run([*map(str, words)], cwd=cwd, text=True, capture_output=True,
                          env={**os.environ, **environment}, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_sources_wheel_and_what_is_installed(root: Path, tmp_path: Path) -> None:
    """A wheel of the packed sources has every file of the package, and its commands run."""
    tree = tmp_path / 'tree'
    shutil.copytree(root, tree, ignore=lambda folder, names: [
        name for name in names if name == '__pycache__' or Path(folder) == root and name not in (
            'tudor_dynamics', 'config', 'resource', 'setup.py', 'setup.cfg', 'package.xml',
            'README.md', 'LICENSE')])
    packed, installed = tmp_path / 'packed', tmp_path / 'installed'
    run(sys.executable, 'setup.py', '-q', 'sdist', '-d', packed, cwd=tree)
    sources, = packed.iterdir()
    pip = (sys.executable, '-m', 'pip', '--disable-pip-version-check', '-q')
    run(*pip, 'wheel', '--no-deps', '--no-build-isolation', '--no-index', '-w', packed, sources,
        cwd=tmp_path)
    wheel, = packed.glob('*.whl')
    run(*pip, 'install', '--no-deps', '--no-index', '--no-compile', '--target', installed, wheel,
        cwd=tmp_path)

    def files(folder: Path) -> set[str]:
        return {str(file.relative_to(folder)) for file in folder.rglob('*') if file.is_file()}
    assert files(installed / 'tudor_dynamics') == files(tree / 'tudor_dynamics')
    share = installed / 'share' / 'tudor_dynamics'
    assert files(share / 'config') == files(tree / 'config')
    assert (share / 'package.xml').is_file()
    commands = {file.name for file in (installed / 'bin').iterdir()}
    assert {'tudor', 'monitor', 'oscillation_damper', 'joint_test'} <= commands
    said = run(sys.executable, '-c', 'import tudor_dynamics.cli.main as entry, sys; '
               "print(entry.__file__); sys.argv = ['tudor', '--version']; entry.main()",
               cwd=tmp_path, PYTHONPATH=str(installed), PYTHONDONTWRITEBYTECODE='1')
    assert said.splitlines() == [
        str(installed / 'tudor_dynamics/cli/main.py'), f'tudor_dynamics {__version__}']
