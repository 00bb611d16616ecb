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

"""Files: those of others are read and unpacked within bounds, own ones written whole."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
import datetime
import errno
from functools import lru_cache
import hashlib
from importlib import metadata
import io
from itertools import count
import os
from pathlib import Path
import platform
import shutil
import stat
import subprocess
import tempfile
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics._version import __version__
from tudor_dynamics.errors import TudorError, UsageError
import yaml


# -- Files of other people are read within bounds, own ones written whole or not at all.
#
# A pipe may never speak and a device never end: only regular files are opened, and never more of
# them is read than what was asked for can be. Whatever is wrong is an OSError that names the file.

def _check_regular(status: os.stat_result, path: Path) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise OSError(errno.EISDIR, 'it is a directory', str(path))
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, 'it is a device, pipe or socket, not a file', str(path))


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading."""
    # Looked at before, as opening a device may do something; and after, as it may have changed.
    _check_regular(path.stat(), path)
    flags = os.O_RDONLY | getattr(os, 'O_NONBLOCK', 0) | getattr(os, 'O_CLOEXEC', 0)
    stream = os.fdopen(os.open(path, flags | getattr(os, 'O_BINARY', 0)), 'rb')
    try:
        _check_regular(os.fstat(stream.fileno()), path)
    except OSError:
        stream.close()
        raise
    return stream


def read_bounded(path: Path, limit: int) -> bytes:
    """Read a regular file of bounded size: limit [bytes]."""
    with open_regular(path) as stream:
        data = stream.read(limit + 1)
    if len(data) > limit:
        raise OSError(errno.EFBIG, f'larger than {limit} bytes, the limit', str(path))
    return data


def read_text(path: Path, limit: int, what: str, kind: type[TudorError],
              remedy: str = 'check its path and rights') -> str:
    """Read a text of at most limit bytes, or raise an error of a kind that names what it is."""
    try:
        return read_bounded(path, limit).decode()
    except (OSError, ValueError) as err:  # ValueError: no UTF-8, or a NUL in the path
        cause = getattr(err, 'strerror', None) or err
        raise kind(f'{what} cannot be read ({cause})', place=path, remedy=remedy) from None


def dump_npz(arrays: Mapping[str, NDArray], *, small: bool = False) -> bytes:
    """Write arrays as an npz archive, compressed where it is to be small."""
    buffer = io.BytesIO()
    (np.savez_compressed if small else np.savez)(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def scratch_folder(path: Path) -> Path:
    """Make a hidden directory beside a path, in which it is written until it is complete."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return Path(tempfile.mkdtemp(dir=path.parent, prefix=scratch_prefix(path)))


def scratch_prefix(path: Path) -> str:
    """Begin of the name of the hidden directory."""
    return f'.{path.name}.'


@contextmanager
def whole(path: Path, *, replace: bool = True) -> Iterator[Path]:
    """
    Let a file or directory be written elsewhere first, so that nobody sees a part.

    Devices, pipes and sockets stay what they are: that is an OSError. A symbolic link stays a
    link; what it leads to is written.
    """
    folder = None
    try:
        folder = scratch_folder(_replaceable(path))
        yield folder / path.name
        _put(folder / path.name, _replaceable(path), replace)
    except OSError as err:  # a full disk does not say of itself which file it was
        cause = FOLDER if err.errno == errno.EEXIST else err.strerror or str(err)
        raise OSError(err.errno, cause, str(path)) from None
    finally:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


def _replaceable(path: Path) -> Path:
    """Give the place that links lead to, unless something stands there that is no file."""
    place = Path(os.path.realpath(path))
    if place.exists() and not place.is_dir():
        _check_regular(place.stat(), path)
    return place


def _put(new: Path, path: Path, replace: bool) -> None:
    """Give something its name; a directory in its place is kept until that has succeeded."""
    if not (replace and new.is_dir() and path.exists()):
        os.replace(new, path)
        return
    aside = Path(tempfile.mkdtemp(dir=path.parent, prefix=f'.{path.name}.old.'))
    old = aside / path.name
    try:
        os.replace(path, old)
        os.replace(new, path)
    except BaseException:
        if old.exists():
            os.replace(old, path)
        aside.rmdir()
        raise
    shutil.rmtree(aside, ignore_errors=True)


FOLDER = 'the path, or a folder in it, is an existing file'
SIGNATURE = 'made by tudor_dynamics'
"""What pages, pictures and bug reports hold, so that the next one may take their place."""
MAX_DRAWN = 1 << 26  # bytes; larger files are not looked through (a report of two bags: 5 MB)


def check_target(
    path: str | Path, *, overwrite: bool | None = False, name: str = 'out',
    endings: Sequence[str] = (), mark: str = '', kind: type[TudorError] = UsageError,
) -> Path:
    """
    Refuse another ending, and what may not be replaced: the one rule, asked before the work.

    Pages and pictures of tudor are replaced, other files only with overwrite (None: not to be
    had), and of folders those that hold a file called mark. name: argument of the path.
    """
    path, remedy = Path(path), f'choose another {name}='
    if endings and path.suffix.lower() not in endings:
        raise kind(f'expected a file that ends in {" or ".join(endings)}', place=path,
                   remedy=remedy)
    if not os.path.lexists(path) or (not overwrite and _is_drawn(path)):
        return path
    if not overwrite:
        raise kind('exists already', place=path,
                   remedy=remedy if overwrite is None else f'{remedy}, or add overwrite=')
    if mark and not (path / mark).is_file() or not mark and path.is_dir():
        raise kind('exists already, but was not written by this command, so it is kept',
                   place=path, remedy=remedy)
    return path


def _is_drawn(path: Path) -> bool:
    with suppress(OSError):
        return SIGNATURE.encode() in read_bounded(path, MAX_DRAWN)
    return False


def other_name(path: Path) -> Path:
    """Give a name beside a path, of nothing that is there."""
    return next(other for number in count(2) if not os.path.lexists(
        other := path.with_name(f'{path.name}_{number}')))


def write_whole(path: Path, data: bytes) -> None:
    """Write a file, whole or not at all."""
    with whole(path) as scratch:
        scratch.write_bytes(data)
        os.chmod(scratch, 0o644)


def write_figure(figure: Any, path: Path, dpi: int = 150) -> None:
    """Write a figure of matplotlib, whole or not at all."""
    stream = io.BytesIO()
    name = path.suffix[1:].lower()
    figure.savefig(stream, format=name, dpi=dpi,
                   metadata={'Software' if name == 'png' else 'Creator': SIGNATURE})
    write_whole(path, stream.getvalue())


def write_directory(path: Path, files: Mapping[str, bytes]) -> None:
    """Write a directory of files, whole or not at all."""
    with whole(path) as scratch:
        scratch.mkdir()
        scratch.chmod(0o755)
        for name, data in files.items():
            (scratch / name).write_bytes(data)


# -- YAML of other people: one loader for arm descriptions, model bundles and metadata of bags.
#
# A few lines of YAML can stand for gigabytes (references to references), for hours (a number of a
# million digits) and for the end of the stack (brackets in brackets). Text is looked through event
# by event before anything is made of it.

MAX_DEPTH = 50  # levels: the compiled loader follows any number of them until the stack ends
MAX_VALUES = 300_000  # keys and values, counted again wherever a reference stands for them
MAX_DIGITS = 400  # of a number
MAX_LONG = 1000  # integers of more than 64 bits


class BoundedLoader(getattr(yaml, 'CSafeLoader', yaml.SafeLoader)):  # type: ignore[misc]
    """The fast safe loader where it is compiled in, with numbers of bounded length."""

    _long = 0

    def construct_number(self, node: yaml.ScalarNode) -> float:
        """Read an integer or float; YAML has them in base 60, too, which take quadratic time."""
        value: float = 0.0
        if len(node.value) <= MAX_DIGITS:
            value = (self.construct_yaml_int(node) if node.tag.endswith('int')
                     else self.construct_yaml_float(node))
            # Long integers can be made to share one hash: many as keys take quadratic time, too.
            self._long += isinstance(value, int) and abs(value) >= 1 << 64
            if self._long <= MAX_LONG:
                return value
        cause = (f'a number of more than {MAX_DIGITS} characters' if self._long <= MAX_LONG else
                 f'more than {MAX_LONG} integers of more than 64 bits')
        raise yaml.constructor.ConstructorError(None, None, cause, node.start_mark)


for _kind in ('int', 'float'):
    BoundedLoader.add_constructor(f'tag:yaml.org,2002:{_kind}', BoundedLoader.construct_number)


class YamlError(ValueError):
    """Text that is no YAML, or more of it than is read."""


def load_yaml(text: str | bytes) -> Any:
    """Read YAML of which nothing is known."""
    try:
        _check(text)
        return yaml.load(text, Loader=BoundedLoader)
    except yaml.YAMLError as err:
        mark = getattr(err, 'problem_mark', None)
        where = f' in line {mark.line + 1}' if mark else ''
        what = ' '.join(str(getattr(err, 'problem', None) or err).split())[:200]
        msg = f'no valid YAML{where} ({what})'
    except RecursionError:
        msg = f'no valid YAML (more than {MAX_DEPTH} levels)'
    except (OverflowError, TypeError, ValueError) as err:  # dates and numbers that are none
        msg = f'no valid YAML ({" ".join(str(err).split())[:200]})'
    raise YamlError(msg)


def _check(text: str | bytes) -> None:
    """Count levels and values, those that references stand for included."""
    values = 0
    sizes: dict[str, int] = {}  # of what has an anchor, once it is complete
    begun: list[tuple[str | None, int]] = []
    for event in yaml.parse(text, Loader=BoundedLoader):
        if isinstance(event, yaml.CollectionEndEvent):
            anchor, before = begun.pop()
            if anchor is not None:
                sizes[anchor] = values - before
            continue
        if not isinstance(event, yaml.NodeEvent):
            continue
        before = values
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in sizes:
                msg = f'alias *{event.anchor} has no anchor before it, or is inside it'
                raise _refused(msg, event)
            values += sizes[event.anchor]
        else:
            values += 1
        if isinstance(event, yaml.CollectionStartEvent):
            begun.append((event.anchor, before))
        elif isinstance(event, yaml.ScalarEvent) and event.anchor is not None:
            sizes[event.anchor] = 1
        for found, most, what in ((len(begun), MAX_DEPTH, 'levels'),
                                  (values, MAX_VALUES, 'values')):
            if found > most:
                raise _refused(f'the file has more than {most} {what}', event)


def _refused(problem: str, event: yaml.Event) -> yaml.YAMLError:
    mark: Any = event.start_mark
    return yaml.MarkedYAMLError(problem=problem, problem_mark=mark)


# -- Unpacking of zstd and lz4 within bounds: a few kilobytes can claim to be gigabytes

ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'  # what a zstd frame begins with (RFC 8878, 3.1.1)
MAX_RATIO = 64  # times its own size that a compressed file may unpack to ...
FREE_BYTES = 64 << 20  # ... or to this, whichever is more.
MAX_PIECE = 64 << 20  # largest chunk or message that is unpacked or read at once [bytes]


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
            raise Damaged(f'it unpacks to more than {MAX_RATIO} times its size and more than '
                          f'{FREE_BYTES >> 20} MB, as no recording does')

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
            raise Damaged(f'a piece that announces {size} bytes unpacks to {len(raw)} or more')
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
            raise Damaged(f'{compression} data cannot be unpacked: {err}') from None
        except Exception as err:
            if type(err).__name__ == 'ZstdError':  # derives from Exception alone
                raise Damaged(f'{compression} data cannot be unpacked: {err}') from None
            raise
        parts.append(part)
        length += len(part)
        if length <= most and not frame.eof:
            raise Damaged(f'{compression} data are cut short')
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


# -- What computed something: a digest of the sources; version, commit, date, libraries

PACKAGE = Path(__file__).resolve().parent
LIBRARIES = ('numpy', 'scipy', 'pin', 'numba', 'pydantic', 'rosbags', 'rclpy')
"""Those that numbers come from."""


@lru_cache
def source_digest(parts: tuple[str, ...]) -> str:
    """Give the version of some parts of the package, and of the modules at its top."""
    files = set(PACKAGE.glob('*.py'))
    for part in parts:
        (PACKAGE / part).stat()  # what is not there cannot say so otherwise
        files.update((PACKAGE / part).rglob('*.py'))
    digest = hashlib.sha256(__version__.encode())
    for file in sorted(files):
        name, content = file.relative_to(PACKAGE).as_posix(), file.read_bytes()
        digest.update(f'{name} {len(content)}\n'.encode() + content)
    return f'{__version__} {digest.hexdigest()[:16]}'


def provenance() -> dict[str, str]:
    """Say what makes results here, in words; the date may be given by SOURCE_DATE_EPOCH."""
    known = os.environ.get('SOURCE_DATE_EPOCH', '')
    now = (datetime.datetime.fromtimestamp(int(known), datetime.timezone.utc)
           if known.isdecimal() else datetime.datetime.now(datetime.timezone.utc))
    commit = _commit()
    return {'version': f'tudor_dynamics {__version__}', **({'commit': commit} if commit else {}),
            'date': now.strftime('%Y-%m-%d %H:%M UTC'),
            'python': f'{platform.python_version()} on {platform.system()} {platform.machine()}',
            'libraries': ', '.join(f'{name} {version}' for name in LIBRARIES
                                   if (version := installed(name)))}


def installed(name: str) -> str:
    """Give the version of a library; empty where there is none."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ''


def _commit() -> str:
    """Give the commit of a checkout, marked where files differ from it; empty elsewhere."""
    folder = PACKAGE.parent
    if not (folder / '.git').exists():
        return ''
    try:
        return subprocess.run(
            ['git', '-C', str(folder), 'describe', '--always', '--dirty=, changed',
             '--abbrev=12', '--exclude=*'], capture_output=True, text=True, timeout=10.0,
            check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ''
