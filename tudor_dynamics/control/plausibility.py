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
Whether joints move as they are commanded, and what lies where they do not.

The way of the readings has to be that of the commands of some time ago, within what is known of
the delay of the loop. What is beyond is the excess of a joint. A real drive wanders off its
commands slowly, which is forgotten; what comes faster, and too far, is a fault.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.limits import Limits
from tudor_dynamics.compiled import compiled
from tudor_dynamics.control import settings
from tudor_dynamics.control.cascade import Commanded, way_at
from tudor_dynamics.typing import FloatArray

# Columns of the state of one joint.
OFFSET = 0  # of the readings from the way that was commanded; no number before the first [rad]
EXCESS = 1  # how far readings are ahead of all that the commands can have made [rad]
ALLOWED = 2  # excess that is no fault [rad]
CONFIRMED = 3  # way that the readings have gone as commanded [rad]
LAST = 4  # reading before [rad]
ONSET = 5  # time at which excess and speed were small last [s]
SAME, STOOD = 6, 7  # equal readings, and the way that was commanded meanwhile [rad]
UNSURE = 8  # time until which its offset is less sure, after a load that held it up [s]
JERKED = 9  # time until which it is allowed more, after a load that held up any joint [s]
WIDTH = 10  # how much more until then [rad]
UNSTEADY = 11  # factor of what is allowed while samples come late, the same for all joints
FASTER = 12  # than any command that may act now, by the last two readings [rad/s]
AHEAD = 13  # the same where it is sure, 1: as much as is no fault
LOADED, PUSH = 14, 15  # when its effort was at its end last [s], and its sign
BEYOND = 16  # 1 where it is farther or faster than is allowed, or will be past a limit
COUNT = 17  # smallest change of its readings [rad]
PUSHED = 18  # time at which it was faster than is allowed, and pushed on with all its effort [s]
UNHEARD = 19  # way that may be due to commands that its driver has not taken [rad]
WATCHED = 20
RADIANS = 'its driver takes radians for degrees, or its encoder has a wrong scale'


@compiled
def watch_law(
    at: NDArray, way: NDArray, commands: NDArray, count: int,  # see `Commanded`
    now: float, dt: float, longer: float,  # longer: of this sample and the one before [s]
    # Earliest and latest of the motion, and for how long its driver may have taken no command [s].
    lags: tuple[float, float, float],
    q: NDArray, effort: NDArray,  # (joints,): effort is 1 at its end
    limits: NDArray,  # (3, joints): lower, upper, speed
    state: NDArray,  # (joints, WATCHED)
) -> bool:
    """Compare readings with commands; True if a joint is beyond them, or frozen despite them."""
    found = False
    earliest, latest, unheard = lags
    lower, upper, speed = limits[0], limits[1], limits[2]
    for j in range(len(q)):
        row, least, most, old = state[j], 0.0, 0.0, False
        slowest, quickest = math.inf, -math.inf
        low = way_at(at, way, commands, count, j, now - latest)
        high = way_at(at, way, commands, count, j, now - earliest)
        low, high = min(low, high), max(low, high)
        k = count - 1
        while k >= 0:
            if at[k] < now - earliest:
                slowest, quickest = min(slowest, commands[k, j]), max(quickest, commands[k, j])
                if not old:
                    low, high = min(low, way[k, j]), max(high, way[k, j])
                    least, most = min(least, commands[k, j]), max(most, commands[k, j])
            old = at[k] < now - latest
            if at[k] < now - latest - unheard:
                break
            k -= 1
        fastest, first = max(most, -least), math.isnan(row[OFFSET])
        row[UNHEARD] *= 1.0 - min(dt / settings.LATE_MEMORY, 1.0)
        if unheard > 0.0 and quickest > slowest:
            row[UNHEARD] += dt * (quickest - slowest)
        if first:
            row[OFFSET], row[LAST], row[ONSET] = q[j] - 0.5 * (low + high), q[j], now
            row[FASTER] = 0.0
        moved, middle = q[j] - row[LAST], 0.5 * (earliest + latest)
        asked = way_at(at, way, commands, count, j, now - middle) - way_at(
            at, way, commands, count, j, now - dt - middle)
        offset = min(max(row[OFFSET], q[j] - high), q[j] - low)
        excess = offset - row[OFFSET]
        explained = min(max(excess, -row[UNHEARD]), row[UNHEARD])
        row[OFFSET] += explained
        row[UNHEARD] -= abs(explained)
        excess -= explained
        if now >= row[JERKED]:
            row[WIDTH] = 0.0
        at_end = abs(effort[j]) >= 1.0
        if at_end:
            row[LOADED], row[PUSH] = now, math.copysign(1.0, effort[j])
        loaded = row[LOADED] > now - settings.OVERLOAD_LASTS
        # A drive that pushes with all it has yields to its load.
        held_up = loaded and excess * row[PUSH] < 0.0
        share = settings.WANDER_LOADED if now < row[UNSURE] else settings.WANDER_SHARE
        forgotten = dt * (settings.WANDER_SPEED * speed[j] + share * fastest)
        if held_up:
            row[OFFSET] = q[j] - way_at(at, way, commands, count, j, now - middle)
            row[UNSURE], excess = now + settings.OVERLOAD_AFTER, 0.0
            for i in range(len(q)):  # a drive that gives way, or recovers, jerks all others
                state[i, JERKED] = row[UNSURE]
                state[i, WIDTH] = max(state[i, WIDTH], settings.EXCESS_JERKED * speed[i])
            row[WIDTH] = max(row[WIDTH], 0.5 * (high - low))
        else:
            row[OFFSET] += min(max(excess, -forgotten), forgotten)
        row[EXCESS] = excess
        row[ALLOWED] = row[UNSTEADY] * (
            settings.EXCESS_TIME * speed[j] + settings.EXCESS_LATE * fastest) + row[WIDTH]
        ahead = max(moved / dt - most, least - moved / dt)
        near = not lower[j] < q[j] + settings.CRITICAL_TIME * moved / dt < upper[j]
        critical = near or abs(moved) > settings.CRITICAL_SPEED * speed[j] * dt
        # A sound drive that is faster than its command does not accelerate with full effort.
        pushed = critical and at_end and moved * row[PUSH] > 0.0 and (
            most if moved > 0.0 else -least) > 0.0
        # One sample may be a count of a coarse encoder, or a stamp that jitters: it takes two,
        # except where the motion is critical.
        once = max(moved / longer - most, least - moved / longer)
        coarse = settings.COARSE_COUNTS * row[COUNT] + (
            0.0 if pushed else settings.COARSE_TIME * speed[j])
        sure = once if critical and once * longer > coarse else min(ahead, row[FASTER])
        part = settings.AHEAD_PUSHED if pushed else 2.0 if row[WIDTH] > 0.0 else (
            1.0 if lower[j] < q[j] + settings.NEAR_BY * moved / dt < upper[j]
            else settings.AHEAD_NEAR)
        row[AHEAD] = sure / (row[UNSTEADY] * part * (
            settings.AHEAD_SPEED * speed[j] + settings.AHEAD_SHARE * fastest))
        row[FASTER] = ahead
        if pushed and row[AHEAD] > 1.0:
            row[PUSHED] = now
        if abs(row[EXCESS]) < settings.EXCESS_SMALL * row[ALLOWED] and row[AHEAD] < 0.5:
            row[ONSET] = now
        if asked != 0.0:
            right = moved if asked > 0.0 else -moved
            right = min(max(right, -abs(asked)), abs(asked))
            row[CONFIRMED] = min(max(row[CONFIRMED] + right, 0.0), speed[j])
        if moved != 0.0 or first or unheard > 0.0:
            row[SAME], row[STOOD] = 0.0, 0.0
        else:
            row[SAME], row[STOOD] = row[SAME] + 1.0, row[STOOD] + asked
        if moved != 0.0:
            row[COUNT] = min(row[COUNT], abs(moved))
        row[LAST] = q[j]
        end = q[j] + settings.EXCESS_GROWS * excess
        past = end > upper[j] if excess > 0.0 else end < lower[j] and excess < 0.0
        beyond = row[AHEAD] > 1.0 or abs(excess) > row[ALLOWED] * (
            settings.EXCESS_AT_END if past else 1.0)
        row[BEYOND] = 1.0 if beyond else 0.0
        if beyond or (row[SAME] >= settings.FROZEN_SAMPLES and not loaded
                      and abs(row[STOOD]) > speed[j] * settings.FROZEN_TIME):
            found = True
    return found


@dataclass(frozen=True)
class Doubt:
    """Why a joint, or its readings, cannot be believed."""

    joint: int
    text: str
    astray: bool  # whether the joint may move as nobody commands it: braked as fast as it can be
    later: bool = True  # whether what is seen later may tell the cause better
    swapped: bool = False
    drifts: bool = False


class MotionWatch:
    """Judges readings against the commands that the joints were given."""

    def __init__(self, units: dict[str, str], limits: Limits, effort: FloatArray) -> None:
        self._joints, self._units, self._limits = tuple(units), tuple(units.values()), limits
        self.speed = np.where(np.isfinite(limits.velocity), limits.velocity, math.pi)
        self._bounds = np.array([limits.lower, limits.upper, self.speed], dtype=float)
        # Largest of each, in the unit that it is measured in, infinite where unknown.
        self._effort = settings.OVERLOADED * np.where(effort > 0.0, effort, np.inf)
        far = self.speed * settings.RANGE_TIME
        self._lowest, self._highest = limits.lower - far, limits.upper + far
        self.reset()

    def reset(self) -> None:
        """Forget all readings, and what was confirmed."""
        self.state = np.zeros((len(self._joints), WATCHED))
        self.state[:, COUNT] = math.inf
        self.restart(None)

    def restart(self, q: FloatArray | None, free: float = 0.0) -> None:
        """Take a reading for the first one; what was confirmed stays."""
        self.state[:, [EXCESS, SAME, STOOD, UNSURE, JERKED, WIDTH, AHEAD, BEYOND, UNHEARD]] = 0.0
        self.state[:, OFFSET] = math.nan
        self.state[:, [LOADED, PUSHED]] = -math.inf
        self.owed = np.zeros(len(self._joints))  # what readings lack of where commands have led
        self._seen: deque[tuple[float, FloatArray, FloatArray | None]] = deque()
        self._onset = np.full(len(self._joints), -math.inf)
        if q is not None:
            self._seen.append((-math.inf, q, None))
        self._free = free  # for which drives may have braked by themselves meanwhile [s]
        self._dt = 0.0

    def trust(self, speed: FloatArray) -> None:
        """Let speeds that the joints have already be commanded: speed (joints,) [rad/s]."""
        self.state[:, CONFIRMED] = np.maximum(
            self.state[:, CONFIRMED], settings.CONFIRMING_TIME * np.abs(speed))

    @property
    def trusted(self) -> FloatArray:
        """Speeds that may be commanded by what was confirmed so far, (joints,) [rad/s]."""
        return np.asarray(settings.UNCONFIRMED_SPEED * self.speed
                          + self.state[:, CONFIRMED] / settings.CONFIRMING_TIME)

    def report(self) -> list[str]:
        """Give how far each joint is ahead of its commands, and what is no fault [rad or m]."""
        return [f'{row[EXCESS]:.4f} of {row[ALLOWED]:.4f}' for row in self.state]

    def step(
        self, now: float, dt: float,  # by the clock of the commands
        q: FloatArray, commanded: Commanded,
        lags: tuple[float, float],  # shortest and longest from a command to its motion [s]
        dq: FloatArray | None = None, effort: FloatArray | None = None,  # what the driver says
        *, telling: bool = True,
        late: float = 0.0, recent: float = 0.0,  # lateness of this sample, of others before [s]
    ) -> list[Doubt]:
        """Judge one reading; without telling, what is found is followed but not explained."""
        longer, self._dt = max(dt, self._dt), dt
        outside = (q < self._lowest) | (q > self._highest)
        step = q - self._seen[-1][1] if self._seen else np.zeros_like(q)
        jumped = np.abs(step) > self.speed * (settings.JUMP_SPEED * dt + settings.JUMP_TIME)
        self._seen.append((now, q, dq))
        while self._seen[0][0] < now - settings.TELLING_TIME:
            self._seen.popleft()
        self._free -= dt
        if self._free > 0.0:
            self.state[:, OFFSET] = math.nan
        self.state[:, UNSTEADY] = 1.0 + min(recent / settings.LATE_DOUBLES, 1.0)
        # A driver that is late with its samples is so with commands, too: until it has caught up,
        # it may go on with old ones, or take what was given after the time of the sample.
        earliest, latest = lags[0] - late, lags[1] + late
        unheard = recent if late > max(dt, settings.LAG_MARGIN) else 0.0
        share = np.zeros_like(q) if effort is None else effort / self._effort
        found = commanded.count > 0 and watch_law(
            commanded.at, commanded.way, commanded.commands, commanded.count, now, dt, longer,
            (earliest, latest, unheard), q, share, self._bounds, self.state)
        # What wanders is forgotten, but not of an encoder that may be frozen.
        self.owed = np.where(self.state[:, SAME] >= settings.FROZEN_SAMPLES,
                             self.state[:, STOOD], -self.state[:, EXCESS])
        if not telling or not (found or outside.any() or jumped.any()):
            return []
        self._onset = self.state[:, ONSET].copy()
        doubts = [Doubt(int(j), f'the measured position {q[j]:.4g} {self._units[j]} is far '
                        f'outside its limits {self._limits.lower[j]:.4g} to '
                        f'{self._limits.upper[j]:.4g}; check unit and zero of its encoder', False,
                        later=False) for j in np.flatnonzero(outside)]
        doubts += [Doubt(int(j), f'the measured position jumped by {step[j]:.3g} {self._units[j]} '
                         f'in {1e3 * dt:.3g} ms; check its encoder', False, later=False)
                   for j in np.flatnonzero(jumped)]
        beyond = self.state[:, BEYOND] > 0.0
        frozen = np.abs(self.state[:, STOOD]) > self.speed * settings.FROZEN_TIME
        for j in np.flatnonzero((beyond | frozen) & ~jumped):
            self.owed[j] = -self.state[j, EXCESS] or self.state[j, STOOD]
            doubts.append(self.tell(int(j), commanded, (earliest, latest)))
        return doubts

    def tell(self, j: int, commanded: Commanded, lags: tuple[float, float]) -> Doubt:
        """Say what explains best how a joint moved since it left its commands."""
        seen = [item for item in self._seen if item[0] >= self._onset[j] - 1e-9]
        seen = seen if len(seen) > 2 else list(self._seen)[-3:]
        times = np.array([item[0] for item in seen])
        moved = np.array([item[1] for item in seen])
        moved -= moved[0]
        own = np.array([math.nan if item[2] is None else item[2][j] for item in seen])
        made = np.concatenate([[0.0], np.cumsum(np.diff(times) * 0.5 * (own[1:] + own[:-1]))])
        best, least, drift, other = Doubt(j, '', True), math.inf, '', math.inf
        for lag in np.linspace(0.0, lags[1], settings.LAGS_TRIED):  # a lie shifts what is measured
            asked = commanded.made(times - lag)
            asked -= asked[0]
            for error, doubt in self._explanations(j, times, moved, asked):
                if error < least:
                    least, best = error, doubt
                if doubt.drifts and error < other:
                    other, drift = error, doubt.text
        if not best.swapped and (text := self._contradiction(j, times, moved[:, j], made)):
            return Doubt(j, text, False)
        # A slow drift near a limit is found before it differs from what needs no figure.
        if not best.drifts and other < settings.FREE * least:
            best = replace(best, text=f'{best.text}; or {drift}')
        return best

    def _explanations(
        self, j: int, times: FloatArray, moved: FloatArray, asked: FloatArray,
    ) -> Iterator[tuple[float, Doubt]]:
        """Give explanations with what they leave of the motion; simple ones come first."""
        mine, wanted, since = moved[:, j], asked[:, j], times - times[0]
        floor = settings.EXCESS_SMALL * self.state[j, ALLOWED] * settings.ROUGH

        def left(explained: FloatArray) -> float:
            return float(np.std(mine - explained)) + floor

        def fast(rate: float) -> float:
            return settings.FREE + abs(rate) / (settings.FAST_DRIFT * self.speed[j])
        pushing = self.state[:, PUSHED] >= times[0]
        pushed, unlikely = bool(pushing[j]), 2.0 if pushing[j] else 1.0  # if all effort is taken
        change = mine - wanted
        sizes = float(np.ptp(mine)), float(np.ptp(wanted))
        fastest = float(np.abs(np.diff(mine) / np.diff(times)).max())
        if pushed or sizes[0] > settings.RUNAWAY * sizes[1] and mine[-1] * wanted[-1] >= 0.0 and (
                fastest > 3.0 * settings.RUNAWAY * settings.UNCONFIRMED_SPEED * self.speed[j]):
            yield (settings.PUSHES * left(wanted) if pushed
                   else settings.RUNS * float(np.std(mine))), Doubt(
                j, 'the joint runs away from its commands' + (
                    f', {sizes[0] / sizes[1]:.2g} times as far as commanded'
                    if 1e-3 < sizes[1] / sizes[0] < 1.0 / settings.RUNAWAY else '')
                + f'; correct this: {RADIANS}', True)
        place = int(np.abs(np.diff(change)).argmax())
        step = float(change[place + 1] - change[place])
        yield left(wanted + step * (np.arange(len(mine)) > place)) + (
            math.inf if abs(step) < settings.JUMP_SHARE * max(
                np.ptp(change), self.state[j, ALLOWED]) else 0.0), Doubt(
                j, f'the measured position jumped by {step:.3g} {self._units[j]} in '
                f'{1e3 * (times[place + 1] - times[place]):.3g} ms; check its encoder', False)
        for i in range(len(self._joints)):
            both_push = pushed and pushing[i]  # of two that are swapped, one is slower
            if i != j and not both_push and np.ptp(
                    asked[:, i] - wanted) > settings.SWAPPED * self.state[j, ALLOWED] and (
                    np.ptp(moved[:, i] - asked[:, i]) > settings.SWAPPED * self.state[i, ALLOWED]):
                both = max(left(asked[:, i]), float(np.std(moved[:, i] - wanted)))
                yield both / settings.FREE, Doubt(
                    j, f'this joint and {self._joints[i]} each follow commands to the other; '
                    'correct the order of commands or readings in the driver', True, swapped=True)
        if sizes[0] < settings.SAME_SIZE * sizes[1]:
            yield left(-wanted), Doubt(
                j, 'the joint moves against its commands; correct the sign of commands or encoder '
                'in its driver', True)
        ratio = float(np.cov(mine, wanted)[0, 1] / max(np.var(wanted, ddof=1), 1e-12))
        if ratio < 0.0:  # as fast as it answers, or faster: drives saturate
            ratio = math.copysign(sizes[0] / max(sizes[1], 1e-9), ratio)
        rate = float(change @ since / max(since @ since, 1e-12))
        yield unlikely * fast(rate) * left(wanted + rate * since), Doubt(
            j, f'the joint moves at {rate:.3g} {self._units[j]}/s in addition to its commands; '
            'check its encoder for drift, and its drive for creep', True, drifts=True)
        common = unlikely * settings.FREE * (2.0 if 2.0 / 3.0 < ratio < 1.5 else 1.0)
        yield common * left(ratio * wanted), Doubt(j, self._scaled(ratio), (
            ratio < 0.0 or ratio > 1.0))

    def _scaled(self, ratio: float) -> str:
        """Say what a joint means that moves by a part, or a multiple, of what is commanded."""
        if -2.0 * settings.STANDS < ratio < settings.STANDS:  # held against its load it gives way
            return (f'the joint does not move although it is commanded ({ratio:.2g} of the way); '
                    'check its encoder (frozen, slips), its brake, and that its driver takes '
                    'commands, in rad and not in degrees')
        if ratio < 0.0:
            return (f'the joint moves against its commands, {-ratio:.2g} times as far; correct '
                    'sign and scale of commands or encoder in its driver')
        return f'the joint moves {ratio:.2g} times as far as commanded; ' + (
            f'correct this: {RADIANS}' if ratio > settings.RADIANS_FROM
            else 'correct the scale of commands or encoder in its driver')

    def _contradiction(
        self, j: int, times: FloatArray, moved: FloatArray, made: FloatArray,
    ) -> str:
        """Say how positions contradict the way by the driver's speeds; empty where they do not."""
        if not np.isfinite(made).all():
            return ''
        way, mine = float(made[-1]), float(moved[-1])
        small = settings.EXCESS_SMALL * self.state[j, ALLOWED]
        if abs(way - mine) < max(settings.CONTRADICTS * abs(self.state[j, EXCESS]), small) or (
                abs(way - mine) < settings.ROUGH * np.abs(np.diff(made)).sum()):
            return ''
        steps = np.diff(moved - made)
        if np.abs(steps).max() > settings.JUMP_SHARE * np.ptp(moved - made):
            return (f'the position jumped by {steps[np.abs(steps).argmax()]:.3g} {self._units[j]}'
                    ', the reported velocity did not; the encoder lost counts: check its cable')
        if abs(mine) < settings.STANDS * abs(way):
            return (f'the position moves {mine / way:.2g} times as far as the reported velocity '
                    'implies; check the encoder, which is frozen, slips, or drifts')
        rate = (mine - way) / (times[-1] - times[0])
        steady = np.std(moved - made - rate * (times - times[0])) * (
            1.0 + abs(rate) / (settings.FAST_DRIFT * self.speed[j]))
        if abs(way) < settings.STANDS * abs(mine) or steady < np.std(moved - mine / way * made):
            return (f'the position moves at {rate:.3g} {self._units[j]}/s in addition to the '
                    'reported velocity; check the encoder, which drifts')
        if mine * way < 0.0:
            return 'the encoder counts backwards, against the reported velocity; correct its sign'
        return (f'the position moves {mine / way:.2g} times as far as the reported velocity '
                'implies; correct the scale of the encoder, or check whether it slips')


class AgeWatch:
    """Says how much later samples come than the quickest of the last while."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget which age is usual."""
        self.late = 0.0  # [s]
        self.recent = 0.0  # of the samples just before, too, whose answers still move the joints
        self._last = math.inf
        self._usual = False  # whether stamps go as fast as the clock: only then ages can be judged
        self._begun = -math.inf
        self._before = self._least = math.inf

    def step(self, now: float, age: float) -> float:
        """Take the age of a stamp; it contains how clocks differ, which drifts: now, age [s]."""
        if now - self._begun > (settings.AGE_MEMORY if self._usual else settings.AGE_LEARNED):
            self._usual |= abs(self._least - self._before) < settings.AGE_STEADY
            self._before, self._least, self._begun = self._least, math.inf, now
        self._least = min(self._least, age)
        self.late = age - min(self._before, self._least) if self._usual else 0.0
        kept = math.exp(min(self._last - now, 0.0) / settings.LATE_MEMORY)
        self.recent, self._last = max(self.late, kept * self.recent), now
        return self.late
