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
Which way is down: the direction of gravity that the efforts follow best.

Efforts are linear in the masses, centres and inertias of the links, whatever these are, for each
direction of gravity. The usual one counts unless another leaves much less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.library.drafting.samples import SLOW, spread
from tudor_dynamics.typing import FloatArray

SIZE = 9.81
"""Of gravity [m/s^2]."""
USUAL = (0.0, 0.0, -SIZE)
OTHERS = {'none': (0.0, 0.0, 0.0), '-x': (-SIZE, 0.0, 0.0), 'x': (SIZE, 0.0, 0.0),
          '-y': (0.0, -SIZE, 0.0), 'y': (0.0, SIZE, 0.0), 'z': (0.0, 0.0, SIZE)}
"""Axes of the base, and an arm that gravity does not reach. Which way along an axis shows where
the same centres of mass carry and accelerate."""
BETTER = 2.0
"""Another direction counts where it leaves less than one over this of the efforts' variance."""
SIMPLER = 1.05
"""No gravity at all counts where a direction explains hardly more."""


@dataclass(frozen=True)
class Down:
    """A direction of gravity, and why."""

    gravity: tuple[float, float, float]  # in the base frame [m/s^2]
    alike: tuple[tuple[float, float, float], ...]  # all that explain the efforts as well [m/s^2]
    # Evidence with its numbers; empty where nothing speaks against the usual direction.
    reason: str


def _unexplained(rows: FloatArray, dq: FloatArray, effort: FloatArray) -> float:
    """Give what is left of the efforts' variance, on average over the joints."""
    shares = []
    for joint in range(effort.shape[1]):
        y = effort[:, joint]
        if not y.std() > 0.0:
            continue
        x = np.column_stack([rows[:, joint], np.tanh(dq[:, joint] / SLOW), dq[:, joint]])
        x = x[:, np.abs(x).max(axis=0) > 1e-9]
        error = y - x @ np.linalg.lstsq(x, y, rcond=1e-9)[0]
        shares.append(float(error @ error) / float((y - y.mean()) @ (y - y.mean())))
    return float(np.mean(shares)) if shares else 1.0


def down(
    model: pin.Model, recordings: Sequence[Recording], index: Sequence[int],
    moving: Sequence[bool],
) -> Down:
    """Judge the direction of gravity."""
    other = pin.Model(model)
    rows: dict[str, list[FloatArray]] = {name: [] for name in ('usual', *OTHERS)}
    speed, measured = [], []
    for recording in recordings:
        assert recording.effort is not None
        taken = spread(recording, model.nq, index)
        speed.append(taken.dq[:, list(index)])
        measured.append(recording.effort[taken.rows])
        for name, gravity in (('usual', USUAL), *OTHERS.items()):
            other.gravity = pin.Motion(np.array(gravity), np.zeros(3))
            data = other.createData()
            rows[name] += [
                pin.computeJointTorqueRegressor(other, data, q, dq, ddq)[list(index)].copy()
                for q, dq, ddq in zip(taken.q, taken.dq, taken.ddq, strict=True)]
    dq, effort = np.vstack(speed), np.vstack(measured)
    if len(effort) < 2:
        return Down(USUAL, (USUAL,), '')
    some = np.flatnonzero(moving)
    left = {name: _unexplained(np.array(found)[:, some], dq[:, some], effort[:, some])
            for name, found in rows.items()}
    best = min(OTHERS, key=lambda name: left[name] * (1.0 if name == 'none' else SIMPLER))
    if left['usual'] <= BETTER * left[best]:
        return Down(USUAL, (USUAL,), '')
    alike = ['none'] if best == 'none' else [
        name for name in OTHERS if name != 'none' and left[name] <= SIMPLER * left[best]]
    names = 'off' if best == 'none' else f'along {" or ".join(alike)}'
    return Down(OTHERS[best], tuple(OTHERS[name] for name in alike), (
        f'{100 * left[best]:.3g} % of the variance of the efforts left with gravity {names}, '
        f'{100 * left["usual"]:.3g} % with it along -z'))
