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
sqlite3 files: their topics, and raw messages of chosen ones.

rosbags reads them no slower, but nothing there bounds what a file of a few kilobytes makes SQLite
do (tables that compute what they hold, rows without end, messages of gigabytes).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
import sqlite3
from urllib.parse import quote

from tudor_dynamics.bags.mcap import Scan
from tudor_dynamics.files import Damaged, MAX_PIECE, open_regular

FREE_STEPS = 20_000_000
STEPS_PER_BYTE = 16
"""Steps of SQLite's machine that reading may take: a row takes some thirty, and is more than two
bytes long."""
_SLICE = 100_000


class SqliteFile:
    """A storage file of rosbag2 in sqlite3."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def topics(self) -> list[tuple[str, str, int]]:
        """Give the topics with their types and numbers of messages."""
        with _opened(self.path) as connection:
            counts: dict[object, int] = {}
            sizes = connection.execute(
                "SELECT topic_id, iif(typeof(data) = 'blob', length(data), -1) FROM messages")
            for number, size in sizes:
                if not 0 <= size <= MAX_PIECE:
                    what = 'which are no bytes' if size < 0 else f'of {size} bytes'
                    raise Damaged(f'SQLite: holds a message {what}')
                counts[number] = counts.get(number, 0) + 1
            return [(name, msgtype, counts.get(number, 0)) for number, name, msgtype
                    in connection.execute('SELECT id, name, type FROM topics ORDER BY id')]

    def definitions(self) -> dict[str, str]:
        """Give the definitions of messages that the file carries; none in older files."""
        with _opened(self.path) as connection:
            if not _plain_columns(connection, 'message_definitions') >= {
                    'topic_type', 'encoding', 'encoded_message_definition'}:
                return {}
            rows = connection.execute(
                'SELECT topic_type, encoded_message_definition FROM message_definitions '
                "WHERE encoding = 'ros2msg' AND length(encoded_message_definition) <= ?",
                (MAX_PIECE,))
            return {str(msgtype): str(text) for msgtype, text in rows}

    def read(self, topics: Collection[str], *, with_data: bool) -> dict[str, Scan]:
        """Read raw messages of some topics, in the order of their log times."""
        found = {name: Scan() for name in topics}
        left = self.path.stat().st_size
        what = 'messages.data' if with_data else 'NULL'
        with _opened(self.path) as connection:
            names = {number: name for number, name
                     in connection.execute('SELECT id, name FROM topics') if name in found}
            marks = ', '.join('?' * len(names))
            rows = connection.execute(
                f'SELECT topics.id, messages.timestamp, {what} FROM messages '  # noqa: S608
                f'JOIN topics ON messages.topic_id = topics.id WHERE topics.id IN ({marks}) '
                'ORDER BY timestamp', tuple(names))
            for number, time, message in rows:
                if type(time) is not int:  # a column of integers can hold anything
                    raise Damaged(f'SQLite: a {type(time).__name__} in place of a log time')
                scan = found[names[number]]
                scan.log_time.append(time)
                if with_data:
                    if not isinstance(message, bytes):
                        raise Damaged(f'SQLite: a {type(message).__name__} in place of a message')
                    left -= len(message)
                    if left < 0:
                        raise Damaged('SQLite: its messages are larger than the file')
                    scan.data.append(message)
        return found


@contextmanager
def _opened(path: Path) -> Iterator[sqlite3.Connection]:
    open_regular(path).close()
    left = (FREE_STEPS + STEPS_PER_BYTE * path.stat().st_size) // _SLICE

    def spend() -> bool:
        nonlocal left
        left -= 1
        return left < 0

    # immutable: neither locks nor journals are looked at, and nothing is written
    connection = sqlite3.connect(f'file:{quote(str(path.absolute()))}?mode=ro&immutable=1',
                                 uri=True)
    try:
        if hasattr(connection, 'setlimit'):  # from Python 3.11 on
            connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_PIECE)
        connection.set_progress_handler(spend, _SLICE)
        connection.execute('PRAGMA trusted_schema = OFF')
        found = {name for name, in connection.execute(
            'SELECT name FROM sqlite_master '
            "WHERE type = 'table' AND name IN ('messages', 'topics')")}
        if found != {'messages', 'topics'}:
            raise Damaged('SQLite: no tables messages and topics')
        if not all(_plain_columns(connection, name) for name in found):
            raise Damaged('SQLite: messages or topics compute what they hold')
        yield connection
    except sqlite3.Error as err:
        cause = 'its tables loop' if left < 0 else str(err)
        raise Damaged(f'SQLite: {cause}') from None
    finally:
        connection.close()


def _plain_columns(connection: sqlite3.Connection, table: str) -> set[str]:
    """Give the columns of a table; none of one that is not there, or computes what it holds."""
    roots = connection.execute(
        "SELECT rootpage FROM sqlite_master WHERE type = 'table' AND name = ?",
        (table,)).fetchall()
    columns = list(connection.execute(f'PRAGMA table_xinfo({table})'))
    if not roots or not all(root for root, in roots) or any(row[6] for row in columns):
        return set()
    return {name for _, name, *_ in columns}
