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

"""An elastic arm whose joints follow measured positions, alone or several at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import InertiaPart
from tudor_dynamics.compiled import in_lanes, LANES, side_by_side, with_lanes
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.mechanics import chain as at
from tudor_dynamics.mechanics.equations import LOADS
from tudor_dynamics.mechanics.matrices import stiffness_matrix
from tudor_dynamics.mechanics.mechanism import build_mechanism, GaugePlace, Mechanism, place_gauge
from tudor_dynamics.models.elastic import kernel, observer
from tudor_dynamics.models.elastic.kernel import (
    DAMPING, Driven, Drives, Equations, Gauges, Gears, Linearised, look, MATRICES, move,
    SPRING_FLOATS, STIFFNESS, tables_of, tangents, VECTORS, Z)
from tudor_dynamics.models.elastic.observer import observe, white_force
from tudor_dynamics.models.elastic.parameters import apply, change, described, Physics
from tudor_dynamics.models.settings import INNER_STEP
from tudor_dynamics.signals.filters import low_pass
from tudor_dynamics.typing import FloatArray


# -- What a driven arm is made of: its reduced links, its gauges, the coordinates that move

def reduced_mechanism(arm: Arm) -> Mechanism:
    """Build the arm with one linear element a link; what lies within a link goes to its end."""
    links = []
    for link in arm.spec.links:
        beam = link.flexible
        if beam is not None:
            lumped = tuple(
                part if isinstance(part.node, str) else part.model_copy(
                    update={'node': 'tip' if 2 * part.node >= beam.elements else 'base'})
                for part in beam.lumped)
            beam = beam.model_copy(update={'elements': 1, 'stretch': False, 'lumped': lumped})
        links.append(link.model_copy(update={'flexible': beam}))
    mechanism = build_mechanism(arm.changed(
        links=tuple(links), payload=arm.spec.payload or InertiaPart(mass=0.0)))
    if not mechanism.beams:
        raise SimulationError(f'{arm.source}: no link is flexible; describe the beam in '
                              'links[].flexible to use the elastic model')
    return mechanism


def moving_coordinates(
    mechanism: Mechanism, gauges: Sequence[GaugePlace], springs: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Give the coordinates (moving,) that move: gears, and bending in planes that gauges see."""
    seen = {gauge.axis for gauge in gauges} or {1, 2}
    free = springs.tolist()
    for joint in mechanism.beams:
        own = {gauge.axis for gauge in gauges if gauge.joint == joint}
        first = int(mechanism.body_int[mechanism.body_of[joint], at.FIRST])
        for plane in sorted(own or seen):
            free += [first + 1, first + 5] if plane == 2 else [first + 2, first + 4]
    return np.array(sorted(free), dtype=np.int64)


def moment_rows(
    mechanism: Mechanism, gauges: Sequence[GaugePlace], free: NDArray[np.int64],
) -> FloatArray:
    """Give the moment at each gauge by coordinate: stiffness times curvature, (gauges, moving)."""
    rows = np.zeros((len(gauges), free.size))
    for row, gauge in zip(rows, gauges, strict=True):
        floats = mechanism.body_float[gauge.body]
        length = floats[at.LENGTH]
        place = gauge.distance / length
        bend = (12.0 * place - 6.0) / length**2
        turn = (6.0 * place - 2.0) / length
        first = int(mechanism.body_int[gauge.body, at.FIRST])
        if gauge.axis == 2:
            stiff, parts = floats[at.EIZ], ((first + 1, -bend), (first + 5, turn))
        else:
            stiff, parts = floats[at.EIY], ((first + 2, bend), (first + 4, turn))
        for coordinate, factor in parts:
            row[free == coordinate] = gauge.sign * stiff * factor
    return rows


# -- An arm whose joints follow measured positions: flexible links, elastic gears with play.
#
# The plant of the simulator in the few coordinates that a recording shows: each gear's twist, and
# each flexible link bent by one element in the planes that gauges see. One cubic element carries a
# link's static shape under any end load exactly and its first mode within 0.5 %.

SAMPLE = 0.01  # sample time that deviations of measurements belong to [s]
NO_GAINS = np.zeros((1, 3, 0, 0))  # of an arm that follows positions alone


@dataclass(frozen=True, eq=False)
class Response:
    """What gauges and gears of a driven arm measure."""

    # Moment that bends each gauge, positive for the load that the joint holds, (samples, gauges)
    # [N m].
    moment: FloatArray
    torque: FloatArray  # torque (or force) of each gear on the links, (samples, joints) [N m or N]


class DrivenArm:
    """An arm driven by the measured positions of its active joints: inner [s]."""

    REMEMBERED = '_moving', '_reading', '_covariance'

    def __init__(self, arm: Arm, *, inner: float = INNER_STEP) -> None:
        self.arm, self.inner = arm, inner
        mechanism = self.mechanism = reduced_mechanism(arm)
        gauges = self.gauges = [place_gauge(mechanism, arm, gauge) for gauge in arm.gauges]
        place = np.array([int(mechanism.q_index[mechanism.joints.index(name)])
                          for name in arm.active_joints], dtype=np.int64)
        free = moving_coordinates(mechanism, gauges, place)
        n, m, joints = mechanism.size, free.size, place.size
        self.tables = Driven(
            Equations(np.zeros((VECTORS, n)), np.zeros((MATRICES, n, n)), np.zeros((m, m)),
                      np.zeros(m), free),
            Gears(np.zeros((joints, SPRING_FLOATS)), place, np.zeros(joints), np.zeros(joints)),
            Drives(np.zeros((3, joints)), np.zeros((joints, 3))),
            mechanism.chain(), mechanism.composite(),
            Gauges(np.array([gauge.body for gauge in gauges], dtype=np.int64),
                   np.array([gauge.distance for gauge in gauges], dtype=float),
                   np.array([gauge.axis for gauge in gauges], dtype=np.int64),
                   np.array([[gauge.sign, 0.0] for gauge in gauges]).reshape(-1, 2),
                   np.zeros((len(gauges), LOADS))))
        self.arrays = tuple(array for table in self.tables for array in table)
        self._vectors = self.tables.equations.vectors
        self._vectors[Z] = mechanism.initial
        self._moving = *self.tables.equations[:2], *self.tables.gears[2:], *self.tables.drives
        self._covariance = np.zeros((0, 0))
        self.loaded = False
        self._reading = np.zeros(len(gauges))
        self._physics = Physics(arm, mechanism, self.tables.gears.springs)
        self.parameters = described(self._physics)
        self.set_parameters({})

    @property
    def size(self) -> int:
        """Give the number of coordinates that move."""
        return int(self.tables.equations.free.size)

    def set_parameters(self, changes: Mapping[str, float]) -> None:
        """Change physical parameters."""
        change(self.parameters, changes, self.arm.name)
        apply(self._physics, self.parameters)
        mechanism, matrices = self.mechanism, self.tables.equations.matrices
        stiffness_matrix(mechanism.body_int, mechanism.body_float, mechanism.coordinate,
                         matrices[STIFFNESS], matrices[DAMPING])
        # of a reading, the moment by rate of curvature that is damping alone [N m^2 s]
        for gain, gauge in zip(self.tables.gauges.gain, self.gauges, strict=True):
            share = gauge.bending / mechanism.beams[gauge.joint].EIz
            gain[1] = -gauge.sign * share * (
                self.parameters['beta'] * self.parameters[f'bending({gauge.joint})'])

    def follow(self, q: FloatArray, dt: FloatArray) -> Response:
        """Follow motion (samples, joints), dt 0 to restart at rest; goes on from call to call."""
        found = self.prompt(q, dt, np.zeros((len(q), 0)), NO_GAINS)
        return Response(self.late(found.moment, dt), found.torque)

    def begin(self, before: FloatArray | None) -> bool:
        """Follow the motion before what counts; say whether there was any."""
        if before is None or not len(before):
            return False
        earlier = before[:, 0].copy()
        earlier[0] = 0.0
        self.follow(before[:, 1:], earlier)
        return True

    def prompt(
        self, q: FloatArray, dt: FloatArray, measured: FloatArray, gains: FloatArray,
    ) -> Response:
        """Follow motion with readings that do not lag, drawn towards measured moments."""
        n = len(q)
        moment = np.zeros((n, len(self.gauges)))
        torque = np.zeros((n, len(self.arm.active_joints)))
        done = kernel.follow(
            np.ascontiguousarray(q), np.ascontiguousarray(dt), self.inner, self.loaded,
            np.ascontiguousarray(measured), gains, moment, torque, *self.arrays)
        if done < n:
            msg = (f'arm {self.arm.name!r}: the elastic model '
                   + (f'finds no equilibrium at q = {np.round(q[done], 3).tolist()}'
                      if dt[done] <= 0.0 else f'diverges after {done} of {n} samples')
                   + '; check stiffness, masses and units in the arm description')
            raise SimulationError(msg)
        return Response(moment, torque)

    def late(self, moment: FloatArray, dt: FloatArray) -> FloatArray:
        """Let readings [N m] lag, as after an amplifier's low-pass; goes on from call to call."""
        lag = self._physics.lag
        if lag <= 0.0 or not len(moment):
            return moment
        if len(moment) == 1 and dt[0] > 0.0:  # live
            self._reading += -math.expm1(-float(dt[0]) / lag) * (moment[0] - self._reading)
            return self._reading[None].copy()
        late = moment.copy()
        ends = [*np.flatnonzero(dt <= 0.0).tolist(), len(dt)]
        for first, end in zip([0, *ends[:-1]], ends, strict=True):
            if end > first:
                start = moment[first] if dt[first] <= 0.0 else self._reading
                late[first:end] = low_pass(
                    moment[first:end], dt[first:end], 1.0 / (2.0 * math.pi * lag), start)
                self._reading = late[end - 1].copy()
        return late

    def linearised(self, q: FloatArray) -> Linearised:
        """Rest, drives held at a pose [rad or m], linearise there; ``follow`` goes on from it."""
        self.follow(np.asarray(q, dtype=float)[None], np.zeros(1))
        result = np.zeros((3, self.size, self.size))
        tables = self.tables
        tangents(tables.equations, tables.gears, tables.chain, self.loaded, result)
        return Linearised(*result[::-1])

    def start_observer(self, deviation: FloatArray, bandwidth: float) -> None:
        """Let moments of a deviation [N m] and bandwidth [1/s] correct the state from now on."""
        m, lag = self.size, self._physics.lag
        self._deviation = np.maximum(np.asarray(deviation, dtype=float), 1e-12)
        self.small, self.pushed = np.zeros((3, m, m)), np.zeros((m, observer.FORCES))
        self.shown = moment_rows(self.mechanism, self.gauges, self.tables.equations.free)
        still = np.zeros_like(self.shown)
        self._seen = np.hstack(
            [still, still, np.eye(len(still))] if lag > 0.0 else [self.shown, still])
        self._covariance = np.zeros((self._seen.shape[1],) * 2)
        self.follow(np.tile(self._vectors[Z, self.tables.gears.place], (2, 1)),
                    np.array([0.0, 1e-3]))
        self.linearise()
        self._noise = SAMPLE * white_force(
            Linearised(*self.small), self.pushed, self.shown / self._deviation[:, None],
            bandwidth, lag)

    def forget(self) -> None:
        """Forget all uncertainty: the arm restarts, at rest."""
        self._covariance[:] = 0.0

    def correct(self, innovation: FloatArray, dt: float) -> bool:
        """Correct the state by innovations (gauges,) [N m], NaN for none; False if impossible."""
        self.linearise()
        mass, damping, stiffness = self.small
        good = observer.propagate(
            self._covariance, mass, damping, stiffness, self.pushed, self.shown, dt,
            self._noise, self._physics.lag)
        good = good and observer.correct(
            self._covariance, self._seen, self._deviation**2 * (SAMPLE / dt), innovation, mass,
            damping, stiffness, self._vectors, self.tables.equations.free, self._reading)
        return bool(good)

    def linearise(self) -> None:
        """Put mass, damping and stiffness into ``small``, forces at the tip into ``pushed``."""
        observer.linearise(self.loaded, self.mechanism.tip, *self.small, self.pushed, *self.arrays)

    def gains_along(
        self, q: FloatArray, dt: FloatArray, measured: FloatArray, deviation: FloatArray,
        bandwidth: float, before: FloatArray | None = None,
    ) -> FloatArray:
        """
        Observe a motion, and keep the gains of the observer, shape (samples, 3, moving, gauges).

        An arm that follows positions alone forgets an error only as fast as its vibrations die
        out, and one with play in its gears never forgets where small differences grow. Corrected a
        little, it forgets them within a time one can choose. The gains are those of the observer
        along a reference; kept as they are, errors remain a smooth function of the parameters.
        Nothing corrects the motion just before, ``before``, ``[dt, q]``.
        """
        measured, lag, self._physics.lag = self.ahead(dt, measured), self._physics.lag, 0.0
        try:
            self.follow(q[:1], np.zeros(1))
            self.start_observer(deviation, bandwidth)
            self.begin(before)
            gains = np.zeros((len(q), 3, self.size, measured.shape[1]))
            done = observe(
                np.ascontiguousarray(q), np.ascontiguousarray(dt), self.inner, self.loaded,
                np.ascontiguousarray(measured), self._deviation**2 * SAMPLE, self._noise, SAMPLE,
                self.mechanism.tip, self._seen, gains, *self.arrays)
        finally:
            self._physics.lag = lag
        if done < len(q):
            raise SimulationError(f'arm {self.arm.name!r}: the elastic model diverges after '
                                  f'{done} samples; correct stiffness, masses and units in links')
        return gains

    def ahead(self, dt: FloatArray, measured: FloatArray) -> FloatArray:
        """Give what will be read a lag later: what draws the arm was there before it is read."""
        lag = self._physics.lag
        if lag <= 0.0:
            return measured
        t = np.cumsum(dt)
        return np.column_stack([np.interp(t + lag, t, column) for column in measured.T])


# -- Several arms of one description, or several motions of one arm, side by side

TOO_FAR = 1e6  # where a state has gone beyond all bounds, as in ``kernel.advance``


@with_lanes(4)
def follow_several(
    dt: NDArray, inner: float, loaded: bool, gains: NDArray, q: NDArray, measured: NDArray,
    moment: NDArray, torque: NDArray, *arrays: NDArray,
) -> int:
    """Follow samples with several arms in lanes, begun before; see ``kernel.follow``."""
    paths, shown, read, passed = in_lanes((q, measured, moment, torque))
    driven = tables_of(in_lanes(arrays))
    for k in range(paths.shape[0]):
        if not move(driven, paths[k], dt[k], inner, loaded):
            return k
        look(driven, loaded, k, shown, gains, read, passed)
    return paths.shape[0]


def _follow_lanes(
    arms: Sequence[DrivenArm], motions: Sequence[FloatArray], dt: FloatArray,
    towards: Sequence[FloatArray], gains: FloatArray,
) -> tuple[int, FloatArray, FloatArray]:
    """Give how many samples went well, moments and states in lanes; one motion serves all."""
    arrays = [side_by_side(same) if same[0].dtype == float else same[0].copy()
              for same in zip(*[arm.arrays for arm in arms], strict=True)]
    samples, joints = motions[0].shape
    moment = np.zeros((samples, len(arms[0].gauges), LANES))
    done = follow_several(
        np.ascontiguousarray(dt), arms[0].inner, arms[0].loaded, gains, side_by_side(motions),
        side_by_side(towards), moment, np.zeros((samples, joints, LANES)), *arrays)
    return done, moment, arrays[0]


def follow_together(
    arms: Sequence[DrivenArm], q: FloatArray, dt: FloatArray,
    measured: Sequence[FloatArray] | None = None, gains: FloatArray = NO_GAINS,
) -> list[FloatArray | None]:
    """Follow a motion with several arms at once: (samples, gauges) [N m], None if one fails."""
    towards = [np.zeros((len(q), 0))] * len(arms) if measured is None else [
        arm.ahead(dt, one) for arm, one in zip(arms, measured, strict=True)]
    begun: dict[int, FloatArray] = {}
    end = len(q) if len(arms) == 1 else 1
    for i, arm in enumerate(arms):
        try:
            begun[i] = arm.prompt(q[:end], dt[:end], towards[i][:end], gains).moment
        except SimulationError:
            continue
    found, lanes = ({}, [*begun]) if end < len(q) else (begun, [])
    while lanes:  # from the second sample on; who diverges is left out, and the rest begins again
        done, moment, states = _follow_lanes(
            [arms[i] for i in lanes], [q[1:]], dt[1:], [towards[i][1:] for i in lanes], gains[1:])
        if done == len(q) - 1:
            found = {i: np.vstack([begun[i], moment[:, :, lane]]) for lane, i in enumerate(lanes)}
            break
        size = np.abs(states).sum(axis=(0, 1))[:len(lanes)]
        # a matrix that cannot be factorised leaves no trace: then the widest state goes
        lost = ~(size < TOO_FAR) if not np.all(size < TOO_FAR) else size == size.max()
        lanes = [i for i, gone in zip(lanes, lost, strict=True) if not gone]
    return [arm.late(found[i], dt) if i in found else None for i, arm in enumerate(arms)]


def follow_motions(arm: DrivenArm, motions: FloatArray, dt: float) -> FloatArray:
    """Follow motions from one pose, eight as fast as one: (motions, samples, gauges) [N m]."""
    rest = arm.prompt(motions[0, :1], np.zeros(1), np.zeros((1, 0)), NO_GAINS).moment
    found = []
    for first in range(0, len(motions), LANES):
        group = motions[first:first + LANES, 1:]
        done, moment, _ = _follow_lanes(
            [arm], list(group), np.full(group.shape[1], dt),
            [np.zeros((group.shape[1], 0))], NO_GAINS)
        if done < group.shape[1]:
            raise SimulationError(f'arm {arm.arm.name!r}: the elastic model diverges after {done} '
                                  'samples of a planned motion; fit it to bags with such motion')
        found.append(np.moveaxis(moment, -1, 0)[:len(group)])
    moments = np.concatenate(found)
    return np.concatenate([np.broadcast_to(rest, (len(moments), *rest.shape)), moments], axis=1)
