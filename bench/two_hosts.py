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
The closed loop over two hosts: a network that is cut, loses or delays, and what the arm does then.

Two network namespaces are two hosts; a process between them forwards their frames. The robot
(`arm_simulator`) lives on the first, reference and monitor on the second, the damper on either.
The arm moves before, during and after the disturbance. Commands and positions are those that the
robot hears and has; states are what the nodes told in their diagnostics, heard on their own host.
Nothing leaves this machine, and all of it is gone at the end. Without the right to make namespaces
there is one line that says so.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
import json
from pathlib import Path
import re
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
from typing import Any

from envelope import Envelope
from live_nodes import Listener, make_model, PAYLOAD, Processes
import numpy as np
import rclpy
from rclpy.signals import SignalHandlerOptions
from tables import show
from tudor_dynamics.arm.description import load_arm
from two_namespaces import ADDRESSES, Host, isolation, Line, Network

HOME, AWAY = np.radians([45.0, 0.0]), np.radians([90.0, -45.0])
SCENARIOS = {'cut 5 s': Line(cut=True), 'loss 5 %': Line(loss=0.05),
             'delay 20 ms': Line(delay=0.02), 'delay 60 ms': Line(delay=0.06)}
DISCOVERY = {'multicast': {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'},
             'peers': {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
                       'ROS_STATIC_PEERS': ';'.join(ADDRESSES)},
             'server': {'ROS_DISCOVERY_SERVER': f'{ADDRESSES[0]}:11811'}}
COMMON = {'ROS_DOMAIN_ID': '77', 'FASTDDS_BUILTIN_TRANSPORTS': 'UDPv4', 'OMP_NUM_THREADS': '1',
          'OPENBLAS_NUM_THREADS': '1'}
"""Without shared memory, which two namespaces of one machine would have in common."""
ROBOT, REMOTE = 0, 1
NEAR = np.radians(2.0)
"""So close to a goal the arm has reached it."""
PATIENCE = 20.0
"""Time for the arm to obey again [s]."""
LEVELS = ('OK', 'WARN', 'ERROR', 'STALE')
STATES = ('following', 'holding', 'fault')


class Inhabitant:
    """What lives on a host: nodes, and a user who hears and acts."""

    def __init__(self, arm: str, serve: bool, side: int) -> None:
        self.nodes = Processes()
        if serve and side == ROBOT:
            self.nodes.serve_discovery(ADDRESSES[side])
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self.arm = load_arm(arm)
        self.user = Listener(self.arm, f'user_{side}')
        joints = self.arm.active_joints
        self.tracks = {topic: self.user.track(topic, names, reliable=reliable)
                       for topic, names, reliable in (
                           ('joint_states', joints, side == ROBOT),
                           ('velocity_commands', (), False), ('strain_residuals', (), False))}

    def start(self, node: str, **values: Any) -> None:
        """Start a node."""
        self.nodes.start(node, **values)

    def spin(self, seconds: float) -> None:
        """Hear for a while."""
        self.user.spin(seconds)

    def go(self, target: Any) -> None:
        """Send a goal."""
        self.user.go(target)

    def heard(self, topic: str) -> int:
        """Count the messages of a topic."""
        return len(self.tracks[topic])

    def position(self) -> Any:
        """Give the newest positions [rad]."""
        return self.tracks['joint_states'].values[-1]

    def troubled(self) -> list[str]:
        """Name the nodes here that wait for ``~/reset``, as their newest diagnosis says."""
        told = {node: self.user.diagnoses(node)[-1:] for node in self.nodes.running}
        return [node for node, found in told.items() for _, status in found
                if 'reset' in status.message or state_of(status) == 'fault']

    def reset(self, node: str) -> None:
        """Reset a node."""
        self.user.reset(node)

    def told(self) -> dict[str, list[tuple[float, int, str, float | None]]]:
        """Give time, level, text and loop delay of what the nodes here told."""
        return {node: [(t, status.level[0], text_of(status), delay_of(status))
                       for t, status in self.user.diagnoses(node)]
                for node in self.nodes.running}

    def figures(self) -> dict[str, tuple[Any, Any, Any]]:
        """Give stamps, arrivals and values of what was heard."""
        return {topic: (track.stamp, track.arrival, track.values)
                for topic, track in self.tracks.items()}

    def close(self) -> None:
        """End the nodes."""
        self.nodes.end()
        self.user.node.destroy_node()
        rclpy.shutdown()


def state_of(status: Any) -> str:
    """Give the state that a diagnosis tells; empty for none."""
    state = {item.key: item.value for item in status.values}.get('state', '')
    return state if state in STATES else ''


def text_of(status: Any) -> str:
    """Give what a diagnosis tells: the state, and if not all is well the words, no numbers."""
    words = re.sub(r'[-\d.]*\d', '#', status.message)
    state = state_of(status)
    return words if not state else state if status.level[0] == 0 else f'{state}: {words}'


def delay_of(status: Any) -> float | None:
    """Give the loop delay that a diagnosis tells [ms]."""
    try:
        return float({item.key: item.value for item in status.values}['loop delay [ms]'])
    except (KeyError, ValueError):  # not of this node, or not known yet
        return None


def wait_for(done: Callable[[], bool], seconds: float) -> float | None:
    """Wait until something is so; give the time that it took, None for never [s]."""
    begin = time.monotonic()
    while time.monotonic() - begin < seconds:
        if done():
            return time.monotonic() - begin
        time.sleep(0.05)
    return None


def start(robot: Host, remote: Host, args: argparse.Namespace, local: bool) -> None:
    """Start the nodes and wait until commands and residuals flow."""
    robot.ask('start', 'arm_simulator', arm=args.arm, rate=args.rate, payload=PAYLOAD,
              seed=args.seed)
    (robot if local else remote).ask('start', 'oscillation_damper', arm=args.arm)
    remote.ask('start', 'reference_generator', arm=args.arm, rate=args.rate)
    remote.ask('start', 'monitor', model=args.model, methods=['strain'])
    for host, topic in ((robot, 'velocity_commands'), (remote, 'strain_residuals')):
        if wait_for(lambda: host.ask('heard', topic) > 100, 60.0) is None:
            raise SystemExit(f'no {topic}: the hosts do not find each other, or a node ended')
    time.sleep(2.0)


def disturb(net: Network, line: Line, rest: float) -> dict[str, float]:
    """Move, disturb the network during a move, and end the disturbance; give the times."""
    _, remote = net.hosts
    remote.ask('go', AWAY)
    time.sleep(3.0)
    remote.ask('go', HOME)
    time.sleep(0.5)
    times = {'begin': time.monotonic(), 'begin_told': time.time()}
    net.set(line)
    time.sleep(2.5)
    remote.ask('go', AWAY)
    time.sleep(2.5)
    if not line.cut:
        time.sleep(rest)
    net.set(Line())
    times['end'], times['end_told'] = time.monotonic(), time.time()
    return times


def obey(net: Network) -> tuple[float | None, list[str]]:
    """Send goals until the arm obeys; give the time it took and who needed ``~/reset``."""
    robot, remote = net.hosts
    begin, reset = time.monotonic(), []
    while time.monotonic() - begin < PATIENCE:
        for host in net.hosts:
            for node in host.ask('troubled'):
                host.ask('reset', node)
                reset.append(node)
        remote.ask('go', HOME)
        if wait_for(lambda: np.abs(robot.ask('position') - HOME).max() < NEAR, 3.0) is not None:
            return time.monotonic() - begin, sorted(set(reset))
    return None, sorted(set(reset))


def run(args: argparse.Namespace, name: str, local: bool) -> dict[str, Any]:
    """Run a scenario and give its figures."""
    settings = {**COMMON, **DISCOVERY[args.discovery]}
    make = partial(Inhabitant, args.arm, args.discovery == 'server')
    with Network(make, settings, args.seed) as net:
        robot, remote = net.hosts
        start(robot, remote, args, local)
        times = disturb(net, SCENARIOS[name], args.rest)
        obeyed, reset = obey(net)
        time.sleep(2.0)
        told = {**robot.ask('told'), **remote.ask('told')}
        seen, far = robot.ask('figures'), remote.ask('figures')
    return {'damper': 'robot' if local else 'remote', 'scenario': name,
            **judge(args, times, seen, far), 'obeys_s': obeyed, 'reset': reset,
            **judge_told(times, told)}


def judge(args: argparse.Namespace, times: dict[str, float], seen: Any, far: Any,
          ) -> dict[str, Any]:
    """Judge samples, commands and positions."""
    envelope, period = Envelope.of(load_arm(args.arm)), 1.0 / args.rate
    stamp, sent, q = seen['joint_states']
    during = stamp[(sent > times['begin']) & (sent < times['end'])]
    lost = 1.0 - np.isin(during, far['joint_states'][0]).mean()
    _, arrival, command = seen['velocity_commands']
    size, _ = envelope.steps(command, arrival, period)
    gaps = np.flatnonzero(np.diff(arrival) > 0.1)
    again = [arrival[k + 1] for k in gaps if arrival[k + 1] > times['end']]
    late = (arrival > times['end'] - 1.0) & (arrival < times['end'])
    return {
        'lost_percent': 100.0 * float(lost),
        'longest_silence_s': float(np.diff(arrival).max()),
        'commands_back_s': float(max(again, default=times['end']) - times['end']),
        'largest_command_deg_s': float(np.degrees(np.abs(command).max())),
        'command_of_limit': envelope.speed(command),
        'largest_step_deg_s': float(np.degrees(size.max())),
        'step_of_limit': envelope.step(command, arrival, period),
        'rest_command_deg_s': float(np.degrees(np.abs(command[late]).max())) if late.any()
        else None,
        'outside_deg': float(np.degrees(envelope.excursion(q))),
        'within_limits': envelope.excursion(q) == 0.0}


def judge_told(times: dict[str, float], told: dict[str, Any]) -> dict[str, Any]:
    """Give the sequence of states of each node, and when all were well again."""
    states: dict[str, list[str]] = {}
    well: float | None = 0.0
    for node, found in told.items():
        texts = [f'{LEVELS[level]} {text}' for t, level, text, _ in found
                 if t > times['begin_told'] - 1.0]
        states[node] = [text for k, text in enumerate(texts) if k == 0 or text != texts[k - 1]]
        bad = [t for t, level, _, _ in found if level]
        good = [t for t, _, _, _ in found if t > max(bad, default=0.0)]
        well = max(well, good[0] - times['end_told']) if good and well is not None else None
    delays = [delay for found in told.values() for *_, delay in found if delay is not None]
    return {'all_ok_s': well, 'states': states, 'loop_delay_ms': max(delays, default=None)}


def table(results: list[dict[str, Any]]) -> str:
    """Give the figures in 80 columns."""
    lines = ['damper scenario      lost  back obeys all OK  command     step    rest  outside',
             '                        %     s     s      s    deg/s    deg/s   deg/s      deg']
    for x in results:
        rest, obeys, well = ('-' if x[key] is None else f'{x[key]:.1f}' for key in (
            'rest_command_deg_s', 'obeys_s', 'all_ok_s'))
        lines.append(
            f'{x["damper"]:6s} {x["scenario"]:12s} {x["lost_percent"]:5.1f} '
            f'{x["commands_back_s"]:5.2f} {obeys:>5s} {well:>6s} '
            f'{x["largest_command_deg_s"]:8.1f} {x["largest_step_deg_s"]:8.2f} {rest:>7s} '
            f'{x["outside_deg"]:6.1f} {"ok" if x["within_limits"] else "!"}')
    for x in results:
        lines += ['', f'damper {x["damper"]}, {x["scenario"]}: largest command '
                  f'{x["command_of_limit"]:.2f}, step {x["step_of_limit"]:.2f} of its limit,',
                  f'  longest silence of commands {x["longest_silence_s"]:.2f} s',
                  f'  needed ~/reset: {", ".join(x["reset"]) or "none"}']
        lines += [textwrap.fill(f'{node}: {" > ".join(states)}', 78, initial_indent='  ',
                                subsequent_indent='      ')
                  for node, states in x['states'].items()]
    return '\n'.join(lines)


def inside(args: argparse.Namespace) -> int:
    """Run all scenarios, in namespaces that are this bench's own."""
    results = []
    with tempfile.TemporaryDirectory() as folder:
        if args.model is None:
            args.model = make_model(args.arm, Path(folder))
        for local in {'robot': (True,), 'remote': (False,), 'both': (False, True)}[args.damper]:
            for name in SCENARIOS:
                if args.only in name:
                    print(f'damper {"on the robot" if local else "remote"}, {name} ...',
                          file=sys.stderr)
                    results.append(run(args, name, local))
    print(json.dumps(results) if args.json else table(results))
    if not args.json:
        show(('damper', 'line', 'samples lost', 'obeys again after', 'all OK after',
              'largest command', 'largest step', 'at rest, deg/s', 'outside limits'),
             [('on the robot' if x['damper'] == 'robot' else x['damper'], x['scenario'],
               f'{x["lost_percent"]:.1f} %', 'never' if x['obeys_s'] is None else
               f'{x["obeys_s"]:.1f} s', 'never' if x['all_ok_s'] is None else
               f'{x["all_ok_s"]:.1f} s', f'{x["largest_command_deg_s"]:.0f} deg/s',
               f'{x["largest_step_deg_s"]:.1f} deg/s', '' if x['rest_command_deg_s'] is None else
               f'{x["rest_command_deg_s"]:.1f}', f'{x["outside_deg"]:.1f} deg') for x in results])
    return 0


def main() -> int:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--arm', default='config/tudor.yaml', metavar='YAML')
    parser.add_argument('--model', help='bundle of the simulated arm; made here by default')
    parser.add_argument('--rate', type=float, default=250.0, help='of all topics [Hz]')
    parser.add_argument('--seed', type=int, default=1, help='of noise and losses')
    parser.add_argument('--rest', type=float, default=5.0,
                        help='time after the last move of a disturbance [s]')
    parser.add_argument('--damper', choices=('robot', 'remote', 'both'), default='both',
                        help='on which host it runs')
    parser.add_argument('--discovery', choices=DISCOVERY, default='multicast')
    parser.add_argument('--only', default='', help='scenarios whose name holds this')
    parser.add_argument('--json', action='store_true')
    parser.add_argument('--inside', action='store_true', help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.inside:
        try:
            return inside(args)
        except KeyboardInterrupt:
            return 130
    words, why = isolation()
    if not words:
        print(f'two_hosts.py skipped: {why}')
        return 0
    process = subprocess.Popen([*words, sys.executable, *sys.argv, '--inside'])
    # who is killed with the first process of a namespace of processes: all others in it
    signal.signal(signal.SIGTERM, lambda *_: process.kill())
    try:
        code = process.wait()
        return code if code >= 0 else 128 - code
    except KeyboardInterrupt:  # those inside have got it, too, and end their nodes
        try:
            process.wait(30.0)
        except subprocess.TimeoutExpired:
            process.kill()
        return 130


if __name__ == '__main__':
    sys.exit(main())
