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
Splines through the points of a trajectory, as joint_trajectory_controller lays them.

Between two points that both have velocities and accelerations lies a quintic, between two that
both have velocities a cubic, and a straight line otherwise (ros2_controllers,
joint_trajectory_controller, "Trajectory Representation").
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import SignalError
from tudor_dynamics.typing import FloatArray

if TYPE_CHECKING:
    from scipy.interpolate import BPoly

MOST_POINTS = 1_000_000
"""Of a trajectory that is made denser; five minutes of a 3 kHz loop."""


def spline(trajectory: Trajectory) -> BPoly:
    """Lay polynomials between points; returns positions of all joints over the time [s]."""
    from scipy.interpolate import BPoly  # slow to import, and few fits have a plan

    given = (trajectory.q, trajectory.dq, trajectory.ddq)
    return BPoly.from_derivatives(
        trajectory.t, np.stack([field for field in given if field is not None], axis=1))


def states(trajectory: Trajectory) -> FloatArray:
    """
    Give the motion at the points.

    Where velocities or accelerations are not given, they are those of the splines; where the
    splines on both sides of a point differ, the mean of both, since the controller draws a
    straight line from effort to effort. The arm rests before the first point and behind the last,
    which the controller holds: there what is not given is zero.

    Returns (points, 3 joints): ``[q, dq, ddq]`` [rad, rad/s, rad/s^2 or m, m/s, m/s^2].
    """
    given = (trajectory.dq, trajectory.ddq)
    return np.hstack([trajectory.q, *(
        _at_points(trajectory, order) if field is None else field
        for order, field in enumerate(given, start=1))])


def _at_points(trajectory: Trajectory, order: int) -> FloatArray:
    """Give a derivative at the points: the mean of both sides, none at the ends."""
    values = np.zeros_like(trajectory.q)
    if len(trajectory.t) < 3 or (order == 2 and trajectory.dq is None):
        return values
    derivative = spline(trajectory).derivative(order)
    inner, widths = trajectory.t[1:-1], np.diff(trajectory.t)
    # the spline takes a point for the begin of the next piece: just before it, for the last one
    before = derivative(inner - 1e-9 * widths[:-1])
    values[1:-1] = 0.5 * (before + derivative(inner))
    return values


def denser(trajectory: Trajectory, rate: float) -> Trajectory:
    """Put more points onto the splines, so that efforts follow what lies between: rate [Hz]."""
    seconds = float(trajectory.t[-1] - trajectory.t[0])
    if not 0.0 < rate < float('inf') or seconds * rate > MOST_POINTS:
        msg = (f'{seconds:g} s at {rate:g} points per second; expected a rate above zero and '
               f'at most {MOST_POINTS} points')
        raise SignalError(msg)
    if len(trajectory.t) < 2:
        return trajectory
    t = np.linspace(trajectory.t[0], trajectory.t[-1], max(1, round(seconds * rate)) + 1)
    curve = spline(trajectory)
    q, dq = np.asarray(curve(t)), np.asarray(curve.derivative(1)(t))
    # of straight lines there is no second derivative
    ddq = np.zeros_like(q) if trajectory.dq is None else np.asarray(curve.derivative(2)(t))
    q[[0, -1]] = trajectory.q[[0, -1]]
    for given, values in ((trajectory.dq, dq), (trajectory.ddq, ddq)):
        if given is None:
            values[[0, -1]] = 0.0
    return Trajectory(trajectory.joints, t, q, dq, ddq)
