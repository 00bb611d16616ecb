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

"""Ringing: in residuals, in strain and efforts at rest, and as the elastic model has it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.errors import SignalError, SimulationError
from tudor_dynamics.identification import settings
from tudor_dynamics.identification.dataset import BagData, model_for
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.models.elastic.model import follow_stretch
from tudor_dynamics.models.settings import RING_AFTER
from tudor_dynamics.signals.filters import MotionState, ring_modes, RingMode, Vibration, zero_phase
from tudor_dynamics.signals.preprocessing import Stretch
from tudor_dynamics.typing import FloatArray


# -- Does the arm ring? The residual of a rigid-body model says, and at which frequency

LOWEST = 0.5  # below, the residual is the model's own error, not a vibration [Hz]
HALF_WIDTH = 0.2  # half width of a resonance, relative to its frequency: it moves with the pose
SMALLEST_SHARE = 0.5  # share of the residual's power above LOWEST that the resonance must have
SMALLEST_AMPLITUDE = 0.02  # rms of the resonance relative to the signal's standard deviation


@dataclass(frozen=True)
class Ringing:
    """A vibration found in a channel."""

    channel: str  # joint or gauge that rings
    frequency: float  # where the residual's power density peaks [Hz]
    rms: float  # root mean square of the band around it, in the channel's unit
    share: float  # its share of the residual's power above 0.5 Hz

    def __str__(self) -> str:
        """Say it in a sentence."""
        return (f'{self.channel} rings at {self.frequency:.2f} Hz with an RMS of {self.rms:.3g}, '
                f'{100 * self.share:.0f} % of the power of the residual above {LOWEST} Hz')


def oscillation(frequency: FloatArray, density: FloatArray) -> tuple[float, float, float]:
    """Give frequency [Hz], rms and share of the largest oscillation: density (frequencies,)."""
    above = frequency >= LOWEST
    power = density * (frequency[1] - frequency[0])
    peak = float(frequency[above][np.argmax(power[above])])
    inside = float(power[above & (np.abs(frequency - peak) <= HALF_WIDTH * peak)].sum())
    return peak, float(np.sqrt(inside)), inside / max(float(power[above].sum()), 1e-300)


def find_ringing(model: Model, data: Sequence[BagData], output: str) -> tuple[Ringing, ...]:
    """Look for resonances in a rigid-body model's residual, at the full rate; none if damped."""
    from scipy.signal import welch  # slow to import

    densities: list[FloatArray] = []
    seconds: list[float] = []
    spread: list[FloatArray] = []
    frequency: FloatArray | None = None
    for bag in data:
        rate = 1.0 / bag.recording.dt
        length = int(round(8.0 * rate))  # 1/8 Hz resolution
        at = model_for(model, bag)
        for s in bag.stretches:
            measured = getattr(s, output)
            if len(measured) < length:
                continue
            residual = measured - at.follow(s)
            grid, density = welch(residual, rate, nperseg=length, axis=0)
            if frequency is None:
                frequency = grid
            if len(grid) != len(frequency):
                continue  # a bag of another rate
            densities.append(density)
            seconds.append(len(measured) / rate)
            spread.append(measured.std(axis=0))
    if frequency is None:
        return ()
    density = np.average(densities, axis=0, weights=seconds)
    deviation = np.average(spread, axis=0, weights=seconds)
    found = []
    for i, channel in enumerate(model.channels):
        peak, rms, share = oscillation(frequency, density[:, i])
        inside = LOWEST * 1.5 < peak < 0.8 * frequency[-1]
        if inside and share > SMALLEST_SHARE and rms > SMALLEST_AMPLITUDE * deviation[i]:
            found.append(Ringing(channel, peak, rms, share))
    return tuple(found)


# -- Frequencies and damping of an elastic arm, joints held, over the poses that its bags cover

CELLS = 18  # of the map along each joint
MOVING = 1e-3  # range of positions above which a joint counts as moving [rad or m]
MODES = 2  # modes wanted: links and gears have more, but bags hardly show them


@dataclass(frozen=True, eq=False)
class ModeMap:
    """The first modes over the poses of some bags."""

    joints: tuple[int, ...]  # indices of the one or two joints that move most, the axes of the map
    edges: tuple[FloatArray, ...]  # edges of the cells along each of them, (cells + 1,) [rad or m]
    # At the middle of each cell, other joints at their mean; first joint first. NaN outside of
    # what the bags enclose, (modes, cells) or (modes, cells, cells) [Hz; 1].
    frequency: FloatArray
    damping: FloatArray


def vibrations(driven: DrivenArm, q: FloatArray, count: int = MODES) -> tuple[Vibration, ...]:
    """Find the slowest small vibrations about rest at a pose [rad or m], joints held."""
    small = driven.linearised(q)
    m = len(small.mass)
    rates = np.zeros((2 * m, 2 * m))
    rates[:m, m:] = np.eye(m)
    rates[m:] = -np.linalg.solve(small.mass, np.hstack([small.stiffness, small.damping]))
    poles = np.linalg.eigvals(rates)
    # rounding leaves a pole without oscillation a little imaginary part
    poles = poles[poles.imag > 1e-6 * np.abs(poles)]
    return tuple(Vibration(float(pole.imag) / (2.0 * math.pi), float(-pole.real / abs(pole)))
                 for pole in poles[np.argsort(np.abs(poles))][:count])


def busiest(positions: FloatArray) -> tuple[int, ...]:
    """Choose the joints that span the map: positions (samples, joints) [rad or m]."""
    order = np.argsort(-positions.std(axis=0), kind='stable')[:2]
    return tuple(sorted(int(i) for i in order if np.ptp(positions[:, i]) > MOVING))


def mode_map(driven: DrivenArm, positions: FloatArray, cells: int = CELLS) -> ModeMap | None:
    """Find the first modes over, and between, the poses visited; None where no joint moves."""
    joints = busiest(positions)
    if not joints:
        return None
    edges = tuple(np.linspace(positions[:, i].min(), positions[:, i].max(), cells + 1)
                  for i in joints)
    place = [np.clip(np.searchsorted(edge, positions[:, i], side='right') - 1, 0, cells - 1)
             for i, edge in zip(joints, edges, strict=True)]
    visited = np.zeros((cells,) * len(joints), dtype=bool)
    visited[tuple(place)] = True
    middle = [0.5 * (edge[1:] + edge[:-1]) for edge in edges]
    frequency = np.full((MODES, visited.size), np.nan)
    damping = frequency.copy()
    q = positions.mean(axis=0)
    for number in np.flatnonzero(enclosed(visited)):
        for i, k, values in zip(joints, np.unravel_index(number, visited.shape), middle,
                                strict=True):
            q[i] = values[k]
        try:
            found = vibrations(driven, q)
        except SimulationError:
            continue
        for order, mode in enumerate(found):
            frequency[order, number], damping[order, number] = mode.frequency, mode.damping
    shape = (MODES,) + (cells,) * len(joints)
    return ModeMap(joints, edges, frequency.reshape(shape), damping.reshape(shape))


def enclosed(visited: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Fill a map of visited cells up to its convex hull."""
    spots = np.argwhere(visited)
    if visited.ndim == 1:
        inside = np.zeros_like(visited)
        inside[spots.min():spots.max() + 1] = True
        return inside
    from scipy.spatial import Delaunay, QhullError  # slow to import

    try:
        hull = Delaunay(spots)
    except QhullError:  # all in a line: nothing is between
        return visited
    every = np.argwhere(np.ones_like(visited))
    return np.asarray((hull.find_simplex(every) >= 0).reshape(visited.shape) | visited)


# -- Ring-downs that bags hold by themselves, measured and as an elastic model has them.
#
# Where the joints stand still after a motion, strain shows the arm's own frequency and damping.
# The model is asked twice: linearised with the joints held at that pose, and simulated along the
# measured motion, so that play and joints that give way count as they did.

STILL = 0.02  # speed below which a joint stands still [rad/s or m/s]
LEAST_SECONDS = 1.2  # shortest standstill that is looked at: three periods of 2.5 Hz [s]
MOST_SECONDS = 4.0  # of a standstill, from its beginning: later there is mostly noise [s]
LEAST_SHARE = 0.8
"""Share of the strain's variance, less a drift, that an oscillation must explain to count."""
SAME = 2.0  # frequencies farther apart than this factor are not the same oscillation


@dataclass(frozen=True)
class Ringdown:
    """An oscillation that died out while the joints stood still."""

    bag: str  # bag that it was found in
    # When, and how much of it was looked at [s].
    begin: float
    seconds: float
    q: tuple[float, ...]  # pose of the arm [rad or m]
    gauge: str  # gauge that showed it best
    amplitude: float  # at the beginning, in the unit of the gauge
    measured: Vibration  # from the strain measured
    held: Vibration | None  # the model's nearest mode at this pose, joints held
    # From the model's strain along the measured motion, analysed in the same way; None where it
    # does not show this oscillation.
    simulated: Vibration | None


def standstills(t: FloatArray, dq: FloatArray) -> list[slice]:
    """Find where all joints stand still for long enough: t (samples,), dq (samples, joints)."""
    still = np.all(np.abs(dq) < STILL, axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
    found = []
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        last = int(np.searchsorted(t, t[begin] + MOST_SECONDS, side='right'))
        part = slice(int(begin), min(int(end), last))
        if t[part.stop - 1] - t[part.start] >= LEAST_SECONDS:
            found.append(part)
    return found


def find_ringdowns(
    driven: DrivenArm, values: Mapping[str, float], bags: Sequence[BagData],
    gauges: FloatArray | None = None,
) -> tuple[Ringdown, ...]:
    """Measure the ring-downs of some bags and predict each; gauges: see ``follow_stretch``."""
    found: list[Ringdown] = []
    for bag in bags:
        own = {} if bag.payload is None else {'payload': bag.payload}
        driven.set_parameters({**values, **own})
        for stretch in bag.stretches:
            parts = standstills(stretch.t, stretch.states.dq)
            if stretch.strain is None or not parts:
                continue
            moment: FloatArray | None = None  # at the gauges along the measured motion [N m]
            with suppress(SimulationError):
                moment = follow_stretch(driven, stretch, gauges).moment
            found += [one for part in parts
                      if (one := _ringdown(driven, bag, stretch, part, moment)) is not None]
    return tuple(found)


def clear_ring(signal: FloatArray, dt: float) -> tuple[float, RingMode | None]:
    """Find the strongest oscillation, and its share of the signal; None where it is not clear."""
    modes: Sequence[RingMode] = ()
    with suppress(SignalError):
        modes = ring_modes(signal, dt, count=1)
    if not modes:
        return 0.0, None
    t = np.arange(len(signal)) * dt
    w = 2.0 * np.pi * modes[0].frequency
    ratio = modes[0].damping
    fading = np.exp(-w * ratio / np.sqrt(max(1.0 - ratio**2, 1e-6)) * t)
    drift = np.column_stack([np.ones_like(t), t])
    whole = np.column_stack([drift, fading * np.cos(w * t), fading * np.sin(w * t)])
    slow, left = (float(np.sum((signal - rows @ np.linalg.lstsq(rows, signal, rcond=None)[0])**2))
                  for rows in (drift, whole))
    share = 1.0 - left / max(slow, 1e-300)
    return share, modes[0] if share >= LEAST_SHARE else None


def _nearest(modes: Sequence[Vibration], frequency: float) -> Vibration | None:
    """Give the mode of nearest frequency, if it can be the same oscillation at all."""
    best = min(modes, key=lambda mode: abs(np.log(mode.frequency / frequency)), default=None)
    if best is None or not 1.0 / SAME < best.frequency / frequency < SAME:
        return None
    return best


def _ringdown(
    driven: DrivenArm, bag: BagData, stretch: Stretch, part: slice, moment: FloatArray | None,
) -> Ringdown | None:
    assert stretch.strain is not None
    strain, t, dt = stretch.strain[part], stretch.t[part], bag.recording.dt
    rings = [clear_ring(column, dt) for column in strain.T]
    gauge = int(np.argmax([share for share, _ in rings]))
    measured = rings[gauge][1]
    if measured is None:
        return None
    q = stretch.states.q[part].mean(axis=0)
    held: Vibration | None = None
    with suppress(SimulationError):
        held = _nearest(vibrations(driven, q), measured.frequency)
    same = None if moment is None else clear_ring(moment[part, gauge], dt)[1]
    return Ringdown(
        str(bag.choice), float(t[0]), float(t[-1] - t[0]), tuple(float(x) for x in q),
        driven.arm.gauge_names[gauge], measured.amplitude, measured, held,
        None if same is None else _nearest([same], measured.frequency))


# -- What rings on while an arm stands, such as a tool without gauges: frequency and damping by the
#    efforts of all joints

@dataclass(frozen=True, eq=False)
class Ring:
    """One oscillation in a rest."""

    frequency: float  # [Hz]
    damping: float  # damping ratio
    amplitude: Any  # complex, at the first sample of the rest, (joints,) [N m or N]
    noise: FloatArray  # rms of what it leaves over, (joints,)


def standing(t: FloatArray, dq: FloatArray) -> list[slice]:
    """Find samples to look at where joints stand for long enough after a motion."""
    speed = np.abs(dq).max(axis=1)
    # an arm that rings through stands all the same
    moving = speed > max(settings.RING_STILL, settings.RING_SPEED * float(speed.max()))
    edges = np.flatnonzero(np.diff(moving.astype(int)))
    found = []
    for stop in (int(k) for k in edges if moving[k]):
        after = min((int(k) for k in edges if k > stop), default=len(t) - 1)
        first = int(np.searchsorted(t, t[stop] + RING_AFTER))
        # a motion has begun before its speed shows
        last = int(np.searchsorted(t, min(t[stop] + settings.RING_UNTIL,
                                          t[after] - settings.RING_BEFORE)))
        if last - first >= 12 and t[last - 1] - t[first] >= settings.RING_LEAST:
            found.append(slice(first, last))
    return found


def block_means(t: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Average blocks of samples (samples, channels), of which the fastest ring needs few."""
    every = max(1, int(len(t) / (settings.RING_RATE * (t[-1] - t[0]))))
    n = len(t) // every
    return (t[:n * every].reshape(n, every).mean(axis=1),
            values[:n * every].reshape(n, every, -1).mean(axis=1))


def ring_of(t: FloatArray, effort: FloatArray) -> Ring | None:
    """Fit one decaying oscillation and a drift to all joints of a rest; None where none is."""
    from scipy.optimize import least_squares  # slow to import, and few arms ring

    t = t - t[0]
    drift = np.vander(t / t[-1], 4)
    smooth = effort - drift @ np.linalg.lstsq(drift, effort, rcond=None)[0]
    rough = np.sqrt(np.maximum(0.5 * np.mean(np.diff(effort, axis=0) ** 2, axis=0), 1e-12))
    (begun,) = loudest_of([(t, smooth / rough)])

    def columns(p: FloatArray) -> FloatArray:
        omega = 2.0 * math.pi * p[0]
        fading = np.exp(-p[1] * omega * t)
        phase = omega * math.sqrt(1.0 - p[1] ** 2) * t
        return np.column_stack([fading * np.cos(phase), fading * np.sin(phase), drift])

    def left(p: FloatArray) -> FloatArray:
        basis = np.linalg.qr(columns(p))[0]
        return np.asarray((effort - basis @ (basis.T @ effort)) / rough).ravel()
    try:
        found = least_squares(left, [begun, 0.02], x_scale=[1.0, 0.01],
                              bounds=([0.8 * begun, 0.0], [1.25 * begun, 0.5]))
    except ValueError:
        return None
    share = 1.0 - 2.0 * found.cost / max(float(np.sum((smooth / rough) ** 2)), 1e-300)
    values = np.linalg.lstsq(columns(found.x), effort, rcond=None)[0]
    noise = np.sqrt(np.mean((effort - columns(found.x) @ values) ** 2, axis=0))
    loud = float(np.max(np.hypot(values[0], values[1]) / np.maximum(noise, 1e-12)))
    if (share < settings.RING_CLEAR or found.x[1] > settings.RING_DAMPED
            or found.x[0] < settings.RING_LOWEST or loud < settings.RING_LOUD):
        return None
    return Ring(float(found.x[0]), float(found.x[1]), values[0] - 1j * values[1], noise)


def loudest_of(rests: Sequence[tuple[FloatArray, FloatArray]], count: int = 1) -> list[float]:
    """Give frequencies [Hz] at which rests, each its times and channels, are loudest."""
    frequency = np.arange(settings.RING_LOWEST, settings.RING_HIGHEST, settings.RING_STEP)
    power = np.zeros(len(frequency))
    for t, values in rests:
        n, step = 8 * len(t), float(t[-1] - t[0]) / (len(t) - 1)
        own = np.abs(np.fft.rfft(values * np.hanning(len(t))[:, None], n, axis=0)) ** 2
        power += np.interp(frequency, np.fft.rfftfreq(n, step), own.sum(axis=1), right=0.0)
    found: list[float] = []
    for _ in range(count):
        found.append(float(frequency[np.argmax(power)]))
        power[np.abs(frequency / found[-1] - 1.0) < settings.RING_APART] = 0.0
    return found


def with_rests(
    recording: Recording, cutoff: float,
) -> Iterator[tuple[slice, MotionState, list[slice]]]:
    """Give segments of a bag with efforts, their motion, filtered, and their rests, if any."""
    for part in recording.segments:
        t = recording.t[part]
        if recording.effort is None or t[-1] - t[0] < RING_AFTER + settings.RING_LEAST:
            continue
        motion = zero_phase(t, recording.q[part], min(cutoff, 0.2 / recording.dt))
        rests = standing(t, motion.dq)
        if rests:
            yield part, motion, rests


def loudest_ring(recording: Recording) -> Ring | None:
    """Give the loudest of what rings on in a bag after motion; None where hardly a rest does."""
    rings: list[Ring | None] = []
    for part, _, rests in with_rests(recording, settings.CUTOFF):
        assert recording.effort is not None
        t, effort = recording.t[part], recording.effort[part]
        rings += [ring_of(*block_means(t[rest], effort[rest])) for rest in rests]
    found = [ring for ring in rings if ring is not None]
    if len(found) <= settings.RING_OFTEN * len(rings):
        return None
    return max(found, key=lambda ring: float(np.max(np.abs(ring.amplitude) / ring.noise)))
