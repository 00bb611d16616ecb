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

"""Figures of the collision detector as a table."""

from __future__ import annotations

from collections.abc import Sequence

from tudor_dynamics.cli.console import new_table, print_table
from tudor_dynamics.identification.collisions import MethodResult


def print_collisions(results: Sequence[MethodResult], allowed: float) -> None:
    """
    Print one row a method.

    Parameters
    ----------
    results : sequence of MethodResult
        Results of each method.
    allowed : float
        False alarms per hour that the thresholds allow.

    """
    table = new_table(
        f'collisions, thresholds for {allowed:g} false alarms per hour', names=('method',),
        figures=('pushes\nfound', 'latency\nmedian [ms]', '\n95 % [ms]', 'false\nalarms',
                 '\nin [min]', 'largest ratio\nwithout push'))

    def milliseconds(value: float | None) -> str:
        return '-' if value is None else f'{1e3 * value:.0f}'

    for item in results:
        score = item.score
        quiet = [float(bag.ratio.max(initial=0.0)) for bag in item.watched if not bag.pushes]
        table.add_row(
            item.method, f'{score.found} of {score.pushes}', milliseconds(score.latency_median),
            milliseconds(score.latency_p95), str(score.false_alarms), f'{60 * score.hours:.1f}',
            f'{max(quiet):.2f}' if quiet else '-')
    print_table(table)
