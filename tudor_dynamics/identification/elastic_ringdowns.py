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
Ring-downs that bags hold by themselves, measured and as an elastic model has them.

Where the joints stand still after a motion, strain shows the arm's own frequency and damping. The
model is asked twice: linearised with the joints held at that pose, and simulated along the measured
motion, so that play and joints that give way count as they did.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.errors import SignalError, SimulationError
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.identification.elastic_modes import Vibration, vibrations
from tudor_dynamics.models.elastic import follow_motion
from tudor_dynamics.models.following import sample_times
from tudor_dynamics.signals import Stretch
from tudor_dynamics.signals.ringdown import ring_modes, RingMode
from tudor_dynamics.simulation.driven import DrivenArm

FloatArray = NDArray[np.float64]

STILL = 0.02
"""Speed below which a joint stands still [rad/s or m/s]."""
LEAST_SECONDS = 1.2
"""Shortest standstill that is looked at: three periods of 2.5 Hz [s]."""
MOST_SECONDS = 4.0
"""Of a standstill, from its beginning: later there is mostly noise [s]."""
LEAST_AMPLITUDE = 4.0
"""Amplitude of an oscillation that counts, in standard deviations of what the model leaves over."""
SAME = 2.0
"""Frequencies farther apart than this factor are not the same oscillation."""


@dataclass(frozen=True)
class Ringdown:
    """
    An oscillation that died out while the joints stood still.

    Attributes
    ----------
    bag : str
        Where.
    begin, seconds : float
        When, and how much of it was looked at [s].
    q : tuple of float
        Pose [rad or m].
    gauge : str
        Gauge that showed it best.
    amplitude : float
        At the beginning, in the unit of the gauge.
    measured : Vibration
        From the strain measured.
    held : Vibration or None
        The model's mode of nearest frequency at this pose, joints held, small amplitude.
    simulated : Vibration or None
        From the model's strain along the measured motion, analysed in the same way; None where
        it does not show this oscillation.

    """

    bag: str
    begin: float
    seconds: float
    q: tuple[float, ...]
    gauge: str
    amplitude: float
    measured: Vibration
    held: Vibration | None
    simulated: Vibration | None


def standstills(stretch: Stretch) -> list[slice]:
    """
    Find where all joints stand still for long enough.

    Parameters
    ----------
    stretch : Stretch
        Gapless motion.

    Returns
    -------
    list of slice
        Samples, at most MOST_SECONDS each.

    """
    still = np.all(np.abs(stretch.states.dq) < STILL, axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
    found = []
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        last = int(np.searchsorted(stretch.t, stretch.t[begin] + MOST_SECONDS, side='right'))
        part = slice(int(begin), min(int(end), last))
        if stretch.t[part.stop - 1] - stretch.t[part.start] >= LEAST_SECONDS:
            found.append(part)
    return found


def find_ringdowns(
    driven: DrivenArm, values: Mapping[str, float], bags: Sequence[BagData],
    gains: FloatArray, noise: FloatArray,
) -> tuple[Ringdown, ...]:
    """
    Measure the ring-downs of some bags and predict each.

    Parameters
    ----------
    driven : DrivenArm
        Arm.
    values : mapping of str to float
        Its parameters; the payload of a bag that says its own replaces theirs.
    bags : sequence of BagData
        Bags with strain.
    gains : ndarray of shape (n_gauges,)
        Reading per moment [unit of the gauge per N m].
    noise : ndarray of shape (n_gauges,)
        Standard deviation of what the model leaves over [unit of the gauge].

    Returns
    -------
    tuple of Ringdown
        In the order of the bags.

    """
    found: list[Ringdown] = []
    for bag in bags:
        own = {} if bag.payload is None else {'payload': bag.payload}
        driven.set_parameters({**values, **own})
        for stretch in bag.stretches:
            parts = standstills(stretch)
            if stretch.strain is None or not parts:
                continue
            strain = _simulated(driven, stretch, gains)
            found += [one for part in parts
                      if (one := _ringdown(driven, bag, stretch, part, strain, noise)) is not None]
    return tuple(found)


def _simulated(driven: DrivenArm, stretch: Stretch, gains: FloatArray) -> FloatArray | None:
    dt = sample_times(stretch)
    if stretch.before is not None:
        dt[0] = stretch.since
    try:
        return np.asarray(
            follow_motion(driven, stretch.states.q, dt, stretch.before).moment * gains)
    except SimulationError:
        return None


def _strongest(signal: FloatArray, dt: float) -> RingMode | None:
    try:
        modes = ring_modes(signal, dt, count=1)
    except SignalError:
        return None
    return modes[0] if modes else None


def _nearest(modes: Sequence[Vibration], frequency: float) -> Vibration | None:
    """Give the mode of nearest frequency, if it can be the same oscillation at all."""
    best = min(modes, key=lambda mode: abs(np.log(mode.frequency / frequency)), default=None)
    if best is None or not 1.0 / SAME < best.frequency / frequency < SAME:
        return None
    return best


def _ringdown(
    driven: DrivenArm, bag: BagData, stretch: Stretch, part: slice, simulated: FloatArray | None,
    noise: FloatArray,
) -> Ringdown | None:
    assert stretch.strain is not None
    strain, t = stretch.strain[part], stretch.t[part]
    # the gauge that shows most of it; what a standstill begins with may be another gauge's noise
    gauge = int(np.argmax(strain.std(axis=0) / np.maximum(noise, 1e-12)))
    measured = _strongest(strain[:, gauge], bag.recording.dt)
    if measured is None or measured.amplitude < LEAST_AMPLITUDE * noise[gauge]:
        return None
    q = stretch.states.q[part].mean(axis=0)
    try:
        held = _nearest(vibrations(driven, q), measured.frequency)
    except SimulationError:
        held = None
    same = None
    if simulated is not None:
        ring = _strongest(simulated[part, gauge], bag.recording.dt)
        if ring is not None and ring.amplitude >= noise[gauge]:
            same = _nearest([Vibration(ring.frequency, ring.damping)], measured.frequency)
    return Ringdown(
        str(bag.choice), float(t[0]), float(t[-1] - t[0]), tuple(float(x) for x in q),
        driven.arm.gauge_names[gauge], measured.amplitude,
        Vibration(measured.frequency, measured.damping), held, same)
