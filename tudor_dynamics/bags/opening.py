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

"""Open any rosbag2: directories with and without metadata, bare files, split bags."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

from tudor_dynamics.bags.finding import natural, SUFFIXES
from tudor_dynamics.bags.notes import Notes
from tudor_dynamics.bags.storage.mcap_summary import BreaksOff, mcap_topics
from tudor_dynamics.bags.storage.metadata import METADATA, Metadata, read_metadata
from tudor_dynamics.bags.storage.raw import Bag, one_line, storage_file, TopicInfo
from tudor_dynamics.bags.storage.sqlite_scan import sqlite_topics
from tudor_dynamics.bags.storage.unpacking import Damaged
from tudor_dynamics.errors import BagError
from tudor_dynamics.files import open_regular, scratch_prefix

HOT_JOURNAL = bytes.fromhex('d9d505f920a163d7')
"""Begin of a rollback journal that counts (https://www.sqlite.org/fileformat.html, 3)."""
MAX_TOPICS = 4096
MAX_NAME = 255
"""Characters in the name of a topic or type, as in DDS."""


def _topics(file: Path, compression: str | None, unfinished: set[Path]) -> list[TopicInfo]:
    """Give the topics of a file, which becomes one of the unfinished if it breaks off."""
    with storage_file(file, compression) as opened:
        read = {'.mcap': mcap_topics, '.db3': sqlite_topics}.get(opened.suffix)
        if read is None:
            raise Damaged(f'the suffix {opened.suffix!r} is neither .mcap nor .db3')
        try:
            listed = read(opened)
        except BreaksOff:
            # with metadata it was finished once: it is a bad copy
            bad_copy = (file.parent / METADATA).exists()
            listed = [] if bad_copy else mcap_topics(opened, unfinished=True)
            if not listed:
                raise
            unfinished.add(file)
        found = [TopicInfo(*item) for item in listed]
        if len(found) > MAX_TOPICS:
            raise Damaged(f'{len(found)} topics; at most {MAX_TOPICS} are read')
        for item in found:
            for text in (item.name, item.msgtype):
                if not (isinstance(text, str) and text.isprintable() and len(text) <= MAX_NAME):
                    raise Damaged(f'impossible topic entry {item}')
    return found


def _merge(found: Collection[TopicInfo]) -> dict[str, TopicInfo]:
    merged: dict[str, TopicInfo] = {}
    for item in found:
        known = merged.get(item.name)
        if known is None:
            merged[item.name] = item
            continue
        types = sorted({*known.msgtype.split(', '), item.msgtype})
        merged[item.name] = TopicInfo(item.name, ', '.join(types), known.count + item.count)
    return merged


def _storage_name(files: Collection[Path]) -> str:
    names = {'.db3': 'sqlite3', '.mcap': 'mcap'}
    suffixes = {Path(file.stem if file.suffix == '.zstd' else file.name).suffix for file in files}
    return ', '.join(sorted(names.get(suffix, suffix) for suffix in suffixes))


def _open_files(
    path: Path, files: tuple[Path, ...], notes: Notes, metadata: Metadata | None = None,
) -> Bag:
    compression = None if metadata is None else metadata.compression
    unfinished: set[Path] = set()
    for file in files:
        _check_leftovers(file, notes)
    topics = _merge([item for file in files for item in _topics(file, compression, unfinished)])
    for file in sorted(unfinished):
        notes.add(f'{file.name} breaks off: its recorder was killed; what is whole is read')
    if metadata is None:
        return Bag(path, _storage_name(files), files, topics, compression,
                   unfinished=frozenset(unfinished))
    announced = {name: replace(info, count=metadata.counts.get(name, info.count))
                 for name, info in topics.items()}
    return Bag(path, _storage_name(files), files, announced, compression, metadata.custom)


def _check_leftovers(file: Path, notes: Notes) -> None:
    """Look at what SQLite left beside a file that was not closed."""
    if file.suffix != '.db3':
        return
    wal, journal = (file.with_name(file.name + end) for end in ('-wal', '-journal'))
    if wal.is_file() and wal.stat().st_size > 0:
        notes.add(f'{wal.name} was never merged: the last messages may be missing; '
                  f'run `sqlite3 {file.name} "pragma wal_checkpoint"` on a copy')
    if not journal.is_file():
        return
    with open_regular(journal) as stream:
        # written before SQLite changes the file itself, whose pages may now be of two times
        if stream.read(len(HOT_JOURNAL)) == HOT_JOURNAL:
            msg = (f'{file}: its recorder was killed while it wrote, {journal.name} takes that '
                   f'back: run `sqlite3 {file.name} "pragma quick_check"` beside it, best '
                   'on a copy of the directory')
            raise BagError(msg)


def _open_directory(path: Path, notes: Notes) -> Bag:
    files = tuple(sorted((item for item in path.iterdir()
                          if item.suffix in SUFFIXES and item.is_file()), key=natural))
    if not (path / METADATA).exists():
        if not files:
            msg = (f'{path}: no bag in this directory (neither {METADATA} nor .mcap or .db3 '
                   'files); give the directory that `ros2 bag record` made')
            raise BagError(msg)
        notes.add(f'no {METADATA}; read {", ".join(file.name for file in files)} '
                  'in the order of their names')
        return _open_files(path, files, notes)
    try:
        metadata = read_metadata(path)
    except BagError as err:
        if not files:
            raise
        notes.add(f'{METADATA} cannot be used: {err.cause}; read '
                  f'{", ".join(file.name for file in files)} in the order of their names')
        return _open_files(path, files, notes)
    if metadata.doubled:
        notes.add(f'{METADATA} lists a file twice; read once')
    missed = [file.name for file in files if file not in metadata.files]
    if missed and not metadata.compression:
        notes.add(f'{", ".join(missed)} not listed in {METADATA} and not read')
    return _open_files(path, metadata.files, notes, metadata)


def open_bag(path: str | Path, notes: Notes | None = None) -> Bag:
    """Open a rosbag2."""
    path = Path(path)
    notes = Notes(str(path)) if notes is None else notes
    try:
        if path.name == METADATA and path.is_file():
            path = path.parent
        if path.is_dir():
            return _open_directory(path, notes)
        if path.is_file() and path.suffix in SUFFIXES:
            return _open_files(path, (path,), notes)
        exists = path.exists()
    except BagError:
        raise
    except (OSError, ValueError) as err:  # ValueError: a NUL in the path
        msg = f'{path}: cannot be read ({one_line(err)}); check path and permissions'
        raise BagError(msg) from None
    if not exists:
        msg = f'{path}: no such file or directory; give a rosbag2 directory, .mcap or .db3 file'
        left = abandoned(path)
        if left:
            msg += f' (a recorder that was killed left {", ".join(str(item) for item in left)})'
    elif path.suffix == '.bag':
        msg = f'{path}: a bag of ROS 1; convert it with `rosbags-convert --src {path} --dst OUT`'
    elif path.suffix == '.zstd':
        msg = f'{path}: a compressed file; give its directory, or unpack it with `zstd -d`'
    else:
        msg = f'{path}: not a bag; give a rosbag2 directory, .mcap or .db3 file'
    raise BagError(msg)


def abandoned(path: Path) -> list[Path]:
    """Give what recorders that were killed left of a bag."""
    try:
        return sorted(item / path.name for item in path.parent.iterdir()
                      if item.name.startswith(scratch_prefix(path))
                      and (item / path.name).is_dir())
    except OSError:
        return []
