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


"""Low-passes in sections: the filters of scipy, to rounding."""

from __future__ import annotations

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from scipy import signal

from tudor_dynamics.signals.filters import (
    butterworth, chebyshev, forward_backward, low_pass, low_pass_sections)


def _record(n: int, channels: int, seed: int = 0) -> np.ndarray:
    """Make a slow motion with noise on it, of about 1."""
    generator = np.random.default_rng(seed)
    motion = np.sin(0.02 * np.arange(n)[:, None] + generator.uniform(0, 6, channels))
    return motion + 0.1 * generator.normal(size=(n, channels))


@settings(max_examples=60, deadline=None)
@given(order=st.sampled_from([2, 4, 6, 8]), cutoff=st.floats(0.01, 0.49), n=st.integers(2, 600),
       channels=st.integers(1, 9), pad=st.integers(0, 300), seed=st.integers(0, 2**31))
def test_butterworth(
    order: int, cutoff: float, n: int, channels: int, pad: int, seed: int,
) -> None:
    """
    A record comes out as scipy filters it; from corners of 1 % of the sample rate on to 1e-10.

    Below, scipy's own sections lose digits, which are differences of numbers that are nearly 1.
    """
    x, pad = _record(n, channels, seed), min(pad, n - 1)
    sos = signal.butter(order, 2.0 * cutoff, output='sos')
    expected = signal.sosfiltfilt(sos, x, axis=0, padlen=pad)
    found = forward_backward(low_pass_sections(butterworth(order), cutoff), x, pad)
    assert np.max(np.abs(found - expected)) < 1e-10


@pytest.mark.parametrize('factor', [2, 5, 10, 50])
def test_chebyshev(factor: int) -> None:
    """The anti-alias filter is that of scipy's `decimate`, with a gain of 1 at 0 Hz."""
    x = _record(4000, 3)
    sos = signal.cheby1(8, 0.05, 0.8 / factor, output='sos')
    at_rest = signal.sosfreqz(sos, [0.0])[1][0].real
    expected = signal.sosfiltfilt(sos, x, axis=0, padlen=300) / at_rest ** 2
    found = forward_backward(low_pass_sections(chebyshev(8, 0.05), 0.4 / factor), x, 300)
    assert np.max(np.abs(found - expected)) < 1e-11


def test_first_order() -> None:
    """The causal low-pass is scipy's filter of the same pole."""
    x, dt = _record(2000, 3), 0.01
    gain = 1.0 - np.exp(-2.0 * np.pi * 20.0 * dt)
    expected, _ = signal.lfilter([gain], [1.0, gain - 1.0], x, axis=0, zi=(1.0 - gain) * x[:1])
    assert np.max(np.abs(low_pass(x, np.full(2000, dt), 20.0, x[0]) - expected)) < 1e-12
