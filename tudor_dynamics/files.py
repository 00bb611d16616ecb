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
Files of other people are read within bounds, own ones written whole or not at all.

A pipe may never speak and a device never end: only regular files are opened, and never more of
them is read than what was asked for can be. Whatever is wrong is an OSError that names the file.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
import errno
import os
from pathlib import Path
import shutil
import stat
import tempfile
from typing import BinaryIO


def _check_regular(status: os.stat_result, path: Path) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise OSError(errno.EISDIR, 'is a directory', str(path))
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, 'no regular file', str(path))


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading."""
    # Looked at before, as opening a device may do something; and after, as it may have changed.
    _check_regular(path.stat(), path)
    flags = os.O_RDONLY | getattr(os, 'O_NONBLOCK', 0) | getattr(os, 'O_CLOEXEC', 0)
    stream = os.fdopen(os.open(path, flags | getattr(os, 'O_BINARY', 0)), 'rb')
    try:
        _check_regular(os.fstat(stream.fileno()), path)
    except OSError:
        stream.close()
        raise
    return stream


def read_bounded(path: Path, limit: int) -> bytes:
    """Read a regular file of bounded size: limit [bytes]."""
    with open_regular(path) as stream:
        data = stream.read(limit + 1)
    if len(data) > limit:
        raise OSError(errno.EFBIG, f'larger than {limit} bytes', str(path))
    return data


def scratch_folder(path: Path) -> Path:
    """Make a hidden directory beside a path, in which it is written until it is complete."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return Path(tempfile.mkdtemp(dir=path.parent, prefix=scratch_prefix(path)))


def scratch_prefix(path: Path) -> str:
    """Begin of the name of the hidden directory."""
    return f'.{path.name}.'


@contextmanager
def whole(path: Path, *, replace: bool = True) -> Iterator[Path]:
    """Let a file or directory be written elsewhere first, so that nobody sees a part."""
    folder = None
    try:
        folder = scratch_folder(path)
        yield folder / path.name
        _put(folder / path.name, path, replace)
    except OSError as err:  # a full disk does not say of itself which file it was
        raise OSError(err.errno, err.strerror or str(err), str(path)) from None
    finally:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


def _put(new: Path, path: Path, replace: bool) -> None:
    """Give something its name; a directory in its place is kept until that has succeeded."""
    if not (replace and new.is_dir() and path.exists()):
        os.replace(new, path)
        return
    aside = Path(tempfile.mkdtemp(dir=path.parent, prefix=f'.{path.name}.old.'))
    old = aside / path.name
    try:
        os.replace(path, old)
        os.replace(new, path)
    except BaseException:
        if old.exists():
            os.replace(old, path)
        aside.rmdir()
        raise
    shutil.rmtree(aside, ignore_errors=True)


def write_whole(path: Path, data: bytes) -> None:
    """Write a file, whole or not at all."""
    with whole(path) as scratch:
        scratch.write_bytes(data)
        os.chmod(scratch, 0o644)


def write_directory(path: Path, files: Mapping[str, bytes]) -> None:
    """Write a directory of files, whole or not at all."""
    with whole(path) as scratch:
        scratch.mkdir()
        scratch.chmod(0o755)
        for name, data in files.items():
            (scratch / name).write_bytes(data)
