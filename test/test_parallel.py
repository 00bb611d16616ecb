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

"""Pieces of work in threads and processes: what runs them makes no difference."""

from __future__ import annotations

from concurrent.futures import Future
from functools import partial
from pathlib import Path
import re
import subprocess
import sys
from threading import Timer
import time

import numpy as np
from patience import PATIENCE
from piece_making import killed, spelled, square
import pytest

from tudor_dynamics.errors import BagError, ProcessError
from tudor_dynamics.parallel import _watch, in_processes, in_threads, LOOK, shared_out


@pytest.mark.parametrize('jobs', [1, 2])
def test_pieces_keep_their_order(jobs: int) -> None:
    """Results and the last count are the same, whatever ran the pieces."""
    counts: list[int] = []
    assert in_processes(square, range(1, 6), jobs, counts.append) == [1, 4, 9, 16, 25]
    assert counts[-1] == 15 and counts == sorted(counts)
    assert in_threads(lambda piece: piece**2, range(1, 6), jobs) == [1, 4, 9, 16, 25]


def test_work_that_waits_is_not_counted_again(tmp_path: Path) -> None:
    """Progress is told as pieces are done, not at each look."""
    future: Future[list[int]] = Future()
    board = np.memmap(tmp_path / 'board', np.int64, 'w+', shape=(1, 2))
    board[0, 0] = 7
    Timer(4 * LOOK, future.set_result, [[1]]).start()
    counts: list[int] = []
    assert _watch(future, board, counts.append) == [1] and counts == [7]


def test_pieces_say_what_they_do() -> None:
    """Which of several a word is of is told; one alone speaks for itself."""
    said: list[str] = []
    found = shared_out([partial(spelled, 'ab'), partial(spelled, 'cd')], said.append)
    assert found == ['a b', 'c d']
    assert sorted(said) == ['spelling ab (1 of 2)', 'spelling cd (2 of 2)']
    assert shared_out([partial(spelled, 'ef')], said.append) == ['e f']
    assert said[-1] == 'spelling ef'


def test_work_that_is_done_before_the_first_look_is_counted(tmp_path: Path) -> None:
    """Progress reaches its end, however quick the work was."""
    future: Future[list[int]] = Future()
    future.set_result([1])
    board = np.memmap(tmp_path / 'board', np.int64, 'w+', shape=(1, 2))
    board[0, 0] = 7
    counts: list[int] = []
    assert _watch(future, board, counts.append) == [1] and counts == [7]


@pytest.mark.parametrize('jobs', [1, 2])
def test_errors_of_pieces_arrive(jobs: int) -> None:
    """The error of a piece comes out as it was raised, with its attributes."""
    with pytest.raises(BagError, match='^-1: negative; give another$') as caught:
        in_processes(square, [1, -1, 2], jobs)
    assert caught.value.place == '-1'


def test_a_killed_worker_is_told() -> None:
    """One line says what to do, and other work goes on."""
    with pytest.raises(ProcessError, match='ended from outside.*; use fewer jobs'):
        in_processes(killed, [1, 2], 2)
    assert in_processes(square, [1, 2], 2) == [1, 4]


def children(pid: int) -> list[int]:
    """Give the processes that another has begun."""
    return [int(word) for task in Path(f'/proc/{pid}/task').iterdir()
            for word in (task / 'children').read_text().split()]


def alive(pid: int) -> bool:
    """Say whether a process is there, and more than a body that nobody has buried."""
    try:
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except OSError:
        return False


@pytest.mark.skipif(not Path('/proc/self/task').is_dir(), reason='processes are seen in /proc')
def test_a_worker_that_compiles_ends_in_silence(root: Path) -> None:
    """What ends it is raised in a callback of numba as well, which would print it."""
    program = ('from ctypes import CFUNCTYPE; from tudor_dynamics import parallel; '
               'parallel._working = True; CFUNCTYPE(None)(parallel._end)()')
    done = subprocess.run([sys.executable, '-c', program], cwd=root, text=True,
                          capture_output=True, check=False)
    assert (done.stdout, done.stderr) == ('', '')


def test_workers_end_with_their_parent(root: Path, tmp_path: Path) -> None:
    """Killed, a recording leaves neither workers nor anything half written, nor says a word."""
    errors = (tmp_path / 'errors').open('w+')
    process = subprocess.Popen(
        [sys.executable, '-m', 'tudor_dynamics', 'record', '--arm', 'config/tudor.yaml',
         '--stimuli', '4', '--seconds', '3000', '--jobs', '2', '--out', str(tmp_path / 'out')],
        cwd=root, stdout=subprocess.DEVNULL, stderr=errors)
    begun: list[int] = []
    deadline = time.monotonic() + PATIENCE
    # two workers beside the tracker of what they share; and at work, with all modules loaded
    while sum('numba' in Path(f'/proc/{pid}/maps').read_text() for pid in begun) < 2:
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.1)
        begun = children(process.pid)
    process.kill()
    process.wait()
    while any(alive(pid) for pid in begun):
        assert time.monotonic() < deadline + PATIENCE
        time.sleep(0.05)
    assert not (tmp_path / 'out').exists() or list((tmp_path / 'out').iterdir()) == []
    with errors:
        errors.seek(0)
        assert not [line for line in errors if not re.match(r'compiling functions|\d+ s: ', line)]
