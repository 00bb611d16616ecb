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

"""What single channels show: outliers, saturation, values that are held, or never change."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification.finding import Finding
from tudor_dynamics.typing import FloatArray

FAR = 20.0
"""An outlier is as many times farther off than 99.5 % of the samples are."""
LARGE = 0.3
"""... and by this part of the channel's range or more."""
SINGLE = 3
"""More samples in a row are no outliers."""
HELD_SECONDS = 0.4
"""A channel that keeps one value for longer while the arm moves is held [s]."""
LIVELY = 10
"""As many times its longest other run of one value is a hold by itself."""
FLAT = 4
"""Samples in a row at the end of the range that make a saturation."""
FLAT_SHARE = 0.004
"""... and the share of all samples there."""
STANDSTILL = 3.0
"""Ends without motion that are longer are told of [s]."""


@dataclass(frozen=True, eq=False)
class Channel:
    """A column of a recording."""

    field: str  # array it stands in
    name: str  # joint or gauge
    column: int  # column of the array
    values: FloatArray  # samples in their unit, (n,)

    @property
    def words(self) -> str:
        """Name it in a sentence."""
        return {'q': 'position of', 'effort': 'effort of', 'strain': 'gauge'}[
            self.field] + f' {self.name}'


def channels(
    recording: Recording, joints: tuple[str, ...], gauges: tuple[str, ...],
) -> Iterator[Channel]:
    """Go through positions, efforts and strains, by joint and gauge."""
    for field, names in (('q', joints), ('effort', joints), ('strain', gauges)):
        values = getattr(recording, field)
        if values is not None:
            for i, name in enumerate(names):
                yield Channel(field, name, i, values[:, i])


def outliers(
    recording: Recording, joints: tuple[str, ...], gauges: tuple[str, ...],
) -> tuple[Recording, list[Finding]]:
    """Find single samples that are far off, and give the recording without them."""
    changed: dict[str, FloatArray] = {}
    findings = []
    for item in channels(recording, joints, gauges):
        where, size = _far_off(item.values, recording.segments)
        if not len(where):
            continue
        values = changed.setdefault(item.field, getattr(recording, item.field).copy())
        good = np.setdiff1d(np.arange(len(item.values)), where)
        values[where, item.column] = np.interp(where, good, item.values[good])
        at = float(recording.t[where[0]])
        many = f'{len(where)} samples' if len(where) > 1 else 'one sample'
        findings.append(Finding(
            'outlier', f'{item.words}: {many} far off by up to {size:.4g}, the first at '
            f'{at:.3f} s', 'repair the driver or the wiring, or leave this part out with '
            'BAG@BEGIN-END%', recording.path, (item.name,), at, size))
    if not changed:
        return recording, findings
    return replace(recording, q=changed.get('q', recording.q),
                   effort=changed.get('effort', recording.effort),
                   strain=changed.get('strain', recording.strain)), findings


def _far_off(x: FloatArray, segments: tuple[slice, ...]) -> tuple[NDArray[np.intp], float]:
    found: list[int] = []
    largest = 0.0
    if not len(x):
        return np.zeros(0, dtype=np.intp), 0.0
    low, high = np.percentile(x, [1.0, 99.0])
    jumps = [np.abs(np.diff(x[part])) for part in segments if part.stop - part.start > 2]
    if not jumps:
        return np.zeros(0, dtype=np.intp), 0.0
    usual = float(np.percentile(np.concatenate(jumps), 99.5))
    limit = max(FAR * usual, LARGE * float(high - low), 1e-300)
    for part in segments:
        values = x[part]
        steps = np.diff(values)
        for first in np.flatnonzero(np.abs(steps) > limit):
            for width in range(1, SINGLE + 1):
                last = first + width
                if last >= len(values) - 1 or abs(steps[last]) <= limit:
                    continue
                if abs(values[last + 1] - values[first]) < 0.3 * abs(steps[first]):
                    found += range(part.start + first + 1, part.start + last + 1)
                    largest = max(largest, abs(float(steps[first])))
                    break
    return np.unique(np.array(found, dtype=np.intp)), largest


def runs(x: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Give first sample and length of each run of equal values of ``x``."""
    change = np.flatnonzero(np.diff(x) != 0.0) + 1
    first = np.concatenate([[0], change])
    return first, np.diff(np.concatenate([first, [len(x)]]))


def flat(
    recording: Recording, joints: tuple[str, ...], gauges: tuple[str, ...],
) -> list[Finding]:
    """Find outputs that never change, are held, die, or are saturated."""
    moves = moving(recording)
    findings = []
    for item in channels(recording, joints, gauges):
        if item.field == 'q' or not moves.any():
            continue
        if np.ptp(item.values) == 0.0:
            findings.append(Finding(
                'constant', f'{item.words} never changes (always {item.values[0]:.4g})',
                'check sensor and driver; the channel cannot be learned', recording.path,
                (item.name,), 0.0, float(item.values[0])))
            continue
        found = _held(recording, item, moves) or _saturated(recording, item)
        if found is not None:
            findings.append(found)
    return findings


def moving(recording: Recording) -> NDArray[np.bool_]:
    """
    Say at which samples a joint moves.

    Returns (n,), True where a joint is within a tenth of a second of a motion.
    """
    width = max(1, round(0.1 / recording.dt))
    found = np.zeros(len(recording.stamp), dtype=bool)
    spans = np.subtract(*np.percentile(recording.q, [99.0, 1.0], axis=0))
    least = np.maximum(2e-3 * spans, 2e-4)
    for part in recording.segments:
        q = recording.q[part]
        if len(q) <= width:
            continue
        gone = np.any(np.abs(q[width:] - q[:-width]) > least, axis=1)
        here = found[part]
        here[:-width] |= gone
        here[width:] |= gone
    return found


def _held(
    recording: Recording, item: Channel, moves: NDArray[np.bool_],
) -> Finding | None:
    first, length = runs(item.values)
    order = np.argsort(length)[::-1]
    longest = int(order[0])
    begin, end = int(first[longest]), int(first[longest] + length[longest])
    t = recording.t
    seconds = float(t[end - 1] - t[begin])
    ends = item.values[begin] in (item.values.min(), item.values.max())
    # before a filter has begun it gives zeros
    others = length[order[1:]][first[order[1:]] > 0]
    usual = int(others[0]) if len(others) else 1
    if seconds < HELD_SECONDS or length[longest] < 4 * usual:
        return None
    still = ~moves
    still[begin:end] = still[:int(length[0])] = False
    # where it never keeps a value long, not even while the arm stands, less motion is enough
    lively = begin > 0 and length[longest] > LIVELY * usual and (
        float(moves[begin:end].sum()) * recording.dt > HELD_SECONDS
        or still.sum() > 0.5 * length[longest])
    if not lively and np.mean(moves[begin:end]) < 0.7:
        return None
    at = float(t[begin])
    value = float(item.values[begin])
    if end >= len(t) - 1:
        return Finding(
            'dying', f'{item.words} dies at {at:.2f} s: {value:.4g} from there to the end',
            f'check sensor and wiring; use BAG@0-{100 * at / t[-1]:.0f}% until then',
            recording.path, (item.name,), at, seconds, 's')
    if ends and len(others) > 2 and int(others[2]) * 6 > length[longest]:
        return None  # several visits to the end of the range are a saturation
    return Finding(
        'held', f'{item.words} keeps {value:.4g} for {seconds:.3g} s from {at:.2f} s on, while '
        'the arm moves', 'check sensor, wiring and driver; leave this part out with '
        'BAG@BEGIN-END%', recording.path, (item.name,), at, seconds, 's')


def _saturated(recording: Recording, item: Channel) -> Finding | None:
    first, length = runs(item.values)
    at = item.values[first]
    for bound in (float(item.values.max()), float(item.values.min())):
        inside = at == bound
        flats = length[inside]
        share = float(flats.sum()) / len(item.values)
        # a sensor with few digits has flat runs everywhere: those at the end must stand out
        elsewhere = float(np.percentile(length[~inside], 99.0)) if np.any(~inside) else 1.0
        if flats.max() >= max(FLAT, 3.0 * elsewhere) and share > FLAT_SHARE:
            when = float(recording.t[first[inside][np.argmax(flats)]])
            begin = float(recording.t[first[inside][flats >= FLAT][0]])
            return Finding(
                'saturated', f'{item.words} is saturated at {bound:.4g}: {100 * share:.2g} % of '
                f'the samples, the first at {begin:.2f} s, the longest at {when:.2f} s',
                'widen the range of amplifier or driver, or move more slowly', recording.path,
                (item.name,), begin, bound)
    return None


def standstill(recording: Recording, moves: NDArray[np.bool_]) -> list[Finding]:
    """Tell of standstill before and after the motion: moves (n,)."""
    if not moves.any():
        return []
    t = recording.t
    places = np.flatnonzero(moves)
    before, after = float(t[places[0]]), float(t[-1] - t[places[-1]])
    if max(before, after) < STANDSTILL:
        return []
    begin, end = 100.0 * before / t[-1], 100.0 * (1.0 - after / t[-1])
    return [Finding(
        'standstill', f'the arm stands still for {before:.3g} s before and {after:.3g} s after '
        'the motion', f'use BAG@{np.floor(begin):.0f}-{np.ceil(end):.0f}%', recording.path, (),
        0.0 if before >= STANDSTILL else float(t[-1]) - after, before + after, 's')]
