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
The loop of damper, position loop, drives and links as a linear system, and its damping.

What is commanded is ``-K_p theta - k (strain - mean)``, late by the delay of the loop (Pade's
approximation of second order); the drive follows by its PI velocity loop against what the links
press on its rotor. The mean follows the strain as the DC blocker does, and the load as the
schedule says.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.control.cascade import INTEGRAL_SHARE
from tudor_dynamics.models.tuning.small_motion import SmallMotion
from tudor_dynamics.typing import FloatArray

LEAST_DELAY = 1e-4
"""Below it the approximation of a delay is as good as none [s]."""
HIGHEST = 40.0
"""Poles above it are those of delays and drives [Hz]."""
SLOW = 0.3
"""Poles below this part of the first frequency belong to means and position loops."""


@dataclass(frozen=True)
class DriveLoop:
    """What stands between a command and the links."""

    bandwidth: float  # of the velocity loop [rad/s]
    delay: float  # from readings to commands in effect [s]
    rotor: tuple[float, ...]  # inertia of each drive; 0 for one that nothing holds up [kg m^2]


@dataclass(frozen=True, eq=False)
class LoopGainsAt:
    """Gains to be judged."""

    strain: FloatArray  # of the dampers, (damped,) [rad/s per m/m]
    position: float  # speed per position error [1/s]
    mean: float  # corner of the DC blocker [rad/s]
    joints: NDArray[np.intp]  # drive that each damper commands, (damped,)


def loop_matrix(small: SmallMotion, drive: DriveLoop, gains: LoopGainsAt) -> FloatArray:
    """Give the matrix of the closed loop; returns (2 m + 5 joints + damped,)."""
    m, n, d = len(small.mass), small.rest.shape[1], len(gains.strain)
    parts = np.cumsum([0, m, m, n, n, n, d, n, n])
    z, dz, th, w, held, mean, old, older = (
        slice(a, b) for a, b in zip(parts[:-1], parts[1:], strict=True))
    a = np.zeros((parts[-1], parts[-1]))
    inverse = np.linalg.inv(small.mass)
    a[z, dz] = np.eye(m)
    a[dz, z], a[dz, dz] = -inverse @ small.stiffness, -inverse @ small.damping
    a[dz, th] = inverse @ small.stiffness @ small.rest
    a[dz, w] = inverse @ small.damping @ small.rest
    a[th, w] = np.eye(n)
    a[w, w] = -drive.bandwidth * np.eye(n)
    a[w, held] = INTEGRAL_SHARE * drive.bandwidth**2 * np.eye(n)
    a[held, w] = -np.eye(n)
    for j, inertia in enumerate(drive.rotor):
        if inertia > 0.0:
            a[parts[3] + j, z] += small.reaction[j, :m] / inertia
            a[parts[3] + j, th] += small.reaction[j, m:] / inertia
    a[mean, z], a[mean, mean] = gains.mean * small.strain, -gains.mean * np.eye(d)
    a[mean, w] = small.slope
    command = np.zeros((n, parts[-1]))
    command[:, th] = -gains.position * np.eye(n)
    for i, (joint, gain) in enumerate(zip(gains.joints, gains.strain, strict=True)):
        command[joint, z] -= gain * small.strain[i]
        command[joint, parts[5] + i] += gain
    late = max(drive.delay, LEAST_DELAY)
    a[old, older] = np.eye(n)
    a[older, old] = -12.0 / late**2 * np.eye(n)
    a[older, older] = -6.0 / late * np.eye(n)
    a[older] += command
    command[:, older] -= 12.0 / late * np.eye(n)
    a[w] += drive.bandwidth * command
    a[held] += command
    return a


@dataclass(frozen=True, eq=False)
class LoopDamping:
    """How a loop swings."""

    # Of the worst damped oscillation of the first mode [Hz]; NaN where nothing swings there.
    frequency: float
    first: float  # its damping ratio, 1 where nothing swings there
    others: float  # least damping ratio of what swings faster, up to 40 Hz
    decay: float  # of what dies out slowest [1/s]; negative where it grows


def loop_damping(matrix: FloatArray, first: float, second: float) -> LoopDamping:
    """Judge a loop by its poles: matrix (n, n), first, second [Hz]."""
    poles = np.linalg.eigvals(matrix)
    size = np.abs(poles) / (2.0 * math.pi)
    swings = poles.imag > 1e-6 * np.abs(poles)
    border = math.sqrt(first * second)
    slow = swings & (size > SLOW * first) & (size <= border)
    fast = swings & (size > border) & (size < HIGHEST)
    ratio = -poles.real / np.maximum(np.abs(poles), 1e-12)
    worst = int(np.argmin(np.where(slow, ratio, np.inf)))
    return LoopDamping(
        float(size[worst]) if slow.any() else math.nan,
        float(ratio[worst]) if slow.any() else 1.0,
        float(ratio[fast].min()) if fast.any() else 1.0,
        float(-poles.real.max()))
