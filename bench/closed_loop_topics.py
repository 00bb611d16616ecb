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
The closed loop over topics: simulator, reference, damper and monitor, each a process of its own.

The arm makes a move, is pushed at the tip, and drives onto an elastic floor. Settling is compared
with the loop inside one process (`ClosedLoop`) on the same reference;
everything is judged by stamps, so that a slow machine may run the simulator below real time.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import json
from pathlib import Path
import tempfile
import time
from typing import Any

from live_nodes import FloatArray, Listener, make_model, PAYLOAD, Processes
import numpy as np
import rclpy

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.mechanics.closed_loop import ClosedLoop
from tudor_dynamics.mechanics.hardware import with_payload
from tudor_dynamics.nodes.common.messages import nanoseconds

BAND = 10.0  # um/m
MOVE = np.radians([75.0, -45.0])


def settling(t: FloatArray, strain: FloatArray, ends: float, until: float) -> dict[str, float]:
    """Judge how a strain comes to rest after a reference has ended: 10 ms means, band, peak."""
    dt = float(np.median(np.diff(t)))
    count = max(round(0.01 / dt), 1)
    chosen = (t > ends - 0.5) & (t < until)
    t, strain = t[chosen], strain[chosen]
    away = strain - strain[t > until - 1.0].mean()
    away = np.convolve(away, np.full(count, 1.0 / count), 'valid')
    t = t[:len(away)]
    outside = t[np.abs(away) > BAND]
    return {'settling': float(max(outside[-1] - ends, 0.0)) if outside.size else 0.0,
            'peak': float(np.abs(away[t > ends]).max())}


def offline(
    arm: Arm, t: FloatArray, q: FloatArray, dq: FloatArray, seed: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Drive the loop in one process along a reference; give times, strains and joint errors."""
    loop = ClosedLoop(with_payload(arm, PAYLOAD), seed=seed)
    grid = np.arange(t[0], t[-1], loop.dt)
    q_ref = np.column_stack([np.interp(grid, t, column) for column in q.T])
    dq_ref = np.column_stack([np.interp(grid, t, column) for column in dq.T])
    loop.reset(q_ref[0])
    seen = loop.run(q_ref, dq_ref, every=4)
    return grid[::4][:len(seen.t)], seen.strain, seen.q - seen.q_ref


def spread(t: FloatArray) -> dict[str, float]:
    """Judge the stamps of a topic."""
    step = np.diff(t)
    return {'rate': float(1.0 / np.median(step)), 'longest gap': float(step.max()),
            'lost': float(np.round(step / np.median(step) - 1.0).clip(0).sum() / len(t))}


def scenario(args: argparse.Namespace, user: Listener) -> dict[str, Any]:
    """Move, push, floor; give the figures."""
    user.hear('joint_states', 'joint_reference', 'strain_residuals')
    user.wait(lambda: all(user.raw[t] for t in ('joint_states', 'joint_reference',
                                                'strain_residuals')), 'the nodes')
    user.hear('joint_states', 'joint_reference', 'link_strains')
    user.let_pass(1.0)  # the damper finds its mean
    dropped = drops_of_monitor(user)
    begin = user.now()
    user.go(MOVE)
    user.let_pass(3.5)
    end = user.now()
    false = len(user.events['collision_event'])
    user.hear('joint_states', 'joint_reference', 'applied_wrench')
    contacts = {'push': react(user, 'push', lambda: user.push((0.0, 0.0, -args.force))),
                'floor': react(user, 'floor', lambda: lower(user))}
    return {'move': judge_move(user, begin, end, args.save), 'false_events': false,
            'damper': sorted({said.message for _, said in user.diagnoses('oscillation_damper')}),
            'dropped_by_monitor': drops_of_monitor(user) - dropped,
            'longest_gap_s': max(spread(stamps_of(user, topic))['longest gap']
                                 for topic in ('joint_states', 'joint_reference')),
            **{name: judge_contact(user, item) for name, item in contacts.items()}}


def stamps_of(user: Listener, topic: str) -> FloatArray:
    """Give all stamps of a topic [s]."""
    return user.series(topic, 'position', user.arm.active_joints)[0]


def drops_of_monitor(user: Listener) -> int:
    """Ask how many samples the monitor has lost."""
    values = {item.key: item.value for item in user.status('monitor').values}
    return int(values['dropped'])


def judge_move(user: Listener, begin: float, end: float, save: str | None) -> dict[str, Any]:
    """Compare the move with the loop in one process on the same reference."""
    joints, gauges = user.arm.active_joints, user.arm.gauge_names
    t_ref, q_ref = user.series('joint_reference', 'position', joints)
    _, dq_ref = user.series('joint_reference', 'velocity', joints)
    during = (t_ref > begin - 1.0) & (t_ref < end)
    t_ref, q_ref, dq_ref = t_ref[during], q_ref[during], dq_ref[during]
    ends = float(t_ref[np.abs(dq_ref).max(axis=1) > 1e-6][-1])
    t, strain = user.series('link_strains', 'position', gauges)
    tj, q = user.series('joint_states', 'position', joints)
    to, strain_o, error_o = offline(user.arm, t_ref, q_ref, dq_ref, 1)
    inside = (tj > t_ref[0]) & (tj < t_ref[-1])
    tj, q = tj[inside], q[inside]
    error = q - np.column_stack([np.interp(tj, t_ref, column) for column in q_ref.T])
    if save:
        np.savez(save, t=t, strain=strain, tj=tj, q=q, t_ref=t_ref, q_ref=q_ref, dq_ref=dq_ref,
                 to=to, strain_o=strain_o, ends=ends)
    return {
        'tracking_deg': float(np.degrees(np.abs(error).max())),
        'tracking_offline_deg': float(np.degrees(np.abs(error_o).max())),
        'off_goal_deg': float(np.degrees(np.abs(q[-1] - MOVE).max())),
        'stamps': {'joint_states': spread(tj), 'joint_reference': spread(t_ref)},
        'strain': {name: {'topics': settling(t, strain[:, i], ends, end),
                          'offline': settling(to, strain_o[:, i], ends, end)}
                   for i, name in enumerate(gauges)}}


def lower(user: Listener) -> None:
    """Put a floor under the tip and drive onto it."""
    user.configure('arm_simulator', obstacle=True, obstacle_height=0.6)
    user.go(np.radians([20.0, -20.0]))


def react(user: Listener, name: str, act: Callable[[], None]) -> dict[str, Any]:
    """Cause a collision and wait for what becomes of it."""
    events = user.events['collision_event']
    events.clear()
    begin = user.now()
    act()
    user.wait(lambda: bool(events) or user.now() > begin + 6.0, 'an event', 120.0)
    seen = {'begin': begin, 'event': events[0] if events else None, 'arrived': user.now()}
    user.let_pass(1.5 if name == 'push' else 3.3)
    if name == 'floor':  # late samples slow the retreat down
        user.wait(lambda: touches(user) < 0.01 or user.now() > begin + 20.0, 'the retreat', 120.0)
        user.let_pass(0.5)
    seen['end'] = user.now()
    seen['reaction'] = user.status('reference_generator').message
    if name == 'push':
        user.push((0.0, 0.0, 0.0))
        user.let_pass(1.0)
    user.reset('monitor')
    while not user.reset('reference_generator'):  # it may not know yet that the collision is over
        pass
    return seen


def touches(user: Listener) -> float:
    """Give the contact force that was applied last [N]."""
    force = user.newest('applied_wrench').wrench.force
    return float(np.linalg.norm([force.x, force.y, force.z]))


def judge_contact(user: Listener, seen: dict[str, Any]) -> dict[str, Any]:
    """Give what was found, when, and what the contact force did."""
    t, force = user.series('applied_wrench', 'force')
    during = (t > seen['begin']) & (t < seen['end'])
    t, size = t[during], np.linalg.norm(force[during], axis=1)
    event, touching = seen['event'], size > 0.01
    result: dict[str, Any] = {'found': event is not None and bool(touching.any()),
                              'largest_N': float(size.max()),
                              'at_the_end_N': float(size[-100:].max())}
    if not result['found']:  # no event, or one without contact
        return {**result, 'false': event is not None}
    touched, onset = float(t[touching][0]), nanoseconds(event.stamp) * 1e-9
    told = {item.key: item.value
            for array in user.events['/diagnostics'] for status in array.status
            if status.name.endswith(': collision') for item in status.values
            if any(v.value == str(nanoseconds(event.stamp)) for v in status.values)}
    t_ref, q_ref = user.series('joint_reference', 'position', user.arm.active_joints)
    t_ref, q_ref = t_ref[t_ref < seen['end']], q_ref[t_ref < seen['end']]
    reacting = q_ref[t_ref > seen['arrived']]
    pressing = t[touching]
    # diagnostics keep one message: on a busy machine the one with the event may be lost
    sure = (onset - touched + 1e-3 * float(told['certain after [ms]']) if told
            else seen['arrived'] - touched)
    return {**result, 'link': event.frame_id, 'onset_s': onset - touched,
            'sure_s': sure,
            'told_s': seen['arrived'] - touched,
            'let_go_s': float(pressing[-1]) - onset, 'reaction': seen['reaction'],
            'reference_moved_deg': float(np.degrees(np.ptp(reacting, axis=0).max()))}


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Start everything, and give the figures."""
    arm = load_arm(args.arm)
    rclpy.init()
    processes = Processes()
    simulated = args.factor != 1.0 or args.clock
    common: dict[str, Any] = {'use_sim_time': True} if simulated else {}
    user = Listener(arm)
    try:
        processes.start('arm_simulator', arm=args.arm, rate=args.rate, factor=args.factor,
                        clock=simulated, lockstep=simulated, payload=PAYLOAD, seed=1)
        processes.start('oscillation_damper', arm=args.arm, timeout=1.0, **common)
        processes.start('reference_generator', arm=args.arm, rate=args.rate,
                        reaction=args.reaction, **common)
        processes.start('monitor', model=args.model, methods=['strain'], **common)
        user.hear('joint_states')
        user.wait(lambda: bool(user.raw['joint_states']), 'the simulator')
        begun, cpu = time.monotonic(), processes.cpu()
        found = scenario(args, user)
        seconds = time.monotonic() - begun
        found['cpu'] = {name: (used - cpu[name]) / seconds
                        for name, used in processes.cpu().items()}
    finally:
        codes = processes.end()
        user.node.destroy_node()
        rclpy.shutdown()
    found['exit_codes'] = codes
    return found


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--arm', default='config/tudor.yaml', metavar='YAML')
    parser.add_argument('--model', help='bundle of the simulated arm; made here by default')
    parser.add_argument('--rate', type=float, default=500.0, help='of all topics [Hz]')
    parser.add_argument('--factor', type=float, default=1.0, help='speed of simulated time')
    parser.add_argument('--clock', action='store_true', help='simulated time at factor 1, too')
    parser.add_argument('--force', type=float, default=4.0, help='of the push [N]')
    parser.add_argument('--reaction', default='retreat', choices=('hold', 'retreat', 'comply'))
    parser.add_argument('--save', metavar='NPZ', help='signals of the move')
    parser.add_argument('--json', action='store_true')
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if args.model is None:
            args.model = make_model(args.arm, Path(folder))
        found = run(args)
    print(json.dumps(found, indent=None if args.json else 2))


if __name__ == '__main__':
    main()
