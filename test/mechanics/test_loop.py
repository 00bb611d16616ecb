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

"""A controller of one's own on the simulated rig: a function of samples."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
import pytest

import tudor_dynamics as td
from tudor_dynamics.errors import SignalError, SimulationError, UsageError
from tudor_dynamics.mechanics.closed_loop import Sample

RATE = 500.0
SPEED = 0.2
"""Of a joint that moves at all [rad/s]."""
BEGIN = 0.1
"""When it begins to [s]."""
GAIN = 1.4e-3
"""Velocity per strain, that of the description [rad/s per um/m]."""


@pytest.fixture(scope='module')
def arm(root: Path) -> td.Arm:
    """Give the reference arm."""
    return td.load_arm(root / 'config' / 'tudor.yaml')


def stepping(arm: td.Arm) -> Callable[[Sample], ArrayLike]:
    """Make a controller that lets the first joint move from a sample on."""
    count = len(arm.active_joints)
    return lambda sample: np.array(
        [SPEED if sample.t >= BEGIN - 1e-9 else 0.0] + [0.0] * (count - 1))


def test_commands_move_the_arm_after_the_delay(arm: td.Arm) -> None:
    """A command acts one sample later, with a delay as much later as was asked."""
    begun = []
    for delay in (0.0, 0.04):
        run = td.Loop(arm, stepping(arm), rate=RATE, delay=delay,
                      imperfections=td.Imperfections.none()).run(0.4)
        assert run.t[1] - run.t[0] == pytest.approx(1.0 / RATE)
        begun.append(float(run.t[np.flatnonzero(run.dq_ref[:, 0] > 0.0)[0]]))
        assert run.q[-1, 0] - run.q[0, 0] == pytest.approx(
            SPEED * (run.t[-1] - begun[-1]), rel=0.1)
    assert begun[0] == pytest.approx(BEGIN + 1.0 / RATE)
    assert begun[1] - begun[0] == pytest.approx(0.04, abs=1e-9)


def test_a_run_goes_on_where_it_ended(arm: td.Arm) -> None:
    """Two runs one after the other are the same as one, noise included."""
    whole = td.Loop(arm, stepping(arm), seed=3).run(0.4)
    loop = td.Loop(arm, stepping(arm), seed=3)
    parts = [loop.run(0.15), loop.run(0.25)]
    for name in ('t', 'q', 'current', 'strain', 'dq_ref', 'q_true'):
        joined = np.concatenate([getattr(part, name) for part in parts])
        assert np.array_equal(joined, getattr(whole, name)), name


def test_strain_fed_back_damps_the_link(arm: td.Arm) -> None:
    """After a push the strain settles in less than half of the time with its feedback."""
    push = td.Push(0.2, 0.05, arm.active_joints[-1], 0.2, (6.0, 0.0, 0.0))
    settled = []
    for gain in (0.0, -GAIN):
        first: list[Sample] = []

        def law(
            sample: Sample, gain: float = gain, first: list[Sample] = first,
        ) -> ArrayLike:
            first.append(sample)
            speed = 3.0 * (first[0].q - sample.q)
            speed[0] += gain * (sample.strain[0] - first[0].strain[0])
            return speed

        run = td.Loop(arm, law, payload=0.2, pushes=[push]).run(3.0)
        off = np.abs(run.strain[:, 0] - run.strain[-75:, 0].mean()) > 20.0
        settled.append(float(run.t[np.flatnonzero(off)[-1]]) - 0.25)
    assert 0.0 < settled[1] < 0.5 * settled[0]


@pytest.mark.parametrize(('answer', 'text'), [
    ([0.0], 'has the shape'), ('fast', 'expected numbers'), ([np.nan, 0.0], 'NaN or infinite')])
def test_answers_that_are_no_velocities_are_refused(
    arm: td.Arm, answer: ArrayLike, text: str,
) -> None:
    """What a controller returns is checked, and named."""
    with pytest.raises(SignalError, match=f'the answer of the controller.*{text}'):
        td.Loop(arm, lambda _: answer).run(0.1)


def test_arguments_that_make_no_sense_are_refused(arm: td.Arm) -> None:
    """A controller that is none, a delay below zero, a rate that is not a multiple."""
    with pytest.raises(UsageError, match='expected a function'):
        td.Loop(arm, 3.0)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match='expected 0 s or more'):
        td.Loop(arm, lambda _: None, delay=-1.0)
    with pytest.raises(SimulationError, match='divided by a whole number'):
        td.Loop(arm, lambda _: None, rate=333.0)


def test_a_goal_may_be_a_list(arm: td.Arm) -> None:
    """As documents show it: the arm goes there."""
    rig = td.Rig(arm, share=1.0)
    rig.run(1.0)
    assert rig.source is not None and rig.source.go([1.0, 0.2]) == ''
    assert rig.run(4.0).q_true[-1] == pytest.approx([1.0, 0.2], abs=0.03)
