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
Which terms of its motion a flexible tool needs, to be foretold where the flange turns.

The plant is that of `still_moves.py`, its moves too, as given and shaped by ZV. Here what its tip
does after them is computed by equations of motion of one mode in each bending plane, of what
MuJoCo knows of the straight tool, frequencies by ring-downs in other poses, and the planned
motion. Terms come one after the other:

linear        each plane is driven by acceleration less gravity, and by angular acceleration
turning       the planes are coupled where the tool turns about its axis (Coriolis, Euler)
centrifugal   of the tool's centre, as the participations in both motions tell where that is
felt          frequencies go by the gravity that is felt, acceleration of the tool included
spin          the deflection itself is thrown out

No term needs a number that the first one does not have. Errors of the tip are relative to the
ring after the move as it was given.

    python bench/still_terms.py [--variants as_is one_plane ...] [--tools 6]
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
from other_plant.carried_tool import (  # noqa: E402
    CarriedTool, DH, draw_tools, DT, FloatArray, HOME, Mode, planes_of, pose_of)
from still_moves import (  # noqa: E402
    commands, LOOK, SEED, SETTLE, SPAN, tests, VARIANTS)
from tudor_dynamics.bags.trajectory import Trajectory  # noqa: E402
from tudor_dynamics.signals.shaping import convolved, impulses  # noqa: E402

TERMS = ('linear', 'turning', 'centrifugal', 'felt', 'spin')
EVERY, FINER = 2, 4
"""Steps of the plant between samples of the motion, steps of the equations in each of these."""
POSES = 14
"""In which frequencies are measured."""


def squares(plant: CarriedTool) -> FloatArray:
    """Give squared frequencies (planes, 4) and what gravity in link 7 does to them."""
    random, rows, values = np.random.default_rng(5), [], []
    gravity = np.array([0.0, 0.0, -plant.options.gravity])
    for _ in range(POSES):
        q = HOME + random.uniform(-SPAN, SPAN)
        rows.append([1.0, *(pose_of(q)[:3, :3].T @ gravity)])
        values.append([ring.frequency**2 for ring in plant.ring_downs(q)])
    return np.linalg.lstsq(np.array(rows), np.array(values), rcond=1e-9)[0].T


def centre_of(mode: Mode) -> FloatArray:
    """Give where a tool is, from its participation: across it, and along it as at the flange."""
    linear, turning = mode.participation[:3], mode.participation[3:]
    across = np.cross(linear, turning) / (linear @ linear)
    flange = np.array([DH[7][0], 0.0, DH[7][2]])
    return np.asarray(across + linear * (flange @ linear) / (linear @ linear))


class Moved:
    """The motion of link 7, in its own frame."""

    def __init__(self, plant: CarriedTool, q: FloatArray) -> None:
        self.dt = EVERY * DT
        place, turn = plant.frames(q[::EVERY])
        self.gravity = turn.transpose(0, 2, 1) @ np.array([0.0, 0.0, -plant.options.gravity])
        second = np.gradient(np.gradient(place, self.dt, axis=0), self.dt, axis=0)
        self.acceleration = np.einsum('nji,nj->ni', turn, second)
        rate = np.einsum('nji,njk->nik', turn, np.gradient(turn, self.dt, axis=0))
        self.speed = np.stack([rate[:, 2, 1], rate[:, 0, 2], rate[:, 1, 0]], axis=1)
        self.turning = np.gradient(self.speed, self.dt, axis=0)

    def at(self, centre: FloatArray) -> FloatArray:
        """Give what rotation adds to the acceleration at a place, centrifugal alone and whole."""
        thrown = np.cross(self.speed, np.cross(self.speed, centre))
        return np.stack([thrown, thrown + np.cross(self.turning, centre)])


def foretold(
    moved: Moved, modes: list[Mode], square: FloatArray, damping: float, terms: tuple[str, ...],
) -> FloatArray:
    """Give how far the tip is from rest in each plane, over the last second (samples, planes)."""
    count, steps = len(modes), len(moved.speed)
    linear = np.array([mode.participation[:3] for mode in modes])
    turning = np.array([mode.participation[3:] for mode in modes])
    tips = np.array([mode.tip for mode in modes])
    along = tips / np.linalg.norm(tips, axis=1)[:, None]
    drive = (moved.acceleration - moved.gravity) @ linear.T + moved.turning @ turning.T
    stiff = np.zeros((steps, count))
    for k, mode in enumerate(modes):
        thrown, whole = moved.at(centre_of(mode))
        if 'centrifugal' in terms:
            drive[:, k] += thrown @ linear[k]
        felt = moved.gravity - (moved.acceleration + whole if 'felt' in terms else 0.0)
        stiff[:, k] = (2.0 * np.pi) ** 2 * (square[k, 0] + felt @ square[k, 1:])
    coupled, slope = np.zeros((2, steps, count, count))
    if 'turning' in terms and count == 2:
        axis = np.cross(along[0], along[1])
        cross = np.array([[0.0, -1.0], [1.0, 0.0]])
        coupled = 2.0 * (moved.speed @ axis)[:, None, None] * cross
        slope = slope + (moved.turning @ axis)[:, None, None] * cross
    if 'spin' in terms:
        own = moved.speed @ along.T
        slope = slope + np.einsum('ni,nj->nij', own, own) - np.einsum(
            'n,ij->nij', (moved.speed**2).sum(axis=1), np.eye(count))
    fading = 4.0 * np.pi * damping * np.sqrt(square[:, 0])
    eta, rate, found = -drive[0] / stiff[0], np.zeros(count), np.zeros((steps, count))
    step = moved.dt / FINER
    for n in range(steps):
        for _ in range(FINER):
            rate = rate - step * (drive[n] + fading * rate + stiff[n] * eta + coupled[n] @ rate
                                  + slope[n] @ eta)
            eta = eta + step * rate
        found[n] = eta
    return np.asarray((found + drive[-1] / stiff[-1]) * np.linalg.norm(tips, axis=1)
                      )[-round(LOOK / moved.dt):]


def errors(plant: CarriedTool, moves: list[Trajectory]) -> dict[str, dict[str, list[float]]]:
    """Compare what is foretold with what the plant does."""
    tool, modes, square = plant.tool, plant.modes(), squares(plant)
    planes = planes_of(tool)[:len(modes)]
    planes = planes * np.sign([[mode.tip @ way] for mode, way in zip(modes, planes, strict=True)])
    found: dict[str, dict[str, list[float]]] = {}
    for given in moves:
        frequency = plant.ring_downs(given.q[-1])[0].frequency
        loud = 0.0
        for how, trajectory in (
                ('as_given', given),
                ('zv', convolved(given, impulses('zv', frequency, tool.damping)))):
            wanted = commands(trajectory, SETTLE + LOOK)
            sensed = plant.follow(plant.settled(given.q[0]), wanted)
            rest = plant.resting(sensed.end, wanted[-1])
            tip = ((sensed.tip[-round(LOOK / DT):] - rest) @ planes.T)[::EVERY]
            loud = loud or float(np.linalg.norm(tip, axis=1).max())
            moved = Moved(plant, wanted)
            for k, name in enumerate(TERMS):
                told = foretold(moved, modes, square, tool.damping, TERMS[:k + 1])
                n = min(len(told), len(tip))
                found.setdefault(how, {}).setdefault(name, []).append(
                    float(np.linalg.norm(told[:n] - tip[:n], axis=1).max()) / loud)
    return found


def main() -> int:
    """Measure and print as JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().splitlines()[0])
    parser.add_argument('--variants', nargs='+', choices=tuple(VARIANTS),
                        default=['stiff_drives_no_dry_friction'])
    parser.add_argument('--tools', type=int, default=6)
    parser.add_argument('--moves', type=int, default=5, help='of each tool')
    args = parser.parse_args()
    warnings.simplefilter('ignore')
    found: dict[str, Any] = {}
    for variant in args.variants:
        whole: dict[str, dict[str, list[float]]] = {}
        for number, tool in enumerate(draw_tools(6, SEED)[:args.tools]):
            plant = CarriedTool(tool, VARIANTS[variant])
            moves, _ = tests(plant, [SEED, 1, number], args.moves)
            for how, rows in errors(plant, moves).items():
                for name, values in rows.items():
                    whole.setdefault(how, {}).setdefault(name, []).extend(values)
        found[variant] = {how: {name: {
            'median': round(float(np.median(values)), 4),
            'nine_of_ten': round(float(np.quantile(values, 0.9)), 4)}
            for name, values in rows.items()} for how, rows in whole.items()}
    print(json.dumps(found, indent=1))
    return 0


if __name__ == '__main__':
    sys.exit(main())
