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

"""Load-adaptive damping: the ratio asked for, at every payload and pose."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from papers import look
from papers.campaign import Cached, FloatArray
from papers.look import BLUE, Picture, VERMILION
from papers.outlook import Floor, Section, Setting
from papers.tuned import DELAY, ENDS, RATE, schedule_of, tuned_arm
import tudor_dynamics as td
from tudor_dynamics.show.pictures import draw_schedule

PAYLOAD_ERROR = 0.02
"""Of the payload that the damper is given: what an estimate has within a second [kg]."""
ALLOWED = 0.2
"""Part of the damping ratio by which it may be missed."""
FASTER = 2.0
QUIET, SLOW = 30.0, 2.0
"""After a pick-up: strain of noise and play [um/m], commands that bring joints back [deg/s]."""
LATE = 0.8
"""After which the damper is given what was picked up [s]."""
POSES, MOVES, PICKED = 8, 12, 8
TAP, TAP_TIME = 6.0, 0.05
"""Force across the last link, and its time: small enough for the limits of the drives [N, s]."""
BAND = 10.0
"""A strain within it of its final value has settled [um/m]."""
NEAR = math.radians(0.2)
WATCHED = 4.0
"""After the end of a reference [s]."""
SMOOTHED = 5
"""Samples that are averaged against noise."""
NOTHING = 1e-4
"""Payload of an empty hand that will pick something up [kg]."""


def section(setting: Setting) -> Section:
    """Compute the section."""
    campaign = setting.campaign
    tuned = tuned_arm(setting)
    schedule, fixed = schedule_of(setting, tuned)
    depends: dict[str, Any] = {'of': campaign.described(ENDS[1], damped=True),
                               'quick': setting.quick}
    found = campaign.stages.result('damping_trials', depends,
                                   lambda: _trials(setting, campaign.arm, schedule))
    content = found.content
    asked = schedule.content.damping_ratio
    ratios = np.array(content['ratios'])
    off = np.abs(ratios[..., 0] / asked - 1.0)
    within = int((off <= ALLOWED).sum())
    moves = {kind: np.array([row[kind] for row in content['moves']])
             for kind in ('fixed', 'scheduled')}
    complete = moves['fixed'][:, 3] > 0.0
    times = {kind: values[complete, 0].mean() for kind, values in moves.items()}
    swings = np.array(content['picked'])
    floors = (
        Floor(f'damping ratio {asked:g}, taps at {ratios.shape[0]} payloads and '
              f'{ratios.shape[1]} poses each', 'within 20 %',
              f'{within} of {off.size}; {np.quantile(ratios[..., 0], 0.05):.2f} to '
              f'{np.quantile(ratios[..., 0], 0.95):.2f} for nine of ten, fixed gains '
              f'{ratios[..., 1].min():.2f} to {ratios[..., 1].max():.2f}',
              bool(off.max() <= ALLOWED)),
        Floor(f'settling at 400 g, {int(complete.sum())} of {len(complete)} moves that fixed '
              'gains follow', f'{FASTER:g} x faster than fixed gains',
              f'{times["scheduled"]:.2f} s instead of {times["fixed"]:.2f} s: '
              f'{times["fixed"] / times["scheduled"]:.1f} x',
              bool(times['fixed'] >= FASTER * times['scheduled'])),
        Floor(f'{len(swings)} pick-ups of 100 to 400 g in motion', 'no limit cycle',
              f'4 s later at most {swings[:, 0].max():.0f} µm/m, '
              f'{swings[:, 1].max():.1f} deg/s',
              bool(np.all(swings[:, 0] < QUIET) and np.all(swings[:, 1] < SLOW)
                   and np.all(swings[:, 2] > 0.0))))
    over = {kind: values[:, 2].max() for kind, values in moves.items()}
    text = (
        'Gains of damper and position loop over payload and pose, computed from an elastic model '
        'that was identified from one recording of 0 g and one of 400 g, by tudor tune. The '
        'damper is given a payload that is wrong by 20 g.',
        'Taps across the last link, from both sides: half of the difference of the strains, and '
        'how far it swings back. Moves between random poses at 400 g: joints overshoot by at most '
        f'{over["fixed"]:.1f} deg with fixed gains and {over["scheduled"]:.1f} deg with '
        f'scheduled ones; {int((~complete).sum())} of {len(complete)} moves end elsewhere with '
        'fixed gains, because the arm is too far from its reference, and '
        f'{int((moves["scheduled"][:, 3] == 0.0).sum())} with scheduled ones. The loop has 4 ms '
        'of delay at 500 Hz, the arm friction, play, noise and limits of its drives.',
        'What is picked up pulls at the joints until the damper is given it, '
        f'{LATE:g} s later: in {int((swings[:, 3] == 0.0).sum())} of {len(swings)} cases so far '
        'that the reference begins again where the arm is, as it does after any interruption.')
    pictures = (
        Picture('damping_schedule', 'Load-adaptive damping', 'The schedule',
                'Medians over the workspace, bands from the least to the largest value.',
                lambda: draw_schedule(schedule, fixed)),
        Picture('damping_ratio', 'Load-adaptive damping', 'Measured damping ratios',
                'One mark a pose, at each payload; hatched what was asked for within 20 %.',
                lambda: _draw_ratios(content, asked)),
        Picture('damping_moves', 'Load-adaptive damping', 'A move with 400 g, and a pick-up',
                'Strain of link 2 and joint 2 after the end of its reference; strain and payload '
                'in use after 400 g were picked up in motion.',
                lambda: _draw_moves(found.arrays)))
    return Section(text, floors, pictures, content)


def _trials(setting: Setting, arm: td.Arm, schedule: td.Schedule) -> Cached:
    random = np.random.default_rng(setting.campaign.plan.seed)
    poses, count, picks = (1, 1, 1) if setting.quick else (POSES, MOVES, PICKED)
    payloads = schedule.payload.tolist()
    ratios = []
    for payload in payloads:
        row = []
        for pose in range(poses):
            q = place(arm, random.uniform(0.03, 0.97, len(arm.active_joints)))
            modes = schedule.at(payload, q).modes
            slow, fast = modes[0].frequency, modes[-1].frequency
            row.append([tapped(arm, used, q, payload, PAYLOAD_ERROR, (slow, fast), pose)[0]
                        for used in (schedule, None)])
        ratios.append(row)
        setting.progress(f'taps at {1e3 * payload:.0f} g', 0.5 * len(ratios) / len(payloads))
    heavy, moves = ENDS[1], []
    arrays: dict[str, FloatArray] = {}
    for number in range(count):
        ends = _ends(arm, random)
        given = heavy + PAYLOAD_ERROR * (1 if number % 2 else -1)
        row_of = {}
        for kind, used in (('fixed', None), ('scheduled', schedule)):
            one = moved(arm, used, ends, heavy, given, number)
            row_of[kind] = [one.settled, one.back, one.overshoot, float(one.followed)]
            if number == 0:
                arrays |= {f'{kind}_t': one.t, f'{kind}_strain': one.strain,
                           f'{kind}_error': one.error}
        moves.append(row_of)
        setting.progress('moves', 0.5 + 0.3 * (number + 1) / count)
    picked = []
    for number in range(picks):
        mass = 0.1 + 0.3 * (number + 1) / picks
        got = picked_up(arm, schedule, _ends(arm, random), mass, LATE, number)
        picked.append([got.swing, got.command, float(got.quiet), float(got.followed)])
        arrays |= {'picked_t': got.t, 'picked_strain': got.strain, 'picked_payload': got.payload}
        setting.progress('pick-ups', 0.8 + 0.2 * (number + 1) / picks)
    return Cached({'payloads': payloads, 'ratios': ratios, 'moves': moves, 'picked': picked},
                  arrays)


def _ends(arm: td.Arm, random: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Draw two poses."""
    n = len(arm.active_joints)
    return place(arm, random.uniform(0.1, 0.9, n)), place(arm, random.uniform(0.1, 0.9, n))


def _draw_ratios(content: dict[str, Any], asked: float) -> Figure:
    figure, axes = look.new_figure(3.0, 1)
    axis = axes[0, 0]
    for kind, (label, colour, marker, shift) in enumerate((
            ('scheduled gains', BLUE, 'o', -6.0), ('fixed gains', VERMILION, 's', 6.0))):
        points = np.array([(1e3 * payload + shift, pair[kind]) for payload, row in zip(
            content['payloads'], content['ratios'], strict=True) for pair in row])
        axis.plot(points[:, 0], points[:, 1], marker, color=colour, markersize=4, label=label,
                  markerfacecolor=colour if kind == 0 else 'white')
    axis.axhspan((1.0 - ALLOWED) * asked, (1.0 + ALLOWED) * asked, facecolor='none',
                 edgecolor='#999999', hatch='///', linewidth=0.0, zorder=0)
    axis.set_ylim(0.0, 1.0)
    axis.set_xlabel('payload [g]')
    axis.set_ylabel('damping ratio, first mode')
    axis.legend(loc='lower right')
    return figure


def _draw_moves(arrays: dict[str, FloatArray]) -> Figure:
    figure, axes = look.new_figure(5.4, 2, 2)
    for kind, (label, colour, width) in {
            'fixed': ('fixed gains', VERMILION, 1.0),
            'scheduled': ('scheduled gains', BLUE, 1.6)}.items():
        t = arrays[f'{kind}_t']
        shown = t > -1.0
        axes[0, 0].plot(t[shown], arrays[f'{kind}_strain'][shown], color=colour, linewidth=width,
                        label=label, linestyle='-' if kind == 'scheduled' else (0, (4, 1.6)))
        axes[0, 1].plot(t[shown], arrays[f'{kind}_error'][shown], color=colour, linewidth=width,
                        label=label, linestyle='-' if kind == 'scheduled' else (0, (4, 1.6)))
    axes[1, 0].plot(arrays['picked_t'], arrays['picked_strain'], color=BLUE, linewidth=1.2)
    axes[1, 1].plot(arrays['picked_t'], 1e3 * arrays['picked_payload'], color=BLUE, linewidth=1.6)
    for axis, label in ((axes[0, 0], 'strain of link 2 [um/m]'),
                        (axes[0, 1], 'joint 2 less reference [deg]'),
                        (axes[1, 0], 'strain of link 2 [um/m]'),
                        (axes[1, 1], 'payload in use [g]')):
        axis.set_ylabel(label)
    for axis in axes[0]:
        axis.set_xlabel('time since the end of the reference [s]')
    for axis in axes[1]:
        axis.set_xlabel('time since the pick-up [s]')
    axes[0, 0].legend(loc='best')
    return figure


def place(arm: td.Arm, shares: FloatArray) -> FloatArray:
    """Give a pose by its shares of the planned range of each joint [rad]."""
    planned = td.planned_limits(arm)
    return np.asarray(planned.lower + shares * (planned.upper - planned.lower))


def resting_at(arm: td.Arm, q: FloatArray) -> td.Arm:
    """Give the arm that begins at the pose q [rad]."""
    simulation = arm.spec.simulation.model_copy(update={
        'initial': dict(zip(arm.active_joints, q.tolist(), strict=True))})
    return arm.changed(simulation=simulation)


def rig_of(
    arm: td.Arm, schedule: td.Schedule | None, q: FloatArray, payload: float, given: float,
    seed: int,
) -> td.Rig:
    """Let an arm rest at a pose, its gains following a schedule."""
    rig = td.Rig(resting_at(arm, q), rate=RATE, payload=payload, delay=DELAY - 1.0 / RATE,
                 seed=seed)
    if schedule is not None:
        rig.follow(schedule, max(given, 0.0))
    rig.run(1.5)
    assert rig.controller is not None  # of an arm that has moved before, and has answered
    rig.controller.watched.trust(rig.controller.limits.velocity)
    return rig


def tapped(
    arm: td.Arm, schedule: td.Schedule | None, q: FloatArray, payload: float, error: float,
    frequencies: tuple[float, float], seed: int,
) -> tuple[float, FloatArray]:
    """Tap the tip from both sides, and look how far the strain swings back."""
    first, second = frequencies
    across = np.array([-math.sin(q.sum()), 0.0, math.cos(q.sum())])
    seen = []
    for side in (1.0, -1.0):
        rig = rig_of(arm, schedule, q, payload, payload + side * error, seed)
        rig.process.force = side * TAP * across
        rig.run(TAP_TIME)
        rig.process.force = np.zeros(3)
        begin = len(rig.trace.t)
        rig.run(1.8 / first)
        seen.append(rig.trace.array('strain')[begin:, _gauge(rig)])
    strain = 0.5 * (seen[0] - seen[1])
    window = max(round(RATE / second), 1)  # over a period of the second mode
    smooth = np.convolve(strain, np.full(window, 1.0 / window), 'same')
    top = int(np.argmax(np.abs(smooth[:int(0.6 * RATE / first)])))
    later = smooth[top:top + int(1.2 * RATE / first)] * np.sign(smooth[top])
    decrement = math.log(float(later[0]) / max(float(-later.min()), 1e-3))
    return decrement / math.hypot(math.pi, decrement), strain


def _gauge(rig: td.Rig) -> int:
    assert rig.controller is not None
    return rig.arm.gauge_names.index(rig.controller.damper.gauges[0])


@dataclass(frozen=True, eq=False)
class Moved:
    """What a move came to."""

    # after the end of the reference, until the strain is within 10 um/m of its final value, and
    # until the joints are within 0.2 deg of the target [s]
    settled: float
    back: float
    overshoot: float  # largest distance of a joint from its target after that end [deg]
    followed: bool  # whether the arm was with its reference all the time
    t: FloatArray  # since that end [s]; strain [um/m]; first joint less its reference [deg]
    strain: FloatArray
    error: FloatArray


def moved(
    arm: td.Arm, schedule: td.Schedule | None, ends: tuple[FloatArray, FloatArray], payload: float,
    given: float, seed: int,
) -> Moved:
    """Move from pose to pose."""
    rig = rig_of(arm, schedule, ends[0], payload, given, seed)
    assert rig.source is not None
    rig.source.go(ends[1])
    rig.step()
    assert rig.source.motion is not None
    remaining = rig.source.motion.remaining
    over = rig.t + remaining
    rig.run(remaining + WATCHED)
    t = np.array(rig.trace.t) - over
    strain = rig.trace.array('strain')[:, _gauge(rig)]
    strain = np.convolve(strain, np.full(SMOOTHED, 1.0 / SMOOTHED), 'same')
    after = (t > 0.0) & (t < t[-1] - 2.0 * SMOOTHED / RATE)
    final = strain[after][-round(0.5 * RATE):].mean()
    q, q_ref = rig.trace.array('q'), rig.trace.array('q_ref')
    away = np.abs(q - ends[1]).max(axis=1)

    def last(outside: FloatArray) -> float:
        times = t[after & outside]
        return float(times[-1]) if times.size else 0.0
    return Moved(last(np.abs(strain - final) > BAND), last(away > NEAR),
                 float(np.degrees(away[after].max())), rig.source.note == '', t, strain,
                 np.degrees(q - q_ref)[:, 0])


@dataclass(frozen=True, eq=False)
class PickedUp:
    """What picking up in motion came to."""

    swing: float  # from 4 to 5 s after it: range of the strain [um/m] and largest command [deg/s]
    command: float
    # whether the damper was not switched off for a swing; whether the arm was with its reference
    # all the time
    quiet: bool
    followed: bool
    t: FloatArray  # since the payload is there [s]; strain [um/m]; payload in use [kg]
    strain: FloatArray
    payload: FloatArray


def picked_up(
    arm: td.Arm, schedule: td.Schedule, ends: tuple[FloatArray, FloatArray], payload: float,
    late: float, seed: int,
) -> PickedUp:
    """Let a payload appear at the tip in the middle of a move."""
    rig = rig_of(arm, schedule, ends[0], NOTHING, 0.0, seed)
    controller, source = rig.controller, rig.source
    assert controller is not None and source is not None and controller.adaptation is not None
    source.go(ends[1])
    rig.step()
    assert source.motion is not None
    rig.run(0.5 * source.motion.remaining)
    begin = len(rig.trace.t)
    rig.process.loop.set_payload(payload)
    used = []
    for k in range(round(5.0 * RATE)):
        if k == round(late * RATE):
            controller.adaptation.tell(rig.t, payload)
        rig.step()
        used.append(controller.adaptation.payload or 0.0)
    strain = rig.trace.array('strain')[begin:, _gauge(rig)]
    command = np.degrees(np.abs(rig.trace.array('command')[begin:]))
    end = round(4.0 * RATE)
    return PickedUp(float(np.ptp(strain[end:])), float(command[end:].max()),
                    controller.gains.excited == '', source.note == '',
                    np.arange(len(strain)) / RATE, strain, np.array(used))
