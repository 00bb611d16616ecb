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

"""What residuals show: drift, death, steps, lost signs, waves, and outputs that come late."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification import settings
from tudor_dynamics.identification.doctor.alternatives import Alternative
from tudor_dynamics.identification.doctor.case import (
    Decimated, Delay, Explained, gain, relative, share_of)
from tudor_dynamics.identification.doctor.findings import Finding, found
from tudor_dynamics.identification.doctor.samples import SINGULAR, until
from tudor_dynamics.identification.ringdowns import oscillation, SMALLEST_AMPLITUDE
from tudor_dynamics.typing import FloatArray


def trends(chosen: Alternative) -> list[Finding]:
    """Look for what changes with time, and for what no model explains, in each channel."""
    case, t = chosen.case, chosen.case.decimated.t
    findings = []
    for name, explained in chosen.explained.items():
        output, shares, line = chosen.output(name), chosen.shares_of(name).tolist(), t - t.mean()
        units = [one.effort.unit for one in case.arm.joints] if name == 'effort' else [
            one.unit for one in case.arm.gauges]
        for i in np.flatnonzero(case.sound[name]).tolist():
            channel, y = case.bodies[name].channels[i], output[:, i]
            dead = _dies(explained, i, t, y)
            if dead is not None:
                what = f'{SINGULAR[name]} {channel!r} stops following the motion at {dead:.2f} s'
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
                    chosen, 'drift', name, i, f'drifts by {rise:.4g} {units[i]} within '
                    f'{t[-1] - t[0]:.4g} s', rise, now, both))
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
        'payload_changed', f'readings of {", ".join(map(repr, names))} change together at '
        f'{at:.1f} s: a load was probably picked up or put down', most.bag, names, time=at,
        now=most.now, otherwise=most.otherwise)]


def _dies(explained: Explained, channel: int, t: FloatArray, y: FloatArray) -> float | None:
    """Say from when on a channel is quiet to the end, though the arm moves on."""
    # expected by what it measured before: samples of a dead channel would teach to expect little
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
    """Say what is wrong with a channel: shares of its variance that remain now, and otherwise."""
    label = chosen.case.bodies[name].channels[channel]
    return found(kind, f'{SINGULAR[name]} {label!r} {what}', chosen.case.recording.path, (label,),
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
    return None if best > settings.SIGNED * now else _found(
        chosen, 'rectified', name, i, 'is never negative, so its sign is lost', 0.0, now, best)


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
                        ('offset_step', 'zero offset', zero))
    return _found(chosen, kind, name, i, f'changes its {word} at about {at:.1f} s', size,
                  now, now * share, at)


def ringing(chosen: Alternative, output: str) -> float | None:
    """Give the frequency of an oscillation that is most of a residual, faster than the motion."""
    from scipy.signal import welch  # slow to import

    case, measured = chosen.case, chosen.output(output)
    rate = 1.0 / float(np.median(np.diff(case.decimated.t)))
    frequency, densities = welch(
        np.hstack([chosen.explained[output].residuals(measured),
                   np.split(case.motion, 3, axis=1)[1]]),
        rate, nperseg=min(len(measured), round(settings.RINGING_SECONDS * rate)), axis=0)
    motion = densities[:, measured.shape[1]:].sum(axis=1)
    found = []
    for i in np.flatnonzero(case.sound[output]).tolist():
        peak, rms, share = oscillation(frequency, densities[:, i])
        moved = motion[frequency >= settings.BELOW_RINGING * peak].sum() / motion.sum()
        if (share > settings.RINGING_SHARE and moved < settings.RINGING_MOVED
                and rms > SMALLEST_AMPLITUDE * float(np.std(measured[:, i]))):
            found.append(peak)
    return min(found, default=None)


def _spectrum(t: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Give frequencies, and what part of the variance of values (n, columns) each one is."""
    step = float(np.median(np.diff(t))) / settings.WAVE_FINE
    place = np.round((t - t[0]) / step).astype(int)
    spread = np.zeros((place[-1] + 1, values.shape[1]))  # fine: stretches keep their phase
    spread[place] = values - values.mean(axis=0)
    count = 1 << (settings.WAVE_LONGER * len(spread)).bit_length()
    shares = 2.0 * np.abs(np.fft.rfft(spread, count, axis=0) / len(t)) ** 2 / np.maximum(
        np.mean(spread[place] ** 2, axis=0), 1e-300)
    return np.asarray(np.fft.rfftfreq(count, step)), shares


def _wave(chosen: Alternative, name: str, i: int, now: float) -> Finding | None:
    """Find a wave that goes on through most of a residual, and is not of the motion."""
    case, t = chosen.case, chosen.case.decimated.t
    seconds = float(t[-1] - t[0])
    if seconds < settings.WAVE_SECONDS:
        return None
    left = chosen.explained[name].residuals(chosen.output(name))[:, i]
    frequency, shares = _spectrum(
        t, np.column_stack([left, np.split(case.motion, 3, axis=1)[1][:, case.moves]]))
    near = (frequency >= max(settings.WAVE_ABOVE, settings.WAVE_CYCLES / seconds)) & (
        frequency <= min(settings.CUTOFF, 0.5 / float(np.median(np.diff(t)))))
    frequency, shares = frequency[near], shares[near]
    peak = int(np.argmax(shares[:, 0]))
    # what rings dies out, or begins again with each motion
    parts = np.array([part.mean() for part in np.array_split(
        np.exp(-2j * np.pi * frequency[peak] * t) * left, settings.WAVE_PARTS)])
    line, uneven = min(float(shares[peak, 0]), 1.0), np.abs(parts / parts.mean() - 1.0).max()
    if (line < settings.WAVE or uneven > settings.WAVE_EVEN
            or shares[peak, 1:].max(initial=0.0) > settings.RINGING_MOVED):
        return None
    return _found(chosen, 'hum', name, i, f'oscillates steadily at {frequency[peak]:.3g} Hz',
                  float(frequency[peak]), now, now * (1.0 - line))


def _unexplained(chosen: Alternative, name: str, i: int, now: float) -> Finding | None:
    """Say that most of a channel is left, and no check has found a cause: now, its share."""
    return None if now < settings.UNEXPLAINED ** 2 or ringing(chosen, name) else _found(
        chosen, 'unexplained', name, i, 'does not fit the model, as its relative residual '
        f'is above the limit of {100 * settings.UNEXPLAINED:.0f} %', 0.0, now)


# -- Outputs that come late

PLURAL = {'effort': 'efforts', 'strain': 'strains', 'velocity': 'velocities'}


def lags(chosen: Alternative) -> list[Alternative]:
    """Look for outputs that come late, the likeliest way of each: as a whole, more, by one."""
    late = [_of_output(chosen, name) for name, sound in chosen.case.sound.items() if sound.any()]
    return [one for one in late if one is not None]


def _of_output(chosen: Alternative, name: str) -> Alternative | None:
    case, shares, best = chosen.case, chosen.shares_of(name), None
    least_gain = settings.LAG_GAIN[name]
    sound, span = np.flatnonzero(case.sound[name]).tolist(), float(case.decimated.t[-1])

    def least(sizes: FloatArray, delay: Callable[[float], Delay]) -> float:
        return _least(sizes, chosen.explained[name].shares(np.array([
            chosen.output(name, delay(float(size))) for size in sizes])))

    grid = settings.LAGS
    # clocks may be apart by seconds; an oscillation looks the same a period later
    if relative(shares[sound]) > settings.LAG_FAR and ringing(chosen, name) is None:
        grid = grid + least(settings.CLOCKS, Delay)
    seconds = least(grid, Delay)
    more = least(settings.CLOCKS, lambda size: Delay(seconds - size, 2.0 * size / span))
    # filters of drivers; and stamps of samples show no less than the time between them
    usual = np.sqrt(case.brevity) * max(settings.USUAL_LAG[name], case.recording.dt)
    ways: list[tuple[tuple[int, ...], float, Delay]] = [
        ((), abs(seconds) / usual, Delay(seconds)),
        ((), abs(more) / usual, Delay(seconds - more, 2.0 * more / span))]
    step = 0.5 * float(settings.LAGS[1] - settings.LAGS[0])
    rates = (chosen.output(name, Delay(step)) - chosen.output(name, Delay(-step))) / (2.0 * step)
    for i in sound if len(sound) > 1 else ():
        rate, left = (chosen.explained[name].rest(i, x[:, i]) for x in (
            rates, chosen.output(name)))
        # beside others with the same stamps a channel comes late by a filter: never early
        own = float(np.clip(-(rate @ left) / max(float(rate @ rate), 1e-300), 0.0, 2.0))
        # drivers filter one channel more than another
        ways.append(((i,), 0.5 * own / usual,
                     Delay(np.where(np.arange(len(shares)) == i, own, 0.0))))
    for channels, size, delay in ways:
        after, judged = chosen.shares_of(name, delay), list(channels) or sound
        better = gain(shares, after)
        if size > 1.0 and relative(after[judged]) < settings.LAG_SHARE and better > least_gain:
            names = tuple(case.bodies[name].channels[i] for i in channels)
            best = replace(chosen, kind=f'{name}_late', channels=names, remedy='', size=delay.size,
                           what=_said(name, names, delay), late={name: delay})
            least_gain = better + settings.LAG_GAIN[name]
    return best


def velocity_lag(
    recording: Recording, decimated: Decimated, joints: Sequence[str],
) -> list[Finding]:
    """Look for velocities of the driver that come later than the derivative of the positions."""
    if not decimated.has('velocity'):
        return []
    derivative = np.split(decimated.motion, 3, axis=1)[1]
    sizes = np.std(derivative, axis=0)
    moves = np.flatnonzero(sizes > settings.STILL * float(sizes.max()))
    shares = np.array([share_of(decimated.output('velocity', Delay(float(lag))) - derivative,
                                derivative) for lag in settings.LAGS])
    zero = shares[np.argmin(np.abs(settings.LAGS))]
    late: dict[int, tuple[float, float]] = {}
    for i in moves.tolist():
        seconds, least = _least(settings.LAGS, shares[:, [i]]), float(shares[:, i].min())
        if (abs(seconds) > max(settings.USUAL_LAG['velocity'], recording.dt)
                and np.log(zero[i] / least) > settings.LAG_GAIN['velocity']
                and np.sqrt(least) < settings.LAG_SHARE):
            late[i] = seconds, least
    if not late:
        return []
    names = () if len(late) == len(moves) else tuple(joints[i] for i in late)
    delay = Delay(float(np.median([seconds for seconds, _ in late.values()])))
    return [found('velocity_late', _said('velocity', names, delay), recording.path, names,
                  size=delay.size, now=relative(zero[list(late)]),
                  otherwise=relative(np.array([least for _, least in late.values()])))]


def _least(lags: FloatArray, shares: FloatArray) -> float:
    """Give the lag of the least residuals: shares of each lag, (lags, channels)."""
    scores = np.log(shares).sum(axis=1)
    i = int(np.argmin(scores))
    seconds = float(lags[i])
    if 0 < i < len(scores) - 1:  # the vertex of the parabola through three
        before, here, after = scores[i - 1:i + 2]
        bend = before - 2.0 * here + after
        if bend > 0.0:
            seconds += float(0.5 * (before - after) / bend * (lags[1] - lags[0]))
    return seconds


def _said(name: str, channels: tuple[str, ...], delay: Delay) -> str:
    """Say what comes late, and by how much."""
    late, what = delay.size > 0.0, PLURAL[name]
    if channels:
        what = f'{SINGULAR.get(name, "velocity of")} {", ".join(map(repr, channels))}'
    more = '' if not delay.rate else (f' at first, and get {1e3 * abs(delay.rate):.2g} ms '
                                      f'{"later" if delay.rate > 0.0 else "earlier"} each second')
    return (f'{what} {"lag" if late else "lead"}{"s" * bool(channels)} the positions by '
            f'{abs(delay.size) * 1e3:.0f} ms{more}')
