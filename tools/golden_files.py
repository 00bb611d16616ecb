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
What a command has written, as values that can be compared: plain values, texts and arrays.

A file becomes a mapping from keys to values, by what its name ends in. What cannot be the same in
two runs is replaced here, by `TEXT`, `KEYS` and `CACHES`, and nowhere else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
import hashlib
from html import unescape
import json
import math
from pathlib import Path
import re
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_typestore, Stores
import yaml

Values = dict[str, Any]
"""Key to a plain value, a text or an array."""

TEXT: tuple[tuple[str, str, str], ...] = (
    (r'\bbags\s+in\s+[\d.]+ s *', 'bags in # s', 'seconds that a campaign took'),
    (r'/[\w/.+-]*/golden_\w{8}(?=/)', 'WORK', 'temporary folder'),
    (r'(?<=search: )[\d.]+ s', '# s', 'seconds that a search took'),
    (r'tudor_dynamics \d+\.\d+\.\d+\w*', 'tudor_dynamics #', 'version'),
    (r'\d{4}-\d\d-\d\d \d\d:\d\d UTC', 'DATE', 'when a model was fitted'),
    (r'(?<=\bCommit)((?:\s|<[^>]*>)+)[0-9a-f]{12}(, changed)?', r'\1#', 'commit that fitted it'),
    (r'(?<=, digest )[0-9a-f]{64}', '#', 'model of a page, with the commit that fitted it'),
    (r'(?<=\] \[)\d+\.\d+(?=\])', '#', 'time of a line in the log of a node'),
    (r'<(style|script)\b.*?</\1>', '', 'how a page looks'),
)
"""Regular expression, replacement, what it is: in every text."""
KEYS: tuple[tuple[str, str], ...] = (
    (r'^stdout:(search_)?seconds(\.|$)', 'seconds that a command took'),
    (r'model\.yaml:(checksum$|files\.)', 'checksums of what is compared itself'),
    (r'model\.yaml:facts\.made\.commit$', 'commit that fitted a model'),
)
"""Regular expression of a key, what it is: values that are not compared."""
CACHES = r'(^|/)(sums|stages|[^/]*\.sums)/'
"""Files in these folders are kept for the next run and depend on the sources."""
PICTURES = ('.png', '.svg', '.pdf', '.gif', '.mp4')


def normal(text: str) -> str:
    """Replace what `TEXT` lists."""
    for pattern, replacement, _ in TEXT:
        text = re.sub(pattern, replacement, text, flags=re.DOTALL)
    return text


def dropped(key: str) -> bool:
    """Say whether a key is left out by `KEYS`."""
    return any(re.search(pattern, key) for pattern, _ in KEYS)


def flat(value: Any, key: str = '') -> Iterator[tuple[str, Any]]:
    """Give the leaves of nested mappings and sequences, each with the path to it."""
    items: Any = None
    if isinstance(value, dict):
        items = value.items()
    elif isinstance(value, list | tuple):
        items = enumerate(value)
    if items is None or not value:
        yield key, normal(value) if isinstance(value, str) else plain(value)
        return
    for name, item in items:
        yield from flat(item, f'{key}.{normal(str(name))}' if key else normal(str(name)))


def plain(value: Any) -> Any:
    """Give a value as JSON and this comparison have it."""
    if isinstance(value, np.generic):
        return value.item()
    return value if isinstance(value, bool | int | float | str | np.ndarray | None) else str(value)


def digest(data: bytes) -> str:
    """Give the checksum of bytes."""
    return hashlib.sha256(data).hexdigest()


def of_text(text: str) -> Values:
    """Give the leaves of JSON, or the text itself."""
    if text.lstrip().startswith(('{', '[')):
        try:
            return dict(flat(json.loads(text)))
        except ValueError:
            pass
    return {'text': normal(text)}


def of_yaml(text: str) -> Values:
    """Give the leaves of YAML, and what stands in its comments."""
    try:
        found = dict(flat(yaml.load(text, getattr(yaml, 'CSafeLoader', yaml.SafeLoader))))
    except yaml.YAMLError:
        return {'text': normal(text)}
    comments = re.findall(r'(?:^|(?<=\s))#.*', text, flags=re.MULTILINE)
    return {**found, **({'comments': normal('\n'.join(comments))} if comments else {})}


def of_page(text: str) -> Values:
    """Give the words of a page without its pictures, which are counted."""
    pictures = re.compile(r'<img\b[^>]*>|<svg\b.*?</svg>', re.DOTALL)
    words = re.sub(r'<[^>]+>', ' ', pictures.sub(' [picture] ', normal(text)))
    lines = (' '.join(line.split()) for line in unescape(words).splitlines())
    return {'text': '\n'.join(line for line in lines if line)}


def of_picture(data: bytes, name: str) -> Values:
    """Give the size of a picture and, of PNG, whose bytes are the same in each run, a checksum."""
    if name.endswith('.png'):
        return {'size': f'{int.from_bytes(data[16:20])} x {int.from_bytes(data[20:24])}',
                'sha256': digest(data)}
    return {'written': True}


def of_bag(folder: Path) -> Values:
    """Give the messages of a bag by topic: stamps, every number, every text."""
    found: Values = {}
    series: dict[str, list[list[Any]]] = {}
    store = get_typestore(Stores.ROS2_JAZZY)
    with AnyReader([folder], default_typestore=store) as reader:
        for link in reader.connections:
            found[f'{link.topic}.type'] = link.msgtype
            series[link.topic] = []
        for link, stamp, raw in reader.messages():
            leaves = message_leaves(reader.deserialize(raw, link.msgtype))
            series[link.topic].append([stamp, *leaves])
    for topic, rows in series.items():
        found[f'{topic}.count'] = len(rows)
        found[f'{topic}.stamps'] = np.array([row[0] for row in rows], dtype=np.int64)
        found[f'{topic}.words'] = digest(repr(
            [[item for item in row if isinstance(item, str)] for row in rows]).encode())
        found[f'{topic}.numbers'] = ragged(
            [[float(item) for item in row[1:] if not isinstance(item, str)] for row in rows])
    return found


def message_leaves(value: Any) -> Iterator[Any]:
    """Give every number and text of a message."""
    if isinstance(value, np.ndarray | list | tuple):
        for item in value:
            yield from message_leaves(item)
    elif hasattr(value, '__msgtype__'):
        for name in value.__dataclass_fields__:
            if name != '__msgtype__':
                yield from message_leaves(getattr(value, name))
    else:
        yield value


def ragged(rows: list[list[float]]) -> Any:
    """Stack rows; rows of several lengths are filled with numbers that none of them has."""
    width = max(map(len, rows), default=0)
    return np.array([[*row, *[-math.inf] * (width - len(row))] for row in rows]).reshape(-1, width)


def of_arrays(path: Path) -> Values:
    """Give the arrays of an NPZ file."""
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


READERS: dict[str, Callable[[str], Values]] = {
    '.json': of_text, '.yaml': of_yaml, '.html': of_page, '.csv': of_text, '.txt': of_text,
    '.xml': of_text, '.urdf': of_text, '.md': of_text}


def of_file(path: Path, name: str) -> Values:
    """Give what a file holds; ``name`` is its path in the folder of its case."""
    if path.suffix == '.npz':
        return of_arrays(path)
    data = path.read_bytes()
    if path.suffix in PICTURES:
        return of_picture(data, name)
    if path.suffix in READERS:
        return READERS[path.suffix](data.decode('utf-8', 'replace'))
    return {'sha256': digest(data)}


def of_folder(folder: Path) -> Values:
    """Give what all files of a folder hold, bags as bags."""
    found: Values = {}
    for path in sorted(item for item in folder.rglob('*') if item.is_file()):
        name = path.relative_to(folder).as_posix()
        if re.search(CACHES, name):
            continue
        found[f'{name}:'] = 'file'
        if path.name == 'metadata.yaml':
            found.update((f'{name.rpartition("/")[0]}:{key}', value)
                         for key, value in of_bag(path.parent).items())
        contents = {} if path.suffix in ('.mcap', '.db3') else of_file(path, name)
        found.update((f'{name}:{key}', value) for key, value in contents.items())
    return found
