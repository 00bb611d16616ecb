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

"""Open any rosbag2: metadata, split bags, bare files, and their raw messages."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
import hashlib
from pathlib import Path
import re
from typing import Any
import warnings

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.bags.mcap import McapFile
from tudor_dynamics.bags.sqlite import SqliteFile
from tudor_dynamics.errors import BagError, TudorWarning
from tudor_dynamics.files import (
    BreaksOff, Damaged, load_yaml, open_regular, read_bounded, scratch_prefix, unpacked_file,
    Unpacker, ZSTD_MAGIC)

# A bag is untrusted. Whatever its bytes are, what leaves this module is data or a BagError on one
# line that names the file, the cause and the remedy.

METADATA = 'metadata.yaml'
MAX_METADATA_BYTES = 10_000_000
MAX_VERSION = 9  # of Jazzy
STORAGES = {'.mcap': 'mcap', '.db3': 'sqlite3'}
"""Suffixes of storage files, and what their format is called."""


@dataclass(frozen=True)
class Metadata:
    """What the metadata say of a bag; where there are none, its files."""

    files: tuple[Path, ...]  # storage files in their order
    # What rosbag2 has compressed, chunks apart; None without metadata, so that each message has to
    # be looked at.
    compression: str | None = None
    counts: Mapping[str, int] = field(default_factory=dict)  # of the messages of each topic
    custom: Mapping[str, str] = field(default_factory=dict)  # what whoever recorded added
    doubled: bool = False  # whether a file was listed more than once


def read_metadata(directory: Path) -> Metadata:
    """Read the metadata of a bag."""
    try:
        content = load_yaml(read_bounded(directory / METADATA, MAX_METADATA_BYTES).decode())
        return _checked(directory, content['rosbag2_bagfile_information'])
    except OSError as err:
        cause = f'{METADATA} cannot be read ({err.strerror})'
    except (KeyError, IndexError) as err:
        cause = f'{METADATA} lacks the key {err}'
    except (AttributeError, TypeError, ValueError) as err:
        cause = ' '.join(str(err).split())[:300]
    raise BagError(cause, place=directory, remedy=f'check {METADATA} and the files beside it')


def _checked(directory: Path, information: dict[str, Any]) -> Metadata:
    version = information['version']
    if not isinstance(version, int) or version > MAX_VERSION:
        raise ValueError(f'the bag has format version {version!r}, expected {MAX_VERSION} or less')
    if information['storage_identifier'] not in STORAGES.values():
        raise ValueError(f'storage {information["storage_identifier"]!r} is unknown; known are '
                         f'{", ".join(STORAGES.values())}')
    compression = str(information.get('compression_mode') or '').lower().replace('none', '')
    if compression not in ('', 'file', 'message', 'storage'):
        raise ValueError(f'compression mode {compression!r} is unknown; known: file, message')
    if compression and information['compression_format'] != 'zstd':
        raise ValueError(f'it has the compression {information["compression_format"]!r}, not zstd')
    names = [Path(name).name for name in information['relative_file_paths']]
    files = tuple(directory / name for name in dict.fromkeys(names))
    for file in files:
        if not file.is_file():
            raise ValueError(f'{file.name} is {"not a file" if file.exists() else "missing"}')
    custom = information.get('custom_data')
    return Metadata(
        files, compression.replace('storage', ''), _counts(information),
        {str(key): str(value) for key, value in custom.items()}
        if isinstance(custom, dict) else {}, len(files) < len(names))


def _counts(information: dict[str, Any]) -> dict[str, int]:
    """Give the counts that are numbers; the storage has the last word on what there is."""
    counts: dict[str, int] = {}
    listed = information.get('topics_with_message_count')
    for item in listed if isinstance(listed, list) else []:
        try:
            name, count = item['topic_metadata']['name'], item['message_count']
            if isinstance(name, str) and isinstance(count, int) and count >= 0:
                counts[name] = counts.get(name, 0) + count
        except (KeyError, TypeError):
            continue
    return counts


DEEPEST = 4  # folders within folders that are looked into


def natural(path: Path) -> list[tuple[int, int, str]]:
    """Give what paths are sorted by: their names, numbers in them by their size."""
    return [(0, int(part), '') if part.isdecimal() else (1, 0, part)
            for part in re.split(r'([0-9]{1,18})', path.name)]


def bags_below(path: Path, deepest: int = DEEPEST) -> list[Path]:
    """Find the bags in a folder; the path itself where it is a bag, or has none below it."""
    if deepest == 0 or not path.is_dir() or _is_bag(path):
        return [path]
    found = []
    for item in sorted(path.iterdir(), key=natural):
        if item.is_dir() and not item.name.startswith('.'):
            found += [bag for bag in bags_below(item, deepest - 1) if _is_bag(bag)]
    return found or [path]


def _is_bag(path: Path) -> bool:
    return (path / METADATA).exists() or any(
        item.suffix in STORAGES and item.is_file() for item in path.iterdir())


class Notes:
    """What is implausible about a bag, collected while it is read; warns of each."""

    def __init__(self, path: str = '', *, quiet: bool = False) -> None:
        self.path = path
        self.texts: list[str] = []
        self.lacking: list[str] = []
        self._quiet = quiet

    def add(self, text: str, *, lacking: bool = False) -> None:
        """Note something, once; lacking: a reason why efforts or strains cannot be used."""
        if text in self.texts:
            return
        self.texts.append(text)
        if lacking:
            self.lacking.append(text)
        if not self._quiet:
            warnings.warn(f'{self.path}: {text}', TudorWarning, stacklevel=3)


REMEDIES = {
    '.db3': 'copy the file again, or save its messages by `sqlite3 FILE .recover | sqlite3 NEW`',
    '.mcap': 'copy the file again, or recover its messages with `mcap recover`',
}


@dataclass(frozen=True)
class TopicInfo:
    """A topic as the bag announces it: name, message type, number of messages."""

    name: str
    msgtype: str  # type of its messages
    count: int  # number of messages


@dataclass(frozen=True, eq=False)
class RawMessages:
    """Messages of one topic, undecoded, in the order of their log times."""

    # Name and type, e.g. `sensor_msgs/msg/JointState`.
    topic: str
    msgtype: str
    log_time: NDArray[np.int64]  # time at which each message was recorded, (n,) [ns]
    data: list[bytes]  # CDR buffers with encapsulation; empty if only times are wanted


@dataclass(frozen=True, eq=False)
class Bag:
    """A bag that could be opened."""

    path: Path  # what the user named
    notes: Notes  # what is implausible about it
    topics: Mapping[str, TopicInfo]  # what the bag announces
    metadata: Metadata
    unfinished: frozenset[Path]  # files that break off, because their recorder was killed

    @property
    def storage(self) -> str:
        """Name its formats: `mcap`, `sqlite3`, or both."""
        suffixes = {Path(file.stem if file.suffix == '.zstd' else file.name).suffix
                    for file in self.metadata.files}
        return ', '.join(sorted(STORAGES.get(suffix, suffix) for suffix in suffixes))

    def read(self, topics: Collection[str], *, with_data: bool = True) -> dict[str, RawMessages]:
        """Read raw messages; topics: a name that is not there is an empty topic."""
        for name in topics:
            if name in self.topics and ',' in self.topics[name].msgtype:
                msg = (f'{self.path}: topic {name} carries messages of several types '
                       f'({self.topics[name].msgtype}); remap one of them and record again')
                raise BagError(msg)
        packed = self.metadata.compression == 'message'
        times: dict[str, list[int]] = {name: [] for name in topics}
        data: dict[str, list[bytes]] = {name: [] for name in topics}
        for path in self.metadata.files:
            with self._opened(path) as (file, unpacker):
                for name, scan in file.read(tuple(topics), with_data=with_data).items():
                    times[name] += scan.log_time
                    data[name] += scan.data if unpacker is None else [
                        unpacker.unpack(message, 'zstd')  # no CDR begins like a compressed message
                        if packed or message[:4] == ZSTD_MAGIC else message
                        for message in scan.data]
        return {name: self._ordered(name, times[name], data[name]) for name in topics}

    @contextmanager
    def _opened(self, path: Path) -> Iterator[tuple[McapFile | SqliteFile, Unpacker | None]]:
        """Open a storage file; with what unpacks its messages, where they may be compressed."""
        compression = self.metadata.compression
        with storage_file(path, compression) as file:
            unpacker = Unpacker(file.stat().st_size)
            yield (_storage(file, unfinished=path in self.unfinished),
                   unpacker if compression in ('message', None) else None)

    def _ordered(self, name: str, times: list[int], data: list[bytes]) -> RawMessages:
        msgtype = self.topics[name].msgtype if name in self.topics else ''
        log_time = np.array(times, dtype=np.int64)
        if np.any(log_time[1:] < log_time[:-1]):
            order = np.argsort(log_time, kind='stable')
            log_time = log_time[order]
            data = [data[i] for i in order] if data else data
        return RawMessages(name, msgtype, log_time, data)

    def definitions(self, msgtype: str) -> list[str]:
        """Give what the bag says that a type of message is made of, file by file."""
        found = []
        for path in self.metadata.files:
            with self._opened(path) as (file, _):
                found += [text for kind, text in file.definitions().items()
                          if kind == msgtype and text]
        return found

    def find(self, wanted: Mapping[str, str]) -> dict[str, str | None]:
        """Find topics by their names in a description, with message types; None where missing."""
        found: dict[str, str | None] = {}
        for name, msgtype in wanted.items():
            relative = name.lstrip('/')
            known = [topic for topic in (name, f'/{relative}', relative) if topic in self.topics]
            if not known and not name.startswith('/'):
                known = sorted(topic for topic, info in self.topics.items()
                               if topic.endswith(f'/{relative}') and info.msgtype == msgtype)
                if len(known) > 1:
                    msg = (f'topic {name} is in several namespaces ({", ".join(known)}); write '
                           'one of them in full in the arm description')
                    raise BagError(msg, place=str(self.path))
            found[name] = known[0] if known else None
        return found

    def payload(self) -> float | None:
        """Give the mass at the tip as whoever recorded wrote it down [kg]."""
        text = self.metadata.custom.get('payload')
        if text is None:
            return None
        try:
            mass = float(text)
        except ValueError:
            mass = -1.0
        if not 0.0 <= mass < float('inf'):
            self.notes.add(f'{METADATA} has the payload {text[:40]!r}, which is not a mass in kg '
                           'and is ignored; correct it')
            return None
        return mass

    def checksum(self) -> str:
        """Give the SHA-256 over the storage files, one after the other."""
        digest = hashlib.sha256()
        for file in self.metadata.files:
            with storage_file(file), open_regular(file) as stream:
                while block := stream.read(1 << 20):
                    digest.update(block)
        return digest.hexdigest()


def one_line(err: BaseException) -> str:
    """Put the text of an exception on one line of bounded length."""
    text = ' '.join(str(err).split()) or 'no reason given'
    return text if len(text) <= 300 else text[:300] + '...'


@contextmanager
def storage_file(file: Path, compression: str | None = '') -> Iterator[Path]:
    """Give a storage file as it can be read; what goes wrong with it becomes a BagError."""
    remedy = REMEDIES.get(Path(file.stem if compression == 'file' else file.name).suffix,
                          'check the bag with `ros2 bag info`')
    try:
        with unpacked_file(file) if compression == 'file' else nullcontext(file) as opened:
            yield opened
    except OSError as err:
        msg = f'{file}: cannot be read ({err.strerror or err}); check file and permissions'
        raise BagError(msg) from None
    except (Damaged, MemoryError) as err:
        msg = f'{file}: damaged or not rosbag2 storage ({one_line(err)}); {remedy}'
        raise BagError(msg) from None


def _storage(file: Path, *, unfinished: bool = False) -> McapFile | SqliteFile:
    if file.suffix == '.mcap':
        return McapFile(file, unfinished=unfinished)
    if file.suffix == '.db3':
        return SqliteFile(file)
    raise Damaged(f'the suffix {file.suffix!r} is neither .mcap nor .db3')


HOT_JOURNAL = bytes.fromhex('d9d505f920a163d7')
"""Begin of a rollback journal that counts (https://www.sqlite.org/fileformat.html, 3)."""
MAX_TOPICS = 4096
MAX_NAME = 255  # characters in the name of a topic or type, as in DDS


def _topics(file: Path, compression: str | None, unfinished: set[Path]) -> list[TopicInfo]:
    """Give the topics of a file, which becomes one of the unfinished if it breaks off."""
    with storage_file(file, compression) as opened:
        try:
            listed = _storage(opened).topics()
        except BreaksOff:
            # with metadata it was finished once: it is a bad copy
            bad_copy = (file.parent / METADATA).exists()
            listed = [] if bad_copy else _storage(opened, unfinished=True).topics()
            if not listed:
                raise
            unfinished.add(file)
        found = [TopicInfo(*item) for item in listed]
        if len(found) > MAX_TOPICS:
            raise Damaged(f'{len(found)} topics; at most {MAX_TOPICS} are read')
        for item in found:
            for text in (item.name, item.msgtype):
                if not (isinstance(text, str) and text.isprintable() and len(text) <= MAX_NAME):
                    raise Damaged(f'name or type of a topic cannot be right: {item}')
    return found


def _open_files(path: Path, notes: Notes, metadata: Metadata) -> Bag:
    topics, unfinished = dict[str, TopicInfo](), set[Path]()
    for file in metadata.files:
        _check_leftovers(file, notes)
    for file in metadata.files:
        for item in _topics(file, metadata.compression, unfinished):
            known = topics.get(item.name)
            if known is not None:
                types = sorted({*known.msgtype.split(', '), item.msgtype})
                item = TopicInfo(item.name, ', '.join(types), known.count + item.count)
            topics[item.name] = item
    for file in sorted(unfinished):
        notes.add(f'{file.name} breaks off, as its recorder was killed; whole messages are read')
    announced = {name: replace(info, count=metadata.counts.get(name, info.count))
                 for name, info in topics.items()}
    return Bag(path, notes, announced, metadata, frozenset(unfinished))


def _check_leftovers(file: Path, notes: Notes) -> None:
    """Look for journals of SQLite next to a file that was not closed."""
    if file.suffix != '.db3':
        return
    wal, journal = (file.with_name(file.name + end) for end in ('-wal', '-journal'))
    if wal.is_file() and wal.stat().st_size > 0:
        notes.add(f'the last messages may be missing, as {wal.name} was never merged; '
                  f'run `sqlite3 {file.name} "pragma wal_checkpoint"` on a copy')
    if not journal.is_file():
        return
    with open_regular(journal) as stream:
        # written before SQLite changes the file itself, whose pages may now be of two times
        if stream.read(len(HOT_JOURNAL)) == HOT_JOURNAL:
            raise BagError(f'{file}: the recorder was killed while it wrote, as {journal.name} '
                           f'shows; copy the directory, run `sqlite3 {file.name} "pragma '
                           'quick_check"` in the copy, which undoes that write, and use the copy')


def _open_directory(path: Path, notes: Notes) -> Bag:
    files = tuple(sorted((item for item in path.iterdir()
                          if item.suffix in STORAGES and item.is_file()), key=natural))
    metadata, cause = Metadata(files), f'{METADATA} is missing'
    if (path / METADATA).exists():
        try:
            metadata, cause = read_metadata(path), ''
        except BagError as err:
            if not files:
                raise
            cause = f'{METADATA} cannot be used ({err.cause})'
    elif not files:
        raise BagError(f'{path}: no bag in this directory (neither {METADATA} nor .mcap or .db3 '
                       'files); give the directory that `ros2 bag record` made')
    if cause:
        notes.add(f'{cause}; so the files {", ".join(file.name for file in files)} are read in '
                  'the order of their names')
    if metadata.doubled:
        notes.add(f'{METADATA} lists a file twice, which is read once')
    missed = [file.name for file in files if file not in metadata.files]
    if missed and not metadata.compression:
        notes.add(f'{", ".join(missed)} is not read, as {METADATA} does not list it')
    return _open_files(path, notes, metadata)


def open_bag(path: str | Path, *, quiet: bool = False) -> Bag:
    """Open a rosbag2; quiet: its notes are kept, but no warnings."""
    path, notes = Path(path), Notes(str(path), quiet=quiet)
    try:
        if path.name == METADATA and path.is_file():
            path = path.parent
        if path.is_dir():
            return _open_directory(path, notes)
        if path.is_file() and path.suffix in STORAGES:
            return _open_files(path, notes, Metadata((path,)))
        exists = path.exists()
    except BagError:
        raise
    except (OSError, ValueError) as err:  # ValueError: a NUL in the path
        msg = f'{path}: cannot be read ({one_line(err)}); check path and permissions'
        raise BagError(msg) from None
    if not exists:
        left = ', '.join(repr(str(item)) for item in abandoned(path))
        found = f'a killed recorder left {left}; give that, or' if left else 'give'
        msg = f'{path}: no such file or directory; {found} a rosbag2 directory, .mcap or .db3 file'
    elif path.suffix == '.bag':
        msg = f'{path}: a bag of ROS 1; convert it with `rosbags-convert --src {path} --dst OUT`'
    elif path.suffix == '.zstd':
        msg = f'{path}: a compressed file; give its directory, or unpack it with `zstd -d`'
    else:
        msg = f'{path}: not a bag; give a rosbag2 directory, .mcap or .db3 file'
    raise BagError(msg)


def abandoned(path: Path) -> list[Path]:
    """Give what recorders that were killed have kept of a bag."""
    try:
        return sorted(item / path.name for item in path.parent.iterdir()
                      if item.name.startswith(scratch_prefix(path))
                      and (item / path.name).is_dir())
    except OSError:
        return []


@dataclass(frozen=True, eq=False)
class Track:
    """All messages of a bag in the order in which they were recorded."""

    topics: dict[str, str]  # topic to message type
    time: NDArray[np.int64]  # log times, (n,) [ns]
    topic: list[str]  # topic of each message
    data: list[bytes]  # messages as CDR buffers


def read_track(path: str | Path, topics: Collection[str] = ()) -> Track:
    """Read a bag for replay; topics: all by default."""
    bag = open_bag(path)
    wanted = [name if name.startswith('/') else f'/{name}' for name in topics]
    missing = [name for name in wanted if name not in bag.topics]
    if missing:
        msg = (f'{path}: no topic {", ".join(missing)}; it has {", ".join(sorted(bag.topics))}')
        raise BagError(msg)
    found = bag.read(wanted or list(bag.topics))
    time = np.concatenate([np.empty(0, np.int64), *(raw.log_time for raw in found.values())])
    if not len(time):
        raise BagError(f'{path}: no messages; record again with the drivers running')
    order = np.argsort(time, kind='stable').tolist()
    names = [name for name, raw in found.items() for _ in raw.data]
    data = [item for raw in found.values() for item in raw.data]
    return Track({name: raw.msgtype for name, raw in found.items()}, time[order],
                 [names[i] for i in order], [data[i] for i in order])
