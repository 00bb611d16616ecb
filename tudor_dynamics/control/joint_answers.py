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

"""
How joints answer small nudges: which one, in which direction, how far and how late.

A reading is compared with the way that commands have made: q = c + d t + a U(t - delay), with U
the integral of a joint's commands. a is 1 where all is right; d is what the joint, or its encoder,
does by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.limits import hard_limits
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.control import settings
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True)
class JointAnswer:
    """What a joint made of its nudge."""

    joint: str  # whose commands are judged
    right: bool | None  # None where it is unclear: a larger nudge may tell
    text: str  # the cause, and what to do
    answered: str = ''  # joint whose positions answered; empty for none
    sign: int = 0  # of that answer; 0 for none
    scale: float = math.nan  # how far it moved, over how far it was commanded
    error: float = math.nan  # standard deviation of that
    delay: float = math.nan  # from a position to the answer to its command [s]
    noise: float = math.nan  # standard deviation of the positions around the answer [rad or m]


@dataclass(frozen=True)
class _Fit:
    """Positions of one joint by the commands of one: q = c + drift t + scale U(t - delay)."""

    scale: float
    error: float
    delay: float
    noise: float
    drift: float
    unexplained: float  # part of the motion, apart from the drift
    delay_error: float  # [s]

    @property
    def clear(self) -> bool:
        """Whether there is an answer at all."""
        return abs(self.scale) > max(settings.ANSWER_ERRORS * self.error, settings.LEAST_ANSWER)

    def near(self, scale: float) -> bool:
        """Say whether the scale may be this one."""
        return settings.SCALE_DOWN < self.scale / scale < settings.SCALE_UP


def _times(scale: float) -> str:
    """Say how far a joint moves, and what that may come from."""
    off = {hint: abs(abs(math.log(scale)) - math.log(factor))
           for factor, hint in settings.KNOWN_SCALES.items()}
    hint = min(off, key=lambda hint: off[hint])
    return (f'the joint moves {scale:.3g} times as far as commanded'
            + (f', perhaps {hint}' if off[hint] < settings.SCALE_NEAR else ''))


def _stuck(way: FloatArray, widths: FloatArray) -> FloatArray:
    """Give the part of a way (samples,) that sticks at each half width, (widths, samples)."""
    left = np.zeros((len(way), len(widths)))
    for k in range(1, len(way)):
        left[k] = np.clip(left[k - 1], way[k] - widths, way[k] + widths)
    return way - left.T


def _lag(t: FloatArray, x: FloatArray, way: FloatArray) -> float:
    """Give how late positions x follow the way of commands [s]."""
    # By speeds: what sticks changes them less than places, and late by nothing.
    lags = np.arange(0.0, settings.DELAY_LONGEST, settings.DELAY_STEP)

    def speed(values: FloatArray, times: FloatArray) -> FloatArray:
        return np.interp(times, t, values) - np.interp(times - settings.ANSWER_WINDOW, t, values)
    moved = speed(way, t[:, np.newaxis] - lags)
    moved -= moved.mean(axis=0)
    answers = speed(x, t) @ moved / np.sqrt(np.einsum('ij,ij->j', moved, moved) + 1e-30)
    return float(lags[np.argmax(np.abs(answers))])


def _fit(t: FloatArray, x: FloatArray, way: FloatArray, *, back: bool) -> _Fit:
    """Fit positions x by commands; back: they went there and back, which says what sticks."""
    delay = _lag(t, x, way)
    way = np.interp(t - delay, t, way)
    best = (math.inf, 0.0, 0.0, 0.0, x)
    line = np.column_stack([np.ones_like(t), t, way])
    sticking = _stuck(way, np.ptp(way) * np.array(settings.STICKING)) if back else ()
    for columns in (line, *(np.column_stack([line, stuck]) for stuck in sticking)):
        found, _, rank, _ = np.linalg.lstsq(columns, x, rcond=1e-6)
        off = x - columns @ found
        energy = float(off @ off)
        if energy < best[0] and (  # what sticks moves less, not more
                columns is line or rank == 4 and found[2] * found[3] < 0.0):
            spread = np.linalg.pinv(columns.T @ columns, rcond=1e-12)[2, 2]
            best = energy, float(spread), float(found[2]), float(found[1]), off
    energy, spread, scale, drift, off = best
    # samples that resemble the ones before them count less (AR(1))
    alike = min(max(float(off[1:] @ off[:-1]) / max(energy, 1e-30), 0.0), 0.999)
    spread *= energy / max(len(t) - 6, 1) * (1.0 + alike) / (1.0 - alike)
    y = x - np.polyval(np.polyfit(t, x, 1), t)
    noise, speed = math.sqrt(energy / len(t)), abs(scale) * float(np.std(np.gradient(way, t)))
    return _Fit(scale, math.sqrt(spread), delay, noise, drift, energy / max(float(y @ y), 1e-30),
                0.5 * noise / max(speed, 1e-30))


class JointRecord:
    """Positions and commands while a joint, by its index, is nudged by a step [rad or m]."""

    def __init__(self, arm: Arm, nudged: int, step: float) -> None:
        self._joints, self._units = arm.active_joints, [
            (1e3, 'mm') if arm.is_prismatic(name) else (math.degrees(1.0), 'deg')
            for name in arm.active_joints]
        self._late = max(settings.LATE_SHARE * arm.damper.full_delay, settings.LATE)
        self._nudged, self._step = nudged, abs(step)
        # Time, positions, the driver's velocities, and the commands in force from then on.
        self._rows: list[tuple[float, FloatArray, FloatArray, FloatArray]] = []
        self._way = np.zeros(len(self._joints))
        self._stood: int | None = None  # samples before the nudge
        self._until: int | None = None  # samples before the end of it
        self._commanded = False
        self._gaps, self._jumps = 0.0, np.zeros(len(self._joints))
        self._end = math.inf
        self.astray = False  # some joint is where no right arm would be: stop it now

    def begin(self) -> None:
        """Take what comes from now on as the nudge; the joints stood until here."""
        self._stood = len(self._rows)

    def positions(self, t: float, q: FloatArray, dq: FloatArray | None = None) -> None:
        """Take positions [rad] of a stamp [s], and what the driver calls their velocities."""
        t, q, command = t - self._gaps, q - self._jumps, np.zeros_like(q)
        if self._rows and (t <= self._rows[-1][0] or t > self._end):
            return
        if not self._commanded:  # of what moves it nothing is known yet
            self._rows.clear()
        else:
            before, last, _, command = self._rows[-1]
            gap = t - before - settings.ANSWER_GAP
            if gap > 0.0:  # what happened there is left out
                self._gaps, self._jumps = self._gaps + gap, self._jumps + q - last
                t, q = t - gap, last
                self.command(np.zeros_like(q))
            self._way = self._way + (t - before) * self._rows[-1][3]
        self._rows.append((t, q, np.full(len(q), np.nan) if dq is None else dq, command))
        off = np.abs(q - self._rows[0][1] - self._way)
        if not self.astray and (np.any(off > settings.OFF * self._step) or np.any(
                np.abs(self._way) > settings.ASTRAY * self._step)):
            self.astray, self._end = True, t + settings.ASTRAY_AFTER
            self._until = len(self._rows)

    def command(self, speed: FloatArray) -> None:
        """Take the command that answers the newest positions [rad/s]."""
        if self._rows:
            self._commanded, self._rows[-1] = True, (*self._rows[-1][:3], speed)

    def judge(self) -> JointAnswer:
        """Say how the nudged joint answered; if rightly, what else moved."""
        if len(self._rows) < settings.LEAST_SAMPLES:
            name = self._joints[self._nudged]
            return JointAnswer(name, None, f'{name}: no positions came; start the driver')
        t, q, self._dq, commands = (np.array(column) for column in zip(*self._rows, strict=True))
        self._time, self._moved = t - t[0], q - q[0]
        self._ways = np.zeros_like(q)
        self._ways[1:] = np.cumsum(np.diff(t)[:, np.newaxis] * commands[:-1], axis=0)
        self._turned = np.abs(self._ways[-1]) < 0.5 * np.ptp(self._ways, axis=0)
        off = np.ptp(self._moved - self._ways, axis=0)
        if self._stood is None:  # no joint was to move yet: the worst one first
            return self._judge(int(np.argmax(off)))
        found = self._judge(self._nudged)
        for other in np.flatnonzero(off > settings.STRAYED * self._step):
            if found.right and other != self._nudged:
                found = self._judge(int(other))
        return found

    def _judge(self, j: int) -> JointAnswer:
        """Judge what the commands of one joint did."""
        name = self._joints[j]
        fits = [self._answer(k, j) for k in range(len(self._joints))]
        clear = [k for k, fit in enumerate(fits) if fit.clear]
        odd = self._by_itself(j)
        if odd and (self._stood is None or j != self._nudged or not any(
                fits[k].unexplained < settings.EXPLAINED for k in clear)):
            return JointAnswer(name, False, f'{name}: {odd}')
        factor, unit = self._units[j]
        way = np.ptp(self._ways[:, j])
        if way < settings.LEAST_WAY * self._step:
            moved = np.ptp(self._moved[:, j])
            if way and moved > settings.RUNAWAY * settings.LEAST_WAY * self._step:
                return JointAnswer(name, False, f'{name}: {_times(moved / way)}; correct units or '
                                   'gear ratio in its driver')
            return JointAnswer(name, None, f'{name}: oscillation_damper commanded a move of only '
                               f'{factor * way:.2g} {unit} in place of {factor * self._step:.2g}; '
                               'see the diagnostics of oscillation_damper')
        if not clear:
            right, text = self._silent(j, fits[j])
            return JointAnswer(name, right, f'{name}: {text}')
        k = j if fits[j].near(1.0) else min(clear, key=lambda k: fits[k].unexplained)
        fit = fits[k]
        gaps = self._gaps / self._time[-1]
        too = [i for i in clear if i != k and abs(fits[i].scale) > settings.MOVES_TOO
               and not self._answer(i, i).unexplained < fits[i].unexplained]
        if fit.unexplained > settings.UNEXPLAINED or gaps > settings.UNEXPLAINED:
            right, text = None, (f'no positions came for {gaps:.0%} of the time; check the driver'
                                 if gaps > settings.UNEXPLAINED else self._figures(j, fit))
        elif k != j:
            right, text = False, self._swapped(j, k)
        elif not fit.near(1.0):
            right, text = False, self._scaled(j, fit)
        elif abs(fit.drift) > settings.DRIFT * self._step:
            right, text = False, self._drifts(j, fit.drift)
        elif too:
            right, text = False, (f'commands to this joint move {self._joints[too[0]]}, too; '
                                  'check the order of commands and the cables of the drives')
        elif fit.delay - fit.delay_error > self._late:
            right, text = False, (f'the joint answers late, after {1e3 * fit.delay:.0f} ms (limit '
                                  f'{1e3 * self._late:.0f} ms); speed up driver and network, or '
                                  "lower gains and raise full_delay in the arm's key 'damper'")
        elif fit.error > settings.SCALE_ERROR:
            right, text = None, self._figures(j, fit)
        else:
            right, text = True, f'right; {self._figures(j, fit)}'
        return JointAnswer(name, right, f'{name}: {text}', self._joints[k],
                           1 if fit.scale > 0.0 else -1, abs(fit.scale), fit.error, fit.delay,
                           fit.noise)

    def _answer(self, k: int, j: int) -> _Fit:
        return _fit(self._time, self._moved[:, k], self._ways[:, j], back=self._turned[j])

    def _figures(self, j: int, fit: _Fit) -> str:
        factor, unit = self._units[j]
        return (f'the joint moves {fit.scale:.3g} +- {fit.error:.2g} times as far as commanded, '
                f'{1e3 * fit.delay:.0f} ms late, with {factor * fit.noise:.2g} {unit} of noise')

    def _velocity(self, j: int) -> _Fit | None:
        """Fit the velocities that the driver itself reports; None where it reports none."""
        dq = self._dq[:, j]
        if not np.isfinite(dq).all() or not dq.any():
            return None
        way = np.zeros_like(dq)
        way[1:] = np.cumsum(np.diff(self._time) * 0.5 * (dq[1:] + dq[:-1]))
        fit = _fit(self._time, way, self._ways[:, j], back=self._turned[j])
        return fit if fit.clear and fit.error < settings.SCALE_ERROR * abs(fit.scale) else None

    def _scaled(self, j: int, fit: _Fit) -> str:
        """Say that sign or scale is wrong, and of what."""
        own = self._velocity(j)
        if own is None:
            where = 'the drive and the encoder'
        elif own.near(1.0):
            where = 'the positions that the driver reports, as its velocity is right'
        elif own.near(fit.scale):
            where = 'the drive, and the encoder that measures position and velocity'
        else:
            where = f'drive and encoder, as its velocity is {own.scale:.3g} times the command'
        texts = ['the joint moves the other way, so a sign is wrong'] if fit.scale < 0.0 else []
        if not (fit.near(1.0) or fit.near(-1.0)):
            texts.append(_times(abs(fit.scale)))
        return f'{"; ".join(texts)}; check {where}'

    def _swapped(self, j: int, k: int) -> str:
        own = self._velocity(j)
        if own is not None and own.near(1.0):
            return (f'commands to this joint change its velocity, but the position of '
                    f'{self._joints[k]!r}; correct order or names of the positions in the driver')
        return (f'commands to this joint move {self._joints[k]!r}; correct the order of commands '
                'or readings in the driver')

    def _drifts(self, j: int, drift: float) -> str:
        factor, unit = self._units[j]
        return (f'the joint moves by itself at {factor * drift:.2g} {unit}/s; check its encoder, '
                'the offset of its drive, and whether another node commands it')

    def _by_itself(self, j: int) -> str:
        """Say what a joint does that no command made; empty for nothing."""
        rows = slice(self._until if self._stood is None or j != self._nudged else self._stood)
        time, off = self._time[rows], (self._moved - self._ways)[rows, j]
        if len(time) < settings.LEAST_SAMPLES:
            return ''
        line = np.polyfit(time, off, 1)
        straight = np.ptp(off - np.polyval(line, time)) < settings.STRAIGHT * np.ptp(off)
        if straight and abs(line[0]) > settings.DRIFT * self._step:
            return self._drifts(j, line[0])
        moved, way = np.ptp(self._moved[:, j]), np.ptp(self._ways, axis=0).max()
        if moved > self._step and moved > settings.RUNAWAY * way:
            return (f'{_times(moved / way)}, back and forth; correct units or gear ratio in its '
                    'driver')
        return ''

    def _silent(self, j: int, fit: _Fit) -> tuple[bool | None, str]:
        """Say why positions do not answer at all."""
        if self._stood is None:  # nobody wanted it to move yet
            return False, self._drifts(j, -self._ways[-1, j] / self._time[-1])
        way = np.ptp(self._ways[:, j])
        if (fit.error > settings.SCALE_ERROR
                or np.ptp(self._moved[:, j]) > settings.MOVES_TOO * way):
            return None, self._figures(j, fit)
        factor, unit = self._units[j]
        return False, (f'the joint does not answer commands of {factor * way:.2g} {unit}; check '
                       'drive, brake and encoder, and that a driver takes the commands')


def nudges(joint: str, q: float, step: float) -> Trajectory:
    """Give a step there and back, twice, at constant speed: q, step [rad or m]."""
    pause = settings.NUDGE_DWELL
    leg = settings.NUDGE_TIME * max(abs(step) / settings.NUDGE, 1.0)
    ends = np.arange(4) * (leg + pause) + leg
    return Trajectory((joint,), np.ravel(ends[:, np.newaxis] + [0.0, pause]),
                      np.repeat(q + step * np.array([1.0, 0.0, 1.0, 0.0]), 2)[:, np.newaxis])


def pose_fault(arm: Arm, q: FloatArray) -> str:
    """Say which joint stands where it cannot; empty for none: q (joints,) [rad or m]."""
    limits = hard_limits(arm)
    for name, at, low, high in zip(arm.active_joints, q, limits.lower, limits.upper, strict=True):
        if at < low - settings.BEYOND or at > high + settings.BEYOND:
            return (f'{name} is at {at:.4g} {arm.position_units[name]}, outside its limits '
                    f'{low:.4g} to {high:.4g}; check order, sign, unit and zero of the positions '
                    'in the driver')
    return ''


def order_fault(joints: Sequence[str], found: Sequence[str]) -> str:
    """Say what is wrong with the joints of a controller, in their order; empty for nothing."""
    if list(found) == list(joints):
        return ''
    what = ' in this order' if sorted(found) == sorted(joints) else ''
    return (f'the controller drives {list(found)}, but commands are for {list(joints)}{what}; set '
            f"the parameter 'joints' of the controller to {list(joints)}")
