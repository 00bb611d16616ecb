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

"""Recordings of an arm that carries a flexible tool, integrated step by step."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.description import Arm, arm_from_dict
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.models.flexible_tool import FlexibleTool
from tudor_dynamics.signals.motion_profile import spline
from tudor_dynamics.typing import FloatArray

ARM = arm_from_dict({
    'name': 'carrier', 'kinematics': {'dh': [
        [0.0, np.pi / 2, 0.3, 0.0], [0.4, 0.0, 0.0, 0.0], [0.1, np.pi / 2, 0.0, 0.0],
        [0.0, -np.pi / 2, 0.3, 0.0], [0.1, 0.0, 0.0, 0.0]]},
    'joints': [{'name': f'j{k}', 'effort': {'topic': 'joint_states', 'unit': 'N m'},
                'limits': {'velocity': 3.0, 'acceleration': 12.0}} for k in range(1, 6)],
    'gravity': [0.0, 0.0, -9.81]}, base=Path(), source='carrier.yaml')
PARTICIPATION = np.array([0.1, 0.5, 0.05, 0.02, -0.01, 0.12])
FREQUENCY, DAMPING = 3.0, 0.02
GRAVITY = np.array([0.06, 0.0, 0.0])
RATE = 200.0
KNOWN = FlexibleTool.model_validate({
    'motion': 'planned', 'rings': 9, 'squares': [FREQUENCY**2, *GRAVITY.tolist()],
    'squares_covariance': np.diag([1e-6] * 4).tolist(), 'damping': DAMPING,
    'damping_error': 0.001, 'participation': PARTICIPATION.tolist(),
    'participation_covariance': np.diag([1e-6] * 6).tolist(), 'quiet': 0.02,
    'scatter': 0.01, 'hidden': []})


def moves(seed: int, count: int = 4, rest: float = 5.0) -> FloatArray:
    """Give positions (samples, joints) [rad] of random moves with rests, at RATE."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-0.6, 0.6, 5)
    parts = [np.tile(q, (int(0.5 * RATE), 1))]
    for _ in range(count):
        to = rng.uniform(-0.6, 0.6, 5)
        seconds = rng.uniform(0.6, 1.0)
        s = np.linspace(0.0, 1.0, int(seconds * RATE))[:, None]
        parts += [q + s**3 * (10.0 - s * (15.0 - 6.0 * s)) * (to - q),
                  np.tile(to, (int(rest * RATE), 1))]
        q = to
    return np.vstack(parts)


def tool_efforts(
    arm: Arm, q: FloatArray, *, participation: FloatArray = PARTICIPATION,
    frequency: float = FREQUENCY, damping: float = DAMPING, every: int = 5,
) -> FloatArray:
    """Give what the tool adds to efforts (samples, joints) [N m]; begins at rest."""
    n, dt = len(q), 1.0 / RATE
    dq = np.gradient(q, dt, axis=0)
    ddq = np.gradient(dq, dt, axis=0)
    model, data = arm.model, arm.model.createData()
    drive, lever, square = np.empty(n), np.empty((n, model.nv)), np.empty(n)
    for k in range(n):
        pin.forwardKinematics(model, data, q[k], dq[k], ddq[k])
        pin.computeJointJacobians(model, data, q[k])
        local = pin.ReferenceFrame.LOCAL
        g = data.oMi[model.nv].rotation.T @ np.array([0.0, 0.0, -9.81])
        a = pin.getClassicalAcceleration(model, data, model.nv, local).vector
        drive[k] = participation @ np.concatenate([a[:3] - g, a[3:]])
        lever[k] = pin.getJointJacobian(model, data, model.nv, local).T @ participation
        square[k] = (2.0 * np.pi) ** 2 * (frequency**2 + GRAVITY @ g)
    eta, speed = -drive[0] / square[0], 0.0
    found = np.empty((n, model.nv))
    step = dt / every
    for k in range(n):
        for _ in range(every):
            second = -drive[k] - 2.0 * damping * np.sqrt(square[k]) * speed - square[k] * eta
            speed += step * second
            eta += step * speed
        found[k] = lever[k] * second
    return found


def recording(q: FloatArray, effort: FloatArray, noise: float = 0.02, seed: int = 0) -> Recording:
    """Make a recording of it, with noise [N m]."""
    n = len(q)
    stamp = np.round(np.arange(n) * 1e9 / RATE).astype(np.int64)
    effort = effort + np.random.default_rng(seed).normal(0.0, noise, effort.shape)
    return Recording('bag', stamp, q, None, effort, None, (slice(0, n),), 1.0 / RATE)


def curved(seed: int, seconds: float = 0.9, points: int = 46) -> Trajectory:
    """Give a trajectory from rest to rest along a curve, past a third pose."""
    first, last, between = np.random.default_rng(seed).uniform(-0.6, 0.6, (3, 5))
    s = np.linspace(0.0, 1.0, points)[:, None]
    place, speed, change = (
        s**3 * (10.0 - s * (15.0 - 6.0 * s)), 30.0 * (s * (1.0 - s))**2 / seconds,
        (60.0 * s - 180.0 * s**2 + 120.0 * s**3) / seconds**2)
    way, aside = last - first, between - 0.5 * (first + last)
    wave, turn = np.sin(np.pi * place), np.pi * np.cos(np.pi * place)
    return Trajectory(
        ARM.active_joints, s[:, 0] * seconds, first + place * way + wave * aside,
        speed * way + turn * speed * aside,
        change * way + (turn * change - np.pi**2 * wave * speed**2) * aside)


def ring_after(trajectory: Trajectory) -> float:
    """Simulate what a tool shows in all joints for a second after a trajectory [N m]."""
    end = float(trajectory.t[-1])
    t = np.arange(-0.2, end + 1.0, 1.0 / RATE)
    q = np.asarray(spline(trajectory)(np.clip(t, 0.0, end)))
    efforts: FloatArray = tool_efforts(ARM, q)
    return float(np.abs(efforts[t > end + 0.02]).max())
