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

"""Which version of the package computed something: a digest of the sources behind it."""

from __future__ import annotations

from functools import lru_cache
import hashlib
from pathlib import Path

from tudor_dynamics._version import __version__

PACKAGE = Path(__file__).resolve().parent


@lru_cache
def source_digest(parts: tuple[str, ...], package: Path = PACKAGE) -> str:
    """Give the version of some parts of the package, and of the modules at its top."""
    files = set(package.glob('*.py'))
    for part in parts:
        path = package / part
        files.update([path] if path.suffix else path.rglob('*.py'))
        path.stat()
    digest = hashlib.sha256(__version__.encode())
    for file in sorted(files):
        name, content = file.relative_to(package).as_posix(), file.read_bytes()
        digest.update(f'{name} {len(content)}\n'.encode() + content)
    return f'{__version__} {digest.hexdigest()[:16]}'
