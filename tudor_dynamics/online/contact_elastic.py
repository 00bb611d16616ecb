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

"""What a force on a link of an elastic arm does to its gauges."""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.mechanics import chain as at
from tudor_dynamics.mechanics.chain import add, Chain, times
from tudor_dynamics.mechanics.equations import put_force, unsaid
from tudor_dynamics.mechanics.mechanism import beam_axes, GaugePlace, Mechanism
from tudor_dynamics.models.elastic.arm import moment_rows
from tudor_dynamics.models.elastic.kernel import (
    Driven, driven_of, DZ, FORCE, Linearised, residual, STIFF, STIFFNESS, Z)
from tudor_dynamics.models.elastic.model import driven_arm, ElasticModel
from tudor_dynamics.models.elastic.observer import FORCES, linearise, white_force
from tudor_dynamics.online.contact_levers import ACROSS, ALONG, link_axes, MOMENT, PRESSING, Span
from tudor_dynamics.online.settings import (
    DEVIATION_STEP, FOLLOWING_RATE, SLOWEST_STATIC, VIBRATION_RATE)
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
    """Write the generalised forces (m, PRESSING) of a unit of what presses on a span [m]."""
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
    """A span of a link, as compiled code has it."""

    def __init__(
        self, span: Span, along: FloatArray, across: FloatArray, mechanism: Mechanism,
        gauges: Sequence[GaugePlace],
    ) -> None:
        if span.joint not in mechanism.beams:
            msg = f'the link of {span.joint!r} is rigid: no gauge shows where it is pushed'
            raise SimulationError(msg)
        body = mechanism.body_of[span.joint]
        floats = mechanism.body_float[body]
        length = float(floats[at.LENGTH])
        start = float(floats[at.BODY_PLACE:at.BODY_PLACE + 3] @ along)
        plane = next(gauge.axis for gauge in gauges if gauge.body == body)
        side = 1 if plane == 2 else 2
        sign = 1.0 if float(beam_axes(floats)[:, side] @ across) > 0.0 else -1.0
        inner, outer = (min(max(end - start, 0.0), length) for end in span.ends)
        self.numbers = (body, side, sign, inner, outer, start)
        self.through: FloatArray = np.zeros((len(gauges), PRESSING))
        for through, gauge in zip(self.through, gauges, strict=True):
            if gauge.body != body or gauge.axis != plane:
                continue
            # the moment about z of a force along y, and about y of one along z
            turned = gauge.sign * sign * (1.0 if plane == 2 else -1.0)
            near, far = (turned * unsaid(place, gauge.distance, length, 1)
                         for place in (inner, outer))
            slope = (far - near) / (outer - inner)
            through[ACROSS], through[MOMENT] = near - (inner + start) * slope, slope


# The slow vibrations of an arm where it is, and what presses carried along with them, compiled.
#
# Modes above a limit follow a force at once: they are taken as statics, so that no sample rate is
# too low for them. The others are carried exactly over a sample, as oscillators under a constant
# force.

@compiled
def slow_modes(small: NDArray, basis: NDArray, squares: NDArray, rates: NDArray) -> None:
    """Find the slowest modes, of a mass of one: basis (m, c), squares, damping rates (c,)."""
    lower = np.linalg.cholesky(small[0])
    inverse = np.linalg.inv(lower)
    values, vectors = np.linalg.eigh(inverse @ small[2] @ inverse.T)
    count = squares.shape[0]
    basis[:] = (inverse.T @ vectors)[:, :count]
    for i in range(count):
        squares[i] = max(values[i], 1.0)
        shape = basis[:, i].copy()
        rates[i] = max(shape @ (small[1] @ shape), 0.0)


@compiled
def turn_basis(before: NDArray, mass: NDArray, now: NDArray, state: NDArray, covariance: NDArray,
               ) -> None:
    """Describe the same vibration by the modes of another pose."""
    c, n = before.shape[1], state.shape[0]
    change = now.T @ mass @ before
    whole = np.eye(n)
    whole[:c, :c] = change
    whole[c:2 * c, c:2 * c] = change
    state[:] = whole @ state
    covariance[:] = whole @ covariance @ whole.T


@compiled
def carry(
    state: NDArray, covariance: NDArray, squares: NDArray, rates: NDArray, white: NDArray,
    acting: NDArray, dt: float, noise: float, fade: float, rise: NDArray,
) -> None:
    """Carry state and covariance over one sample."""
    c, k, n = squares.shape[0], acting.shape[1], state.shape[0]
    step, entering = np.zeros((n, n)), np.zeros((n, white.shape[1]))
    for i in range(c):
        slow = min(0.5 * rates[i], 0.95 * math.sqrt(squares[i]))
        ringing = math.sqrt(squares[i] - slow * slow)
        decay = math.exp(-slow * dt)
        cosine, sine = (decay * math.cos(ringing * dt),
                        decay * math.sin(ringing * dt) / ringing)
        step[i, i], step[i, c + i] = cosine + slow * sine, sine
        step[c + i, i], step[c + i, c + i] = -squares[i] * sine, cosine - slow * sine
        place, speed = (1.0 - step[i, i]) / squares[i], sine
        for j in range(k):
            step[i, 2 * c + j], step[c + i, 2 * c + j] = place * acting[i, j], speed * acting[i, j]
        for j in range(white.shape[1]):
            entering[i, j], entering[c + i, j] = place * white[i, j], speed * white[i, j]
    for j in range(k):
        step[2 * c + j, 2 * c + j] = fade
    state[:] = step @ state
    covariance[:] = step @ covariance @ step.T + noise / dt * (entering @ entering.T)
    covariance[2 * c:, 2 * c:] += rise


@compiled
def correct(
    state: NDArray, covariance: NDArray, rows: NDArray, variance: NDArray, measured: NDArray,
    trusted: float,
) -> float:
    """Correct a state by what gauges show [N m] beyond the model; NaN does not count."""
    n, likely = state.shape[0], 0.0
    # one gauge after the other: their noise is independent
    for g in range(measured.shape[0]):
        if math.isnan(measured[g]):
            continue
        row = covariance @ rows[g]
        spread = variance[g] + rows[g] @ row
        left = measured[g] - rows[g] @ state
        size = abs(left) / math.sqrt(spread)
        cut = min(size, trusted)
        likely -= cut * (size - 0.5 * cut) + 0.5 * math.log(2.0 * math.pi * spread)
        for i in range(n):
            state[i] += row[i] / spread * left
            for j in range(n):
                covariance[i, j] -= row[i] * row[j] / spread
    for i in range(n):
        for j in range(i):
            covariance[i, j] = covariance[j, i] = 0.5 * (covariance[i, j] + covariance[j, i])
    return likely


class ElasticFront:
    """An elastic arm that follows positions, uncorrected, and is linearised as it goes."""

    def __init__(
        self, model: ElasticModel, spans: Sequence[Span], gain: FloatArray,
        moment_deviation: FloatArray,
    ) -> None:
        self._gain = gain
        self._zero = np.array([values[1] for values in model.coefficients_ or ()])
        self._driven = driven = driven_arm(model.arm, model.values)
        m = driven.size
        tables = driven.tables
        self._shown = moment_rows(driven.mechanism, driven.gauges, tables.equations.free)
        self._pressing = []
        for span in spans:
            axes = link_axes(model.arm, span.joint)
            self._pressing.append(Pressing(
                span, axes.along, axes.across, driven.mechanism, driven.gauges))
        places = tables.gears.place
        self._geared = np.searchsorted(tables.equations.free, places)
        self._engaged = (tables.equations.matrices[STIFFNESS, places, places]
                         + tables.gears.springs[:, STIFF])
        driven.start_observer(moment_deviation, FOLLOWING_RATE)
        self._small: FloatArray = np.zeros((3, m, m))
        self._white: FloatArray = np.zeros((m, FORCES))
        self._acting = [np.zeros((m, PRESSING)) for _ in spans]
        driven.follow(np.tile(tables.equations.vectors[Z, places], (2, 1)),
                      np.array([0.0, 1e-3]))
        self._linearise()
        squares = np.linalg.eigvals(np.linalg.solve(self._small[0], self._small[2])).real
        count = max(1, int(np.sum(squares < (2.0 * np.pi * SLOWEST_STATIC) ** 2)))
        self._basis: FloatArray = np.zeros((m, count))
        self._squares: FloatArray = np.zeros(count)
        self._rates: FloatArray = np.zeros(count)
        slow_modes(self._small, self._basis, self._squares, self._rates)
        self._first = self._basis.copy()
        self.noise = DEVIATION_STEP * white_force(
            Linearised(*self._small), self._white, self._shown / moment_deviation[:, None],
            VIBRATION_RATE)

    @property
    def modes(self) -> int:
        """Give the number of vibrations that are carried along."""
        return len(self._squares)

    def follow(self, dt: float, row: FloatArray) -> FloatArray:
        """Go to the next sample, dt 0 to restart at rest; returns moments (gauges,) [N m]."""
        if dt <= 0.0:
            self._driven.forget()
            self._basis[:] = self._first  # what went before may have been no arm any more
        moment = self._driven.follow(row[None, :len(row) // 3], np.array([dt])).moment[0]
        if dt <= 0.0:
            return moment  # matrices come with the next sample, which moves it
        self._before = self._basis.copy()
        try:
            self._linearise()
            slow_modes(self._small, self._basis, self._squares, self._rates)
            self._flexible = np.linalg.inv(self._small[2]) - (
                self._basis / self._squares) @ self._basis.T
        except np.linalg.LinAlgError as err:
            raise SimulationError(f'the elastic model has no modes at this pose ({err}): its '
                                  'links bend too far; fit it again') from None
        return moment

    def residual(
        self, dt: float, row: FloatArray, measured: FloatArray, residual: FloatArray | None,
    ) -> FloatArray | None:
        """Give the residual as moments (gauges,) [N m]; arguments as in `follow`."""
        return np.asarray((measured - self._zero) / self._gain - self.follow(dt, row))

    def settle(self, left: FloatArray, dt: float, states: FloatArray) -> None:
        """
        Draw the arm to what was measured, and hypotheses the other way.

        An arm in its play, or far from where it is linearised, is no linear one. The followed arm
        takes over what the true one does, and the states, which are the difference of both, know
        of it.
        """
        equations, c = self._driven.tables.equations, self.modes
        before = equations.vectors[[Z, DZ]][:, equations.free]
        if not self._driven.correct(left, dt):
            return
        change = equations.vectors[[Z, DZ]][:, equations.free] - before
        states[:, :2 * c] -= (change @ self._small[0] @ self._basis).ravel()

    def carry(
        self, number: int, state: FloatArray, covariance: FloatArray, dt: float, fade: float,
        rise: FloatArray, calm: float,
    ) -> FloatArray:
        """Carry a hypothesis (2 c + PRESSING,) to the newest sample; returns its rows by gauge."""
        acting = self._acting[number]
        turn_basis(self._before, self._small[0], self._basis, state, covariance)
        carry(state, covariance, self._squares, self._rates, self._basis.T @ self._white,
              self._basis.T @ acting, dt, calm * self.noise, fade, rise)
        shown = self._shown @ self._basis
        return np.hstack([shown, np.zeros_like(shown), self._pressing[number].through
                          + self._shown @ self._flexible @ acting])

    def _linearise(self) -> None:
        driven = self._driven
        linearise(False, driven.mechanism.tip, *self._small, self._white, *driven.arrays)
        # teeth that bear: in its play a gear takes no force, where a contact ends it does
        self._small[2, self._geared, self._geared] = self._engaged
        for item, columns in zip(self._pressing, self._acting, strict=True):
            pressing_columns(*item.numbers, columns, *driven.arrays)
