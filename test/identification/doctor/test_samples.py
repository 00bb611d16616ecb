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

"""What single channels show, and what they do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sample_arms import multisine, recording_of

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification.doctor.examine import look_at_samples
from tudor_dynamics.identification.doctor.samples import flat, moving, outliers, standstill
from tudor_dynamics.typing import FloatArray

RATE = 100.0
JOINTS, GAUGES = ('j1', 'j2'), ('g1', 'g2')


@pytest.fixture
def recording() -> Recording:
    """Give twenty seconds of motion with strains that follow it, with noise."""
    motion = multisine(np.arange(2000) / RATE, 2, 5)
    strain = 100.0 * motion[:, :2] + np.random.default_rng(0).normal(0.0, 1.0, (2000, 2))
    return recording_of(motion[:, :2], RATE, strain=strain, path='run')


def _strain(recording: Recording, values: FloatArray) -> Recording:
    assert recording.strain is not None
    return replace(recording, strain=np.column_stack([recording.strain[:, 0], values]))


def test_a_clean_recording_stays_clean(recording: Recording) -> None:
    """Nothing is said, and nothing is changed."""
    same, findings = look_at_samples(recording, JOINTS, GAUGES)
    assert same is recording
    assert findings == []


@pytest.mark.parametrize('size', [5.0, 1e10])
def test_an_outlier_has_place_and_size(recording: Recording, size: float) -> None:
    """One sample far off is named and put right for the checks that follow."""
    q = recording.q.copy()
    q[700, 1] += size
    clean, (finding,) = outliers(replace(recording, q=q), JOINTS, GAUGES)
    assert (finding.kind, finding.channels) == ('outlier', ('j2',))
    assert finding.time == pytest.approx(7.0)
    assert finding.size == pytest.approx(size, rel=0.05)
    assert clean.q[700, 1] == pytest.approx(recording.q[700, 1], abs=0.01)


def test_a_constant_channel(recording: Recording) -> None:
    """A sensor that never changes is named with its value."""
    finding, = flat(_strain(recording, np.full(2000, 7.0)), JOINTS, GAUGES)
    assert (finding.kind, finding.channels, finding.size) == ('constant', ('g2',), 7.0)


def test_a_held_channel(recording: Recording) -> None:
    """Place and length of a value that is held."""
    assert recording.strain is not None
    values = recording.strain[:, 1].copy()
    values[600:850] = values[600]
    finding, = flat(_strain(recording, values), JOINTS, GAUGES)
    assert (finding.kind, finding.channels) == ('held', ('g2',))
    assert finding.time == pytest.approx(6.0)
    assert finding.size == pytest.approx(2.5, abs=0.05)


def test_a_channel_that_is_held_to_the_end_dies(recording: Recording) -> None:
    """From when on nothing comes any more."""
    assert recording.strain is not None
    values = recording.strain[:, 1].copy()
    values[1200:] = values[1200]
    finding, = flat(_strain(recording, values), JOINTS, GAUGES)
    assert (finding.kind, finding.time) == ('dying', pytest.approx(12.0))


def test_a_saturated_channel(recording: Recording) -> None:
    """The bound is named."""
    assert recording.strain is not None
    bound = float(np.percentile(recording.strain[:, 1], 85.0))
    finding, = flat(_strain(recording, np.minimum(recording.strain[:, 1], bound)), JOINTS, GAUGES)
    assert (finding.kind, finding.size) == ('saturated', pytest.approx(bound))


def test_few_digits_are_no_saturation(recording: Recording) -> None:
    """A sensor with coarse steps has flat runs everywhere."""
    assert recording.strain is not None
    assert flat(_strain(recording, 40.0 * np.round(recording.strain[:, 1] / 40.0)),
                JOINTS, GAUGES) == []


def test_standstill_at_the_ends(recording: Recording) -> None:
    """Seconds before and after the motion, and what to write to leave them out."""
    q = np.vstack([np.repeat(recording.q[:1], 500, axis=0), recording.q])
    longer = recording_of(q, RATE, path='run')
    finding, = standstill(longer, moving(longer))
    assert finding.kind == 'standstill'
    assert finding.size == pytest.approx(5.0, abs=0.3)
    assert 'BAG@' in finding.remedy
