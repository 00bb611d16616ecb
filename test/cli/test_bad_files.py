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

"""A bad file gives one line and exit code 2, in bounded time and memory, whatever it holds."""

from __future__ import annotations

from collections.abc import Callable
import json
import os
from pathlib import Path
import re
import sqlite3
import subprocess
import sys
from typing import Any

from backports import zstd
from bag_making import joint_states, JOINTS, make_bag
import mcap_records as mcap
import pytest
from tudor_dynamics.cli.main import main
import yaml

MAX_SECONDS, MAX_BYTES = 10.0, 500_000_000
RUNNER = """
import contextlib, io, json, os, resource, sys, time
from tudor_dynamics.cli.main import main

def peak():
    with contextlib.suppress(OSError):
        with open('/proc/self/status') as file:
            return 1024 * int(file.read().partition('VmHWM:')[2].split()[0])
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

for words in json.load(sys.stdin):
    with contextlib.suppress(OSError):  # begin the peak of memory anew, where Linux can
        open('/proc/self/clear_refs', 'w').write('5')
    out, err = io.StringIO(), io.StringIO()
    begun = time.process_time()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(words)
        except SystemExit as end:
            code = end.code
        except BaseException as error:
            code = repr(error)
    print(json.dumps([code, out.getvalue(), err.getvalue(), time.process_time() - begun,
                      peak()]), flush=True)
"""
ARM = {'name': 'pair', 'kinematics': {'dh': [[0.4, 0, 0, 0], [0.4, 0, 0, 0]]},
       'joints': [{'name': name} for name in JOINTS]}
LINK = '<link name="l{0}"/>'
JOINT = ('<joint name="j{0}" type="fixed"><parent link="l{0}"/><child link="l{1}"/></joint>')


def references(first: str, line: str) -> str:
    """Let each line stand for nine times what the line before stands for."""
    lines = [f'a0: &a0 {first}']
    lines += [f'a{i + 1}: &a{i + 1} ' + line.format(', '.join([f'*a{i}'] * 9)) for i in range(9)]
    return '\n'.join(lines)


def pipe(path: Path) -> Path:
    """Make a pipe that nobody writes to."""
    os.mkfifo(path)
    return path


def bomb(path: Path) -> Path:
    """Write an MCAP file with a chunk that unpacks to four gigabytes."""
    content = (make_bag(path) / f'{path.name}.mcap').read_bytes()
    packed = zstd.compress(bytes(1 << 24)) * 256
    chunk = mcap.close_chunk(bytes(16), '', b'')[:24] + b'\0\0\0\0\4\0\0\0zstd'
    chunk += len(packed).to_bytes(8, 'little') + packed
    data, _ = mcap.sections(content)
    data = [(kind, chunk if kind == mcap.CHUNK else body) for kind, body in data]
    (path / f'{path.name}.mcap').write_bytes(mcap.build(data, []))
    return path


def computed(path: Path) -> Path:
    """Write a database whose messages are computed: nearly a gigabyte each."""
    connection = sqlite3.connect(path)
    connection.execute('CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, '
                       'serialization_format)')
    connection.execute("INSERT INTO topics VALUES (1, '/joint_states', "
                       "'sensor_msgs/msg/JointState', 'cdr')")
    connection.execute('CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, '
                       'data BLOB GENERATED ALWAYS AS (zeroblob(900000000)) VIRTUAL)')
    connection.executemany('INSERT INTO messages VALUES (?, 1, 1)', [(i,) for i in range(9)])
    connection.commit()
    connection.close()
    return path


def written(path: Path, text: str) -> Path:
    """Write text."""
    path.write_text(text, encoding='utf-8')
    return path


def with_urdf(path: Path, urdf: str) -> Path:
    """Describe an arm by a URDF, given as text or as the place of a file."""
    if '<' in urdf:
        written(path.with_suffix('.urdf'), urdf)
        urdf = path.with_suffix('.urdf').name
    return written(path, yaml.safe_dump({**ARM, 'kinematics': {'urdf': urdf}}))


def chain(links: int) -> str:
    """Describe a chain of links."""
    parts = [LINK.format(i) for i in range(links)]
    parts += [JOINT.format(i, i + 1) for i in range(links - 1)]
    return f'<robot name="r">{"".join(parts)}</robot>'


def simulate(path: Path) -> list[object]:
    """Give the words that simulate an arm."""
    return ['simulate', path, '--modes', '1']


Make = Callable[[Path], list[Any]]
CASES: dict[str, tuple[Make, str]] = {
    'zstd chunk': (lambda p: ['info', bomb(p / 'b')], 'unpacks to'),
    'computed messages': (lambda p: ['info', computed(p / 'a.db3')], 'compute what they hold'),
    'pipe for a bag': (lambda p: ['info', pipe(p / 'a.mcap')], 'not a bag'),
    'device for a bag': (lambda p: ['info', '/dev/zero'], 'not a bag'),
    'device for a table': (
        lambda p: ['simulate', 'config/single_flexible_link.yaml', '--json', '--motion',
                   '/dev/zero'], 'pipe or socket, not a file'),
    'pipe for an arm': (lambda p: simulate(pipe(p / 'a.yaml')), 'pipe or socket, not a file'),
    'device for an arm': (lambda p: simulate(Path('/dev/zero')), 'pipe or socket, not a file'),
    'references': (lambda p: simulate(written(p / 'a.yaml', references('[1]', '[{}]'))),
                   'more than 300000 values'),
    'merge keys': (
        lambda p: simulate(written(p / 'a.yaml', references('{x: 1}', '{{<<: [{}]}}'))),
        'more than 300000 values'),
    'number': (lambda p: simulate(written(p / 'a.yaml', 'a: ' + '1:' * 300_000 + '1')),
               'a number of more than'),
    'depth': (lambda p: simulate(written(p / 'a.yaml', '- ' * 300_000)), 'more than 50 levels'),
    'device for a URDF': (lambda p: simulate(with_urdf(p / 'a.yaml', '/dev/zero')),
                          'pipe or socket, not a file'),
    'pipe for a URDF': (lambda p: simulate(with_urdf(p / 'a.yaml', str(pipe(p / 'a.urdf')))),
                        'pipe or socket, not a file'),
    'chain': (lambda p: simulate(with_urdf(p / 'a.yaml', chain(20_000))), 'at most 1000'),
    'nested XML': (lambda p: simulate(with_urdf(p / 'a.yaml', '<a>' * 300_000)),
                   '51 levels'),
    'pipe for torques': (
        lambda p: ['simulate', 'config/single_flexible_link.yaml', '--json', '--torque',
                   pipe(p / 'a.csv')], 'pipe or socket, not a file'),
    'pipe for a model': (
        lambda p: ['evaluate', '--model', pipe(p / 'm').parent, 'x'], 'cannot be read'),
}


@pytest.fixture(scope='module')
def answers(tmp_path_factory: pytest.TempPathFactory, root: Path) -> dict[str, list]:
    """Run all commands in one process, which is what takes time: it loads the modules once."""
    # compiling what has not been compiled yet takes memory that no file is to blame for
    subprocess.run([sys.executable, '-m', 'tudor_dynamics', 'simulate', '--torque', '0',
                    '--seconds', '0.01', '--json', 'config/single_flexible_link.yaml'], cwd=root,
                   timeout=600, stdout=subprocess.DEVNULL, check=True)
    words = [[str(word) for word in make(tmp_path_factory.mktemp('bad'))]
             for make, _ in CASES.values()]
    done = subprocess.run([sys.executable, '-c', RUNNER], input=json.dumps(words), text=True,
                          cwd=root, stdout=subprocess.PIPE, timeout=600, check=True)
    return dict(zip(CASES, map(json.loads, done.stdout.splitlines()), strict=True))


@pytest.mark.parametrize('name', CASES)
def test_bad_file(answers: dict[str, list], name: str) -> None:
    """One line with the cause, exit code 2, little time and memory."""
    code, out, err, seconds, memory = answers[name]
    err = re.sub(r'(?m)^\d+ s: .*\n', '', err)  # progress, after 3 s on a busy machine
    assert code == 2, err
    assert out == '' and err.count('\n') == 1 and len(err) < 600
    assert CASES[name][1] in err
    assert seconds < MAX_SECONDS and memory < MAX_BYTES


def test_samples_that_would_overflow(
    tmp_path: Path, root: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """A sample of 1e154, whose square is no number, is left out with a warning."""
    effort = joint_states().values['effort'].copy()
    effort[150, 0] = 1e154
    bag = make_bag(tmp_path / 'b', joint_states(effort=effort))
    arm = written(tmp_path / 'arm.yaml', yaml.safe_dump(ARM))
    code = main(['fit', str(bag), '--arm', str(arm), '--out', str(tmp_path / 'm'), '--json'])
    captured = capsys.readouterr()
    assert code in (0, 1) and 'Traceback' not in captured.err
    assert "NaN or infinite or beyond 1e+12 for 'shoulder' (in 1 of 300 samples), " in captured.err
    assert json.loads(captured.out)['effort']['analytical']['validation']['fit'] > 99.0
