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
Files of a model bundle: bytes in, checked values out, and back.

Bundles are untrusted: reads are bounded and of regular files only, nothing is unpickled.
"""

from __future__ import annotations

import hashlib
import io
from pathlib import Path
from typing import Any
import zipfile
import zlib

import numpy as np
from tudor_dynamics import bounded_yaml, files
from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.storage.parts import HeadPart, read
from tudor_dynamics.typing import FloatArray
import yaml

MAX_BYTES = {'model.yaml': 20_000_000, 'arm.yaml': 2_000_000, 'arm.urdf': 20_000_000,
             'elm.npz': 200_000_000, 'data.npz': 200_000_000}
FORMAT = 'tudor_dynamics/model'
VERSION = 1
MARK = 'checksum: '
"""Begins the last line of ``model.yaml``, a checksum over all before it."""


class _Dumper(getattr(yaml, 'CSafeDumper', yaml.SafeDumper)):  # type: ignore[misc]
    """The fast safe dumper, without references between equal lists."""

    def ignore_aliases(self, data: object) -> bool:
        return True


def dump_yaml(content: Any) -> str:
    """
    Write plain values as YAML, without references.

    Parameters
    ----------
    content : dict
        Mapping of plain values.

    Returns
    -------
    str
        Text.

    """
    text: str = yaml.dump(content, Dumper=_Dumper, sort_keys=False, width=99,
                          allow_unicode=True, default_flow_style=None)
    return text


def load_yaml(text: str | bytes, file: Path) -> Any:
    """
    Read the YAML of a bundle.

    Parameters
    ----------
    text : str or bytes
        Text of the file.
    file : Path
        Where it came from, for messages.

    Returns
    -------
    object
        Plain values.

    Raises
    ------
    ModelError
        If it is no YAML, or stands for more than it may.

    """
    try:
        return bounded_yaml.load_yaml(text)
    except ValueError as err:
        raise ModelError(str(err), place=file, remedy='fit the model again') from None


def sha256(data: bytes) -> str:
    """
    Give the SHA-256 of bytes in hexadecimal digits.

    Parameters
    ----------
    data : bytes
        Content of a file.

    """
    return hashlib.sha256(data).hexdigest()


def dump_npz(arrays: dict[str, FloatArray]) -> bytes:
    """Write arrays as an npz archive."""
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def load_npz(data: bytes, file: Path) -> dict[str, FloatArray]:
    """
    Read arrays from an npz archive.

    Parameters
    ----------
    data : bytes
        Bytes of the archive.
    file : Path
        Where it came from, for messages.

    Returns
    -------
    dict of str to ndarray
        Arrays.

    Raises
    ------
    ModelError
        If it is no archive, unpacks to too much, or holds anything but numbers.

    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(item.file_size for item in archive.infolist()) > MAX_BYTES['elm.npz']:
                msg = 'unpacks to more than a model can have'
                raise ModelError(msg, place=file)
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except ModelError:
        raise
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, MemoryError, RuntimeError,
            TypeError, ValueError) as err:
        msg = f'no archive of numbers ({err}); fit the model again'
        raise ModelError(msg, place=file) from None
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray) or array.dtype.kind not in 'fiu':
            msg = (f'no archive of numbers ({name[:100]!r} holds others); fit the model '
                   'again')
            raise ModelError(msg, place=file)
    return {name: array.astype(float) for name, array in arrays.items()}


def read_file(path: Path, name: str) -> bytes:
    """
    Read one file of a bundle.

    Parameters
    ----------
    path : Path
        Directory of the bundle.
    name : str
        File in it, of `MAX_BYTES`.

    Returns
    -------
    bytes
        Content.

    Raises
    ------
    ModelError
        If it cannot be read, is larger than it may be, or is no file.

    """
    file = path / name
    try:
        return files.read_bounded(file, MAX_BYTES[name])
    except OSError as err:
        msg = f'cannot be read ({err.strerror}); expected a model bundle of tudor fit'
        raise ModelError(msg, place=file) from None


def write_directory(content: dict[str, bytes], path: Path) -> None:
    """
    Write a directory of files, whole or not at all, in place of one that may stand there.

    Parameters
    ----------
    content : dict of str to bytes
        Names and contents of the files.
    path : Path
        Directory to be made.

    Raises
    ------
    ModelError
        If it cannot be written; what stood there still stands then.

    """
    try:
        files.write_directory(path, content)
    except OSError as err:
        msg = f'cannot be written ({err.strerror or err}); choose another place'
        raise ModelError(msg, place=path) from None


def sealed(content: dict[str, Any]) -> bytes:
    """Give a head as a file: format and version before the content, its checksum behind."""
    body = dump_yaml({'format': FORMAT, 'version': VERSION, **content})
    return f'{body}{MARK}{sha256(body.encode())}\n'.encode()


def read_head(path: Path) -> HeadPart:
    """
    Read the head of a bundle.

    Parameters
    ----------
    path : Path
        Directory of the bundle.

    Returns
    -------
    HeadPart
        Arm, files, preprocessing, outputs and facts.

    Raises
    ------
    ModelError
        If it is not there, damaged, altered, or of another version.

    """
    file = path / 'model.yaml'
    try:
        text = read_file(path, 'model.yaml').decode()
    except UnicodeDecodeError:
        msg = f'{file}: no text; expected a model bundle of tudor fit'
        raise ModelError(msg) from None
    body, mark, checksum = text.rpartition(MARK)
    if not mark or checksum != f'{sha256(body.encode())}\n':
        msg = (f'{file}: altered or cut short (checksum differs); fit the model again instead of '
               'editing it')
        raise ModelError(msg)
    head = load_yaml(body, file)
    if not isinstance(head, dict) or head.get('format') != FORMAT:
        msg = f'{file}: not in the format {FORMAT!r}'
        raise ModelError(msg)
    if head.get('version') != VERSION:
        msg = (f'{file}: bundle version {head.get("version")!r}; this program reads version '
               f'{VERSION}: update tudor_dynamics, or fit the model again')
        raise ModelError(msg)
    try:
        return read(HeadPart, head)
    except ModelError as err:
        raise err.at(file) from None
