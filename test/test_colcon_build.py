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

"""The package builds with colcon, and what `ros2 run` needs stands where it looks."""

from __future__ import annotations

from importlib.metadata import Distribution, distributions
import os
from pathlib import Path
import shutil
import subprocess
import sys

from patience import PATIENCE
import pytest

PACKAGE = 'tudor_dynamics'
COPIED = ('config', 'resource', PACKAGE)


@pytest.fixture(scope='module')
def workspace(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Workspace in which the package was built."""
    pytest.importorskip('colcon_core', reason='pip install -e .[test]')
    folder = tmp_path_factory.mktemp('workspace')
    source = folder / 'src' / PACKAGE
    for place in COPIED:
        shutil.copytree(root / place, source / place, ignore=shutil.ignore_patterns('__pycache__'))
    for file in root.iterdir():
        if file.is_file() and not file.name.startswith('.'):
            shutil.copy(file, source)
    code = 'import sys; from colcon_core.command import main; sys.exit(main())'
    build = subprocess.run(
        [sys.executable, '-c', code, '--log-base', 'log', 'build', '--base-paths', 'src',
         '--executor', 'sequential', '--event-handlers', 'console_direct+'],
        cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    assert build.returncode == 0, build.stdout + build.stderr
    return folder


@pytest.fixture(scope='module')
def prefix(workspace: Path) -> Path:
    """Place where the package was installed."""
    return workspace / 'install' / PACKAGE


def installed(prefix: Path) -> Distribution:
    """Metadata of the package in the workspace, not of the one in this environment."""
    places = [str(place) for place in prefix.glob('lib/python3*/site-packages')]
    found = [dist for dist in distributions(path=places)
             if dist.metadata['Name'].replace('-', '_') == PACKAGE]
    assert len(found) == 1, f'{PACKAGE} was not installed once under {prefix}'
    return found[0]


def test_executables(prefix: Path) -> None:
    """Every command of the package is an executable file where `ros2 run` looks."""
    scripts = [point.name for point in installed(prefix).entry_points
               if point.group == 'console_scripts']
    assert 'tudor' in scripts
    for name in scripts:
        assert os.access(prefix / 'lib' / PACKAGE / name, os.X_OK), name


def test_share(root: Path, prefix: Path) -> None:
    """Description, configuration and the entry in ament's index are installed."""
    share = prefix / 'share'
    assert (share / PACKAGE / 'package.xml').is_file()
    assert (share / 'ament_index' / 'resource_index' / 'packages' / PACKAGE).is_file()
    for file in (root / 'config').iterdir():
        copy = share / PACKAGE / 'config' / file.name
        assert copy.read_bytes() == file.read_bytes()


def test_start(workspace: Path, prefix: Path) -> None:
    """After sourcing the workspace the command starts, from the installed copy."""
    executable = prefix / 'lib' / PACKAGE / 'tudor'
    where = f'import {PACKAGE}; print({PACKAGE}.__file__)'
    script = (f'source install/setup.bash && "{executable}" --help && '
              f'"{sys.executable}" -c "{where}"')
    bash = shutil.which('bash')
    assert bash
    run = subprocess.run([bash, '-c', script], cwd=workspace, stdin=subprocess.DEVNULL,
                         capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert 'usage: tudor' in run.stdout
    assert run.stdout.splitlines()[-1].startswith(str(prefix))


def test_ros2_run(workspace: Path, prefix: Path) -> None:
    """
    What `ros2 run` does: the prefix from ament's index, the executable, its ROS arguments.

    Namespace, remapping, the installed parameter file and simulated time; parameters and graph as
    `ros2 node list` and `ros2 param get` see them.
    """
    pytest.importorskip('rclpy')
    from rcl_interfaces.srv import GetParameters
    from ros_world import World
    config = prefix / 'share' / PACKAGE / 'config' / 'nodes.yaml'
    found = ('from ament_index_python.packages import get_package_prefix; '
             f'print(get_package_prefix("{PACKAGE}"))')
    script = (f'source install/setup.bash && at="$("{sys.executable}" -c \'{found}\')" && '
              f'exec "$at/lib/{PACKAGE}/oscillation_damper" --ros-args -r __ns:=/left -r '
              f'velocity_commands:=speeds --params-file "{config}" -p damping:=0.25 '
              '-p use_sim_time:=true -p "arm:=$at/share/tudor_dynamics/config/tudor.yaml"')
    bash = shutil.which('bash')
    assert bash
    world = World()
    process = subprocess.Popen([bash, '-c', script], cwd=workspace, stdin=subprocess.DEVNULL,
                               stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        assert world.spin(lambda: ('oscillation_damper', '/left')
                          in world.probe.get_node_names_and_namespaces(), 60.0)
        damping, simulated, timeout = world.call(
            GetParameters, '/left/oscillation_damper/get_parameters',
            GetParameters.Request(names=['damping', 'use_sim_time', 'timeout'])).values
        assert damping.double_value == 0.25 and simulated.bool_value
        assert timeout.double_value == 0.1
        assert world.spin(lambda: world.probe.count_publishers('/left/speeds') == 1)
        assert world.probe.count_subscribers('/left/joint_states') == 1
    finally:
        process.terminate()
        said, _ = process.communicate(timeout=PATIENCE)
        world.close()
    assert process.returncode == 0, said
