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

"""One bag of the repository, as it is and with one thing altered by hand."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification.dataset import BagChoice, BagData
from tudor_dynamics.identification.doctor.between import examine_bags
from tudor_dynamics.identification.doctor.examine import examine
from tudor_dynamics.identification.doctor.findings import Finding
from tudor_dynamics.typing import FloatArray

ROOT = Path(__file__).resolve().parents[3]


@lru_cache
def _arm() -> Arm:
    return load_arm(ROOT / 'config' / 'two_blade_arm.yaml')


@lru_cache
def _bag(name: str = 'two_blade_test') -> Recording:
    return read_recording(ROOT / 'bags' / name, _arm())


def _effort(recording: Recording) -> FloatArray:
    assert recording.effort is not None
    return recording.effort


def _strain(recording: Recording) -> FloatArray:
    assert recording.strain is not None
    return recording.strain


def _one(recording: Recording) -> Finding:
    finding, = examine(_arm(), recording).findings
    return finding


def _late(values: FloatArray, t: FloatArray, seconds: float) -> FloatArray:
    return np.stack([np.interp(t - seconds, t, x) for x in values.T], axis=1)


def test_a_clean_bag_stays_clean() -> None:
    """No alternative explains it better."""
    assert examine(_arm(), _bag()).findings == ()


@pytest.mark.parametrize('name', ['effort', 'strain'])
def test_a_late_output(name: str) -> None:
    """Which, and by how much."""
    bag = _bag()
    values = getattr(bag, name)
    finding = _one(replace(bag, **{name: _late(values, bag.t, 0.05)}))
    assert finding.kind == f'{name}_late'
    assert finding.size == pytest.approx(0.05, abs=0.01)
    assert finding.now is not None and finding.otherwise is not None
    assert finding.otherwise < 0.7 * finding.now


def test_an_effort_with_its_sign_turned() -> None:
    """Friction that drives shows it, where each current has parameters of its own."""
    finding = _one(replace(_bag(), effort=_effort(_bag()) * [1.0, -1.0]))
    assert (finding.kind, finding.channels) == ('effort_sign', ('joint3',))


def test_a_joint_with_its_sign_turned() -> None:
    """The other kinematics explain it."""
    finding = _one(replace(_bag(), q=_bag().q * [1.0, -1.0]))
    assert (finding.kind, finding.channels) == ('joint_sign', ('joint3',))


def test_exchanged_names() -> None:
    """Efforts, joints and gauges."""
    bag = _bag()
    for changed, kind in (
            (replace(bag, effort=_effort(bag)[:, ::-1]), 'efforts_exchanged'),
            (replace(bag, effort=_effort(bag)[:, ::-1], q=bag.q[:, ::-1]), 'joints_exchanged'),
            (replace(bag, strain=_strain(bag)[:, ::-1]), 'gauges_exchanged')):
        assert _one(changed).kind == kind


def test_gravity_along_another_axis() -> None:
    """The right axis is named, with the angle between the two."""
    finding, = examine(_arm().under(np.array([9.81, 0.0, 0.0])), _bag()).findings
    assert (finding.kind, finding.size) == ('gravity_axis', pytest.approx(90.0))
    assert '-9.81' in finding.remedy


def test_milliamperes() -> None:
    """All currents a thousand times too large."""
    finding = _one(replace(_bag(), effort=1e3 * _effort(_bag())))
    assert (finding.kind, finding.size) == ('effort_unit', 1e3)
    assert finding.channels == ('joint2', 'joint3')


def test_drift() -> None:
    """By how much a gauge drifts."""
    bag = _bag()
    finding = _one(replace(bag, strain=_strain(bag) + np.outer(bag.t / bag.t[-1], [0.0, 120.0])))
    assert (finding.kind, finding.channels) == ('drift', ('link3_hub',))
    assert finding.size == pytest.approx(120.0, rel=0.25)


def test_a_gauge_turned_in_one_of_three_bags() -> None:
    """The bag that differs from the others is named."""
    names = ('two_blade_train_1', 'two_blade_train_2', 'two_blade_test')
    bags = []
    for name in names:
        recording = _bag(name)
        if name == names[1]:
            recording = replace(recording, strain=_strain(recording) * [-1.0, 1.0])
        bags.append(BagData(BagChoice(name), replace(recording, path=name), ()))
    finding, = examine_bags(_arm(), bags)
    assert (finding.kind, finding.bag, finding.channels) == (
        'gauge_sign', names[1], ('link2_hub',))


def test_the_same_recording_twice() -> None:
    """Under whatever name."""
    bags = [BagData(BagChoice(name), replace(_bag(), path=name), ()) for name in 'ab']
    finding, = examine_bags(_arm(), bags)
    assert (finding.kind, finding.bag) == ('same_recording', 'b')
