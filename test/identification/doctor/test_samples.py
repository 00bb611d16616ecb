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
from tudor_dynamics.identification.doctor.findings import Finding
from tudor_dynamics.identification.doctor.samples import look_at_samples
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


def _found(recording: Recording) -> list[Finding]:
    return look_at_samples(recording, JOINTS, GAUGES)[1]


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
    clean, (finding,) = look_at_samples(replace(recording, q=q), JOINTS, GAUGES)
    assert (finding.kind, finding.channels) == ('outlier', ('j2',))
    assert finding.time == pytest.approx(7.0)
    assert finding.size == pytest.approx(size, rel=0.05)
    assert clean.q[700, 1] == pytest.approx(recording.q[700, 1], abs=0.01)


def test_single_samples_far_off_in_noise(recording: Recording) -> None:
    """However much a channel changes from sample to sample, none is off by its whole range."""
    assert recording.strain is not None
    values = recording.strain[:, 1] + np.random.default_rng(1).normal(0.0, 3.0, 2000)
    values[[300, 900, 1500]] += np.ptp(values)
    finding, = _found(_strain(recording, values))
    assert finding.kind == 'outlier' and '3 samples' in finding.what


def test_a_constant_channel(recording: Recording) -> None:
    """A sensor that never changes is named with its value."""
    finding, = _found(_strain(recording, np.full(2000, 7.0)))
    assert (finding.kind, finding.channels, finding.size) == ('constant', ('g2',), 7.0)


def test_a_held_channel(recording: Recording) -> None:
    """Place and length of a value that is held."""
    assert recording.strain is not None
    values = recording.strain[:, 1].copy()
    values[600:850] = values[600]
    finding, = _found(_strain(recording, values))
    assert (finding.kind, finding.channels) == ('held', ('g2',))
    assert finding.time == pytest.approx(6.0)
    assert finding.size == pytest.approx(2.5, abs=0.05)


def test_a_channel_that_is_held_to_the_end_dies(recording: Recording) -> None:
    """From when on nothing comes any more."""
    assert recording.strain is not None
    values = recording.strain[:, 1].copy()
    values[1200:] = values[1200]
    finding, = _found(_strain(recording, values))
    assert (finding.kind, finding.time) == ('dying', pytest.approx(12.0))


def test_a_saturated_channel(recording: Recording) -> None:
    """The bound is named."""
    assert recording.strain is not None
    bound = float(np.percentile(recording.strain[:, 1], 85.0))
    finding, = _found(_strain(recording, np.minimum(recording.strain[:, 1], bound)))
    assert (finding.kind, finding.size) == ('saturated', pytest.approx(bound))


def test_few_digits_are_no_saturation(recording: Recording) -> None:
    """A sensor with coarse steps has flat runs everywhere."""
    assert recording.strain is not None
    finding, = _found(_strain(recording, 40.0 * np.round(recording.strain[:, 1] / 40.0)))
    assert (finding.kind, finding.size) == ('coarse_channel', pytest.approx(40.0))


def test_standstill_at_the_ends(recording: Recording) -> None:
    """Seconds before and after the motion, and what to write to leave them out."""
    q = np.vstack([np.repeat(recording.q[:1], 500, axis=0), recording.q])
    longer = recording_of(q, RATE, path='run')
    finding, = look_at_samples(longer, JOINTS, ())[1]
    assert finding.kind == 'standstill'
    assert finding.size == pytest.approx(5.0, abs=0.3)
    assert finding.remedy.startswith('use run@')


@pytest.mark.parametrize(('width', 'many'), [
    (1, 'one sample'), (2, '2 samples'), (3, '3 samples')])
def test_a_few_samples_in_a_row(recording: Recording, width: int, many: str) -> None:
    """Up to three are outliers, and are counted."""
    assert recording.strain is not None
    values = recording.strain[:, 1].copy()
    values[900:900 + width] += 5000.0
    finding, = _found(_strain(recording, values))
    assert finding.kind == 'outlier' and many in finding.what


def test_a_jump_is_no_outlier(recording: Recording) -> None:
    """What does not come back is another zero, and four samples in a row are a signal."""
    assert recording.strain is not None
    jump, four = recording.strain[:, 1].copy(), recording.strain[:, 1].copy()
    jump[900:] += 5000.0
    four[900:904] += 5000.0
    for values in (jump, four):
        assert 'outlier' not in {item.kind for item in _found(_strain(recording, values))}


def test_a_gap_is_no_outlier(recording: Recording) -> None:
    """Samples are compared with those before and after without a gap."""
    assert recording.strain is not None
    values = recording.strain[:, 1].copy()
    values[900:] += 5000.0
    strain = np.column_stack([recording.strain[:, 0], values])
    parted = recording_of(recording.q, RATE, strain=strain, gaps=(900,), path='run')
    assert _found(parted) == []


def test_outliers_of_several_channels_are_all_put_right(recording: Recording) -> None:
    """Each is named by itself, and the checks that follow see none of them."""
    assert recording.strain is not None
    strain = recording.strain.copy()
    strain[300, 0] += 9000.0
    strain[800, 1] -= 9000.0
    clean, findings = look_at_samples(replace(recording, strain=strain), JOINTS, GAUGES)
    assert [item.channels for item in findings] == [('g1',), ('g2',)]
    assert clean.strain is not None
    assert np.abs(clean.strain - recording.strain).max() < 50.0


def test_a_value_that_is_held_at_rest_is_no_fault(recording: Recording) -> None:
    """Neither motion nor reading changes for three seconds."""
    assert recording.strain is not None
    q, strain = recording.q.copy(), recording.strain.copy()
    still = slice(600, 900)
    q[still], strain[still] = q[600], strain[600]
    q[still.stop:] += q[600] - q[still.stop]  # it goes on from where it stood
    assert _found(replace(recording, q=q, strain=strain)) == []


def test_several_visits_to_the_end_of_the_range_are_a_saturation(recording: Recording) -> None:
    """A sine that is cut off keeps one value for half a second, again and again."""
    t = np.arange(2000) / RATE
    values = np.minimum(400.0 * np.sin(2.0 * t), 150.0)
    finding, = _found(_strain(recording, values))
    assert (finding.kind, finding.size) == ('saturated', 150.0)
    assert 'its longest saturation begins at' in finding.what


def test_zeros_of_a_filter_that_has_not_begun(recording: Recording) -> None:
    """They stand at the begin; a value that is held later is measured against later ones."""
    assert recording.strain is not None
    values = recording.strain[:, 1].copy()
    values[:20] = 0.0
    assert _found(_strain(recording, values)) == []
    values[600:850] = values[600]
    assert [item.kind for item in _found(_strain(recording, values))] == ['held']


def test_an_arm_that_never_moves(recording: Recording) -> None:
    """Nothing is said of sensors that do not change where nothing does."""
    still = replace(recording, q=np.zeros_like(recording.q),
                    strain=np.full_like(recording.strain, 3.0))
    assert _found(still) == []


@pytest.mark.parametrize(('before', 'after', 'remedy'), [
    (5.0, 0.0, 'use run@6'), (0.0, 5.0, 'use run@60-'), (2.0, 2.0, None)])
def test_which_part_is_in_motion(
    recording: Recording, before: float, after: float, remedy: str | None,
) -> None:
    """Less than three seconds at either end are usual; of a part, a part of it is named."""
    first, last = (np.repeat(row, round(seconds * RATE), axis=0) for row, seconds in (
        (recording.q[:1], before), (recording.q[-1:], after)))
    findings = _found(recording_of(np.vstack([first, recording.q, last]), RATE,
                                   path='run@60-100%'))
    assert [item.kind for item in findings] == ['standstill'] * (remedy is not None)
    for item in findings:
        assert item.size == pytest.approx(before + after, abs=0.3)
        assert remedy is not None and item.remedy.startswith(remedy)
