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
Free motion that a model has not seen, as much of it as thresholds want.

What a model is judged by is often short: one test bag, or the end of an only one. The residuals of
a threshold may come from training bags as well, each predicted by a model of the others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from tudor_dynamics.arm import PreprocessingSpec
from tudor_dynamics.errors import SignalError
from tudor_dynamics.identification.dataset import BagData, part
from tudor_dynamics.identification.payloads import model_for
from tudor_dynamics.identification.validation import Validation
from tudor_dynamics.models.base import Model

Case = tuple[Model, BagData]
Left = tuple[list[BagData], BagData]
ENOUGH = 160.0
"""Motion of which thresholds hardly profit from more [s]."""
PARTS = 5
"""Into which an only bag is cut."""
SHORTEST = 4.0
"""Parts shorter than this are not worth their ends, in which filters settle [s]."""


def left_out(training: Sequence[BagData], preprocessing: PreprocessingSpec) -> list[Left]:
    """
    Leave out each training bag once, or each part of an only one.

    Returns an empty list where the only bag is too short.
    """
    bags = list(training)
    if len(bags) > 1:
        return [(bags[:i] + bags[i + 1:], bag) for i, bag in enumerate(bags)]
    count = min(PARTS, int(bags[0].recording.t[-1] / SHORTEST))
    found: list[Left] = []
    for i in range(count if count > 1 else 0):
        begin, end = i / count, (i + 1) / count
        try:
            rest = [part(bags[0], *piece, preprocessing)
                    for piece in ((0.0, begin), (end, 1.0)) if piece[0] < piece[1]]
            found.append((rest, part(bags[0], begin, end, preprocessing)))
        except SignalError:
            continue  # a part in which nothing is long enough
    return found


def unseen_cases(
    fit: Callable[[Sequence[BagData]], Model], model: Model, validation: Validation,
    others: Sequence[Left], output: str,
) -> tuple[Case, ...]:
    """Collect bags with models that have not seen them, until there is enough motion."""
    cases = list(validation.cases)
    if model.has_memory:
        return tuple(cases)
    judged = {bag.choice.path for _, bag in cases}
    if others and all(bag.choice.path in judged for _, bag in others):
        if len({bag.choice.path for _, bag in others}) > 1:
            return tuple(cases)  # each was left out already
        cases = []
    for known, bag in others:
        if sum(float(item.recording.t[-1]) for _, item in cases) >= ENOUGH:
            break
        cases.append((model_for(fit(known), bag), bag))
    return tuple(cases)
