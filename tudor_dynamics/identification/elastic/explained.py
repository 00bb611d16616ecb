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


"""How well simulated strain explains what was measured."""

from __future__ import annotations

import numpy as np

from tudor_dynamics.typing import FloatArray


def fit_percent(errors: FloatArray, strain: FloatArray) -> float:
    """
    Give the fit of all channels together, ``100 (1 - |e| / |y - mean|)`` [%].

    errors, strain (samples, gauges) [unit of the gauges].
    """
    spread = float(np.linalg.norm(strain - strain.mean(axis=0)))
    return 100.0 * (1.0 - float(np.linalg.norm(errors)) / max(spread, 1e-300))


def robust_scale(errors: FloatArray, strain: FloatArray) -> FloatArray:
    """
    Give robust standard deviations: half of the errors lie within 0.6745 of them.

    errors, strain (samples, gauges) [unit of the gauges].
    """
    return np.asarray(np.maximum(np.median(np.abs(errors), axis=0) / 0.6745,
                                 1e-3 * strain.std(axis=0) + 1e-12))
