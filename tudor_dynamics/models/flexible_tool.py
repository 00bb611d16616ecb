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

"""A flexible tool at the flange: what drives it, how it rings, what it shows in efforts."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any, Literal

import numpy as np
import pinocchio as pin
from pydantic import Field

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import Finite, Positive
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.base import BundlePart
from tudor_dynamics.models.settings import (
    RING_AFTER, TOOL_CUTOFF, TOOL_DRAWS, TOOL_MEMORY, TOOL_STEP)
from tudor_dynamics.signals.filters import MotionState, zero_phase
from tudor_dynamics.signals.motion_profile import spline
from tudor_dynamics.typing import FloatArray

# One mode eta at the flange, the frame of the last joint, with its acceleration a and gravity g:
#     eta'' + 2 zeta w eta' + w^2 eta = -p . (a - g),   w^2 = w0^2 + gravity . g
# By reciprocity efforts have J' p eta''; p is the participation.

LIKELY = 1.96  # standard deviations of an interval of 95 %


@dataclass(frozen=True, eq=False)
class Flange:
    """Motion of the flange in its own frame."""

    t: FloatArray  # (samples,) [s]
    acceleration: FloatArray  # linear, angular, (samples, 6) [m/s^2, rad/s^2]
    twist: FloatArray  # velocity, linear, angular, (samples, 6) [m/s, rad/s]
    gravity: FloatArray  # (samples, 3) [m/s^2]
    jacobian: FloatArray  # at the end, (6, joints)


@dataclass(frozen=True)
class Estimate:
    """A value with the ends of its interval of 95 %."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        """Write the value, and its interval in brackets."""
        return f'{self.value:.3g} ({self.low:.2g}-{self.high:.2g})'


@dataclass(frozen=True, eq=False)
class Oscillation:
    """A ring, as it is predicted."""

    frequency: Estimate  # [Hz]
    amplitude: FloatArray  # in the efforts of all joints, (joints,) [N m or N]
    loudest: int  # joint of the largest amplitude
    torque: Estimate  # amplitude there [N m or N]
    mode: Estimate  # amplitude of the mode [m kg^0.5]


def flange_motion(arm: Arm, t: FloatArray, motion: MotionState) -> Flange:
    """Follow the flange along a motion of the joints: t (samples,) [s]."""
    model, data, last = arm.model, arm.model.createData(), arm.model.njoints - 1
    local = pin.ReferenceFrame.LOCAL
    states = np.zeros((len(t), 3, model.nv))
    for order, values in enumerate((motion.q, motion.dq, motion.ddq)):
        states[:, order, arm.velocity_index] = values
    acceleration, twist, gravity = (np.empty((len(t), size)) for size in (6, 6, 3))
    for k, state in enumerate(states):
        pin.forwardKinematics(model, data, *state)
        acceleration[k] = pin.getClassicalAcceleration(model, data, last, local).vector
        twist[k] = pin.getVelocity(model, data, last, local).vector
        gravity[k] = data.oMi[last].rotation.T @ model.gravity.linear
    pin.computeJointJacobians(model, data, states[-1, 0])
    jacobian = pin.getJointJacobian(model, data, last, local)
    return Flange(t, acceleration, twist, gravity, jacobian[:, arm.velocity_index])


def angular_frequency(squares: FloatArray, gravity: FloatArray) -> FloatArray:
    """Give the frequency [rad/s] where gravity (..., 3) has a direction in the flange."""
    return np.asarray(2.0 * math.pi * np.sqrt(np.maximum(
        squares[0] + gravity @ squares[1:], 1e-6)))


def free_ring(flange: Flange, squares: FloatArray, damping: float) -> Any:
    """Give eta'' at the end of a motion, complex, by each part of the drive (6,)."""
    # the solution of slow changes, as in signals/shaping.py; before the motion the tool hangs
    w = angular_frequency(squares, flange.gravity)
    pole = w * complex(-damping, math.sqrt(1.0 - damping**2))
    step = np.diff(flange.t)
    left = np.append(np.cumsum((0.5 * step * (pole[1:] + pole[:-1]))[::-1])[::-1], 0.0)
    drive = flange.acceleration.copy()
    drive[:, :3] -= flange.gravity - flange.gravity[-1]
    kernel = (np.exp(left) / np.sqrt(pole.imag * pole.imag[-1]))[:, None] * drive
    summed = 0.5 * step @ (kernel[1:] + kernel[:-1]) - kernel[0] / pole[0]
    return 1j * pole[-1] ** 2 * summed


class FlexibleTool(BundlePart):
    """
    One mode of what an arm carries at its flange.

    Source: modal reduction of a structure on a moving base; see docs/explanation/shaping.md.
    """

    motion: Literal['planned', 'measured']  # that it was fitted to
    rings: int = Field(ge=1, le=10**9)  # that it was fitted to
    # Squared frequency without gravity [Hz^2]; what gravity in the flange adds [Hz^2 per m/s^2].
    squares: list[Finite] = Field(min_length=4, max_length=4)
    squares_covariance: list[list[Finite]]
    damping: float = Field(ge=0.0, lt=1.0)  # damping ratio
    damping_error: float = Field(ge=0.0, lt=1.0)
    # What drives it, and what it shows in efforts, linear and angular [kg^0.5, m kg^0.5].
    participation: list[Finite] = Field(min_length=6, max_length=6)
    participation_covariance: list[list[Finite]]
    quiet: Positive  # ring that was not heard in the rests [N m or N]
    scatter: Positive  # error of a predicted ring, relative to it
    hidden: list[Literal['translation', 'rotation']]  # what the moves do not show

    def model_post_init(self, _: Any) -> None:
        """Refuse what is no covariance, and no frequency."""
        for name, size in (('squares', 4), ('participation', 6)):
            rows = getattr(self, f'{name}_covariance')
            values = np.array(rows if {len(row) for row in rows} == {size} else [])
            if values.shape != (size, size) or not (
                    np.linalg.eigvalsh(values).min() >= -1e-6 * np.abs(values).max()):
                raise ModelError(f'{name}_covariance: expected a covariance of {size} values')
        if not self.squares[0] > 0.0:
            raise ModelError('squares begin with no square of a frequency')

    def frequency(self, gravity: FloatArray) -> Estimate:
        """Give the frequency [Hz] where gravity (3,) [m/s^2] has a direction in the flange."""
        row = np.concatenate([[1.0], gravity])
        square, off = row @ self.squares, math.sqrt(row @ self.squares_covariance @ row)
        return Estimate(*(math.sqrt(max(float(square + k * off), 1e-6))
                          for k in (0.0, -LIKELY, LIKELY)))

    def frequency_at(self, arm: Arm, q: FloatArray) -> Estimate:
        """Give the frequency [Hz] where the joints stand: q (joints,) [rad or m]."""
        still = np.zeros((1, len(q)))
        return self.frequency(flange_motion(
            arm, np.zeros(1), MotionState(q[None], still, still)).gravity[0])

    def ring_after(self, arm: Arm, trajectory: Trajectory) -> Oscillation:
        """Predict the ring after a trajectory, when modes of the arm itself have decayed."""
        begin, end = float(trajectory.t[0]), float(trajectory.t[-1])
        t = np.arange(max(begin - 0.5, end - TOOL_MEMORY), end + RING_AFTER,
                      TOOL_STEP)
        q = (np.asarray(spline(trajectory)(np.clip(t, begin, end))) if end > begin
             else np.tile(trajectory.q, (len(t), 1)))
        return self.ring(flange_motion(arm, t, zero_phase(t, q, TOOL_CUTOFF)))

    def ring(self, flange: Flange) -> Oscillation:
        """Predict the ring at the end of a motion that begins at rest and ends at one."""
        frequency = self.frequency(flange.gravity[-1])
        off = frequency.value * (frequency.high - frequency.low) / LIKELY
        early, free, late = (free_ring(flange, np.array(self.squares) + [off * k, 0.0, 0.0, 0.0],
                                       self.damping) for k in (-1.0, 0.0, 1.0))
        random = np.random.default_rng(0)
        drawn = random.multivariate_normal(self.participation, self.participation_covariance,
                                           TOOL_DRAWS, method='eigh')
        noise = random.normal(size=(3, len(drawn)))
        changed = free + noise[0, :, None] * 0.5 * (late - early)
        modes = np.abs((drawn * changed).sum(axis=1) * (
            1.0 + self.scatter * math.sqrt(0.5) * (noise[1] + 1j * noise[2])))
        mode = float(abs(self.participation @ free))
        amplitude = np.abs(self.participation @ flange.jacobian) * mode
        loudest = int(np.argmax(amplitude))
        shown = modes * np.abs(drawn @ flange.jacobian[:, loudest])
        square = (2.0 * math.pi * frequency.value) ** 2
        return Oscillation(frequency, amplitude, loudest, *(
            Estimate(value, min(value, float(np.quantile(values, 0.025))),
                     max(value, float(np.quantile(values, 0.975))))
            for value, values in ((float(amplitude[loudest]), shown),
                                  (mode / square, modes / square))))

    def __str__(self) -> str:
        """Write the mode, and what the moves did not show."""
        hidden = f'; these moves do not show {" or ".join(self.hidden)}' if self.hidden else ''
        return (f'rings at {math.sqrt(self.squares[0]):.3g} Hz without gravity, damping ratio '
                f'{self.damping:.2g}, by {self.rings} rests after {self.motion} motion{hidden}')
