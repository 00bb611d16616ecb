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

"""Tools that ring on after motion are named, and arms that are still are not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tool_making import ARM, DAMPING, FREQUENCIES, moves, ONE, recording, tool_efforts

from tudor_dynamics.identification.dataset import BagChoice, BagData
from tudor_dynamics.identification.doctor import between
from tudor_dynamics.identification.doctor.between import Pair
from tudor_dynamics.identification.doctor.examine import examine_all, rings_on
from tudor_dynamics.identification.ringdowns import loudest_ring


def test_frequency_and_damping() -> None:
    """They are those of the tool."""
    q = moves(1)
    found = loudest_ring(recording(q, tool_efforts(ARM, q, frequencies=ONE)))
    assert found is not None
    # gravity moves the frequency by 0.15 Hz over all poses
    assert found.frequency == pytest.approx(FREQUENCIES[0], abs=0.15)
    assert found.damping == pytest.approx(DAMPING, abs=0.003)


def test_an_arm_that_is_still_does_not_ring() -> None:
    """Noise, and what dies out at once, are no tool."""
    q = moves(1)
    assert loudest_ring(recording(q, np.zeros_like(q))) is None
    assert loudest_ring(recording(q, tool_efforts(ARM, q, frequencies=ONE, damping=0.2))) is None
    assert rings_on(ARM, replace(recording(q, np.zeros_like(q)), effort=None)) == []


def test_the_doctor_says_so_and_finds_no_fault() -> None:
    """It names frequency and joint, and takes the ringing for nothing else."""
    q = moves(1)
    bag = BagData(BagChoice('bag'), recording(q, tool_efforts(ARM, q, frequencies=ONE)), ())
    (seen,) = examine_all(ARM, [bag])
    (item,) = seen.findings  # nor does it ask to leave out where the arm stands and rings
    assert item.kind == 'rings' and 'rings at ' in item.what and 'N m' in item.what
    assert f'tudor shape --frequency {item.size:.2f} --damping 0.0' in item.remedy
    assert item.unit == 'Hz' and item.size == pytest.approx(FREQUENCIES[0], abs=0.15)


@pytest.mark.parametrize(('error', 'back', 'kinds'), [
    (0.5, -1.0, ['load_unknown']), (3.0, -1.0, []), (0.5, 1.0, [])])
def test_poor_bags_do_not_compare_loads(
    error: float, back: float, kinds: list[str], monkeypatch: pytest.MonkeyPatch,
) -> None:
    """
    A bag that predicts another worse than nothing does says nothing of what that carries.

    Nor do bags of which each carries more than the other, as one of a ringing beam did.
    """
    q = moves(1, count=2)
    own = recording(q, tool_efforts(ARM, q, frequencies=ONE))
    cases = [seen.case for seen in examine_all(ARM, [
        BagData(BagChoice(name), own, ()) for name in ('one', 'two')])]
    ones = np.ones(5)

    def pair(one: Any, *_: Any) -> Pair:
        return Pair(ones, ones, ones if one is cases[0] else back * ones, 0.1, error)
    monkeypatch.setattr(between, 'pair', pair)
    found = between.compare([(case, None) for case in cases if case is not None])
    assert [item.kind for item in found] == kinds
