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

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from functools import lru_cache
from importlib.metadata import version
from itertools import islice
import os
from pathlib import Path
import re
import shutil
import signal
import sys
from tempfile import TemporaryDirectory
import threading
import time
from typing import Any, TypeVar
import warnings

import numpy as np
from tudor_dynamics.errors import ProcessError, TudorWarning, UsageError
from tudor_dynamics.files import PACKAGE, source_digest
from tudor_dynamics.typing import Progress


# No process outlives the one that began it, also where that was killed and ended nothing itself.

Piece = TypeVar('Piece')
Result = TypeVar('Result')
Count = Callable[[int], None]
"""Called with the number of steps that a piece of work has done since the last call."""

GRACE = 10.0  # for a worker to end by itself once its parent has gone [s]
LOOK = 0.2  # time between two looks at the progress, or for the parent [s]
STEPS, PROCESS = range(2)
QUIET = 'ignore:resource_tracker:UserWarning'
"""Loky clears away what a killed process has left; a warning of it is of no use to anybody."""


_cluster: Cluster | None = None  # other machines that do the work; None where it is done here
_watched = _working = False


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


def shared_out(pieces: Sequence[Callable[[Progress], Result]], progress: Progress) -> list[Result]:
    """Do pieces of work that are mostly compiled: in threads, or on other machines."""
    count = len(pieces)
    if count == 1:
        return [pieces[0](progress)]
    if _cluster is not None:
        return _cluster.run(_silently, pieces, lambda done: progress(
            f'{done} of {count} searches done'))
    return in_threads(
        lambda k: pieces[k](lambda text: progress(f'{text} ({k + 1} of {count})')),
        range(count), len(os.sched_getaffinity(0)))


def _silently(piece: Callable[[Progress], Result], count: Count) -> Result:
    result = piece(lambda _: None)
    count(1)
    return result


def width(jobs: int) -> int:
    """Say how many pieces are done at a time."""
    return jobs if _cluster is None else max(1, _cluster.width())


def in_processes(
    work: Callable[[Piece, Count], Result], pieces: Sequence[Piece], jobs: int,
    progress: Callable[[int], None] = lambda _: None,
) -> list[Result]:
    """Do pieces of work in processes, or on other machines."""
    if _cluster is not None:
        return _cluster.run(work, pieces, progress)
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
    done, ended = 0, False
    while not ended:
        ended = bool(wait([future], LOOK).done)
        if done < (now := int(board[:, STEPS].sum())):
            progress(done := now)
    return future.result()


def _run_all(
    work: Callable[[Piece, Count], Result], pieces: Sequence[Piece], jobs: int, folder: str,
) -> list[Result]:
    from joblib import delayed, Parallel  # slow to import, and one process needs none of it
    from joblib.externals.loky import get_reusable_executor
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    # An interrupt is the first thread's to handle; processes that begin here inherit that.
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    before = os.environ.get('PYTHONWARNINGS', '')
    os.environ['PYTHONWARNINGS'] = f'{before},{QUIET}'.strip(',')
    try:
        return list(Parallel(jobs, backend='loky', batch_size=1, pre_dispatch='all')(
            delayed(_in_worker)(work, piece, folder, row, len(pieces), os.getpid())
            for row, piece in enumerate(pieces)))
    except TerminatedWorkerError:
        msg = 'a worker process was ended from outside, as happens when memory runs out'
        raise ProcessError(msg, remedy='use fewer jobs') from None
    finally:
        get_reusable_executor(jobs).shutdown(wait=True)
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
    sys.unraisablehook = lambda _: None  # where a callback of numba takes what is raised
    if not _working:  # nothing is half written, and the pool would print what is raised
        os._exit(1)
    raise SystemExit(1)


ADDRESS = re.compile(r'(tcp|tls|ws|wss)://(\[[0-9a-fA-F:.]+\]|[^\s/:\[\]]+):\d{1,5}')
TIMEOUT = 10.0  # for a scheduler to answer [s]
AHEAD = 4  # pieces that are under way, for each of the cluster's threads
LIBRARIES = ('numpy', 'scipy', 'numba', 'pin')
"""What results depend on, besides the package itself."""


@contextmanager
def on_cluster(address: str | None) -> Iterator[None]:
    """
    Let the pieces of work that are begun meanwhile go to a cluster.

    Parameters
    ----------
    address : str or None
        Of a Dask scheduler, such as ``tcp://10.0.0.1:8786``; None for this machine alone.

    Raises
    ------
    UsageError
        If no scheduler answers there, or Dask is not installed.

    """
    global _cluster
    if address is None:
        yield
        return
    if not ADDRESS.fullmatch(address):
        raise UsageError(f'cluster= {address}: not the address of a Dask scheduler', remedy='give '
                         'one such as tcp://10.0.0.1:8786')
    try:
        from distributed import Client
    except ImportError:
        raise UsageError('a cluster needs the package distributed', remedy='install '
                         'tudor_dynamics[cluster], here and on all machines') from None
    try:
        client = Client(address, timeout=TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as err:
        raise UsageError(f'no cluster answers on {address} ({err})', remedy='start its scheduler '
                         'by `dask scheduler`, and give the address that it prints') from None
    _cluster = Cluster(client)
    try:
        if not _cluster.width():
            warnings.warn(f'cluster {address} has no workers yet; waiting for some: start them '
                          f'with `dask worker {address}`', TudorWarning, stacklevel=3)
        yield
    finally:
        _cluster = None
        client.close()


def elsewhere() -> bool:
    """Say whether other machines may do the work."""
    return _cluster is not None


class Cluster:
    """The workers of a scheduler, which work in place of processes of this machine."""

    def __init__(self, client: Any) -> None:
        self.client = client

    def width(self) -> int:
        """Give the number of pieces that they do at a time, now."""
        return sum(self.client.nthreads().values())

    def run(
        self, work: Callable[[Piece, Count], Result], pieces: Iterable[Piece],
        progress: Callable[[int], None],
    ) -> list[Result]:
        """
        Do pieces of work, a function of a module and counting its steps; results in their order.

        A piece is taken when its turn comes, more than once where a worker is lost; ``progress``
        gets the steps that all pieces have done.
        """
        from distributed import as_completed, KilledWorker
        known, steps = versions(), 0
        results: dict[int, Result] = {}
        running: dict[Any, int] = {}
        done, waiting = as_completed(loop=self.client.loop), enumerate(pieces)
        try:
            while True:
                # a piece may be large: no more than a few are on their way
                room = AHEAD * (1 + self.width()) - len(running)
                for number, piece in islice(waiting, max(room, 0)):
                    future = self.client.submit(_piece, work, piece, known, pure=False)
                    running[future] = number
                    done.add(future)
                if not running:
                    return [results[number] for number in range(len(results))]
                future = next(done)
                results[running.pop(future)], more = future.result()
                steps += more
                progress(steps)
        except KilledWorker:
            raise ProcessError('several workers died, one after the other, at the same task',
                               remedy='check that they have enough memory') from None
        except (CancelledError, OSError) as err:
            raise ProcessError(f'the cluster does not answer any more ({err})', remedy='start it '
                               'and this command again') from None
        finally:
            self.client.cancel([future for future in running if not future.done()])


@lru_cache
def versions() -> dict[str, str]:
    """Give the versions that results depend on: of the package, by its sources, and of others."""
    rooms = tuple(sorted(folder.name for folder in PACKAGE.iterdir()
                         if (folder / '__init__.py').exists()))
    return {'tudor_dynamics': source_digest(rooms), **{name: version(name) for name in LIBRARIES}}


def _piece(
    work: Callable[[Piece, Count], Result], piece: Piece, known: dict[str, str],
) -> tuple[Result, int]:
    own = versions()
    other = [f'{name} {own[name]}, here {value}' for name, value in known.items()
             if own[name] != value]
    if other:
        raise ProcessError(f'a worker has other versions: {"; ".join(other)}', remedy='install '
                           'the same versions on all machines, and start the workers again')
    steps: list[int] = []
    return work(piece, steps.append), sum(steps)
