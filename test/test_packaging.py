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
from collections import Counter
from collections.abc import Iterable
from configparser import ConfigParser
from importlib import metadata
import os
from pathlib import Path, PurePath
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
import zipfile

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version
import pytest
from tudor_dynamics._version import __version__

PIP = (sys.executable, '-m', 'pip', '--disable-pip-version-check', '-q')
CONFIG = 'tudor_dynamics/config/two_blade_arm.yaml'
EVERY_MODULE = """
from importlib import import_module, util
from pathlib import Path
from pkgutil import walk_packages
import sys
import tudor_dynamics as td
found = [item.name for item in walk_packages(td.__path__, 'tudor_dynamics.')
         if not item.name.startswith('tudor_dynamics.nodes')]  # which need ROS 2
assert len(found) > 100
for name in found:
    import_module(name)
assert [*td.load_arm(sys.argv[2]).active_joints] == ['joint2', 'joint3']
site = Path(sys.argv[1])
for name in ('tudor_dynamics', 'numpy', 'scipy', 'pinocchio', 'rosbags'):
    assert site in Path(*sys.modules[name].__path__).parents, name
assert not [name for name in ('pytest', 'mypy', 'pandas', 'rclpy') if util.find_spec(name)]
"""
"""Import all in a folder of packages, and read the arm of a file."""


def run(*words: str | Path, cwd: Path, **environment: str) -> str:
    """Run a command; give what it prints."""
    done = subprocess.run([*map(str, words)], cwd=cwd, text=True, capture_output=True,
                          env={**os.environ, **environment}, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope='module')
def wheel(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pack the sources in `tree`, and make a wheel of the package, in `packed` beside it."""
    folder = tmp_path_factory.mktemp('release')
    tree, packed = folder / 'tree', folder / 'packed'
    shutil.copytree(root, tree, ignore=lambda folder, names: [
        name for name in names if name == '__pycache__' or Path(folder) == root and name not in (
            'tudor_dynamics', 'config', 'resource', 'setup.py', 'setup.cfg', 'package.xml',
            'README.md', 'LICENSE')])
    run(sys.executable, 'setup.py', '-q', 'sdist', '-d', packed, cwd=tree)
    sources, = packed.iterdir()
    run(*PIP, 'wheel', '--no-deps', '--no-build-isolation', '--no-index', '-w', packed, sources,
        cwd=folder)
    made, = packed.glob('*.whl')
    return made


def test_sources_wheel_and_what_is_installed(wheel: Path, tmp_path: Path) -> None:
    """A wheel of the packed sources has every file of the package, and its commands run."""
    tree, installed = wheel.parents[1] / 'tree', tmp_path / 'installed'
    run(*PIP, 'install', '--no-deps', '--no-index', '--no-compile', '--target', installed, wheel,
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


def needed(wheel: Path) -> dict[tuple[str, str], metadata.Distribution]:
    """Give what a wheel says that it needs, and what that needs, by name and extra."""
    name = '-'.join(wheel.name.split('-')[:2])
    own = metadata.PathDistribution(zipfile.Path(wheel, f'{name}.dist-info/'))
    found: dict[tuple[str, str], metadata.Distribution] = {}
    open_ends = [(own, '')]
    while open_ends:
        above, of = open_ends.pop()
        for item in map(Requirement, above.requires or ()):
            if item.marker is not None and not item.marker.evaluate({'extra': of}):
                continue
            for extra in ('', *item.extras):
                key = canonicalize_name(item.name), extra
                if key not in found:
                    found[key] = metadata.distribution(item.name)
                    open_ends.append((found[key], extra))
    return found


def link(wanted: Iterable[metadata.Distribution], site: Path) -> None:
    """Put distributions elsewhere: folders as a whole where nobody else has a file in them."""
    owners = Counter(first for one in metadata.distributions()
                     for first in {file.parts[0] for file in one.files or ()})
    for one in wanted:
        if not one.files:
            pytest.skip(f'{one.name} is from a package of the system, not from a wheel')
        for place in {file if owners[file.parts[0]] > 1 else PurePath(file.parts[0])
                      for file in one.files if not {'..', 'include'} & {*file.parts}}:
            (site / place).parent.mkdir(parents=True, exist_ok=True)
            (site / place).symlink_to(one.locate_file(place))


def test_a_new_environment_needs_only_what_is_declared(
    root: Path, wheel: Path, tmp_path: Path,
) -> None:
    """Beside what setup.cfg declares, and what that needs, there is nothing: all modules come."""
    new = tmp_path / 'new'
    run(sys.executable, '-m', 'venv', '--without-pip', new, cwd=tmp_path)
    site, = new.glob('lib/python3*/site-packages')
    link({one.name: one for one in needed(wheel).values()}.values(), site)
    run(*PIP, 'install', '--no-deps', '--no-index', '--no-compile', '--ignore-installed',
        '--prefix', new, wheel, cwd=tmp_path)

    def alone(*words: str | Path) -> str:
        # nothing is compiled: that takes half a minute
        return run(new / 'bin' / 'python', *words, cwd=tmp_path, PYTHONPATH='',
                   PYTHONNOUSERSITE='1', NUMBA_DISABLE_JIT='1', TUDOR_PLAIN_LANES='1')
    assert alone(new / 'bin' / 'tudor', '--version') == f'tudor_dynamics {__version__}\n'
    assert 'joint2' in alone(new / 'bin' / 'tudor', 'info', root / 'bags' / 'two_blade_test')
    alone('-c', EVERY_MODULE, site, new / 'share' / CONFIG)


@pytest.mark.parametrize(('target', 'compiles'), [('venv', True), ('demo', True), ('test', False)])
def test_what_make_compiles(root: Path, tmp_path: Path, target: str, compiles: bool) -> None:
    """The first command of a new environment finds its inner loops; tests compile their own."""
    said = run('make', '-n', target, f'VENV={tmp_path}', cwd=root)
    assert ('compiling inner loops' in said) == compiles
    assert not compiles or said.index('pip install') < said.index('compiling inner loops')


def test_one_version_everywhere(root: Path) -> None:
    """In the package, package.xml, the newest part of the change log, and the tag of a commit."""
    # package.xml has no candidates of releases: three numbers alone (REP 140)
    assert ET.parse(root / 'package.xml').findtext('version') == Version(__version__).base_version
    released = re.findall(r'^(\S+) \(\d{4}-\d\d-\d\d\)\n-+$',
                          (root / 'CHANGELOG.rst').read_text(), re.MULTILINE)
    assert released[0] == __version__
    assert released == sorted(released, key=Version, reverse=True)
    tags: list[str] = []
    if (root / '.git').exists() and shutil.which('git'):
        tags = subprocess.run(['git', 'tag', '--points-at', 'HEAD'], cwd=root, text=True,
                              capture_output=True, check=False).stdout.split()
    assert [tag for tag in tags if re.match(r'v?\d+\.', tag)] in ([], [__version__])


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
