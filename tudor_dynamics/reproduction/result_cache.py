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
Stages of a long computation that are kept, and used again after an interruption.

The name of a stage's directory ends in a digest of all that its result depends on: settings, arm,
version of the package and the source of the parts that compute it, with what these parts share.
Another digest is another directory, so nothing out of date is ever taken for a result; what a
stage left behind under older digests is removed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import hashlib
import io
import json
from pathlib import Path
import shutil
from typing import Any

import numpy as np

from tudor_dynamics.errors import UsageError
from tudor_dynamics.models.storage.files import write_directory
from tudor_dynamics.source_digest import source_digest
from tudor_dynamics.typing import FloatArray

FOLDER = 'stages'
RECORDING = ('arm', 'bags', 'control', 'signals', 'simulation', 'reproduction/plan.py')
"""Parts of the package that a recording depends on."""
FITTING = (*RECORDING, 'models', 'payload', 'contact', 'identification', 'monitoring', 'doctor',
           'report', 'reproduction', 'excitation')
"""Parts that a fit and its figures depend on."""


@dataclass(frozen=True, eq=False)
class Cached:
    """
    What a stage came to.

    Attributes
    ----------
    content : dict
        Figures as plain values.
    arrays : dict of str to ndarray
        Signals by name.

    """

    content: dict[str, Any]
    arrays: dict[str, FloatArray]


class ResultCache:
    """
    Results of stages below a directory.

    Parameters
    ----------
    root : str or Path
        Directory, made where it is not there.

    """

    def __init__(self, root: str | Path) -> None:
        self.root = Path(root) / FOLDER
        if self.root.exists() and not self.root.is_dir():
            msg = f'{self.root}: is no directory; give another --out'
            raise UsageError(msg)
        self.root.mkdir(parents=True, exist_ok=True)

    def folder(self, name: str, depends: dict[str, Any], parts: tuple[str, ...]) -> Path:
        """
        Give the directory of a stage, which may not be there yet.

        Parameters
        ----------
        name : str
            Name of the stage.
        depends : dict
            Plain values that the result depends on.
        parts : tuple of str
            Parts of the package that it depends on.

        Returns
        -------
        Path
            Directory.

        """
        text = json.dumps({**depends, 'source': source_digest(parts)}, sort_keys=True)
        path = self.root / f'{name}-{hashlib.sha256(text.encode()).hexdigest()[:12]}'
        for other in self.root.glob(f'{name}-' + 12 * '[0-9a-f]'):
            if other != path:
                shutil.rmtree(other)
        return path

    def result(
        self,
        name: str,
        depends: dict[str, Any],
        make: Callable[[], Cached],
        parts: tuple[str, ...] = FITTING,
    ) -> Cached:
        """
        Compute a stage, or read what was computed before.

        Parameters
        ----------
        name : str
            Name of the stage.
        depends : dict
            Plain values that the result depends on.
        make : callable
            Computes the result where it is not kept.
        parts : tuple of str
            Parts of the package that it depends on.

        Returns
        -------
        Cached
            Values and signals.

        """
        path = self.folder(name, depends, parts)
        known = _read(path)
        if known is not None:
            return known
        found = make()
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **found.arrays)  # type: ignore[arg-type]
        text = json.dumps(found.content, indent=1, allow_nan=False)
        write_directory({'result.json': text.encode(), 'arrays.npz': buffer.getvalue()}, path)
        # what was written and read again, so that a second run sees the same
        return Cached(json.loads(text), found.arrays)


def _read(path: Path) -> Cached | None:
    """Read a stage; one that cannot be read is computed again."""
    try:
        content = json.loads((path / 'result.json').read_text(encoding='utf-8'))
        with np.load(path / 'arrays.npz', allow_pickle=False) as file:
            return Cached(content, {name: file[name] for name in file.files})
    except (OSError, ValueError, EOFError):
        return None
