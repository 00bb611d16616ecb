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

"""Head of a model bundle, ``model.yaml``: readable, with a checksum over itself as last line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.bundle_files import dump_yaml, load_yaml, read_file, sha256

FORMAT = 'tudor_dynamics/model'
VERSION = 1
MARK = 'checksum: '


def sealed(content: dict[str, Any]) -> bytes:
    """Give a head as a file: format and version before the content, its checksum behind."""
    body = dump_yaml({'format': FORMAT, 'version': VERSION, **content})
    return f'{body}{MARK}{sha256(body.encode())}\n'.encode()


def read_head(path: Path) -> dict[str, Any]:
    """
    Read the head of a bundle.

    Parameters
    ----------
    path : Path
        Directory of the bundle.

    Returns
    -------
    dict
        With arm, files, preprocessing and outputs, each of them a dictionary.

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
    for key in ('arm', 'files', 'preprocessing', 'outputs'):
        if not isinstance(head.get(key), dict):
            msg = f'{file}: the part {key!r} is missing; fit the model again'
            raise ModelError(msg)
    return head
