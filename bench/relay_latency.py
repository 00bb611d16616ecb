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
How long the relay takes to shape a trajectory of ten seconds, by its points and its shaper.

Seven joints, points with velocities and accelerations, as MoveIt sends them. Shaping, the check
against limits and the making of the message count, not its way over the network. The last column
is the ratio to a loop over 100 000 numbers in the same run.

    python bench/relay_latency.py
"""

from __future__ import annotations

import argparse

from filters import fastest
import numpy as np
from tables import show
from trajectory_msgs.msg import JointTrajectory

from tudor_dynamics.arm.limits import Limits
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.control.trajectory import Path
from tudor_dynamics.nodes.common.messages import put_trajectory, trajectory_of
from tudor_dynamics.signals.filters import MotionState
from tudor_dynamics.signals.shaping import convolved, impulses, KINDS

SECONDS, JOINTS = 10.0, 7
FREQUENCY, DAMPING = 2.77, 0.02  # of a tool


def planned(points: int) -> JointTrajectory:
    """Give a quintic from rest to rest."""
    t = np.linspace(0.0, SECONDS, points)
    s, one = t[:, None] / SECONDS, np.ones(JOINTS)
    q = (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5) * one
    dq = (30.0 * s**2 - 60.0 * s**3 + 30.0 * s**4) / SECONDS * one
    ddq = (60.0 * s - 180.0 * s**2 + 120.0 * s**3) / SECONDS**2 * one
    names = tuple(f'joint{j}' for j in range(JOINTS))
    return put_trajectory(JointTrajectory(), Trajectory(names, t, q, dq, ddq))


def shaped(message: JointTrajectory, kind: str) -> JointTrajectory:
    """Do what the relay does with a trajectory from where the arm rests."""
    given, wide = trajectory_of(message), np.full(JOINTS, 10.0)
    done = convolved(given, impulses(kind, FREQUENCY, DAMPING))
    rest = np.zeros(JOINTS)
    why = Path(MotionState(given.q[0], rest, rest), done).beyond(Limits(-wide, wide, wide, wide))
    assert not why, why
    return put_trajectory(JointTrajectory(), done)


def main() -> None:
    """Print a table."""
    argparse.ArgumentParser(description=__doc__,
                            formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    loop = fastest(lambda: sum(k for k in range(100_000)))
    rows = []
    for points in (11, 101, 1001):
        message = planned(points)
        for kind in KINDS:
            taken = fastest(lambda: shaped(message, kind))  # noqa: B023
            rows.append((points, kind, len(shaped(message, kind).points), f'{1e3 * taken:.1f} ms',
                         f'{taken / loop:.1f}'))
    show(('points', 'shaper', 'points sent', 'time', 'loops'), rows)


if __name__ == '__main__':
    main()
