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

"""What single channels show: outliers, saturation, drift, held values, wrong units."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification.doctor import settings
from tudor_dynamics.identification.doctor.case import Case, Explained
from tudor_dynamics.identification.doctor.findings import Finding, found
from tudor_dynamics.load.rows import BELIEVED, Described, described_masses
from tudor_dynamics.typing import FloatArray


def trends(
    case: Case, name: str, explained: Explained, output: FloatArray,
) -> list[Finding]:
    """
    Look for drift and for channels that die, in the residuals of the bag's own model.

    output (n, channels).
    """
    t = case.decimated.t
    line = (t - t.mean())[:, None]
    straight = explained.extended(line)
    findings = []
    for i, channel in enumerate(case.bodies[name].channels):
        if not case.sound[name][i]:
            continue
        y = output[:, i]
        dead = _dies(explained, i, t, y)
        if dead is not None:
            findings.append(found(
                'dying', f'{_words(name)} {channel} follows the arm no more from {dead:.2f} s on',
                case.recording.path, (channel,), time=dead, size=float(t[-1]) - dead,
                remedy=_until(case.recording, dead)))
            continue
        both = straight.alone(i, y[:, None])[0]
        now = explained.alone(i, y[:, None])[0]
        # the slope by Frisch and Waugh: both sides freed of all other columns
        x, z = explained.rest(i, line[:, 0]), explained.rest(i, y)
        rise = float(x @ z) / max(float(x @ x), 1e-300) * float(t[-1] - t[0])
        if (np.log(now / both) > settings.DRIFT_GAIN * case.brevity
                and abs(rise) > settings.DRIFT_SIZE * float(np.std(y))):
            findings.append(found(
                'drift', f'{_words(name)} {channel} drifts by {rise:.4g} in '
                f'{t[-1] - t[0]:.4g} s', case.recording.path, (channel,), time=0.0, size=rise,
                now=float(np.sqrt(now)), otherwise=float(np.sqrt(both))))
    return findings


def _words(name: str) -> str:
    return {'q': 'position of', 'effort': 'effort of', 'strain': 'gauge'}[name]


def _until(recording: Recording, time: float) -> str:
    return f'check sensor and wiring; use BAG@0-{100 * time / recording.t[-1]:.0f}% until then'


def _dies(explained: Explained, channel: int, t: FloatArray, y: FloatArray) -> float | None:
    """
    Say from when on a channel is quiet to the end, though the arm moves on.

    What is expected of it comes from what it measured before: what is dead would teach to expect
    little.
    """
    if t[-1] - t[0] < settings.SHORTEST:
        return None  # windows of less than half a second are too short to judge
    edges = np.linspace(t[0], t[-1], settings.WINDOWS + 1)
    for k in range(settings.WINDOWS // 4, settings.WINDOWS - 1):
        before = t < edges[k]
        lived, after = float(np.std(y[before])), y[~before]
        if float(np.std(after)) > settings.QUIET * lived:
            continue
        expected = explained.predicted(channel, y, before)
        error, spread = float(np.std((y - expected)[before])), float(np.std(expected[~before]))
        if error > settings.ALIVE * lived or spread < settings.EXPECTED * lived:
            continue  # nobody knows what it did, or it may well be quiet
        if float(np.std(after)) > settings.QUIET * spread:
            continue
        # what was predicted may be wrong: both parts together must not be explained as well
        apart = float(np.sum((y - expected)[before] ** 2)) + len(after) * float(np.var(after))
        together = y - explained.predicted(channel, y, np.ones(len(y), dtype=bool))
        if np.log(float(together @ together) / max(apart, 1e-300)) > settings.DEAD_GAIN:
            return _last_alive(edges[:k + 1], t, y, expected)
    return None


def _last_alive(edges: FloatArray, t: FloatArray, y: FloatArray, expected: FloatArray) -> float:
    for begin, end in zip(edges[-2::-1], edges[:0:-1], strict=True):
        inside = (t >= begin) & (t <= end)
        x, z = expected[inside], y[inside]
        x, z = x - x.mean(), z - z.mean()
        if float(x @ z) > settings.FOLLOWS * float(x @ x):
            return float(end)
    return float(edges[0])


def sizes(case: Case) -> list[Finding]:
    """Find efforts whose size is that of another unit."""
    effort = case.outputs['effort']
    units = [joint.effort.unit for joint in case.arm.joints]
    largest = np.abs(effort).max(axis=0)
    limits = np.array([float(case.arm.model.effortLimit[case.arm.velocity_index[i]])
                       for i in range(len(units))])
    bounds = np.array([settings.LARGEST_EFFORT[unit] for unit in units])
    for i, unit in enumerate(units):
        if unit != 'A' and 0.0 < limits[i] < settings.UNLIMITED:
            bounds[i] = min(bounds[i], settings.BEYOND_LIMIT * limits[i])
    over = [i for i in range(len(units)) if largest[i] > bounds[i]]
    known = described_masses(case.arm, case.motion, effort)
    if not over:
        return [] if known is None else _by_masses(case, known)
    if known is None or units[over[0]] == 'A':
        # what is a thousandth of the largest is in the same unit as that
        all_of_them = len(over) > len(units) / 2
    else:
        all_of_them = (len(known.believed) > 1
                       and float(np.median(known.believed)) > settings.THOUSANDTH)
    names = case.arm.active_joints
    chosen = tuple(names) if all_of_them else tuple(names[i] for i in over)
    most = max(over, key=lambda i: largest[i] / bounds[i])
    what = (f'effort of {", ".join(chosen)} reaches {largest[most]:.4g} where the description '
            f'says {units[most]}: it looks like m{units[most]}')
    now = float(largest[most])
    return [found('effort_unit', what, case.recording.path, chosen, size=1000.0, now=now,
                  otherwise=now / 1000.0, measure='largest effort')]


def _by_masses(case: Case, known: Described) -> list[Finding]:
    joints = case.arm.joints
    described = [i for i in range(len(joints)) if joints[i].effort.unit != 'A'
                 and known.share[i] > BELIEVED]
    if len(described) < 2:
        return []
    ratio = float(np.median(np.abs(known.ratio[described])))
    if 1.0 / settings.FEW_TIMES < ratio < settings.FEW_TIMES:
        return []
    thousand = not 1.0 / settings.THOUSANDTH < ratio < settings.THOUSANDTH
    size = 1000.0 if ratio > settings.THOUSANDTH else 0.001 if thousand else ratio
    unit = joints[described[0]].effort.unit
    other = f'm{unit}' if size == 1000.0 else f'k{unit}' if size == 0.001 else 'currents in A'
    what = (f'all efforts are {ratio:.3g} times what the masses of the URDF need: they look like '
            f'{other}, not {unit}')
    return [found('effort_unit', what, case.recording.path, case.arm.active_joints, size=size,
                  now=ratio, otherwise=ratio / size,
                  measure='measured effort over that of the masses')]


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
        return f'{_words(self.field)} {self.name}'


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
    changed: dict[str, Any] = {}
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
        findings.append(found(
            'outlier', f'{item.words}: {many} far off by up to {size:.4g}, the first at '
            f'{at:.3f} s', recording.path, (item.name,), time=at, size=size))
    return (replace(recording, **changed) if changed else recording), findings


def _far_off(x: FloatArray, segments: tuple[slice, ...]) -> tuple[NDArray[np.intp], float]:
    places: list[int] = []
    largest = 0.0
    if not len(x):
        return np.zeros(0, dtype=np.intp), 0.0
    low, high = np.percentile(x, [1.0, 99.0])
    jumps = [np.abs(np.diff(x[part])) for part in segments if part.stop - part.start > 2]
    if not jumps:
        return np.zeros(0, dtype=np.intp), 0.0
    usual = float(np.percentile(np.concatenate(jumps), 99.5))
    limit = max(settings.FAR * usual, settings.FAR_RANGE * float(high - low), 1e-300)
    for part in segments:
        values = x[part]
        steps = np.diff(values)
        for first in np.flatnonzero(np.abs(steps) > limit):
            for width in range(1, settings.SINGLE + 1):
                last = first + width
                if last >= len(values) - 1 or abs(steps[last]) <= limit:
                    continue
                if abs(values[last + 1] - values[first]) < settings.RETURNED * abs(steps[first]):
                    places += range(part.start + first + 1, part.start + last + 1)
                    largest = max(largest, abs(float(steps[first])))
                    break
    return np.unique(np.array(places, dtype=np.intp)), largest


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
            findings.append(found(
                'constant', f'{item.words} never changes (always {item.values[0]:.4g})',
                recording.path, (item.name,), time=0.0, size=float(item.values[0])))
            continue
        finding = _held(recording, item, moves) or _saturated(recording, item)
        if finding is not None:
            findings.append(finding)
    return findings


def moving(recording: Recording) -> NDArray[np.bool_]:
    """
    Say at which samples a joint moves.

    Returns (n,), True where a joint is within a tenth of a second of a motion.
    """
    width = max(1, round(0.1 / recording.dt))
    result = np.zeros(len(recording.stamp), dtype=bool)
    spans = np.subtract(*np.percentile(recording.q, [99.0, 1.0], axis=0))
    least = np.maximum(2e-3 * spans, 2e-4)
    for part in recording.segments:
        q = recording.q[part]
        if len(q) <= width:
            continue
        gone = np.any(np.abs(q[width:] - q[:-width]) > least, axis=1)
        here = result[part]
        here[:-width] |= gone
        here[width:] |= gone
    return result


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
    if seconds < settings.HELD_SECONDS or length[longest] < 4 * usual:
        return None
    still = ~moves
    still[begin:end] = still[:int(length[0])] = False
    # where it never keeps a value long, not even while the arm stands, less motion is enough
    lively = begin > 0 and length[longest] > settings.LIVELY * usual and (
        float(moves[begin:end].sum()) * recording.dt > settings.HELD_SECONDS
        or still.sum() > 0.5 * length[longest])
    if not lively and np.mean(moves[begin:end]) < 0.7:
        return None
    at = float(t[begin])
    value = float(item.values[begin])
    if end >= len(t) - 1:
        return found(
            'dying', f'{item.words} dies at {at:.2f} s: {value:.4g} from there to the end',
            recording.path, (item.name,), time=at, size=seconds, remedy=_until(recording, at))
    if ends and len(others) > 2 and int(others[2]) * 6 > length[longest]:
        return None  # several visits to the end of the range are a saturation
    return found(
        'held', f'{item.words} keeps {value:.4g} for {seconds:.3g} s from {at:.2f} s on, while '
        'the arm moves', recording.path, (item.name,), time=at, size=seconds)


def _saturated(recording: Recording, item: Channel) -> Finding | None:
    first, length = runs(item.values)
    at = item.values[first]
    for bound in (float(item.values.max()), float(item.values.min())):
        inside = at == bound
        flats = length[inside]
        share = float(flats.sum()) / len(item.values)
        # a sensor with few digits has flat runs everywhere: those at the end must stand out
        elsewhere = float(np.percentile(length[~inside], 99.0)) if np.any(~inside) else 1.0
        if flats.max() >= max(settings.FLAT, 3.0 * elsewhere) and share > settings.FLAT_SHARE:
            when = float(recording.t[first[inside][np.argmax(flats)]])
            begin = float(recording.t[first[inside][flats >= settings.FLAT][0]])
            return found(
                'saturated', f'{item.words} is saturated at {bound:.4g}: {100 * share:.2g} % of '
                f'the samples, the first at {begin:.2f} s, the longest at {when:.2f} s',
                recording.path, (item.name,), time=begin, size=bound)
    return None


def standstill(recording: Recording, moves: NDArray[np.bool_]) -> list[Finding]:
    """Report standstill before and after the motion: moves (n,)."""
    if not moves.any():
        return []
    t = recording.t
    places = np.flatnonzero(moves)
    before, after = float(t[places[0]]), float(t[-1] - t[places[-1]])
    if max(before, after) < settings.STANDSTILL:
        return []
    begin, end = 100.0 * before / t[-1], 100.0 * (1.0 - after / t[-1])
    return [found(
        'standstill', f'the arm stands still for {before:.3g} s before and {after:.3g} s after '
        'the motion', recording.path, size=before + after,
        time=0.0 if before >= settings.STANDSTILL else float(t[-1]) - after,
        remedy=f'use BAG@{np.floor(begin):.0f}-{np.ceil(end):.0f}%')]
