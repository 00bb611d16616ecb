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

"""The doctor looks at bags beside a model: does it know all that the arm carries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

from tudor_dynamics.doctor.bags import examine_bag, merged
from tudor_dynamics.doctor.load import load_of
from tudor_dynamics.errors import TudorError
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.identification.finding import Finding
from tudor_dynamics.identification.payloads import model_for
from tudor_dynamics.identification.worth.carried import payload_of
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.payload.estimate import PayloadEstimate


@dataclass(frozen=True, eq=False)
class Evaluated:
    """What bags show beside a model."""

    findings: tuple[Finding, ...]  # of the bags alone, and of the bags beside the model
    # Bag whose residuals look like a load, to what is known of it.
    loads: dict[str, PayloadEstimate]


def examine_evaluation(bundle: ModelBundle, data: Sequence[BagData]) -> Evaluated:
    """Look at bags that a model is compared with."""
    findings, loads = [], {}
    for bag in data:
        examined = examine_bag(bundle.arm, bag)
        findings.append(list(examined.findings))
        if examined.case is None:
            continue
        known = {}
        for output, kinds in bundle.models.items():
            model = kinds.get('analytical')
            if model is not None and output in examined.case.outputs:
                try:
                    known[output] = model_for(model, bag)
                except TudorError:
                    continue  # its payload is not known, which is said elsewhere
        found = load_of(examined.case, {output: model.predict(examined.case.motion)
                                        for output, model in known.items()}, str(bag.choice))
        if found is not None:
            told = loads[str(bag.choice)] = payload_of(bundle, [bag], 'analytical')
            findings[-1].insert(0, _measured(found, told))
    return Evaluated(tuple(merged(findings)), loads)


def _measured(finding: Finding, told: PayloadEstimate) -> Finding:
    """Say of a load what is known of it: how much, and as surely as that is known."""
    size = None if math.isnan(told.mass) else told.mass - told.known
    return replace(finding, what=f'{finding.what}; {told.sentence}', size=size,
                   unit='' if size is None else 'kg')
