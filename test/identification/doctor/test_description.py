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

"""Lengths, angles and gauges that no arm has."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sample_arms import arm_of, gauge

from tudor_dynamics.identification.doctor.examine import suspects

ROWS = [[0.4, 1.5707963267948966, 0.1, 0.0], [0.3, 0.0, 0.0, 0.0]]
JOINTS: list[dict[str, Any]] = [{'name': 'j1'}, {'name': 'j2'}]


def test_a_right_description_is_none() -> None:
    """Nothing is said of it."""
    arm = arm_of(ROWS, JOINTS, gauges=[gauge('g1', 'j1', 0.05)])
    assert suspects(arm) == ([], arm)


def test_millimetres() -> None:
    """Rows that reach 800 m, and the arm as it would be in metres."""
    (item,), mended = suspects(arm_of(
        [[1e3 * a, alpha, 1e3 * d, theta] for a, alpha, d, theta in ROWS], JOINTS))
    assert (item.kind, item.size) == ('dh_in_millimetres', pytest.approx(800.0))
    assert mended.spec.kinematics.dh == tuple(tuple(row) for row in ROWS)


def test_degrees() -> None:
    """A right angle of 90."""
    (item,), mended = suspects(arm_of([[0.4, 90.0, 0.1, 0.0], ROWS[1]], JOINTS))
    assert (item.kind, item.size) == ('dh_in_degrees', 90.0)
    assert mended.spec.kinematics.dh is not None
    assert mended.spec.kinematics.dh[0][1] == pytest.approx(ROWS[0][1])


@pytest.mark.parametrize(('distance', 'kind'), [
    (50.0, 'gauge_in_millimetres'), (0.45, 'gauge_beyond_link')])
def test_gauges(distance: float, kind: str) -> None:
    """A gauge 50 m or 45 cm after the axis of a link of 40 cm."""
    (item,), _ = suspects(arm_of(ROWS, JOINTS, gauges=[gauge('g1', 'j1', distance)]))
    assert (item.kind, item.channels) == (kind, ('g1',))
    assert item.size == distance


def test_two_gauges_in_millimetres() -> None:
    """Both are named, and the arm that the bag is judged by has both in metres."""
    items, mended = suspects(arm_of(ROWS, JOINTS, gauges=[
        gauge('g1', 'j1', 50.0), gauge('g2', 'j2', 40.0)]))
    assert [item.channels for item in items] == [('g1',), ('g2',)]
    assert [one.distance for one in mended.gauges] == [0.05, 0.04]


def test_what_no_metres_explain_is_not_mended() -> None:
    """A gauge beyond its link may sit anywhere, and rows of both kinds are put right together."""
    arm = arm_of(ROWS, JOINTS, gauges=[gauge('g1', 'j1', 0.45)])
    assert suspects(arm)[1] is arm
    items, mended = suspects(arm_of([[400.0, 90.0, 100.0, 0.0], [300.0, 0.0, 0.0, 0.0]], JOINTS))
    assert [item.kind for item in items] == ['dh_in_millimetres', 'dh_in_degrees']
    assert np.allclose(mended.spec.kinematics.dh, ROWS)
