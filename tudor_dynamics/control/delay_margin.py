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

"""
What the delay of the loop leaves of the damper's gain and of the position gain.

Strain feedback that comes late feeds the links instead of taking energy out of them, the second
mode first. The rule is one of thumb: the gain that is still stable falls with the delay, and the
share given here keeps to about half of it on the reference arm (``bench/damper_delay.py``).
"""

from __future__ import annotations

SLOPE = 1.5
"""Power with which the share falls."""
FADES, GONE = 4.0, 5.0
"""Multiples of the full delay between which the rest fades to none."""
PHASE = 0.25
"""Position gain times delay: 14 deg of phase at the corner of the position loop."""


def damping_share(delay: float, full: float) -> float:
    """Give the part of the damper's gain that a delay allows: delay, full [s]."""
    ratio = delay / full
    if ratio <= 1.0:
        return 1.0
    return ratio**-SLOPE * min(max((GONE - ratio) / (GONE - FADES), 0.0), 1.0)


def position_gain_limit(delay: float) -> float:
    """Give the largest position gain [1/s] for a delay of the loop, drives included [s]."""
    return PHASE / max(delay, 1e-3)
