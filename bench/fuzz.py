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
Damaged input of every kind: no crash, no hang, no value that differs from rosbags' own decoding.

Bags of every storage and compression, model bundles with their checksums made right again, arm
descriptions and URDFs are damaged at random (by a seed, so that each case can be had again) and
read in a process of their own. Allowed is a TudorError of one line, or a result; that of a bag is
compared with what rosbags makes of the same bytes, message by message.

    python bench/fuzz.py
    python bench/fuzz.py --only bags:1234 --keep DIR
    python bench/fuzz_bags.py --losses 500        whole fits of bags that lost messages
    python bench/fuzz_urdfs.py --urdfs 2000       URDFs with faults that people make
    python bench/fuzz_files.py                    plans, trajectories, marks of pushes, fleets
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass, field
import multiprocessing
from pathlib import Path
import sys
import tempfile
import time
import traceback
import warnings

import numpy as np

from tudor_dynamics.errors import TudorError, TudorWarning

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / 'test'))  # helpers that tests need, too
MEMORY = '/dev/shm' if Path('/dev/shm').is_dir() else None  # noqa: S108 (a disk is slow)
MAX_SECONDS = 10.0
MAX_BYTES = 500_000_000
START_SECONDS, PATIENCE = 600.0, 600.0
"""For samples and compiled code of a new process, and for a case, on the clock on the wall."""
COUNTS = {'bags': 10_000, 'bundles': 5_000, 'arms': 3_000}
READ, REFUSED, WRONG = 'read', 'refused', 'wrong'


def target(name, folder):
    """Make what is to be damaged."""
    from fuzzing.arms import Arms
    from fuzzing.bags import Bags
    from fuzzing.bundles import Bundles
    from fuzzing.files import Fleets, Plans, Trajectories, Truths
    from fuzzing.losses import Losses
    from fuzzing.urdfs import Urdfs
    if name in ('bags', 'bundles'):
        return {'bags': Bags, 'bundles': Bundles}[name](folder)
    return {'arms': Arms, 'urdfs': Urdfs, 'losses': Losses, 'plans': Plans, 'fleets': Fleets,
            'trajectories': Trajectories, 'truths': Truths}[name](folder, ROOT)


def peak(*, reset=False):
    """Give the largest resident memory since the last reset, where Linux tells it [bytes]."""
    try:
        if reset:
            Path('/proc/self/clear_refs').write_text('5', encoding='ascii')
            return 0
        text = Path('/proc/self/status').read_text(encoding='ascii', errors='replace')
    except OSError:
        return 0
    return 1024 * int(text.partition('VmHWM:')[2].split()[0])


def judge(kind, path):
    """Read one damaged input and say how that ended, in how much time and memory."""
    peak(reset=True)
    begun = time.process_time()  # others may keep the machine busy
    outcome, text, found = READ, '', None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('error', RuntimeWarning)
            warnings.simplefilter('ignore', TudorWarning)
            found = kind.use(path)
    except TudorError as err:
        outcome, text = REFUSED, str(err)
        if len(text) > 2000:
            outcome, text = WRONG, f'a message of {len(text)} characters'
        elif not text.isprintable():
            outcome, text = WRONG, f'a message that steers the terminal: {text!r}'
    except Exception:
        outcome, text = WRONG, traceback.format_exc()
    seconds, memory = time.process_time() - begun, peak()
    if (seconds > getattr(kind, 'seconds', MAX_SECONDS)
            or memory > getattr(kind, 'memory', MAX_BYTES)):
        outcome, text = WRONG, f'{seconds:.1f} s, {memory / 1e6:.0f} MB'
    if outcome == READ:
        difference = kind.compare(path, found)
        if difference:
            outcome, text = WRONG, difference
    return outcome, text, seconds, memory


def case(kind, name, seed, number, folder):
    """Make one damaged input, the same for the same numbers."""
    rng = np.random.default_rng([seed, sum(name.encode()), number])
    samples = kind.samples
    sample = samples[int(rng.integers(len(samples)))]
    return sample, kind.make(rng, sample, folder)


def work(name, seed, first, last, pipe):
    """Judge cases one after the other; the samples themselves must be read."""
    with tempfile.TemporaryDirectory(dir=MEMORY) as folder:
        kind = target(name, Path(folder, 'samples'))
        for sample in getattr(kind, 'first', kind.samples):
            outcome = text = ''
            for _ in range(2):  # again where the first has compiled what was not yet
                if outcome != READ:
                    outcome, text, _, _ = judge(kind, kind.make(None, sample, Path(folder)))
            if outcome != READ:
                pipe.send(('sample', sample, WRONG, text, 0.0, 0))
        pipe.send(None)
        for number in range(first, last):
            pipe.send(number)
            sample, path = case(kind, name, seed, number, Path(folder))
            pipe.send((number, sample, *judge(kind, path)))


@dataclass
class Tally:
    """How the cases of one kind ended."""

    kind: str
    outcomes: Counter = field(default_factory=Counter)
    wrong: int = 0
    slowest: float = 0.0
    memory: int = 0

    def add(self, number, sample, outcome, text, seconds, memory):
        """Count a case."""
        self.outcomes[outcome] += 1
        self.slowest, self.memory = max(self.slowest, seconds), max(self.memory, memory)
        if outcome == WRONG:
            self.wrong += 1
            print(f'{self.kind}:{number} ({sample}): {text}', flush=True)


def run(name, seed, first, last, seconds=float('inf')):
    """Go through the cases of one kind, with another process wherever one ends or hangs."""
    context, tally = multiprocessing.get_context('spawn'), Tally(name)
    over = time.monotonic() + seconds
    while first < last and time.monotonic() < over:
        ours, theirs = context.Pipe(duplex=False)
        worker = context.Process(target=work, args=(name, seed, first, last, theirs), daemon=True)
        worker.start()
        theirs.close()
        patience, current = START_SECONDS, None
        try:
            while ours.poll(patience):
                item = ours.recv()
                if isinstance(item, tuple):
                    tally.add(*item)
                    first = item[0] + 1 if item[0] != 'sample' else first
                    if item[0] != 'sample' and time.monotonic() > over:
                        last = first
                        break
                elif item is not None:
                    patience, current = PATIENCE, item
            ended = f'no answer within {patience:g} s'
        except EOFError:
            worker.join()
            ended = f'the process ended with {worker.exitcode}'
        worker.kill()
        worker.join()
        if current is None:
            raise SystemExit(f'{name}: {ended} before the first case')
        if first < last:
            tally.add(current, '', WRONG, ended, 0.0, 0)
            first = current + 1
    return tally


def main(description=__doc__, counts=COUNTS):
    """Damage, read, count."""
    parser = argparse.ArgumentParser(description=description.strip().splitlines()[0])
    for name, count in counts.items():
        parser.add_argument(f'--{name}', type=int, default=count, metavar='N')
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--minutes', type=float, default=float('inf'), metavar='M',
                        help='end each kind after this time, with what is done by then')
    parser.add_argument('--only', metavar='KIND:NUMBER', help='one case, in this process')
    parser.add_argument('--keep', type=Path, metavar='DIR', help='where --only leaves its input')
    args = parser.parse_args()
    if args.only:
        name, _, number = args.only.partition(':')
        with tempfile.TemporaryDirectory(dir=MEMORY) as folder:
            kind = target(name, Path(folder))
            sample, path = case(kind, name, args.seed, int(number), args.keep or Path(folder))
            print(f'{sample}, {path}:', *judge(kind, path)[:2], sep='\n')
        return 0
    failed = 0
    for name in counts:
        begun = time.perf_counter()
        tally = run(name, args.seed, 0, getattr(args, name), 60.0 * args.minutes)
        failed += tally.wrong
        print(f'{name}: {sum(tally.outcomes.values())} mutations in '
              f'{time.perf_counter() - begun:.0f} s: {tally.outcomes[READ]} read, '
              f'{tally.outcomes[REFUSED]} refused, {tally.outcomes[WRONG]} wrong; slowest '
              f'{tally.slowest:.2f} s, at most {tally.memory / 1e6:.0f} MB', flush=True)
    return 1 if failed else 0


if __name__ == '__main__':
    sys.exit(main())
