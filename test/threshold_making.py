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

"""Residuals of two links that ring, a walk of them through thresholds, and plain thresholds."""

from __future__ import annotations

import numpy as np

from tudor_dynamics.online.detector import Excess, ExcessStage
from tudor_dynamics.online.settings import LAGS, WINDOW
from tudor_dynamics.online.streams import Motion, Residual
from tudor_dynamics.online.threshold_learning import FreeMotion
from tudor_dynamics.online.thresholds import MethodThresholds, Tail

CHANNELS = ('a', 'b')


def ringing(seconds: float, seed: int, rate: float = 100.0) -> FreeMotion:
    """Make residuals of two links that ring at 2.5 Hz, driven by noise, and a motion."""
    rng = np.random.default_rng(seed)
    n = int(seconds * rate)
    t = np.arange(n) / rate
    pole = np.exp((-0.03 + 1j) * 2 * np.pi * 2.5 / rate)
    state, out = np.zeros(2, dtype=complex), np.empty((n, 2))
    for k in range(n):
        state = pole * state + rng.normal(size=2) * np.sqrt(100.0 / rate)
        out[k] = state.real + 0.2 * rng.normal(size=2)
    q = np.stack([np.sin(t), np.cos(0.7 * t)], axis=1)
    dq = np.stack([np.cos(t), -0.7 * np.sin(0.7 * t)], axis=1)
    ddq = np.stack([-np.sin(t), -0.49 * np.cos(0.7 * t)], axis=1)
    stamp = 10**18 + (t * 1e9).round().astype(np.int64)
    return FreeMotion(stamp, np.hstack([q, dq, ddq]), out)


def walk(stage: ExcessStage, record: FreeMotion, push=0.0) -> list[Excess]:
    """Run samples through a stage, with a push added to the residual."""
    push = np.broadcast_to(np.asarray(push, dtype=float).reshape(-1, 1), record.residual.shape)
    return [stage.step(Residual(Motion(int(s), 9.0, 0.01, m), r, r, r))
            for s, m, r in zip(record.stamp, record.motion, record.residual + push, strict=True)]


def plain_thresholds(
    channels: tuple[str, ...], joints: int = 2, size: float = 6.0,
) -> MethodThresholds:
    """Make thresholds that are the same in all motion: some three sizes of the residual."""
    n = len(channels)
    taps = np.zeros((LAGS + WINDOW, n, n))
    taps[0] = np.eye(n)
    profile = np.zeros((2 * n, 1 + 4 * joints))
    profile[:, 0] = size
    tail, never = (Tail(location, 0.5, 0.0, 0.2, 6.0, 50.0) for location in (3.0, 1e9))
    return MethodThresholds(
        channels, 0.01, taps, profile, (tail,) * 2 * n + (never,) * n, 120.0, np.full(n, 1.0),
        np.full(joints, 1.8), np.zeros(n))
