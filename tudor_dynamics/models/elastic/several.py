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

"""Several arms of one description, or several motions of one arm, side by side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.lanes import in_lanes, LANES, side_by_side
from tudor_dynamics.models.elastic.arm import DrivenArm, NO_GAINS
from tudor_dynamics.models.elastic.corrected import CorrectedArm
from tudor_dynamics.models.elastic.kernel import look, move, sense, tables_of
from tudor_dynamics.typing import FloatArray

TOO_FAR = 1e6
"""Where a state has gone beyond all bounds, as in ``kernel.advance``."""


@compiled
def follow_several(
    q: NDArray, dt: NDArray, inner: float, loaded: bool, measured: NDArray, gains: NDArray,
    moment: NDArray, torque: NDArray, *arrays: NDArray,
) -> int:
    """
    Follow a stretch of samples with several arms side by side, which have begun before it.

    q, dt, inner, loaded, gains: no time is 0.
    """
    shown, read, passed = in_lanes((measured, moment, torque))
    driven = tables_of(in_lanes(arrays))
    for k in range(q.shape[0]):
        if not move(driven, q[k], dt[k], inner, loaded):
            return k
        look(driven, loaded, k, shown, gains, read, passed)
    return q.shape[0]


def follow_together(
    arms: Sequence[CorrectedArm], q: FloatArray, dt: FloatArray,
    measured: Sequence[FloatArray] | None = None, gains: FloatArray = NO_GAINS,
) -> list[FloatArray | None]:
    """
    Follow one motion with several arms at once, in hardly more time than with one.

    q (samples, joints) [rad or m], measured (samples, gauges) [N m], gains
    (samples, 3, moving, gauges), dt (samples,) [s]; returns (samples, gauges) [N m], None for one
    that finds no equilibrium, or diverges.
    """
    towards = [np.zeros((len(q), 0))] * len(arms) if measured is None else [
        arm.ahead(dt, one) for arm, one in zip(arms, measured, strict=True)]
    begun: dict[int, FloatArray] = {}
    end = len(q) if len(arms) == 1 else 1
    for i, arm in enumerate(arms):
        try:
            begun[i] = arm.prompt(q[:end], dt[:end], towards[i][:end], gains).moment
        except SimulationError:
            continue
    found = begun
    if end < len(q):
        rest = _behind_the_first(arms, [*begun], q[1:], dt[1:], towards, gains[1:])
        found = {i: np.vstack([begun[i], moment]) for i, moment in rest.items()}
    return [arm.late(found[i], dt) if i in found else None for i, arm in enumerate(arms)]


def _behind_the_first(
    arms: Sequence[CorrectedArm], lanes: list[int], q: FloatArray, dt: FloatArray,
    towards: Sequence[FloatArray], gains: FloatArray,
) -> dict[int, FloatArray]:
    """Follow from the second sample on; who diverges is left out, and the rest begins again."""
    while lanes:
        arrays = [side_by_side(same) if same[0].dtype == float else same[0].copy()
                  for same in zip(*[arms[i].arrays for i in lanes], strict=True)]
        moment = np.zeros((len(q), len(arms[0].gauges.body), LANES))
        done = follow_several(
            np.ascontiguousarray(q), np.ascontiguousarray(dt), arms[0].inner, arms[0].loaded,
            side_by_side([towards[i][1:] for i in lanes]), gains, moment,
            np.zeros((len(q), q.shape[1], LANES)), *arrays)
        if done == len(q):
            return {i: np.ascontiguousarray(moment[:, :, lane]) for lane, i in enumerate(lanes)}
        size = np.abs(arrays[0]).sum(axis=(0, 1))[:len(lanes)]
        # a matrix that cannot be factorised leaves no trace: then the widest state goes
        lost = ~(size < TOO_FAR) if not np.all(size < TOO_FAR) else size == size.max()
        lanes = [i for i, gone in zip(lanes, lost, strict=True) if not gone]
    return {}


@compiled
def follow_paths(
    q: NDArray, dt: float, inner: float, loaded: bool, moment: NDArray, torque: NDArray,
    *arrays: NDArray,
) -> int:
    """
    Follow several motions with one arm each, side by side, which have begun before them.

    q (samples, springs, LANES), dt [s].
    """
    paths, read, passed = in_lanes((q, moment, torque))
    driven = tables_of(in_lanes(arrays))
    for k in range(paths.shape[0]):
        if not move(driven, paths[k], dt, inner, loaded):
            return k
        sense(driven, loaded, read[k], passed[k])
    return paths.shape[0]


def follow_motions(arm: DrivenArm, motions: FloatArray, dt: float) -> FloatArray:
    """
    Follow several motions from one pose, eight of them in hardly more time than one.

    motions (motions, samples, joints) [rad or m], dt [s]; returns (motions, samples, gauges)
    [N m].
    """
    rest = arm.prompt(motions[0, :1], np.zeros(1), np.zeros((1, 0)), NO_GAINS).moment
    found = []
    for first in range(0, len(motions), LANES):
        group = motions[first:first + LANES, 1:]
        arrays = [side_by_side([array]) if array.dtype == float else array.copy()
                  for array in arm.arrays]
        moment = np.zeros((group.shape[1], len(arm.gauges.body), LANES))
        done = follow_paths(side_by_side(list(group)), dt, arm.inner, arm.loaded, moment,
                            np.zeros((*group.shape[1:], LANES)), *arrays)
        if done < group.shape[1]:
            raise SimulationError(f'{arm.arm.name}: the elastic model diverges after {done} of '
                                  f'{group.shape[1]} samples of a planned motion')
        found.append(np.moveaxis(moment, -1, 0)[:len(group)])
    moments = np.concatenate(found)
    return np.concatenate([np.broadcast_to(rest, (len(moments), *rest.shape)), moments], axis=1)
