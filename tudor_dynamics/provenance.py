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

"""What made a result: version, commit, date, libraries."""

from __future__ import annotations

import datetime
from importlib import metadata
import os
from pathlib import Path
import platform
import subprocess

from tudor_dynamics._version import __version__

LIBRARIES = ('numpy', 'scipy', 'pin', 'numba', 'pydantic', 'rosbags')
"""Those that numbers come from."""


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
    folder = Path(__file__).resolve().parents[1]
    if not (folder / '.git').exists():
        return ''
    try:
        return subprocess.run(
            ['git', '-C', str(folder), 'describe', '--always', '--dirty=, changed',
             '--abbrev=12', '--exclude=*'], capture_output=True, text=True, timeout=10.0,
            check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ''
