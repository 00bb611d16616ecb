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

"""Damper: a joint yields in proportion to the mean-free strain of its link; test of its sign."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, IntEnum
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.compiled import compiled
from tudor_dynamics.control import settings
from tudor_dynamics.errors import ArmError, SignalError
from tudor_dynamics.typing import FloatArray


# -- One step of the damper of one joint, compiled: for hardware and for simulation alike

# Columns of the settings of one joint.
GAIN = 0  # speed per strain, with its sign [rad/s per unit of the gauge]
CORNER = 1  # angular corner frequency of the DC blocker [rad/s]
WINDOW = 2  # samples of the moving average, 0 for the DC blocker
SPEED_LIMIT = 3  # [rad/s]
DEAD_TIME = 4  # without any change of the reading [s]
STALE_TIME = 5  # without any reading [s]
MAX_RATE = 6  # fastest plausible change [unit/s]
MAX_STRAIN = 7  # largest plausible reading [unit]
FADE_TIME = 8  # [s]
RECOVERY = 9  # the gauge must be well for so long [s]
MOVING_CORNER = 10  # takes the place of CORNER while the reference moves [rad/s]
SETTINGS = 11
# Columns of the state of one joint.
MEAN, LAST, UNCHANGED, AGE, WELL, WEIGHT, GOOD, STATUS, SUM, COUNT, HEAD, SEEN = range(12)
STATES = 12


@compiled
def moving_share(dq_ref: NDArray, planned: NDArray) -> float:
    """Give how much a reference moves, from 0 at rest to 1: speeds (joints,) [rad/s]."""
    most = 0.0
    for j in range(dq_ref.shape[0]):
        most = max(most, min(abs(dq_ref[j]) / (settings.MOVING_REFERENCE * planned[j]), 1.0))
    return most


@compiled
def damper_law(
    row: NDArray, state: NDArray, past: NDArray, dt: float, strain: float, fresh: bool,
    saturated: bool, moving: float,
) -> float:
    """Give the yielding speed of one joint; past (window,): readings of the moving average."""
    state[AGE] += dt
    state[UNCHANGED] += dt
    fault = 0
    if fresh:
        if not math.isfinite(strain):
            fault = 3
        elif abs(strain) > row[MAX_STRAIN] or (
                state[SEEN] > 0.0
                and abs(strain - state[LAST]) > row[MAX_RATE] * state[AGE]):
            fault = 6
        if fault != 3:
            if strain != state[LAST] or state[SEEN] == 0.0:
                state[UNCHANGED] = 0.0
            state[LAST], state[SEEN] = strain, 1.0
    elif state[AGE] > row[STALE_TIME]:
        fault = 4
    elif state[SEEN] == 0.0:
        fault = 3
    elif state[STATUS] >= 3.0:
        fault = int(state[STATUS])
    if fault == 0 and state[UNCHANGED] > row[DEAD_TIME]:
        fault = 5
    if fault > 0:
        state[WELL] = 0.0
        state[COUNT], state[SUM], state[HEAD] = 0.0, 0.0, 0.0
        if fresh:
            state[AGE] = 0.0
    elif fresh:
        if state[WELL] == 0.0:
            state[MEAN] = strain
        # Soon after the start the mean is that of what was seen, later that of the DC blocker.
        corner = row[CORNER] + moving * (row[MOVING_CORNER] - row[CORNER])
        share = 1.0 - math.exp(-corner * state[AGE])
        state[WELL] += state[AGE]
        if state[WELL] < row[RECOVERY]:
            share = max(share, state[AGE] / state[WELL])
        window = int(row[WINDOW])
        if window == 0:
            state[MEAN] += share * (strain - state[MEAN])
        else:
            head = int(state[HEAD])
            if state[COUNT] >= window:
                state[SUM] -= past[head]
            else:
                state[COUNT] += 1.0
            past[head] = strain
            state[SUM] += strain
            state[HEAD] = (head + 1) % window
            state[MEAN] = state[SUM] / state[COUNT]
        state[GOOD] = strain - state[MEAN]
        state[AGE] = 0.0
    if fault > 0:
        status = fault
    elif state[WELL] < row[RECOVERY]:
        status = 1
    else:
        status = 2 if saturated else 0
    state[STATUS] = status
    change = dt / row[FADE_TIME]
    if status == 0:
        state[WEIGHT] = min(state[WEIGHT] + change, 1.0)
    else:
        state[WEIGHT] = max(state[WEIGHT] - change, 0.0)
    # A reading that stands still is trusted less and less before the gauge counts as dead.
    trust = min(max(2.0 - 2.0 * state[UNCHANGED] / row[DEAD_TIME], 0.0), 1.0)
    speed = state[WEIGHT] * trust * row[GAIN] * state[GOOD]
    limit = row[SPEED_LIMIT]
    return min(max(speed, -limit), limit)


# -- Damper: a joint yields with a speed proportional to the mean-free strain of its link.
#
# The law of Malzahn, Reinhart and Bertram, a linear feedback of mean-free strain per joint,
# without any model. Strain counts positive for the load that the joint holds, so the joint yields
# with the opposite sign: the hub follows the tip. The mean has to go because the load of gravity
# would move the joint away from its reference.
#
# A gauge whose signal is missing, stale, stuck or implausible is faded out: its last good share
# goes to zero within the fade time, and comes back only after the gauge was well for a while.

class Status(IntEnum):
    """What the damper of one joint does, and why it does not damp."""

    DAMPING = 0
    STARTING = 1
    SATURATED = 2
    MISSING = 3
    STALE = 4
    STUCK = 5
    IMPLAUSIBLE = 6


MEANING = {
    Status.DAMPING: 'damps',
    Status.STARTING: f'damping is off until the strain is valid for {settings.RECOVERY_TIME:g} s',
    Status.SATURATED: 'damping is off while the joint is at a limit of current, speed or position',
    Status.MISSING: 'damping is off while strain is absent or not finite; check gauge and driver',
    Status.STALE: 'damping is off while no new strain arrives; check the driver of the gauge',
    Status.STUCK: 'damping is off while the strain does not change; check gauge and amplifier',
    Status.IMPLAUSIBLE: 'damping is off until '
    f'{settings.RECOVERY_TIME:g} s after the strain jumped, or was beyond '
    f'{1e6 * settings.PLAUSIBLE_STRAIN:g} um/m; check the cable of the gauge',
}


@dataclass(frozen=True)
class DamperSettings:
    """Settings of the damper of one joint; strains in the unit of the gauge."""

    # Names of joint and gauge.
    joint: str
    gauge: str
    # Yielding speed per mean-free strain; negative where strain counts positive for the load that
    # the joint holds [rad/s per unit].
    gain: float
    mean_frequency: float = 0.1  # corner of the DC blocker [Hz]
    mean_window: float = 0.0  # length of the moving average that takes its place, 0 for none [s]
    speed_limit: float = math.inf  # bound of the yielding speed [rad/s]
    # Fastest plausible change [unit/s] and largest plausible reading [unit].
    max_rate: float = math.inf
    max_strain: float = math.inf
    # Corner of the DC blocker while the reference moves; the same by default [Hz].
    moving_frequency: float | None = None
    scale: float = 1.0  # unit of the gauge per m/m

    def row(self, dt: float) -> FloatArray:
        """Give the settings in the order of the columns, for a step [s]."""
        return np.array([
            self.gain, 2.0 * math.pi * self.mean_frequency, np.rint(self.mean_window / dt),
            self.speed_limit, max(settings.DEAD_GAUGE_TIME, 5.0 * dt),
            max(settings.STALE_GAUGE_TIME, 3.0 * dt), self.max_rate, self.max_strain,
            settings.FADE_TIME, settings.RECOVERY_TIME,
            2.0 * math.pi * (self.moving_frequency or self.mean_frequency)])


STRAIN_SCALE = {'um/m': 1e6, 'm/m': 1.0}


def arm_damping(arm: Arm, *, share: float = 1.0) -> list[DamperSettings]:
    """Take the settings of the dampers of active joints from an arm description."""
    damper = arm.damper
    gauges = {gauge.name: gauge for gauge in arm.gauges}
    limits = {joint.name: joint.limits for joint in arm.spec.joints}
    result = []
    for item in damper.joints:
        unit = gauges[item.gauge].unit
        if unit not in STRAIN_SCALE:
            raise ArmError(f'{arm.source}: the damper needs um/m or m/m as unit of a gauge, but '
                           f'that of {item.gauge!r} is {unit}; correct gauges[].unit')
        scale, limit = STRAIN_SCALE[unit], limits[item.joint]
        result.append(DamperSettings(
            item.joint, item.gauge, -share * item.gain / scale, damper.mean_frequency,
            damper.mean_window or 0.0,
            (limit.velocity if limit else None) or math.inf,
            max_rate=settings.PLAUSIBLE_RATE * scale,
            max_strain=settings.PLAUSIBLE_STRAIN * scale,
            moving_frequency=damper.moving_frequency, scale=scale))
    return [item for item in result if item.joint in arm.active_joints]


class Damper:
    """Damper of several joints, step by step: dt [s]."""

    def __init__(self, joints: list[DamperSettings], dt: float) -> None:
        self.joints = tuple(item.joint for item in joints)
        self.gauges = tuple(item.gauge for item in joints)
        self.rows = np.array([item.row(dt) for item in joints]).reshape(-1, SETTINGS)
        self._fixed = self.rows.copy()
        self._scale = np.array([item.scale for item in joints])
        window = int(self.rows[:, WINDOW].max(initial=1.0))
        self.past = np.zeros((len(joints), max(window, 1)))
        self.state = np.zeros((len(joints), STATES))
        self.dt = dt
        self.reset()

    def reset(self) -> None:
        """Forget mean and faults; the damper fades in after the recovery time."""
        self.state[:] = 0.0
        self.state[:, STATUS] = float(Status.STARTING)

    def adapt(
        self, gain: FloatArray, mean_frequency: float, weight: float, shift: FloatArray,
    ) -> None:
        """Take scheduled gains [rad/s per m/m] in use, and shift the means along with the load."""
        wanted = np.full((len(gain), 3), 2.0 * math.pi * mean_frequency)
        wanted[:, 0] = -gain / self._scale
        columns = [GAIN, CORNER, MOVING_CORNER]
        fixed = self._fixed[:, columns]
        self.rows[:, columns] = fixed + weight * (wanted - fixed)
        self.state[:, MEAN] += shift

    def release(self) -> None:
        """Take the gains of the settings in use."""
        self.rows[:] = self._fixed

    @property
    def status(self) -> tuple[Status, ...]:
        """Say what each joint's damper does."""
        return tuple(Status(int(value)) for value in self.state[:, STATUS])

    def report(self) -> list[str]:
        """Say in one sentence a joint what its damper does."""
        return [f'{joint} ({gauge}): {MEANING[status]}' for joint, gauge, status
                in zip(self.joints, self.gauges, self.status, strict=True)]

    def step(
        self, strain: ArrayLike, fresh: ArrayLike = True, saturated: ArrayLike = False,
        moving: float = 0.0,
    ) -> FloatArray:
        """Give the yielding speeds (joints,) for one step; fresh, saturated (joints,)."""
        count = len(self.joints)
        values, new, limited = (
            x if x.shape == (count,) else np.broadcast_to(x, count)  # which takes 5 us
            for x in map(np.asarray, (strain, fresh, saturated)))
        return np.array([
            damper_law(self.rows[j], self.state[j], self.past[j], self.dt, float(values[j]),
                       bool(new[j]), bool(limited[j]), moving) for j in range(count)])


# -- Self-test of the damper's sign, for a user of real hardware.
#
# A gauge that was glued or wired the other way round turns the damper into an exciter. The test
# makes a small step of one joint without the damper and again with a share of its gain, a small
# one first: with the right sign the link must come to rest sooner. The arm is reached through one
# function that the caller gives, so that the same test runs on hardware and in simulation.

@dataclass(frozen=True, eq=False)
class StepResponse:
    """Strain after a small step."""

    dt: float  # sample time [s]
    strain: FloatArray  # from the end of the step on, 3 s or more, (samples,)


class Sign(Enum):
    """Outcome of the test."""

    RIGHT = 'right'
    WRONG = 'wrong'
    UNCLEAR = 'unclear'


@dataclass(frozen=True)
class SignResult:
    """Result for one joint."""

    joint: str  # name of the joint
    sign: Sign  # outcome of the test
    text: str  # one sentence for the user


Measure = Callable[[str, float, float], StepResponse]
"""Takes joint, step [rad] and share of the damper's gain; makes the step, returns the strain."""


def ringing(response: StepResponse) -> FloatArray:
    """Take slow motion out of a response."""
    if len(response.strain) * response.dt < settings.SHORTEST_DECAY:
        raise SignalError(f'strain came for {len(response.strain) * response.dt:g} s, but is '
                          f"needed for {settings.SHORTEST_DECAY:g} s; check the gauge's driver")
    from scipy.signal import butter, sosfiltfilt  # slow to import

    sos = butter(2, settings.SIGN_HIGH_PASS * 2.0 * response.dt, 'highpass', output='sos')
    values = response.strain - response.strain[-len(response.strain) // 4:].mean()
    return np.asarray(sosfiltfilt(sos, values), dtype=float)


def decay_time(response: StepResponse, noise: float = 0.0) -> float:
    """Give the mean time of the energy of the ringing [s]: short for a quick decay."""
    energy = ringing(response) ** 2 - noise
    t = np.arange(energy.size) * response.dt
    total = float(energy.sum())
    return float((t * energy).sum() / total) if total > 0.0 else float(t[-1])


def grows(strain: ArrayLike, dt: float) -> bool:
    """Say whether a running response grows, so that a test has to stop; not before a second."""
    values = np.asarray(strain, dtype=float)
    half = int(round(0.5 / dt))
    if values.size < 2 * half:
        return False
    return bool(np.ptp(values[-half:]) > settings.SIGN_GROWTH * np.ptp(values[:half]))


def check_sign(
    joint: str, measure: Measure, *, step: float = settings.SIGN_STEP,
    rest: StepResponse | None = None,
) -> SignResult:
    """Test the sign of one joint's damper: step [rad]."""
    noise = float(np.var(ringing(rest))) if rest is not None else 0.0
    plain = measure(joint, step, 0.0)
    peak = float(np.abs(ringing(plain)).max())
    if peak == 0.0 or peak < 5.0 * math.sqrt(noise):
        text = 'the link hardly rang after the step; test again with a larger step'
        return SignResult(joint, Sign.UNCLEAR, f'{joint}: {text}')
    for share in settings.SIGN_SHARES:
        result = _compare(joint, plain, measure(joint, -step, share), noise)
        if result.sign is not Sign.UNCLEAR:
            break
    return result


def _compare(joint: str, plain: StepResponse, damped: StepResponse, noise: float) -> SignResult:
    # the arm may have rung when its rest was recorded: what is left at the end is noise at most
    end = ringing(damped)[-len(damped.strain) // 4:]
    before = decay_time(plain, noise)
    after = decay_time(damped, min(noise, float(np.mean(end ** 2))))
    louder = (np.sqrt(np.mean(ringing(damped)[-len(damped.strain) // 3:] ** 2))
              > 1.2 * np.sqrt(np.mean(ringing(plain)[-len(plain.strain) // 3:] ** 2)))
    change = f'with the damper, ringing lasts {after:.2f} s instead of {before:.2f} s'
    if louder or after * settings.SIGN_DECAY >= before:
        sign, text = Sign.WRONG, (
            f"{change}, so the damper excites the link; reverse the sign in the gauge's driver")
    elif after <= settings.SIGN_DECAY * before:
        sign, text = Sign.RIGHT, f'{change}, so the sign of the gauge is right'
    else:
        sign, text = Sign.UNCLEAR, (f'{change}, too small a change to judge the sign; raise '
                                    'damper.joints[].gain in the arm description')
    return SignResult(joint, sign, f'{joint}: {text}')
