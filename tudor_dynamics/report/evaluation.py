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

"""The page of an evaluation: figures of a model on other bags, and a load where one is found."""

from __future__ import annotations

from collections.abc import Sequence

from tudor_dynamics.doctor.evaluation import Evaluated
from tudor_dynamics.identification.validation import Validation
from tudor_dynamics.identification.worth.comparison import Change
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.units import output_units
from tudor_dynamics.report.load import load_section
from tudor_dynamics.report.page import rendered


def evaluation_page(
    bundle: ModelBundle, bags: Sequence[str], outputs: dict[str, dict[str, Validation]],
    evaluated: Evaluated, worse: Sequence[Change],
) -> str:
    """Render the page."""
    rows = [{'output': output, 'kind': kind, 'channel': name, 'score': score,
             'unit': output_units(bundle.arm, output)[name]}
            for output, kinds in outputs.items() for kind, item in kinds.items()
            for name, score in item.score.channels.items()]
    return rendered('evaluation', arm=bundle.arm.name, bags=bags, rows=rows, worse=worse,
                    findings=evaluated.findings,
                    loads=[load_section(bundle.arm, bag, told)
                           for bag, told in evaluated.loads.items()])
