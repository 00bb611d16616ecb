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

from collections.abc import Callable
from pathlib import Path
import pickle
import threading
from typing import Any

import pytest
from tudor_dynamics.bags.storage import Bag
from tudor_dynamics.cli import console, evaluate, why
from tudor_dynamics.models.bundle import ModelBundle


@pytest.fixture(autouse=True)
def unwatched(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no step be named on a slow machine, where a test counts the lines of an error."""
    monkeypatch.setattr(console, 'SILENCE', threading.TIMEOUT_MAX)


def shown(item: Any) -> object:
    """Give what an argument of a replay is told by, for a test session with bags that stay."""
    return (item.digest if isinstance(item, ModelBundle) else
            str(item.path) if isinstance(item, Bag) else pickle.dumps(item))


@pytest.fixture(scope='session')
def replays() -> dict[object, Any]:
    """Keep what monitors found in bags."""
    return {}


@pytest.fixture
def replayed_once(replays: dict[object, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the same bag pass the same monitor once, where a test is about what is said of it."""
    def kept(replay: Callable[..., Any]) -> Callable[..., Any]:
        def found(*given: Any) -> Any:
            key = (replay.__name__, *map(shown, given))
            if key not in replays:
                replays[key] = replay(*given)
            return replays[key]
        return found
    for module, name in ((evaluate, 'evaluate_collisions'), (why, 'explain')):
        monkeypatch.setattr(module, name, kept(getattr(module, name)))


@pytest.fixture(scope='session')
def model(two_blades: Path) -> Path:
    """Model of the sample bags."""
    return two_blades
