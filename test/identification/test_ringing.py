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

"""Vibrations are found in what a rigid model leaves over, and only there."""

from __future__ import annotations

import numpy as np
import pytest
from sample_arms import multisine, recording_of
from scipy import signal

from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.identification.dataset import BagChoice, BagData
from tudor_dynamics.identification.ringdowns import find_ringing
from tudor_dynamics.signals.preprocessing import prepare, Stretch
from tudor_dynamics.typing import FloatArray

RATE = 100.0


class Rigid:
    """Predicts 100 times the position."""

    payload_range = None
    channels = ('hub', 'mid')

    def follow(self, stretch: Stretch) -> FloatArray:
        """Give both channels."""
        return 100.0 * stretch.motion[:, :2]


def _bag(added: FloatArray, seed: int = 0, gaps: tuple[int, ...] = ()) -> BagData:
    q = multisine(np.arange(len(added)) / RATE, 2, seed)[:, :2]
    recording = recording_of(q, RATE, strain=100.0 * q + added, gaps=gaps)
    spec = PreprocessingSpec(rate=20.0)
    return BagData(BagChoice('bag'), recording, tuple(prepare(recording, spec)))


def _noise(seed: int, size: float = 1.0, n: int = 8000) -> FloatArray:
    return np.asarray(np.random.default_rng(seed).normal(0, size, (n, 2)))


def _resonance(frequency: float, damping: float, seed: int) -> FloatArray:
    """Shake a lightly damped oscillator by noise; scaled to rms 10."""
    w = 2 * np.pi * frequency
    system = signal.cont2discrete(([w * w], [1, 2 * damping * w, w * w]), 1 / RATE, 'zoh')
    y = signal.lfilter(system[0].ravel(), system[1], _noise(seed)[:, 0])
    return np.asarray(10.0 * y / y.std())


@pytest.mark.parametrize('frequency', [1.8, 3.07, 13.2])
def test_resonance_is_found(frequency: float) -> None:
    """A lightly damped resonance in one channel is found there, within 0.15 Hz, with its size."""
    bags = []
    for seed in range(2):
        added = _noise(seed)
        added[:, 1] += _resonance(frequency, 0.005, seed + 5)
        bags.append(_bag(added, seed))
    found, = find_ringing(Rigid(), bags, 'strain')
    assert found.channel == 'mid'
    assert found.frequency == pytest.approx(frequency, abs=0.15)
    assert found.rms == pytest.approx(10.0, rel=0.25)
    assert found.share > 0.7
    assert f'mid rings at {found.frequency:.2f} Hz' in str(found)


def test_across_a_gap() -> None:
    """A gap does not hide it: each side is looked at by itself."""
    added = _noise(0, 0.1)
    added += 20 * np.sin(2 * np.pi * 4.0 * np.arange(8000) / RATE)[:, None]
    found = find_ringing(Rigid(), [_bag(added, gaps=(4321,))], 'strain')
    assert [r.channel for r in found] == ['hub', 'mid']
    assert all(abs(r.frequency - 4.0) < 0.1 for r in found)


@pytest.mark.parametrize('seed', range(5))
def test_what_is_no_ringing(seed: int) -> None:
    """White noise, slow model error, and a tremor that is tiny beside the signal do not ring."""
    assert find_ringing(Rigid(), [_bag(_noise(seed, 20.0))], 'strain') == ()
    slow = signal.lfilter([1e-3], [1, -0.999], _noise(seed, 300.0), axis=0)
    assert find_ringing(Rigid(), [_bag(slow + _noise(seed + 9, 0.1), seed)], 'strain') == ()
    swing = 20.0 * np.sin(2 * np.pi * 0.6 * np.arange(8000) / RATE)[:, None]
    assert find_ringing(Rigid(), [_bag(swing + _noise(seed, 0.1), seed)], 'strain') == ()
    tiny = 0.3 * np.sin(2 * np.pi * 3.0 * np.arange(8000) / RATE)[:, None]
    assert find_ringing(Rigid(), [_bag(tiny + _noise(seed, 0.01))], 'strain') == ()


def test_too_short_to_tell() -> None:
    """Under eight seconds nothing is said."""
    added = 20 * np.sin(2 * np.pi * 4.0 * np.arange(700) / RATE)[:, None] * np.ones(2)
    assert find_ringing(Rigid(), [_bag(added)], 'strain') == ()
