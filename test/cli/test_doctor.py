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

"""``tudor doctor``: each thing that is missing is named, and what to do."""

from __future__ import annotations

import json
from pathlib import Path
import shutil
from subprocess import SubprocessError
import time
from types import SimpleNamespace

import pytest
from tudor_dynamics.cli import doctor
from tudor_dynamics.cli.main import main


@pytest.fixture(autouse=True)
def sound(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Let the machine have all that is needed."""
    for name in ('ROS_DISTRO', 'ROS_DOMAIN_ID', 'ROS_LOCALHOST_ONLY'):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv('ROS_HOME', str(tmp_path / 'new' / 'ros'))
    monkeypatch.setattr('os.getloadavg', lambda: (0.1, 0.1, 0.1))
    monkeypatch.setattr(doctor, 'find_spec', lambda name: object())
    machine(monkeypatch)
    return tmp_path


def machine(
    monkeypatch: pytest.MonkeyPatch, clock: str = 'Normal', heard: str = '{}',
) -> None:
    """Let other programs say whether the clock is synchronised, and what topics were heard."""
    monkeypatch.setattr(doctor, 'subprocess', SimpleNamespace(
        SubprocessError=SubprocessError, run=lambda call, **_: SimpleNamespace(
            stdout=heard if 'live_topics' in call else f'Leap status : {clock}')))


def test_a_sound_machine(sound: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing to do is the first line; folders that will be made need not be there."""
    assert main(['doctor']) == 0
    said = capsys.readouterr().out
    assert said.startswith('nothing to do\n') and 'synchronised' in said
    assert all(len(line) <= 80 or len(line.split()) == 1 for line in said.splitlines())
    assert not (sound / 'new').exists()
    assert main(['doctor', '-v']) == 0
    assert 'ROS_HOME' in capsys.readouterr().out and 'ROS_HOME' not in said
    assert main(['doctor', '--json']) == 0
    content = json.loads(capsys.readouterr().out)
    assert content['made']['version'] and all(not item['remedy'] for item in content['checks'])


def test_the_middleware_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    """That which is in use, also where no variable says it."""
    monkeypatch.delenv('RMW_IMPLEMENTATION', raising=False)
    monkeypatch.setattr(doctor.subprocess, 'run', lambda call, **_: SimpleNamespace(
        stdout='{}' if 'live_topics' in call else 'rmw_a\n'))
    main(['doctor'])
    assert 'middleware: rmw_a\n' in capsys.readouterr().out


@pytest.mark.parametrize('name, value, said', [
    ('ROS_DISTRO', 'humble', 'only jazzy'),
    ('ROS_DOMAIN_ID', '102', 'ROS_DOMAIN_ID'),
    ('ROS_DOMAIN_ID', '-1', 'ROS_DOMAIN_ID'),
    ('ROS_LOCALHOST_ONLY', '1', 'unset ROS_LOCALHOST_ONLY')])
def test_surroundings(
    name: str, value: str, said: str, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Variables that keep nodes apart, or of another ROS."""
    monkeypatch.setenv(name, value)
    assert main(['doctor']) == 1
    first, line, *_ = capsys.readouterr().out.splitlines()
    assert first == 'to do:' and said in line


def remedies(capsys: pytest.CaptureFixture[str]) -> dict[str, str]:
    """Give what is to be done, by what was looked at."""
    assert main(['doctor', '--json']) == 1
    return {item['name']: item['remedy'] for item in json.loads(capsys.readouterr().out)['checks']
            if item['remedy']}


def test_what_the_machine_lacks(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    """ROS, a clock that is set and synchronised, idle cores, rights, space."""
    monkeypatch.setattr(doctor, 'find_spec', lambda name: None)
    assert list(remedies(capsys)) == ['ROS 2']
    monkeypatch.setattr(doctor, 'find_spec', lambda name: object())
    machine(monkeypatch, clock='Not synchronised')
    assert 'chrony' in remedies(capsys)['clock']
    monkeypatch.setattr(doctor.time, 'localtime', lambda: time.gmtime(0))
    assert 'set the clock' in remedies(capsys)['clock']
    monkeypatch.setattr('os.getloadavg', lambda: (999.0, 0.1, 0.1))
    assert 'late' in remedies(capsys)['processor']
    monkeypatch.setattr(shutil, 'disk_usage', lambda path: SimpleNamespace(free=10**9))
    assert '1.3 GB' in remedies(capsys)['space for them']


def test_folders_are_written_to(
    sound: Path, small_disk: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A full disk, and a file where a folder should be, are found by writing; no file is left."""
    monkeypatch.setenv('ROS_HOME', str(small_disk / 'ros'))
    found = main(['doctor', '--json']), json.loads(capsys.readouterr().out)['checks']
    assert [item['found'] for item in found[1] if item['name'] == 'bags of events'] == [
        str(small_disk / 'ros' / 'tudor_dynamics' / 'events')]
    assert not list(small_disk.iterdir())
    (small_disk / 'rest').write_bytes(bytes(shutil.disk_usage(small_disk).free))
    said = remedies(capsys)
    assert '(No space left on device): set ROS_HOME' in said['bags of events']
    assert 'events need up to 1.3 GB there' in said['space for them']
    monkeypatch.setenv('ROS_HOME', str(small_disk / 'rest'))
    assert '(Not a directory)' in remedies(capsys)['bags of events']
    assert [path.name for path in small_disk.iterdir()] == ['rest']


@pytest.mark.parametrize(('programs', 'kernel', 'said', 'todo'), [
    ({}, 0, ', synchronised', False), ({}, 5, ', not synchronised', True),
    ({}, -1, 'see `chronyc tracking`', False), ({}, None, 'see `chronyc tracking`', False),
    ({'chronyc': 'Stratum : 3\nLeap status     : Normal\n'}, 5, ', synchronised', False),
    ({'chronyc': 'Leap status     : Not synchronised\n'}, 0, ', not synchronised', True),
    ({'chronyc': 'a daemon that says nothing of it'}, 5, ', not synchronised', True)])
def test_who_knows_of_the_clock(
    programs: dict[str, str], kernel: int | None, said: str, todo: bool,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    """Chrony, otherwise the kernel; where nobody answers, how to find out."""
    def program(call: tuple[str, ...], **_: object) -> SimpleNamespace:
        if call[0] == 'chronyc' and call[0] not in programs:
            raise FileNotFoundError(call[0])
        return SimpleNamespace(stdout=programs.get(call[0], '{}'))
    monkeypatch.setattr(doctor.subprocess, 'run', program)
    monkeypatch.setattr(doctor.ctypes, 'CDLL', lambda name: SimpleNamespace(
        **{} if kernel is None else {'adjtimex': lambda given: kernel}))
    assert main(['doctor', '--json']) == todo
    clock, = (item for item in json.loads(capsys.readouterr().out)['checks']
              if item['name'] == 'clock')
    assert said in clock['found'] and bool(clock['remedy']) == todo


def test_the_kernel_answers() -> None:
    """The call is one that Linux has; in a container it may be forbidden."""
    assert doctor.ctypes.CDLL(None).adjtimex(doctor.ctypes.create_string_buffer(256)) in range(
        -1, 6)


FINE = {'publishers': 1, 'rate': 500.0, 'gap': 0.004, 'age': 0.002}


@pytest.mark.parametrize(('changed', 'said'), [
    ({}, ''), ({'age': 4e7}, ''), ({'rate': 2.0, 'gap': 0.6}, ''),
    ({'publishers': 2}, 'stop all but one'), ({'publishers': 0}, 'start its driver'),
    ({'rate': 0.0}, 'see whether that node runs'), ({'gap': 0.4}, '0.4 s without a message'),
    ({'age': 3.2}, 'stamps are 3.2 s old'), ({'age': -0.5}, 'stamps are 0.5 s ahead')])
def test_live_topics(
    changed: dict[str, float], said: str, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Each fault of a stream has its remedy; slow streams and stamps of bags have none."""
    machine(monkeypatch, heard=json.dumps({'/joint_states': {**FINE, **changed}}))
    assert main(['doctor', '--json']) == bool(said)
    last = json.loads(capsys.readouterr().out)['checks'][-1]
    assert last['name'] == '/joint_states' and said in last['remedy']
    assert bool(said) == bool(last['remedy'])


def test_ros_that_does_not_run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    """A process that fails is a finding, not an error of the command."""
    machine(monkeypatch, heard='Segmentation fault')
    assert 'rclpy does not run' in remedies(capsys)['live topics']
