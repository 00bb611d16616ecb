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
A package ``control_msgs`` with the action of joint trajectory controllers, made in a test.

Wheels of ROS have none; the generators that they bring make one of the same names and fields.
"""

from __future__ import annotations

from collections.abc import Iterator
import ctypes
from importlib.util import find_spec
import os
from pathlib import Path
import shutil
import subprocess
import sys
import sysconfig

import numpy as np
import pytest

TOLERANCE = """string name
float64 position
float64 velocity
float64 acceleration
"""
COMPONENT = """uint16 X_AXIS=1
uint16 Y_AXIS=2
uint16 Z_AXIS=3
uint16 TRANSLATION=4
uint16 ROTATION=5
string joint_name
uint16 component
float64 position
float64 velocity
float64 acceleration
"""
FOLLOW = """trajectory_msgs/JointTrajectory trajectory
trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
JointTolerance[] path_tolerance
JointComponentTolerance[] component_path_tolerance
JointTolerance[] goal_tolerance
JointComponentTolerance[] component_goal_tolerance
builtin_interfaces/Duration goal_time_tolerance
---
int32 SUCCESSFUL=0
int32 INVALID_GOAL=-1
int32 INVALID_JOINTS=-2
int32 OLD_HEADER_TIMESTAMP=-3
int32 PATH_TOLERANCE_VIOLATED=-4
int32 GOAL_TOLERANCE_VIOLATED=-5
int32 error_code
string error_string
---
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
string[] multi_dof_joint_names
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error
"""
GENERATE = """
from importlib import metadata
from pathlib import Path
import sys

import rosidl_cli.entry_points as found
from rosidl_cli.command.generate.api import generate

# wheels list some generators twice, which the command refuses
points = metadata.EntryPoints({(e.group, e.name): e for d in metadata.distributions()
                               for e in d.entry_points if e.group.startswith('rosidl')}.values())
found.importlib_metadata.entry_points = lambda: points
generate(package_name='control_msgs', output_path=Path('out'), types=['c', 'py'],
         interface_files=[f'{Path.cwd()}:msg/JointTolerance.msg',
                          f'{Path.cwd()}:msg/JointComponentTolerance.msg',
                          f'{Path.cwd()}:action/FollowJointTrajectory.action'],
         include_paths=[f'{sys.prefix}/share'],
         typesupports=['c', 'fastrtps_c', 'introspection_c'])
"""
USED = ('action_msgs', 'builtin_interfaces', 'geometry_msgs', 'service_msgs', 'std_msgs',
        'trajectory_msgs', 'unique_identifier_msgs')
LIBRARY = 'lib{}__rosidl_typesupport_{}.so'
# rclpy looks for the first, which stands for the libraries of both names
MODULE = 'control_msgs_s__rosidl_typesupport_c.so'
NAME = 'control_msgs'


def run(folder: Path, *words: str | Path) -> None:
    """Run a command in a folder, and give what it said if it fails."""
    paths = os.pathsep.join(filter(None, [sys.prefix, os.environ.get('AMENT_PREFIX_PATH')]))
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False,
                          env={**os.environ, 'AMENT_PREFIX_PATH': paths})
    assert not done.returncode, done.stdout[-2000:] + done.stderr[-4000:]


def make(folder: Path) -> Path:
    """Generate and compile the package in a folder; gives the folder for ``sys.path``."""
    (folder / 'msg').mkdir()
    (folder / 'action').mkdir()
    (folder / 'msg/JointTolerance.msg').write_text(TOLERANCE)
    (folder / 'msg/JointComponentTolerance.msg').write_text(COMPONENT)
    (folder / 'action/FollowJointTrajectory.action').write_text(FOLLOW)
    run(folder, sys.executable, '-c', GENERATE)
    out, prefix = folder / 'out', Path(sys.prefix)
    for kind in ('c', 'fastrtps_c', 'introspection_c'):  # included as control_msgs/...
        (out / kind).rename(folder / f'{kind}_{NAME}')
        (folder / kind).mkdir()
        (folder / f'{kind}_{NAME}').rename(folder / kind / NAME)
    package = folder / 'python' / NAME
    package.parent.mkdir()
    (out / 'py').rename(package)
    (package / '__init__.py').touch()
    include = [sysconfig.get_paths()['include'], np.get_include(), *map(
        str, [*(folder / kind for kind in ('c', 'fastrtps_c', 'introspection_c')),
              prefix / 'include', *prefix.glob('include/*')])]
    code = [*(folder / 'c').rglob('*.c*'), *(folder / 'fastrtps_c').rglob('*.cpp'),
            *package.rglob('*_s.c'), package / '_control_msgs_s.ep.rosidl_typesupport_c.c']
    kinds = ('rosidl_generator_c', 'rosidl_typesupport_c', 'rosidl_typesupport_fastrtps_c',
             'rosidl_typesupport_introspection_c', 'rosidl_generator_py')
    libraries = [*(f'{name}__{kind}' for name in USED for kind in kinds), 'rosidl_runtime_c',
                 'rosidl_typesupport_c', 'rosidl_typesupport_fastrtps_c',
                 'rosidl_typesupport_fastrtps_cpp', 'rosidl_typesupport_introspection_c',
                 'fastcdr', 'rcutils', 'rmw', 'stdc++']

    def compile_(target: Path, name: str, sources: list[Path], *more: str) -> None:
        run(folder, 'gcc', '-shared', '-fPIC', '-w', '-o', target, f'-Wl,-soname,{name}',
            *(f'-I{path}' for path in include), *sources, *more, f'-L{prefix}/lib',
            f'-Wl,-rpath,{prefix}/lib', *(f'-l{name}' for name in libraries))
    first, second = (LIBRARY.format(NAME, kind) for kind in ('fastrtps_c', 'introspection_c'))
    compile_(package / MODULE, first, code)
    compile_(package / second, second, list((folder / 'introspection_c').rglob('*.c')),
             str(package / MODULE))
    return package.parent


@pytest.fixture(scope='session')
def control_msgs_folder(tmp_path_factory: pytest.TempPathFactory) -> Path | None:
    """Give where the package was made; None where a distribution brings its own."""
    if find_spec(NAME) is not None:
        return None
    if find_spec('rosidl_cli') is None or shutil.which('gcc') is None:
        pytest.skip('neither control_msgs nor the generators and a compiler to make it are here')
    return make(tmp_path_factory.mktemp(NAME))


@pytest.fixture
def control_msgs(control_msgs_folder: Path | None, monkeypatch: pytest.MonkeyPatch,
                 ) -> Iterator[None]:
    """Let the package be imported in a test, and in no other."""
    if control_msgs_folder is None:
        yield
        return
    monkeypatch.syspath_prepend(control_msgs_folder)
    for name in (MODULE, LIBRARY.format(NAME, 'introspection_c')):
        ctypes.CDLL(str(control_msgs_folder / NAME / name))
    yield
    for name in [name for name in sys.modules if name.partition('.')[0] == NAME]:
        del sys.modules[name]
