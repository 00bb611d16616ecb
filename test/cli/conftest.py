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

"""What all tests of commands share."""

from __future__ import annotations

from pathlib import Path
import threading

import pytest
from tudor_dynamics.cli import console


@pytest.fixture(autouse=True)
def unwatched(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no step be named on a slow machine, where a test counts the lines of an error."""
    monkeypatch.setattr(console, 'SILENCE', threading.TIMEOUT_MAX)


@pytest.fixture(scope='session')
def model(two_blades: Path) -> Path:
    """Model of the sample bags."""
    return two_blades
