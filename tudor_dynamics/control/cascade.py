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
Joint cascade: P position control with velocity feed-forward around PI velocity control.

Between the two stands the motion envelope, so that no speed is asked for beyond a joint's limits.

One compiled law serves the controller of a real arm, step by step, and the simulated one, inside a
compiled loop. Gains of damper and position loop are what the measured delay allows.
"""

from __future__ import annotations

from collections import deque
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.limits import DriveStop, Limits, unlimited
from tudor_dynamics.arm.schema import DamperSpec, MotorSpec
from tudor_dynamics.compiled import compiled
from tudor_dynamics.control import settings
from tudor_dynamics.errors import ArmError
from tudor_dynamics.typing import FloatArray

# Envelope: columns of the limits of one joint.
LOWER, UPPER = 0, 1  # position [rad]
SPEED = 2  # [rad/s]
ACCELERATION = 3  # [rad/s^2]
BRAKE = 4  # with which the joint stops before a position limit [rad/s^2]
TIME = 5  # for which it goes on as fast before that [s]
ROW = 6
# Columns of its state.
COMMAND = 0  # last command [rad/s]
CUT = 1  # what cut the last command: sum of the following
ENVELOPE_STATES = 2
BY_SPEED, BY_POSITION, BY_ACCELERATION = 1, 2, 4
SATURATING = BY_SPEED + BY_POSITION  # a command that only takes longer is none the less obeyed


@compiled
def approach_speed(way: float, acceleration: float, time: float) -> float:
    """Give the fastest speed from which a joint stops in a way [rad], after a time [s] of it."""
    if way <= 0.0:
        return 0.0
    if math.isinf(way) or math.isinf(acceleration):
        return math.inf if time == 0.0 else way / time
    reach = acceleration * time
    return math.sqrt(reach * reach + 2.0 * acceleration * way) - reach


@compiled
def envelope_law(row: NDArray, state: NDArray, dt: float, wanted: float, q: float) -> float:
    """Give the speed nearest to the wanted one that keeps a joint within its limits."""
    limit = settings.COMMANDED_SPEED * row[SPEED]
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


class Envelope:
    """Envelope of several joints, step by step; lag [s]: from a command to its motion."""

    def __init__(self, limits: Limits, lag: float, stop: DriveStop | None = None) -> None:
        joints = len(limits.lower)
        self._timeout = 0.0 if stop is None else stop.timeout
        margin = np.where(np.isfinite(limits.velocity),
                          settings.POSITION_MARGIN * limits.velocity, 0.0)
        brake = settings.BRAKING_SHARE * limits.acceleration
        self.rows = np.zeros((joints, ROW))
        self.rows[:, LOWER], self.rows[:, UPPER] = limits.lower + margin, limits.upper - margin
        self.rows[:, SPEED], self.rows[:, ACCELERATION] = limits.velocity, limits.acceleration
        self.rows[:, BRAKE] = brake if stop is None else np.minimum(brake, stop.acceleration)
        self.state = np.zeros((joints, ENVELOPE_STATES))
        self.lag = lag
        self._take_lag()
        self.begin(0.0)

    @property
    def command(self) -> FloatArray:
        """Last command [rad/s]."""
        return np.asarray(self.state[:, COMMAND].copy())

    @property
    def cuts(self) -> NDArray[np.intp]:
        """Say what cut the last command of each joint, see `envelope_law`, (joints,)."""
        return self.state[:, CUT].astype(np.intp)

    def _take_lag(self) -> None:
        self.rows[:, TIME] = max(settings.APPROACH_TIME * self.lag, self.lag + self._timeout)

    def begin(self, command: ArrayLike) -> None:
        """Restart at the speeds that the joints have: command (joints,) [rad/s]."""
        self.state[:] = 0.0
        self.state[:, COMMAND] = command

    def step(self, dt: float, wanted: ArrayLike, q: ArrayLike) -> FloatArray:
        """Bound the wanted speeds, (joints,)."""
        self._take_lag()
        wanted, q = np.asarray(wanted, dtype=float), np.asarray(q, dtype=float)
        return np.array([envelope_law(self.rows[j], self.state[j], dt, float(wanted[j]),
                                      float(q[j])) for j in range(len(self.rows))])


# Cascade: columns of the gains of one joint, see `JointGains`.
POSITION_GAIN, VELOCITY_GAIN, INTEGRAL_GAIN, CURRENT_LIMIT = range(4)
# Columns of the state of one joint.
INTEGRAL = 0  # share of the integrator in the current [A]
SATURATED = 1  # 1 while the current is at its limit
STATES = 2


@compiled
def position_law(row: NDArray, q_ref: float, dq_ref: float, q: float, yielding: float) -> float:
    """Give the speed that the position loop of a joint wants, for the envelope to bound."""
    return dq_ref + row[POSITION_GAIN] * (q_ref - q) + yielding


@compiled
def velocity_law(
    row: NDArray, state: NDArray, dt: float, speed: float, dq: float, ahead: float,
) -> float:
    """Give the current [A] of one joint; ahead [A]: what is fed forward."""
    error = speed - dq
    current = row[VELOCITY_GAIN] * error + state[INTEGRAL] + ahead
    limit = row[CURRENT_LIMIT]
    bounded = min(max(current, -limit), limit)
    # Anti-windup: the integrator stands still unless it leads back from the limit.
    if bounded == current or (error > 0.0) != (current > 0.0):
        state[INTEGRAL] += row[INTEGRAL_GAIN] * dt * error
        state[INTEGRAL] = min(max(state[INTEGRAL], -limit), limit)
    state[SATURATED] = 1.0 if bounded != current else 0.0
    return bounded


class JointGains(NamedTuple):
    """Gains of one joint, in the order of the columns."""

    # Speed per position error [1/s]; at most 0.3 times the first eigenfrequency in rad/s, or the
    # position loop undoes the damping.
    position: float
    velocity: float  # current per speed error [A s/rad]
    integral: float  # current per integrated speed error [A/rad]
    current_limit: float = math.inf  # largest current of the drive [A]


def motor_gains(motor: MotorSpec, damper: DamperSpec) -> JointGains:
    """Tune the cascade of one joint by its motor."""
    # The velocity loop sees the rotor alone, because the elastic link follows far below its
    # bandwidth w: K = J w / k_t, and the integrator has its corner at a fifth of w.
    if motor.reflected_inertia <= 0.0:
        raise ArmError(f'joint {motor.joint!r}: no velocity loop can be tuned for a rotor_inertia '
                       'of 0; set it [kg m^2] in motors: of the arm description')
    bandwidth = 2.0 * math.pi * damper.velocity_bandwidth
    gain = motor.reflected_inertia * bandwidth / motor.joint_torque_constant
    return JointGains(
        damper.position_gain, gain, settings.INTEGRAL_SHARE * bandwidth * gain,
        motor.current_limit or math.inf)


def arm_gains(arm: Arm) -> list[JointGains]:
    """Tune the cascade of an arm's active joints."""
    damper = arm.damper
    motors = {motor.joint: motor for motor in arm.spec.motors}
    for joint in arm.joints:
        if joint.name not in motors:
            raise ArmError(f'{arm.source}: joint {joint.name!r} has no motor; add it to motors: '
                           'with gear_ratio, torque_constant and rotor_inertia')
    return [motor_gains(motors[joint.name], damper) for joint in arm.joints]


def velocity_lag(damper: DamperSpec) -> float:
    """Give the time from a commanded speed until the joint has most of it [s]."""
    return 1.0 / (2.0 * math.pi * damper.velocity_bandwidth)


class Cascade:
    """Gains, state and envelope of several joints, for the laws above: dt, lag [s]."""

    def __init__(self, gains: list[JointGains], dt: float, limits: Limits | None = None,
                 lag: float = 0.0, stop: DriveStop | None = None) -> None:
        self.rows = np.array(gains).reshape(-1, 4)
        self.state = np.zeros((len(gains), STATES))
        self.envelope = Envelope(limits or unlimited(len(gains)), lag + 2.0 * dt, stop)

    def reset(self, current: ArrayLike = 0.0) -> None:
        """Restart with integrators that give a current [A]."""
        self.state[:] = 0.0
        self.state[:, INTEGRAL] = current
        self.envelope.begin(0.0)


# -- Gains of damper and position loop: what the measured delay allows, and when the damper is off.
#
# The delay is measured by commands of the last half second, and the way that they have made.

@compiled
def way_at(at: NDArray, way: NDArray, commands: NDArray, count: int, j: int, time: float) -> float:
    """Give the way that the commands of a joint, each held until the next, have made [rad]."""
    k = count - 1
    while k >= 0 and at[k] > time:
        k -= 1
    return way[0, j] if k < 0 else way[k, j] + (time - at[k]) * commands[k, j]


class Commanded:
    """Commands by a clock, each held until the next."""

    def __init__(self, joints: int) -> None:
        self.at = np.zeros(512)  # since when each is in force [s]
        self.commands = np.zeros((512, joints))
        self.way = np.zeros((512, joints))  # made by the commands before [rad]
        self.count = 0  # how many of them are in use

    def add(self, now: float, command: FloatArray) -> None:
        """Take a command in force from now on: command (joints,) [rad/s]."""
        if self.count == len(self.at):
            first = int(np.searchsorted(self.at, now - 2.0 * settings.DELAY_LONGEST))
            keep = max(first, self.count // 4)
            rest = self.count - keep
            for kept in (self.at, self.commands, self.way):
                kept[:rest] = kept[keep:]
            self.count = rest
        k = self.count
        if k:  # a sample can be earlier than what was commanded while it did not come
            now = max(now, self.at[k - 1])
        self.way[k] = 0.0 if k == 0 else (
            self.way[k - 1] + (now - self.at[k - 1]) * self.commands[k - 1])
        self.at[k], self.commands[k] = now, command
        self.count += 1

    def made(self, times: FloatArray) -> FloatArray:
        """Give the way made by some times, (times, joints) [rad]."""
        places = np.maximum(np.searchsorted(self.at[:self.count], times, 'right') - 1, 0)
        since = (times - self.at[places])[:, np.newaxis]
        return np.asarray(self.way[places] + since * self.commands[places])


class DelayMeter:
    """
    Measures the time from a command until the readings answer it, with all that lies between.

    That is the whole loop as the damper has it: command, drive, sensor, messages. For each of many
    delays it keeps, with forgetting, how much of the measured speeds the commands of that time ago
    leave unexplained; the least is at the delay. Times are those of the samples' stamps, to which
    commands are the answers: no other clock is needed.
    """

    def __init__(self, speed: FloatArray) -> None:
        self._scale = np.where(np.isfinite(speed), speed, 1.0)  # speed: that joints may have
        self._lags = np.arange(0.0, settings.DELAY_LONGEST, settings.DELAY_STEP)
        self._errors = np.zeros(len(self._lags))
        self._energy = self._time = 0.0
        # Delay of the loop, the last that could be estimated [s]; None before the first.
        self.delay: float | None = None
        self.commands = Commanded(len(speed))

    def add_motion(self, now: float, dt: float, dq: FloatArray) -> None:
        """Take measured speeds into account: now, dt [s], dq (joints,) [rad/s]."""
        dq = dq / self._scale
        commands = self.commands
        if commands.count == 0 or np.abs(dq).max(initial=0.0) < settings.DELAY_MOVING or (
                commands.at[0] > now - settings.DELAY_LONGEST):
            return
        means = (commands.made(now - self._lags) - commands.made(now - dt - self._lags)) / dt
        off = means / self._scale - dq
        kept = np.exp(-dt / settings.DELAY_MEMORY)
        self._errors *= kept
        self._errors += dt * np.einsum('ij,ij->i', off, off)
        self._energy = kept * self._energy + dt * float(dq @ dq)
        self._time = kept * self._time + dt
        best = int(self._errors.argmin())
        if (self._time < settings.DELAY_MOTION
                or self._errors[best] > settings.DELAY_CLEAR * self._energy):
            return
        self.delay = float(self._lags[best])
        if 0 < best < len(self._lags) - 1:
            before, at, after = self._errors[best - 1:best + 2]
            bend = before - 2.0 * at + after
            if bend > 0.0:
                self.delay += settings.DELAY_STEP * 0.5 * float((before - after) / bend)


def damping_share(delay: float, full: float) -> float:
    """Give the part of the damper's gain that a delay allows: delay, full [s]."""
    ratio = delay / full
    if ratio <= 1.0:
        return 1.0
    faded = (settings.DELAY_GONE - ratio) / (settings.DELAY_GONE - settings.DELAY_FADES)
    return ratio**-settings.DELAY_SLOPE * min(max(faded, 0.0), 1.0)


def position_gain_limit(delay: float) -> float:
    """Give the largest position gain [1/s] for a delay of the loop, drives included [s]."""
    return settings.DELAY_PHASE / max(delay, 1e-3)


class RingingWatch:
    """Judges what the position loop and the damper add to the reference."""

    # While the reference rests, what they add must decay: an oscillation that keeps its size, or
    # grows, is fed by them. Whether it rests or not, commands beyond the speed limit again and
    # again, or far from the reference, are no damping either.

    def __init__(self, speed: FloatArray) -> None:
        self._scale = np.where(np.isfinite(speed), speed, 1.0)  # speed: that joints may have
        self._peaks: deque[float] = deque(maxlen=settings.RINGING_LASTS + 2)
        self.reset()

    def reset(self) -> None:
        """Forget what was seen."""
        self._peaks.clear()
        self._rest = self._elapsed = self._peak = self._wild = 0.0
        self._wild_windows = 0

    def step(self, dt: float, added: FloatArray, moving: bool, cut: bool) -> str:
        """Judge what was added in one command, (joints,); empty for nothing."""
        self._rest = 0.0 if moving else self._rest + dt
        self._elapsed += dt
        size = float((np.abs(added) / self._scale).max(initial=0.0))
        self._wild += dt if cut or size > settings.WILD_COMMAND else 0.0
        self._peak = max(self._peak, size)
        if self._elapsed < settings.RINGING_WINDOW:
            return ''
        share, peak = self._wild / self._elapsed, self._peak
        self._elapsed = self._peak = self._wild = 0.0
        self._wild_windows = self._wild_windows + 1 if share > settings.WILD_SHARE else 0
        if self._rest < settings.RINGING_SETTLING:
            self._peaks.clear()
        else:
            self._peaks.append(peak)
        if self._wild_windows >= settings.WILD_WINDOWS:
            self.reset()
            return 'commands are often at the speed limit, or far from the reference speed'
        peaks = list(self._peaks)
        grown = [now > settings.RINGING_GROWTH * before
                 for before, now in zip(peaks, peaks[1:], strict=False)]
        # all four are loud: a push, or its end, in the middle of a window grows into the next
        if len(grown) > 2 and min(peaks[-4:]) > settings.RINGING_LOUD and all(grown[-3:]):
            self.reset()
            return 'an oscillation grows while the reference is at rest'
        if len(peaks) == settings.RINGING_LASTS + 2 and all(
                now > settings.RINGING_LOUD and now > settings.RINGING_DECAY * before
                for before, now in zip(peaks[:-2], peaks[2:], strict=True)):
            self.reset()
            return 'an oscillation does not decay while the reference is at rest'
        return ''


def learned_period(period: float, dt: float) -> float:
    """Learn the time between samples [s]; long ones lack some, so short ones count more."""
    share = period if dt > period else min(settings.PERIOD_QUICK * period, 1.0)
    return period + share * (min(dt, 2.0 * period) - period)


class LoopGains:
    """Gains of damper and position loop in use, by what was measured of the loop."""

    def __init__(self, spec: DamperSpec, speed: FloatArray, share: float = 1.0) -> None:
        self.described = self._basis = spec.position_gain
        self.asked = 0.0  # speed per position error, 0 for that of description or schedule [1/s]
        self.described_delay = self.full_delay = spec.full_delay  # [s]
        self.share = self.weight = share
        self.delay = DelayMeter(speed)
        self.adapts = True
        self.excited = ''  # why the damper is off; empty if it is not
        self.period = self._clock = 0.0  # between samples, and by their stamps [s]
        self.late = 0.0  # by which samples come later than usual [s]
        self._ringing = RingingWatch(speed)
        self._lag = velocity_lag(spec)
        self._shortest = settings.DELAY_LONGEST
        self._longest = settings.CAREFUL_DELAY + self._lag

    def reset(self) -> None:
        """Try the damper again."""
        self.excited = ''
        self.begin()

    def begin(self, speed: FloatArray | None = None) -> None:
        """Take the next sample for a first one, of an arm at a known speed [rad/s]."""
        self._ringing.reset()
        self.delay.commands.count = 0
        if speed is not None:
            self.delay.commands.add(self._clock - settings.DELAY_LONGEST, speed)

    @property
    def position_gain(self) -> float:
        """Speed per position error that is asked for [1/s]."""
        return self.asked if self.asked > 0.0 else self._basis

    def adapt(self, position_gain: float, full_delay: float, weight: float) -> None:
        """Take scheduled values in use: position_gain [1/s], full_delay [s]."""
        self._basis = self.described + weight * (position_gain - self.described)
        self.full_delay = self.described_delay + weight * (full_delay - self.described_delay)

    @property
    def assumed_delay(self) -> float:
        """Delay of the loop, assumed where it was not measured yet [s]."""
        delay = self.delay.delay
        return settings.UNKNOWN_DELAY if delay is None else delay

    @property
    def allowed_share(self) -> float:
        """Part of what is asked for that the loop allows, 0 to 1."""
        if not self.adapts:
            return 1.0
        if self.excited:
            return 0.0
        delay = self.delay.delay
        return 1.0 if delay is None else damping_share(delay + self.late, self.full_delay)

    @property
    def response_time(self) -> float:
        """Longest time from a command to the motion [s]."""
        delay = self.delay.delay
        return (settings.CAREFUL_DELAY if delay is None else delay) + self._lag + self.period

    @property
    def lags(self) -> tuple[float, float]:
        """Shortest and longest time from a command to its motion, by what is known [s]."""
        return max(self._shortest - settings.LAG_MARGIN, 0.0), self._longest

    @property
    def position_gain_in_use(self) -> float:
        """Speed per position error that the loop allows [1/s]."""
        gain = self.described if self.excited else self.position_gain
        return min(gain, position_gain_limit(
            self.assumed_delay + self._lag + self.period + self.late))

    def sampled(self, dt: float) -> tuple[float, float]:
        """Take a sample: give the clock, and the delay of the loop [s]."""
        self.period = learned_period(self.period, dt)
        self._clock += dt  # stamps alone: a simulated arm may be slower than this machine
        delay = self.delay.delay
        if delay is None:
            self._shortest, self._longest = 0.0, self.response_time
        else:  # loads, and what lies, make it longer than it is
            self._shortest = min(self._shortest or delay, delay)
            self._longest = min(delay + settings.LAG_MARGIN,
                                self._longest + settings.LAG_RISE * dt)
        return self._clock, self.assumed_delay

    def step(self, dt: float, dq: FloatArray) -> tuple[float, float]:
        """Measure the delay; give the damper's share and the position gain [1/s] in force."""
        self.delay.add_motion(self._clock, dt, dq)
        change = dt / settings.SHARE_RAMP_TIME
        share = min(self.share, settings.LARGEST_SHARE) * self.allowed_share
        self.weight += min(max(share - self.weight, -change), change)
        return self.weight, self.position_gain_in_use

    def took(self, waited: float, command: FloatArray) -> None:
        """Take a command [rad/s] that was given a time after the last sample [s]."""
        self.delay.commands.add(self._clock + self.late + waited, command)

    def commanded(
        self, dt: float, command: FloatArray, added: FloatArray, moving: bool, cut: bool,
    ) -> float:
        """Judge what was added, see `RingingWatch`; give the longest time to the motion [s]."""
        self.excited = self._ringing.step(dt, added, moving, cut) or self.excited
        self.delay.commands.add(self._clock + self.late, command)
        return self.response_time
