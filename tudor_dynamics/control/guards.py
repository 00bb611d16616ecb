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

"""Guards: motion envelope, encoder checks, instability of the damper, references, take-over."""

from __future__ import annotations

from collections import Counter, deque
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tudor_dynamics.arm.limits import DriveStop, Limits
from tudor_dynamics.compiled import compiled
from tudor_dynamics.typing import FloatArray


# -- One step of the motion envelope of one joint, compiled: for hardware and simulation alike

# Columns of the limits of one joint.
LOWER, UPPER = 0, 1  # position [rad]
SPEED = 2  # [rad/s]
ACCELERATION = 3  # [rad/s^2]
BRAKE = 4  # with which the joint stops before a position limit [rad/s^2]
TIME = 5  # for which it goes on as fast before that [s]
ROW = 6
# Columns of the state of one joint.
COMMAND = 0  # last command [rad/s]
CUT = 1  # what cut the last command: sum of the following
STATES = 2
BY_SPEED, BY_POSITION, BY_ACCELERATION = 1, 2, 4
SATURATING = BY_SPEED + BY_POSITION  # a command that only takes longer is none the less obeyed

COMMANDED = 0.93
"""Part of the speed limit that is commanded: the rest is for what drive and load make of it."""


@compiled
def approach_speed(way: float, acceleration: float, time: float) -> float:
    """
    Give the fastest speed towards a position limit from which the joint still stops before it.

    acceleration [rad/s^2], time [s]; way [rad]: below 0 beyond it; returns [rad/s], 0 beyond the
    limit.
    """
    if way <= 0.0:
        return 0.0
    if math.isinf(way) or math.isinf(acceleration):
        return math.inf if time == 0.0 else way / time
    reach = acceleration * time
    return math.sqrt(reach * reach + 2.0 * acceleration * way) - reach


@compiled
def envelope_law(row: NDArray, state: NDArray, dt: float, wanted: float, q: float) -> float:
    """
    Give the speed nearest to the wanted one that keeps a joint within its limits.

    row, state (ROW,), dt [s], wanted [rad/s], q [rad]; returns speed [rad/s].
    """
    limit = COMMANDED * row[SPEED]
    speed = min(max(wanted, -limit), limit)
    cut = 0
    if speed != wanted:
        cut += BY_SPEED
    bounded = min(max(speed, -approach_speed(q - row[LOWER], row[BRAKE], row[TIME])),
                  approach_speed(row[UPPER] - q, row[BRAKE], row[TIME]))
    if bounded != speed:
        cut += BY_POSITION
    speed = bounded
    if not math.isinf(row[ACCELERATION]):  # no time times no limit is no number
        change = row[ACCELERATION] * dt
        speed = min(max(bounded, state[COMMAND] - change), state[COMMAND] + change)
    if speed != bounded:
        cut += BY_ACCELERATION
    state[COMMAND], state[CUT] = speed, cut
    return speed


# -- Motion envelope: no speed leaves the package that a joint's limits do not allow

ROOM = 0.002
"""A position limit is kept off by what the speed limit goes in this time, for readings that are
rounded and joints that stick and slip [s]: 0.24 deg at 120 deg/s."""
BRAKING = 0.6
"""Part of the acceleration limit with which the arm stops before a position limit: the rest is for
what drive and load make of a command."""
APPROACH = math.e
"""Time of the approach over the lag: a place that is approached by v = way / T through a lag is
not overshot from T = e lag on."""


class Envelope:
    """Envelope of several joints, step by step: lag [s]."""

    def __init__(self, limits: Limits, lag: float, stop: DriveStop | None = None) -> None:
        joints = len(limits.lower)
        self._timeout = 0.0 if stop is None else stop.timeout
        room = np.where(np.isfinite(limits.velocity), ROOM * limits.velocity, 0.0)
        brake = BRAKING * limits.acceleration
        self.rows = np.zeros((joints, ROW))
        self.rows[:, LOWER], self.rows[:, UPPER] = limits.lower + room, limits.upper - room
        self.rows[:, SPEED], self.rows[:, ACCELERATION] = limits.velocity, limits.acceleration
        self.rows[:, BRAKE] = brake if stop is None else np.minimum(brake, stop.acceleration)
        self.set_lag(lag)
        self.state = np.zeros((joints, STATES))

    @property
    def command(self) -> FloatArray:
        """Last command [rad/s]."""
        return np.asarray(self.state[:, COMMAND].copy())

    @property
    def cuts(self) -> NDArray[np.intp]:
        """Sum of what cut the last command of each joint, see `envelope_law`."""
        return np.asarray(self.state[:, CUT].astype(np.intp))

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """Which joints had speed or position at a limit in the last step."""
        return np.asarray((self.cuts & SATURATING) > 0)

    @property
    def speeding(self) -> NDArray[np.bool_]:
        """Which joints were to go faster than their speed limit in the last step."""
        return np.asarray((self.cuts & BY_SPEED) > 0)

    def set_lag(self, lag: float) -> None:
        """Take another time from command to motion into use [s]."""
        self.rows[:, TIME] = max(APPROACH * lag, lag + self._timeout)

    def begin(self, command: ArrayLike) -> None:
        """Begin anew at the speeds that the joints have [rad/s]: command (joints,) [rad/s]."""
        self.state[:] = 0.0
        self.state[:, COMMAND] = command

    def reset(self) -> None:
        """Begin anew at standstill."""
        self.begin(0.0)

    def step(self, dt: float, wanted: ArrayLike, q: ArrayLike) -> FloatArray:
        """
        Bound the wanted speeds.

        dt [s], wanted (joints,) [rad/s], q (joints,) [rad]; returns (joints,) [rad/s].
        """
        wanted, q = np.asarray(wanted, dtype=float), np.asarray(q, dtype=float)
        return np.array([envelope_law(self.rows[j], self.state[j], dt, float(wanted[j]),
                                      float(q[j])) for j in range(len(self.rows))])


# -- Encoders that cannot be believed: frozen while commanded, jumping, or out of any range

FROZEN_TIME = 0.015
"""A reading that stands still is frozen where the joint should have gone on for so long at its
speed limit [s]: 1.8 deg at 120 deg/s."""
FROZEN_SAMPLES = 3
"""Readings that must be the same: slow joints give the same count twice."""
JUMP_SPEED = 3.0
"""A reading may change by so many times the speed limit..."""
JUMP_TIME = 0.02
"""... and by what the speed limit makes of this time besides [s]."""
RANGE_TIME = 0.2
"""Further beyond a position limit than the speed limit goes in this time is no pose [s]."""


class EncoderWatch:
    """
    Judges the readings of encoders against the commands that the joints were given.

    owed (joints,) [rad or m].
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._speed = limits.velocity
        n = len(self._speed)
        self._last: FloatArray | None = None
        self._same = np.zeros(n, dtype=np.intp)
        self.owed = np.zeros(n)
        self._stood, self._jumped = np.zeros(n), np.zeros(n)

    def reset(self) -> None:
        """Take the next reading for a first one."""
        self._last = None
        self._same[:] = 0
        self.owed[:] = 0.0
        self._stood[:] = 0.0
        self._jumped[:] = 0.0

    def step(self, dt: float, q: FloatArray, commanded: FloatArray) -> list[tuple[int, str]]:
        """
        Judge one reading.

        dt [s], q (joints,) [rad or m], commanded (joints,) [rad/s or m/s].
        """
        found: list[tuple[int, str]] = []
        far = self._speed * RANGE_TIME
        for j in np.flatnonzero((q < self._limits.lower - far) | (q > self._limits.upper + far)):
            found.append((int(j), f'its position {q[j]:.4g} is no pose of the arm, with limits of '
                          f'{self._limits.lower[j]:.4g} .. {self._limits.upper[j]:.4g}'))
        if self._last is not None:
            change = q - self._last
            allowed = self._speed * (JUMP_SPEED * dt + JUMP_TIME)
            for j in np.flatnonzero(np.abs(change) > allowed):
                found.append((int(j), f'its position jumped by {change[j]:.4g} within '
                              f'{1e3 * dt:.3g} ms'))
                self._jumped[j] -= change[j] - dt * commanded[j]
            still = change == 0.0
            self._same = np.where(still, self._same + 1, 0)
            self._stood = np.where(still, self._stood + dt * commanded, 0.0)
            self.owed = self._stood + self._jumped
            frozen = (self._same >= FROZEN_SAMPLES) & (
                np.abs(self._stood) > self._speed * FROZEN_TIME)
            for j in np.flatnonzero(frozen):
                found.append((int(j), 'it does not move although it is commanded to: encoder '
                              'frozen, brake on, or a driver that does not listen'))
        self._last = q.copy()
        return found


# -- A damper that excites instead of damping: seen by a swing that does not decay

WINDOW = 0.4
"""Time over which the size of a swing is taken: most of a period at 2 Hz [s]."""
SETTLING = 0.6
"""After the reference has come to rest [s]."""
LOUD = 0.04
"""Part of the speed limit below which a swing is of no concern: 4.5 deg/s at 120 deg/s."""
LASTING = 4
"""Windows in a row without decay."""
DECAY = 0.85
"""A swing decays if it is smaller than this part of itself two windows before."""
GROWTH = 1.3
"""A swing that is so much larger than a window before, twice in a row, grows."""
WILD = 0.5
"""Part of the speed limit that nothing but a swing adds to a reference for long."""
SHARE = 0.3
"""Part of a window in which commands are cut, or wild, that no damping needs."""
WINDOWS = 2
"""Such windows in a row."""


class SwingWatch:
    """
    Judges what the position loop and the damper add to the reference.

    While the reference rests, what they add must decay: a swing that goes on at the same size, or
    grows, is fed by them. Whether it rests or not, commands beyond the speed limit again and
    again, or far from the reference, are no damping either.

    speed (joints,) [rad/s].
    """

    def __init__(self, speed: FloatArray) -> None:
        self._scale = np.where(np.isfinite(speed), speed, 1.0)
        self._peaks: deque[float] = deque(maxlen=LASTING + 2)
        self.reset()

    def reset(self) -> None:
        """Forget what was seen."""
        self._peaks.clear()
        self._rest = self._elapsed = self._peak = self._wild = 0.0
        self._wild_windows = 0

    def step(self, dt: float, added: FloatArray, moving: bool, cut: bool) -> str:
        """
        Judge one command.

        dt [s], added (joints,) [rad/s]; returns an empty string for nothing.
        """
        self._rest = 0.0 if moving else self._rest + dt
        self._elapsed += dt
        size = float(np.max(np.abs(added) / self._scale, initial=0.0))
        self._wild += dt if cut or size > WILD else 0.0
        self._peak = max(self._peak, size)
        if self._elapsed < WINDOW:
            return ''
        share, peak = self._wild / self._elapsed, self._peak
        self._elapsed = self._peak = self._wild = 0.0
        self._wild_windows = self._wild_windows + 1 if share > SHARE else 0
        if self._rest < SETTLING:
            self._peaks.clear()
        else:
            self._peaks.append(peak)
        if self._wild_windows >= WINDOWS:
            self.reset()
            return 'its commands are at the limits, or far from the reference, again and again'
        peaks = list(self._peaks)
        grown = [now > GROWTH * before for before, now in zip(peaks, peaks[1:], strict=False)]
        if len(grown) > 1 and min(peaks[-2:]) > LOUD and all(grown[-2:]):
            self.reset()
            return 'the swing grows while the reference rests'
        if len(peaks) == LASTING + 2 and all(
                now > LOUD and now > DECAY * before
                for before, now in zip(peaks[:-2], peaks[2:], strict=True)):
            self.reset()
            return 'the swing does not decay while the reference rests'
        return ''


# -- References that may be followed: newest one, its age, and why others are refused

class ReferenceGate:
    """
    Lets references pass that keep to the limits, and says what is wrong with others.

    q, dq (joints,) [rad, rad/s]; refusal: empty if it was taken.
    """

    def __init__(self, joints: tuple[str, ...], limits: Limits) -> None:
        self._joints, self._limits = joints, limits
        self.refused: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """Forget the newest reference."""
        self.q, self.dq = np.zeros(len(self._joints)), np.zeros(len(self._joints))
        self._at: float | None = None
        self.refusal = ''

    @property
    def known(self) -> bool:
        """Whether any reference was taken."""
        return self._at is not None

    def age(self, now: float) -> float:
        """Give the age of the newest reference; infinite without one [s]."""
        return math.inf if self._at is None else now - self._at

    def place(self, now: float, longest: float) -> FloatArray:
        """
        Give where the newest reference is by now, carried on for a time at most [rad; s].

        now, longest [s].
        """
        return np.asarray(self.q + min(self.age(now), longest) * self.dq)

    def add(self, now: float, q: FloatArray, dq: FloatArray) -> None:
        """Take a reference, if it can be one: now [s], q, dq (joints,) [rad, rad/s]."""
        self.refusal = self._impossible(q, dq)
        if self.refusal:
            self.refused[self.refusal.partition(':')[0]] += 1
        else:
            self._at, self.q, self.dq = now, q.copy(), dq.copy()

    def _impossible(self, q: FloatArray, dq: FloatArray) -> str:
        if not (np.isfinite(q).all() and np.isfinite(dq).all()):
            return 'reference not finite: its values are no numbers'
        limits = self._limits
        for j in np.flatnonzero(limits.outside(q)):
            degrees = '' if abs(q[j]) < 2.0 * math.pi else '; are these degrees?'
            return (f'reference outside limits: {self._joints[j]} {q[j]:.4g} is not within '
                    f'{limits.lower[j]:.4g} .. {limits.upper[j]:.4g}{degrees}')
        for j in np.flatnonzero(np.abs(dq) > limits.velocity):
            return (f'reference too fast: {self._joints[j]} {dq[j]:.4g} is beyond the speed limit '
                    f'{limits.velocity[j]:.4g}')
        return ''


# -- Taking over an arm that somebody else has moved: not while its drives brake by themselves

LOOK = 0.1
"""Time for which an arm is looked at first, beside the delay of the loop [s]: drives that hear
nothing brake after as long."""
BRAKES = 0.1
"""Part of the planned acceleration from which on an arm brakes."""


class Takeover:
    """
    Says when an arm of unknown motion can be commanded, and at which speed.

    A command at the speed that was measured is a step up for an arm that has begun to brake
    meanwhile; so one that brakes is left to stop.

    acceleration (joints,) [rad/s^2].
    """

    def __init__(self, acceleration: FloatArray) -> None:
        self._acceleration = acceleration
        self._seen: deque[tuple[float, FloatArray]] = deque()

    def reset(self) -> None:
        """Begin to look."""
        self._seen.clear()

    def step(self, now: float, dq: FloatArray, delay: float) -> bool:
        """Look at a sample: now, delay [s], dq (joints,) [rad/s]."""
        self._seen.append((now, dq))
        while len(self._seen) > 2 and now - self._seen[1][0] >= LOOK + delay:
            self._seen.popleft()
        begin, before = self._seen[0]
        if now - begin < LOOK + delay:
            return False
        slower = np.abs(before) - np.abs(dq)
        return not bool(np.any(slower > BRAKES * self._acceleration * (now - begin)))


# -- When an arm begins to follow its reference, and when it may not go on

NEAR_TIME = 0.07
"""A reference is near the arm within what the planned speed goes in this time [s]: 4.9 deg."""
FOLLOWING_TIME = 0.3
"""Following error at which the arm stops, as such a time [s]: 21 deg."""
RESTING = 0.05
"""Part of the planned speed below which a reference rests."""


class Following:
    """Reasons not to follow a reference: planned (joints,) [rad/s or m/s]."""

    def __init__(
        self, joints: tuple[str, ...], planned: FloatArray, reference: ReferenceGate,
    ) -> None:
        self._joints, self._planned, self._reference = joints, planned, reference

    def stray(self, now: float, timeout: float, q: FloatArray) -> str:
        """
        Say why an arm that follows must not go on; empty if it may.

        now, timeout [s], q (joints,) [rad or m].
        """
        away = self._away(now, timeout, q)
        if self._reference.age(now) > timeout:
            return f'no reference for {1e3 * timeout:.0f} ms'
        if np.any(away > FOLLOWING_TIME * self._planned):
            j = int(np.argmax(away / self._planned))
            return f'{self._joints[j]} is {away[j]:.3g} away from its reference'
        return ''

    def obstacle(self, now: float, timeout: float, q: FloatArray, held: FloatArray) -> str:
        """
        Say why an arm that holds cannot begin to follow; empty if it can.

        held (joints,) [rad/s or m/s].
        """
        reference, away = self._reference, self._away(now, timeout, q)
        if reference.age(now) > timeout:
            return reference.refusal or 'no reference comes'
        if np.any(away > NEAR_TIME * self._planned):
            j = int(np.argmax(away / self._planned))
            return (f'the reference is {away[j]:.3g} away from {self._joints[j]}: it has to '
                    'begin at the arm')
        if np.any(np.abs(reference.dq) > RESTING * self._planned):
            return 'the reference moves already: it has to begin at rest'
        return 'the arm brakes' if np.any(np.abs(held) > RESTING * self._planned) else ''

    def _away(self, now: float, timeout: float, q: FloatArray) -> FloatArray:
        return np.abs(self._reference.place(now, timeout) - q)
