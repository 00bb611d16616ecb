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

"""A recording thinned for the doctor: smooth, the same for motion and outputs, few samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.signals.offline import zero_phase
from tudor_dynamics.typing import FloatArray, IndexArray

CUTOFF = 8.0
"""Both sides pass a zero-phase Butterworth filter of this corner frequency [Hz]."""
LEAST_SECONDS = 3.0
"""Shorter stretches tell nothing [s]."""
MARGIN = 0.25
"""Left out at both ends of each stretch: edges of the filter, and room for lags [s]."""
MOST = 600
"""Samples kept of a bag."""
STEP = 0.03
"""No two samples kept are nearer [s]."""


@dataclass(frozen=True, eq=False)
class Part:
    """A gapless stretch at the full rate, smoothed."""

    t: FloatArray  # time since the start of the recording, (n,) [s]
    keep: IndexArray  # samples that are used
    # (n, channels): `effort`, `strain` and `velocity`, where there are some.
    outputs: dict[str, FloatArray]


@dataclass(frozen=True, eq=False)
class Thinned:
    """What the doctor compares: motion and outputs of the same bandwidth."""

    t: FloatArray  # time since the start of the recording, (n,) [s]
    # `[q, dq, ddq]`, from the positions alone, (n, 3 joints)
    # [rad, rad/s, rad/s^2 or m, m/s, m/s^2].
    motion: FloatArray
    parts: tuple[Part, ...]  # stretches they come from

    def has(self, name: str) -> bool:
        """Say whether an output, or the driver's velocity, of this name is there."""
        return name in self.parts[0].outputs

    def output(self, name: str, lag: float = 0.0) -> FloatArray:
        """
        Give an output on the samples kept, as if it had come earlier.

        lag [s]; returns (n, channels) [its unit].
        """
        found = []
        for part in self.parts:
            values = part.outputs[name]
            if lag == 0.0:
                found.append(values[part.keep])
            else:
                at = part.t[part.keep] + lag
                found.append(np.stack([np.interp(at, part.t, column) for column in values.T],
                                      axis=1))
        return np.vstack(found)


def thin(recording: Recording) -> Thinned | None:
    """Thin a recording; returns None where no stretch is long enough."""
    t_all = recording.t
    chosen = [part for part in recording.segments
              if t_all[part.stop - 1] - t_all[part.start] >= LEAST_SECONDS
              and part.stop - part.start >= 64]
    if not chosen:
        return None
    seconds = sum(float(t_all[part.stop - 1] - t_all[part.start]) for part in chosen)
    wanted = max(STEP, seconds / MOST)
    cutoff = min(CUTOFF, 0.2 / recording.dt)
    n_joints = recording.q.shape[1]
    parts, motions, times = [], [], []
    for part in chosen:
        t = t_all[part]
        columns = {'position': recording.q[part]}
        for name, values in (('effort', recording.effort), ('strain', recording.strain),
                             ('velocity', recording.dq)):
            if values is not None:
                columns[name] = values[part]
        states = zero_phase(t, np.hstack(list(columns.values())), cutoff)
        factor = max(1, int(wanted / ((t[-1] - t[0]) / (len(t) - 1))))
        begin, end = np.searchsorted(t, [t[0] + MARGIN, t[-1] - MARGIN])
        keep = np.arange(int(begin), int(end), factor)
        motions.append(np.hstack([x[keep, :n_joints] for x in (states.q, states.dq, states.ddq)]))
        times.append(t[keep])
        outputs, first = {}, n_joints
        for name, values in list(columns.items())[1:]:
            outputs[name] = states.q[:, first:first + values.shape[1]]
            first += values.shape[1]
        parts.append(Part(t, keep, outputs))
    return Thinned(np.concatenate(times), np.vstack(motions), tuple(parts))
