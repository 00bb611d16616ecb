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
Self-test of the damper's sign, for a user of real hardware.

A gauge that was glued or wired the other way round turns the damper into an exciter. The test
makes a small step of one joint without the damper and again with a share of its gain, a small one
first: with the right sign the link must come to rest sooner. The arm is reached through one
function that the caller gives, so that the same test runs on hardware and in simulation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import butter, sosfiltfilt

from tudor_dynamics.errors import SignalError
from tudor_dynamics.typing import FloatArray

STEP = math.radians(3.0)
"""Step that the test asks for [rad]."""
SHARES = (0.25, 0.5, 1.0)
"""Parts of the damper's gain; the next one where the last told nothing."""
CLEAR = 0.9
"""With the right sign the decay lasts at most this part of the time without the damper."""
HIGH_PASS = 0.7
"""Slow motion of the joint does not count as ringing [Hz]."""


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
    # Mean time of the ringing's energy without the damper and with it [s].
    without: float
    damped: float
    text: str  # one sentence for the user


Measure = Callable[[str, float, float], StepResponse]
"""Takes joint, step [rad] and share of the damper's gain; makes the step, returns the strain."""


def ringing(response: StepResponse) -> FloatArray:
    """Take slow motion out of a response."""
    if len(response.strain) * response.dt < 2.0:
        msg = (f'a response of {len(response.strain) * response.dt:g} s is too short to see a '
               'decay; record 3 s or more')
        raise SignalError(msg)
    sos = butter(2, HIGH_PASS * 2.0 * response.dt, 'highpass', output='sos')
    values = response.strain - response.strain[-len(response.strain) // 4:].mean()
    return np.asarray(sosfiltfilt(sos, values), dtype=float)


def decay_time(response: StepResponse, noise: float = 0.0) -> float:
    """
    Give the mean time of the energy of the ringing: short for a quick decay.

    Returns [s].
    """
    energy = ringing(response) ** 2 - noise
    t = np.arange(energy.size) * response.dt
    total = float(energy.sum())
    return float((t * energy).sum() / total) if total > 0.0 else float(t[-1])


def grows(strain: ArrayLike, dt: float, *, factor: float = 1.5) -> bool:
    """
    Say whether a running response grows: the reason to stop a test at once.

    strain (samples,), dt [s]; returns False as long as less than a second has been seen.
    """
    values = np.asarray(strain, dtype=float)
    half = int(round(0.5 / dt))
    if values.size < 2 * half:
        return False
    return bool(np.ptp(values[-half:]) > factor * np.ptp(values[:half]))


def check_sign(
    joint: str, measure: Measure, *, step: float = STEP, shares: Sequence[float] = SHARES,
    rest: StepResponse | None = None,
) -> SignResult:
    """Test the sign of one joint's damper: step [rad]."""
    if not shares:
        msg = 'no share of the gain to test with; give at least one'
        raise SignalError(msg)
    noise = float(np.var(ringing(rest))) if rest is not None else 0.0
    plain = measure(joint, step, 0.0)
    peak = float(np.abs(ringing(plain)).max())
    if peak == 0.0 or peak < 5.0 * math.sqrt(noise):
        text = 'the link hardly rang; take a larger step, or one that ends sooner'
        return SignResult(joint, Sign.UNCLEAR, 0.0, 0.0, f'{joint}: {text}')
    for share in shares:
        result = _compare(joint, plain, measure(joint, -step, share), noise)
        if result.sign is not Sign.UNCLEAR:
            break
    return result


def _compare(
    joint: str, plain: StepResponse, damped: StepResponse, noise: float,
) -> SignResult:
    # the arm may have rung when its rest was recorded: what is left at the end is noise at most
    end = ringing(damped)[-len(damped.strain) // 4:]
    before = decay_time(plain, noise)
    after = decay_time(damped, min(noise, float(np.mean(end ** 2))))
    louder = (np.sqrt(np.mean(ringing(damped)[-len(damped.strain) // 3:] ** 2))
              > 1.2 * np.sqrt(np.mean(ringing(plain)[-len(plain.strain) // 3:] ** 2)))
    change = f'the ringing lasts {after:.2f} s instead of {before:.2f} s'
    if louder or after * CLEAR >= before:
        sign, text = Sign.WRONG, (
            f'{change}: the damper excites the link; turn the sign of the gauge (strain counts '
            'positive for the load that the joint holds), and leave the damper off before')
    elif after <= CLEAR * before:
        sign, text = Sign.RIGHT, f'{change}: the sign is right'
    else:
        sign, text = Sign.UNCLEAR, f'{change}: too little to tell; take a larger gain'
    return SignResult(joint, sign, before, after, f'{joint}: {text}')
