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

"""Which bag, and which part of it: as arguments of commands name it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
import glob
import os
from pathlib import Path
import re

from tudor_dynamics.bags.finding import bags_below, natural
from tudor_dynamics.errors import check_type, UsageError

Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]


@dataclass(frozen=True)
class BagChoice:
    """A bag, or a part of it by time."""

    path: str  # bag directory or file
    # Part used, as fractions of its duration, or since its first sample [s].
    begin: float = 0.0
    end: float = 1.0
    seconds: bool = False  # whether begin and end are times
    # Of the recording, where it was read; needed to compare times with fractions [s].
    duration: float | None = field(default=None, compare=False)

    def overlaps(self, other: BagChoice) -> bool:
        """
        Say whether another choice of the same recording has samples of this one.

        Times and fractions can be compared once one of the two was read; before, they are not
        said to overlap.
        """
        duration = self.duration or other.duration
        if self.seconds == other.seconds:
            own, others = (self.begin, self.end), (other.begin, other.end)
        elif duration is None:
            return False
        else:
            own, others = self.span(duration), other.span(duration)
        return own[0] < others[1] and others[0] < own[1]

    def span(self, duration: float) -> tuple[float, float]:
        """Give begin and end as times: duration [s]; returns begin, end [s]."""
        scale = 1.0 if self.seconds else duration
        return self.begin * scale, self.end * scale

    def __str__(self) -> str:
        """Write the choice as it is written on the command line."""
        if self.seconds:
            return f'{self.path}@{self.begin:g}s-{self.end:g}s'
        if (self.begin, self.end) == (0.0, 1.0):
            return self.path
        return f'{self.path}@{100 * self.begin:g}-{100 * self.end:g}%'


def parse_choice(text: str) -> BagChoice:
    """Read a bag argument: ``PATH``, ``PATH@BEGIN-END%`` or ``PATH@BEGINs-ENDs``."""
    timed = re.fullmatch(r'(.+)@(\d+(?:\.\d+)?)s-(\d+(?:\.\d+)?)s', text)
    if timed is not None:
        begin, end = float(timed[2]), float(timed[3])
        if not begin < end < float('inf'):
            msg = (f'{text}: the part {timed[2]}s-{timed[3]}s is empty; give the earlier time '
                   f'first, such as {timed[1]}@5s-50s')
            raise UsageError(msg)
        return BagChoice(timed[1], begin, end, seconds=True)
    match = re.fullmatch(r'(.+)@(\d+(?:\.\d+)?)-(\d+(?:\.\d+)?)%', text)
    if match is None:
        return BagChoice(text)
    begin, end = float(match[2]) / 100.0, float(match[3]) / 100.0
    if not 0.0 <= begin < end <= 1.0:
        msg = (f'{text}: the part {match[2]}-{match[3]}% is empty or outside 0-100%; give two '
               f'shares of the bag, the smaller first, such as {match[1]}@0-60%')
        raise UsageError(msg)
    return BagChoice(match[1], begin, end)


def choices(bags: Paths, name: str = 'bags') -> list[BagChoice]:
    """Read the names of bags, one or several."""
    if isinstance(bags, (str, os.PathLike)):
        bags = [bags]
    advice = 'give the path of a bag, or a list of paths'
    check_type(bags, (list, tuple), name, advice)
    for bag in bags:
        check_type(bag, (str, os.PathLike), f'one of {name}', advice)
    return [parse_choice(os.fspath(bag)) for bag in bags]


def found_choices(texts: Sequence[str]) -> list[BagChoice]:
    """Read bag arguments, among them folders of bags and patterns such as ``'bags/2026-*'``."""
    found: list[BagChoice] = []
    for text in texts:
        choice = parse_choice(text)
        if os.path.lexists(choice.path) or not glob.has_magic(choice.path):
            paths = [Path(choice.path)]
        else:
            paths = sorted(map(Path, glob.glob(choice.path)), key=natural)
            if not paths:
                raise UsageError(f'{text}: no file has such a name', remedy='name a bag, or a '
                                 'folder of bags')
        below = [bag for path in paths for bag in bags_below(path)]
        found += [choice] if below == [Path(choice.path)] else [
            replace(choice, path=str(bag)) for bag in below]
    return found


def check_choices(training: Sequence[BagChoice], test: Sequence[BagChoice]) -> None:
    """Refuse parts of one bag that overlap."""
    if not training:
        msg = 'there is no bag to learn from: give the path of one, better of several'
        raise UsageError(msg)
    known: dict[Path, list[BagChoice]] = {}
    for number, other in enumerate((*training, *test)):
        same = known.setdefault(Path(other.path).resolve(), [])
        for one in same:
            if one.overlaps(other):
                msg = (f'{one} and {other} overlap: the same samples twice, or in training and '
                       'test; name parts that do not overlap, such as BAG@0-60% and BAG@60-100%')
                raise UsageError(msg)
        if number < len(training):
            same.append(other)
