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

"""How inner loops are compiled and kept; small arrays in them; several arms side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from fcntl import flock, LOCK_EX
from functools import cache
import hashlib
import logging
import math
import os
from pathlib import Path
import shutil
from threading import Timer
from typing import Any, cast, TypeVar

import numba
from numba.core.compiler_lock import global_compiler_lock
import numpy as np
from numpy.typing import NDArray

try:
    if os.environ.get('TUDOR_PLAIN_LANES'):
        raise ImportError('TUDOR_PLAIN_LANES is set')
    from tudor_dynamics.vectors import LANES as WIDTH, views, without_owner
    LANES, PLAIN = WIDTH, False
except (AttributeError, ImportError, TypeError):
    LANES, PLAIN = 8, True

Function = TypeVar('Function', bound=Callable[..., object])

PACKAGE = Path(__file__).parent
_CONFIG: Any = numba.config
MARKS = b'\n@compiled\n', b'\n@with_lanes('  # what a file with inner loops contains
OTHERS = Path(__file__).name, 'vectors.py', 'settings.py'
"""Files that say how to compile, and those with numbers that inner loops of others use."""

KEPT = 'tudor_dynamics-'  # how directories with compiled functions begin


def kernel_files() -> dict[Path, bytes]:
    """Read the files whose functions, or numbers, are compiled."""
    contents = {file: file.read_bytes() for file in sorted(PACKAGE.rglob('*.py'))}
    return {file: content for file, content in contents.items()
            if file.name in OTHERS or any(mark in content for mark in MARKS)}


def kept_in() -> Path:
    """
    Name the directory in which compiled functions are kept between runs.

    A compiled function contains those that it calls, but numba compiles it again only where its
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


def compiled(function: Function) -> Function:
    """
    Compile a function of scalars and arrays; the result is kept on disk between runs.

    Sums keep their order and products are rounded. A function that several others call is compiled
    into each of them, and which copy serves depends on what was called first: with any freedom in
    rounding, results would depend on what a process has done before.
    """
    jit: Any = numba.njit  # its stub lacks an option
    before, _CONFIG.CACHE_DIR = _CONFIG.CACHE_DIR, str(DIRECTORY)  # for this function alone
    try:
        made = jit(cache=DIRECTORY.is_dir(), nogil=True, error_model='numpy',
                   no_cfunc_wrapper=True)(function)
    finally:
        _CONFIG.CACHE_DIR = before
    return cast(Function, made if made is function else _once(made))  # NUMBA_DISABLE_JIT


_ALONE: set[Path] = set()  # locks that this process holds
SILENCE = 3.0  # after so long it is said that something is compiled [s]


@cache
def _say() -> None:
    logging.getLogger('tudor_dynamics').warning(
        'compiling functions, once after each update; this takes a minute')


def _once(function: Any) -> Any:
    """Let only one of several processes compile a function; the others wait, and read it."""
    compile_it, own = function.compile, function.py_func
    place = DIRECTORY / f'{own.__module__}.{own.__qualname__}.lock'

    def compile_once(signature: Any) -> Any:
        # numba's own lock first: who has it may need this function inside of another one
        with global_compiler_lock, ExitStack() as held:
            if not _ALONE:
                timer = Timer(SILENCE, _say)
                timer.daemon = True
                timer.start()
                held.callback(timer.cancel)
            if place not in _ALONE:
                with suppress(OSError):  # a directory without locks, or without rights
                    flock(held.enter_context(place.open('a')), LOCK_EX)
                    _ALONE.add(place)
                    held.callback(_ALONE.discard, place)
            # numbers as such: not once more for every constant that a kernel calls it with
            return compile_it(tuple(map(numba.types.unliteral, signature)))
    function.compile = compile_once
    return function


@compiled
def all_finite(x: NDArray[np.float64]) -> bool:
    """Say whether no value of a vector is NaN or infinite."""
    for value in x:
        if not math.isfinite(value):
            return False
    return True


@compiled
def largest_size(x: NDArray[np.float64], begin: int, end: int) -> float:
    """Give the largest absolute value of a part of a vector; NaN if one is NaN."""
    most = 0.0
    for i in range(begin, end):
        if not abs(x[i]) <= most:
            most = abs(x[i])
        if math.isnan(most):
            return most
    return most


# -- Several arms side by side, and arrays that nobody counts references to.
#
# A kernel of numbers, given arrays whose last axis are lanes, is compiled once more for vectors of
# the processor, as it stands: one step then advances as many arms as there are lanes. Comparisons
# say whether they hold in all lanes, so a kernel may branch only where its lanes agree.
#
# Where numba is not as ``vectors.py`` expects it, or ``TUDOR_PLAIN_LANES`` is set, the lanes are
# followed one after the other: the same numbers to rounding, several times slower.

Tables = TypeVar('Tables', bound=tuple)
Kernel = TypeVar('Kernel', bound=Callable[..., int])

if PLAIN:
    @compiled
    def unowned(tables: Tables) -> Tables:
        """Give the same arrays."""
        return tables

    @compiled
    def in_lanes(tables: Tables) -> Tables:
        """Take the last axis of float arrays for lanes, share those of integers; see `unowned`."""
        return tables
else:
    @compiled
    def unowned(tables: Tables) -> Tables:
        """
        Give the same arrays, without their owner.

        Nobody counts references to them nor to their rows, each an atomic addition that numba does
        not leave out where there is a loop: a third of the time of a step. Only for the arguments
        of a function that is called from Python, which holds them until it returns.
        """
        return without_owner(tables)  # type: ignore[call-arg]

    @compiled
    def in_lanes(tables: Tables) -> Tables:
        """
        Take the last axis of all arrays of numbers for lanes; arrays of whole numbers are shared.

        Nobody counts references to what is given, see ``unowned``.
        """
        return views(unowned(tables))  # type: ignore[call-arg]


def side_by_side(several: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Put arrays of one shape side by side (..., LANES); the last one fills remaining lanes."""
    return np.stack([*several, *[several[-1]] * (LANES - len(several))], axis=-1)


def with_lanes(shared: int) -> Callable[[Kernel], Kernel]:
    """
    Compile a kernel that takes its arguments after the first ``shared`` ones by ``in_lanes``.

    It returns the number of steps done, which is that of the lane that fails first. In the plain
    way a lane that fails is NaN afterwards.
    """
    def decorate(kernel: Kernel) -> Kernel:
        fast = compiled(kernel)
        return cast(Kernel, one_by_one(fast, shared)) if PLAIN else fast
    return decorate


def one_by_one(kernel: Callable[..., int], shared: int) -> Callable[..., int]:
    """Let a kernel follow the lanes one after the other."""
    def follow(*arguments: Any) -> int:
        common, several = arguments[:shared], arguments[shared:]
        begun = [array.copy() for array in several]  # whole numbers are the same in all lanes
        done = []
        for lane in range(LANES):
            own = [np.ascontiguousarray(array[..., lane]) if array.dtype == float else array.copy()
                   for array in begun]
            done.append(kernel(*common, *own))
            for array, found in zip(several, own, strict=True):
                if array.dtype == float:
                    array[..., lane] = found
                else:
                    array[...] = found
        for lane, steps in enumerate(done):
            for array in several:
                if steps < max(done) and array.dtype == float:
                    array[..., lane] = np.nan
        return min(done)
    return follow
