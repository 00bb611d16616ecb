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

"""Thresholds learned beside the running robot, from residuals as they come."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tudor_dynamics.errors import FitError
from tudor_dynamics.monitoring.residuals import Residual
from tudor_dynamics.monitoring.thresholds.learning import FreeMotion, learn_thresholds
from tudor_dynamics.monitoring.thresholds.thresholds import MethodThresholds
from tudor_dynamics.typing import FloatArray

MAX_SAMPLES = 2_000_000
THINNED = 100
"""Samples of which one tells the friction of a joint."""


class Calibration:
    """Collects free motion for a while: seconds [s]."""

    def __init__(
        self, channels: dict[str, tuple[str, ...]], seconds: float,
        stiction: Callable[[str, FloatArray], FloatArray] | None = None,
    ) -> None:
        self.channels = channels
        self.stiction = stiction
        self.seconds = seconds
        self._parts: dict[str, list[list[Residual]]] = {name: [] for name in channels}
        self._collected = dict.fromkeys(channels, 0.0)
        self._count = 0

    def add(self, method: str, residual: Residual) -> None:
        """Collect one residual."""
        parts = self._parts[method]
        motion = residual.motion
        last = parts[-1][-1].motion.stamp if parts else 0
        dt = (motion.stamp - last) * 1e-9
        if not parts or not 0.0 < dt <= max(5.0 * motion.dt, 0.02):
            parts.append([])
        else:
            self._collected[method] += dt
        parts[-1].append(residual)
        self._count += 1

    @property
    def done(self) -> bool:
        """Say whether every method has enough."""
        return (self._count > MAX_SAMPLES
                or min(self._collected.values(), default=0.0) >= self.seconds)

    def learn(self) -> dict[str, MethodThresholds]:
        """Learn the thresholds."""
        found = {}
        for method, parts in self._parts.items():
            records = [FreeMotion(np.array([r.motion.stamp for r in part], dtype=np.int64),
                                  np.array([r.motion.row for r in part]),
                                  np.array([r.value for r in part]))
                       for part in parts if len(part) > 1]
            places = np.vstack([r.motion[::THINNED, :r.motion.shape[1] // 3] for r in records]
                               or [np.zeros((0, 0))])
            held = (None if self.stiction is None or not len(places)
                    else self.stiction(method, places))
            learned = learn_thresholds(records, self.channels[method], held)
            if not all(tail.scale > 0 for tail in learned.tails):
                msg = f'{method}: a residual never changes; check the sensors and calibrate again'
                raise FitError(msg)
            found[method] = learned
        return found
