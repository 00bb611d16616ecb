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
Time and memory of `tudor fit` on many bags, of one that is killed, and of one that goes on.

A few simulated recordings of config/tudor.yaml become many bags by noise on all signals, so that
no two have the same bytes. Peaks of memory are those that the system keeps of every process.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

import numpy as np
from tables import show

from tudor_dynamics import load_arm
from tudor_dynamics.arm.description import Arm
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.writer import recording_series, write_bag
from tudor_dynamics.parallel import Count, in_processes

ARM = 'config/tudor.yaml'
SOURCES = 8
"""Recordings that are simulated."""
NOISE = 1e-3
"""Of every signal, as a part of its standard deviation."""
LOOK = 0.1
"""Time between two looks at the processes [s]."""


@dataclass
class Run:
    """What a command took."""

    seconds: float = 0.0  # from its start to its end [s]
    cpu: float = 0.0  # of it and all its processes [s]
    # Process to its largest memory in use, and that of it which no library's file backs [MiB].
    peaks: dict[int, tuple[int, int]] = field(default_factory=dict)
    code: int = 0  # its exit code


def noisy(recording: Recording, seed: int) -> Recording:
    """Put noise on all signals."""
    generator = np.random.default_rng(seed)

    def shaken(x: np.ndarray | None) -> np.ndarray | None:
        return None if x is None else x + NOISE * x.std(axis=0) * generator.normal(size=x.shape)
    q, dq, effort, strain = (shaken(getattr(recording, name))
                             for name in ('q', 'dq', 'effort', 'strain'))
    assert q is not None
    return replace(recording, q=q, dq=dq, effort=effort, strain=strain)


def write(piece: tuple[str, Sequence[tuple[int, str]]], count: Count) -> None:
    """Write the bags of one recording."""
    source, bags = piece
    arm = load_arm(ARM)
    recording = read_recording(source, arm)
    for seed, path in bags:
        write_bag(path, recording_series(noisy(recording, seed), arm),
                  custom={'payload': '0.2'})
        count(1)


def make(arm: Arm, folder: Path, bags: int, seconds: float, jobs: int) -> None:
    """Make the bags that are not there yet."""
    source = folder.with_name(f'{folder.name}_sources')
    if not source.exists():
        subprocess.run([sys.executable, '-m', 'tudor_dynamics', 'record', '--arm', ARM,
                        '--payload', '0.2', '--stimuli', str(SOURCES), '--seconds', str(seconds),
                        '--jobs', str(jobs), '--out', str(source)], check=True,
                       stdout=subprocess.DEVNULL)
    wanted = [(i, folder / f'bag_{i:05d}') for i in range(bags)]
    missing = [(i, str(path)) for i, path in wanted if not path.exists()]
    pieces = [(str(source / f'stimulus_{k + 1:02d}'), [one for one in missing
                                                       if one[0] % SOURCES == k])
              for k in range(SOURCES)]
    begun = time.perf_counter()
    in_processes(write, [piece for piece in pieces if piece[1]], jobs)
    if missing:
        print(f'{len(missing)} bags of {seconds:g} s of {arm.name} made in '
              f'{time.perf_counter() - begun:.0f} s')


def children(pid: int) -> list[int]:
    """Give a process and all that it has begun."""
    try:
        own = [int(word) for task in Path(f'/proc/{pid}/task').iterdir()
               for word in (task / 'children').read_text().split()]
    except OSError:
        return []
    return [pid, *(item for child in own for item in children(child))]


def memory(pid: int) -> tuple[int, int]:
    """Give the largest memory of a process so far, and what of it is its own now [MiB]."""
    try:
        lines = dict(line.split(':', 1) for line in
                     Path(f'/proc/{pid}/status').read_text().splitlines())
        return tuple(int(lines[key].split()[0]) >> 10  # type: ignore[return-value]
                     for key in ('VmHWM', 'RssAnon'))
    except (OSError, KeyError):
        return 0, 0


def timed(words: Sequence[str], kill_after: float | None = None) -> Run:
    """Run a command; look at its processes meanwhile, and kill them all if asked to."""
    run, before, begun = Run(), os.times(), time.perf_counter()
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    while process.poll() is None:
        for pid in children(process.pid):
            run.peaks[pid] = tuple(map(max, memory(pid), run.peaks.get(pid, (0, 0))))
        if kill_after is not None and time.perf_counter() - begun > kill_after:
            process.send_signal(signal.SIGKILL)
            kill_after = None
        time.sleep(LOOK)
    after = os.times()
    run.seconds = time.perf_counter() - begun
    run.cpu = (after.children_user + after.children_system
               - before.children_user - before.children_system)
    run.code = process.returncode
    assert process.stderr is not None
    for line in process.stderr.read().decode().splitlines()[:8]:
        print('   ', line)
    return run


def main() -> None:
    """Make bags, fit them, and say what it took."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--bags', type=int, nargs='+', default=[20, 100])
    parser.add_argument('--seconds', type=float, default=80.0)
    parser.add_argument('--jobs', type=int, default=os.cpu_count() or 1)
    parser.add_argument('--folder', type=Path, default=Path('out/many_bags'))
    parser.add_argument('--kill-after', type=float, metavar='S',
                        help='kill the fit of the largest number of bags once, and go on')
    args = parser.parse_args()
    arm, rows = load_arm(ARM), []
    for bags in args.bags:
        folder = args.folder / f'{bags}'
        make(arm, folder, bags, args.seconds, args.jobs)
        out = args.folder / f'model_{bags}'
        words = [sys.executable, '-m', 'tudor_dynamics', 'fit', str(folder), '--stream', '--arm',
                 ARM, '--jobs', str(args.jobs), '--out', str(out), '--overwrite', '--exit-zero']
        sums = list(out.with_name(f'{out.name}.sums').glob('*'))
        if sums:
            print(f'{len(sums)} files of an earlier fit are there, and are used')
        if args.kill_after is not None and bags == max(args.bags):
            run = timed(words, args.kill_after)
            kept = len(list(out.with_name(f'{out.name}.sums').glob('*.npz')))
            print(f'{bags} bags: killed after {run.seconds:.0f} s, {kept} bags kept')
        run = timed(words)
        each = ', '.join(f'{peak} MiB ({own} its own)' for peak, own in sorted(
            run.peaks.values(), reverse=True) if peak > 50)
        print(f'{bags} bags: {run.seconds:.1f} s, {run.cpu:.1f} s CPU '
              f'({1000 * run.cpu / bags:.0f} ms a bag), exit code {run.code}; processes: {each}')
        rows.append((f'{bags}, {args.jobs} processes', f'{run.seconds:.2g} s', f'{run.cpu:.3g} s',
                     '{} MiB ({} MiB)'.format(*max(run.peaks.values()))))
    show(('bags', 'time', 'CPU', 'largest process (of that not mapped from libraries)'), rows)


if __name__ == '__main__':
    main()
