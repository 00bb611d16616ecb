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

"""A piece of work in a module that other processes can import."""

from __future__ import annotations

import os
from pathlib import Path
import signal
import time

from patience import PATIENCE

from tudor_dynamics.errors import BagError
from tudor_dynamics.parallel import Count
from tudor_dynamics.typing import Progress


def square(piece: int, count: Count) -> int:
    """Do a piece of work of as many steps."""
    if piece < 0:
        raise BagError('negative', place=str(piece), remedy='give another')
    for _ in range(piece):
        count(1)
    return piece**2


def spelled(piece: str, told: Progress) -> str:
    """Do a piece of work that says what it does."""
    told(f'spelling {piece}')
    return ' '.join(piece)


def killed(piece: int, count: Count) -> int:
    """End as a process does for which there is no memory."""
    os.kill(os.getpid(), signal.SIGKILL)
    return piece


def held(piece: tuple[Path, int], count: Count) -> int:
    """Say that a piece has begun, and in which process; end when there is a file ``go``."""
    folder, number = piece
    (folder / f'{number}-{os.getpid()}').touch()
    deadline = time.monotonic() + PATIENCE
    while not (folder / 'go').exists():
        assert time.monotonic() < deadline
        time.sleep(0.02)
    time.sleep(0.1)
    count(number)
    return number**2
