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

"""Sums on disk."""

from __future__ import annotations

from pathlib import Path

import pytest

from tudor_dynamics.identification import passes
from tudor_dynamics.identification.passes import Folder

OLD, NEW = ('-'.join((24 * letter, 16 * letter)) + '.npz' for letter in 'ab')


def test_a_folder_keeps_what_is_used(tmp_path: Path) -> None:
    """It is made where it is not; what is of before goes, files of others stay."""
    folder = Folder(tmp_path / 'model.sums')
    assert folder.read(OLD) is None
    for content in (b'one', b'another'):
        for name in (OLD, NEW, 'notes.txt'):
            folder.write(name, content)
        assert folder.read(NEW) == content
    folder.forget({NEW})
    assert sorted(file.name for file in folder.path.iterdir()) == [NEW, 'notes.txt']


def test_what_is_too_large_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file that no bag can come to counts as none: it is made again."""
    monkeypatch.setattr(passes, 'LARGEST', 10)
    folder = Folder(tmp_path)
    folder.write(OLD, b'x' * 11)
    folder.write(NEW, b'x' * 10)
    assert folder.read(OLD) is None and folder.read(NEW) == b'x' * 10
