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

"""From readings to kilograms: where the scale is from, and what a kilogram adds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from payload_making import true_outputs, two_gauge_arm
import pinocchio as pin
import pytest
from sample_arms import gauge, LENGTH_2, multisine, planar_arm

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.arm.schema import EffortSpec
from tudor_dynamics.load.rows import (
    carrier, carrier_frame, described_masses, find_scale, LoadRows, Source, tip)
from tudor_dynamics.models.regressor import EffortRegressor
from tudor_dynamics.typing import FloatArray

MOTION = multisine(np.arange(0.0, 40.0, 0.05), 2, 2)


def amps(**constant: Any) -> Arm:
    """Describe an arm whose second joint has a current, and the first as well unless it says."""
    return planar_arm([{'name': 'j1', 'effort': {'unit': 'A', **constant}},
                       {'name': 'j2', 'effort': {'unit': 'A'}}])


def test_where_a_load_sits() -> None:
    """At the frame that is farthest out on the last link, with the name of that link."""
    arm = two_gauge_arm()
    assert carrier(arm) == 'j2' and tip(arm) == pytest.approx([LENGTH_2, 0.0, 0.0])
    assert carrier_frame(arm)


@pytest.mark.parametrize('output', ['effort', 'strain'])
def test_rows_are_those_of_a_body_that_is_added(output: str) -> None:
    """A point mass at the tip changes outputs by its parameters times the rows, to rounding."""
    arm = two_gauge_arm()
    rows = LoadRows(arm, output)
    point = pin.Inertia(0.3, np.array([LENGTH_2, 0.0, 0.0]), np.zeros((3, 3)))
    added = rows.rows(MOTION) @ point.toDynamicParameters()
    assert added == pytest.approx(0.3 * rows.point(MOTION), abs=1e-10)
    if output == 'effort':
        with_load, without = (true_outputs(arm, MOTION, m)['effort'] for m in (0.3, 0.0))
        assert added == pytest.approx(with_load - without, abs=1e-9)


@pytest.mark.parametrize(('arm', 'output', 'source', 'relative'), [
    (two_gauge_arm(), 'effort', Source.TORQUE, 0.03),
    (amps(torque_constant=2.0), 'effort', Source.CONSTANTS, 0.1),
    (amps(), 'effort', Source.NOTHING, 0.0),
    (two_gauge_arm(), 'strain', Source.NOTHING, 0.05),
    (planar_arm(gauges=[gauge('g1', 'j1', 0.0), gauge('g2', 'j2', 0.0)],
                sensors=[{'gauge': 'g2', 'gain': 80.0}]), 'strain', Source.GAIN, 0.05)])
def test_where_kilograms_come_from(
    arm: Arm, output: str, source: Source, relative: float,
) -> None:
    """Torques, constants or gains of the description; without any of them nothing."""
    found = find_scale(arm, output, MOTION, true_outputs(two_gauge_arm(), MOTION, 0.0)['effort'])
    assert found.source is source and found.relative == relative
    if source is Source.CONSTANTS:  # only the joint whose constant is known
        assert found.factor.tolist() == [1.0, 0.0]
    if source is Source.GAIN:
        assert found.factor.tolist() == [0.0, 80.0]


def described(root: Path) -> tuple[Arm, FloatArray, FloatArray]:
    """Give an arm with masses, its motion, and the efforts of these masses with friction."""
    arm = load_arm(root / 'config' / 'tudor.yaml')
    motion = multisine(np.arange(0.0, 40.0, 0.05), len(arm.joints), 2)
    regressor = EffortRegressor(arm)
    values = np.zeros(len(regressor.columns))
    bodies = np.concatenate([body.toDynamicParameters() for body in list(arm.model.inertias)[1:]])
    values[:len(bodies)] = bodies
    speed = motion[:, len(arm.joints):2 * len(arm.joints)]
    return arm, motion, regressor.rows(motion) @ values + 0.3 * speed


def test_masses_of_the_description(root: Path) -> None:
    """They explain efforts in their own unit by the factor between the two, friction apart."""
    arm, motion, effort = described(root)
    factors = np.linspace(0.5, 2.0, effort.shape[1])
    found = described_masses(arm, motion, effort * factors)
    assert found is not None
    heavy = found.share > 0.5
    assert heavy.any() and found.ratio[heavy] == pytest.approx(factors[heavy], rel=0.02)
    assert np.array_equal(found.believed, found.ratio[found.share > 0.6])
    noise = np.random.default_rng(1).normal(size=effort.shape)
    others = described_masses(arm, motion, noise)
    assert others is not None and not len(others.believed)
    assert described_masses(two_gauge_arm(), MOTION, np.ones((len(MOTION), 2))) is None


def test_masses_are_a_scale_where_nothing_else_is(root: Path) -> None:
    """Currents without constants are compared with the masses, which is an assumption."""
    arm, motion, effort = described(root)
    bare, known = (arm.with_joints({
        joint.name: {'effort': EffortSpec(unit=unit)} for joint in arm.joints})
        for unit in ('A', 'N m'))
    found = find_scale(bare, 'effort', motion, 0.5 * effort)
    assert found.source is Source.MASSES and found.relative == 0.1
    used = found.factor != 0.0
    assert used.any() and found.factor[used] == pytest.approx(0.5, rel=0.02)
    unsure = find_scale(known, 'effort', motion, 1.2 * effort)
    assert unsure.source is Source.TORQUE and unsure.relative == pytest.approx(0.2, rel=0.05)
