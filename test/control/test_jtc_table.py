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

"""
Trajectories one by one: what joint_trajectory_controller documents, and what is done here.

docs/reference/trajectories.md has the same table, which a test compares.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.control.references import ReferenceSource, Tolerances
from tudor_dynamics.errors import SignalError

DT, POSE, JOINTS = 0.01, np.array([1.0, 0.2]), ('joint2', 'joint3')
NAN = float('nan')


class Play:
    """A reference with an arm that is where its reference was, or off by some."""

    def __init__(self, root: Path) -> None:
        self.source = ReferenceSource(load_arm(root / 'config/tudor.yaml'))
        self.k, self.off, self.fastest, self.steepest = 0, np.zeros(2), 0.0, 0.0
        self.moved = self.speed = np.zeros(2)
        self.run(0.05)

    def run(self, seconds: float) -> None:
        """Let time pass."""
        self.fastest = self.steepest = 0.0
        for _ in range(round(seconds / DT)):
            self.k += 1
            q = POSE if self.source.q is None else self.source.q
            self.source.measured(DT * self.k, q + self.off)
            q, speed = self.source.step(DT * self.k, DT)
            self.steepest = max(self.steepest, float(np.abs(speed - self.speed).max()))
            self.moved, self.speed = q - POSE, speed
            self.fastest = max(self.fastest, float(np.abs(speed).max()))


Step = Callable[[Play], None]


def send(
    t: list[float], q: list[Any], dq: Any = None, ddq: Any = None, *, since: float = 0.0,
    joints: tuple[str, ...] = JOINTS, why: str = '', absolute: bool = False,
) -> Step:
    """Send a message, by what joints are to move from the pose; it is refused where why says."""
    def step(play: Play) -> None:
        places = [0.0 if absolute else POSE[JOINTS.index(name)] if name in JOINTS else 0.0
                  for name in joints]
        none: list[Any] = [[]] * len(t)
        rows = [[x + place for x, place in zip(row, places, strict=False)] for row in q]
        try:
            found = play.source.take(
                Trajectory.from_points(joints, np.array(t), rows, dq or none, ddq or none), since)
        except SignalError as err:
            found = str(err)
        assert why in found and bool(why) == bool(found), found
    return step


def at(seconds: float, *moved: float) -> Step:
    """Let time pass; the reference has moved so far from the pose then."""
    def step(play: Play) -> None:
        play.run(seconds)
        assert play.moved == pytest.approx(np.array(moved), abs=1e-6)
    return step


def smooth(play: Play) -> None:
    """No speed has jumped since the last time that was let pass."""
    assert play.steepest < 0.06


def rests(play: Play) -> None:
    """Let it brake; it comes to rest before it was to arrive."""
    play.run(1.5)
    assert not play.speed.any()


def ended(text: str) -> Step:
    """Check how it ended; empty: not yet."""
    def step(play: Play) -> None:
        found = play.source.outcome
        assert found.startswith(text) and bool(text) == bool(found), found
    return step


def do(action: Callable[[Play], Any]) -> Step:
    """Do something else."""
    def step(play: Play) -> None:
        action(play)
    return step


def bounds(**values: float) -> Step:
    """Set tolerances."""
    return do(lambda play: setattr(play.source, 'tolerances', Tolerances(**values)))


def off(*by: float) -> Step:
    """Put the arm off its reference."""
    return do(lambda play: setattr(play, 'off', np.array(by)))


stop = do(lambda play: play.source.stop('no points'))
whole = do(lambda play: setattr(play.source, 'partial', False))
touch = do(lambda play: play.source.collide(True))
STILL = [[0.0, 0.0], [0.0, 0.0]]
LINE = send([1.0, 2.0], [[0.2, 0.0], [0.3, 0.0]])
SAME = 'the same'


@dataclass(frozen=True)
class Row:
    """A trajectory, what is documented, what is done, and the steps that show it."""

    name: str
    jtc: str
    here: str
    steps: tuple[Step, ...]


TABLE = (
    Row('positions alone', 'straight lines, speeds jump at the points (discouraged)', SAME,
        (LINE, at(0.5, 0.1, 0.0), at(1.0, 0.25, 0.0), at(0.6, 0.3, 0.0), ended('reached'))),
    Row('with velocities', 'cubics, continuous in speed', SAME,
        (send([1.0, 2.0], [[0.2, 0.0], [0.3, 0.0]], [[0.3, 0.0], [0.0, 0.0]]),
         at(0.5, 0.1 - 0.3 / 8, 0.0), smooth, at(1.6, 0.3, 0.0), smooth, ended('reached'))),
    Row('with accelerations', 'quintics, continuous in acceleration', SAME,
        (send([1.0, 2.0], [[0.2, 0.0], [0.3, 0.0]], [[0.3, 0.0], [0.0, 0.0]],
              [[0.5, 0.0], [0.0, 0.0]]),
         at(0.5, 0.1 - 0.3 * 5 / 32 + 0.5 / 64, 0.0), smooth, at(1.6, 0.3, 0.0), smooth)),
    Row('velocities at some points', 'each segment by what is given at its points',
        'velocities count where all points have them; otherwise straight lines',
        (send([1.0, 2.0], [[0.2, 0.0], [0.3, 0.0]], [[0.3, 0.0], []]), at(0.5, 0.1, 0.0))),
    Row('one point', 'is reached at its time',
        'a goal: a smooth move of its own time, by the limits of planned motion',
        (send([9.0], [[0.3, 0.1]]), at(2.0, 0.3, 0.1), ended('reached'))),
    Row('first point at time 0', 'no interpolation from the initial point: it is jumped to',
        'left out: it goes to the next one from where the reference is',
        (send([0.0, 1.0], [[0.5, 0.0], [0.2, 0.0]], STILL), at(0.5, 0.1, 0.0), smooth,
         at(0.6, 0.2, 0.0))),
    Row('joints in another order', 'sorted by name', SAME,
        (send([1.0, 2.0], [[0.0, 0.2], [0.1, 0.3]], joints=JOINTS[::-1]), at(1.0, 0.2, 0.0),
         at(1.1, 0.3, 0.1))),
    Row('accelerations without velocities', 'not said',
        'accelerations do not count: straight lines',
        (send([1.0, 2.0], [[0.2, 0.0], [0.3, 0.0]], None, STILL), at(0.5, 0.1, 0.0))),
    Row('velocities without positions', 'refused, unless `allow_integration_in_goal_trajectories`',
        'refused: point and count are named',
        (send([1.0, 2.0], [[], []], STILL, why='point 1 of 2 has 0 of 2 positions'),
         at(0.5, 0.0, 0.0))),
    Row('a stamp to come', 'the pose is held until then', SAME,
        (send([1.0, 2.0], [[0.2, 0.0], [0.3, 0.0]], since=-0.5), at(0.5, 0.0, 0.0),
         at(0.5, 0.1, 0.0), at(1.7, 0.3, 0.0), ended('reached'))),
    Row('a stamp to come, while one is driven',
        'that is driven until then, with `allow_trajectory_replacement`', SAME,
        (LINE, send([1.0, 2.0], [[0.1, 0.1], [0.0, 0.2]], since=-1.0), at(1.0, 0.2, 0.0),
         at(1.0, 0.1, 0.1), at(1.1, 0.0, 0.2), ended('reached'))),
    Row('two stamps to come', 'the newer one overwrites the other', SAME,
        (send([1.0, 2.0], [[0.5, 0.0], [0.5, 0.0]], since=-0.5),
         send([1.0, 2.0], [[0.2, 0.0], [0.3, 0.0]], since=-1.0), at(1.0, 0.0, 0.0),
         at(1.0, 0.2, 0.0), at(1.1, 0.3, 0.0))),
    Row('a stamp to come, then one for now', 'not said', 'the one for now drops the other',
        (send([1.0, 2.0], [[0.5, 0.0], [0.5, 0.0]], since=-0.5), LINE, at(1.0, 0.2, 0.0),
         at(1.5, 0.3, 0.0), ended('reached'))),
    Row('a stamp that is over', 'points in the past are discarded', SAME,
        (send([0.4, 1.0, 2.0], [[0.4, 0.0], [0.1, 0.0], [0.2, 0.0]], since=0.5),
         at(0.5, 0.1, 0.0), at(1.1, 0.2, 0.0))),
    Row('all points in the past', 'rejected, the current one goes on', 'the same, with a reason',
        (LINE, send([1.0, 2.0], [[0.5, 0.0], [0.5, 0.0]], since=3.0,
                    why='all points are in the past: the last one was due 1 s ago'),
         at(1.0, 0.2, 0.0), at(1.1, 0.3, 0.0), ended('reached'))),
    Row('another one, for now', 'replaces the current one smoothly', SAME,
        (send([1.0, 2.0], [[0.2, 0.0], [0.3, 0.0]], [[0.2, 0.0], [0.0, 0.0]]),
         do(lambda play: play.run(0.8)),
         send([0.8, 1.6], [[0.1, 0.1], [0.0, 0.2]], STILL), at(0.8, 0.1, 0.1), smooth,
         at(0.9, 0.0, 0.2), smooth, ended('reached'))),
    Row('no points', 'stops what is driven; the action is not aborted',
        'brakes within the limits; the action is aborted',
        (LINE, do(lambda play: play.run(0.5)), stop, rests, ended('stopped: no points'))),
    Row('some of the joints', 'refused, unless `allow_partial_joints_goal`: others are held',
        'held; refused where `allow_partial_joints_goal` is off',
        (send([1.0, 2.0], [[0.1], [0.2]], joints=('joint3',)), at(1.0, 0.0, 0.1),
         at(1.1, 0.0, 0.2))),
    Row('some of the joints, while others are driven', 'the others are held where they are',
        'the others come to where they were led',
        (LINE, do(lambda play: play.run(0.5)),
         send([1.0, 2.0], [[0.1], [0.2]], joints=('joint3',)), at(1.0, 0.3, 0.1),
         at(1.1, 0.3, 0.2))),
    Row('some of the joints, where that is not allowed', 'refused', 'the same, with a reason',
        (whole, send([1.0, 2.0], [[0.1], [0.2]], joints=('joint3',),
                     why='wrong joints, missing: joint2; the joints are joint2, joint3'),
         at(0.5, 0.0, 0.0))),
    Row('an unknown joint', 'values for the joints of the controller are required',
        'refused, the joint is named',
        (send([1.0, 2.0], [[0.1, 0.0], [0.2, 0.0]], joints=('joint2', 'wrist'),
              why='wrong joints, unknown: wrist; the joints are'), at(0.5, 0.0, 0.0))),
    Row('a joint twice', 'not said', 'refused, the joint is named',
        (send([1.0, 2.0], [[0.1, 0.0], [0.2, 0.0]], joints=('joint2', 'joint2'),
              why='wrong joints, twice: joint2; the'), at(0.5, 0.0, 0.0))),
    Row('times that do not increase', 'times have to increase strictly',
        'refused, the point is named',
        (send([1.0, 1.0], [[0.1, 0.0], [0.2, 0.0]],
              why='time does not increase after point 1 of 2, at 1 s'),
         at(0.5, 0.0, 0.0))),
    Row('NaN in the middle', 'not said', 'refused, the point is named',
        (send([1.0, 2.0], [[0.1, NAN], [0.2, 0.0]], why='the positions of point 1 of 2 have nan'),
         at(0.5, 0.0, 0.0))),
    Row('other counts than joints', 'not said', 'refused, the point is named',
        (send([1.0, 2.0], [[0.1, 0.0], [0.2]], why='point 2 of 2 has 1 of 2 positions'),
         at(0.5, 0.0, 0.0))),
    Row('the last point in motion',
        'refused, unless `allow_nonzero_velocity_at_trajectory_end`', 'refused',
        (send([1.0, 2.0], [[0.1, 0.0], [0.2, 0.0]], [[0.0, 0.0], [0.1, 0.0]],
              why='the last point is in motion; end the trajectory at rest'), at(0.5, 0.0, 0.0))),
    Row('a point beyond a limit', 'no check: the user has to ensure that inputs are correct',
        'refused before anything moves, joint and value named',
        (send([2.0, 4.0, 6.0], [[0.5, 0.0], [3.0, 0.0], [0.0, 0.0]],
              why='joint2 reaches position 4, outside'), at(0.5, 0.0, 0.0))),
    Row('beyond limits between points', 'high overshoot to match points that do not fit',
        'refused before anything moves',
        (send([1.0, 1.4], [[0.0, 0.0], [0.6, 0.0]], STILL, why='joint2 reaches velocity 2.25'),
         at(0.5, 0.0, 0.0))),
    Row('a goal at a limit, in single precision', 'not said', 'within it',
        (send([3.0, 6.0], [[1.5, 0.0], np.radians([178, 80]).astype('f4').tolist()],
              absolute=True), do(lambda play: play.run(6.1)), ended('reached'))),
    Row('off the path', 'aborted, the position is held', 'brakes, with joint and distance',
        (bounds(path=0.05), LINE, do(lambda play: play.run(0.5)), off(0.0, 0.06), rests,
         ended("off the path: 'joint3' is 0.06 rad away (tolerance 0.05); see"))),
    Row('late at the goal, within `goal_time`', 'succeeds', SAME,
        (bounds(goal=0.03, goal_time=0.5), LINE, off(0.0, 0.04), at(2.2, 0.3, 0.0), ended(''),
         off(0.0, 0.0), at(0.1, 0.3, 0.0), ended('reached'))),
    Row('not at the goal after `goal_time`', 'aborted', 'the same, with joint and distance',
        (bounds(goal=0.03, goal_time=0.5), LINE, off(0.0, 0.04), at(2.7, 0.3, 0.0),
         ended("missed the goal: 0.5 s after the end 'joint3' is 0.04 rad away"))),
    Row('not at the goal, `goal_time` 0', 'it waits for as long as it takes', SAME,
        (bounds(goal=0.03), LINE, off(0.0, 0.04), at(9.0, 0.3, 0.0), ended(''), off(0.0, 0.0),
         at(0.1, 0.3, 0.0), ended('reached'))),
    Row('during a collision', 'controllers know of none', 'stops what is driven; refused',
        (LINE, do(lambda play: play.run(0.5)), touch, ended('stopped: collision'),
         send([1.0, 2.0], [[0.2, 0.0], [0.3, 0.0]], why='a collision was reported; free'))))


@pytest.mark.parametrize('row', TABLE, ids=lambda row: row.name)
def test_what_is_done(row: Row, root: Path) -> None:
    """Motion and words are those of the table."""
    play = Play(root)
    for step in row.steps:
        step(play)
    assert play.fastest <= play.source.hard.velocity.max() + 1e-6


def test_document_has_the_table(root: Path) -> None:
    """Row by row, in this order."""
    page = (root / 'docs/reference/trajectories.md').read_text()
    text = page.split('## One by one\n')[1].split('\n## ')[0]
    rows = [tuple(cell.strip() for cell in line.strip('|').split('|'))
            for line in text.splitlines() if line.startswith('|')][2:]
    assert rows == [(row.name, row.jtc, row.here) for row in TABLE]
    assert len(rows) >= 30
