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

"""Arrays or live messages become a rosbag2: the whole bag or nothing."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO, FileIO
from operator import itemgetter
from pathlib import Path
import shutil
import sqlite3
from types import SimpleNamespace
from typing import Any, cast, Literal

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

from tudor_dynamics.arm.description import Arm, by_topic, refuse_interfaces
from tudor_dynamics.bags.messages import (
    FIELDS, IMU, joint_signals, JOINT_STATE, LAYOUTS, Signals, WRENCH_STAMPED)
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.storage import METADATA, one_line, RawMessages
from tudor_dynamics.errors import BagError, check_type, remedy_of
from tudor_dynamics.files import check_target, scratch_folder, whole


# rosbags writes a bag for those who finish it. MCAP keeps up to a megabyte in memory, SQLite all
# of the bag in one transaction; whoever is killed before the end has nothing, and whoever meets a
# full disk has half a record at the end of the file. Here, what was saved stays.

class WholeFile(FileIO):
    """A file without buffer that writes all or raises; a buffer would keep what failed."""

    def write(self, data: Any) -> int:
        """Write all bytes; a disk that becomes full takes some of them first."""
        rest = memoryview(data)
        while rest:
            rest = rest[self._some(rest):]
        return len(data)

    def _some(self, data: memoryview) -> int:
        return super().write(data)


class McapSaver:
    """MCAP: a chunk is ended, and the file cut after the last whole one."""

    def __init__(self, writer: Any) -> None:
        self._storage = storage = writer.storage
        storage.bio.close()
        storage.bio = WholeFile(storage.path, 'r+')
        storage.bio.seek(0, 2)
        self._new_chunk = type(storage.chunk)
        self._mark()

    def _mark(self) -> None:
        storage = self._storage
        self._saved = (storage.bio.tell(), len(storage.chunks), dict(storage.channel_stats),
                       storage.message_start_time, storage.message_end_time)

    def save(self) -> None:
        """End the chunk."""
        if self._storage.chunk.msgs:
            self._storage.close_chunk()
        self._mark()

    def restore(self) -> None:
        """Cut the file."""
        storage = self._storage
        end, chunks, counts, first, last = self._saved
        storage.bio.seek(end)
        storage.bio.truncate()
        del storage.chunks[chunks:]
        storage.channel_stats = dict.fromkeys(storage.channel_stats, 0) | counts
        storage.message_start_time, storage.message_end_time = first, last
        storage.chunk = self._new_chunk(2**63 - 1, 0, BytesIO(), defaultdict(list))


def sqlite_saver(writer: Any) -> SimpleNamespace:
    """SQLite: a transaction is ended, or taken back."""
    connection = writer.storage.conn
    # what is not saved stays out of the file: a killed process leaves it whole
    connection.execute('PRAGMA cache_spill = OFF')
    return SimpleNamespace(save=connection.commit, restore=connection.rollback)


PLUGINS = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}
METADATA_VERSION: Literal[9] = 9  # of metadata.yaml, as Jazzy writes it
FAILURES = (OSError, sqlite3.Error)
"""What a storage raises where the disk takes no more; SQLite has its own way."""


def reason(err: Exception) -> str:
    """Say why something could not be written."""
    return (err.strerror or str(err)) if isinstance(err, OSError) else one_line(err)


# All messages of a topic have one layout, or few. rosbags encodes one of each, its numbers are
# found by the parser that also reads bags, and the columns are written over copies of it: in an
# eighth of the time that rosbags takes for all (bench/read_bags.py).

def encode(signals: Signals) -> RawMessages:
    """Encode messages, each recorded at its stamp."""
    stamp = np.asarray(signals.stamp, dtype=np.int64)
    if len(stamp) and not 0 <= int(stamp.min()) <= int(stamp.max()) < 2**31 * 10**9:
        raise BagError(f'{signals.topic}: stamps from {stamp.min() / 1e9:.6g} to '
                       f'{stamp.max() / 1e9:.6g} s; ROS 2 takes 0 to 2**31 s: correct them')
    data = [b''] * len(stamp)
    frames = np.full(len(stamp), signals.frame, dtype=object)
    for frame in set(frames.tolist()) or {''}:
        rows, template = np.flatnonzero(frames == frame), _template(signals, frame)
        layout = LAYOUTS[signals.msgtype](template)
        messages = np.tile(np.frombuffer(template, dtype=np.uint8), (len(rows), 1))
        layout.times(messages)[:] = np.column_stack(np.divmod(stamp[rows], 1_000_000_000))
        for field, values in signals.values.items():
            expected = (len(stamp), layout.fields[field][1])
            if np.shape(values) != expected:
                msg = f'{signals.topic}: {field} has shape {np.shape(values)}, not {expected}'
                raise BagError(msg)
            layout.numbers(messages, *layout.fields[field])[:] = values[rows]
        for row, message in zip(rows.tolist(), messages, strict=True):
            data[row] = message.tobytes()
    return RawMessages(signals.topic, signals.msgtype, stamp, data)


def _template(signals: Signals, frame: str) -> bytes:
    """Encode a message of zeros."""
    typestore = get_typestore(Stores.ROS2_JAZZY)
    kinds = typestore.types
    header = kinds['std_msgs/msg/Header'](kinds['builtin_interfaces/msg/Time'](0, 0), frame)
    vector = kinds['geometry_msgs/msg/Vector3'](0.0, 0.0, 0.0)
    unknown = np.zeros(9)
    parts: dict[str, tuple[Any, ...]] = {
        JOINT_STATE: (list(signals.names), *(
            np.zeros(len(signals.names) if field in signals.values else 0) for field in FIELDS)),
        WRENCH_STAMPED: (kinds['geometry_msgs/msg/Wrench'](vector, vector),),
        IMU: (kinds['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 0.0), unknown,
              vector, unknown, vector, unknown)}
    message = kinds[signals.msgtype](header, *parts[signals.msgtype])
    return bytes(typestore.serialize_cdr(message, signals.msgtype))


def write_bag(
    path: str | Path, series: Sequence[Signals | RawMessages] | Recording, *,
    arm: Arm | None = None, storage: str = 'mcap', custom: Mapping[str, str] | None = None,
    overwrite: bool = False,
) -> None:
    """
    Write a rosbag2 directory, messages in the order of their log times.

    It appears only when it is complete. Signals are recorded at their stamps.

    Parameters
    ----------
    path : str or Path
        Directory to be made.
    series : sequence of Signals or RawMessages, or Recording
        What each topic holds, such as ``joint_signals`` gives.
    arm : Arm, optional
        On whose topics a recording is laid out.
    storage : {'mcap', 'sqlite3'}
        Format of the messages.
    custom : mapping of str to str, optional
        For ``custom_data`` of the metadata, such as ``payload`` [kg].
    overwrite : bool, default=False
        Replace a bag that stands there. Anything else is never replaced.

    Raises
    ------
    BagError, ArgumentError
        If the path exists or cannot be written, the storage is unknown, or a recording has no arm.

    """
    if isinstance(series, Recording):
        check_type(arm, Arm, 'arm', 'a recording knows no topics')
        series = recording_series(series, cast(Arm, arm))
    write_messages(path, _in_order(series), storage=storage, custom=custom, overwrite=overwrite,
                   topics=[*dict.fromkeys((item.topic, item.msgtype) for item in series)])


def _in_order(series: Sequence[Signals | RawMessages]) -> Iterator[tuple[int, str, str, bytes]]:
    """Encode what is not yet, once it is asked for, and give all messages by their log times."""
    topics = [encode(item) if isinstance(item, Signals) else item for item in series]
    yield from sorted(((time, item.topic, item.msgtype, data) for item in topics for time, data in
                       zip(item.log_time.tolist(), item.data, strict=True)), key=itemgetter(0))


def write_messages(
    path: str | Path, messages: Iterable[tuple[int, str, str, bytes]], *, storage: str = 'mcap',
    custom: Mapping[str, str] | None = None, topics: Iterable[tuple[str, str]] = (),
    overwrite: bool = False,
) -> None:
    """Write a bag of messages in their order: time [ns], topic, type, data; topics: also empty."""
    path = Path(path)
    if storage not in PLUGINS:
        raise BagError(f'{path}: storage {storage!r} is unknown; use one of {", ".join(PLUGINS)}')
    check_target(path, overwrite=overwrite, name='path', mark=METADATA, kind=BagError)
    typestore = get_typestore(Stores.ROS2_JAZZY)
    try:
        with whole(path, replace=overwrite) as scratch, Writer(
                scratch, version=METADATA_VERSION, storage_plugin=PLUGINS[storage]) as writer:
            for key, value in (custom or {}).items():
                writer.set_custom_data(key, value)
            known = {item: writer.add_connection(*item, typestore=typestore) for item in topics}
            for time, topic, msgtype, data in messages:
                item = topic, msgtype
                if item not in known:
                    known[item] = writer.add_connection(*item, typestore=typestore)
                writer.write(known[item], time, data)
    except FAILURES as err:
        raise BagError(f'{path}: cannot be written ({reason(err)}); {remedy_of(err)}') from None


def recording_series(recording: Recording, arm: Arm) -> list[Signals]:
    """Lay a recording out on the topics of its arm: joint states, efforts, strains."""
    refuse_interfaces(arm, 'a bag that is written here')
    stamp, joints = recording.stamp, arm.active_joints
    efforts, own, elsewhere = recording.effort, None, []
    if efforts is not None:
        for topic, chosen in by_topic(joint.effort for joint in arm.joints).items():
            if topic == arm.spec.joint_topic:
                # An array of JointState is as long as name: efforts from elsewhere are NaN here.
                own = np.full(efforts.shape, np.nan)
                own[:, chosen] = efforts[:, chosen]
            else:
                elsewhere.append(joint_signals(
                    _full(topic), stamp, [joints[i] for i in chosen], effort=efforts[:, chosen]))
    result = [joint_signals(_full(arm.spec.joint_topic), stamp, joints, recording.q, recording.dq,
                            own), *elsewhere]
    if recording.strain is not None:
        for topic, chosen in by_topic(arm.gauges).items():
            result.append(joint_signals(_full(topic), stamp, [arm.gauge_names[i] for i in chosen],
                                        recording.strain[:, chosen]))
    return result


def _full(topic: str) -> str:
    return topic if topic.startswith('/') else f'/{topic}'


RESERVE, RESERVED = 'reserve', 1 << 20  # file and bytes that are kept for index and metadata


class LiveWriter:
    """
    Writes messages as they come; the bag appears under its name when it is closed.

    Until then it lies in a hidden directory beside. What was saved there can be read whatever
    becomes of the process, see `open_bag`. A disk that becomes full ends the bag with what was
    saved: room for that is kept from the start.
    """

    def __init__(self, path: str | Path, storage: str = 'mcap') -> None:
        self.path = Path(path)
        check_target(self.path, overwrite=None, name='path', kind=BagError)
        scratch: Path | None = None
        try:
            scratch = scratch_folder(self.path)
            (scratch / RESERVE).write_bytes(bytes(RESERVED))
            writer = Writer(scratch / self.path.name, version=METADATA_VERSION,
                            storage_plugin=PLUGINS[storage])
            writer.open()
            self._writer: Any = writer
            self._saver = (McapSaver if storage == 'mcap' else sqlite_saver)(writer)
            self._mark()
        except FAILURES as err:
            if scratch is not None:
                shutil.rmtree(scratch, ignore_errors=True)
            msg = f'{path}: cannot be written ({reason(err)}); {remedy_of(err)}'
            raise BagError(msg) from None
        self._scratch = scratch
        self._typestore = get_typestore(Stores.ROS2_JAZZY)
        self._connections: dict[str, object] = {}
        self._open = True

    @property
    def count(self) -> int:
        """Messages written."""
        return sum(self._writer.counts.values())

    def add(self, topic: str, msgtype: str) -> bool:
        """Announce a topic; False for a type that this program does not know."""
        if topic not in self._connections:
            if msgtype not in self._typestore.types:
                return False
            with self._ending():
                self._connections[topic] = self._writer.add_connection(
                    topic, msgtype, typestore=self._typestore)
                self._save()
        return True

    def write(self, topic: str, time: int, data: bytes) -> None:
        """Write a message of a topic that was announced: time [ns]."""
        with self._ending():
            self._writer.write(self._connections[topic], time, data)

    def save(self) -> None:
        """Bring what was written to disk, where it outlives the process."""
        with self._ending():
            self._save()

    def _save(self) -> None:
        self._saver.save()
        self._mark()

    def _mark(self) -> None:
        """Remember what the metadata say of what was saved."""
        writer = self._writer
        self._saved = dict(writer.counts), writer.min_timestamp, writer.max_timestamp

    def close(self) -> None:
        """Finish the bag and give it its name; without any message there is none."""
        if self._open:
            self.save()
        if self._open:
            self._finish('')

    @contextmanager
    def _ending(self) -> Iterator[None]:
        """End the bag with what was saved if the disk takes no more."""
        try:
            yield
        except FAILURES as err:
            self._finish(f'cannot be written any more ({reason(err)})')

    def _finish(self, failure: str) -> None:
        """Finish the bag, and raise what has failed."""
        self._open = False
        made = self._scratch / self.path.name
        try:
            (self._scratch / RESERVE).unlink()
            if failure:  # what was written after it was last saved is forgotten
                self._saver.restore()
                counts, first, last = self._saved
                self._writer.counts = dict.fromkeys(self._writer.counts, 0) | counts
                self._writer.min_timestamp, self._writer.max_timestamp = first, last
            count = self.count
            try:
                self._writer.close()
            except FAILURES as err:
                failure = failure or f'cannot be finished ({reason(err)})'
                self._writer.abort()
                (made / 'metadata.yaml.tmp').unlink(missing_ok=True)
            if count:
                made.rename(self.path)
            shutil.rmtree(self._scratch, ignore_errors=True)
        except FAILURES as err:
            raise BagError(f'{self.path}: {failure or "cannot be finished"}; copy the folder '
                           f'{made}, which keeps the messages ({reason(err)})') from None
        if failure:
            msg = (f'{self.path}: {failure}; recording has ended, and the {count} messages that '
                   'were on the disk are kept; free some space, and record under another name')
            raise BagError(msg)
