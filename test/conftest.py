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

"""Settings and fixtures that all tests share."""

from __future__ import annotations

from collections.abc import Iterator
from fcntl import flock, LOCK_EX
import gc
import os
from pathlib import Path
import subprocess
import tempfile

import pytest

ROOT = Path(__file__).resolve().parents[1]

# Before rclpy or matplotlib are imported anywhere.
os.environ.setdefault('MPLBACKEND', 'Agg')
os.environ.setdefault('ROS_PYTHON_CHECK_FIELDS', '1')
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
# Tests kill processes. Shared memory of Fast DDS 2.14 does not always stand that: others lose data
# or crash (eProsima/Fast-DDS issue 5469, pull request 4737), and each that is killed leaves files.
os.environ.setdefault('FASTDDS_BUILTIN_TRANSPORTS', 'UDPv4')
# ROS logs below the home directory otherwise, and there may be none.
os.environ.setdefault('ROS_HOME', str(Path(tempfile.gettempdir()) / f'tudor_home_{os.getuid()}'))
os.environ.setdefault('ROS_LOG_DIR', str(Path(tempfile.gettempdir()) / f'tudor_log_{os.getuid()}'))
for _name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'):
    os.environ.setdefault(_name, '1')

# A domain for each pytest process, so that neither parallel workers nor other runs on this machine
# hear each other. Workers inherit the first number from the process that starts them.
_first = int(os.environ.setdefault('TUDOR_TEST_DOMAIN', str(1 + os.getpid() % 90)))
_worker = os.environ.get('PYTEST_XDIST_WORKER', 'gw0').removeprefix('gw')
os.environ['ROS_DOMAIN_ID'] = str(_first + int(_worker) % 10)

LONGEST = ('test_elastic_search.py', 'test_mypy.py',
           'test_documented_commands.py', 'test_evaluate_collisions.py', 'test_processes.py',
           'test_doctor_bench.py', 'nodes/test_closed_loop.py')
"""What takes longest in one piece begins first, so that no worker is left alone with it. One
compiles while the other has what needs nothing compiled: side by side both would compile the same.
The loop over topics comes after, because it is repeated more slowly where it was held up."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest files first; everything else stays in its order."""
    items.sort(key=lambda item: next((k for k, name in enumerate(LONGEST) if item.path.as_posix(
        ).endswith(name)), len(LONGEST)))


@pytest.hookimpl(hookwrapper=True)
def pytest_collection() -> Iterator[None]:
    """Let the collector of garbage leave alone what stays for good: a million objects."""
    gc.disable()
    yield
    gc.collect()
    gc.freeze()
    gc.enable()


@pytest.fixture(scope='module', autouse=True)
def few_objects() -> Iterator[None]:
    """Let it leave alone, too, what a file of tests has imported: a tenth of the time of nodes."""
    yield
    gc.collect()
    gc.freeze()


@pytest.fixture(scope='session')
def root() -> Path:
    """Root of the repository."""
    return ROOT


@pytest.fixture(scope='session')
def shared_data() -> Path:
    """Give the folder of recordings beside the checkout; skip the test where it is absent."""
    folder = Path(os.environ.get('TUDOR_SHARED_DATA', ROOT.parent / 'shared' / 'data'))
    if not folder.is_dir():
        pytest.skip(f'no recordings in {folder}; TUDOR_SHARED_DATA names another folder')
    return folder


@pytest.fixture(scope='session')
def two_blades(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fit the sample bags, once for all workers; the others wait, and take what is there."""
    return fitted_once('two_blades', [root / f'bags/two_blade_train_{k}' for k in (1, 2)],
                       tmp_path_factory)


@pytest.fixture(scope='session')
def laboratory(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fit three recordings of 80 s of the same arm, as `two_blades`."""
    return fitted_once('laboratory', [shared_data / f'bags/arm_200g_free_{k}' for k in (1, 2, 3)],
                       tmp_path_factory)


def fitted_once(name: str, bags: list[Path], factory: pytest.TempPathFactory) -> Path:
    """Fit bags of the two-blade arm in the first worker that asks."""
    import tudor_dynamics as td
    own = factory.getbasetemp()
    folder = own.parent if own.name.startswith('popen-') else own  # of all workers
    with (folder / f'{name}.lock').open('w') as file:
        flock(file, LOCK_EX)
        if not (folder / name).exists():  # written as a whole, or not at all
            td.fit(bags, td.load_arm(ROOT / 'config/two_blade_arm.yaml'), out=folder / name,
                   settings=td.FitSettings(kinds=('analytical',)))
    return folder / name


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """Give a directory on a disk of 256 kB; skip the test where nothing may be mounted."""
    place = tmp_path / 'disk'
    place.mkdir()
    try:
        done = subprocess.run(
            ['mount', '-t', 'tmpfs', '-o', 'size=256k', 'tmpfs', str(place)],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
        failed = done.stdout.strip() if done.returncode else ''
    except OSError as err:
        failed = str(err)
    if failed:
        pytest.skip(f'a full disk needs the right to mount one ({failed})')
    yield place
    subprocess.run(['umount', str(place)], check=True)
