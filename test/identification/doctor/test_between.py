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

"""Bags of one arm compared with one another: units, signs, loads, copies."""

from __future__ import annotations

from dataclasses import replace

from doctor_making import bag, column, described, healthy
import numpy as np
import pytest

from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.identification.doctor.between import examine_bags, merged
from tudor_dynamics.identification.doctor.findings import Finding, found


def _bags(*payloads: float | None, carried: tuple[float, ...] | None = None) -> list[BagData]:
    """Give bags of other motion; payloads as they are stated, and as they are carried."""
    true = carried or tuple(payload or 0.0 for payload in payloads)
    return [bag(healthy(seed=k, payload=mass), f'run{k + 1}', payload)
            for k, (payload, mass) in enumerate(zip(payloads, true, strict=True))]


def _found(bags: list[BagData]) -> tuple[Finding, ...]:
    return examine_bags(described(), bags)


@pytest.mark.parametrize('payloads', [
    (None, None), (None, None, None), (0.0, 0.5, 0.5)])
def test_bags_that_agree(payloads: tuple[float | None, ...]) -> None:
    """Other motion, and payloads as they are stated, are no fault."""
    assert _found(_bags(*payloads)) == ()


@pytest.mark.parametrize('count', [2, 3])
def test_a_gauge_turned_in_one_bag(count: int) -> None:
    """The bag that differs from the others is named; of two it is the second."""
    bags = _bags(*[None] * count)
    recording = bags[1].recording
    bags[1] = replace(bags[1], recording=replace(
        recording, strain=column(recording.strain, 1, np.negative)))
    finding, = _found(bags)
    assert (finding.kind, finding.bag, finding.channels) == ('gauge_sign', 'run2', ('g2',))
    assert finding.remedy == 'change the sign of the gauge in its driver, or that of the effort'


@pytest.mark.parametrize(('factor', 'evidence'), [
    (10.0, '10 times as large as in run1'), (1e3, 'which no link survives')])
def test_a_gauge_in_another_unit(factor: float, evidence: str) -> None:
    """Against the other bags, and by itself where no strain is as large; said once."""
    bags = _bags(None, None, None)
    recording = bags[2].recording
    assert recording.strain is not None
    bags[2] = replace(bags[2], recording=replace(recording, strain=factor * recording.strain))
    finding, = _found(bags)
    assert (finding.kind, finding.bag, finding.channels, finding.size) == (
        'strain_unit', 'run3', ('g1', 'g2'), pytest.approx(factor, rel=0.05))
    assert evidence in finding.what


def test_currents_beside_torques() -> None:
    """All efforts of one bag are a tenth of what the others have."""
    bags = _bags(None, None, None)
    recording = bags[1].recording
    assert recording.effort is not None
    bags[1] = replace(bags[1], recording=replace(recording, effort=0.1 * recording.effort))
    finding, = _found(bags)
    assert (finding.kind, finding.bag) == ('effort_unit', 'run2')
    assert finding.size == pytest.approx(0.1, rel=0.1)


def test_a_payload_stated_wrong() -> None:
    """The bag is named with the mass that it carries."""
    bags = _bags(0.0, 0.5, 0.1, 0.5, carried=(0.0, 0.5, 0.5, 0.5))
    finding, = _found(bags)
    assert (finding.kind, finding.bag) == ('payload_wrong', 'run3')
    assert finding.size == pytest.approx(0.5, abs=0.1)
    assert (finding.unit, finding.now) == ('kg', 0.1)


def test_loads_that_are_not_stated() -> None:
    """Which of two bags carries more."""
    finding, = _found(_bags(None, None, carried=(0.0, 1.0)))
    assert (finding.kind, finding.bag) == ('load_unknown', 'run2')
    assert finding.what == "the arm carries more in bag 'run2' than in bag 'run1'"


def test_one_recording_twice() -> None:
    """A copy is found by its motion; standstill in common is no copy."""
    one, other = _bags(None, None)
    copy = bag(one.recording, 'copy')
    finding, = _found([one, other, copy])
    assert (finding.kind, finding.bag, finding.size) == ('same_recording', 'copy', 1.0)


def test_what_several_bags_show_is_said_once() -> None:
    """By kind and channels; what happened while one bag was recorded stays with it."""
    late = [found('effort_late', 'late', name, size=0.05) for name in ('a', 'b')]
    held = [found('held', 'held', name, ('g1',)) for name in ('a', 'b')]
    assert [(item.kind, item.bag) for item in merged([[late[0], held[0]], [late[1], held[1]]])] \
        == [('effort_late', 'a, b'), ('held', 'a'), ('held', 'b')]


def test_a_fault_of_all_bags_is_one_finding() -> None:
    """Bags with a fault are no measure for the others."""
    bags = _bags(None, None)
    turned = [replace(item, recording=replace(item.recording, q=item.recording.q * [1.0, -1.0]))
              for item in bags]
    finding, = _found(turned)
    assert (finding.kind, finding.bag, finding.channels) == ('joint_sign', 'run1, run2', ('j2',))
