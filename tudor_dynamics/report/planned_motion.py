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

"""A planned motion as a figure: positions, speeds, accelerations, in parts of their limits."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure
import numpy as np

from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.report.figure import plain_text, write_figure
from tudor_dynamics.report.schedule import LOOKS
from tudor_dynamics.report.style import PRINT, style
from tudor_dynamics.signals.excitation import JointRange
from tudor_dynamics.signals.motion_profile import MotionLimits
from tudor_dynamics.signals.splines import states

SHOWN = 20.0
"""Samples a second that are drawn [Hz]."""


def draw_motion(
    trajectory: Trajectory, bounds: JointRange, limits: MotionLimits, units: dict[str, str],
) -> Figure:
    """Draw a motion; to be called within a style."""
    names = trajectory.joints
    _, dq, ddq = np.split(states(trajectory), 3, axis=1)
    figure = Figure(figsize=(7.2, 0.6 + 1.25 * len(names)))
    axes = figure.subplots(len(names), 2, sharex=True, squeeze=False,
                           gridspec_kw={'width_ratios': (1.0, 1.6)})
    every = max(int(round(1.0 / (SHOWN * float(np.median(np.diff(trajectory.t)))))), 1)
    t = trajectory.t[::every]
    for j, (name, (left, right)) in enumerate(zip(names, axes, strict=True)):
        left.plot(t, trajectory.q[::every, j], color='#111111', linewidth=1.0)
        for limit in (bounds.lower[j], bounds.upper[j]):
            left.axhline(limit, color='#777777', linewidth=0.9, linestyle=(0, (4, 2)))
        plain_text(left.set_ylabel, f'{name} [{units[name]}]')
        for look, values, label in (
                (LOOKS[0], dq[::every, j] / limits.velocity[j], 'speed'),
                (LOOKS[1], ddq[::every, j] / limits.acceleration[j], 'acceleration')):
            right.plot(t, values, color=look['color'], linestyle=look['linestyle'],
                       linewidth=1.0, label=label)
        right.set_ylim(-1.15, 1.15)
        right.set_yticks((-1.0, 0.0, 1.0))
    axes[0, 0].set_title('position, and its limits (dashed)')
    axes[0, 1].set_title('in parts of the limits')
    axes[0, 1].legend(loc='lower right', bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.0)
    for axis in axes[-1]:
        axis.set_xlabel('time [s]')
    figure.tight_layout()
    return figure


def write_motion_figure(
    trajectory: Trajectory, bounds: JointRange, limits: MotionLimits, units: dict[str, str],
    path: Path,
) -> None:
    """Write the figure, whole or not at all."""
    with style(PRINT):
        write_figure(draw_motion(trajectory, bounds, limits, units), path)
