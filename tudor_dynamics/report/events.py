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

"""Picture of collisions: how far each method stands above its thresholds, pushes, events."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
import numpy as np

from tudor_dynamics.identification.collisions.replay import MethodResult
from tudor_dynamics.report.figure import plain_text, write_figure
from tudor_dynamics.report.style import BLUE, PRINT, style, VERMILION

LOWEST = 0.05
"""Ratios below are not worth their place."""
MOST = 6
"""Bags that are drawn at most."""


def write_events(results: Sequence[MethodResult], path: Path) -> None:
    """Write the picture, whole or not at all."""
    bags = min(len(results[0].watched), MOST)
    with style(PRINT):
        figure = Figure(figsize=(7.2, 0.7 + 1.35 * bags * len(results)), layout='constrained')
        rows = figure.subplots(bags * len(results), 1, squeeze=False)[:, 0]
        for place, axes in enumerate(rows):
            result, bag = results[place % len(results)], place // len(results)
            _draw(axes, result, bag, first=place == 0, last=place == len(rows) - 1)
        write_figure(figure, path)


def _draw(axes: Any, result: MethodResult, bag: int, *, first: bool, last: bool) -> None:
    watched = result.watched[bag]
    if not len(watched.stamp):
        return
    sightings = watched.sightings
    # events tell their time since the first sample of the bag, which settling leaves out
    origin = (sightings[0].event.stamp - round(sightings[0].time * 1e9) if sightings
              else int(watched.stamp[0]))
    t = (watched.stamp - origin) * 1e-9
    axes.semilogy(t, np.maximum(watched.ratio, LOWEST), color=BLUE, linewidth=0.8)
    axes.axhline(1.0, color='#333333', linewidth=0.8, linestyle=(0, (4, 2)))
    for number, push in enumerate(watched.truth.pushes, 1):
        axes.axvspan((push.begin - origin) * 1e-9, (push.end - origin) * 1e-9, color='#f0e442',
                     alpha=0.6, linewidth=0)
        axes.text((push.begin - origin) * 1e-9, LOWEST * 1.15, f'{number}', fontsize=7.5)
    top = 2.0 * max(float(watched.ratio.max(initial=0.0)), 1.5)
    axes.plot([item.time for item in sightings], [0.7 * top] * len(sightings), 'v',
              color=VERMILION, markersize=6, clip_on=False)
    axes.set_ylim(LOWEST, top)
    axes.set_xlim(float(t[0]), float(t[-1]))
    axes.set_ylabel('ratio')
    said = f'{result.score.found} of {result.score.pushes} pushes found, ' if (
        watched.truth.pushes and len(result.watched) == 1) else ''
    note = ' (yellow: pushes, triangles: events)' if first else ''
    plain_text(axes.set_title, f'{result.method}: {said}{len(sightings)} events in '
               f'{Path(watched.bag).name}{note}')
    if last:
        axes.set_xlabel('time [s]')
