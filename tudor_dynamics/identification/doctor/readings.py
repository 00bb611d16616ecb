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

"""What readings show that no arm does: jumps, repeats, lines, copies, lost signs, hum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
import math

import numpy as np

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification import settings
from tudor_dynamics.identification.doctor.channels import Channel, runs
from tudor_dynamics.identification.doctor.findings import Finding
from tudor_dynamics.identification.ringdowns import power_density


def look_at_readings(recording: Recording, items: Sequence[Channel]) -> list[Finding]:
    """Look at each channel of a recording, and at those of a kind together."""
    findings = [*copies(items), *_filled(recording, items)]
    for item in items:
        if np.ptp(item.values) == 0.0:
            continue
        checks = (_stale, _jump, _noisy) if item.field == 'q' else (
            _alternating, _noise_alone, _coarse, _hum)
        findings += [one for check in checks if (one := check(recording, item)) is not None][:1]
    return findings


def copies(items: Sequence[Channel]) -> list[Finding]:
    """Find channels that give what another one gives."""
    return [replace(other.found('copied_channel', f' and that of {one.name} have the same values',
                                0.0, 0.0), channels=(one.name, other.name))
            for one, other in combinations(items, 2) if one.field == other.field
            and np.ptp(one.values) > 0.0 and np.std(one.values - other.values) < (
                settings.COPIED if one.field == 'effort' else settings.COPIED_EXACTLY)
            * np.std(one.values)]


def _filled(recording: Recording, items: Sequence[Channel]) -> list[Finding]:
    """Find stretches where all that moves lies on straight lines, as no noise does."""
    bends, moves = [], []
    for item in items:
        steps = np.diff(item.values, append=item.values[-1])
        size = float(np.percentile(np.abs(steps), 90))
        bends.append(np.abs(np.diff(steps, prepend=steps[0])) < settings.STRAIGHT * size)
        moves.append(np.abs(steps) > settings.STRAIGHT * size)
    straight = np.all(bends, axis=0) & np.any(moves, axis=0)
    first, length = runs(straight.astype(float))
    found = straight[first] & (length >= settings.STRAIGHT_RUN)
    share = float(length[found].sum()) / len(straight)
    if not settings.STRAIGHT_SHARE < share < 1.0 - settings.STRAIGHT_SHARE:
        return []
    at = float(recording.t[first[found][0]])
    return [items[0].found('filled', f' and all else lie on straight lines in {100 * share:.2g} % '
                           f'of the samples, the first at {at:.2f} s', at, share)]


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
    """Find positions that change from sample to sample as no arm can, or that have few digits."""
    noise = float(np.median(np.abs(np.diff(item.values, 3)))) / math.sqrt(20.0) / 0.6745
    if noise < settings.NOISY:
        return None
    steps = np.abs(np.diff(item.values))
    digit = float(steps[steps > 0.0].min())
    if np.abs(steps / digit - np.round(steps / digit)).max() < settings.STRAIGHT:
        return item.found('coarse_positions', f' comes in steps of {digit:.3g}', 0.0, digit)
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
    alone = (x[1:-1] == 0.0) & (np.minimum(x[:-2], x[2:]) > far) | (
        x[1:-1] == 0.0) & (np.maximum(x[:-2], x[2:]) < -far)
    share = float(np.mean(alone))
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
    return item.found('constant', f' is {item.values.mean():.4g} and noise', 0.0,
                      float(item.values.mean()))


def _coarse(recording: Recording, item: Channel) -> Finding | None:
    """Find a channel of few digits."""
    levels = np.unique(item.values)
    if len(levels) > settings.LEVELS or len(item.values) < settings.LEVELS ** 2:
        return None
    step = float(np.min(np.diff(levels)))
    return item.found('coarse_channel', f' has {len(levels)} values, {step:.3g} apart', 0.0, step)


def _hum(recording: Recording, item: Channel) -> Finding | None:
    """Find one frequency, above those of motion, in all of a recording."""
    parts = [part for part in recording.segments
             if part.stop - part.start >= settings.HUM_SAMPLES]
    if not parts:
        return None
    n = settings.HUM_SAMPLES
    blocks = [power_density(item.values[k:k + n, None], 1.0 / recording.dt, n)
              for part in parts for k in range(part.start, part.stop - n + 1, n)]
    frequency = blocks[0][0]
    spectra = np.array([density[:, 0] for _, density in blocks]) * frequency[1]
    if len(spectra) < 4:
        return None
    # what gears and structures do comes and goes with motion: a mains does not
    lasting = np.where(frequency > settings.HUM_ABOVE, spectra.min(axis=0), 0.0)
    peak = int(np.argmax(lasting))
    near = slice(max(peak - 1, 0), peak + 2)
    line = float(lasting[near].sum())
    around = float(np.median(lasting[max(peak - 20, 0):peak + 21]))
    if (line < settings.HUM_SHARE * float(np.var(item.values))
            or lasting[peak] < settings.HUM_PEAK * around):
        return None
    return item.found('hum', f' has a wave of {frequency[peak]:.3g} Hz with an amplitude of '
                      f'{math.sqrt(2.0 * line):.3g} throughout', 0.0, float(frequency[peak]))
