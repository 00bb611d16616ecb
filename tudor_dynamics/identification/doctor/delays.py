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

"""Outputs that come late: all of them, one channel, or by a clock that runs fast."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification import settings
from tudor_dynamics.identification.doctor.alternatives import Alternative
from tudor_dynamics.identification.doctor.case import (
    Decimated, Delay, gain, relative, share_of)
from tudor_dynamics.identification.doctor.findings import Finding, found
from tudor_dynamics.identification.doctor.readings import SINGULAR
from tudor_dynamics.identification.doctor.residuals import ringing
from tudor_dynamics.typing import FloatArray

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
        return _least(sizes, [chosen.shares_of(name, delay(float(size))) for size in sizes])

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


def _least(lags: FloatArray, shares: Sequence[FloatArray] | FloatArray) -> float:
    """Give the lag of the least residuals: shares of each lag, (lags, channels)."""
    scores = np.log(np.array(shares)).sum(axis=1)
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
    what = f'{PLURAL[name]} come'
    if channels:
        what = f'{name if name == "velocity" else SINGULAR[name]} {", ".join(channels)} comes'
    by = f'{abs(delay.size) * 1e3:.0f} ms {"late" if delay.size > 0.0 else "early"}'
    if delay.rate:
        by = f'{by} at first, and {1e3 * delay.rate:+.2g} ms more each second'
    return f'{what} {by} against the positions'
