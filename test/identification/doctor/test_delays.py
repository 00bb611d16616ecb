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

"""Outputs that come late: by one channel, by seconds, and more and more."""

from __future__ import annotations

from dataclasses import replace
import math

from doctor_making import column, described, healthy, late
import numpy as np
import pytest
from scipy.signal import lfilter

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification.doctor.examine import examine
from tudor_dynamics.identification.doctor.findings import Finding
from tudor_dynamics.typing import FloatArray


def found(recording: Recording) -> dict[str, Finding]:
    """Give what is found, by kind."""
    return {item.kind: item for item in examine(described(), recording).findings}


def slow(x: FloatArray) -> FloatArray:
    """Filter by a lag of 0.15 s, at 100 Hz."""
    keep = math.exp(-0.01 / 0.15)
    return lfilter([1.0 - keep], [1.0, -keep], x, zi=[keep * x[0]])[0]


def test_one_effort_is_filtered() -> None:
    """Its joint is named, and about how late it comes; the other joint is not."""
    one = healthy(seconds=40.0)
    finding = found(replace(one, strain=None, effort=column(one.effort, 0, slow)))['effort_late']
    assert finding.channels == ('j1',)
    assert finding.size == pytest.approx(0.15, abs=0.05)


def test_one_velocity_is_filtered() -> None:
    """The derivative of the positions shows it, joint by joint."""
    one = healthy(seconds=40.0, velocity=True)
    assert found(replace(one, dq=column(one.dq, 1, slow)))['velocity_late'].channels == ('j2',)


def test_clocks_that_are_apart_by_a_second() -> None:
    """Far beyond what filters do."""
    one = healthy(seconds=60.0)
    effort = late(one.effort, one.t, 1.0)[100:]
    finding = found(replace(
        one, strain=None, effort=effort, q=one.q[100:], stamp=one.stamp[100:],
        segments=(slice(0, len(effort)),)))['effort_late']
    assert finding.channels == () and finding.size == pytest.approx(1.0, abs=0.02)


def test_a_clock_that_runs_fast() -> None:
    """Efforts that come later and later."""
    one = healthy(seconds=60.0)
    assert one.effort is not None
    fast = np.stack([np.interp(one.t / 1.004, one.t, x) for x in one.effort.T], axis=1)
    assert 'ms later each second' in found(
        replace(one, strain=None, effort=fast))['effort_late'].what
