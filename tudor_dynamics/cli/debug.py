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

"""One file with all that a bug report needs: versions, call, files, output, traceback."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import io
import os
from pathlib import Path
import shlex
import sys
import time
import traceback
from typing import Any, TextIO

from tudor_dynamics.cli.doctor import checks
from tudor_dynamics.files import read_bounded, write_whole
from tudor_dynamics.provenance import provenance

LONGEST = 1_000_000  # characters that are kept of the output


class _Copied:
    """A stream whose text is kept, too."""

    def __init__(self, stream: TextIO, kept: io.StringIO) -> None:
        self._stream, self._kept = stream, kept

    def write(self, text: str) -> int:
        if self._kept.tell() < LONGEST:
            self._kept.write(text)
        return self._stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def report(arguments: Sequence[str], output: str = '', ended: str = '') -> str:
    """Write what a bug report needs about a call, and about an exception that is handled."""
    files = [path for path in map(Path, arguments) if path.suffix in ('.yaml', '.urdf')
             and path.is_file() and os.access(path, os.R_OK) and path.stat().st_size < LONGEST]
    raised = traceback.format_exc() if sys.exc_info()[0] else ''
    return '\n'.join((
        *(f'{name}: {value}' for name, value in provenance().items()),
        *(f'{check.name}: {check.found}' for check in checks()), f'folder: {Path.cwd()}',
        f'call: {shlex.join(("tudor", *arguments))}', *filter(None, (ended, output, raised)),
        *(f'{path}:\n{read_bounded(path, LONGEST).decode(errors="replace")}' for path in files)))


def recorded(path: Path, arguments: Sequence[str], run: Callable[[], int]) -> int:
    """Run a command, and write what a bug report needs about it, however it ends."""
    said, begun, code = io.StringIO(), time.monotonic(), None
    streams = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (_Copied(stream, said) for stream in streams)  # type: ignore
    try:
        code = run()
        return code
    finally:
        sys.stdout, sys.stderr = streams
        ended = 'ended by the error below' if code is None else f'exit code: {code}'
        write_whole(path, report(arguments, said.getvalue(), f'{ended}, after '
                                 f'{time.monotonic() - begun:.1f} s').encode())
