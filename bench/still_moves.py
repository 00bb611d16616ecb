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
Move a flexible tool on another simulator's arm: is it still at the end, by how much, at what cost.

The plant is MuJoCo's, of `other_plant/carried_tool.py`: seven joints whose drives lag, yield and
rub, and a slender tool of 1 to 5 Hz, damping ratio 0.01 to 0.03, mounted askew; every other tool
has two bending planes of different stiffness. Each tool is learned from ten moves with rests of
5.5 s: positions and efforts at 200 Hz with noise, efforts late by a sample, and the planned motion
(--by measured: without it); a fit that asks for more motion gets twice as much. Then come moves
that nothing was learned from: curves through three random poses with rotation of the tool, from
rest to rest. Each is followed as it was planned, shaped by another timing, by ZV, and by another
timing with the frequency 5 % too high and too low. What counts is the tip relative to the flange,
in both planes, from 0.3 s after the last point on, for a second: the largest distance from where
it comes to rest. The search of a tool was chosen on seeds 20 to 25.

    python bench/still_moves.py [--variants all as_is one_plane ...] [--seeds 20 21] [--tools 6]
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
import itertools
import json
import os
from pathlib import Path
import sys
import time
from typing import Any
import warnings

for _name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'):
    os.environ[_name] = '1'  # before numpy loads

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402
from other_plant.carried_tool import (  # noqa: E402
    CarriedTool, DH, draw_tools, DT, FloatArray, HOME, Options, planes_of, pose_of)
from scipy.spatial import cKDTree  # noqa: E402
from tables import show  # noqa: E402
from tudor_dynamics.arm.description import Arm, arm_from_dict  # noqa: E402
from tudor_dynamics.arm.schema import PreprocessingSpec  # noqa: E402
from tudor_dynamics.bags.recording import Recording  # noqa: E402
from tudor_dynamics.bags.trajectory import Trajectory  # noqa: E402
from tudor_dynamics.errors import TudorError  # noqa: E402
from tudor_dynamics.identification.excitation_plan import (  # noqa: E402
    make_moves, MOVE, Order, REST as QUIET, target_of_arm, UNKNOWN)
from tudor_dynamics.identification.tool import find_moves, fit_tool  # noqa: E402
from tudor_dynamics.models.bundle import ModelBundle  # noqa: E402
from tudor_dynamics.models.still_timing import shaped_for, still_timing  # noqa: E402

JOINTS = tuple(f'j{k}' for k in range(1, 8))
SPAN = np.array([1.2, 0.6, 1.0, 0.6, 1.2, 0.8, 1.3])
"""Poses are that far from home [rad]."""
VELOCITY = np.array([2.3, 2.3, 2.3, 2.3, 2.6, 2.6, 2.6])
ACCELERATION = np.array([15.0, 8.0, 10.0, 12.0, 15.0, 18.0, 20.0])
"""Limits of the drives [rad/s, rad/s^2]."""
POINT, RATE = 0.02, 200.0
"""Time between points of a trajectory [s], rate of recordings [Hz]."""
LEARNED, EACH, REST, FIRST = 10, 5, 5.5, 0.5
"""Moves that a tool is learned from, moves of a recording, rest after each, before them [s]."""
POSITION_NOISE, EFFORT_NOISE, LATE = 1e-5, 0.05, 1
"""Of recordings [rad, N m, samples]."""
SETTLE, LOOK = 0.3, 1.0
"""From when after the last point on the tip is looked at, and for how long [s]."""
LEAST_TURN = 0.5
"""Rotation of the tool from begin to end of a test [rad]."""
LOUD = 2e-3
"""Ring of the tip from which on a reduction means something; moves with less are left out [m]."""
OFF = 0.05
SEEDS = (20, 21, 26, 27)
"""The tool's model was made with the first two; nothing was chosen on the last two."""
VARIANTS = {
    'as_is': Options(),
    'one_plane': Options(one_plane=True),
    'stiff_drives': Options(yielding=0.2),
    'one_plane_stiff_drives': Options(one_plane=True, yielding=0.2),
    'one_plane_stiff_drives_no_dry_friction': Options(
        one_plane=True, yielding=0.2, rubbing=0.0),
    'one_plane_no_dry_friction': Options(one_plane=True, rubbing=0.0),
    'no_dry_friction': Options(rubbing=0.0),
    'stiff_drives_no_dry_friction': Options(yielding=0.2, rubbing=0.0),
    'one_plane_stiff_drives_no_dry_friction_no_gravity': Options(
        one_plane=True, yielding=0.2, rubbing=0.0, gravity=0.0),
    'more_dry_friction': Options(rubbing=3.0),
}


def described(options: Options) -> Arm:
    """Describe the arm to the package: kinematics, efforts, limits; it knows nothing else."""
    return arm_from_dict({
        'name': 'carrier', 'kinematics': {'dh': DH.tolist(), 'convention': 'modified'},
        'joints': [{'name': name, 'effort': {'topic': 'joint_states', 'unit': 'N m'},
                    'limits': {'velocity': float(v), 'acceleration': float(a)}}
                   for name, v, a in zip(JOINTS, VELOCITY, ACCELERATION, strict=True)],
        'gravity': [0.0, 0.0, -options.gravity]}, base=Path(), source='carrier.yaml')


# -- Motion

def timed(rise: float | None, duration: float, t: FloatArray) -> FloatArray:
    """Give way, speed and acceleration (3, times) along a path of length 1, rest to rest."""
    s = np.clip(t / duration, 0.0, 1.0)
    if rise is None:  # one polynomial
        return np.stack([s**3 * (10.0 - s * (15.0 - 6.0 * s)),
                         30.0 * s**2 * (1.0 - s) ** 2 / duration,
                         60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / duration**2])
    # pulses of acceleration in that part of the time at both ends, constant speed between
    top = 1.0 / (1.0 - rise)
    into = np.where(s > 0.5, 1.0 - s, s)
    a = np.minimum(into / rise, 1.0)
    way = top * rise * (0.5 * a**2 + (np.cos(2.0 * np.pi * a) - 1.0) / (4.0 * np.pi**2))
    way = np.where(into < rise, way, top * (into - 0.5 * rise))
    speed = top * (a - np.sin(2.0 * np.pi * a) / (2.0 * np.pi))
    bend = np.sign(0.5 - s) * top / rise * (1.0 - np.cos(2.0 * np.pi * a))
    return np.stack([np.where(s > 0.5, 1.0 - way, way), speed / duration, bend / duration**2])


def move(
    start: FloatArray, target: FloatArray, random: np.random.Generator, slowest: float = 0.5,
) -> Trajectory:
    """Plan a move from rest to rest on a curve, as planners do: a joint at 0.5 to 2 rad/s."""
    via = 0.5 * (start + target) + random.uniform(-0.35, 0.35, 7)
    bend = 4.0 * (0.5 * (start + target) - via)  # the parabola through all three
    whole, speed = bool(random.random() < 0.3), random.uniform(slowest, 2.0)
    share = random.uniform(0.3, 0.9)  # of the accelerations that drives allow

    def along(rise: float | None, duration: float, t: FloatArray) -> FloatArray:
        s, ds, dds = timed(rise, duration, t)[..., None]
        slope = target - start - bend + 2.0 * bend * s
        return np.stack([start + s * (target - start - bend) + s**2 * bend, slope * ds,
                         2.0 * bend * ds**2 + slope * dds])
    # as short ramps as accelerations allow, and if none is long enough, slower
    for rise in [None] if whole else np.linspace(0.02, 0.5, 97).tolist():
        unit = along(rise, 1.0, np.linspace(0.0, 1.0, 800))
        by_speed = float(np.abs(unit[1]).max()) / speed
        by_ramp = float(np.sqrt((np.abs(unit[2]) / (share * ACCELERATION)).max()))
        if by_ramp <= by_speed:
            break
    duration = max(by_speed, by_ramp)
    t = np.linspace(0.0, duration, max(round(duration / POINT), 8) + 1)
    q, dq, ddq = along(rise, duration, t)
    dq[[0, -1]], ddq[[0, -1]] = 0.0, 0.0
    return Trajectory(JOINTS, t, q, dq, ddq)


def commands(trajectory: Trajectory, after: float) -> FloatArray:
    """Give commands of each step as controllers do, by polynomials of the fifth degree."""
    begin, end = float(trajectory.t[0]), float(trajectory.t[-1])
    t = np.minimum(begin + DT * np.arange(round((end - begin + after) / DT)), end)
    k = np.clip(np.searchsorted(trajectory.t, t, side='right') - 1, 0, len(trajectory.t) - 2)
    h = np.diff(trajectory.t)[k][:, None]
    s = (t - trajectory.t[k])[:, None] / h
    assert trajectory.dq is not None
    q0, q1 = trajectory.q[k], trajectory.q[k + 1]
    v0, v1 = h * trajectory.dq[k], h * trajectory.dq[k + 1]
    if trajectory.ddq is None:
        d = q1 - q0
        return np.asarray(q0 + s * (v0 + s * (3.0 * d - 2.0 * v0 - v1 + s * (v0 + v1 - 2.0 * d))))
    a0, a1 = h**2 * trajectory.ddq[k], h**2 * trajectory.ddq[k + 1]
    d = q1 - q0 - v0 - 0.5 * a0
    e, f = v1 - v0 - a0, a1 - a0
    return np.asarray(q0 + s * (v0 + s * (0.5 * a0 + s * (
        10.0 * d - 4.0 * e + 0.5 * f + s * (-15.0 * d + 7.0 * e - f + s * (
            6.0 * d - 3.0 * e + 0.5 * f))))))


# -- Learning

def recordings(
    plant: CarriedTool, seed: list[int], moves: int, noise: float,
) -> list[tuple[Recording, Recording]]:
    """Record moves with rests: what is measured, and what was planned, of each recording."""
    random, found = np.random.default_rng(seed), []
    for _ in range(max(moves // EACH, 1)):
        q = HOME + random.uniform(-SPAN, SPAN)
        begin, parts = plant.settled(q), [np.tile(q, (round(FIRST / DT), 1))]
        for _ in range(EACH):
            to = HOME + random.uniform(-SPAN, SPAN)
            parts.append(commands(move(q, to, random, 1.0), REST))
            q = to
        found.append(recorded(plant, begin, np.vstack(parts), random, noise))
    return found


def recorded(
    plant: CarriedTool, begin: Any, wanted: FloatArray, random: np.random.Generator,
    noise: float,
) -> tuple[Recording, Recording]:
    """Record what is measured while the plant follows, and what was planned."""
    sensed = plant.follow(begin, wanted)
    every = round(1.0 / (RATE * DT))
    n = len(wanted[::every])
    stamp = 1_700_000_000_000_000_000 + np.round(np.arange(n) * 1e9 / RATE).astype(np.int64)
    measured = sensed.q[::every] + random.normal(0.0, noise * POSITION_NOISE, (n, 7))
    effort = sensed.effort[::every]
    effort = np.vstack([np.tile(effort[0], (LATE, 1)), effort[:-LATE]])
    effort = effort + random.normal(0.0, noise * EFFORT_NOISE, (n, 7))
    return (Recording('recorded', stamp, measured, None, effort, None, (slice(0, n),), 1.0 / RATE),
            Recording('planned', stamp, wanted[::every], None, None, None, (slice(0, n),),
                      1.0 / RATE))


def excited(
    arm: Arm, plant: CarriedTool, seed: list[int], moves: int, noise: float,
) -> list[tuple[Recording, Recording]]:
    """Record the moves that tudor excite plans for a tool that nobody knows."""
    near = arm.changed(joints=tuple(
        joint.model_copy(update={'limits': joint.limits.model_copy(update={
            'lower': float(low), 'upper': float(high)})})
        for joint, low, high in zip(arm.spec.joints, HOME - SPAN, HOME + SPAN, strict=True)))
    plan = make_moves(target_of_arm(near), Order(
        moves * (MOVE + QUIET) + 0.01, 1.0, POINT, 60, sum(seed)), UNKNOWN)
    wanted = np.vstack([np.tile(plan.trajectory.q[0], (round(FIRST / DT), 1)),
                        commands(plan.trajectory, 0.0)])
    return [recorded(plant, plant.settled(wanted[0]), wanted, np.random.default_rng(seed), noise)]


def learned(
    arm: Arm, plant: CarriedTool, seed: list[int], by: str = 'planned', moves: int = LEARNED,
    noise: float = 1.0, planned_moves: int = 0,
) -> Any:
    """Learn the tool, from random moves or from some of tudor excite."""
    pairs = (excited(arm, plant, seed, planned_moves, noise) if planned_moves else
             recordings(plant, seed, moves, noise))
    return fit_tool(arm, [one for measured, planned in pairs for one in find_moves(
        arm, measured, planned if by == 'planned' else None)], by)


# -- Judging

@dataclass(frozen=True)
class Ring:
    """How far the tip is from where it comes to rest [m]."""

    both: float
    planes: tuple[float, float]  # each bending plane


def ring_after(plant: CarriedTool, begin: FloatArray, trajectory: Trajectory) -> Ring:
    """Follow a trajectory, and look at the tip after it."""
    wanted = commands(trajectory, SETTLE + LOOK)
    sensed = plant.follow(begin, wanted)
    tip = sensed.tip[-round(LOOK / DT):] - plant.resting(sensed.end, wanted[-1])
    across = np.abs(tip @ planes_of(plant.tool).T).max(axis=0)
    return Ring(float(np.linalg.norm(tip, axis=1).max()), (float(across[0]), float(across[1])))


def off_path(given: Trajectory, shaped: Trajectory) -> float:
    """Give how far a motion leaves the path of the given one [rad]."""
    path = cKDTree(commands(given, 0.0))
    return float(path.query(commands(shaped, 0.0)[::4])[0].max())


def over_limits(trajectory: Trajectory) -> float:
    """Give the largest speed or acceleration over its limit."""
    q = commands(trajectory, 0.0)
    dq = np.diff(q, axis=0) / DT
    ddq = np.diff(dq[::8], axis=0) / (8 * DT)
    return float(max((np.abs(dq) / VELOCITY).max(), (np.abs(ddq) / ACCELERATION).max()))


def judged(
    arm: Arm, plant: CarriedTool, tool: Any, given: Trajectory, frequency: float,
) -> dict[str, Any]:
    """Follow a move in all ways."""
    begin = plant.settled(given.q[0])
    before = ring_after(plant, begin, given)
    row: dict[str, Any] = {
        'seconds': round(float(given.t[-1]), 3), 'turn': round(turned(given), 2),
        'ring_mm': _mm(before.both), 'planes_mm': [_mm(x) for x in before.planes],
        'frequency': round(frequency, 3),
        'frequency_learned': round(tool.frequency_at(arm, given.q[-1])[0].value, 3),
        'predicted_N_m': round(predicted(arm, tool, given), 4)}
    for name, by, factor in (('timing', 'timing', 1.0), ('zv', 'zv', 1.0),
                             ('high', 'timing', 1.0 + OFF), ('low', 'timing', 1.0 - OFF)):
        off = tool.model_copy(update={'frequencies': [x * factor for x in tool.frequencies]})
        begun = time.process_time()
        try:
            shaped = (still_timing(arm, off, given) if by == 'timing'
                      else shaped_for(ModelBundle(arm, PreprocessingSpec(), {}, tool=off), given,
                                      by))
        except TudorError as err:
            row[name] = {'refused': str(err)[:200]}
            continue
        spent = time.process_time() - begun
        after = ring_after(plant, begin, shaped)
        longer = float(shaped.t[-1] - shaped.t[0] - given.t[-1] + given.t[0])
        row[name] = {
            'ring_mm': _mm(after.both), 'planes_mm': [_mm(x) for x in after.planes],
            'reduced': round(1.0 - after.both / before.both, 4),
            'half_periods_longer': round(2.0 * frequency * longer, 3),
            'predicted_N_m': round(predicted(arm, off, shaped), 4),
            'off_path_rad': round(off_path(given, shaped), 5),
            'over_limits': round(over_limits(shaped), 3), 'seconds_to_plan': round(spent, 2)}
    return row


def turned(given: Trajectory) -> float:
    """Give the rotation of the tool from begin to end [rad]."""
    between = pose_of(given.q[0])[:3, :3].T @ pose_of(given.q[-1])[:3, :3]
    return float(np.arccos(np.clip(0.5 * (np.trace(between) - 1.0), -1.0, 1.0)))


def _mm(metres: float) -> float:
    return round(1e3 * metres, 3)


def tests(plant: CarriedTool, seed: list[int], count: int) -> tuple[list[Trajectory], int]:
    """Plan moves that rotate the tool and let it ring; how many did not ring, beside them."""
    random, quiet = np.random.default_rng(seed), 0
    found: list[Trajectory] = []
    while len(found) < count:
        start, target = HOME + random.uniform(-SPAN, SPAN, (2, 7))
        given = move(start, target, random)
        if turned(given) < LEAST_TURN:
            continue
        if ring_after(plant, plant.settled(start), given).both < LOUD:
            quiet += 1
        else:
            found.append(given)
    return found, quiet


def predicted(arm: Arm, tool: Any, given: Trajectory) -> float:
    """Give the ring that the package expects of the loudest joint [N m]."""
    return float(tool.ring_after(arm, given).torque.value)


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Give medians and the figure that nine of ten moves reach; one that is refused has 0."""
    whole: dict[str, Any] = {'moves': len(rows)}
    for name in ('timing', 'zv', 'high', 'low'):
        items = [row[name] for row in rows]
        done = [item for item in items if 'refused' not in item]
        reduced = [item.get('reduced', 0.0) for item in items]
        whole[name] = {
            'refused': len(items) - len(done),
            'reduced_median': _quantile(reduced, 0.5),
            'reduced_by_nine_of_ten': _quantile(reduced, 0.1),
            'reduced_least': _quantile(reduced, 0.0),
            'of_those_done': {'reduced_median': _quantile([x['reduced'] for x in done], 0.5),
                              'reduced_by_nine_of_ten': _quantile([x['reduced'] for x in done],
                                                                  0.1)},
            'half_periods_longer': {
                'median': _quantile([x['half_periods_longer'] for x in done], 0.5),
                'most': _quantile([x['half_periods_longer'] for x in done], 1.0)},
            'off_path_rad_most': _quantile([x['off_path_rad'] for x in done], 1.0),
            'over_limits_most': _quantile([x['over_limits'] for x in done], 1.0),
            'seconds_to_plan': {
                'median': _quantile([x['seconds_to_plan'] for x in done], 0.5),
                'most': _quantile([x['seconds_to_plan'] for x in done], 1.0)}}
    return whole


def _quantile(values: list[float], share: float) -> float | None:
    return round(float(np.quantile(values, share)), 4) if values else None


def variant(arm: Arm, options: Options, seed: int, args: argparse.Namespace) -> dict[str, Any]:
    """Measure one plant."""
    tools: list[dict[str, Any]] = []
    rows: list[dict[str, Any]] = []
    for number, drawn in enumerate(draw_tools(6, seed)):
        if number >= args.tools:
            break
        plant = CarriedTool(drawn, options)
        about: dict[str, Any] = {'drawn': {
            'frequency': round(drawn.frequency, 3), 'damping': round(drawn.damping, 4),
            'apart': round(drawn.apart, 2), 'length': round(drawn.length, 3),
            'mass': round(drawn.mass, 2)}}
        tools.append(about)
        moves, about['quiet_moves_left_out'] = tests(plant, [seed, 1, number], args.moves)
        tool = None
        for often in (1, 2):  # a fit that fails asks for more motion
            try:
                tool = learned(arm, plant, [seed, 2, number], args.by, often * args.learned,
                               args.noise, often * args.excited)
                break
            except TudorError as err:
                about['not_learned'] = [*about.get('not_learned', []), str(err)]
        if tool is None:
            rows += [{'tool': number, **dict.fromkeys(
                ('timing', 'zv', 'high', 'low'), {'refused': 'not learned'})} for _ in moves]
            continue
        about['learned'] = str(tool)
        about['rings'] = []
        for k, given in enumerate(moves):
            rings = plant.ring_downs(given.q[-1])
            about['rings'].append([[round(x.frequency, 3), round(x.damping, 4)] for x in rings])
            row = judged(arm, plant, tool, given, rings[0].frequency)
            rows.append({'tool': number, 'move': k, **row})
            if args.verbose:
                print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    known = [row for row in rows if 'frequency' in row]
    return {'all': summary(rows),
            'frequency_error': {
                'median': _quantile([abs(x['frequency_learned'] / x['frequency'] - 1.0)
                                     for x in known], 0.5),
                'most': _quantile([abs(x['frequency_learned'] / x['frequency'] - 1.0)
                                   for x in known], 1.0)},
            'tools': tools, 'rows': rows}


def main() -> int:
    """Measure and print as JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().splitlines()[0])
    parser.add_argument('--variants', nargs='+', choices=('all', *VARIANTS), default=['as_is'])
    parser.add_argument('--tools', type=int, default=6)
    parser.add_argument('--moves', type=int, default=5, help='of each tool')
    parser.add_argument('--by', choices=('planned', 'measured'), default='planned',
                        help='the motion that the tool is learned from')
    parser.add_argument('--seeds', nargs='+', type=int, default=list(SEEDS),
                        help='of tools and moves')
    parser.add_argument('--learned', type=int, default=LEARNED, help='moves to learn from')
    parser.add_argument('--excited', type=int, default=0, metavar='MOVES',
                        help='learn from so many moves of tudor excite --for vibration instead')
    parser.add_argument('--noise', type=float, default=1.0, help='times that of the recordings')
    parser.add_argument('--verbose', action='store_true', help='say each move as it is done')
    parser.add_argument('--out', type=Path, help='also write the figures there, plant by plant')
    args = parser.parse_args()
    warnings.simplefilter('ignore')
    names = list(VARIANTS) if 'all' in args.variants else args.variants
    found = {}
    rows = []
    for name, seed in itertools.product(names, args.seeds):
        one = variant(described(VARIANTS[name]), VARIANTS[name], seed, args)
        found[f'{name} {seed}'] = one
        timing = one['all']['timing']
        rows.append([f'{name.replace("_", " ")}, {one["all"]["moves"]} moves (seed {seed})',
                     *(reached(one['all'][way]) for way in ('timing', 'high', 'low', 'zv')),
                     f'{timing["half_periods_longer"]["most"]:.2f}',
                     '{median:.2f} / {most:.2f}'.format(**timing['seconds_to_plan'])])
        if args.out is not None:
            args.out.write_text(json.dumps(found, indent=1))
    print(json.dumps(found, indent=1))
    show(['plant', 'timing', 'frequency 5 % higher', '5 % lower', 'ZV',
          'longer, half periods', 'seconds to plan'], rows)
    return 0


def reached(ways: dict[str, Any]) -> str:
    """Write what is gone of the ring: median, and what nine of ten reach."""
    return f'{100.0 * ways["reduced_median"]:.0f} / {100.0 * ways["reduced_by_nine_of_ten"]:.0f} %'


if __name__ == '__main__':
    sys.exit(main())
