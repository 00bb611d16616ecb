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
TURN, PLACE = np.array([0.9, -0.4, 0.5]), np.array([-0.02, -0.31, 0.33])
MASS, LENGTH, FREQUENCIES, DAMPING = 0.8, 0.35, (3.0, 3.7), 0.02
ONE = (3.0, 40.0)  # frequencies of one that bends in one plane
RATE = 200.0
KNOWN = FlexibleTool.model_validate({
    'motion': 'planned', 'rests': 9, 'turn': TURN.tolist(), 'place': PLACE.tolist(), 'mass': MASS,
    'length': LENGTH, 'frequencies': FREQUENCIES, 'damping': [DAMPING, DAMPING],
    'covariance': np.diag([1e-6] * 12).tolist(), 'quiet': 0.02, 'scatter': 0.01,
    'pushed': np.eye(6).tolist()})


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


def with_tool(arm: Arm) -> pin.Model:
    """Hang a mass on a rod with a universal joint at the last joint; it shares nothing with us."""
    model = arm.model.copy()
    turn = pin.exp3(TURN)
    foot = pin.SE3(turn, PLACE - LENGTH * turn[:, 2])
    first = model.addJoint(arm.model.njoints - 1, pin.JointModelRY(), foot, 'bend_x')
    second = model.addJoint(first, pin.JointModelRX(), pin.SE3.Identity(), 'bend_y')
    model.appendBodyToJoint(second, pin.Inertia(
        MASS, np.zeros(3), 1e-9 * np.eye(3)), pin.SE3(np.eye(3), np.array([0.0, 0.0, LENGTH])))
    return model


def springs(frequencies: tuple[float, float], damping: float) -> tuple[FloatArray, FloatArray]:
    """Give stiffness and damping of both angles [N m/rad, N m s/rad]."""
    w = 2.0 * np.pi * np.array(frequencies)
    return MASS * LENGTH**2 * w**2, 2.0 * damping * MASS * LENGTH**2 * w


def hanging(model: pin.Model, q: FloatArray, stiff: FloatArray) -> FloatArray:
    """Give the angles at which a tool hangs where the arm stands [rad]."""
    data, angles = model.createData(), np.zeros(2)
    for _ in range(200):
        pull = pin.computeGeneralizedGravity(model, data, np.append(q, angles))[-2:]
        angles -= 0.5 * (angles + pull / stiff)
    return angles


def true_frequencies(q: FloatArray) -> FloatArray:
    """Give the frequencies of small swings about the place where it hangs [Hz]."""
    model, stiff = with_tool(ARM), springs(FREQUENCIES, DAMPING)[0]
    data, angles = model.createData(), hanging(model, q, stiff)
    rows = np.diag(stiff) + np.array([
        (pin.computeGeneralizedGravity(model, data, np.append(q, angles + way))[-2:].copy()
         - pin.computeGeneralizedGravity(model, data, np.append(q, angles - way))[-2:]) / 2e-5
        for way in 1e-5 * np.eye(2)])
    mass = pin.crba(model, data, np.append(q, angles))[-2:, -2:]
    return np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(mass, rows)).real)) / (2.0 * np.pi)


def tool_efforts(
    arm: Arm, q: FloatArray, *, frequencies: tuple[float, float] = FREQUENCIES,
    damping: float = DAMPING, every: int = 5,
) -> FloatArray:
    """Give what the tool adds to efforts (samples, joints); begins at rest, hanging."""
    n, dt = len(q), 1.0 / RATE
    dq = np.gradient(q, dt, axis=0)
    path = np.hstack([q, dq, np.gradient(dq, dt, axis=0)])
    model = with_tool(arm)
    data, own = model.createData(), arm.model.nv
    stiff, fading = springs(frequencies, damping)
    angles, speed = hanging(model, q[0], stiff), np.zeros(2)
    found, step = np.empty((n, own)), dt / every
    whole, pace = np.empty(own + 2), np.empty(own + 2)
    for k in range(n):
        ahead = path[min(k + 1, n - 1)] - path[k]
        for part in range(every):
            now = path[k] + part / every * ahead
            whole[:own], whole[own:], change = now[:own], angles, now[2 * own:]
            pace[:own], pace[own:] = now[own:2 * own], speed
            mass = pin.crba(model, data, whole)  # its upper triangle
            forces = pin.nonLinearEffects(model, data, whole, pace)
            (a, b), (_, c) = mass[own:, own:].tolist()
            x, y = (forces[own:] + stiff * angles + fading * speed
                    + change @ mass[:own, own:]).tolist()
            second = np.array([b * y - c * x, b * x - a * y]) / (a * c - b * b)
            if part == 0:
                inner = np.triu(mass[:own, :own])
                inner += np.triu(inner, 1).T
                found[k] = inner @ change + mass[:own, own:] @ second + forces[:own]
            speed = speed + step * second
            angles = angles + step * speed
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


def ring_after(trajectory: Trajectory, factor: float = 1.0) -> float:
    """Simulate what a tool shows in all joints for a second after a trajectory [N m]."""
    end = float(trajectory.t[-1])
    t = np.arange(-0.2, end + 1.0, 1.0 / RATE)
    q = np.asarray(spline(trajectory)(np.clip(t, 0.0, end)))
    efforts = tool_efforts(ARM, q, frequencies=(factor * FREQUENCIES[0], factor * FREQUENCIES[1]))
    efforts = efforts[t > end + 0.02]
    return float(0.5 * np.ptp(efforts, axis=0).max())
