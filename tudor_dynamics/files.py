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

import errno
import os
from pathlib import Path
import stat
import tempfile
from typing import BinaryIO


def _check_regular(status: os.stat_result, path: Path) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise OSError(errno.EISDIR, 'is a directory', str(path))
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, 'no regular file', str(path))


def open_regular(path: Path) -> BinaryIO:
    """
    Open a regular file for reading.

    Parameters
    ----------
    path : Path
        File to open.

    Returns
    -------
    BinaryIO
        Open file.

    Raises
    ------
    OSError
        If it cannot be opened, or is a pipe, a device, a socket or a directory.

    """
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
    """
    Read a regular file of bounded size.

    Parameters
    ----------
    path : Path
        File to read.
    limit : int
        Largest size [bytes].

    Returns
    -------
    bytes
        Content.

    Raises
    ------
    OSError
        If it cannot be read, is no regular file, or larger.

    """
    with open_regular(path) as stream:
        data = stream.read(limit + 1)
    if len(data) > limit:
        raise OSError(errno.EFBIG, f'larger than {limit} bytes', str(path))
    return data


def write_whole(path: Path, data: bytes) -> None:
    """
    Write a file under another name first, so that nobody ever sees a part of it.

    Parameters
    ----------
    path : Path
        File; one that is there is replaced. Its directory is made.
    data : bytes
        Content of the file.

    Raises
    ------
    OSError
        If it cannot be written; what was there is there still, and nothing else.

    """
    scratch = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, scratch = tempfile.mkstemp(dir=path.parent, prefix=f'.{path.name}.')
        with os.fdopen(handle, 'wb') as stream:
            stream.write(data)
        os.chmod(scratch, 0o644)
        os.replace(scratch, path)
    except BaseException as err:
        if scratch is not None:
            Path(scratch).unlink(missing_ok=True)
        if isinstance(err, OSError):  # a full disk does not say of itself which file it was
            raise OSError(err.errno, err.strerror or str(err), str(path)) from None
        raise
