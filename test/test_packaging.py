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

import ast
from configparser import ConfigParser
from importlib import metadata
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET

import pytest
from tudor_dynamics._version import __version__

PIP = (sys.executable, '-m', 'pip', '--disable-pip-version-check', '-q')


def run(*words: str | Path, cwd: Path, **environment: str) -> str:
    """Run a command; give what it prints."""
    done = subprocess.run([*map(str, words)], cwd=cwd, text=True, capture_output=True,
                          env={**os.environ, **environment}, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def wheel_of(root: Path, folder: Path) -> Path:
    """Pack the sources, and make a wheel of the package."""
    tree, packed = folder / 'tree', folder / 'packed'
    shutil.copytree(root, tree, ignore=lambda folder, names: [
        name for name in names if name == '__pycache__' or Path(folder) == root and name not in (
            'tudor_dynamics', 'config', 'resource', 'setup.py', 'setup.cfg', 'package.xml',
            'README.md', 'LICENSE')])
    run(sys.executable, 'setup.py', '-q', 'sdist', '-d', packed, cwd=tree)
    sources, = packed.iterdir()
    run(*PIP, 'wheel', '--no-deps', '--no-build-isolation', '--no-index', '-w', packed, sources,
        cwd=folder)
    wheel, = packed.glob('*.whl')
    return wheel


def test_sources_wheel_and_what_is_installed(root: Path, tmp_path: Path) -> None:
    """A wheel of the packed sources has every file of the package, and its commands run."""
    tree, installed = tmp_path / 'tree', tmp_path / 'installed'
    run(*PIP, 'install', '--no-deps', '--no-index', '--no-compile', '--target', installed,
        wheel_of(root, tmp_path), cwd=tmp_path)

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


@pytest.mark.parametrize(('target', 'compiles'), [('venv', True), ('demo', True), ('test', False)])
def test_what_make_compiles(root: Path, tmp_path: Path, target: str, compiles: bool) -> None:
    """The first command of a new environment finds its inner loops; tests compile their own."""
    said = run('make', '-n', target, f'VENV={tmp_path}', cwd=root)
    assert ('compiling inner loops' in said) == compiles
    assert not compiles or said.index('pip install') < said.index('compiling inner loops')


def test_every_import_is_declared(root: Path) -> None:
    """Of the package: in setup.cfg, as an extra where it may be absent, or in package.xml."""
    config = ConfigParser()
    config.read(root / 'setup.cfg')

    def plain(name: str) -> str:
        return name.lower().replace('_', '-')

    def names(text: str) -> set[str]:
        return {plain(re.split(r'[\[<>=]', line)[0]) for line in text.split()}
    declared = names(config['options']['install_requires'])
    extras = names(config['options.extras_require']['cluster'])
    extras |= names(config['options.extras_require']['frames'])
    ros = {item.text for item in ET.parse(root / 'package.xml').iter('exec_depend')}
    ros.add('control_msgs')  # nodes do without, as wheels have none
    owners = metadata.packages_distributions()
    lacking, always = {}, set()
    for file in (root / 'tudor_dynamics').rglob('*.py'):
        tree = ast.parse(file.read_text())
        for node in ast.walk(tree):
            found = [item.name for item in node.names] if isinstance(node, ast.Import) else [
                node.module or ''] if isinstance(node, ast.ImportFrom) else []
            for name in {item.partition('.')[0] for item in found}:
                if name in {*sys.stdlib_module_names, 'tudor_dynamics', *ros}:
                    continue
                own = {plain(item) for item in owners.get(name, [name])}
                if not own & (declared | extras):
                    lacking[name] = file.name
                if node in tree.body:
                    always |= own & extras
    assert not lacking and not always
