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

"""The one way in which the package compiles its inner loops, and where it keeps the results."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import hashlib
import os
from pathlib import Path
import shutil
from typing import Any, cast, TypeVar

import numba

Function = TypeVar('Function', bound=Callable[..., object])

PACKAGE = Path(__file__).parent
_CONFIG: Any = numba.config
MARK = b'\n@compiled\n'
"""What a file with inner loops contains."""
NUMBERS = 'layout.py'
"""File with nothing but numbers that inner loops use."""
OWN = Path(__file__).name
"""This file, which says how to compile."""

KEPT = 'tudor_dynamics-'
"""How directories with compiled functions begin."""


def kernel_files() -> dict[Path, bytes]:
    """Read the files whose functions, or numbers, are compiled."""
    contents = {file: file.read_bytes() for file in sorted(PACKAGE.rglob('*.py'))}
    return {file: content for file, content in contents.items()
            if MARK in content or file.name == NUMBERS or file.name == OWN}


def kept_in() -> Path:
    """
    Name the directory in which compiled functions are kept between runs.

    A compiled function contains those that it calls, but numba compiles it anew only where its
    own file has changed. So the name holds a checksum of all such files: after an upgrade nothing
    old is used.
    """
    digest = hashlib.sha256()
    for file, content in kernel_files().items():
        digest.update(file.relative_to(PACKAGE).as_posix().encode() + b'\0' + content)
    root = PACKAGE / '__pycache__'
    if _CONFIG.CACHE_DIR:
        root = Path(_CONFIG.CACHE_DIR)
    elif not os.access(root if root.exists() else PACKAGE, os.W_OK):
        root = Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache')
    return root / (KEPT + digest.hexdigest()[:16])


def prepare() -> Path:
    """Make the directory of compiled functions; in the package, remove older ones."""
    here = kept_in()
    if not here.is_dir():
        try:
            here.mkdir(parents=True, exist_ok=True)
        except OSError:
            return here
        for old in (PACKAGE / '__pycache__').glob(KEPT + '*'):
            if old != here:
                shutil.rmtree(old, ignore_errors=True)
    return here


DIRECTORY = prepare()


@contextmanager
def _kept() -> Iterator[None]:
    """Let numba keep what it is given now in the directory, and only that."""
    before = _CONFIG.CACHE_DIR
    _CONFIG.CACHE_DIR = str(DIRECTORY)
    try:
        yield
    finally:
        _CONFIG.CACHE_DIR = before


def compiled(function: Function) -> Function:
    """
    Compile a function of scalars and arrays; the result is kept on disk between runs.

    Sums keep their order and products are rounded. A function that several others call is compiled
    into each of them, and which copy serves depends on what was called first: with any freedom in
    rounding, results would depend on what a process has done before.
    """
    with _kept():
        jit = numba.njit(cache=DIRECTORY.is_dir(), nogil=True, error_model='numpy')
        return cast(Function, jit(function))
