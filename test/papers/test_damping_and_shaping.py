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

"""Trials of damping and shaping: what they measure, on the arm with all its imperfections."""

from __future__ import annotations

from functools import lru_cache

from motion_machine import tudor
import numpy as np
from papers import damping, shaping
from papers.damping import tapped
import pytest

import tudor_dynamics as td
from tudor_dynamics.control.shaped_motion import Shaping
from tudor_dynamics.models.tuning import design, MoveRefiner, TunedArm, Wish

POSE = np.radians([60.0, 20.0])


@lru_cache
def schedule() -> td.Schedule:
    """Tune the reference arm as it was described."""
    return design(TunedArm(tudor()), Wish(0.6, 0.006, (0.0, 0.4)))


@pytest.mark.parametrize('payload', [0.0, 0.4])
def test_damping_ratio_is_that_asked_for(payload: float) -> None:
    """A tap tells it; fixed gains have another one."""
    modes = schedule().at(payload, POSE).modes
    ends = modes[0].frequency, modes[-1].frequency
    scheduled, fixed = (tapped(tudor(), used, POSE, payload, 0.02, ends, 1)[0]
                        for used in (schedule(), None))
    assert scheduled == pytest.approx(0.6, rel=0.2)
    assert fixed < 0.48


def test_undamped_arm_does_not_ring_behind_a_shaped_move() -> None:
    """With 400 g a tenth is left, half a period later."""
    ends = np.radians([20.0, -40.0]), np.radians([65.0, -10.0])
    period = 1.0 / schedule().at(0.4, ends[1]).modes[0].frequency
    left, length = {}, {}
    for kind in ('none', 'elastic'):
        how = Shaping(kind, schedule(), payload=0.4)
        q, dq, length[kind] = shaping.reference(tudor(), how, ends, period)
        left[kind] = shaping.run(tudor(), 0.4, q, dq, length[kind], period, 0)[2]
        assert how.note == ''
    assert left['elastic'] < 0.1 * left['none']
    assert length['elastic'] - length['none'] < 0.51 * period


def test_gears_that_cross_their_play() -> None:
    """What modes know nothing of, the simulated model does: a third of what they leave."""
    ends = np.radians([136.0, 14.0]), np.radians([52.0, -52.0])
    period = 1.0 / schedule().at(0.3, ends[1]).modes[0].frequency
    left, length = [], []
    for refine in (None, MoveRefiner(TunedArm(tudor()))):
        how = Shaping('elastic', schedule(), payload=0.3, refine=refine)
        q, dq, duration = shaping.reference(tudor(), how, ends, period)
        left.append(shaping.run(tudor(), 0.3, q, dq, duration, period, 0)[2])
        length.append(duration)
        assert how.note == ''
    assert left[0] > 80.0 and left[1] < 0.35 * left[0]
    assert length[0] == length[1]


def test_moves_on_one_side() -> None:
    """All links stay left or right of the upright, with some room."""
    random = np.random.default_rng(1)
    for _ in range(20):
        sums = np.cumsum(shaping.draw_ends(tudor(), random, sided=True), axis=1)
        assert np.all(sums < np.radians(80.0)) or np.all(sums > np.radians(100.0))


def test_figures_of_what_was_measured() -> None:
    """Marks of every trial."""
    content = {'payloads': [0.0, 0.4], 'ratios': [[[0.6, 0.4]], [[0.62, 0.5]]]}
    axis = damping._draw_ratios(content, 0.6).axes[0]
    assert [len(line.get_xdata()) for line in axis.get_lines()] == [2, 2]
