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

"""Makes schedules of gains whose values are linear in payload and pose."""

from __future__ import annotations

from typing import Any

import numpy as np

from tudor_dynamics.control.schedule import columns_of, Mode, Point, Schedule, ScheduleFile

JOINTS = ('joint2', 'joint3')


def point(payload: float, q: tuple[float, float]) -> Point:
    """Make a point whose values are linear in payload and pose."""
    a, b = q
    return Point(
        np.array([1000.0 - 500.0 * payload + a, 800.0 + b]), 3.0 - payload, 0.02, 0.6,
        np.array([300.0 * a + 100.0 * payload, 50.0 * b]),
        np.array([[10.0, 1.0], [2.0, 3.0]]) * (1.0 + payload),
        (Mode(3.0 - payload, 0.01, np.array([0.5, 0.1]), np.array([9e3, 1e3])),
         Mode(14.0, 0.03, np.array([-0.1, 0.1]), np.array([-2e4, 4e4]))))


def content(**more: Any) -> dict[str, Any]:
    """Give what stands in a file."""
    payload, pose = (0.0, 0.2, 0.4), ((0.2, 1.6, 3.0), (-1.3, 1.3))
    nodes = [tuple(point(m, (a, b)).row().tolist())
             for m in payload for a in pose[0] for b in pose[1]]
    return {'format': 'tudor_dynamics/schedule', 'version': 1, 'arm': 'tudor', 'joints': JOINTS,
            'damped': JOINTS, 'gauges': ('link2_hub', 'link3_hub'), 'damping_ratio': 0.6,
            'delay': 0.005, 'mean_frequency': 0.1, 'payload': payload, 'pose': pose,
            'columns': columns_of(JOINTS, JOINTS, 2), 'nodes': tuple(nodes), **more}


def schedule(**more: Any) -> Schedule:
    """Make a schedule."""
    return Schedule(ScheduleFile.model_validate(content(**more)))
