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

"""All arms beside each other: series of each quantity, and which arms are named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
import datetime

import numpy as np

from tudor_dynamics.identification.fleet.unlike import drifts, Series, unlike
from tudor_dynamics.identification.streamed.task import Sight
from tudor_dynamics.identification.worth.comparison import Change, LEAST, SIGMAS
from tudor_dynamics.library.fleet.outcome import Named, Seen


def parted(sights: Sequence[Sight], least: int) -> list[Sight]:
    """Divide few bags, so that there are enough parts for standard errors."""
    count = -(-least // len(sights))
    found = []
    for sight in sights:
        choice = sight.choice
        width = (choice.end - choice.begin) / count
        found += [sight] if count == 1 else [replace(sight, choice=replace(
            choice, begin=choice.begin + i * width, end=choice.begin + (i + 1) * width))
            for i in range(count)]
    return found


def named_beside(seen: Sequence[Seen]) -> list[Named]:
    """Compare each quantity of all arms."""
    start = min((item.date for item in seen), default=datetime.date.min)
    groups: dict[tuple[str, str, str, str], dict[str, list[Seen]]] = {}
    for item in seen:
        quantity = item.quantity
        if not 0.0 < quantity.error < float('inf'):
            continue
        key = item.output, quantity.name, quantity.channel, quantity.unit
        groups.setdefault(key, {}).setdefault(item.arm, []).append(item)
    found = []
    for (output, name, channel, unit), arms in groups.items():
        series = [_series(items, start) for items in arms.values()]
        for kind, told in (('unlike', unlike(series)), ('drift', drifts(series))):
            found += [Named(arm, kind, f'{name}, {channel} ({output})', unit, item.value,
                            item.expected, item.sigmas)
                      for arm, item in zip(arms, told, strict=True)
                      if item is not None and item.named]
    return found


def named_aged(changes: Mapping[str, Sequence[Change]]) -> list[Named]:
    """Say whose model has aged: a motion that no model knows lets the errors of all arms grow."""
    found = []
    for same in zip(*changes.values(), strict=True):
        growth = [np.log(max(item.now / item.then, 1e-12)) for item in same]
        errors = [max(abs(value / item.sigmas), 1e-3) if item.sigmas else LEAST
                  for value, item in zip(growth, same, strict=True)]
        told = unlike([Series(np.zeros(1), np.array([value]), np.array([error]))
                       for value, error in zip(growth, errors, strict=True)])
        for arm, change, beside in zip(changes, same, told, strict=True):
            if change.changed and (beside is None or beside.sigmas > SIGMAS):
                found.append(Named(
                    arm, 'aged', f'relative error of {change.output}, {change.channel}', '',
                    change.relative_now, change.relative_then, change.sigmas))
    return found


def _series(items: Sequence[Seen], start: datetime.date) -> Series:
    order = sorted(items, key=lambda item: item.date)
    return Series(np.array([float((item.date - start).days) for item in order]),
                  np.array([item.quantity.value for item in order]),
                  np.array([item.quantity.error for item in order]))
