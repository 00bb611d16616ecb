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

"""A flexible tool at the flange: how it is after a motion, how it rings, what efforts show."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
import math
from typing import Annotated, Any, Literal

import numpy as np
import pinocchio as pin
from pydantic import Field
from scipy.linalg import eigh

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import Finite, Positive
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.base import BundlePart
from tudor_dynamics.models.settings import (
    RING_AFTER, RING_BANDWIDTH, RING_MEAN, RING_RENEWED, RING_RIDGE, TOOL_CUTOFF, TOOL_DRAWS,
    TOOL_HIDDEN, TOOL_LEVER, TOOL_MEMORY, TOOL_NUDGE, TOOL_STEP, TOOL_UNSEEN)
from tudor_dynamics.models.tool_motion import accelerate, from_rest, MOTION, PLACES, settled, TOOL
from tudor_dynamics.signals.filters import MotionState, zero_phase
from tudor_dynamics.signals.motion_profile import spline
from tudor_dynamics.typing import FloatArray

Six = Annotated[list[Finite], Field(min_length=6, max_length=6)]
KINDS = {'translation': slice(0, 3), 'rotation': slice(3, 6)}
LIKELY = 1.96  # standard deviations of an interval of 95 %


@dataclass(frozen=True, eq=False)
class Flange:
    """Motion of the flange, the frame of the last joint, in its own frame."""

    t: FloatArray  # (samples,) [s]
    # Acceleration, angular acceleration, rate of rotation, gravity (samples, 12) [m/s^2, rad/s].
    motion: FloatArray
    velocity: FloatArray  # (samples, 3) [m/s]
    jacobian: FloatArray  # at the end, linear and angular, (6, joints)


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

    amplitude: FloatArray  # in the efforts of all joints, (joints,) [N m or N]
    loudest: int  # joint of the largest amplitude
    torque: Estimate  # amplitude there [N m or N]


@dataclass(frozen=True, eq=False)
class ToolModes:
    """Small vibrations about the place where a tool hangs, the slower first."""

    poles: FloatArray  # complex, (modes,) [1/s]
    shapes: FloatArray  # of d in each, (2, modes)
    pulls: FloatArray  # on the flange, force and moment by an acceleration of 1, (modes, 6)
    hangs: FloatArray  # state there, (4,) [m, m/s]

    @cached_property
    def rows(self) -> Any:
        """Give what a state adds to each, complex (modes, 4)."""
        parts = np.linalg.pinv(self.shapes)
        return np.hstack([parts, -1j * parts / self.poles.imag[:, None]])

    def of(self, state: FloatArray) -> Any:
        """Give how far each is out, complex (modes,), in a state (4,)."""
        return self.rows @ (state - self.hangs)


def flange_motion(arm: Arm, t: FloatArray, motion: MotionState) -> Flange:
    """Follow the flange along a motion of the joints: t (samples,) [s]."""
    model, data, last = arm.model, arm.model.createData(), arm.model.njoints - 1
    local = pin.ReferenceFrame.LOCAL
    states = np.zeros((len(t), 3, model.nv))
    for order, values in enumerate((motion.q, motion.dq, motion.ddq)):
        states[:, order, arm.velocity_index] = values
    rows, velocity = np.empty((len(t), MOTION)), np.empty((len(t), 3))
    for k, state in enumerate(states):
        pin.forwardKinematics(model, data, *state)
        rows[k, :6] = pin.getClassicalAcceleration(model, data, last, local).vector
        twist = pin.getVelocity(model, data, last, local)
        velocity[k], rows[k, 6:9] = twist.linear, twist.angular
        rows[k, 9:] = data.oMi[last].rotation.T @ model.gravity.linear
    pin.computeJointJacobians(model, data, states[-1, 0])
    jacobian = pin.getJointJacobian(model, data, last, local)
    return Flange(t, rows, velocity, jacobian[:, arm.velocity_index])


def pushes(flange: Flange, frequency: float, ends: FloatArray) -> Any:
    """Give how a flange moves at a frequency between ends (n + 1,) [s], complex (n, 6)."""
    turned = np.exp(2j * math.pi * frequency * flange.t)[:, None]
    lever = [1.0] * 3 + [TOOL_LEVER] * 3
    whole = np.cumsum(turned * flange.motion[:, :6] * lever, axis=0)
    return np.diff(whole[np.minimum(np.searchsorted(flange.t, ends), len(whole) - 1)], axis=0)


def square(pushed: Any) -> FloatArray:
    """Sum up pushes (n, 6) as (6, 6)."""
    return np.asarray(np.real(pushed.conj().T @ pushed))


def sizes_of(pushed: FloatArray) -> dict[str, FloatArray]:
    """Give how much of each kind is pushed in its three directions, the least first: (6, 6)."""
    return {name: np.sqrt(np.maximum(np.linalg.eigvalsh(pushed[part, part]), 0.0))
            for name, part in KINDS.items()}


def hidden_in(pushed: FloatArray) -> list[str]:
    """Name the kinds of which pushes (6, 6) leave a direction out."""
    sizes = sizes_of(pushed)
    most = max(float(size[-1]) for size in sizes.values())
    return [name for name, size in sizes.items() if size[0] < TOOL_HIDDEN * most]


def row_of(x: FloatArray) -> FloatArray:
    """Give the numbers of ``tool_motion`` of parameters, see FlexibleTool.parameters."""
    planes = (len(x) - 8) // 2
    w, ratio = 2.0 * math.pi * np.exp(x[8:8 + planes]), np.exp(x[8 + planes:])
    row = np.zeros(TOOL)
    row[:3], row[3:12], row[12] = x[3:6], pin.exp3(x[:3]).T.ravel(), math.exp(-x[7])
    row[13:15], row[15:17], row[17] = w**2, 2.0 * ratio * w, planes - 1
    return row


def modes_of(row: FloatArray, gravity: FloatArray) -> ToolModes:
    """Find the modes of a tool of 1 kg where gravity (3,) has a direction in the flange."""
    still, planes = np.concatenate([np.zeros(9), gravity]), int(row[17]) + 1
    hangs = settled(row, gravity)

    def near(k: int, by: float) -> tuple[FloatArray, FloatArray]:
        found, state = np.empty(PLACES), hangs.copy()
        state[k] += by
        accelerate(row, state[:2], state[2:], still, found)
        return found[:2], found[5:]
    ends = [[near(k, by) for by in (TOOL_NUDGE, -TOOL_NUDGE)] for k in range(planes)]
    stiff, ways = (np.array([(one[i] - other[i]) / (2.0 * TOOL_NUDGE) for one, other in ends])
                   for i in (0, 1))
    inertia = ways @ ways.T
    squares, shapes = eigh(-inertia @ stiff[:, :planes].T, inertia)
    w, shapes = np.sqrt(np.maximum(squares, 1e-3)), shapes / np.linalg.norm(shapes, axis=0)
    fading = 0.5 * (shapes**2).T @ row[15:15 + planes]
    forces = shapes.T @ ways
    # weight has another lever where the mass is off, by -1 / w^2 for an acceleration of 1
    moments = np.cross(near(0, 0.0)[1], forces) + np.cross(forces, gravity) / w[:, None]**2
    return ToolModes(
        -fading + 1j * np.sqrt(np.maximum(w**2 - fading**2, 1e-3)),
        np.vstack([shapes, np.zeros((2 - planes, planes))]), np.hstack([forces, moments]), hangs)


class FlexibleTool(BundlePart):
    """
    What an arm carries at its flange and what bends, as one mass on a rod: see ``tool_motion``.

    Source: pseudo-rigid-body model of a cantilever; see docs/explanation/shaping.md.
    """

    motion: Literal['planned', 'measured']  # that it was fitted to
    rests: int = Field(ge=1, le=10**9)  # in which it rings, that it was fitted to
    # Rotation from the flange to its axes: it points along z, bends along x, and maybe y [rad].
    turn: list[Finite] = Field(min_length=3, max_length=3)
    place: list[Finite] = Field(min_length=3, max_length=3)  # of its mass, while straight [m]
    mass: Positive  # [kg]
    length: Positive  # of the rod [m]
    frequencies: list[Positive] = Field(min_length=1, max_length=2)  # along x, y, no gravity [Hz]
    damping: list[Positive] = Field(min_length=1, max_length=2)  # ratios
    covariance: list[list[Finite]]  # of the parameters
    quiet: Positive  # ring that was not heard in the rests [N m or N]
    scatter: Positive  # error of a predicted ring, relative to it
    # In what directions its rests were pushed, each once: translations, then rotations (6, 6).
    pushed: list[Six] = Field(min_length=6, max_length=6)

    def model_post_init(self, _: Any) -> None:
        """Refuse what is no covariance, and planes that differ in number."""
        if len(self.damping) != len(self.frequencies):
            raise ModelError('damping: expected one ratio for each of frequencies')
        size = len(self.parameters)
        values = np.array(self.covariance if {len(row) for row in self.covariance} == {size}
                          else [])
        if values.shape != (size, size) or not (
                np.linalg.eigvalsh(values).min() >= -1e-6 * np.abs(values).max()):
            raise ModelError(f'covariance: expected a covariance of {size} values')

    @property
    def parameters(self) -> FloatArray:
        """Turn, place, logarithms of mass, length, frequencies and damping, (10,) or (12,)."""
        sizes = [self.mass, self.length, *self.frequencies, *self.damping]
        return np.array([*self.turn, *self.place, *np.log(sizes)])

    @property
    def hidden(self) -> list[str]:
        """Kinds of motion of which its rests leave a direction out."""
        return hidden_in(np.array(self.pushed))

    def drawn(self) -> FloatArray:
        """Give the parameters, then random ones within their uncertainty."""
        return np.vstack([self.parameters, np.random.default_rng(0).multivariate_normal(
            self.parameters, self.covariance, TOOL_DRAWS, method='eigh')])

    def modes(self, gravity: FloatArray) -> ToolModes:
        """Find its modes where gravity (3,) [m/s^2] has a direction in the flange."""
        found = modes_of(row_of(self.parameters), gravity)
        return ToolModes(found.poles, found.shapes, self.mass * found.pulls, found.hangs)

    def frequency(self, gravity: FloatArray) -> tuple[Estimate, ...]:
        """Give the frequencies [Hz] where gravity (3,) [m/s^2] has a direction in the flange."""
        x = self.parameters
        logs = np.log([np.abs(modes_of(row_of(one), gravity).poles) / (2.0 * math.pi) for one in
                       (x, *(x + TOOL_NUDGE * np.eye(len(x))))])
        slopes = (logs[1:] - logs[0]) / TOOL_NUDGE
        off = np.sqrt(np.einsum('ik,ij,jk->k', slopes, self.covariance, slopes))
        ends = LIKELY * np.array([0.0, -1.0, 1.0])
        return tuple(Estimate(*np.exp(value + error * ends).tolist())
                     for value, error in zip(logs[0], off, strict=True))

    def frequency_at(self, arm: Arm, q: FloatArray) -> tuple[Estimate, ...]:
        """Give the frequencies [Hz] where the joints stand: q (joints,) [rad or m]."""
        still = np.zeros((1, len(q)))
        return self.frequency(flange_motion(
            arm, np.zeros(1), MotionState(q[None], still, still)).motion[0, 9:])

    def ring_after(self, arm: Arm, trajectory: Trajectory) -> Oscillation:
        """Predict the ring after a trajectory, when modes of the arm itself have decayed."""
        begin, end = float(trajectory.t[0]), float(trajectory.t[-1])
        t = np.arange(max(begin - 0.5, end - TOOL_MEMORY), end + RING_AFTER, TOOL_STEP)
        q = (np.asarray(spline(trajectory)(np.clip(t, begin, end))) if end > begin
             else np.tile(trajectory.q, (len(t), 1)))
        return self.ring(flange_motion(arm, t, zero_phase(t, q, TOOL_CUTOFF)))

    def ring(self, flange: Flange) -> Oscillation:
        """Predict the ring at the end of a motion, in even steps, from rest to rest."""
        noise = np.random.default_rng(1).normal(size=(2, TOOL_DRAWS)) * math.sqrt(0.5)
        shown = np.array([_shown(x, flange) for x in self.drawn()])
        shown[1:] *= np.abs(1.0 + self.error_of(flange) * (noise[0] + 1j * noise[1]))[:, None]
        loudest = int(np.argmax(shown[0]))
        value, ends = float(shown[0, loudest]), np.quantile(shown[1:, loudest], [0.025, 0.975])
        return Oscillation(shown[0], loudest, Estimate(
            value, min(float(ends[0]), value), max(float(ends[1]), value)))

    def error_of(self, flange: Flange) -> float:
        """Give the error of a ring relative to it: larger the less its push was learned from."""
        push = pushes(flange, self.frequencies[0], flange.t[[0, -1]])[0]
        sizes, ways = np.linalg.eigh(np.array(self.pushed))
        shares = np.abs(ways.T @ push)**2 / max(float(np.sum(np.abs(push)**2)), 1e-12)
        return math.sqrt(self.scatter**2 + float(shares @ (
            1.0 / (np.maximum(sizes, 0.0) / self.scatter**2 + TOOL_UNSEEN**-2))))

    def __str__(self) -> str:
        """Write the modes, and what the moves did not show."""
        names = ' or '.join(self.hidden)
        hidden = names and f'; these moves do not show {names}: see tudor excite --for vibration'
        each = (f'{" and ".join(f"{value:.{digits}g}" for value in values)}' for values, digits in
                ((self.frequencies, 3), (self.damping, 2)))
        return (f'rings at {next(each)} Hz without gravity, damping ratio {next(each)}, '
                f'{self.mass:.2g} kg at {self.length:.2g} m, by {self.rests} rests after '
                f'{self.motion} motion{hidden}')


def _shown(x: FloatArray, flange: Flange) -> FloatArray:
    """Give half the range of efforts (joints,) in the first period after a motion."""
    row = row_of(x)
    step = float(flange.t[-1] - flange.t[0]) / max(len(flange.t) - 1, 1)
    modes = modes_of(row, flange.motion[-1, 9:])
    pulls = modes.poles**2 * modes.of(from_rest(row, step, flange.motion)[-1])
    t = np.linspace(0.0, 2.0 * math.pi / modes.poles[0].imag, 48)
    waves = (np.exp(np.outer(t, modes.poles)) * pulls) @ modes.pulls @ flange.jacobian
    return 0.5 * math.exp(x[6]) * np.ptp(waves.real, axis=0)


# -- How it rings beside the running robot, by what efforts show of it

class RingObserver:
    """
    Follows the acceleration of a tool's modes, which turn and decay, and a mean beside each.

    The residual of efforts is the sum of their pulls; projected on these it corrects the modes,
    complex numbers, as a Luenberger observer does.
    """

    def __init__(self, arm: Arm, tool: FlexibleTool) -> None:
        self.tool, self._arm = tool, arm
        self._data, self._q = arm.model.createData(), np.zeros(arm.model.nq)
        self._last = arm.model.njoints - 1
        self._small: ToolModes | None = None  # vibrations of a pose lately
        self._age = 0.0  # of these [s]
        self._modes: Any = np.zeros(len(tool.frequencies), complex)
        self._mean = np.zeros(len(tool.frequencies))
        self._rate = 1.0  # at which they decay [1/s]
        self.amplitude = np.zeros(len(arm.active_joints))  # of each effort [N m or N]

    def step(self, dt: float, q: FloatArray, residual: FloatArray) -> FloatArray:
        """Take the residual of efforts (joints,) into account; dt 0 begins. Give amplitudes."""
        model = self._arm.model
        self._q[self._arm.velocity_index] = q
        jacobian = pin.computeJointJacobian(model, self._data, self._q, self._last)
        self._age += dt
        if self._small is None or dt <= 0.0 or self._age > RING_RENEWED:
            self._small, self._age = self.tool.modes(
                self._data.oMi[self._last].rotation.T @ model.gravity.linear), 0.0
        modes = self._small
        levers = modes.pulls @ jacobian[:, self._arm.velocity_index]
        if dt <= 0.0:
            self._modes, self._mean = 0.0 * self._modes, 0.0 * self._mean
        self._modes = self._modes * np.exp(modes.poles * dt)
        self._rate = float(-modes.poles.real.max())
        # where efforts hardly tell the modes apart, neither has all of them
        square = levers @ levers.T
        square += RING_RIDGE * np.trace(square) * np.eye(len(square))
        error = np.linalg.solve(square, levers @ residual) - self._modes.real - self._mean
        # a real error corrects half of a complex number
        w = modes.poles.imag * dt
        self._modes += 2.0 * (1.0 - np.exp(-RING_BANDWIDTH * w)) * error
        self._mean += (1.0 - np.exp(-RING_MEAN * w)) * error
        self.amplitude = np.abs(self._modes) @ np.abs(levers)
        return self.amplitude

    def __str__(self) -> str:
        """Say what rings most, and how long until nobody hears it."""
        loudest = int(np.argmax(self.amplitude))
        size, name = float(self.amplitude[loudest]), self._arm.active_joints[loudest]
        if size <= self.tool.quiet:
            return 'quiet'
        left = math.log(size / self.tool.quiet) / max(self._rate, 1e-9)
        return (f'{size:.2g} {"N" if self._arm.is_prismatic(name) else "N m"} at {name}, quiet in '
                f'{left:.1f} s')
