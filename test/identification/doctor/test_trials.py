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

"""Remedies are tried before they are printed: hysteresis, ringing, and what is won."""

from __future__ import annotations

from dataclasses import replace

from doctor_making import altered, column, described, healthy, late
import numpy as np
import pytest
from sample_arms import recording_of

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.identification.doctor.examine import examine
from tudor_dynamics.identification.doctor.findings import UNSEEN
from tudor_dynamics.models.regressor import EffortRegressor


def _open() -> Arm:
    """Give the arm with its friction left open."""
    return altered(described(), joints=[{
        'name': name, 'effort': {'topic': 'joint_states', 'unit': 'N m'}}
        for name in ('j1', 'j2')])


@pytest.mark.parametrize('distance', [0.01, 0.05])
def test_hysteresis_is_no_lag(distance: float) -> None:
    """Friction that follows after a displacement looks like efforts that come late."""
    recording = healthy()
    assert recording.effort is not None
    state = np.zeros((len(recording.t), 2))
    for k, step in enumerate(np.diff(recording.q, axis=0)):
        state[k + 1] = np.clip(state[k] + step / distance, -1.0, 1.0)
    assert examine(_open(), replace(
        recording, effort=recording.effort + 2.0 * state)).findings == ()


def test_a_lag_pays_beside_hysteresis() -> None:
    """What it wins on parts left out is printed."""
    recording = healthy()
    finding, = examine(_open(), replace(
        recording, effort=late(recording.effort, recording.t, 0.05))).findings
    assert finding.kind == 'effort_late' and finding.measure == UNSEEN
    assert finding.now is not None and finding.otherwise is not None
    assert finding.otherwise < 0.8 * finding.now
    assert 'on data left out of the fit: ' in str(finding) and ' % now, ' in str(finding)


@pytest.mark.parametrize('seed', [1, 2, 3, 6, 12, 14])
def test_an_arm_that_rings_after_a_move_has_no_structural_fault(seed: int) -> None:
    """A motor that turns with another joint explained a tool that swings after one move."""
    rng, t = np.random.default_rng(seed), np.arange(1100) / 100.0
    s = np.clip(t / 1.5, 0.0, 1.0)
    q = rng.uniform(-1.0, 1.0, 2) + np.outer(
        s ** 3 * (10.0 - 15.0 * s + 6.0 * s * s), rng.uniform(-0.8, 0.8, 2))
    dq = np.gradient(q, t, axis=0)
    rows = EffortRegressor(described())
    effort = rows.outputs(np.hstack([q, dq, np.gradient(dq, t, axis=0)]), np.tile(
        rng.uniform(0.15, 0.3, len(rows.columns)), (2, 1)))
    swing = np.sin(2.0 * np.pi * 2.8 * t) * np.where(t < 1.5, t / 1.5, np.exp(-0.3 * (t - 1.5)))
    found = examine(_open(), recording_of(
        q + np.outer(swing, [2e-4, 3e-4]), 100.0, path='ring',
        effort=effort + np.outer(swing, rng.uniform(0.3, 1.0, 2))
        + rng.normal(0.0, 0.01, effort.shape))).findings
    assert [item.kind for item in found if item.kind not in ('standstill', 'rings')] == []


def test_a_fault_shows_beside_an_oscillation() -> None:
    """What swings faster than the arm moves hides no wrong sign in the slow motion."""
    recording = healthy(seconds=40.0)
    assert recording.effort is not None
    swing = np.outer(np.sin(2.0 * np.pi * 6.0 * recording.t), 0.3 * recording.effort.std(axis=0))
    assert examine(_open(), replace(recording, effort=recording.effort + swing)).described
    turned = examine(_open(), replace(recording, strain=None, effort=column(
        recording.effort, 1, np.negative) + swing)).findings
    assert 'effort_sign' in [item.kind for item in turned]


def test_one_velocity_comes_late() -> None:
    """The derivative of the positions shows it, joint by joint."""
    one = healthy(velocity=True)
    assert one.dq is not None
    finding, = examine(described(), replace(one, dq=column(
        one.dq, 1, lambda x: np.interp(one.t - 0.1, one.t, x)))).findings
    assert (finding.kind, finding.channels) == ('velocity_late', ('j2',))


def test_a_lag_below_a_sample_is_none() -> None:
    """At 30 Hz, stamps do not show 20 ms."""
    one = healthy(seconds=40.0)
    kept = slice(None, None, 3)
    effort, strain = (x[kept] for x in (late(one.effort, one.t, 0.02), one.strain)
                      if x is not None)
    slow = replace(one, q=one.q[kept], stamp=one.stamp[kept], effort=effort, strain=strain,
                   dt=3.0 * one.dt, segments=(slice(0, len(effort)),))
    assert examine(described(), slow).findings == ()


def test_a_tiny_step_is_no_outlier() -> None:
    """A joint that stands has a range of nothing, and steps of 0.1 mrad do no harm."""
    recording = healthy()
    still = column(recording.q, 0, np.zeros_like)
    still[700, 0] = 1e-4
    assert not any(item.kind == 'outlier' for item in examine(
        described(), replace(recording, q=still)).findings)
