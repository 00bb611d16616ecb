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

"""Force control of the simulated arm on floors: steps, faults, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from papers.force import ForceRig, RATE
import pytest

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.control.force_control import ForceController, ForceSettings, Phase
from tudor_dynamics.errors import ArmError, UsageError
from tudor_dynamics.online.contact_fronts import StaticStrain


def tudor() -> Arm:
    """Give the reference arm."""
    return load_arm(Path(__file__).parents[2] / 'config' / 'tudor.yaml')


def bench_on(
    stiffness: float, seed: int = 0, settings: ForceSettings = ForceSettings(),  # noqa: B008
) -> ForceRig:
    """Press on a floor with 2 N for 3 s."""
    rig = ForceRig(tudor(), stiffness, seed, settings)
    rig.approach(2.0)
    return rig


def forces(bench: ForceRig, seconds: float) -> np.ndarray:
    """Let time pass; give the forces of the floor meanwhile."""
    bench.run(seconds)
    return bench.force[-round(seconds * RATE):]


@pytest.mark.parametrize(('stiffness', 'seed'), [(500.0, 0), (500.0, 1), (20000.0, 2)])
def test_a_step_of_2_newtons(stiffness: float, seed: int) -> None:
    """From 2 to 4 N, every imperfection on: on 500 N/m within 5 % after a second."""
    bench = bench_on(stiffness, seed)
    assert bench.controller.phase is Phase.HOLD, bench.controller.cause
    assert bench.controller.press(4.0) == ''
    force = forces(bench, 3.0)
    assert force.min() > 1.0  # contact is never lost
    assert force.max() < 4.0 + 0.2 * 2.0
    late = force[round(1.0 * RATE):]
    if stiffness == 500.0:
        assert np.abs(late - 4.0).max() < 0.05 * 2.0 + 0.05
    assert late[-500:].std() < 0.1 and abs(late[-500:].mean() - 4.0) < 0.1


def test_it_leaves_the_surface() -> None:
    """Retreat leads back to where the approach began, and a force may be asked for again."""
    bench = bench_on(500.0)
    bench.controller.retreat()
    force = forces(bench, 5.0)
    assert bench.controller.phase is Phase.IDLE
    assert force[-1] == 0.0
    assert bench.controller.press(2.0) == ''


def missing(strain: np.ndarray) -> np.ndarray:
    """Lose the hub gauge of link 3."""
    return np.where(np.arange(len(strain)) == 1, np.nan, strain)


def stuck(strain: np.ndarray) -> np.ndarray:
    """Let the hub gauge of link 3 say the same for ever."""
    return np.where(np.arange(len(strain)) == 1, 7.0, strain)


def wrong(strain: np.ndarray) -> np.ndarray:
    """Let the hub gauge of link 2 say what no force explains."""
    return np.where(np.arange(len(strain)) == 0, strain + 300.0, strain)


@pytest.mark.parametrize(('fault', 'why'), [
    (missing, 'is missing'), (stuck, 'stuck'), (wrong, 'no force at the tip|force on the tip')])
def test_a_gauge_fault_ends_in_a_held_pose(fault: Callable, why: str) -> None:
    """The arm stands, says why, and takes no force until it is cleared."""
    bench = bench_on(2000.0)
    bench.static = Weightless(bench.static)  # what is stuck is the reading with the weight
    bench.alter = lambda sample: replace(sample, strain=fault(sample.strain))
    bench.run(2.0)
    assert bench.controller.phase is Phase.HELD
    assert any(part in bench.controller.cause for part in why.split('|')), bench.controller.cause
    pose = bench.controller.pose
    assert pose is not None
    before = pose.copy()
    bench.run(0.5)
    assert np.array_equal(bench.controller.pose, before)
    assert bench.controller.press(2.0).startswith('held')
    bench.controller.clear()
    assert bench.controller.phase is Phase.IDLE


class Weightless:
    """The readings of the weight where the fault began, kept."""

    def __init__(self, static: StaticStrain) -> None:
        self._static, self._kept = static, None

    def at(self, q: np.ndarray, force: float) -> object:
        """Give the same as the first time."""
        if self._kept is None:
            self._kept = self._static.at(q, force)
        return self._kept


def test_no_surface_and_a_lost_one() -> None:
    """Nothing within reach, and a floor that goes: both end in a held pose."""
    bench = bench_on(500.0, settings=ForceSettings(reach=0.01))
    assert bench.controller.phase is Phase.HELD and 'no surface' in bench.controller.cause
    bench = bench_on(500.0)
    bench.process.floor = None
    bench.run(1.5)
    assert bench.controller.phase is Phase.HELD
    assert 'lost' in bench.controller.cause or 'gives way' in bench.controller.cause


def test_the_reference_does_not_leave_an_arm_that_does_not_follow() -> None:
    """Where the damper holds, the reference stops near the arm, and says which joint is away."""
    bench = ForceRig(tudor(), 500.0)
    bench.run(0.5)
    start = bench.controller.pose.copy()
    assert bench.controller.press(2.0) == ''
    bench.process.command = lambda command: None
    bench.run(6.0)
    assert bench.controller.phase is Phase.HELD
    assert 'away from its reference' in bench.controller.cause
    assert np.abs(bench.controller.pose - start).max() < np.radians(5.5)


def test_what_is_refused() -> None:
    """Forces that cannot be held, and arms whose gauges have no gain."""
    arm = tudor()
    controller = ForceController(arm)
    assert 'no joint positions' in controller.press(2.0)
    for force in (0.1, -1.0, float('nan'), 100.0):
        assert 'send one above' in controller.press(force)
    bare = Arm(arm.spec.model_copy(update={'sensors': ()}), arm.full_model, arm.source, arm.urdf)
    with pytest.raises(ArmError, match='no gauge has a gain'):
        ForceController(bare)
    with pytest.raises(UsageError, match='not all zero'):
        ForceController(arm, normal=(0.0, 0.0, 0.0))
