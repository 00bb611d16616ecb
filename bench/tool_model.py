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
A flexible tool at the flange: how it rings after a motion, identified from its rings.

A study of its own until its figures are those wanted; bench/flexible_tool.py measures them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pinocchio as pin
from pydantic import Field, ValidationError

from tudor_dynamics.arm.description import Arm, MAX_YAML_BYTES
from tudor_dynamics.arm.schema import Finite, Name, Positive, Spec, validation_message
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import FitError, ModelError
from tudor_dynamics.files import load_yaml, read_text, write_whole
from tudor_dynamics.identification import settings
from tudor_dynamics.identification.ringdowns import block_means, Ring, ring_of, standing
from tudor_dynamics.signals.filters import MotionState, zero_phase
from tudor_dynamics.signals.motion_profile import spline
from tudor_dynamics.typing import FloatArray
import yaml

# -- A flexible tool at the flange ; chosen on translations of a beam held up,
# down and level, judged on transfers of it (bench/flexible_tool.py). Expected sizes: TOOL_GRAVITY
# is what gravity does to the squared frequency of a mass on a beam of 0.5 m [Hz^2 per m/s^2],
# TOOL_ALONG the part of it along the bending, where a tool sags; TOOL_RECIPROCAL the difference of
# what drives a tool and what it shows, TOOL_DELAY that between motion and tool [s], TOOL_LARGE the
# participation over that of drives which show the rings seen.
TOOL_GRAVITY, TOOL_ALONG, TOOL_RECIPROCAL, TOOL_DELAY, TOOL_LARGE = 0.08, 0.25, 0.1, 0.03, 5.0
TOOL_CUTOFF = 25.0  # corner of the zero-phase filter of motion [Hz]
TOOL_LEVER = 0.3  # translation that counts as much as a rotation of 1 rad: half a long tool [m]
# Error of a ring relative to it, which weighs rings, and least variance relative to that.
TOOL_RELATIVE, TOOL_SURE = 0.1, 0.1
TOOL_HIDDEN = 0.1  # singular value of a direction, over the largest, below which it is hidden
TOOL_LEAST, TOOL_STARTS = 3, 4  # rings that a fit needs, and starts of its search
# Samples of a trajectory, and how much of it a tool remembers, from its end [s].
TOOL_STEP, TOOL_MEMORY = 0.004, 60.0
TOOL_DRAWS = 400  # random tools within the uncertainty, for an interval

# One mode eta at the flange, the frame of the last joint, with its acceleration a and gravity g:
#     eta'' + 2 zeta w eta' + w^2 eta = -drive . (a - g),   w^2 = w0^2 + gravity . g
# Efforts have J' show eta''. By reciprocity drive is show in a rigid chain; joints that yield and
# links that move along make a little difference, and a delay.

SIZES = np.array([1.0] * 3 + [TOOL_LEVER] * 3)
"""What makes participation of rotations (6,) comparable with that of translations [1, m]."""
KINDS = {'translation': slice(0, 3), 'rotation': slice(3, 6)}
LIKELY = 1.96  # standard deviations of an interval of 95 %


@dataclass(frozen=True, eq=False)
class Flange:
    """Motion of the flange in its own frame."""

    t: FloatArray  # (samples,) [s]
    acceleration: FloatArray  # linear, angular, (samples, 6) [m/s^2, rad/s^2]
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
    acceleration, gravity = np.empty((len(t), 6)), np.empty((len(t), 3))
    for k, state in enumerate(states):
        pin.forwardKinematics(model, data, *state)
        acceleration[k] = pin.getClassicalAcceleration(model, data, last, local).vector
        gravity[k] = data.oMi[last].rotation.T @ model.gravity.linear
    pin.computeJointJacobians(model, data, states[-1, 0])
    jacobian = pin.getJointJacobian(model, data, last, local)
    return Flange(t, acceleration, gravity, jacobian[:, arm.velocity_index])


def free_ring(flange: Flange, squares: FloatArray, damping: float) -> Any:
    """Give eta'' at the end of a motion, complex, by each part of the drive (6,)."""
    # the solution of slow changes, as in signals/shaping.py; before the motion the tool hangs
    w = 2.0 * math.pi * np.sqrt(np.maximum(squares[0] + flange.gravity @ squares[1:], 1e-6))
    pole = w * complex(-damping, math.sqrt(1.0 - damping**2))
    step = np.diff(flange.t)
    left = np.append(np.cumsum((0.5 * step * (pole[1:] + pole[:-1]))[::-1])[::-1], 0.0)
    drive = flange.acceleration.copy()
    drive[:, :3] -= flange.gravity - flange.gravity[-1]
    kernel = (np.exp(left) / np.sqrt(pole.imag * pole.imag[-1]))[:, None] * drive
    summed = 0.5 * step @ (kernel[1:] + kernel[:-1]) - kernel[0] / pole[0]
    return 1j * pole[-1] ** 2 * summed


class FlexibleTool(Spec):
    """One mode of what an arm carries at its flange, as it stands in a file."""

    version: Literal[1] = 1
    arm: Name
    motion: Literal['planned', 'measured']  # that it was fitted to
    rings: int = Field(ge=TOOL_LEAST, le=10**9)  # that it was fitted to
    # Squared frequency without gravity [Hz^2]; what gravity in the flange adds [Hz^2 per m/s^2].
    squares: list[Finite] = Field(min_length=4, max_length=4)
    squares_covariance: list[list[Finite]]
    damping: float = Field(ge=0.0, lt=1.0)  # damping ratio
    damping_error: float = Field(ge=0.0, lt=1.0)
    # What drives it (6), what it shows in efforts (6) [kg^0.5, m kg^0.5], and its delay [s].
    participation: list[Finite] = Field(min_length=13, max_length=13)
    participation_covariance: list[list[Finite]]
    scatter: Positive  # error of a predicted ring, relative to it
    hidden: list[Literal['translation', 'rotation']]  # what the moves do not show

    def model_post_init(self, _: Any) -> None:
        """Refuse what is no covariance, and no frequency."""
        for name, size in (('squares', 4), ('participation', 13)):
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
        t = np.arange(max(begin - 0.5, end - TOOL_MEMORY), end + settings.RING_AFTER,
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
        modes = np.abs((drawn[:, :6] * changed).sum(axis=1) * (
            1.0 + self.scatter * math.sqrt(0.5) * (noise[1] + 1j * noise[2])))
        mode = float(abs(self.participation[:6] @ free))
        amplitude = np.abs(self.participation[6:12] @ flange.jacobian) * mode
        loudest = int(np.argmax(amplitude))
        shown = modes * np.abs(drawn[:, 6:12] @ flange.jacobian[:, loudest])
        square = (2.0 * math.pi * frequency.value) ** 2
        return Oscillation(frequency, amplitude, loudest, *(
            Estimate(value, *(float(np.quantile([value, *values], k)) for k in (0.025, 0.975)))
            for value, values in ((float(amplitude[loudest]), shown),
                                  (mode / square, modes / square))))

    def write(self, path: Path) -> None:
        """Write the file, whole or not at all; one that is there is replaced."""
        write_whole(path, yaml.safe_dump(self.model_dump(), sort_keys=False, width=99,
                                         default_flow_style=None).encode())


def read_tool(path: Path, arm: Arm) -> FlexibleTool:
    """Read the file of a tool, and refuse that of another arm."""
    remedy = 'write one with FlexibleTool.write'
    text = read_text(path, MAX_YAML_BYTES, 'the tool', ModelError, remedy)
    try:
        tool = FlexibleTool.model_validate(load_yaml(text))
    except ValueError as err:
        cause = validation_message(err) if isinstance(err, ValidationError) else err
        raise ModelError(f'no tool: {cause}', place=path, remedy=remedy) from None
    if tool.arm != arm.name:
        raise ModelError(f'the tool is of the arm {tool.arm!r}, expected {arm.name!r}',
                         place=path, remedy='give the tool and the description of one arm')
    return tool


# -- From recordings

@dataclass(frozen=True, eq=False)
class Heard:
    """What rings in a rest, after a motion; None where nothing clear does."""

    flange: Flange
    ring: Ring | None


Pairs = Sequence[tuple[Flange, Ring]]


def heard(arm: Arm, recording: Recording, planned: Recording | None = None) -> list[Heard]:
    """Find the rests of a recording, each with its motion: as planned, where that is there."""
    found = []
    for part in recording.segments:
        t = recording.t[part]
        if recording.effort is None or t[-1] - t[0] < settings.RING_AFTER + settings.RING_LEAST:
            continue
        cutoff = min(TOOL_CUTOFF, 0.2 / recording.dt)
        motion = zero_phase(t, recording.q[part], cutoff)
        rests = standing(t, motion.dq)
        if planned is not None and rests:
            when = (planned.stamp - recording.stamp[0]) * 1e-9
            motion = zero_phase(t, np.stack([np.interp(t, when, q) for q in planned.q.T], axis=1),
                                cutoff)
        for rest in rests:
            means = block_means(t[rest], recording.effort[part][rest])
            at = means[0][0]
            own = slice(*np.searchsorted(t, [at - TOOL_MEMORY, at], side='right'))
            found.append(Heard(flange_motion(arm, t[own], MotionState(
                motion.q[own], motion.dq[own], motion.ddq[own])), ring_of(*means)))
    return found


def fit_tool(arm: Arm, rests: Sequence[Heard], motion: str) -> FlexibleTool:
    """Fit a tool to rests of recordings, their motion `planned` or `measured`."""
    pairs = [(rest.flange, rest.ring) for rest in rests if rest.ring is not None]
    if len(pairs) < TOOL_LEAST or any(joint.effort.unit == 'A' for joint in arm.joints):
        msg = (f'{len(pairs)} rests with a clear ring, efforts in {arm.joints[0].effort.unit}; '
               f'expected {TOOL_LEAST} rests or more, efforts in N m or N')
        raise FitError(msg, remedy='let the arm rest for three seconds or more after each motion')
    ratios = np.array([ring.damping for _, ring in pairs])
    weights = np.array([ring.damping_error ** -2 for _, ring in pairs])
    damping = float(weights @ ratios / weights.sum())
    spread = math.sqrt(float(weights @ (ratios - damping) ** 2 / weights.sum()))
    expected = np.eye(3)
    for _ in range(2):  # gravity along the bending changes the frequency little
        squares, covariance = _squares(pairs, TOOL_GRAVITY ** 2 * expected)
        found = _participation(pairs, squares, damping)
        along = np.array(found['participation'][6:9])
        along /= np.linalg.norm(along)
        expected = np.eye(3) - (1.0 - TOOL_ALONG ** 2) * np.outer(along, along)
    return FlexibleTool.model_validate({
        'arm': arm.name, 'motion': motion, 'rings': len(pairs), 'squares': squares.tolist(),
        'squares_covariance': covariance.tolist(), 'damping': damping,
        'damping_error': max(spread, float(weights.sum() ** -0.5)), **found})


def _squares(pairs: Pairs, expected: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find what gravity does to frequencies, by what is expected of it (3, 3)."""
    rows = np.array([[1.0, *flange.gravity[-1]] for flange, _ in pairs])
    measured = np.array([ring.frequency ** 2 for _, ring in pairs])
    off = np.array([2.0 * ring.frequency * ring.frequency_error for _, ring in pairs])
    weighted, prior, scale = rows / off[:, None] ** 2, np.zeros((4, 4)), 1.0
    prior[1:, 1:] = np.linalg.inv(expected)
    for _ in range(2):  # the second time with the scatter of the first
        covariance = np.linalg.inv(weighted.T @ rows / scale + prior)
        squares = covariance @ weighted.T @ measured / scale
        left = float(np.sum(((measured - rows @ squares) / off) ** 2))
        scale = max(1.0, left / max(len(pairs) - 4, 1))
    return squares, covariance


def _participation(pairs: Pairs, squares: FloatArray, damping: float) -> dict[str, Any]:
    """Find drive, show and delay, their covariance, the scatter, and what is hidden."""
    from scipy.optimize import least_squares  # slow to import

    w = np.array([2.0 * math.pi * ring.frequency for _, ring in pairs])
    free = np.array([free_ring(flange, squares, damping) for flange, _ in pairs]) * SIZES
    levers = np.array([flange.jacobian.T for flange, _ in pairs]) * SIZES
    seen = np.array([ring.amplitude for _, ring in pairs])
    loud = np.abs(seen).max(axis=1)
    noise = np.array([np.sqrt(np.mean(ring.noise ** 2)) for _, ring in pairs])
    unit = (TOOL_RELATIVE * loud + noise)[:, None]
    # drives of this size would show rings as large as those seen
    usual = math.sqrt(float(np.median(loud / np.linalg.norm(free, axis=1))))

    def error(x: FloatArray) -> Any:
        return (levers @ x[6:12]) * (free @ x[:6] * np.exp(1j * w * x[12]))[:, None] - seen

    def whole(x: FloatArray, scale: float) -> FloatArray:
        misfit = (error(x) / unit / math.sqrt(scale)).ravel()
        apart = (x[:6] - x[6:12]) / (TOOL_RECIPROCAL * np.linalg.norm(x[6:12]) + 1e-9)
        return np.concatenate([misfit.real, misfit.imag, apart, x[12:] / TOOL_DELAY,
                               x[6:12] / (TOOL_LARGE * usual)])

    random, scale = np.random.default_rng(0), float(seen.shape[1])
    starts = [np.append(np.tile(usual * random.normal(size=6), 2), 0.0)
              for _ in range(TOOL_STARTS)]
    for _ in range(3):  # what the model does not explain weighs against what is expected
        best = min((least_squares(whole, start, args=(scale,)) for start in starts),
                   key=lambda one: float(one.cost))
        # all joints of a ring are one sample: what a ring has besides is the same in all of them
        scale = max(TOOL_SURE, seen.shape[1] * float(np.sum(np.abs(
            error(best.x) / unit) ** 2)) / max(2 * seen.size - len(best.x), len(pairs)))
        starts = [best.x]
    sizes = {name: np.linalg.svd(np.vstack([free.real, free.imag])[:, part], compute_uv=False)
             for name, part in KINDS.items()}
    most = max(float(size[0]) for size in sizes.values())
    errors = np.linalg.norm(error(best.x), axis=1) / np.linalg.norm(seen, axis=1)
    back = np.append(np.tile(SIZES, 2), 1.0)
    covariance = np.linalg.inv(best.jac.T @ best.jac) * np.outer(back, back)
    return {'participation': (best.x * back).tolist(),
            'participation_covariance': covariance.tolist(),
            'scatter': max(float(np.sqrt(np.mean(errors ** 2))), 1e-3),
            'hidden': [name for name, size in sizes.items()
                       if len(size) < 3 or size[2] < TOOL_HIDDEN * most]}
