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

"""Where contacts are looked for, and what gauges of a rigid or an elastic arm read of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
import pinocchio as pin

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.kinematics import gauge_axis, gauge_point, link_reach, unit_vector
from tudor_dynamics.compiled import compiled
from tudor_dynamics.errors import ModelError, SimulationError
from tudor_dynamics.load.settings import GAIN_STD, UNKNOWN_STD
from tudor_dynamics.mechanics import chain as at
from tudor_dynamics.mechanics.chain import add, times
from tudor_dynamics.mechanics.equations import put_force, unsaid
from tudor_dynamics.mechanics.mechanism import beam_axes, GaugePlace, Mechanism
from tudor_dynamics.models.base import MemorylessModel, Model
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.models.elastic.kernel import (
    Driven, driven_of, DZ, FORCE, Linearised, residual, STIFF, STIFFNESS, Z)
from tudor_dynamics.models.elastic.model import driven_arm, ElasticModel
from tudor_dynamics.models.elastic.observer import white_force
from tudor_dynamics.online.settings import (
    DEVIATION_STEP, FOLLOWING_RATE, FORCE_CHANGE, POSE_CHANGE, PUSH_DEVIATION, SLOWEST_STATIC,
    SPAN_LENGTH, VIBRATION_RATE)
from tudor_dynamics.typing import FloatArray


ACROSS, MOMENT, ALONG = range(3)
PRESSING = 3  # how many there are


def gauge_gain(arm: Arm, model: Model | None) -> FloatArray:
    """Give reading per moment [unit per N m], (gauges,); NaN where nobody knows."""
    if isinstance(model, ElasticModel) and model.coefficients_ is not None:
        return np.array([values[0] for values in model.coefficients_])
    sensors = {sensor.gauge: sensor.gain for sensor in arm.spec.sensors}
    return np.array([sensors.get(name, np.nan) for name in arm.gauge_names])


def newtons_of(arm: Arm, model: Model) -> tuple[float, float]:
    """Give true newtons over those of a model, NaN if unknown, and what part of it is in doubt."""
    if not isinstance(model, ElasticModel):
        return 1.0, GAIN_STD
    # strain alone cannot see a factor that all masses and stiffnesses have too much
    gain, given = np.abs(gauge_gain(arm, model)), np.abs(gauge_gain(arm, None))
    doubt = max((float(error[0] / own) for error, own in zip(
        model.standard_errors_ or (), gain, strict=False)), default=0.0)
    if doubt > GAIN_STD and np.isfinite(given).any():
        return float(np.nanmedian(gain / given)), GAIN_STD
    return 1.0 if doubt < UNKNOWN_STD else math.nan, doubt


def validation_rmse(bundle: ModelBundle, output: str, kind: str) -> FloatArray | None:
    """Give the RMSE of each channel in the validation of a fit; None where there was none."""
    facts: Any = bundle.facts.get('validation')
    try:
        channels = facts[output][kind]['validation']['channels']
        return np.array([float(channels[name]['rmse']) for name in bundle.arm.channels[output]])
    except (KeyError, TypeError, ValueError):
        return None


def strain_deviation(bundle: ModelBundle, kind: str) -> FloatArray:
    """Give the standard deviation of strain residuals in free motion (gauges,), NaN if unknown."""
    noise = getattr(bundle.models['strain'][kind], 'noise_', None)
    if noise is not None:
        return np.array(noise, dtype=float)
    found = validation_rmse(bundle, 'strain', kind)
    if found is not None:
        return found
    sensors = {sensor.gauge: sensor.noise for sensor in bundle.arm.spec.sensors}
    return np.array([sensors.get(name) or np.nan for name in bundle.arm.gauge_names])


def torque_scale(arm: Arm) -> FloatArray:
    """Give the torque at active joints per unit of effort [N m or N]; NaN where unknown."""
    return np.where([joint.effort.unit == 'A' for joint in arm.joints], arm.torque_constants, 1.0)


# Where on the links a contact is looked for.
#
# What is estimated on a span is (F, F a, A): the force across the link, its moment about the
# joint, and the force along the link. Forces at the two ends of the span stand for a push between
# them, so all that lies inboard or outboard of the span feels the push itself: spans end at
# gauges.


@dataclass(frozen=True)
class Span:
    """A part of a link, and what is known of a contact there before anything was measured."""

    joint: str  # joint that moves the link
    # Ends, from the joint along the link; equal where the place is known [m].
    inner: float
    outer: float
    along: float = 0.0  # standard deviation of the force along the link [N]

    @property
    def middle(self) -> float:
        """Mean of the place before anything is known [m]."""
        return 0.5 * (self.inner + self.outer)

    @property
    def ends(self) -> tuple[float, float]:
        """Two different places that stand for all between them [m]."""
        return min(self.inner, self.outer - SPAN_LENGTH), self.outer

    @property
    def spread(self) -> float:
        """Give the standard deviation of the place before anything is known [m]."""
        return (self.outer - self.inner) / math.sqrt(12.0)

    @property
    def weight(self) -> float:
        """How likely a contact is here before anything is known, up to a factor [m]."""
        return self.outer - self.inner or self.outer  # an end stands for the whole link

    @property
    def covariance(self) -> FloatArray:
        """Covariance of what presses, any place as likely as another [N, N m, N]."""
        across, middle = PUSH_DEVIATION**2, self.middle
        return np.array([[across, across * middle, 0.0],
                         [across * middle, across * (middle**2 + self.spread**2), 0.0],
                         [0.0, 0.0, self.along**2]])


@dataclass(frozen=True, eq=False)
class LinkAxes:
    """Directions of a link in the frame of its joint."""

    # (3,): along the link, across it in the plane that its gauges see, and the axis they bend
    # about.
    along: FloatArray
    across: FloatArray
    bending: FloatArray


def link_axes(arm: Arm, joint: str) -> LinkAxes:
    """Give the directions of a link that has gauges."""
    gauge = next(gauge for gauge in arm.gauges if gauge.joint == joint)
    along, bending = unit_vector(gauge.direction), gauge_axis(arm.full_model, gauge)
    return LinkAxes(along, np.cross(bending, along), bending)


def link_end(arm: Arm, joint: str) -> float | None:
    """Give how far a link with gauges reaches from its joint [m]; None where nobody knows."""
    farthest = max(gauge.distance for gauge in arm.gauges if gauge.joint == joint)
    end = link_reach(arm.full_model, joint, link_axes(arm, joint).along)
    return end if end > farthest + SPAN_LENGTH else None


def spans_of(arm: Arm, known: Sequence[bool]) -> tuple[Span, ...]:
    """Divide the links at their gauges; none where no gauge has a scale, or no link a length."""
    # A contact inboard of a link's first gauge is felt by the gauges of links before it alone, as
    # a contact of those. With one gauge a link, two of them in one plane show a force at the tip.
    places: dict[str, list[float]] = {}
    for gauge, counts in zip(arm.gauges, known, strict=True):
        if counts:
            places.setdefault(gauge.joint, []).append(gauge.distance)
    order = sorted(places, key=arm.full_model.getJointId)
    spans = []
    for number, joint in enumerate(order):
        end = link_end(arm, joint)
        if end is None:
            continue
        own = sorted(set(places[joint]))
        along = PUSH_DEVIATION if number else 0.0
        if len(own) == 1 and joint == order[-1]:
            spans.append(Span(joint, end, end, along=along))
            continue
        spans += [Span(joint, near, far, along=along)
                  for near, far in zip(own, [*own[1:], end], strict=True)]
    return tuple(spans)


class RigidFront:
    """A rigid arm: levers of forces on spans about the gauges, gain (gauges,) [unit per N m]."""

    modes = 0

    def __init__(self, arm: Arm, spans: Sequence[Span], gain: FloatArray) -> None:
        self._spans, self._gain, self._model = spans, gain, arm.full_model
        self._data = self._model.createData()
        self._q, self._columns = arm.held_pose()
        self._gauges = [
            (self._model.getJointId(gauge.joint), gauge_point(gauge),
             gauge_axis(self._model, gauge), gauge.distance) for gauge in arm.gauges]
        self._axes = [link_axes(arm, span.joint) for span in spans]

    def residual(
        self, dt: float, row: FloatArray, measured: FloatArray, residual: FloatArray | None,
    ) -> FloatArray | None:
        """Give the residual as moments (gauges,) [N m]; None where the model has none."""
        if residual is None:
            return None
        self._now = self.rows(row)
        return np.asarray(residual / self._gain)

    def carry(
        self, number: int, state: FloatArray, covariance: FloatArray, dt: float, fade: float,
        rise: FloatArray, calm: float,
    ) -> FloatArray:
        """Carry what presses on a span to the newest sample; see `ElasticFront.carry`."""
        state *= fade
        covariance *= fade * fade
        covariance += rise
        return self._now[number]

    def settle(self, left: FloatArray, dt: float, states: FloatArray) -> None:
        """Do nothing: a rigid arm has no state of its own."""

    def rows(self, row: FloatArray) -> list[FloatArray]:
        """Give the moment at gauges by what presses, span by span: (gauges, PRESSING)."""
        self._q[self._columns] = row[:len(self._columns)]
        pin.forwardKinematics(self._model, self._data, self._q)
        return [self._levers(span, axes)
                for span, axes in zip(self._spans, self._axes, strict=True)]

    def _levers(self, span: Span, axes: LinkAxes) -> FloatArray:
        own = self._model.getJointId(span.joint)
        near, far = span.ends
        result = np.zeros((len(self._gauges), PRESSING))
        for g, (joint, _, _, distance) in enumerate(self._gauges):
            if joint not in self._model.supports[own]:
                continue
            # inboard of a gauge on the same link nothing bends it
            inner = 0.0 if joint == own and near <= distance else self._moment(
                g, own, near * axes.along, axes.across)
            outer = self._moment(g, own, far * axes.along, axes.across)
            slope = (outer - inner) / (far - near)
            result[g] = (inner - near * slope, slope,
                         self._moment(g, own, far * axes.along, axes.along))
        return result

    def _moment(self, g: int, own: int, at: FloatArray, direction: FloatArray) -> float:
        """Give the moment at a gauge by a unit force at a point of a link."""
        joint, point, axis, _ = self._gauges[g]
        link, carrier = self._data.oMi[own], self._data.oMi[joint]
        lever = link.act(at) - carrier.act(point)
        return -float((carrier.rotation @ axis) @ np.cross(lever, link.rotation @ direction))


# What a force on a link of an elastic arm does to its gauges, compiled.

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
    m, none = pushed.shape[0], np.zeros(pushed.shape[0])
    for column, (place, across, along) in enumerate(
            ((inner, sign, 0.0), (outer, sign, 0.0), (inner, 0.0, 1.0))):
        here = driven.chain.moving[body]
        x = (here[at.WORLD], here[at.WORLD + 3], here[at.WORLD + 6])
        y = (here[at.WORLD + side], here[at.WORLD + 3 + side], here[at.WORLD + 6 + side])
        put_force(driven.chain, body, place, add(times(across, y), times(along, x)))
        _generalised(driven, pushed[:, column])
        driven.chain.wrench[:] = 0.0
    _generalised(driven, none)
    for a in range(m):
        near, far = pushed[a, 0], pushed[a, 1]
        slope = (far - near) / (outer - inner)
        pushed[a, ACROSS] = near - none[a] - (inner + start) * slope
        pushed[a, MOMENT] = slope
        pushed[a, ALONG] -= none[a]


class Pressing:
    """A span of a link, as compiled code has it."""

    def __init__(
        self, span: Span, axes: LinkAxes, mechanism: Mechanism, gauges: Sequence[GaugePlace],
    ) -> None:
        if span.joint not in mechanism.beams:
            raise ModelError(f'the link of {span.joint!r} has gauges, but no links[].flexible; '
                             'describe its beam there to estimate contacts')
        body = mechanism.body_of[span.joint]
        floats = mechanism.body_float[body]
        length = float(floats[at.LENGTH])
        start = float(floats[at.BODY_PLACE:at.BODY_PLACE + 3] @ axes.along)
        plane = next(gauge.axis for gauge in gauges if gauge.body == body)
        side = 1 if plane == 2 else 2
        sign = 1.0 if float(beam_axes(floats)[:, side] @ axes.across) > 0.0 else -1.0
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
    inverse = np.linalg.inv(np.linalg.cholesky(small[0]))
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
        cosine, sine = decay * math.cos(ringing * dt), decay * math.sin(ringing * dt) / ringing
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
        m, tables = driven.size, driven.tables
        self._pressing = [Pressing(span, link_axes(model.arm, span.joint), driven.mechanism,
                                   driven.gauges) for span in spans]
        places = tables.gears.place
        self._geared = np.searchsorted(tables.equations.free, places)
        self._engaged = (tables.equations.matrices[STIFFNESS, places, places]
                         + tables.gears.springs[:, STIFF])
        driven.start_observer(moment_deviation, FOLLOWING_RATE)
        self._small, self._white, self._shown = driven.small, driven.pushed, driven.shown
        self._acting = [np.zeros((m, PRESSING)) for _ in spans]
        driven.follow(np.tile(tables.equations.vectors[Z, places], (2, 1)), np.array([0.0, 1e-3]))
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

    def residual(
        self, dt: float, row: FloatArray, measured: FloatArray, residual: FloatArray | None,
    ) -> FloatArray | None:
        """Go to the next sample, dt 0 to restart at rest; gives the residual as moments [N m]."""
        if dt <= 0.0:
            self._driven.forget()
            self._basis[:] = self._first  # what went before may have been no arm any more
        moment = self._driven.follow(row[None, :len(row) // 3], np.array([dt])).moment[0]
        if dt > 0.0:  # after a restart matrices come with the next sample, which moves it
            self._before = self._basis.copy()
            try:
                self._linearise()
                slow_modes(self._small, self._basis, self._squares, self._rates)
                self._flexible = np.linalg.inv(self._small[2]) - (
                    self._basis / self._squares) @ self._basis.T
            except np.linalg.LinAlgError as err:
                raise SimulationError('the modes of the elastic model cannot be computed at this '
                                      f'pose ({err}); fit it to bags with such poses') from None
        return np.asarray((measured - self._zero) / self._gain - moment)

    def settle(self, left: FloatArray, dt: float, states: FloatArray) -> None:
        """Draw the arm to what was measured, and hypotheses the other way."""
        # An arm in its play, or far from where it is linearised, is no linear one. The followed
        # arm takes over what the true one does, and the states, which are the difference of both,
        # know of it.
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
        driven.linearise()
        # teeth that bear: in its play a gear takes no force, where a contact ends it does
        self._small[2, self._geared, self._geared] = self._engaged
        for item, columns in zip(self._pressing, self._acting, strict=True):
            pressing_columns(*item.numbers, columns, *driven.arrays)


# -- What gauges of a resting arm read of a force at the tip

StaticReadings = tuple[FloatArray, FloatArray | None]
"""Readings (gauges,) of the weight of the arm, but for constants, in units of the gauges; those of
a unit force [1/N], None where only levers are known."""


class StaticStrain:
    """Readings of gauges of a resting arm."""

    def __init__(
        self, arm: Arm, model: Model | None = None,
        normal: tuple[float, float, float] = (0.0, 0.0, 1.0),
    ) -> None:
        self._normal = np.array(normal) / np.linalg.norm(normal)
        self._force = 0.0
        self._last: StaticReadings | None = None
        self._at = np.zeros(len(arm.active_joints))
        self._model = model if isinstance(model, MemorylessModel) else None
        self._driven: DrivenArm | None = None
        self._zero = np.zeros(len(arm.gauges))
        self.source = 'none'
        if self._model is not None:
            self.source = 'model'
            return
        self._gain = np.nan_to_num(gauge_gain(arm, model))
        values: dict[str, float] = (
            dict(model.values) if isinstance(model, ElasticModel)
            and model.coefficients_ is not None else {})
        try:
            self._driven = DrivenArm(arm)
            self._driven.set_parameters(values)
        except SimulationError:
            self._driven = None
            return
        self.source = 'elastic model' if values else 'description'

    def at(self, q: FloatArray, force: float = 0.0) -> StaticReadings:
        """Give the readings at a pose under a force [N], whose levers change as the arm bends."""
        force = max(force, FORCE_CHANGE)
        if (self._last is None or float(np.abs(q - self._at).max()) > POSE_CHANGE
                or abs(force - self._force) > FORCE_CHANGE):
            self._last, self._at, self._force = self._solve(q, force), q.copy(), force
        return self._last

    def _solve(self, q: FloatArray, force: float) -> StaticReadings:
        if self._model is not None:
            row = np.concatenate([q, np.zeros(2 * len(q))])[None]
            return np.asarray(self._model.predict(row)[0]), None
        if self._driven is None:
            return self._zero, None
        driven = self._driven
        try:
            free = driven.follow(q[None], np.zeros(1)).moment[0]
            driven.tables.chain.wrench[driven.mechanism.tip, :3] = force * self._normal
            driven.loaded = True
            pressed = driven.follow(q[None], np.zeros(1)).moment[0]
        except SimulationError:
            return self._zero, None
        finally:
            driven.tables.chain.wrench[:] = 0.0
            driven.loaded = False
        return free * self._gain, (pressed - free) * self._gain / force
