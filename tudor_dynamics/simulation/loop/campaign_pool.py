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

"""Many recordings at a time; the number of processes makes no difference to the bags."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
import multiprocessing
from multiprocessing import connection
import os
from pathlib import Path
import signal
import threading
import time
from typing import Any

from tudor_dynamics.arm import load_arm
from tudor_dynamics.simulation.loop.campaign import record_stimulus, StimulusResult, StimulusSpec

GRACE = 10.0
"""For a worker to end by itself once its parent has gone [s]."""

_done: Any = None  # steps done in all processes, shared


def _begin(counter: Any) -> None:
    global _done
    _done = counter


def _begin_worker(counter: Any) -> None:
    _begin(counter)
    signal.signal(signal.SIGTERM, _end)
    threading.Thread(target=_watch_parent, daemon=True).start()


def _end(*_: object) -> None:
    raise SystemExit(1)


def _watch_parent() -> None:
    """End with the process that began this one, also where that was killed and told nobody."""
    parent = multiprocessing.parent_process()
    assert parent is not None  # this runs in a child
    connection.wait([parent.sentinel])
    os.kill(os.getpid(), signal.SIGTERM)  # what was half written is removed
    time.sleep(GRACE)
    os._exit(1)


def _count(steps: int) -> None:
    with _done.get_lock():
        _done.value += steps


def _work(source: str, spec: StimulusSpec, path: str) -> StimulusResult:
    return record_stimulus(load_arm(source), spec, Path(path), _count)


def _work_in_worker(source: str, spec: StimulusSpec, path: str) -> StimulusResult:
    try:
        return _work(source, spec, path)
    except SystemExit:  # the pool would take it for a result and go on with what is left
        os._exit(1)


def record_stimuli(
    source: str | Path,
    specs: Sequence[StimulusSpec],
    paths: Sequence[Path],
    jobs: int,
    progress: Callable[[int], None] = lambda _: None,
) -> list[StimulusResult]:
    """
    Simulate and record several stimuli.

    Parameters
    ----------
    source : str or Path
        Arm description; each process reads it.
    specs : sequence of StimulusSpec
        What to record.
    paths : sequence of Path
        Directory of each bag; must not exist.
    jobs : int
        Number of processes; one for no process beside this one.
    progress : callable, optional
        Told the number of simulation steps done so far, all stimuli together.

    Returns
    -------
    list of StimulusResult
        What was done, in the order of ``specs``.

    """
    context = multiprocessing.get_context('spawn')
    counter = context.Value('q', 0)
    if min(jobs, len(specs)) <= 1:
        _begin(counter)
        results = []
        for spec, path in zip(specs, paths, strict=True):
            results.append(_work(str(source), spec, str(path)))
            progress(counter.value)
        return results
    before = set(multiprocessing.active_children())
    with ProcessPoolExecutor(min(jobs, len(specs)), mp_context=context,
                             initializer=_begin_worker, initargs=(counter,)) as pool:
        with _no_interrupt():  # an interrupt is this process's to handle; workers inherit that
            futures = [pool.submit(_work_in_worker, str(source), spec, str(path))
                       for spec, path in zip(specs, paths, strict=True)]
        workers = set(multiprocessing.active_children()) - before
        pending: set[Future[StimulusResult]] = set(futures)
        try:
            while pending:
                finished, pending = wait(pending, timeout=0.2)
                progress(counter.value)
                for future in finished:
                    future.result()
        except BaseException:  # else the pool would go through all that is left
            for worker in workers:
                worker.terminate()
            pool.shutdown(cancel_futures=True)
            raise
        return [future.result() for future in futures]


@contextmanager
def _no_interrupt() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    usual = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, usual)
