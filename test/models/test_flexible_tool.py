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

"""How a tool rings beside the robot: amplitude, and when it is quiet."""

from __future__ import annotations

import numpy as np
import pytest
from tool_making import ARM, FREQUENCIES, KNOWN, moves, RATE, tool_efforts

from tudor_dynamics.models.flexible_tool import FlexibleTool, RingObserver
from tudor_dynamics.typing import FloatArray


def ringing(q: FloatArray) -> FloatArray:
    """Give what efforts have over those of a tool that does not bend, which rigid models know."""
    stiff = tool_efforts(ARM, q, frequencies=(60.0, 60.0), damping=0.5)
    return np.asarray(tool_efforts(ARM, q) - stiff)


def watched(q: FloatArray, residual: FloatArray, tool: FlexibleTool = KNOWN,
            ) -> tuple[RingObserver, FloatArray]:
    """Let the observer follow a record; give it with the amplitudes (samples, joints)."""
    observer = RingObserver(ARM, tool)
    return observer, np.array([
        observer.step(1.0 / RATE if k else 0.0, q[k], residual[k]) for k in range(len(q))])


@pytest.mark.parametrize(('off', 'mean'), [(1.0, 0.0), (0.97, 0.0), (1.0, 0.6)])
def test_amplitude_after_a_move(off: float, mean: float) -> None:
    """It is that of the efforts within 25 %, also in noise, beside a mean, and 3 % off."""
    for seed in (2, 3):
        q = moves(seed, count=1, rest=4.0)
        efforts = ringing(q)
        noisy = efforts + mean + np.random.default_rng(seed).normal(0.0, 0.02, efforts.shape)
        _, found = watched(q, noisy, KNOWN.model_copy(update={
            'frequencies': [off * one for one in FREQUENCIES]}))
        # both planes beat: it is that of both together, which is there once in a beat
        period = int(RATE / FREQUENCIES[0])
        begins = range(len(q) - int(2.8 * RATE), len(q) - int(0.5 * RATE), 10)
        truth = np.array([0.5 * np.ptp(efforts[k:k + period], axis=0) for k in begins])
        loudest = int(truth.sum(axis=0).argmax())
        told = np.array([found[k + period // 2, loudest] for k in begins])
        assert 0.85 < np.max(truth[:, loudest] / told) < 1.25


def test_when_it_is_quiet() -> None:
    """The time that is told is that which passes, within a fifth; then it says so."""
    q = moves(3, count=1, rest=14.0)
    efforts = ringing(q)
    observer = RingObserver(ARM, KNOWN)
    told, quiet = 0.0, 0.0
    for k, residual in enumerate(efforts):
        observer.step(1.0 / RATE if k else 0.0, q[k], residual)
        if k == len(q) - 12 * RATE:
            text = str(observer)
            assert ' N m at j' in text
            told = float(text.rsplit('in ', 1)[1].removesuffix(' s'))
        if told and not quiet and str(observer) == 'quiet':
            quiet = k / RATE - (len(q) / RATE - 12.0)
    assert told > 2.0 and quiet == pytest.approx(told, rel=0.2)


def test_a_still_arm_and_a_new_beginning() -> None:
    """Noise alone is quiet; after a gap nothing is left of what rang before it."""
    q = np.zeros((600, 5))
    noise = np.random.default_rng(0).normal(0.0, 0.01, q.shape)
    observer, _ = watched(q, noise)
    assert str(observer) == 'quiet'
    rings = np.sin(2.0 * np.pi * FREQUENCIES[0] * np.arange(600.0) / RATE)[:, None] * np.ones(5)
    observer, found = watched(q, rings)
    assert found[-1].max() > 0.3
    assert not observer.step(0.0, q[0], 0.0 * rings[0]).any()
