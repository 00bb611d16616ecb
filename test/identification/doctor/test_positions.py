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

"""Positions that creep or err with their angle, and stamps that count another time."""

from __future__ import annotations

from dataclasses import replace

from doctor_making import column, described, healthy
import numpy as np
import pytest

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification.doctor.examine import examine


def _found(recording: Recording) -> list[tuple[str, tuple[str, ...]]]:
    return [(one.kind, one.channels) for one in examine(described(), recording).findings]


@pytest.mark.parametrize('velocity', [False, True])
def test_position_that_creeps(velocity: bool) -> None:
    """The outputs follow the angle that is right: by how much the position creeps is said."""
    recording = healthy(velocity=velocity)
    q = column(recording.q, 1, lambda x: x - 0.2 * recording.t / recording.t[-1])
    finding, = examine(described(), replace(recording, q=q)).findings
    assert (finding.kind, finding.channels) == ('position_drift', ('j2',))
    assert finding.size == pytest.approx(0.2, rel=0.1) and finding.unit == 'rad'
    assert 'drifts by -0.2' in finding.what


def test_encoder_off_its_centre() -> None:
    """An error that goes with the angle is found with its size and its waves a turn."""
    recording = healthy(seconds=40.0)
    q = column(recording.q, 0, lambda x: x + 0.05 * np.sin(5.0 * x + 1.0))
    finding, = examine(described(), replace(recording, q=q)).findings
    assert (finding.kind, finding.channels) == ('position_ripple', ('j1',))
    assert finding.size == pytest.approx(0.05, rel=0.1)
    assert 'repeats 5 times a turn' in finding.what


@pytest.mark.parametrize('pace', [0.5, 2.0])
def test_stamps_of_another_rate(pace: float) -> None:
    """Weight says how fast the motion is, also where no velocity was recorded."""
    recording = healthy(seconds=40.0)
    first = recording.stamp[0]
    stamp = first + ((recording.stamp - first) * pace).astype(np.int64)
    finding, = examine(described(), replace(
        recording, stamp=stamp, dt=recording.dt * pace)).findings
    assert (finding.kind, finding.size) == ('time_scale', 1.0 / pace)
    assert f'{pace:g} times as fast' in finding.what


def test_small_errors_of_a_position_are_none() -> None:
    """What every encoder has is not reported."""
    recording = healthy()
    for error in (0.005 * np.sin(5.0 * recording.q), 0.01 * recording.t[:, None] / 24.0):
        assert _found(replace(recording, q=recording.q + error)) == []
