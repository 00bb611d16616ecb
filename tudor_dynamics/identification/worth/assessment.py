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

"""All that can be said of the worth of a fit: uses, thresholds, marks, and what to do next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tudor_dynamics.identification.collisions.free_motion import learn_all
from tudor_dynamics.identification.fit import FitResult
from tudor_dynamics.identification.verdict import Grade
from tudor_dynamics.identification.worth.next_steps import next_steps, NextStep
from tudor_dynamics.identification.worth.physics import marks
from tudor_dynamics.identification.worth.uses import Use, uses_of
from tudor_dynamics.monitoring.thresholds.thresholds import MethodThresholds


@dataclass(frozen=True, eq=False)
class Assessment:
    """What a fit is worth."""

    uses: tuple[Use, ...]  # verdicts, model by model
    thresholds: dict[tuple[str, str], MethodThresholds]  # method and kind to what was learned
    missing: tuple[str, ...]  # methods without thresholds, with the reason
    marks: tuple[str, ...]  # what no arm can be
    steps: tuple[NextStep, ...]  # what to do next, that with the largest gain first

    @property
    def detects(self) -> Grade | None:
        """Give how well the best model detects collisions; None without thresholds."""
        found = [use.level for use in self.uses
                 if use.name.startswith('collision') and use.level is not None]
        return min(found, key=list(Grade).index, default=None)

    def as_dict(self) -> dict[str, Any]:
        """Give verdicts and steps as plain values."""
        uses: dict[str, Any] = {}
        for use in self.uses:
            uses.setdefault(use.output, {}).setdefault(use.kind, []).append(use.as_dict())
        return {'uses': uses, 'marks': list(self.marks),
                'without_thresholds': list(self.missing),
                'next_steps': [step.as_dict() for step in self.steps]}


def assess(result: FitResult) -> Assessment:
    """Judge a fit by what it is to be used for."""
    # beside the robot filters are causal: thresholds are those of the models that run there
    beside = result if result.causal is None else result.causal
    learned, reasons = learn_all([(item.output, item.kind, item.unseen) for item in beside.fitted],
                                 beside.preprocessing)
    uses: list[Use] = []
    found: list[str] = []
    for item in result.fitted:
        methods = (item.output, *(('momentum',) if (
            item.output == 'effort' and item.kind == 'analytical') else ()))
        uses += uses_of(
            item, result.arm,
            {method: learned[method, item.kind] for method in methods
             if (method, item.kind) in learned},
            {method: reasons[method, item.kind] for method in methods
             if (method, item.kind) in reasons})
        if item.output == 'effort' and item.kind == 'analytical' and item.validation.cases:
            model, bag = item.validation.cases[0]
            found += marks(model, result.arm, [bag])
    missing = tuple(f'{method} {kind}: {why}' for (method, kind), why in reasons.items())
    return Assessment(tuple(uses), learned, missing, tuple(found),
                      next_steps(result, uses, learned, missing))
