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

"""Ring-down analysis: known decays are found again."""

from __future__ import annotations

import numpy as np
import pytest

from tudor_dynamics.errors import SignalError
from tudor_dynamics.signals.filters import ring_modes

DT = 5e-4


def decay(frequency: float, damping: float, amplitude: float, seconds: float = 2.5) -> np.ndarray:
    """Make a damped oscillation."""
    t = np.arange(int(seconds / DT)) * DT
    w = 2 * np.pi * frequency
    rate = w * damping / np.sqrt(1 - damping**2)
    return np.asarray(amplitude * np.exp(-rate * t) * np.cos(w * t + 0.4))


@pytest.mark.parametrize('damping', [0.005, 0.05, 0.4, -0.02])
def test_two_modes(damping: float) -> None:
    """Frequency, ratio and amplitude of two oscillations beside an offset and a slow motion."""
    t = np.arange(int(2.5 / DT)) * DT
    signal = decay(2.3, damping, 100.0) + decay(8.3, 0.02, 30.0) + 400.0 + 20.0 * np.exp(-t)
    first, second = ring_modes(signal, DT)
    assert first.frequency == pytest.approx(2.3, rel=5e-3)
    assert first.damping == pytest.approx(damping, abs=2e-3 + 0.02 * abs(damping))
    assert first.amplitude == pytest.approx(100.0, rel=0.05)
    assert second.frequency == pytest.approx(8.3, rel=5e-3)
    assert second.damping == pytest.approx(0.02, abs=2e-3)


def test_in_noise() -> None:
    """Noise of 2 um/m on 100 um/m leaves 5 % of frequency and 0.01 of damping."""
    noise = 2.0 * np.random.default_rng(0).standard_normal(5000)
    mode, = ring_modes(decay(2.3, 0.05, 100.0) + noise, DT, count=1)
    assert mode.frequency == pytest.approx(2.3, rel=0.02)
    assert mode.damping == pytest.approx(0.05, abs=0.01)


def test_refusals() -> None:
    """Too short and not finite signals are refused."""
    with pytest.raises(SignalError, match='too few'):
        ring_modes(np.zeros(5), DT)
    with pytest.raises(SignalError, match='finite'):
        ring_modes(np.full(5000, np.nan), DT)
