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

"""What a plan promised and what a fit reached, as a table."""

from __future__ import annotations

import math

from tudor_dynamics.cli.console import new_table, print_table
from tudor_dynamics.identification.planned import Comparison


def print_comparison(comparison: Comparison) -> None:
    """Print standard errors expected and reached."""
    table = new_table(
        f'standard errors, expected by the plan and reached ({comparison.runs:.2g} runs of it)',
        names=('parameter', 'unit'),
        figures=('expected', 'by the noise\nthat was found', 'reached', 'reached /\nexpected'))
    for item in comparison.promises:
        name = item.name if item.output == 'effort' else f'{item.channels[0]}: {item.name}'
        table.add_row(name, item.unit, *(
            f'{value:.2g}' if math.isfinite(value) else '-' for value in (
                item.expected, item.by_noise, item.reached, item.reached / item.expected)))
    print_table(table)
    ratios = comparison.ratios()
    if not ratios:
        return
    for key, words in (('expected', 'the plan'), ('by_noise', 'the plan with the noise found')):
        if key == 'expected' and not comparison.stated:
            print('no noise was stated in the plan: its own column is for a noise of 1')
            continue
        print(f'reached over {words}: median {ratios[f"median_over_{key}"]:.2f}, '
              f'{100 * ratios[f"within_30_percent_of_{key}"]:.0f} % of the parameters within 30 %')
