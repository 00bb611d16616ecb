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

"""Live joint states to positions, velocities and accelerations, as the offline tools do it."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from tudor_dynamics.arm import PreprocessingSpec
from tudor_dynamics.monitoring.stamps import StampGate
from tudor_dynamics.signals.filters import CausalDifferentiator, low_pass_gain
from tudor_dynamics.small_arrays import all_finite
from tudor_dynamics.typing import FloatArray


@dataclass(eq=False, slots=True)  # frozen would be three times as slow to make
class Motion:
    """Motion of one sample."""

    stamp: int  # header stamp of the sample [ns]
    elapsed: float  # time since the filter began, or began anew behind a gap [s]
    dt: float  # time since the sample before; 0 at the beginning [s]
    # `[q, dq, ddq]` of the active joints, (3 joints,) [rad, rad/s, rad/s^2 or m, m/s, m/s^2].
    row: FloatArray

    def settled(self, settle: float) -> bool:
        """
        Say whether the transients of the filters are over, by the offline tools' rule.

        settle [s].
        """
        return self.elapsed >= settle - 0.5 * self.dt


class LowPass:
    """First-order low-pass of vectors: cutoff [Hz]."""

    def __init__(self, cutoff: float | None) -> None:
        self.cutoff = cutoff
        self._state: FloatArray | None = None

    def step(self, dt: float, x: FloatArray) -> FloatArray:
        """
        Filter one sample; ``dt`` of 0 begins anew.

        x (channels,); dt [s]: 0 begins anew.
        """
        if self.cutoff is None:
            return x
        if self._state is None or dt <= 0:
            self._state = x.copy()
        else:
            self._state = self._state + low_pass_gain(self.cutoff, dt) * (x - self._state)
        return self._state


class StateFilter:
    """Filter of live joint states; gap [s]: 0 for five periods."""

    def __init__(self, spec: PreprocessingSpec, gap: float = 0.0) -> None:
        self.spec = spec
        self.gate = StampGate(gap)
        self.drops: Counter[str] = self.gate.drops
        self._differentiator = CausalDifferentiator(
            spec.velocity_cutoff, spec.acceleration_cutoff)
        self._output = LowPass(spec.output_cutoff)
        self._began = 0
        self._with_velocity = False

    def reset(self) -> None:
        """Forget the past."""
        self.gate.reset()

    def step(self, stamp: int, q: FloatArray, measured: FloatArray | None = None) -> Motion | None:
        """
        Filter one sample.

        stamp [ns], q (joints,) [rad or m], measured (joints,) [rad/s or m/s]; returns None for a
        sample that is left out.
        """
        if not all_finite(q):
            self.drops['not_finite'] += 1
            self.gate.unusable()
            return None
        if not self.spec.measured_velocity or (
                measured is not None and not all_finite(measured)):
            measured = None
        tick = self.gate.step(stamp)
        if tick is None:
            return None
        changed = self._with_velocity != (measured is not None)
        if tick.first or changed:
            if changed and not tick.first:
                self.drops['velocity_came_or_went'] += 1
            self._differentiator.reset()
            self._began = stamp
            self._with_velocity = measured is not None
        dt = 0.0 if stamp == self._began else tick.dt
        row = self._differentiator.step_row(tick.dt, q, measured)
        if self._output.cutoff is not None:
            n = len(q)
            row[:2 * n] = self._output.step(dt, row[:2 * n])
        return Motion(stamp, (stamp - self._began) * 1e-9, dt, row)
