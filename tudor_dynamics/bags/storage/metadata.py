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

"""``metadata.yaml`` of a bag: storage files, compression, numbers of messages, custom data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tudor_dynamics.bounded_yaml import load_yaml
from tudor_dynamics.errors import BagError
from tudor_dynamics.files import read_bounded

METADATA = 'metadata.yaml'
MAX_METADATA_BYTES = 10_000_000
MAX_VERSION = 9
"""Of Jazzy."""
STORAGES = ('mcap', 'sqlite3')


@dataclass(frozen=True)
class Metadata:
    """What the metadata say of a bag."""

    files: tuple[Path, ...]  # storage files in their order
    compression: str  # what rosbag2 has compressed, beside chunks
    counts: Mapping[str, int]  # number of messages of each topic
    custom: Mapping[str, str]  # what whoever recorded added
    doubled: bool = False  # whether a file was listed more than once


def read_metadata(directory: Path) -> Metadata:
    """Read the metadata of a bag."""
    try:
        content = load_yaml(read_bounded(directory / METADATA, MAX_METADATA_BYTES))
        return _checked(directory, content['rosbag2_bagfile_information'])
    except OSError as err:
        cause = f'cannot be read: {err.strerror}'
    except (KeyError, IndexError) as err:
        cause = f'no key {err}'
    except (AttributeError, TypeError, ValueError) as err:
        cause = ' '.join(str(err).split())[:300]
    raise BagError(cause, place=directory, remedy='check the bag with `ros2 bag info`')


def _checked(directory: Path, information: dict[str, Any]) -> Metadata:
    version = information['version']
    if not isinstance(version, int) or version > MAX_VERSION:
        msg = f'version {version!r}; at most {MAX_VERSION} is known'
        raise ValueError(msg)
    if information['storage_identifier'] not in STORAGES:
        msg = f'storage {information["storage_identifier"]!r}; known are {", ".join(STORAGES)}'
        raise ValueError(msg)
    compression = str(information.get('compression_mode') or '').lower().replace('none', '')
    if compression not in ('', 'file', 'message', 'storage'):
        msg = f'compression mode {compression!r}'
        raise ValueError(msg)
    if compression and information['compression_format'] != 'zstd':
        msg = f'compression format {information["compression_format"]!r}; zstd can be read'
        raise ValueError(msg)
    names = [Path(name).name for name in information['relative_file_paths']]
    files = tuple(directory / name for name in dict.fromkeys(names))
    for file in files:
        if not file.is_file():
            msg = f'{file.name} is not there, or no file'
            raise ValueError(msg)
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
