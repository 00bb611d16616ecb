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
Errors of the package: each derives from TudorError and from a builtin.

A message says what was found, where, what was expected and what to do. The command line prints it
on one line and exits with code 2.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
import difflib
import errno
import os
from pathlib import Path
import re
import sys
import textwrap
import warnings

ARGUMENT = re.compile(r'\b([a-z_]+)=(?=[\s,;:)]|$)')
"""An argument in an error, as in ``lower seconds=``; commands and nodes put their own name."""
MAX_MESSAGE = 1500  # characters of a message; names and values that it repeats may have any number


def printable(text: str) -> str:
    """Replace characters that would steer the terminal, as names in a file may hold them."""
    return ''.join(char if char.isprintable() else '?' for char in text)


def wrapped(text: str, width: int) -> str:
    """Break a text into lines, no word, path or number in two; those after the first indented."""
    text = printable(text)
    return textwrap.fill(text, width, subsequent_indent=' ' * (len(text) - len(text.lstrip()) + 2),
                         break_long_words=False, break_on_hyphens=False)


def complain(text: str) -> None:
    """Print on standard error: one line, but on a terminal as many as its width needs."""
    with suppress(OSError):  # standard error may lead to a full disk
        width = os.get_terminal_size(sys.stderr.fileno()).columns if sys.stderr.isatty() else 0
        print(wrapped(text, width or sys.maxsize), file=sys.stderr)


def forget_output() -> None:
    """Send what could not be written nowhere; the interpreter would try again at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def meant(word: str, known: Iterable[str]) -> str:
    """Ask for the known word that is most like a wrong one; empty if none is."""
    close = difflib.get_close_matches(word, list(known), 1, 0.7)
    return f' (did you mean {close[0]}?)' if close else ''


def remedy_of(err: BaseException) -> str:
    """Say what to do about a file or folder that cannot be opened, read or written."""
    return {errno.EINVAL: 'give another file', errno.EISDIR: 'give a file',
            errno.ENOSPC: 'free some space', errno.EACCES: 'change the rights of the file '
            'or folder, or give another path', errno.EEXIST: 'give another path',
            }.get(getattr(err, 'errno', None) or 0, 'check path, rights and disk')


def _one_line(text: str) -> str:
    return printable(' '.join(text.split()))


class TudorError(Exception):
    """
    Base of every error that this package raises on purpose.

    Its text is ``place: cause; remedy``, on one line of bounded length without control
    characters. Programs read the attributes, never the text.

    Parameters
    ----------
    cause : str
        What was found, and what was expected.
    place : str or Path, optional
        File, bag or part of them that the cause was found in.
    remedy : str, optional
        What to do.

    """

    def __init__(
        self, cause: str = '', *, place: str | Path | None = None, remedy: str = '',
    ) -> None:
        self.cause, self.place, self.remedy = _one_line(cause), place, _one_line(remedy)
        text = _one_line(self.advice if place is None else f'{place}: {self.advice}')
        super().__init__(text if len(text) <= MAX_MESSAGE else f'{text[:MAX_MESSAGE]}...')

    @property
    def advice(self) -> str:
        """Cause and remedy without the place, for where that is known."""
        return '; '.join(part for part in (self.cause, self.remedy) if part)

    def at(self, place: str | Path) -> TudorError:
        """Give the same error with the place of what was read; unchanged where it has one."""
        return self if self.place is not None else type(self)(
            self.cause, place=place, remedy=self.remedy)


class ArmError(TudorError, ValueError):
    """An arm description (YAML, URDF or D-H table) that cannot be used."""


class BagError(TudorError, ValueError):
    """A recording that cannot be read, or not for what was asked."""


class SignalError(TudorError, ValueError):
    """A signal or filter setting that cannot be processed."""


class FitError(TudorError, ValueError):
    """Data from which the model asked for cannot be identified."""


class ModelError(TudorError, ValueError):
    """A model bundle that is damaged, of another version, or of another arm."""


class NotFittedError(TudorError, ValueError, AttributeError):
    """A model that was asked to predict before it was fitted or loaded."""


class ScheduleError(TudorError, ValueError):
    """A schedule of gains that is damaged, or of another arm."""


class SimulationError(TudorError, RuntimeError):
    """A mechanism that cannot be simulated, or a run that diverged."""


class ProcessError(TudorError, RuntimeError):
    """A process that was ended from outside before its work was done."""


class UsageError(TudorError, ValueError):
    """A command line, or the arguments of a call, that contradict themselves."""


class ArgumentError(TudorError, TypeError):
    """An argument of a type that a function does not take."""


def check_type(value: object, wanted: type | tuple[type, ...], name: str, advice: str) -> None:
    """Refuse an argument of another type, before it fails far from where it was given."""
    if not isinstance(value, wanted):
        kinds = wanted if isinstance(wanted, tuple) else (wanted,)
        raise ArgumentError(f'{name} is {repr(value)[:60]} of type {type(value).__name__}; '
                            f'expected {" or ".join(kind.__name__ for kind in kinds)}: {advice}')


MAX_STEPS, MAX_BYTES = 2e7, 4e9
"""What one run may take at once: steps or samples, and memory of what is kept of them [bytes]."""


def check_budget(what: str, steps: float, each: float = 8.0,
                 remedy: str = 'lower seconds=, or raise dt=') -> None:
    """Refuse a run that nobody could wait for, or no memory holds: each [bytes a step]."""
    if not (steps <= MAX_STEPS and steps * each <= MAX_BYTES):
        over = (f'{1e-6 * steps:.3g} million steps, more than the limit of {1e-6 * MAX_STEPS:g} '
                'million' if not steps <= MAX_STEPS else
                f'{1e-9 * steps * each:.1f} GB of memory, more than the limit of '
                f'{1e-9 * MAX_BYTES:g} GB')
        raise UsageError(f'{what} needs {over}', remedy=remedy)


class TudorWarning(UserWarning):
    """Something in data or a model that the user should know of."""


@contextmanager
def quiet() -> Iterator[None]:
    """Keep warnings back, of what is reported otherwise."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', TudorWarning)
        yield
