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

"""How well motions show an arm's parameters, as a table and as plain values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tudor_dynamics.cli.console import new_table, print_table
from tudor_dynamics.excitation.conditions import ExcitationReport


def condition_values(report: ExcitationReport) -> dict[str, Any]:
    """Give the condition numbers of a motion as plain values."""
    return {output: [{'channels': list(group.channels), 'condition': group.condition,
                      'parameters': group.parameters, 'weakest': group.weakest}
                     for group in groups]
            for output, groups in (('effort', report.effort), ('strain', report.strain))}


def print_conditions(names: Sequence[str], reports: Sequence[ExcitationReport]) -> None:
    """Print the condition numbers of motions."""
    table = new_table('condition numbers of the regressors: below 30 good, above 1000 poor',
                      names=('motion', 'output', 'channels', 'shown least'),
                      figures=('condition', 'parameters'))
    for name, report in zip(names, reports, strict=True):
        for output, groups in (('effort', report.effort), ('strain', report.strain)):
            for group in groups:
                table.add_row(name, output, ', '.join(group.channels), group.weakest,
                              f'{group.condition:.1f}', str(group.parameters))
        table.add_section()
    print_table(table)
