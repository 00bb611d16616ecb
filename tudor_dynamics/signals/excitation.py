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
Excitation of an arm for identification: APRBS and band-limited Fourier series.

APRBS (amplitude-modulated pseudo-random binary signal) as in Isermann and Muenchhof,
Identification of Dynamic Systems (2011): the sections of a binary signal from a shift register get
amplitudes that are spread evenly over the range and shuffled. Fourier series as in Swevers et al.
(IEEE Transactions on Robotics and Automation 13, 1997), scaled into the limits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.limits import planned_limits
from tudor_dynamics.errors import SignalError
from tudor_dynamics.signals import settings
from tudor_dynamics.signals.motion_profile import (
    follow_targets, motion_limits, MotionLimits, Reference)
from tudor_dynamics.typing import FloatArray

TAPS = (7, 6)
"""Feedback of a shift register of 7 bits, whose sequence repeats only after 127 clocks."""


@dataclass(frozen=True, eq=False)
class JointRange:
    """Range of each joint [rad]."""

    lower: FloatArray  # smallest position of each joint, (joints,) [rad]
    upper: FloatArray  # largest position of each joint, (joints,) [rad]


@dataclass(frozen=True, eq=False)
class Targets:
    """Targets of each joint over time."""

    start: FloatArray  # where the joints rest at first, (joints,) [rad]
    # For each joint, when [s] it gets which target [rad].
    times: tuple[FloatArray, ...]
    values: tuple[FloatArray, ...]


def joint_range(arm: Arm) -> JointRange:
    """Take the range of planned motion from an arm description; half a turn where it has none."""
    planned = planned_limits(arm)
    return JointRange(np.where(np.isfinite(planned.lower), planned.lower, -np.pi),
                      np.where(np.isfinite(planned.upper), planned.upper, np.pi))


def binary_sequence(length: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Run a shift register from a random state; returns (length,)."""
    state = [bool(bit) for bit in rng.integers(0, 2, TAPS[0])]
    if not any(state):
        state[0] = True
    result = np.empty(length, dtype=bool)
    first, second = TAPS
    for k in range(length):
        result[k] = state[-1]
        state = [state[first - 1] != state[second - 1], *state[:-1]]
    return result


def aprbs(
    bounds: JointRange, duration: float, seed: int, *, clock: float = 1.0,
) -> Targets:
    """Make an APRBS for each joint: duration, clock [s]."""
    rest = settings.REST
    if not (clock > 0.0 and duration > rest + clock):
        raise SignalError(f'an APRBS of {duration} s with a clock of {clock} s has no target; it '
                          f'needs more than {rest + max(clock, 0.0):g} s and a positive clock')
    joints = len(bounds.lower)
    generators = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(joints)]
    start = np.zeros(joints)
    times: list[FloatArray] = []
    values: list[FloatArray] = []
    for j, rng in enumerate(generators):
        clocks = int((duration - rest) / clock)
        bits = binary_sequence(clocks, rng)
        begins = np.flatnonzero(np.concatenate([[True], bits[1:] != bits[:-1]]))
        count = len(begins) + 1  # one for the rest before
        bins = (np.arange(count) + rng.uniform(0.0, 1.0, count)) / count
        rng.shuffle(bins)
        levels = bounds.lower[j] + bins * (bounds.upper[j] - bounds.lower[j])
        start[j] = levels[0]
        # Joints do not start together: the clock of each has a phase of its own.
        phase = rng.uniform(0.0, 0.5 * clock)
        times.append(np.asarray(rest + phase + begins * clock, dtype=np.float64))
        values.append(levels[1:])
    return Targets(start, tuple(times), tuple(values))


def aprbs_motion(arm: Arm, duration: float, seed: int, dt: float) -> Reference:
    """Plan the motion of an arm through an APRBS within its limits: duration, dt [s]."""
    targets = aprbs(joint_range(arm), duration, seed)
    return follow_targets(targets.start, targets.times, targets.values, motion_limits(arm), dt,
                          int(round(duration / dt)))


def fourier_motion(
    bounds: JointRange, limits: MotionLimits, duration: float, seed: int, dt: float, *,
    base: float = 0.1, harmonics: int = 5,
) -> Reference:
    """Make a random band-limited Fourier series of a base [Hz] that starts and ends at rest."""
    ramp = 1.0 / base
    if harmonics < 1 or duration < 3.0 * ramp:
        raise SignalError(f'a Fourier series of {duration} s with {harmonics} harmonics of {base} '
                          f'Hz: give at least one harmonic and {3.0 * ramp:g} s')
    rng = np.random.default_rng(seed)
    t = np.asarray(np.arange(int(round(duration / dt))) * dt, dtype=np.float64)
    w = 2.0 * np.pi * base * np.arange(1, harmonics + 1)[:, None]
    window = fade(t, duration, ramp)
    q, dq, ddq = (np.zeros((len(t), len(bounds.lower))) for _ in range(3))
    for j in range(len(bounds.lower)):
        a, b = rng.standard_normal((2, harmonics, 1))
        s = (a / w * np.sin(w * t) - b / w * np.cos(w * t)).sum(axis=0)
        ds = (a * np.cos(w * t) + b * np.sin(w * t)).sum(axis=0)
        dds = (-a * w * np.sin(w * t) + b * w * np.cos(w * t)).sum(axis=0)
        parts = (window[0] * s, window[1] * s + window[0] * ds,
                 window[2] * s + 2.0 * window[1] * ds + window[0] * dds)
        half = 0.5 * (bounds.upper[j] - bounds.lower[j])
        scale = min(half / np.abs(parts[0]).max(), limits.velocity[j] / np.abs(parts[1]).max(),
                    limits.acceleration[j] / np.abs(parts[2]).max())
        # Where the range is not used up, the centre may lie anywhere in what is left.
        left = half - scale * np.abs(parts[0]).max()
        centre = 0.5 * (bounds.upper[j] + bounds.lower[j]) + rng.uniform(-left, left)
        q[:, j] = centre + scale * parts[0]
        dq[:, j], ddq[:, j] = scale * parts[1], scale * parts[2]
    return Reference(dt, q, dq, ddq)


def fade(t: FloatArray, duration: float, ramp: float) -> tuple[
        FloatArray, FloatArray, FloatArray]:
    """Fade in and out along a quintic, at rest outside: window, first and second derivative."""
    x = np.clip(np.minimum(t, duration - t) / ramp, 0.0, 1.0)
    sign = np.where(t < 0.5 * duration, 1.0, -1.0) / ramp
    return (x**3 * (10.0 - 15.0 * x + 6.0 * x * x), sign * 30.0 * x * x * (1.0 - x) ** 2,
            (60.0 * x * (1.0 - x) * (1.0 - 2.0 * x)) / ramp**2)
