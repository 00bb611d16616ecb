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

"""How sure the doctor has to be: gaps, short recordings, faults at once, what one fault hides."""

from __future__ import annotations

from dataclasses import replace

from doctor_making import altered, column, described, healthy, late
import numpy as np
import pytest

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification.doctor.alternatives import axis_name, choose
from tudor_dynamics.identification.doctor.case import Case, decimate, Delay
from tudor_dynamics.identification.doctor.examine import examine
from tudor_dynamics.identification.doctor.findings import Finding


def _findings(recording: Recording) -> tuple[Finding, ...]:
    return examine(described(), recording).findings


def _parted(recording: Recording, *places: int, gap: float = 2.0) -> Recording:
    """Leave some seconds out before the samples at some places."""
    stamp = recording.stamp.copy()
    for place in places:
        stamp[place:] += round(gap * 1e9)
    edges = [0, *places, len(stamp)]
    return replace(recording, stamp=stamp, segments=tuple(
        slice(begin, end) for begin, end in zip(edges[:-1], edges[1:], strict=True)))


def _late_efforts(recording: Recording, seconds: float) -> Recording:
    return replace(recording, effort=late(recording.effort, recording.t, seconds))


def test_gaps_are_no_fault() -> None:
    """A recording in three parts is judged as one of the same motion."""
    assert _findings(_parted(healthy(), 700, 1500)) == ()


def test_faults_are_found_across_gaps() -> None:
    """The lag is that of all parts together."""
    finding, = _findings(_parted(_late_efforts(healthy(), 0.05), 700, 1500))
    assert finding.kind == 'effort_late'
    assert finding.size == pytest.approx(0.05, abs=0.01)


def test_parts_of_less_than_three_seconds_are_left_out() -> None:
    """What remains is judged; where nothing remains nothing is."""
    parted = _parted(healthy(), 200)
    seen = decimate(parted)
    assert seen is not None and seen.t[0] > parted.t[200]
    assert decimate(_parted(healthy(seconds=6.0), 200, 400)) is None


def test_what_is_compared_has_one_bandwidth() -> None:
    """Few samples, motion from the positions, and each output at the same instants."""
    recording = healthy(velocity=True)
    seen = decimate(recording)
    assert seen is not None
    assert 300 < len(seen.t) <= 800 and np.all(np.diff(seen.t) >= 0.03 - 1e-9)
    q, dq, ddq = np.split(seen.motion, 3, axis=1)
    at = np.searchsorted(recording.t, seen.t - 1e-6)
    assert np.abs(q - recording.q[at]).max() < 1e-3
    assert recording.dq is not None and np.abs(dq - recording.dq[at]).max() < 0.02
    assert seen.output('effort').shape == (len(seen.t), 2)
    assert np.abs(seen.output('velocity') - dq).max() < 0.02
    # as if it had come 50 ms earlier
    moved = seen.output('velocity', Delay(0.05))
    assert np.sqrt(np.mean((moved - dq - 0.05 * ddq) ** 2)) < 0.05 * np.std(dq)


@pytest.mark.parametrize(('seconds', 'lag', 'named'), [
    (24.0, 0.02, True), (6.0, 0.02, False), (6.0, 0.06, True)])
def test_short_recordings_have_to_show_more(seconds: float, lag: float, named: bool) -> None:
    """Twenty milliseconds show in 24 s and not in six; sixty do."""
    kinds = [item.kind for item in _findings(_late_efforts(healthy(seconds=seconds), lag))]
    assert kinds == ['effort_late'] * named


def test_a_lag_beyond_those_tried_is_none() -> None:
    """Outputs of another motion are not called late."""
    recording = healthy()
    other = healthy(seed=9)
    found = _findings(replace(recording, effort=other.effort, strain=other.strain))
    assert not {'effort_late', 'strain_late'} & {item.kind for item in found}


def test_a_lag_is_found_with_a_sign_put_right() -> None:
    """Two faults of one bag: the joint counts the other way, and its efforts come late."""
    recording = _late_efforts(healthy(), 0.06)
    kinds = [item.kind for item in _findings(replace(recording, q=recording.q * [1.0, -1.0]))]
    assert kinds[:2] == ['joint_sign', 'effort_late']


def test_a_lag_is_found_with_a_unit_put_right() -> None:
    """Efforts in thousandths that come late."""
    recording = _late_efforts(healthy(), 0.06)
    assert recording.effort is not None
    findings = _findings(replace(recording, effort=1e3 * recording.effort))
    assert [item.kind for item in findings] == ['effort_unit', 'effort_late']
    assert findings[1].size == pytest.approx(0.06, abs=0.01)


def test_a_drift_is_not_taken_for_another_description() -> None:
    """One gauge that drifts far does not make joints or gravity wrong."""
    recording = healthy()
    findings = _findings(replace(recording, strain=column(
        recording.strain, 1, lambda x: x + 60.0 * recording.t)))
    assert [(item.kind, item.channels) for item in findings] == [('drift', ('g2',))]


def test_a_dead_effort_does_not_turn_its_joint() -> None:
    """Friction of what has died says nothing of directions."""
    recording = healthy()
    random = np.random.default_rng(1)
    effort = column(recording.effort, 0, lambda x: np.where(
        recording.t > 12.0, random.normal(0.0, 0.02, len(x)), x))
    kinds = {item.kind for item in _findings(replace(recording, effort=effort))}
    assert 'dying' in kinds and not {'effort_sign', 'joint_sign', 'gravity_axis'} & kinds


@pytest.mark.filterwarnings('error')
def test_an_effort_that_dies_in_a_gap() -> None:
    """No window of the gap says when it was last alive."""
    recording = healthy(seconds=40.0)
    effort = column(recording.effort, 0, lambda x: np.where(
        recording.t < 8.0, x, 0.01 * np.sin(40.0 * recording.t)))
    finding, = _findings(_parted(replace(recording, effort=effort), 800, gap=4.5))
    assert finding.kind == 'dying' and finding.time == pytest.approx(8.0, abs=2.0)


def test_gravity_off_is_another_arm() -> None:
    """An arm that lies flat by its description gets no advice from a gravity of zero."""
    arm = altered(described(), gravity=[0.0, 0.0, 0.0])
    assert 'gravity_axis' not in {item.kind for item in examine(arm, healthy()).findings}


@pytest.mark.parametrize(('gravity', 'name'), [
    ((0.0, 0.0, -9.81), '-z'), ((9.81, 0.0, 0.0), '+x'), ((0.1, -9.8, 0.0), '-y'),
    ((6.0, 0.0, -6.0), '(0.71, 0.00, -0.71)')])
def test_names_of_directions(gravity: tuple[float, ...], name: str) -> None:
    """Axes by their letter, what lies between them by its components."""
    assert axis_name(np.array(gravity)) == name


def test_a_disturbance_of_some_seconds_is_no_structure() -> None:
    """A slow disturbance of 6 s is no coupling, and no exchange of joints."""
    one = healthy(seed=1, seconds=6.0)
    assert one.effort is not None
    waves = np.stack([np.sin(0.6 * np.pi * one.t), np.cos(0.6 * np.pi * one.t)], axis=1)
    disturbed = replace(one, effort=one.effort + one.effort.std(axis=0) * waves, strain=None)
    decimated = decimate(disturbed)
    assert decimated is not None and choose(Case(described(), disturbed, decimated)) == []
