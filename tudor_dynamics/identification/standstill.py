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

"""Where a recording moves, but for standstill in the middle."""

from __future__ import annotations

import numpy as np

from tudor_dynamics.bags import Recording

STANDSTILL = 2e-3
"""Part of the largest motion of any joint that is no motion yet."""
STANDSTILL_KEPT = 0.5
"""Standstill beside the motion that stays, for what swings out and breaks away [s]."""


def motion_span(recording: Recording) -> tuple[float, float]:
    """
    Find where a recording moves, but for standstill in the middle.

    A joint that stands is held by friction that no model knows the sign of, and a long wait
    before or behind the motion would count as much as the motion.

    Returns begin, end [s].
    """
    t, q = recording.t, recording.q
    bound = STANDSTILL * max(float(np.ptp(q, axis=0).max(initial=0.0)), 1e-300)
    away = np.flatnonzero(np.any(np.abs(q - q[0]) > bound, axis=1))
    back = np.flatnonzero(np.any(np.abs(q - q[-1]) > bound, axis=1))
    if not len(away):
        return 0.0, float(t[-1])
    begin, end = float(t[away[0]]) - STANDSTILL_KEPT, float(t[back[-1]]) + STANDSTILL_KEPT
    return (begin if begin > STANDSTILL_KEPT else 0.0,
            end if end < t[-1] - STANDSTILL_KEPT else float(t[-1]))


def standstill_note(recording: Recording, span: tuple[float, float]) -> str:
    """Say what of a recording is left out because nothing moves: span [s]."""
    parts = [f'{length:.1f} s at the {end}' for length, end in (
        (span[0], 'begin'), (float(recording.t[-1]) - span[1], 'end')) if length > 0.0]
    return f'standstill of {" and ".join(parts)} is left out' if parts else ''
