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

"""An arm that follows measured positions and is drawn towards measured strain, compiled."""

from __future__ import annotations

from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.models.elastic.kernel import begin, move, sense
from tudor_dynamics.models.elastic.statics import ACC, DDZ, DZ, Z


@compiled
def follow_corrected(
    measured: NDArray, gains: NDArray,
    q: NDArray, dt: NDArray, inner: float, vectors: NDArray, matrices: NDArray, factor: NDArray,
    delta: NDArray, free: NDArray, past: NDArray, path: NDArray, aim: NDArray,
    aim_rate: NDArray, springs: NDArray, spring_at: NDArray, base: NDArray, wrench: NDArray,
    loaded: bool, columns: NDArray, owner: NDArray, inertias: NDArray, body_int: NDArray,
    body_float: NDArray, coordinate: NDArray, moving: NDArray, reaction: NDArray,
    gauge_body: NDArray, gauge_place: NDArray, gauge_axis: NDArray, gauge_gain: NDArray,
    loads: NDArray, moment: NDArray, torque: NDArray,
) -> int:
    """
    Follow a stretch of samples, corrected behind each by given gains.

    Parameters
    ----------
    measured : ndarray of shape (n_samples, n_gauges)
        Moments that the gauges show [N m].
    gains : ndarray of shape (n_samples, 3, m, n_gauges)
        What a moment that was not predicted changes in coordinates, rates and accelerations.
    q, dt, inner, vectors, matrices, factor, delta, free, past, path, aim, aim_rate, springs
        As in ``follow``.
    spring_at, base, wrench, loaded, columns, owner, inertias, body_int, body_float, coordinate
        As in ``follow``.
    moving, reaction, gauge_body, gauge_place, gauge_axis, gauge_gain, loads, moment, torque
        As in ``follow``.

    Returns
    -------
    int
        Samples done; fewer than given where the state is no longer finite.

    """
    for k in range(q.shape[0]):
        if dt[k] <= 0.0:
            good = begin(q[k], vectors, matrices, factor, delta, free, past, aim, aim_rate,
                         springs, spring_at, base, wrench, loaded, body_int, body_float,
                         coordinate, moving, reaction)
        else:
            good = move(q[k], dt[k], inner, vectors, matrices, factor, delta, free, past, path,
                        aim, aim_rate, springs, spring_at, base, wrench, loaded, columns, owner,
                        inertias, body_int, body_float, coordinate, moving, reaction)
        if not good:
            return k
        sense(vectors, aim, aim_rate, springs, spring_at, base, wrench, loaded, body_int,
              body_float, coordinate, moving, reaction, gauge_body, gauge_place, gauge_axis,
              gauge_gain, loads, moment[k], torque[k])
        for g in range(measured.shape[1]):
            unexpected = measured[k, g] - moment[k, g]
            for a in range(free.shape[0]):
                i = free[a]
                vectors[Z, i] += gains[k, 0, a, g] * unexpected
                vectors[DZ, i] += gains[k, 1, a, g] * unexpected
                vectors[DDZ, i] += gains[k, 2, a, g] * unexpected
                vectors[ACC, i] += gains[k, 2, a, g] * unexpected
    return q.shape[0]
