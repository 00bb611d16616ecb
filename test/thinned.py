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

"""Half of the cases of a product, for tests that all take the same way through the code."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
import os
from typing import Any

ALL = 'TUDOR_ALL_CASES'
"""Set, it asks for all of them, as bench/all_cases.py does."""


def thinned(*values: Iterable[Any]) -> list[tuple[Any, ...]]:
    """
    Give each second case of a product: those whose numbers have an even sum.

    Each value comes with half of all combinations of the others; of three factors or more, any
    two values come together, unless all others have one value alone.
    """
    return [tuple(value for _, value in case) for case in product(*map(enumerate, values))
            if ALL in os.environ or sum(number for number, _ in case) % 2 == 0]


def first(*cases: Any) -> list[Any]:
    """Give the first of some cases that differ in their random numbers alone."""
    return list(cases) if ALL in os.environ else [cases[0]]
