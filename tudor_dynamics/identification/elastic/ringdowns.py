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
model is asked twice: linearised with the joints held at that pose, and simulated along the
measured motion, so that play and joints that give way count as they did.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tudor_dynamics.errors import SignalError, SimulationError
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.identification.elastic.modes import Vibration, vibrations
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.models.elastic.fitted import follow_motion
from tudor_dynamics.signals import Stretch
from tudor_dynamics.signals.ringdown import ring_modes, RingMode
from tudor_dynamics.typing import FloatArray

STILL = 0.02
"""Speed below which a joint stands still [rad/s or m/s]."""
LEAST_SECONDS = 1.2
"""Shortest standstill that is looked at: three periods of 2.5 Hz [s]."""
MOST_SECONDS = 4.0
"""Of a standstill, from its beginning: later there is mostly noise [s]."""
LEAST_SHARE = 0.8
"""Share of the strain's variance, less a drift, that an oscillation must explain to count."""
SAME = 2.0
"""Frequencies farther apart than this factor are not the same oscillation."""


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
    # The model's mode of nearest frequency at this pose, joints held, small amplitude.
    held: Vibration | None
    # From the model's strain along the measured motion, analysed in the same way; None where it
    # does not show this oscillation.
    simulated: Vibration | None


def standstills(stretch: Stretch) -> list[slice]:
    """Find where all joints stand still for long enough."""
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
) -> tuple[Ringdown, ...]:
    """Measure the ring-downs of some bags and predict each."""
    found: list[Ringdown] = []
    for bag in bags:
        own = {} if bag.payload is None else {'payload': bag.payload}
        driven.set_parameters({**values, **own})
        for stretch in bag.stretches:
            parts = standstills(stretch)
            if stretch.strain is None or not parts:
                continue
            moment = _simulated(driven, stretch)
            found += [one for part in parts
                      if (one := _ringdown(driven, bag, stretch, part, moment)) is not None]
    return tuple(found)


def _simulated(driven: DrivenArm, stretch: Stretch) -> FloatArray | None:
    """Give the moments at the gauges along the measured motion [N m]."""
    try:
        return follow_motion(driven, stretch.states.q, stretch.dt, stretch.before).moment
    except SimulationError:
        return None


def clear_ring(signal: FloatArray, dt: float) -> tuple[float, RingMode | None]:
    """
    Find the strongest oscillation, and how much of the signal it is.

    signal (samples,), dt [s]; returns mode, None where it is not clear.
    """
    try:
        modes = ring_modes(signal, dt, count=1)
    except SignalError:
        return 0.0, None
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
    try:
        held = _nearest(vibrations(driven, q), measured.frequency)
    except SimulationError:
        held = None
    same = None if moment is None else clear_ring(moment[part, gauge], dt)[1]
    return Ringdown(
        str(bag.choice), float(t[0]), float(t[-1] - t[0]), tuple(float(x) for x in q),
        driven.arm.gauge_names[gauge], measured.amplitude,
        Vibration(measured.frequency, measured.damping), held,
        None if same is None else _nearest([Vibration(same.frequency, same.damping)],
                                           measured.frequency))
