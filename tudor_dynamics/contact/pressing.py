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

"""What a force on a span of a link does to a driven arm: coordinates and gauges, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.contact.layout import ACROSS, ALONG, MOMENT, PRESSING
from tudor_dynamics.contact.span import Span
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.models.elastic.kernel import Driven, driven_of
from tudor_dynamics.models.elastic.setup import GaugePlaces
from tudor_dynamics.models.elastic.statics import FORCE, residual
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.simulation.mechanics.chain import Chain
from tudor_dynamics.simulation.mechanics.mechanism import Mechanism
from tudor_dynamics.simulation.mechanics.point_load import put_force, unsaid
from tudor_dynamics.simulation.mechanics.vector import add, times
from tudor_dynamics.typing import FloatArray


@compiled
def _put(
    chain: Chain, body: int, side: int, place: float, across: float, along: float,
) -> None:
    here = chain.moving[body]
    x = (here[at.WORLD], here[at.WORLD + 3], here[at.WORLD + 6])
    y = (here[at.WORLD + side], here[at.WORLD + 3 + side], here[at.WORLD + 6 + side])
    put_force(chain, body, place, add(times(across, y), times(along, x)))


@compiled
def _generalised(driven: Driven, column: NDArray) -> None:
    vectors, free = driven.equations.vectors, driven.equations.free
    residual(vectors, driven.gears, driven.chain, True)
    for a in range(free.shape[0]):
        column[a] = -vectors[FORCE, free[a]]


@compiled
def pressing_columns(
    body: int, side: int, sign: float, inner: float, outer: float, start: float,
    pushed: NDArray, *arrays: NDArray,
) -> None:
    """
    Write the generalised forces of a unit of what presses on a span.

    inner, outer, start [m]; writes pushed (m, PRESSING).
    """
    driven = driven_of(arrays)
    m, chain = pushed.shape[0], driven.chain
    none, near, far = np.zeros(m), np.zeros(m), np.zeros(m)
    _generalised(driven, none)
    _put(chain, body, side, inner, sign, 0.0)
    _generalised(driven, near)
    chain.wrench[:] = 0.0
    _put(chain, body, side, outer, sign, 0.0)
    _generalised(driven, far)
    chain.wrench[:] = 0.0
    _put(chain, body, side, inner, 0.0, 1.0)
    _generalised(driven, pushed[:, ALONG])
    chain.wrench[:] = 0.0
    _generalised(driven, none)
    for a in range(m):
        slope = (far[a] - near[a]) / (outer - inner)
        pushed[a, ACROSS] = near[a] - none[a] - (inner + start) * slope
        pushed[a, MOMENT] = slope
        pushed[a, ALONG] -= none[a]


class Pressing:
    """
    A span of a link, as compiled code has it.

    along, across (3,), through (gauges, PRESSING).
    """

    def __init__(
        self, span: Span, along: FloatArray, across: FloatArray, mechanism: Mechanism,
        gauges: GaugePlaces,
    ) -> None:
        if span.joint not in mechanism.beams:
            msg = f'the link of {span.joint!r} is rigid: no gauge tells where it is pushed'
            raise SimulationError(msg)
        body = mechanism.body_of[span.joint]
        floats = mechanism.body_float[body]
        length = float(floats[at.LENGTH])
        frame = floats[at.BODY_ROTATION:at.BODY_ROTATION + 9].reshape(3, 3)
        start = float(floats[at.BODY_PLACE:at.BODY_PLACE + 3] @ along)
        own = (gauges.body == body)
        plane = int(gauges.axis[own][0])
        side = 1 if plane == 2 else 2
        sign = 1.0 if float(frame[:, side] @ across) > 0.0 else -1.0
        inner, outer = (min(max(end - start, 0.0), length) for end in span.ends)
        self.numbers = (body, side, sign, inner, outer, start)
        self.through: FloatArray = np.zeros((len(gauges.body), PRESSING))
        for g in np.flatnonzero(own & (gauges.axis == plane)).tolist():
            # the moment about z of a force along y, and about y of one along z
            turned = float(gauges.sign[g]) * sign * (1.0 if plane == 2 else -1.0)
            near, far = (turned * unsaid(place, float(gauges.place[g]), length, 1)
                         for place in (inner, outer))
            slope = (far - near) / (outer - inner)
            self.through[g, ACROSS] = near - (inner + start) * slope
            self.through[g, MOMENT] = slope
