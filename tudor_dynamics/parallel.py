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

"""Pieces of work in threads or processes, by joblib, with the same results."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from functools import partial
import os
from pathlib import Path
import shutil
import signal
from tempfile import TemporaryDirectory
import threading
import time
from typing import Protocol, TypeVar

import numpy as np

from tudor_dynamics.errors import ProcessError
from tudor_dynamics.typing import Progress

# No process outlives the one that began it, also where that was killed and ended nothing itself.

Piece = TypeVar('Piece')
Result = TypeVar('Result')
Count = Callable[[int], None]
"""Called with the number of steps that a piece of work has done since the last call."""

GRACE = 10.0
"""For a worker to end by itself once its parent has gone [s]."""
LOOK = 0.2
"""Time between two looks at the progress, or for the parent [s]."""
STEPS, PROCESS = range(2)
QUIET = 'ignore:resource_tracker:UserWarning'
"""Loky clears away what a killed process has left; a warning of it is of no use to anybody."""


class Workers(Protocol):
    """Other machines, which do pieces of work in place of processes of this one."""

    def width(self) -> int:
        """Give the number of pieces that they do at a time, now."""

    def run(
        self, work: Callable[[Piece, Count], Result], pieces: Sequence[Piece],
        progress: Callable[[int], None],
    ) -> list[Result]:
        """
        Do pieces of work.

        Parameters
        ----------
        work : callable
            Does a piece, and counts its steps; a function of a module.
        pieces : sequence
            Pieces, each of which may be taken several times.
        progress : callable
            Called with the number of steps that all pieces have done.

        Returns
        -------
        list
            What came of each piece, in their order.

        """


_workers: Workers | None = None
_watched = _working = False


@contextmanager
def given_to(others: Workers) -> Iterator[None]:
    """Let the pieces of work that are begun meanwhile go to other machines."""
    global _workers
    _workers = others
    try:
        yield
    finally:
        _workers = None


def workers() -> Workers | None:
    """Give the other machines that do the work; None where it is done here."""
    return _workers


def in_threads(
    work: Callable[[Piece], Result], pieces: Sequence[Piece], jobs: int,
) -> list[Result]:
    """Do pieces of work that leave the interpreter's lock, such as compiled ones."""
    if len(pieces) < 2:
        return [work(piece) for piece in pieces]
    # joblib's threads are looked after every 10 ms, as long as some pieces take
    pool = ThreadPoolExecutor(jobs)
    try:
        return list(pool.map(work, pieces))
    finally:
        pool.shutdown(wait=False, cancel_futures=True)  # after an interrupt, some still compute


def shared_out(
    work: Callable[[Piece, Progress], Result], pieces: Sequence[Piece], progress: Progress,
) -> list[Result]:
    """Do pieces of work that are mostly compiled: in threads, or on other machines."""
    count = len(pieces)
    if count == 1:
        return [work(pieces[0], progress)]
    if _workers is not None:
        return _workers.run(partial(_silently, work), pieces, lambda done: progress(
            f'{done} of {count} searches done'))
    return in_threads(
        lambda k: work(pieces[k], lambda text: progress(f'{text} ({k + 1} of {count})')),
        range(count), len(os.sched_getaffinity(0)))


def _silently(work: Callable[[Piece, Progress], Result], piece: Piece, count: Count) -> Result:
    result = work(piece, lambda _: None)
    count(1)
    return result


def width(jobs: int) -> int:
    """Say how many pieces are done at a time."""
    return jobs if _workers is None else max(1, _workers.width())


def in_processes(
    work: Callable[[Piece, Count], Result], pieces: Sequence[Piece], jobs: int,
    progress: Callable[[int], None] = lambda _: None,
) -> list[Result]:
    """Do pieces of work in processes, or on other machines."""
    if _workers is not None:
        return _workers.run(work, pieces, progress)
    if min(jobs, len(pieces)) <= 1:
        done: list[int] = []
        results = []
        for piece in pieces:
            results.append(work(piece, done.append))
            progress(sum(done))
        return results
    with TemporaryDirectory(prefix='tudor_') as folder, ThreadPoolExecutor(1) as runner:
        board = np.memmap(Path(folder) / 'board', np.int64, 'w+', shape=(len(pieces), 2))
        future = runner.submit(_run_all, work, pieces, min(jobs, len(pieces)), folder)
        try:
            return _watch(future, board, progress)
        except BaseException:  # else all that is left would be gone through
            while not future.done():  # one may just begin
                for process in set(board[:, PROCESS].tolist()) - {0}:
                    with suppress(ProcessLookupError):
                        os.kill(process, signal.SIGTERM)  # what is half written is removed
                time.sleep(LOOK)
            raise


def _watch(
    future: Future[list[Result]], board: np.memmap, progress: Callable[[int], None],
) -> list[Result]:
    while not future.done():
        wait([future], LOOK)
        progress(int(board[:, STEPS].sum()))
    found = future.result()
    progress(int(board[:, STEPS].sum()))  # also of work that was done before the first look
    return found


def _run_all(
    work: Callable[[Piece, Count], Result], pieces: Sequence[Piece], jobs: int, folder: str,
) -> list[Result]:
    from joblib import delayed, Parallel  # slow to import, and one process needs none of it
    from joblib.externals.loky import get_reusable_executor
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    # An interrupt is the first thread's to handle; processes that begin here inherit that.
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    before = os.environ.get('PYTHONWARNINGS')
    os.environ['PYTHONWARNINGS'] = f'{before},{QUIET}' if before else QUIET
    try:
        return list(Parallel(jobs, backend='loky', batch_size=1, pre_dispatch='all')(
            delayed(_in_worker)(work, piece, folder, row, len(pieces), os.getpid())
            for row, piece in enumerate(pieces)))
    except TerminatedWorkerError:
        msg = 'a process was ended from outside, as the system does where memory runs out'
        raise ProcessError(msg, remedy='use fewer --jobs') from None
    finally:
        get_reusable_executor(jobs).shutdown(wait=True)
        os.environ.pop('PYTHONWARNINGS')
        if before is not None:
            os.environ['PYTHONWARNINGS'] = before


def _in_worker(
    work: Callable[[Piece, Count], Result], piece: Piece, folder: str, row: int, rows: int,
    parent: int,
) -> Result:
    _watch_parent(parent, folder)
    board = np.memmap(Path(folder) / 'board', np.int64, 'r+', shape=(rows, 2))
    board[row, PROCESS] = os.getpid()

    def count(steps: int) -> None:
        board[row, STEPS] += steps

    global _working
    try:
        _working = True
        return work(piece, count)
    except SystemExit:  # the pool would take it for a result and go on with what is left
        os._exit(1)
    finally:
        _working = False
        board[row, PROCESS] = 0


def _watch_parent(parent: int, folder: str) -> None:
    global _watched
    if _watched:
        return
    _watched = True
    signal.signal(signal.SIGTERM, _end)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(LOOK)
        shutil.rmtree(folder, ignore_errors=True)
        os.kill(os.getpid(), signal.SIGTERM)  # what was half written is removed
        time.sleep(GRACE)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _end(*_: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # comes again until the process has ended
    if not _working:  # nothing is half written, and the pool would print what is raised
        os._exit(1)
    raise SystemExit(1)
