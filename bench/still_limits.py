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
Time a thousand random moves for random tools, and see whether limits and path hold.

Moves and limits are those of `still_moves.py`: a seven-joint arm, curves through three random
poses, from rest to rest. The tools have 1 to 5 Hz, one bending plane or two. Between the points of
a timed trajectory a controller interpolates by polynomials of the fifth degree; speeds,
accelerations and efforts along that are compared with the largest of the given move, and the place
of the flange with its path. Efforts are those of links of 2 kg each and of friction.

    python bench/still_limits.py [--moves 1000]
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import sys
from typing import Any
import warnings

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402
from other_plant.carried_tool import DT, FloatArray, HOME, Options, pose_of  # noqa: E402
import pinocchio as pin  # noqa: E402
from scipy.spatial import cKDTree  # noqa: E402
from still_moves import commands, described, move, SPAN  # noqa: E402
from tudor_dynamics.arm.description import Arm  # noqa: E402
from tudor_dynamics.errors import TudorError  # noqa: E402
from tudor_dynamics.models.flexible_tool import FlexibleTool  # noqa: E402
import tudor_dynamics.models.still_timing as timing  # noqa: E402


class Efforts:
    """Efforts of the arm, links of 2 kg and friction, as a model of the package gives them."""

    def __init__(self, arm: Arm) -> None:
        self.model = arm.model.copy()
        for body in range(1, self.model.njoints):
            self.model.inertias[body] = pin.Inertia.FromSphere(2.0, 0.1)
        self.data = self.model.createData()

    def predict(self, motion: FloatArray) -> FloatArray:
        """Give them for positions, velocities and accelerations."""
        q, dq, ddq = np.split(motion, 3, axis=1)
        rigid = [pin.rnea(self.model, self.data, *row) for row in zip(q, dq, ddq, strict=True)]
        return np.array(rigid) + 3.0 * np.tanh(dq / 0.01) + 2.0 * dq

    def largest(self, q: FloatArray, slow: bool) -> FloatArray:
        """Give the largest of each joint along positions in steps, or of slow motion as well."""
        q, dq = q[::8], np.gradient(q[::8], 8 * DT, axis=0)
        found = np.abs(self.predict(np.hstack([q, dq, np.gradient(dq, 8 * DT, axis=0)])))
        if slow:
            found = np.maximum(found, np.abs(self.predict(np.hstack([q, 0.05 * dq, 0.0 * q]))))
        return np.asarray(found.max(axis=0))


def drawn(random: np.random.Generator) -> FlexibleTool:
    """Draw a tool."""
    planes = int(random.integers(1, 3))
    frequency = random.uniform(1.0, 5.0)
    return FlexibleTool.model_validate({
        'motion': 'planned', 'rests': 10, 'turn': random.uniform(-1.5, 1.5, 3).tolist(),
        'place': random.uniform(-0.4, 0.4, 3).tolist(), 'mass': 0.7,
        'length': max(random.uniform(0.25, 0.5), 3.0 * 9.81 / (2.0 * np.pi * frequency) ** 2),
        'frequencies': [frequency, frequency * random.uniform(1.0, 1.8)][:planes],
        'damping': [0.02] * planes, 'covariance': np.diag([1e-6] * (8 + 2 * planes)).tolist(),
        'quiet': 0.02, 'scatter': 0.05, 'pushed': np.eye(6).tolist()})


def largest(q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Give the largest speed and acceleration of each joint."""
    speed = np.diff(q, axis=0) / DT
    change = np.diff(speed[::8], axis=0) / (8 * DT)
    return np.abs(speed).max(axis=0), np.abs(change).max(axis=0)


def off_path(given: FloatArray, found: FloatArray) -> float:
    """Give how far the flange leaves its path [m]."""
    places, between = (np.array([pose_of(q)[:3, 3] for q in path])
                       for path in (given[::8], found[::40]))
    fine = np.arange(0.0, len(places) - 1, 1.0 / 64.0)  # straight between them: 1e-5 m of a curve
    path = np.stack([np.interp(fine, np.arange(len(places)), x) for x in places.T], axis=1)
    return float(cKDTree(path).query(between)[0].max())


def main() -> int:
    """Measure and print as JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().splitlines()[0])
    parser.add_argument('--moves', type=int, default=1000)
    args = parser.parse_args()
    warnings.simplefilter('ignore')
    arm, random = described(Options()), np.random.default_rng(30)
    model = Efforts(arm)
    timing.effort_limits = lambda _: np.zeros(7)  # those of the given move hold
    faster, harder, efforts, off, longer, refused = [], [], [], [], [], []
    for _ in range(args.moves):
        tool = drawn(random)
        given = move(*(HOME + random.uniform(-SPAN, SPAN, (2, 7))), random)
        try:
            found = timing.still_timing(arm, tool, given, model)
        except TudorError as err:
            refused.append(str(err))
            continue
        before, after = (commands(one, 0.0) for one in (given, found))
        (speed, change), (new_speed, new_change) = largest(before), largest(after)
        moved = speed > 1e-6
        faster.append(float((new_speed / speed)[moved].max()))
        harder.append(float((new_change / change)[moved].max()))
        efforts.append(float((model.largest(after, False)
                              / model.largest(before, True)).max()))
        off.append(off_path(before, after))
        seconds = float(found.t[-1] - given.t[-1] + given.t[0] - found.t[0])
        longer.append(2.0 * tool.frequencies[0] * seconds)
    figures: dict[str, Any] = {
        'moves': args.moves, 'refused': len(refused), 'why': sorted(set(refused))[:5],
        'largest_speed_over_given': max(faster), 'largest_acceleration_over_given': max(harder),
        'median_acceleration_over_given': float(np.median(harder)),
        'largest_effort_over_given': max(efforts),
        'median_effort_over_given': float(np.median(efforts)),
        'path_left_by_mm': 1e3 * max(off), 'longest_half_periods': max(longer)}
    print(json.dumps(figures, indent=1))
    return 0


if __name__ == '__main__':
    sys.exit(main())
