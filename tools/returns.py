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
Count how often the code sends a reader back to a file that was seen already.

    python tools/returns.py [load_arm] [read_recording] [period] [--tree]

A reader follows every call within the package into its file and, at its end, back to the caller's;
each move into another file that was open before is a return.

What is followed is a second run, with everything imported: ``load_arm`` of an arm in ``config/``,
``read_recording`` of a bag in ``bags/``, and one sample of the simulated arm with its controller
in the middle of a move. A function that numba compiled is one call: what it calls is not followed.
Beside the figures stand the calls that cause most returns; ``--tree`` prints the whole walk.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
import importlib
import math
from pathlib import Path
import re
import sys
from types import FrameType
from typing import Any
import warnings

import tudor_dynamics as td

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = Path(td.__file__).parent
RIG = 'Rig'
"""Class of the simulated arm with its controller and source of references."""
MOST = 10
"""Calls that are printed."""

Place = tuple[str, str]
"""File in the package, and function."""


@dataclass
class Walk:
    """Where a reader has been."""

    moves: int = 0
    returns: int = 0
    files: set[str] = field(default_factory=set)
    causes: Counter[tuple[Place, Place]] = field(default_factory=Counter)
    tree: list[str] = field(default_factory=list)
    _open: list[Place] = field(default_factory=list)
    _file: str = ''

    def call(self, place: Place) -> None:
        """Go into a function."""
        caller = self._open[-1] if self._open else ('', '')
        mark = self._go(place[0], caller, place)
        self.tree.append(f'{"  " * len(self._open)}{mark} {place[0]}:{place[1]}')
        self._open.append(place)

    def leave(self) -> None:
        """Go back to who called."""
        place = self._open.pop() if self._open else ('', '')
        if self._open and self._go(self._open[-1][0], self._open[-1], place) == '<':
            self.tree.append(f'{"  " * (len(self._open) - 1)}< back in {self._open[-1][0]}')

    def _go(self, file: str, caller: Place, called: Place) -> str:
        if file == self._file:
            return ' '
        self.moves += 1
        self._file = file
        if file not in self.files:
            self.files.add(file)
            return '+'
        self.returns += 1
        self.causes[caller, called] += 1
        return '<'


def follow(run: Callable[[], object]) -> Walk:
    """Walk through what a function without arguments does."""
    walk, begin = Walk(), f'{PACKAGE}/'

    def profile(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if not code.co_filename.startswith(begin):
            return
        if event == 'call':
            name = getattr(code, 'co_qualname', code.co_name)
            walk.call((code.co_filename[len(begin):], name))
        elif event == 'return':
            walk.leave()

    sys.setprofile(profile)
    try:
        run()
    finally:
        sys.setprofile(None)
    return walk


def find_class(name: str) -> Any:
    """Import a class of the package by its name, wherever it stands."""
    line = re.compile(rf'^class {name}\b', re.MULTILINE)
    files = [file for file in sorted(PACKAGE.rglob('*.py')) if line.search(file.read_text())]
    if len(files) != 1:
        sys.exit(f'{len(files)} files define a class {name}, expected one; correct RIG in '
                 f'{Path(__file__).name}')
    module = '.'.join(files[0].relative_to(PACKAGE.parent).with_suffix('').parts)
    return getattr(importlib.import_module(module), name)


def of_load_arm() -> Callable[[], object]:
    """Read the arm with two blades."""
    return lambda: td.load_arm(ROOT / 'config' / 'two_blade_arm.yaml')


def of_read_recording() -> Callable[[], object]:
    """Read a bag of that arm."""
    arm = td.load_arm(ROOT / 'config' / 'two_blade_arm.yaml')
    return lambda: td.read_recording(ROOT / 'bags' / 'two_blade_train_1', arm)


def of_period() -> Callable[[], object]:
    """Advance the arm with gauges and a damper by one sample, half a second into a move."""
    rig = find_class(RIG)(td.load_arm(ROOT / 'config' / 'tudor.yaml'))
    rig.run(0.5)
    rig.source.go([math.radians(20.0), math.radians(-60.0)])
    rig.run(0.5)
    step: Callable[[], object] = rig.step
    return step


THINGS = {'load_arm': of_load_arm, 'read_recording': of_read_recording, 'period': of_period}


def walk_through(thing: str) -> Walk:
    """Run it once, and follow it the second time."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        run = THINGS[thing]()
        run()
        return follow(run)


def report(thing: str, walk: Walk, tree: bool) -> str:
    """Write figures, and the calls that cause most returns or the whole walk."""
    lines = [f'{thing}: {walk.returns} returns in {len(walk.files)} files']
    if tree:
        return '\n'.join([*lines, *walk.tree])
    for (caller, called), count in walk.causes.most_common(MOST):
        lines += [f'{count:5}  {":".join(caller) if caller[0] else "outside"}',
                  f'         -> {":".join(called)}']
    return '\n'.join(lines)


def main() -> None:
    """Follow what is named, or everything."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().splitlines()[0])
    parser.add_argument('things', nargs='*', metavar='THING',
                        help=f'{", ".join(THINGS)}, or all, which is what none means')
    parser.add_argument('--tree', action='store_true', help='print the walk')
    args = parser.parse_args()
    things = list(THINGS) if not args.things or 'all' in args.things else args.things
    unknown = [thing for thing in things if thing not in THINGS]
    if unknown:
        parser.error(f'unknown: {", ".join(unknown)}; known are {", ".join(THINGS)} and all')
    for thing in things:
        print(report(thing, walk_through(thing), args.tree))


if __name__ == '__main__':
    main()
