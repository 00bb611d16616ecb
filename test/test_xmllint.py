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

"""XML files: well-formed, and package.xml as REP 149 wants it."""

from __future__ import annotations

from configparser import ConfigParser
from pathlib import Path
import re
import shutil
import subprocess
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[1]
FILES = ['package.xml',
         *sorted(f'config/{file.name}' for file in (ROOT / 'config').glob('*.urdf'))]

KEYLESS = 'lazy_loader', 'llvmlite', 'markupsafe', 'plotly'
# Where the name on PyPI is not that of the rosdep key after "python3-".
KEYS = {'backports.zstd': 'python3-rosbags-pip', 'pin': 'pinocchio', 'pyyaml': 'python3-yaml',
        'rosbags': 'python3-rosbags-pip'}


@pytest.mark.linter
@pytest.mark.parametrize('name', FILES)
def test_well_formed(name: str) -> None:
    """Each XML file can be parsed; xmllint agrees where it is there."""
    ElementTree.parse(ROOT / name)
    if xmllint := shutil.which('xmllint'):
        run = subprocess.run([xmllint, '--noout', '--nonet', str(ROOT / name)],
                             capture_output=True, text=True)
        assert run.returncode == 0, run.stderr


@pytest.mark.linter
def test_package_xml() -> None:
    """catkin_pkg, which rosdep, colcon and bloom use, has nothing to say against package.xml."""
    package_module = pytest.importorskip('catkin_pkg.package', reason='comes with colcon-ros')
    warnings: list[str] = []
    package = package_module.parse_package(str(ROOT / 'package.xml'), warnings=warnings)
    assert not warnings
    assert package.package_format == 3
    assert package.get_build_type() == 'ament_python'


@pytest.mark.linter
def test_same_dependencies() -> None:
    """What pip installs for a user, rosdep installs too."""
    config = ConfigParser()
    config.read(ROOT / 'setup.cfg', encoding='utf-8')
    lines = config['options']['install_requires'].split()
    names = [re.split(r'[<>=\[]', line)[0] for line in lines]
    wanted = {KEYS.get(name, f'python3-{name}') for name in names if name not in KEYLESS}
    tree = ElementTree.parse(ROOT / 'package.xml')
    found = {element.text for element in tree.findall('exec_depend')}
    assert wanted <= found
