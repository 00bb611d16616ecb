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

"""What rings on while an arm stands: frequency and damping by the efforts of all joints."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification import settings
from tudor_dynamics.signals.filters import zero_phase
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True, eq=False)
class Ring:
    """One oscillation in a rest."""

    frequency: float  # [Hz]
    damping: float  # damping ratio
    # Standard errors of these two.
    frequency_error: float
    damping_error: float
    amplitude: Any  # complex, at the first sample of the rest, (joints,) [N m or N]
    noise: FloatArray  # rms of what it leaves over, (joints,)


def standing(t: FloatArray, dq: FloatArray) -> list[tuple[int, slice]]:
    """Find where joints stand for long enough: the sample of the stop, and those looked at."""
    speed = np.abs(dq).max(axis=1)
    # an arm that rings through stands all the same
    moving = speed > max(settings.RING_STILL, settings.RING_SPEED * float(speed.max()))
    edges = np.flatnonzero(np.diff(moving.astype(int)))
    found = []
    for stop in (int(k) for k in edges if moving[k]):
        after = min((int(k) for k in edges if k > stop), default=len(t) - 1)
        first = int(np.searchsorted(t, t[stop] + settings.RING_AFTER))
        last = int(np.searchsorted(t, min(t[stop] + settings.RING_UNTIL, t[after])))
        if last - first >= 12 and t[last - 1] - t[first] >= settings.RING_LEAST:
            found.append((stop, slice(first, last)))
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
    begun = _loudest(t, smooth / rough)
    if begun is None:
        return None

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
    # what is left is no white noise: a period counts as one sample
    scale = 2.0 * found.cost / (len(t) * effort.shape[1]) * max(
        1.0, 1.0 / (found.x[0] * float(np.median(np.diff(t)))))
    covariance = scale * np.linalg.pinv(found.jac.T @ found.jac)
    off, off_damping = np.sqrt(np.diag(covariance)).tolist()
    return Ring(float(found.x[0]), float(found.x[1]), off, off_damping,
                values[0] - 1j * values[1], noise)


def _loudest(t: FloatArray, values: FloatArray) -> float | None:
    """Give the frequency at which all channels together are loudest [Hz]."""
    n = 8 * len(t)
    power = (np.abs(np.fft.rfft(values * np.hanning(len(t))[:, None], n, axis=0)) ** 2).sum(axis=1)
    frequency = np.fft.rfftfreq(n, float(t[-1]) / (len(t) - 1))
    inside = (frequency >= settings.RING_LOWEST) & (frequency <= settings.RING_HIGHEST)
    return float(frequency[inside][np.argmax(power[inside])]) if inside.any() else None


def loudest_ring(recording: Recording) -> Ring | None:
    """Give the loudest of what rings on in a bag after motion; None where hardly a rest does."""
    found, rests = [], 0
    for part in recording.segments:
        t = recording.t[part]
        if recording.effort is None or t[-1] - t[0] < settings.RING_AFTER + settings.RING_LEAST:
            continue
        states = zero_phase(t, recording.q[part], min(settings.CUTOFF, 0.2 / recording.dt))
        for _, rest in standing(t, states.dq):
            rests += 1
            ring = ring_of(*block_means(t[rest], recording.effort[part][rest]))
            if ring is not None:
                found.append(ring)
    if len(found) <= settings.RING_OFTEN * rests:
        return None
    return max(found, key=lambda ring: float(np.max(np.abs(ring.amplitude) / ring.noise)))
