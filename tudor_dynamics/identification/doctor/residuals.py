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

"""What residuals show of single channels: drift, death, steps, lost signs, waves."""

from __future__ import annotations

import numpy as np

from tudor_dynamics.identification import settings
from tudor_dynamics.identification.doctor.alternatives import Alternative
from tudor_dynamics.identification.doctor.case import Explained, share_of
from tudor_dynamics.identification.doctor.findings import Finding, found
from tudor_dynamics.identification.doctor.readings import SINGULAR, until
from tudor_dynamics.identification.ringdowns import (
    oscillation, power_density, SMALLEST_AMPLITUDE)
from tudor_dynamics.typing import FloatArray


def trends(chosen: Alternative) -> list[Finding]:
    """Look for what changes with time, and for what no model explains, in each channel."""
    case, t = chosen.case, chosen.case.decimated.t
    findings = []
    for name, explained in chosen.explained.items():
        output, shares, line = chosen.output(name), chosen.shares_of(name).tolist(), t - t.mean()
        for i in np.flatnonzero(case.sound[name]).tolist():
            channel, y = case.bodies[name].channels[i], output[:, i]
            dead = _dies(explained, i, t, y)
            if dead is not None:
                what = f'{SINGULAR[name]} {channel} no longer follows the arm from {dead:.2f} s on'
                findings.append(found(
                    'dying', what, case.recording.path, (channel,), time=dead,
                    size=float(t[-1]) - dead, remedy=until(case.recording, dead)))
                continue
            if name == 'effort' and not case.moves[i]:
                continue
            # the slope by Frisch and Waugh: both sides freed of all other columns
            x, left = explained.rest(i, line), explained.rest(i, y)
            slope = float(x @ left) / max(float(x @ x), 1e-300)
            rise = slope * float(t[-1] - t[0])
            now, both = float(share_of(left, y)), float(share_of(left - slope * x, y))
            step = _step(chosen, name, i, left)
            if (np.log(now / both) > settings.DRIFT_GAIN * case.brevity
                    and abs(rise) > settings.DRIFT_SIZE * float(np.std(y))
                    and (step is None or both < (step.otherwise or 0.0) ** 2)):
                findings.append(_found(
                    chosen, 'drift', name, i, f'drifts by {rise:.4g} in {t[-1] - t[0]:.4g} s',
                    rise, now, both))
                continue
            odd = (_without_sign(chosen, name, i) or step or _wave(chosen, name, i, shares[i])
                   or _unexplained(chosen, name, i, shares[i]))
            findings += [] if odd is None else [odd]
    return _at_once(findings)


def _at_once(findings: list[Finding]) -> list[Finding]:
    """Take gains and zeros of several channels that change at one time for a change of load."""
    steps = [item for item in findings if item.kind in ('gain_step', 'offset_step')]
    times = [item.time or 0.0 for item in steps]
    if len(steps) < 2 or max(times) - min(times) > settings.SAME_TIME * max(times):
        return findings
    names, at = tuple(item.channels[0] for item in steps), float(np.median(times))
    most = max(steps, key=lambda item: item.now or 0.0)
    return [item for item in findings if item not in steps] + [found(
        'payload_changed', f'{", ".join(names)} change at about {at:.1f} s: a load was picked up '
        'or put down', most.bag, names, time=at, now=most.now, otherwise=most.otherwise)]


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
        if not inside.any():
            continue  # a gap
        x, z = expected[inside], y[inside]
        x, z = x - x.mean(), z - z.mean()
        if float(x @ z) > settings.FOLLOWS * float(x @ x):
            return float(end)
    return float(edges[0])


def _found(
    chosen: Alternative, kind: str, name: str, channel: int, what: str, size: float,
    now: float, otherwise: float | None = None, time: float = 0.0,
) -> Finding:
    """Say what is odd about a channel: shares of its variance that remain now, and otherwise."""
    label = chosen.case.bodies[name].channels[channel]
    return found(kind, f'{SINGULAR[name]} {label} {what}', chosen.case.recording.path, (label,),
                 time=time, size=size, now=float(np.sqrt(now)),
                 otherwise=None if otherwise is None else float(np.sqrt(otherwise)))


def _without_sign(chosen: Alternative, name: str, i: int) -> Finding | None:
    """Find a channel that is never negative, and is explained where its sign is guessed."""
    raw = getattr(chosen.case.recording, name)[:, i]
    if raw.min() < 0.0:
        return None
    explained, y = chosen.explained[name], chosen.output(name)[:, i]
    everything = np.ones(len(y), dtype=bool)
    n = chosen.case.motion.shape[1] // 3
    now = float(share_of(y - explained.predicted(i, y, everything), y))
    columns = explained.bodies[i]
    # first guesses: friction has the sign of a speed, weight that of what bodies can do
    guesses = [*chosen.case.motion[:, n:2 * n].T, *np.linalg.svd(
        columns - columns.mean(axis=0), full_matrices=False)[0][:, :settings.SIGNS].T]
    best = 1.0
    for guess in guesses:
        for _ in range(settings.SIGN_PASSES):
            signed = np.where(guess < 0.0, -y, y)
            guess = explained.predicted(i, signed, everything)
        # of the same spread: a guess that turns a large constant load makes one of its own
        best = min(best, float(share_of(signed - guess, y)))
    if best > settings.SIGNED * now:
        return None
    return _found(chosen, 'rectified', name, i, 'has lost its sign', 0.0, now, best)


def _step(chosen: Alternative, name: str, i: int, left: FloatArray) -> Finding | None:
    """Find a time after which a channel has another gain, or another zero."""
    explained, y, t = chosen.explained[name], chosen.output(name)[:, i], chosen.case.decimated.t
    if t[-1] - t[0] < settings.STEP_SECONDS:
        return None
    predicted, best = y - left, (1.0, 0.0, 0.0, 0.0)
    for at in t[0] + (t[-1] - t[0]) * np.linspace(*settings.STEP_WITHIN, settings.STEPS):
        after = (t > at).astype(float)
        columns = np.stack([explained.rest(i, x) for x in (after, after * predicted)], axis=1)
        values = np.linalg.lstsq(columns, left, rcond=1e-9)[0]
        share = float(np.sum((left - columns @ values) ** 2) / max(float(left @ left), 1e-300))
        if share < best[0]:
            best = share, float(at), float(values[0]), float(values[1])
    share, at, zero, gain = best
    now, least = float(share_of(left, y)), settings.STEPPED[int(t[-1] - t[0] > settings.STEP_LONG)]
    if share > least or now * (1.0 - share) < settings.STEP_SHARE:
        return None
    kind, word, size = (('gain_step', 'gain', gain) if
                        abs(gain) * float(np.std(predicted)) > abs(zero) else
                        ('offset_step', 'zero', zero))
    return _found(chosen, kind, name, i, f'has another {word} from about {at:.1f} s on', size,
                  now, now * share, at)


def ringing(chosen: Alternative, output: str) -> float | None:
    """Give the frequency of an oscillation that is most of a residual, faster than the motion."""
    case, measured = chosen.case, chosen.output(output)
    rate = 1.0 / float(np.median(np.diff(case.decimated.t)))
    frequency, densities = power_density(
        np.hstack([chosen.explained[output].residuals(measured),
                   np.split(case.motion, 3, axis=1)[1]]),
        rate, min(len(measured), round(settings.RINGING_SECONDS * rate)))
    motion = densities[:, measured.shape[1]:].sum(axis=1)
    found = []
    for i in np.flatnonzero(case.sound[output]).tolist():
        peak, rms, share = oscillation(frequency, densities[:, i])
        moved = motion[frequency >= settings.BELOW_RINGING * peak].sum() / motion.sum()
        if (share > settings.RINGING_SHARE and moved < settings.RINGING_MOVED
                and rms > SMALLEST_AMPLITUDE * float(np.std(measured[:, i]))):
            found.append(peak)
    return min(found, default=None)


def _wave(chosen: Alternative, name: str, i: int, now: float) -> Finding | None:
    """Find a wave that goes on through most of a residual, and is none of the motion."""
    case, t = chosen.case, chosen.case.decimated.t
    seconds = float(t[-1] - t[0])
    if seconds < settings.WAVE_SECONDS:
        return None
    left = chosen.explained[name].residuals(chosen.output(name))[:, i]
    both = np.column_stack([left, np.split(case.motion, 3, axis=1)[1][:, case.moves]])
    both -= both.mean(axis=0)
    frequency = np.arange(max(settings.WAVE_ABOVE, settings.WAVE_CYCLES / seconds),
                          settings.CUTOFF, 0.1 / seconds)
    waves = np.exp(-2j * np.pi * np.outer(frequency, t))
    shares = 2.0 * np.abs(waves @ both / len(t)) ** 2 / np.maximum(
        np.mean(both ** 2, axis=0), 1e-300)
    peak = int(np.argmax(shares[:, 0]))
    # what rings dies out, or begins again with each motion
    parts = np.array([part.mean() for part in np.array_split(
        waves[peak] * left, settings.WAVE_PARTS)])
    line, uneven = float(shares[peak, 0]), np.abs(parts / parts.mean() - 1.0).max()
    if (line < settings.WAVE or uneven > settings.WAVE_EVEN
            or shares[peak, 1:].max(initial=0.0) > settings.RINGING_MOVED):
        return None
    return _found(chosen, 'hum', name, i, f'has a wave of {frequency[peak]:.3g} Hz throughout',
                  float(frequency[peak]), now, now * (1.0 - line))


def _unexplained(chosen: Alternative, name: str, i: int, now: float) -> Finding | None:
    """Say that most of a channel is left, and no check has found a cause: now, its share."""
    if now < settings.UNEXPLAINED ** 2 or ringing(chosen, name):
        return None
    return _found(chosen, 'unexplained', name, i, f'is not explained: {100 * now:.0f} % of its '
                  'variance remains, and no check finds a cause', 0.0, now)
