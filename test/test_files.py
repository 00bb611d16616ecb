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

"""Reading regular files within bounds, writing files whole."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from tudor_dynamics import files
from tudor_dynamics.files import open_regular, read_bounded, whole, write_directory, write_whole


def test_regular_files_are_read(tmp_path: Path) -> None:
    """A file up to the limit comes whole, a larger one not at all."""
    file = tmp_path / 'a'
    file.write_bytes(b'12345')
    assert read_bounded(file, 5) == b'12345'
    with pytest.raises(OSError, match='larger than 4 bytes') as caught:
        read_bounded(file, 4)
    assert caught.value.filename == str(file)


@pytest.mark.parametrize('kind', ['pipe', 'device', 'directory', 'link to a device'])
def test_nothing_else_is_opened(tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch,
                                ) -> None:
    """A pipe without a writer, an endless device and a directory are refused before opening."""
    path = {'device': Path('/dev/zero'), 'directory': tmp_path}.get(kind, tmp_path / 'x')
    if kind == 'pipe':
        os.mkfifo(path)
    elif kind == 'link to a device':
        path.symlink_to('/dev/zero')

    def opened(*_: object) -> int:
        raise AssertionError('opened')
    monkeypatch.setattr(files.os, 'open', opened)
    with pytest.raises(OSError, match='directory' if kind == 'directory' else 'it is a device'):
        open_regular(path)


def test_a_pipe_that_takes_the_place_of_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What has changed between looking and opening is seen, too, without waiting for a writer."""
    pipe, file = tmp_path / 'pipe', tmp_path / 'file'
    os.mkfifo(pipe)
    file.write_bytes(b'')
    status = file.stat()
    monkeypatch.setattr(Path, 'stat', lambda _: status)
    with pytest.raises(OSError, match='it is a device'):
        open_regular(pipe)


def test_written_whole(tmp_path: Path) -> None:
    """A file is made with its directory, and replaced."""
    for data in (b'one', b'two'):
        write_whole(tmp_path / 'new' / 'a', data)
        assert (tmp_path / 'new' / 'a').read_bytes() == data
    assert (tmp_path / 'new' / 'a').stat().st_mode & 0o777 == 0o644
    assert [item.name for item in (tmp_path / 'new').iterdir()] == ['a']


def test_what_cannot_be_written_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A full disk, an interrupt and a directory in the way leave no scratch file."""
    (tmp_path / 'a').mkdir()
    with pytest.raises(IsADirectoryError):
        write_whole(tmp_path / 'a', b'x')
    for error in (OSError(errno.ENOSPC, 'No space left on device'), KeyboardInterrupt()):
        def fail(*_: object, error: BaseException = error) -> None:
            raise error
        with monkeypatch.context() as patch:
            patch.setattr(files.os, 'chmod', fail)
            with pytest.raises(type(error)) as caught:
                write_whole(tmp_path / 'b', b'x')
        assert getattr(caught.value, 'filename', str(tmp_path / 'b')) == str(tmp_path / 'b')
    assert [item.name for item in tmp_path.iterdir()] == ['a']


def test_full_disk(small_disk: Path) -> None:
    """On a disk that is really full the old file stays, and the error names it."""
    write_whole(small_disk / 'a', b'old')
    with pytest.raises(OSError, match='No space left') as caught:
        write_whole(small_disk / 'a', bytes(1_000_000))
    assert caught.value.filename == str(small_disk / 'a')
    assert [item.read_bytes() for item in small_disk.iterdir()] == [b'old']


def test_directory_in_place_of_another(tmp_path: Path) -> None:
    """A directory is replaced as a whole, and only where that is wanted."""
    write_directory(tmp_path / 'a', {'old': b'1', 'both': b'2'})
    write_directory(tmp_path / 'a', {'new': b'3', 'both': b'4'})
    assert {item.name: item.read_bytes() for item in (tmp_path / 'a').iterdir()} == {
        'new': b'3', 'both': b'4'}
    with pytest.raises(OSError, match='not empty') as caught, \
            whole(tmp_path / 'a', replace=False) as scratch:
        scratch.mkdir()
        (scratch / 'other').write_bytes(b'')
    assert caught.value.filename == str(tmp_path / 'a')
    assert sorted(item.name for item in (tmp_path / 'a').iterdir()) == ['both', 'new']
    assert [item.name for item in tmp_path.iterdir()] == ['a']
