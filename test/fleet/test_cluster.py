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

"""Work on a cluster of processes: workers that die or come late make no difference to results."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
import json
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import threading
import time

from patience import PATIENCE
from piece_making import held, killed, spelled, square
import pytest

from tudor_dynamics import parallel
from tudor_dynamics.cli.main import main
from tudor_dynamics.errors import BagError, ProcessError, TudorWarning, UsageError
from tudor_dynamics.parallel import Cluster, in_processes, on_cluster, shared_out, width

pytest.importorskip('distributed', reason='pip install tudor_dynamics[cluster] for work on '
                                          'other machines')
TESTS = Path(__file__).parents[1]
PIECES = 20
"""Enough for whoever comes late to get some."""


class Machines:
    """A scheduler, and workers that are begun when they are asked for."""

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack
        self._workers = 0
        with socket.socket() as taken:
            taken.bind(('127.0.0.1', 0))
            self.address = f'tcp://127.0.0.1:{taken.getsockname()[1]}'
        self._begin('scheduler', '--host', '127.0.0.1', '--port',
                    self.address.rpartition(':')[2], '--no-dashboard', '--no-show')

    def worker(self) -> None:
        """Begin a worker with a nanny, which begins it again when it dies."""
        self._workers += 1
        self._begin('worker', self.address, '--nworkers', '1', '--nthreads', '1',
                    '--no-dashboard', '--local-directory', '/tmp')

    def ready(self) -> str:
        """Give the address, with a worker at least."""
        if not self._workers:
            self.worker()
        return self.address

    def _begin(self, *words: str) -> None:
        # on a busy machine a process may need longer to answer than the defaults of 30 s allow
        environment = os.environ | {
            'PYTHONPATH': str(TESTS), 'DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT': '150s',
            'DASK_DISTRIBUTED__COMM__TIMEOUTS__TCP': '150s'}
        process = subprocess.Popen(
            [sys.executable, '-m', 'dask', *words], stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL, env=environment, start_new_session=True)
        self._stack.callback(process.wait)
        self._stack.callback(os.killpg, process.pid, signal.SIGKILL)


@pytest.fixture(scope='module')
def machines() -> Iterator[Machines]:
    """Begin a scheduler, and end all that belongs to it."""
    with ExitStack() as stack:
        yield Machines(stack)


def wait_for(condition: Callable[[], bool]) -> None:
    """Wait until something is so."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def here() -> Cluster:
    """Give the cluster that the work goes to."""
    assert parallel._cluster is not None
    return parallel._cluster


def states() -> list[str]:
    """Give the states of the nannies."""
    found = here().client.run(lambda dask_worker: dask_worker.status.name, nanny=True)
    return list(found.values())


def processes(folder: Path) -> set[str]:
    """Give the processes that have begun a piece."""
    return {file.name.partition('-')[2] for file in folder.iterdir() if '-' in file.name}


def test_a_worker_dies_and_another_comes_late(machines: Machines, tmp_path: Path) -> None:
    """Killed in the middle of a piece, it is replaced and its piece done again."""
    told: list[int] = []
    results: list[int] = []
    pieces = [(tmp_path, number) for number in range(PIECES)]

    def work() -> None:
        results.extend(in_processes(held, pieces, 1, told.append))

    with pytest.warns(TudorWarning, match='no workers yet'), on_cluster(machines.address):
        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        machines.worker()
        wait_for(lambda: any(tmp_path.iterdir()) or not thread.is_alive())
        # a nanny that is still beginning its worker gives up when that dies
        wait_for(lambda: states() == ['running'])
        number, _, pid = next(tmp_path.iterdir()).name.partition('-')
        os.kill(int(pid), signal.SIGKILL)
        machines.worker()
        # both are there, and one of them has begun a piece: which, is the scheduler's business
        wait_for(lambda: (here().width() == 2 and len(processes(tmp_path)) > 1)
                 or not thread.is_alive())
        (tmp_path / 'go').touch()
        thread.join(PATIENCE)
        assert width(7) == 2
    assert results == [number**2 for number in range(PIECES)]
    assert told[-1] == sum(range(PIECES)) and told == sorted(told)
    assert len(processes(tmp_path)) == 3
    begun = [file.name.partition('-')[0] for file in tmp_path.iterdir()]
    assert begun.count(number) == 2  # the piece of the dead worker
    assert width(7) == 7 and parallel._cluster is None


def test_errors_come_back(machines: Machines) -> None:
    """An error is what it was, and what kills one worker after the other says so."""
    with on_cluster(machines.ready()):
        with pytest.raises(BagError, match='^-1: negative; give another$') as caught:
            in_processes(square, [1, -1, 2], 2)
        assert caught.value.place == '-1'
        with pytest.raises(ProcessError, match='several workers died'):
            in_processes(killed, [1], 2)
        assert in_processes(square, range(1, 6), 2) == [1, 4, 9, 16, 25]


def test_searches_go_there(machines: Machines) -> None:
    """What threads would have done is done by workers, in order."""
    said: list[str] = []
    with on_cluster(machines.ready()):
        found = shared_out([partial(spelled, 'ab'), partial(spelled, 'cd')], said.append)
    assert found == ['a b', 'c d']
    assert said == ['1 of 2 searches done', '2 of 2 searches done']


def test_other_versions_are_refused(
    machines: Machines, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A worker that would compute something else computes nothing."""
    with on_cluster(machines.ready()):
        monkeypatch.setattr(parallel, 'versions', lambda: {'numpy': '1.0'})
        with pytest.raises(ProcessError, match=r'other versions: numpy [0-9.]+, here 1\.0'):
            in_processes(square, [1], 1)


@pytest.mark.parametrize(('address', 'words'), [
    ('here', 'here: not the address of a Dask'), ('tcp://127.0.0.1:1', 'no cluster answers')])
def test_no_cluster(
    address: str, words: str, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str], root: Path, tmp_path: Path,
) -> None:
    """One line, exit code 2."""
    monkeypatch.setattr(parallel, 'TIMEOUT', 0.5)
    with pytest.raises(UsageError, match=words), on_cluster(address):
        pass
    assert main(['record', '--arm', str(root / 'config/tudor.yaml'), '--stimuli', '1', '--seconds',
                 '3', '--out', str(tmp_path / 'out'), '--cluster', address]) == 2
    assert words in capsys.readouterr().err and not (tmp_path / 'out').exists()


def test_figures_are_those_of_this_machine(
    machines: Machines, root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Recordings and a fit bag by bag come out the same, byte by byte, by relative names too."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('SOURCE_DATE_EPOCH', '0')  # bundles say to the minute when they were made
    there = ['--cluster', machines.ready()]
    for name, more in (('here', ['--jobs', '1']), ('there', there)):
        assert main(['record', '--arm', str(root / 'config/tudor.yaml'), '--stimuli', '2',
                     '--seconds', '8', '--out', f'{name}/bags', *more]) == 0
        os.symlink(f'{name}/bags', 'bags')
        assert main(['fit', 'bags', '--stream', '--arm', str(root / 'config/tudor.yaml'), '--out',
                     f'{name}/model', '--exit-zero', '--json', *more]) == 0
        os.unlink('bags')
    bags, models = (sorted(Path('here').glob(f'{part}/**/*.*')) for part in ('bags', 'model'))
    assert len(bags) == 5 and len(models) >= 4
    for file in [*bags, *(file for file in models if file.suffix != '.html')]:
        assert file.read_bytes() == Path('there', *file.parts[1:]).read_bytes(), file
    said = capsys.readouterr().out
    assert json.loads(said[said.rindex('\n{'):])['unused'] == []
