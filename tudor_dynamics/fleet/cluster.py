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
Pieces of work on other machines, by Dask; what runs them makes no difference to results.

A worker that dies takes no piece with it: the scheduler gives it to another one. One that comes
later takes its share. Names of files in a piece mean the same on all machines.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from functools import lru_cache
from importlib.metadata import version
from itertools import islice
import re
from typing import Any
import warnings

from tudor_dynamics.errors import ProcessError, TudorWarning, UsageError
from tudor_dynamics.files import PACKAGE, source_digest
from tudor_dynamics.parallel import Count, given_to, Piece, Result

ADDRESS = re.compile(r'(tcp|tls|ws|wss)://(\[[0-9a-fA-F:.]+\]|[^\s/:\[\]]+):\d{1,5}')
TIMEOUT = 10.0
"""For a scheduler to answer [s]."""
AHEAD = 4
"""Pieces that are under way, for each of the cluster's threads."""
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
    if address is None:
        yield
        return
    if not ADDRESS.fullmatch(address):
        raise UsageError(f'--cluster {address}: no address of a scheduler', remedy='give one such '
                         'as tcp://10.0.0.1:8786')
    try:
        from distributed import Client
    except ImportError:
        raise UsageError('--cluster needs the package distributed', remedy='install '
                         'tudor_dynamics[cluster], here and on all machines') from None
    try:
        client = Client(address, timeout=TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as err:
        raise UsageError(f'--cluster {address}: no scheduler answers ({err})', remedy='start one '
                         'with `dask scheduler`, and give the address that it prints') from None
    cluster = Cluster(client)
    try:
        if not cluster.width():
            warnings.warn(f'--cluster {address} has no workers yet, and waits for some',
                          TudorWarning, stacklevel=3)
        with given_to(cluster):
            yield
    finally:
        client.close()


class Cluster:
    """The workers of a scheduler."""

    def __init__(self, client: Any) -> None:
        self.client = client

    def width(self) -> int:
        """Give the number of pieces that they do at a time, now."""
        return sum(self.client.nthreads().values())

    def run(
        self, work: Callable[[Piece, Count], Result], pieces: Iterable[Piece],
        progress: Callable[[int], None],
    ) -> list[Result]:
        """Do pieces of work, in their order; a piece is taken when its turn comes."""
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
            raise ProcessError('a piece of work ended several workers, one after the other',
                               remedy='look whether their memory is enough') from None
        except (CancelledError, OSError) as err:
            raise ProcessError(f'the cluster has gone ({err})', remedy='start it and the command '
                               'again') from None
        finally:
            self.client.cancel([future for future in running if not future.done()])


@lru_cache
def versions() -> dict[str, str]:
    """Give the versions that results depend on: of the package, by its sources, and of others."""
    rooms = tuple(sorted(folder.name for folder in PACKAGE.iterdir()
                         if (folder / '__init__.py').exists()))
    return {'tudor_dynamics': source_digest(rooms),
            **{name: version(name) for name in LIBRARIES}}


def _piece(
    work: Callable[[Piece, Count], Result], piece: Piece, known: dict[str, str],
) -> tuple[Result, int]:
    own = versions()
    other = [f'{name} {own[name]}, not {value}' for name, value in known.items()
             if own[name] != value]
    if other:
        raise ProcessError(f'a worker has {", ".join(other)}', remedy='install the same versions '
                           'on all machines, and start the workers again')
    steps: list[int] = []
    return work(piece, steps.append), sum(steps)
