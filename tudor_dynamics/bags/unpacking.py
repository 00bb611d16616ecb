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

"""Unpacking of zstd and lz4 within bounds: a few kilobytes can claim to be gigabytes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
import tempfile
from typing import Any

from tudor_dynamics.files import open_regular

ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'
"""What a zstd frame begins with (RFC 8878, 3.1.1)."""
MAX_RATIO = 64
"""Times its own size that a compressed file may unpack to ..."""
FREE_BYTES = 64 << 20
"""... or to this, whichever is more."""
MAX_PIECE = 64 << 20
"""Largest chunk or message that is unpacked or read at once [bytes]."""


class Damaged(ValueError):
    """A storage file that contradicts itself, or asks for more than it may."""


class BreaksOff(Damaged):
    """A file without its end: cut short, or its recorder was killed."""


class Unpacker:
    """Unpacks the pieces of one file: size [bytes]."""

    def __init__(self, size: int) -> None:
        self._left = max(MAX_RATIO * size, FREE_BYTES)

    def take(self, size: int) -> None:
        """Count what was unpacked; Damaged where it becomes too much."""
        self._left -= size
        if self._left < 0:
            raise Damaged(f'it unpacks to more than {MAX_RATIO} times its size, or '
                          f'{FREE_BYTES >> 20} MB')

    def unpack(self, data: bytes, compression: str, size: int | None = None) -> bytes:
        """Unpack a piece; compression: not at all if empty."""
        most = MAX_PIECE if size is None else size
        if most > MAX_PIECE:
            raise Damaged(f'a piece of {most} bytes; at most {MAX_PIECE} are unpacked at once')
        if size is not None:  # before any memory is asked for
            self.take(size)
        raw = _unpack(data, compression, min(most, self._left + 1) if size is None else most)
        if size is None:
            self.take(len(raw))
        elif len(raw) != size:
            raise Damaged(f'a piece of {size} bytes unpacks to {len(raw)} or more')
        return raw


def _decompressor(compression: str) -> Any:
    try:
        if compression == 'zstd':
            from backports import zstd
            return zstd.ZstdDecompressor()
        if compression == 'lz4':
            from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
            return LZ4FrameDecompressor()
    except ImportError as err:
        msg = f'compressed with {compression}, for which a library is missing ({err})'
        raise Damaged(msg) from None
    raise Damaged(f'compression {compression[:40]!r} is unknown; zstd and lz4 can be read')


def _unpack(data: bytes, compression: str, most: int) -> bytes:
    """Unpack to at most one byte more than asked for, which shows that there is more."""
    if compression == '':
        return data
    parts, length = [], 0
    while data and length <= most:  # frames can follow each other
        frame = _decompressor(compression)
        try:
            part = bytes(frame.decompress(data, max_length=most + 1 - length))
        except (EOFError, MemoryError, RuntimeError, ValueError) as err:
            raise Damaged(f'{compression}: {err}') from None
        except Exception as err:
            if type(err).__name__ == 'ZstdError':  # derives from Exception alone
                raise Damaged(f'{compression}: {err}') from None
            raise
        parts.append(part)
        length += len(part)
        if length <= most and not frame.eof:
            raise Damaged(f'{compression}: cut short')
        data = frame.unused_data or b''
    return b''.join(parts)


@contextmanager
def unpacked_file(path: Path) -> Iterator[Path]:
    """Unpack a file that rosbag2 has compressed as a whole."""
    from backports import zstd
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder, path.stem)
        with open_regular(path) as packed, target.open('wb') as out:
            unpacker = Unpacker(path.stat().st_size)
            try:
                with zstd.open(packed, 'rb') as stream:
                    while block := stream.read(1 << 20):
                        unpacker.take(len(block))
                        out.write(block)
            except (EOFError, zstd.ZstdError) as err:
                raise Damaged(f'zstd: {err}') from None
        yield target
