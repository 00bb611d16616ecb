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

"""The search: within all limits, better than chance, and what it says where there is no way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sample_arms import arm_of, SIX_ROWS

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.limits import Limits, SelfCollision
from tudor_dynamics.errors import SignalError
from tudor_dynamics.identification.excitation import (
    Bounds, Efforts, Information, known_efforts, series, TOUCH)
from tudor_dynamics.identification.excitation_plan import (
    bounds_of, make_moves, make_plan, Order, random_series, target_of_arm)
from tudor_dynamics.models.flexible_tool import flange_motion, pushes, sizes_of, square
from tudor_dynamics.signals.filters import MotionState
from tudor_dynamics.signals.motion_profile import motion_limits

URDF = """<robot name="box">
<link name="base"><collision><origin xyz="0 0 0.2"/><geometry>
<cylinder radius="0.08" length="0.4"/></geometry></collision></link>
{}
<joint name="j1" type="revolute"><parent link="base"/><child link="upper"/>
<origin xyz="0 0 0.45"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="2" effort="{}"/></joint>
<joint name="j2" type="revolute"><parent link="upper"/><child link="fore"/>
<origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="2" effort="15"/></joint></robot>"""
LINK = """<link name="{}"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0.2 0 0"/><geometry><box size="0.4 0.06 0.06"/></geometry></collision>
</link>"""
YAML = """name: box
kinematics: {urdf: box.urdf}
joints:
  - {name: j1, limits: {acceleration: 10}}
  - {name: j2, limits: {acceleration: 10}}
"""


def box_arm(folder: Path, effort: float = 60.0):
    """Describe two links that can hit the column they stand on."""
    links = ''.join(LINK.format(name) for name in ('upper', 'fore'))
    (folder / 'box.urdf').write_text(URDF.format(links, effort))
    (folder / 'box.yaml').write_text(YAML)
    return load_arm(folder / 'box.yaml')


def six_joints():
    """Describe six joints with limits of their own each."""
    joints = [{'name': f'j{i}', 'limits': {
        'lower': -1.0 - 0.2 * i, 'upper': 1.5, 'velocity': 1.0 + 0.1 * i, 'acceleration': 9.0}}
        for i in range(1, 7)]
    return arm_of(SIX_ROWS, joints)


def target(arm):
    """Ask for all that is to be identified, with noise of 1."""
    return target_of_arm(arm)


def test_derivatives_of_the_series():
    """Speeds and accelerations are derivatives, and there is rest at both ends."""
    limits = Limits(-np.ones(2), np.ones(2), np.ones(2), 3 * np.ones(2))
    basis = series(limits, limits, 20.0, 0.7, 1e-3)
    motion = basis.motion(np.random.default_rng(0).normal(size=basis.sizes.shape))
    for k in (0, 2):
        np.testing.assert_allclose(np.gradient(motion[:, k:k + 2], 1e-3, axis=0)[5:-5],
                                   motion[5:-5, k + 2:k + 4], atol=2e-3)
    assert not motion[:1000, 2:].any() and not motion[-1000:, 2:].any()


def test_within_limits_and_better_than_chance():
    """Six joints: no limit is passed by a rounding error, and errors are half of random ones."""
    wanted = target(six_joints())
    plan = make_plan(wanted, Order(30.0, 1.0, 0.01, 15, 0))
    limits, bounds = motion_limits(wanted.arm), bounds_of(wanted)
    moved = plan.trajectory
    assert (np.abs(moved.dq) <= limits.velocity * (1 + 1e-9)).all()
    assert (np.abs(moved.ddq) <= limits.acceleration * (1 + 1e-9)).all()
    assert (moved.q >= bounds.range.lower - 1e-9).all()
    assert (moved.q <= bounds.range.upper + 1e-9).all()
    information = Information(wanted.models, wanted.noise.size)
    chance = [information.cost(random_series(bounds.range, limits, Order(
        30.0, 1.0, 0.01, 1, seed)).motion[::5])[0] for seed in range(3)]
    own = information.cost(np.hstack([moved.q, moved.dq, moved.ddq])[::5])[0]
    assert own < min(chance) - np.log(2.0)


def test_same_seed_same_motion():
    """What is drawn depends on the seed alone."""
    wanted = target(six_joints())
    one, two, other = (make_plan(wanted, Order(15.0, 0.6, 0.02, 2, seed)).trajectory.q
                       for seed in (4, 4, 5))
    assert np.array_equal(one, two) and not np.array_equal(one, other)


def test_a_search_can_be_ended():
    """Where the time is over, the best so far is taken, within the limits."""
    calls = []

    def stop(cost: float) -> bool:
        calls.append(cost)
        return len(calls) == 3
    plan = make_plan(target(six_joints()), Order(15.0, 0.6, 0.02, 50, 0), report=stop)
    assert len(calls) == 3 and plan.beyond.velocity.max() <= 1.0 + 1e-9


@pytest.mark.parametrize('kind', ['series', 'moves'])
def test_links_do_not_touch(kind, tmp_path):
    """Both kinds keep clear of the column that their range leads into."""
    arm = box_arm(tmp_path)
    wanted, links = target(arm), SelfCollision(arm)
    assert links.near(np.array([0.0, 2.8]), 0.1).distance < 0.0  # the fore-arm in the column
    order = Order(12.0, 0.7, 0.02, 15, 1)
    plan = (make_plan(wanted, order, links=links) if kind == 'series' else
            make_moves(wanted, order, [3.0], links=links))
    assert plan.beyond.clearance >= TOUCH and np.ptp(plan.trajectory.q, axis=0).min() > (
        0.5 if kind == 'series' else 0.4)


def test_moves_push_a_tool_each_way():
    """Those that are chosen leave no direction out, and push more than those at random."""
    wanted, order = target(six_joints()), Order(25.0, 1.0, 0.01, 40, 3)

    def shown(found):
        t = np.arange(2500) * 0.01
        motion = MotionState(*(getattr(found.trajectory, name) for name in ('q', 'dq', 'ddq')))
        rows = pushes(flange_motion(wanted.arm, t, motion), 2.0, np.arange(0.0, 25.1, 5.0))
        return np.exp(np.mean(np.log([*sizes_of(square(rows)).values()])))
    plan = make_moves(wanted, order, [2.0])
    assert not plan.hidden and len(plan.trajectory.t) == 2500
    random = [shown(make_moves(wanted, replace(order, steps=1, seed=seed), [2.0]))
              for seed in range(4)]
    assert shown(plan) > max(*random, 1.2 * np.mean(random))


def test_efforts_stay_within_their_limits(tmp_path):
    """Where the URDF knows bodies and limits, the arm is not asked for more than it has."""
    arm = box_arm(tmp_path, effort=20.0)  # 2 kg at 0.2 m and 2 at 0.6 m weigh 15.7 N m
    wanted = target(arm)
    free = make_plan(target(box_arm(tmp_path, effort=1e3)), Order(15.0, 0.7, 0.02, 10, 0))
    efforts = known_efforts(arm)
    assert isinstance(efforts, Efforts)
    motion = np.hstack([free.trajectory.q, free.trajectory.dq, free.trajectory.ddq])
    assert np.abs(efforts.ratio(motion)).max() > 1.0
    plan = make_plan(wanted, Order(15.0, 0.7, 0.02, 10, 0))
    assert plan.beyond.effort.max() <= 1.0


def test_no_way_is_said(tmp_path):
    """An arm that cannot hold its own weight is told so in one line."""
    with pytest.raises(SignalError, match='no motion was found within all limits'):
        make_plan(target(box_arm(tmp_path, effort=0.5)), Order(12.0, 0.7, 0.02, 3, 0))


def test_slope_of_penalties(tmp_path):
    """Slopes of limits, efforts and distances are those of differences."""
    arm = box_arm(tmp_path, effort=10.0)
    limits = Limits(-np.ones(2), np.ones(2), np.ones(2), np.ones(2))
    bounds = Bounds(limits, limits, known_efforts(arm), SelfCollision(arm))
    motion = np.random.default_rng(0).uniform(-2.0, 2.0, (20, 6))
    motion[:, 1] += 1.5
    way = np.random.default_rng(1).normal(size=motion.shape)
    for penalty in (bounds.penalty, bounds.coupled_penalty):
        cost, slope = penalty(motion)
        change = (penalty(motion + 1e-5 * way)[0] - penalty(motion - 1e-5 * way)[0]) / 2e-5
        assert cost > 0.0 and np.sum(slope * way) == pytest.approx(change, rel=0.02)


def test_too_short():
    """There is no series in five seconds."""
    with pytest.raises(SignalError, match='has less than one period; raise'):
        make_plan(target(six_joints()), Order(5.0, 1.0, 0.01, 5, 0))
