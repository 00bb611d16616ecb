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

"""Shaped references: moves of the undamped arm that leave no ringing."""

from __future__ import annotations

import math
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from papers import look
from papers.campaign import Cached, FloatArray
from papers.damping import place
from papers.look import BLUE, Picture, VERMILION
from papers.outlook import Floor, Section, Setting
from papers.tuned import ENDS, schedule_of, tuned_arm
import tudor_dynamics as td
from tudor_dynamics.control.shaped_motion import ShapedPlanner, Shaping
from tudor_dynamics.models.tuning import MoveRefiner

KINDS = {'none': 'not shaped', 'fixed': 'ZV, one frequency', 'zv': 'ZV by payload',
         'zvd': 'ZVD by payload', 'elastic': 'elastic', 'refined': 'elastic, refined'}
BEFORE, AFTER = 0.3, 0.02
"""Rest before a move, and how long after its end swings count first [s]."""
SMOOTHED = 0.01
"""Time that readings are averaged over against noise [s]."""
LOUD = 20.0
"""A move that leaves less unshaped has nothing to be shaped [um/m]."""
WANTED = 0.9
MOVES = 12
LEVEL = math.radians(12.0)
"""Room that a move on one side leaves to the poses where loads change their signs [rad]."""


def section(setting: Setting) -> Section:
    """Compute the section."""
    campaign = setting.campaign
    tuned = tuned_arm(setting)
    schedule, _ = schedule_of(setting, tuned)
    depends: dict[str, Any] = {'of': campaign.described(ENDS[1], damped=False),
                               'quick': setting.quick}
    found = campaign.stages.result('shaping_trials', depends,
                                   lambda: _trials(setting, campaign.arm, schedule,
                                                   MoveRefiner(tuned)))
    content = found.content
    sided, across = (_left(content['moves'], side) for side in (True, False))
    longest = max((row['longer']['refined'] / row['period'] for row in content['moves']),
                  default=0.0)
    floors = (
        Floor('residual strain of moves whose loads keep their sign, 0 to 400 g', '90 % less',
              f'{100.0 * (1.0 - sided["refined"]):.0f} % less (by the modes alone '
              f'{100.0 * (1.0 - sided["elastic"]):.0f} %)', sided['refined'] <= 1.0 - WANTED),
        Floor('how much longer than not shaped', 'half a period', f'{longest:.2f} of a period',
              longest <= 0.51),
        Floor('ZV of one frequency on the same moves', 'less is left by the elastic one',
              f'{100.0 * (1.0 - sided["fixed"]):.0f} % less', sided['elastic'] < sided['fixed']),
        Floor('residual strain of moves anywhere, gears crossing their play', '90 % less',
              f'{100.0 * (1.0 - across["refined"]):.0f} % less (by the modes alone '
              f'{100.0 * (1.0 - across["elastic"]):.0f} %, ZV of one frequency '
              f'{100.0 * (1.0 - across["fixed"]):.0f} %)', across['refined'] <= 1.0 - WANTED),
        Floor('the same moves of an arm without play, by the modes alone', '90 % less',
              f'{100.0 * (1.0 - across["elastic_tight"]):.0f} % less',
              across['elastic_tight'] <= 1.0 - WANTED))
    text = (
        'Moves of the arm without damper, with all its imperfections; what is left is half the '
        'range of the strain of link 2 over the first period after the move, added up over the '
        'moves. The payload is known, the modes are those of an elastic model that was identified '
        'from one recording of 0 g and one of 400 g.',
        'Where the load of a gear changes its sign on the way, the link falls through the play of '
        'the gear (0.8 deg) and rings from that, which its modes know nothing of: those moves are '
        'counted for themselves, refined by the simulated model with its play, and once more '
        'without play.')
    return Section(text, floors, (
        Picture('shaping_left', 'Shaped references', 'What is left after a move',
                'One mark a move: residual strain without shaping and with it. Left: loads keep '
                'their sign. Right: moves anywhere.', lambda: _draw_left(content)),
        Picture('shaping_move', 'Shaped references', 'One move with 400 g',
                'Speed of joint 2 and strain of link 2, from the beginning of the move.',
                lambda: _draw_move(found.arrays))), content)


def _left(moves: list[dict[str, Any]], sided: bool) -> dict[str, float]:
    """Give the part of the residual strain that each kind leaves."""
    own = [row['left'] for row in moves if row['sided'] is sided and row['left']['none'] > LOUD]
    if not own:
        return dict.fromkeys((*KINDS, 'elastic_tight'), 1.0)
    plain = sum(row['none'] for row in own)
    parts = {kind: sum(row[kind] for row in own) / plain for kind in KINDS}
    tight = sum(row['none_tight'] for row in own)
    return {**parts, 'elastic_tight': sum(row['elastic_tight'] for row in own) / tight}


def _trials(
    setting: Setting, arm: td.Arm, schedule: td.Schedule, refiner: MoveRefiner,
) -> Cached:
    random = np.random.default_rng(setting.campaign.plan.seed)
    payloads = schedule.payload.tolist()
    count = 1 if setting.quick else MOVES
    middle = schedule.at(float(np.mean(payloads)), place(arm, np.full(2, 0.5))).modes[0]
    moves: list[dict[str, Any]] = []
    arrays: dict[str, FloatArray] = {}
    tight = without_play(arm)
    for sided in (True, False):
        for number in range(count):
            payload = payloads[-1 - number % len(payloads)]
            ends = draw_ends(arm, random, sided)
            mode = schedule.at(payload, ends[1]).modes[0]
            row: dict[str, Any] = {'payload': payload, 'sided': sided, 'left': {}, 'longer': {},
                                   'period': 1.0 / mode.frequency}
            plain = 0.0
            for kind in KINDS:
                shaping = (
                    Shaping('zv', None, middle.frequency, middle.damping)
                    if kind == 'fixed' else
                    Shaping('elastic', schedule, payload=payload, refine=refiner)
                    if kind == 'refined' else Shaping(kind, schedule, payload=payload))
                q, dq, length = reference(arm, shaping, ends, row['period'])
                plain = length if kind == 'none' else plain
                t, strain, left = run(arm, payload, q, dq, length, row['period'], number)
                row['left'][kind], row['longer'][kind] = left, length - plain
                if kind in ('none', 'elastic'):
                    row['left'][f'{kind}_tight'] = run(
                        tight, payload, q, dq, length, row['period'], number)[2]
                if not moves:
                    arrays |= {f'{kind}_t': t[::20], f'{kind}_strain': strain[::20],
                               f'{kind}_speed': np.degrees(dq[::20, 0])}
            moves.append(row)
            setting.progress('moves', len(moves) / (2.0 * count))
    return Cached({'moves': moves}, arrays)


def without_play(arm: td.Arm) -> td.Arm:
    """Give the same arm with gears that have no play."""
    motors = tuple(motor.model_copy(update={'backlash': 0.0}) for motor in arm.spec.motors)
    return arm.changed(motors=motors)


def draw_ends(
    arm: td.Arm, random: np.random.Generator, sided: bool,
) -> tuple[FloatArray, FloatArray]:
    """Draw two poses."""
    while True:
        ends = place(arm, random.uniform(0.05, 0.95, 2)), place(arm, random.uniform(0.05, 0.95, 2))
        if np.abs(ends[1] - ends[0]).max() < math.radians(10.0):
            continue
        angles = np.array([np.cumsum(q) for q in ends])
        right = np.all(angles < 0.5 * math.pi - LEVEL)
        if not sided or right or np.all(angles > 0.5 * math.pi + LEVEL):
            return ends


def reference(
    arm: td.Arm, shaping: Shaping, ends: tuple[FloatArray, FloatArray], period: float,
) -> tuple[FloatArray, FloatArray, float]:
    """Give a shaped move with rest before and after it, and its length [s]."""
    assert arm.spec.damper is not None
    dt = 1.0 / arm.spec.damper.rate
    planner = ShapedPlanner(td.motion_limits(arm), ends[0], shaping)
    planner.go(ends[1])
    length = planner.remaining
    begin = round(BEFORE / dt)
    steps = begin + math.ceil((length + AFTER + 1.2 * period) / dt)
    q, dq = np.tile(ends[0], (steps, 1)), np.zeros((steps, len(ends[0])))
    for k in range(begin, steps):
        planner.step(dt)
        q[k], dq[k] = planner.q, planner.dq
    return q, dq, length


def run(
    arm: td.Arm, payload: float, q: FloatArray, dq: FloatArray, length: float, period: float,
    seed: int,
) -> tuple[FloatArray, FloatArray, float]:
    """Let the undamped arm follow a move."""
    loop = td.ClosedLoop(td.with_payload(arm, payload), damping=0.0, seed=seed)
    loop.reset(q[0])
    seen = loop.run(q, dq)
    t, window = seen.t - BEFORE, round(SMOOTHED / loop.dt)
    strain = np.convolve(seen.strain[:, 0], np.full(window, 1.0 / window), 'same')
    after = (t > length + AFTER) & (t < length + AFTER + period)
    return t, strain, float(0.5 * np.ptp(strain[after]))


def _draw_left(content: dict[str, Any]) -> Figure:
    figure, axes = look.new_figure(3.4, 1, 2, sharey=True)
    for axis, sided in zip(axes[0], (True, False), strict=True):
        rows = [row['left'] for row in content['moves'] if row['sided'] is sided]
        for kind, marker, colour in (('fixed', 's', VERMILION), ('zv', '^', '#777777'),
                                     ('elastic', 'D', '#007a57'), ('refined', 'o', BLUE)):
            axis.plot([row['none'] for row in rows], [row[kind] for row in rows], marker,
                      color=colour, markersize=4, label=KINDS[kind],
                      markerfacecolor='white' if kind == 'fixed' else colour)
        most = 1.05 * max(row['none'] for row in rows)
        axis.plot([0.0, most], [0.0, (1.0 - WANTED) * most], '-', color='#111111', linewidth=0.9,
                  label='90 % less')
        axis.set_xlabel('left, not shaped [um/m]')
    axes[0, 0].set_ylabel('left, shaped [um/m]')
    axes[0, 0].legend(loc='upper left')
    return figure


def _draw_move(arrays: dict[str, FloatArray]) -> Figure:
    figure, axes = look.new_figure(4.6, 2, 1, sharex=True)
    for kind, colour, style in (('none', '#888888', '-'), ('fixed', VERMILION, (0, (4, 1.6))),
                                ('refined', BLUE, (0, (5, 1.2, 1, 1.2)))):
        for axis, what in zip(axes[:, 0], ('speed', 'strain'), strict=True):
            axis.plot(arrays[f'{kind}_t'], arrays[f'{kind}_{what}'], color=colour,
                      linestyle=style, linewidth=1.3, label=KINDS[kind])
    axes[0, 0].set_ylabel('speed of joint 2 [deg/s]')
    axes[1, 0].set_ylabel('strain of link 2 [um/m]')
    axes[1, 0].set_xlabel('time [s]')
    axes[0, 0].legend(loc='best')
    return figure
