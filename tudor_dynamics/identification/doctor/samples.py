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

"""What single channels show: outliers, held values, jumps, few digits, wrong units, stamps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.control.damper import STRAIN_SCALE
from tudor_dynamics.identification import settings
from tudor_dynamics.identification.dataset import parse_choice
from tudor_dynamics.identification.doctor.case import Case
from tudor_dynamics.identification.doctor.findings import Finding, found
from tudor_dynamics.load.rows import Described, described_masses
from tudor_dynamics.load.settings import BELIEVED
from tudor_dynamics.signals.preprocessing import Timing, timing
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
    unit: str  # of its values, after a blank; empty where it is not known

    def found(self, kind: str, what: str, time: float, size: float, remedy: str = '') -> Finding:
        """Say what it does."""
        return found(kind, f'{SINGULAR[self.field]} {self.name!r}{what}', self.bag, (self.name,),
                     time=time, size=size, remedy=remedy)


def channels(
    recording: Recording, joints: tuple[str, ...], gauges: tuple[str, ...],
    units: Mapping[tuple[str, str], str],
) -> list[Channel]:
    """List positions, efforts and strains, by joint and gauge."""
    return [Channel(field, name, i, values[:, i], recording.path, units.get(
                (field, name), ' rad or m' if field == 'q' else ''))
            for field, names in (('q', joints), ('effort', joints), ('strain', gauges))
            if (values := getattr(recording, field)) is not None
            for i, name in enumerate(names)]


def runs(x: FloatArray) -> tuple[IndexArray, IndexArray]:
    """Give first sample and length of each run of equal values of ``x``."""
    first = np.flatnonzero(np.diff(x, prepend=np.nan) != 0.0)
    return first, np.diff(first, append=len(x))


def until(recording: Recording, time: float) -> str:
    """Say what to do about a channel that is of no use from a time on [s]."""
    before = parse_choice(recording.path).within(0.0, round(time / recording.t[-1], 2))
    return f'check sensor and wiring; use only this part of the bag: {before}'


def look_at_samples(
    recording: Recording, joints: tuple[str, ...], gauges: tuple[str, ...],
    retimed: Timing | None = None, units: Mapping[tuple[str, str], str] | None = None,
) -> tuple[Recording, list[Finding]]:
    """Look at what needs no description: samples and stamps; give the bag without outliers."""
    clean, findings = outliers(recording, channels(recording, joints, gauges, units or {}))
    items, moves = channels(clean, joints, gauges, units or {}), moving(clean)
    if moves.any():
        findings += [*flat(clean, items, moves), *look_at_readings(clean, items),
                     *standstill(clean, moves)]
    return clean, [*findings, *oddities(recording), *jitter(clean, retimed)]


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
    return [replace(other.found('copied_channel', f' equals {SINGULAR[one.field]} {one.name!r}',
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
    return [found('filled', f'all signals are straight lines during {seconds:.2g} s of the bag, '
                  f'first at {at:.2f} s, so lost samples were probably interpolated',
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
    times, since = ('once', 'at') if len(places) == 1 else (f'{len(places)} times', 'first at')
    if math.isclose(abs(size), 2.0 * math.pi, rel_tol=settings.WRAPPED):
        return item.found('positions_wrapped', f' jumps {times} by a full turn, {since} '
                          f'{at:.2f} s', at, size)
    begins, lengths = runs(item.values)
    run = int(np.searchsorted(begins, first, 'right')) - 1
    held = float(t[first] - t[begins[run]])
    if held > settings.HELD_BEFORE and lengths[run] > settings.HELD_RUN * np.median(lengths):
        return item.found('position_held', f' stays at {item.values[first]:.4g} for {held:.2g} s, '
                          f'then jumps by {size:.3g}{item.unit} at {at:.2f} s', at - held, held)
    return item.found('position_jump', f' jumps {times} by up to {np.abs(excess).max():.3g}'
                      f'{item.unit} between two samples, {since} {at:.2f} s', at, size)


def _noisy(recording: Recording, item: Channel) -> Finding | None:
    """Find positions that change from sample to sample as no arm can."""
    noise = float(np.median(np.abs(np.diff(item.values, 3)))) / math.sqrt(20.0) / 0.6745
    return None if noise < settings.NOISY else item.found(
        'noisy_positions', f' has noise of {noise:.2g}{item.unit} rms (limit {settings.NOISY:g})',
        0.0, noise)


def _stale(recording: Recording, item: Channel) -> Finding | None:
    """Find positions that are repeated while the joint moves."""
    width = max(1, round(settings.STALE_WINDOW / recording.dt))
    gone = np.abs(item.values[width:] - item.values[:-width])
    if not len(gone):
        return None
    fast = gone > max(0.5 * float(np.percentile(gone, 95)), settings.STALE_LEAST)
    same = np.diff(item.values)[width // 2:][:len(fast)] == 0.0
    share = float(np.mean(same[fast[:len(same)]])) if fast[:len(same)].any() else 0.0
    return None if share < settings.STALE else item.found(
        'stale', f' repeats the previous value in {100 * share:.0f} % of the samples of fast '
        f'motion (at {1.0 / recording.dt:.4g} Hz)', 0.0, share)


def _alternating(recording: Recording, item: Channel) -> Finding | None:
    """Find a zero between two samples of one sign that are far from it, again and again."""
    x = item.values
    far = settings.FAR_FROM_ZERO * float(np.std(x))
    share = float(np.mean((x[1:-1] == 0.0) & (x[:-2] * x[2:] > far ** 2)))
    return None if share < settings.ALTERNATING else item.found(
        'alternating', f' is zero between nonzero neighbours in {100 * share:.0f} % of its '
        'samples', 0.0, share)


def _noise_alone(recording: Recording, item: Channel) -> Finding | None:
    """Find a channel whose samples have nothing to do with the ones before."""
    x = item.values - item.values.mean()
    power = float(x @ x)
    same = [abs(float(x[k:] @ x[:-k])) / power for k in range(1, settings.WHITE_LAGS + 1)]
    mean = float(item.values.mean())
    return None if max(same) > settings.WHITE / math.sqrt(len(x)) else item.found(
        'constant', f' shows nothing but noise around {mean:.4g}{item.unit}', 0.0, mean)


def _coarse(recording: Recording, item: Channel) -> Finding | None:
    """Find a channel of few digits."""
    levels = np.unique(item.values)
    step = float(np.min(np.diff(levels)))
    if item.field == 'q':
        coarse = step > settings.COARSE and len(levels) > settings.COARSE_LEVELS
        return None if not coarse else item.found(
            'coarse_positions', f' changes in steps of {step:.3g}{item.unit} (limit '
            f'{settings.COARSE:g})', 0.0, step)
    if len(levels) > settings.LEVELS or len(item.values) < settings.LEVELS ** 2:
        return None
    return item.found('coarse_channel', f' has only {len(levels)} different values, although more '
                      f'than {settings.LEVELS} are expected', 0.0, step)


def sizes(case: Case) -> list[Finding]:
    """Find efforts and strains whose size is that of another unit."""
    read = np.abs(case.outputs.get('strain', np.zeros((1, len(case.arm.gauges))))).max(axis=0)
    over = {gauge.name: strain for gauge, x in zip(case.arm.gauges, read.tolist(), strict=True)
            if (strain := x / STRAIN_SCALE.get(gauge.unit, math.inf)) > settings.LARGEST_STRAIN}
    most = max(over.values(), default=0.0)
    return _efforts(case) if not over else [*_efforts(case), found(
        'strain_unit', f'gauge {", ".join(map(repr, over))} reads {100.0 * most:.3g} % strain, '
        'which no link survives: its unit must be another one', case.recording.path, tuple(over),
        size=1e3 if most < 1e3 * settings.LARGEST_STRAIN else 1e6)]


def _efforts(case: Case) -> list[Finding]:
    if 'effort' not in case.outputs:
        return []
    arm, effort = case.arm, case.outputs['effort']
    units = [joint.effort.unit for joint in arm.joints]
    largest = np.abs(effort).max(axis=0)
    bounds = np.array([settings.LARGEST_EFFORT[unit] for unit in units])
    for i, limit in enumerate(arm.model.effortLimit[arm.velocity_index].tolist()):
        if units[i] != 'A' and 0.0 < limit < settings.UNLIMITED:
            bounds[i] = min(bounds[i], settings.BEYOND_LIMIT * limit)
    over = np.flatnonzero(largest > bounds).tolist()
    known = described_masses(arm, case.motion, effort)
    if not over:
        return [] if known is None else _by_masses(case, known)
    if known is None or units[over[0]] == 'A':
        # what is a thousandth of the largest is in the same unit as that
        all_of_them = len(over) > len(units) / 2
    else:
        all_of_them = (len(known.believed) > 1
                       and float(np.median(known.believed)) > settings.THOUSANDTH)
    chosen = arm.active_joints if all_of_them else tuple(arm.active_joints[i] for i in over)
    most = max(over, key=lambda i: largest[i] / bounds[i])
    now = float(largest[most])
    return [found(
        'effort_unit', f'effort of {", ".join(map(repr, chosen))} reaches {now:.4g} {units[most]} '
        f'(limit {bounds[most]:.4g}): it looks like m{units[most]}', case.recording.path, chosen,
        size=1000.0, now=now, otherwise=now / 1000.0, measure='largest effort')]


def _by_masses(case: Case, known: Described) -> list[Finding]:
    units = [joint.effort.unit for joint in case.arm.joints]
    described = [i for i, unit in enumerate(units) if unit != 'A' and known.share[i] > BELIEVED
                 and case.moves[i]]
    if len(described) < 2:
        return []
    ratio = float(np.median(np.abs(known.ratio[described])))
    if 1.0 / settings.FEW_TIMES < ratio < 1e3 / settings.FEW_TIMES:
        return []  # rough masses; no unit is a few times larger
    unit = units[described[0]]
    size, other = ((1000.0, f'm{unit}') if ratio > 1.0 else
                   (0.001, f'k{unit}') if ratio < 1.0 / settings.THOUSANDTH else
                   (ratio, 'currents in A'))
    return [found(
        'effort_unit', f'all efforts are {ratio:.3g} times what the masses in the URDF need, '
        f'so they look like {other}, not {unit}', case.recording.path, case.arm.active_joints,
        size=size, now=ratio, otherwise=ratio / size,
        measure='ratio of measured efforts to those of the masses in the URDF')]


def outliers(recording: Recording, items: Sequence[Channel]) -> tuple[Recording, list[Finding]]:
    """Find single samples that are far off, and give the recording without them."""
    changed: dict[str, Any] = {}
    findings = []
    for item in items:
        where = _far_off(item.values, recording.segments,
                         settings.LEAST_FAR if item.field == 'q' else 1e-300)
        if not len(where):
            continue
        values = changed.setdefault(item.field, getattr(recording, item.field).copy())
        good = np.setdiff1d(np.arange(len(item.values)), where)
        values[where, item.column] = np.interp(where, good, item.values[good])
        size = float(np.max(np.abs(values[where, item.column] - item.values[where])))
        at = float(recording.t[where[0]])
        many = f'{len(where)} samples' if len(where) > 1 else 'one sample'
        findings.append(item.found('outlier', f' differs from its neighbours by up to {size:.4g}'
                                   f'{item.unit} in {many}, first at {at:.3f} s', at, size))
    return replace(recording, **changed) if changed else recording, findings


def _far_off(x: FloatArray, segments: tuple[slice, ...], least: float) -> IndexArray:
    steps = np.diff(x)
    steps[[part.stop - 1 for part in segments[:-1]]] = 0.0
    # what the next step takes back is noise, however fast the motion is
    back = np.sqrt(np.maximum(-steps[:-1] * steps[1:], 0.0))
    span = float(np.subtract(*np.percentile(x, [99.0, 1.0])))
    wide, single = (
        max(far * float(np.percentile(np.append(usual, 0.0), 99.5)), share * span, least)
        for usual, far, share in ((np.abs(steps), settings.FAR, settings.FAR_RANGE),
                                  (back, settings.FAR_BACK, settings.FAR_BACK_RANGE)))
    places: list[int] = []
    for width in range(1, settings.SINGLE + 1):
        there = np.abs(steps[:-width])
        off = (np.minimum(there, np.abs(steps[width:])) > (
            wide if width > 1 else min(wide, single))) & (
                np.abs(x[width + 1:] - x[:-width - 1]) < settings.RETURNED * there)
        places += [at + k for at in np.flatnonzero(off).tolist() for k in range(1, width + 1)]
    return np.unique(np.array(places, dtype=np.intp))


def flat(
    recording: Recording, items: Sequence[Channel], moves: NDArray[np.bool_],
) -> list[Finding]:
    """Find outputs that never change, are held, die, or are saturated: moves (n,)."""
    findings: list[Finding | None] = []
    for item in items:
        if item.field == 'q':
            continue
        if np.ptp(item.values) == 0.0:
            value = float(item.values[0])
            findings.append(item.found(
                'constant', f' is always {value:.4g}{item.unit}', 0.0, value))
        else:
            findings.append(_held(recording, item, moves) or _saturated(recording.t, item))
    return [finding for finding in findings if finding is not None]


def moving(recording: Recording) -> NDArray[np.bool_]:
    """Say at which samples (n,) a joint is within a tenth of a second of a motion."""
    width = max(1, round(0.1 / recording.dt))
    result = np.zeros(len(recording.stamp), dtype=bool)
    spans = np.subtract(*np.percentile(recording.q, [99.0, 1.0], axis=0))
    least = np.maximum(2e-3 * spans, 2e-4)
    for part in recording.segments:
        q = recording.q[part]
        gone = np.any(np.abs(q[width:] - q[:-width]) > least, axis=1)
        here = result[part]
        here[:-width] |= gone
        here[width:] |= gone
    return result


def _held(recording: Recording, item: Channel, moves: NDArray[np.bool_]) -> Finding | None:
    t, values = recording.t, item.values
    first, length = runs(values)
    order = np.argsort(length)[::-1]
    longest = int(length[order[0]])
    begin = int(first[order[0]])
    end = begin + longest
    at, seconds = float(t[begin]), float(t[end - 1] - t[begin])
    # before a filter has begun it gives zeros
    others = length[order[1:]][first[order[1:]] > 0]
    usual = int(others[0]) if len(others) else 1
    if seconds < settings.HELD_SECONDS or longest < settings.HELD_RUN * usual:
        return None
    still = ~moves
    still[begin:end] = still[:int(length[0])] = False
    # where it never keeps a value long, not even while the arm stands, less motion is enough
    lively = begin > 0 and longest > settings.LIVELY * usual and (
        float(moves[begin:end].sum()) * recording.dt > settings.HELD_SECONDS
        or still.sum() > 0.5 * longest)
    if not lively and np.mean(moves[begin:end]) < settings.HELD_MOVING:
        return None
    value = float(values[begin])
    if end >= len(t) - 1:
        return item.found('dying', f' stays at {value:.4g}{item.unit} from {at:.2f} s to the end',
                          at, seconds, until(recording, at))
    if (value in (values.min(), values.max()) and len(others) > 2
            and int(others[2]) * settings.VISITS > longest):
        return None  # several visits to the end of the range are a saturation
    return item.found('held', f' stays at {value:.4g}{item.unit} for {seconds:.3g} s from '
                      f'{at:.2f} s on, while the arm moves', at, seconds)


def _saturated(t: FloatArray, item: Channel) -> Finding | None:
    first, length = runs(item.values)
    for bound in (float(item.values.max()), float(item.values.min())):
        inside = item.values[first] == bound
        flats, times = length[inside], t[first[inside]]
        share = float(flats.sum()) / len(item.values)
        # a sensor with few digits has flat runs everywhere: those at the end must stand out
        elsewhere = float(np.percentile(length[~inside], 99.0)) if np.any(~inside) else 1.0
        if (flats.max() >= max(settings.FLAT, settings.FLAT_RUN * elsewhere)
                and share > settings.FLAT_SHARE):
            begin = float(times[flats >= settings.FLAT][0])
            return item.found(
                'saturated', f' is saturated at {bound:.4g}{item.unit} in {100 * share:.2g} % of '
                f'samples, first at {begin:.2f} s; its longest saturation begins at '
                f'{times[np.argmax(flats)]:.2f} s', begin, bound)
    return None


def standstill(recording: Recording, moves: NDArray[np.bool_]) -> list[Finding]:
    """Report standstill before and after the motion: moves (n,)."""
    t, places = recording.t, np.flatnonzero(moves)
    before, after = float(t[places[0]]), float(t[-1] - t[places[-1]])
    if max(before, after) < settings.STANDSTILL:
        return []
    moving = parse_choice(recording.path).within(
        np.floor(100.0 * before / t[-1]) / 100.0, np.ceil(100.0 * (1.0 - after / t[-1])) / 100.0)
    return [found(
        'standstill', f'standstill of {before:.3g} s before and {after:.3g} s after the motion',
        recording.path, size=before + after,
        time=0.0 if before >= settings.STANDSTILL else float(t[-1]) - after,
        remedy=f'use {moving} in place of {recording.path}')]


def jitter(recording: Recording, retimed: Timing | None) -> list[Finding]:
    """Report stamps that jitter on an even sampling."""
    uneven = retimed or timing(recording)
    if uneven is None or not uneven.clear:
        return []
    done = '; evenly spaced stamps are used instead' if retimed is not None else ''
    return [found(
        'jitter', f'time stamps jitter by {uneven.jitter * 1e3:.2g} ms, though sampling is steady '
        f'at {1.0 / recording.dt:.4g} Hz{done}', recording.path, time=0.0, size=uneven.jitter,
        now=uneven.now, otherwise=uneven.even)]


def oddities(recording: Recording) -> list[Finding]:
    """Report what was found while the bag was read: its clock, and velocities that are none."""
    findings = [found(
        'clock_set_back', f'the clock was set back by {item.seconds:.4g} s at {item.time:.3f} s; '
        f'{item.lost} messages with repeated times are left out, and the recording is split '
        'there', recording.path, time=item.time, size=item.seconds)
        for item in recording.oddities.set_backs]
    zero = recording.oddities.zero_velocities
    return findings if not zero else [*findings, found(
        'velocity_zeros', f'velocities of {", ".join(map(repr, zero))} are all zero, though joints'
        ' move; no velocities of this bag are used', recording.path, zero, time=0.0, size=0.0)]
