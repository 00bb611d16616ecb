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

"""Linear programmes of moves that leave links still."""

from __future__ import annotations

import numpy as np
import pytest

from tudor_dynamics.signals import settings
from tudor_dynamics.signals.shaping import solved


def test_a_programme_that_does_not_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """A linear programme has at most so many steps, and without an end no solution."""
    monkeypatch.setattr(settings, 'PROGRAMME_STEPS', 1)
    random = np.random.default_rng(0)
    cost, rows = random.normal(size=20), random.normal(size=(80, 20))
    assert solved(cost, [rows], [np.ones(80)], bounds=(-1.0, 1.0)) is None
    monkeypatch.undo()
    assert solved(cost, [rows], [np.ones(80)], bounds=(-1.0, 1.0)) is not None
