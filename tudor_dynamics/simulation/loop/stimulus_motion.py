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

"""Motions of stimuli: random ones by their seeds, and planned ones."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.limits import hard_limits
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.signals.excitation import aprbs_motion, fourier_motion, joint_range
from tudor_dynamics.signals.motion_profile import motion_limits, Reference
from tudor_dynamics.signals.splines import states


def stimulus_seeds(seed: int, stimulus: int) -> tuple[int, int, int]:
    """Give the seeds of motion, noise and pushes of a stimulus."""
    state = np.random.SeedSequence([seed, stimulus]).generate_state(3)
    return int(state[0]), int(state[1]), int(state[2])


def stimulus_motion(arm: Arm, excitation: str, seconds: float, seed: int, dt: float) -> Reference:
    """
    Make the motion of a stimulus.

    Parameters
    ----------
    arm : Arm
        Arm with limits.
    excitation : {'aprbs', 'fourier'}
        Kind of motion.
    seconds : float
        Length of the motion [s].
    seed : int
        Of the motion.
    dt : float
        Sample time [s].

    Returns
    -------
    Reference
        Motion of the active joints.

    """
    if excitation == 'aprbs':
        return aprbs_motion(arm, seconds, seed, dt)
    return fourier_motion(joint_range(arm), motion_limits(arm), seconds, seed, dt)


def played_motion(arm: Arm, trajectory: Trajectory, dt: float) -> Reference:
    """Make a motion of a trajectory, at the rate of the loop: dt [s]."""
    if sorted(trajectory.joints) != sorted(arm.active_joints):
        msg = (f'the trajectory moves {", ".join(trajectory.joints)}; {arm.name} has '
               f'{", ".join(arm.active_joints)}')
        raise SimulationError(msg)
    q, dq, _ = np.split(states(trajectory.of(arm.active_joints)), 3, axis=1)
    hard = hard_limits(arm)
    wrong = np.any((q < hard.lower) | (q > hard.upper) | (np.abs(dq) > hard.velocity), axis=0)
    beyond = [name for name, outside in zip(arm.active_joints, wrong, strict=True) if outside]
    if beyond:
        msg = f'the trajectory takes {", ".join(beyond)} beyond the limits of {arm.name}'
        raise SimulationError(msg, remedy='plan it for this arm (tudor excite)')
    t = trajectory.t - trajectory.t[0]
    curve = CubicHermiteSpline(t, q, dq)
    times = np.arange(int(t[-1] / dt + 1e-9) + 1) * dt
    return Reference(dt, curve(times), curve(times, 1), curve(times, 2))
