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

"""Stamps that jitter on an even sampling become even, and no others."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from sample_arms import multisine, recording_of

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.signals.preprocessing import retimed, timing
from tudor_dynamics.typing import FloatArray

RATE = 100.0


def _positions(t: FloatArray) -> FloatArray:
    return multisine(t, 2, 3)[:, :2]


def _even(count: int = 1500) -> Recording:
    return recording_of(_positions(np.arange(count) / RATE), RATE)


def _jittered(recording: Recording, size: float, seed: int) -> Recording:
    late = np.random.default_rng(seed).normal(0.0, size * 1e9, len(recording.stamp))
    return replace(recording, stamp=recording.stamp + np.round(late).astype(np.int64))


@settings(deadline=None, max_examples=20)
@given(size=st.floats(3e-4, 1.2e-3), seed=st.integers(0, 1000))
def test_jitter_is_taken_out(size: float, seed: int) -> None:
    """The even stamps come back to a part of the jitter, which is told."""
    even = _even()
    found, why = retimed(_jittered(even, size, seed))
    assert why is not None
    assert why.jitter == pytest.approx(size, rel=0.1)
    assert why.even < 0.2 * why.now
    assert np.max(np.abs(found.stamp - even.stamp)) < 0.3 * size * 1e9
    assert any('even stamps' in warning for warning in found.warnings)


def test_even_stamps_stay() -> None:
    """Nothing is said of a bag without jitter."""
    recording = _even()
    assert retimed(recording) == (recording, None)


def test_samples_that_were_taken_unevenly_stay() -> None:
    """Where the samples themselves jitter, their stamps are right."""
    t = np.arange(1500) / RATE
    t = t + np.random.default_rng(1).normal(0.0, 1e-3, len(t))
    recording = recording_of(_positions(t), RATE)
    recording = replace(recording, stamp=recording.stamp[0] + np.round(t * 1e9).astype(np.int64))
    found, why = retimed(recording)
    assert why is None
    assert found is recording
    seen = timing(recording)
    assert seen is not None
    assert seen.now < 0.3 * seen.even


def test_lost_samples_leave_their_places() -> None:
    """Two messages that were lost leave a hole, and do not shift what follows."""
    even = _even()
    kept = np.delete(np.arange(len(even.stamp)), [400, 900])
    recording = replace(even, stamp=even.stamp[kept], q=even.q[kept],
                        segments=(slice(0, len(kept)),))
    found, why = retimed(_jittered(recording, 8e-4, 2))
    assert why is not None
    assert np.max(np.abs(found.stamp - recording.stamp)) < 0.3e6
