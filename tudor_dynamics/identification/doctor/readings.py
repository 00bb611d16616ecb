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

"""What readings show that no arm does: jumps, repeats, copies, zeros, few digits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
import math

import numpy as np

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification import settings
from tudor_dynamics.identification.dataset import parse_choice
from tudor_dynamics.identification.doctor.findings import Finding, found
from tudor_dynamics.typing import FloatArray, IndexArray

SINGULAR = {'q': 'position of', 'effort': 'effort of', 'strain': 'gauge'}


@dataclass(frozen=True, eq=False)
class Channel:
    """A column of a recording."""

    field: str  # array it stands in
    name: str  # joint or gauge
    column: int  # column of the array
    values: FloatArray  # samples in their unit, (n,)
    bag: str

    def found(self, kind: str, what: str, time: float, size: float, remedy: str = '') -> Finding:
        """Say what it does."""
        return found(kind, f'{SINGULAR[self.field]} {self.name}{what}', self.bag, (self.name,),
                     time=time, size=size, remedy=remedy)


def channels(
    recording: Recording, joints: tuple[str, ...], gauges: tuple[str, ...],
) -> Iterator[Channel]:
    """Go through positions, efforts and strains, by joint and gauge."""
    for field, names in (('q', joints), ('effort', joints), ('strain', gauges)):
        values = getattr(recording, field)
        if values is not None:
            for i, name in enumerate(names):
                yield Channel(field, name, i, values[:, i], recording.path)


def runs(x: FloatArray) -> tuple[IndexArray, IndexArray]:
    """Give first sample and length of each run of equal values of ``x``."""
    first = np.flatnonzero(np.diff(x, prepend=np.nan) != 0.0)
    return first, np.diff(first, append=len(x))


def until(recording: Recording, time: float) -> str:
    """Say what to do about a channel that is of no use from a time on [s]."""
    before = parse_choice(recording.path).within(0.0, round(time / recording.t[-1], 2))
    return f'check sensor and wiring; use {before} until then'


def look_at_readings(recording: Recording, items: Sequence[Channel]) -> list[Finding]:
    """Look at each channel of a recording, and at those of a kind together."""
    findings = [*_copies(items), *_filled(recording, items)]
    for item in items:
        if np.ptp(item.values) == 0.0:
            continue
        checks = (_stale, _coarse, _jump, _noisy) if item.field == 'q' else (
            _alternating, _noise_alone, _coarse)
        findings += [one for check in checks if (one := check(recording, item)) is not None][:1]
    return findings


def _copies(items: Sequence[Channel]) -> list[Finding]:
    """Find channels that give what another one gives."""
    return [replace(other.found('copied_channel', f' and that of {one.name} have the same values',
                                0.0, 0.0), channels=(one.name, other.name))
            for one, other in combinations(items, 2) if one.field == other.field != 'q'
            and np.ptp(one.values) > 0.0 and np.std(one.values - other.values) < (
                settings.COPIED if one.field == 'effort' else settings.COPIED_EXACTLY)
            * np.std(one.values)]


def _filled(recording: Recording, items: Sequence[Channel]) -> list[Finding]:
    """Find stretches in which every channel is a straight line: no arm and no noise does that."""
    t = recording.t
    straight, slanted = np.ones(len(t) - 2, dtype=bool), np.zeros(len(t) - 2, dtype=bool)
    for item in items:
        slopes = np.diff(item.values) / np.diff(t)
        straight &= np.abs(np.diff(slopes)) <= settings.STRAIGHT * np.abs(slopes).max()
        if item.field != 'q':  # a joint may well move evenly
            slanted |= slopes[1:] != 0.0
    first, length = runs(np.where(straight & slanted, 1.0, 0.0))
    lines = (length >= settings.LINE) & (straight & slanted)[first]
    if not lines.any():
        return []
    at, seconds = float(t[first[lines][0]]), float(length[lines].sum() * recording.dt)
    return [found('filled', f'all channels are straight lines in {lines.sum()} stretches of '
                  f'{seconds:.2g} s together, the first at {at:.2f} s: lost samples were filled',
                  recording.path, time=at, size=seconds)]


def _jump(recording: Recording, item: Channel) -> Finding | None:
    """Find a step that the readings around it do not lead to, at a usual distance of stamps."""
    t = recording.t
    steps, spans = np.diff(item.values), np.diff(t)
    even = np.abs(spans / recording.dt - 1.0) < settings.EVEN_STAMPS
    for part in recording.segments[:-1]:
        even[part.stop - 1] = False
    if len(steps) < 7:
        return None
    speed = np.pad(np.where(even, steps / spans, np.nan), 3, mode='edge')
    near = np.array([np.roll(speed, k)[3:-3] for k in (-3, -2, -1, 1, 2, 3)])
    even &= np.isfinite(near).all(axis=0)
    if not even.any():
        return None
    excess = np.where(even, steps - np.median(near, axis=0) * spans, 0.0)
    least = max(settings.JUMPED * float(np.percentile(np.abs(excess), 99.5)),
                float(np.percentile(np.abs(steps[even]), 99.0)), settings.LEAST_JUMP)
    places = np.flatnonzero(np.abs(excess) > least)
    if not len(places):
        return None
    first, size, at = int(places[0]), float(excess[places[0]]), float(t[places[0] + 1])
    times = 'once' if len(places) == 1 else f'{len(places)} times'
    if math.isclose(abs(size), 2.0 * math.pi, rel_tol=settings.WRAPPED):
        return item.found('positions_wrapped', f' jumps {times} by a turn, first at {at:.2f} s',
                          at, size)
    begins, lengths = runs(item.values)
    run = int(np.searchsorted(begins, first, 'right')) - 1
    held = float(t[first] - t[begins[run]])
    if held > settings.HELD_BEFORE and lengths[run] > settings.HELD_RUN * np.median(lengths):
        return item.found('position_held', f' keeps {item.values[first]:.4g} for {held:.2g} s '
                          f'until {at:.2f} s, and then jumps by {size:.3g}', at - held, held)
    return item.found('position_jump', f' jumps {times} by up to {np.abs(excess).max():.3g}, '
                      f'which its motion does not lead to, first at {at:.2f} s', at, size)


def _noisy(recording: Recording, item: Channel) -> Finding | None:
    """Find positions that change from sample to sample as no arm can."""
    noise = float(np.median(np.abs(np.diff(item.values, 3)))) / math.sqrt(20.0) / 0.6745
    if noise < settings.NOISY:
        return None
    return item.found('noisy_positions', f' has noise of {noise:.2g}', 0.0, noise)


def _stale(recording: Recording, item: Channel) -> Finding | None:
    """Find positions that are repeated while the joint moves."""
    width = max(1, round(settings.STALE_WINDOW / recording.dt))
    gone = np.abs(item.values[width:] - item.values[:-width])
    if not len(gone):
        return None
    fast = gone > max(0.5 * float(np.percentile(gone, 95)), settings.STALE_LEAST)
    same = np.diff(item.values)[width // 2:][:len(fast)] == 0.0
    share = float(np.mean(same[fast[:len(same)]])) if fast[:len(same)].any() else 0.0
    if share < settings.STALE:
        return None
    return item.found('stale', f' repeats {100 * share:.0f} % of its values in fast motion, '
                      f'at {1.0 / recording.dt:.4g} Hz', 0.0, share)


def _alternating(recording: Recording, item: Channel) -> Finding | None:
    """Find a zero between two samples of one sign that are far from it, again and again."""
    x = item.values
    far = settings.FAR_FROM_ZERO * float(np.std(x))
    share = float(np.mean((x[1:-1] == 0.0) & (x[:-2] * x[2:] > far ** 2)))
    if share < settings.ALTERNATING:
        return None
    return item.found('alternating', f' is zero between two samples that are not, in '
                      f'{100 * share:.0f} % of the samples', 0.0, share)


def _noise_alone(recording: Recording, item: Channel) -> Finding | None:
    """Find a channel whose samples have nothing to do with the ones before."""
    x = item.values - item.values.mean()
    power = float(x @ x)
    same = [abs(float(x[k:] @ x[:-k])) / power for k in range(1, settings.WHITE_LAGS + 1)]
    if max(same) > settings.WHITE / math.sqrt(len(x)):
        return None
    return item.found('constant', f' never changes but by noise, at {item.values.mean():.4g}', 0.0,
                      float(item.values.mean()))


def _coarse(recording: Recording, item: Channel) -> Finding | None:
    """Find a channel of few digits."""
    levels = np.unique(item.values)
    step = float(np.min(np.diff(levels)))
    if item.field == 'q':
        coarse = step > settings.COARSE and len(levels) > settings.COARSE_LEVELS
        return None if not coarse else item.found(
            'coarse_positions', f' has values that are {step:.3g} apart', 0.0, step)
    if len(levels) > settings.LEVELS or len(item.values) < settings.LEVELS ** 2:
        return None
    return item.found('coarse_channel', f' has {len(levels)} values, {step:.3g} apart', 0.0, step)
