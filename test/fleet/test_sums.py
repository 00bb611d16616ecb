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
from types import SimpleNamespace
from typing import Any

import pytest

from tudor_dynamics.identification import many_bags
from tudor_dynamics.identification.many_bags import forget, Summing

OLD, NEW = ('-'.join((24 * letter, 16 * letter)) + '.npz' for letter in 'ab')


def test_a_folder_keeps_what_is_used(tmp_path: Path) -> None:
    """What is of before goes, files of others stay."""
    for name in (OLD, NEW, 'notes.txt'):
        (tmp_path / name).write_bytes(b'one')
    forget(tmp_path, {NEW})
    assert sorted(file.name for file in tmp_path.iterdir()) == [NEW, 'notes.txt']


class _Bytes:
    @staticmethod
    def loaded(content: bytes) -> bytes:
        return content


class _Stored(Summing):
    form = _Bytes

    def name(self, seen: Any) -> str:
        return str(seen)


def test_what_is_too_large_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file that no bag can come to counts as none, as one that is not there: it is made."""
    monkeypatch.setattr(many_bags, 'LARGEST', 10)
    stored = _Stored(SimpleNamespace(store=tmp_path), ())  # type: ignore[arg-type]
    (tmp_path / OLD).write_bytes(b'x' * 11)
    (tmp_path / NEW).write_bytes(b'x' * 10)
    names: list[Any] = [OLD, NEW, 'none']
    assert [stored.found(name) for name in names] == [None, b'x' * 10, None]
