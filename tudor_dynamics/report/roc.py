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

"""Plot of detection rate against false alarms, for each method."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from tudor_dynamics.errors import UsageError
from tudor_dynamics.identification.collisions.replay import MethodResult
from tudor_dynamics.report.figure import write_figure

SUFFIXES = ('.png', '.svg', '.pdf')


def picture_path(path: str | Path) -> Path:
    """Refuse a file name that no plot can be written to."""
    if Path(path).suffix not in SUFFIXES:
        msg = f'{path}: expected a picture, a file that ends in {", ".join(SUFFIXES)}'
        raise UsageError(msg)
    return Path(path)


def write_roc(results: Sequence[MethodResult], path: Path) -> None:
    """Write the plot, whole or not at all."""
    figure = Figure(figsize=(6.4, 4.4), layout='constrained')
    axes = figure.add_subplot()
    for result, marker in zip(results, 'os^Dv', strict=False):
        false = [point[1] for point in result.roc]
        rate = [100.0 * point[2] for point in result.roc]
        line, = axes.plot(false, rate, drawstyle='steps-post', label=result.method)
        score = result.score
        axes.plot(score.false_alarms_per_hour or 0.0, 100.0 * (score.detection_rate or 0.0),
                  marker, color=line.get_color(), markersize=9, clip_on=False)
    hours = results[0].score.hours
    axes.set_xscale('symlog', linthresh=max(1.0 / max(hours, 1e-6), 1e-3))
    axes.set_xlabel(f'false alarms per hour (from {60 * hours:.1f} min without a push)')
    axes.set_ylabel('pushes found [%]')
    axes.set_ylim(0, 103)
    axes.set_xlim(left=0)
    axes.grid(alpha=0.3)
    axes.legend(title='marker: threshold in force')
    write_figure(figure, path)
