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
A soak: all nodes for minutes, killed, stopped and started at random, and what must hold meanwhile.

Robot, damper, reference, monitor and recorder run as processes while a user sends goals. At random
times one of them is killed (SIGKILL), asked to end (SIGTERM) or stopped for up to 3 s
(SIGSTOP, SIGCONT), and started again. In turns each is left alive for a fifth of the time, so that
its memory can be judged. At the end a table says what held and what did not; exit code 1 if
anything did not.

Queues are deeper than shipped, so that the nodes are judged and not the scheduler of a busy
machine.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import random
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any
import warnings

from live_nodes import Listener, make_model, PAYLOAD, Processes, Track, usage
import numpy as np
import rclpy
from rclpy.signals import SignalHandlerOptions
from soak_checks import Life, Line, Observed, verdict

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.errors import TudorWarning
from tudor_dynamics.models.bundle import load_bundle
from tudor_dynamics.signals.motion_profile import joint_range

NODES = ('arm_simulator', 'oscillation_damper', 'reference_generator', 'monitor', 'bag_recorder')
RECORDED = ('joint_states', 'link_strains', 'velocity_commands', 'joint_reference')
DEPTH, HISTORY = 1000, 100
"""Of subscriptions and publishers; what a publisher keeps for stopped readers is its memory."""
LONGEST_PAUSE = 3.0
"""Of a stopped process [s]."""
GOALS = 4.0
"""Time between two goals [s]."""
LOOK = 0.1
"""Period of everything that is looked at [s]."""
WEIGH = 2.0
"""Time between two looks at the memory [s]."""


def queues(publish: tuple[str, ...], hear: tuple[str, ...] = ()) -> dict[str, int]:
    """Parameters that make queues deeper."""
    return {f'qos_overrides./{topic}.{kind}.depth': depth
            for kind, depth, topics in (('publisher', HISTORY, publish),
                                        ('subscription', DEPTH, hear)) for topic in topics}


class Chaos:
    """Kills, stops and starts nodes at random; remembers their lives."""

    def __init__(self, args: argparse.Namespace, folder: Path) -> None:
        self.args, self.folder = args, folder
        self.processes = Processes()
        self.lives: list[Life] = []
        self.current: dict[str, Life] = {}
        self.counts = dict.fromkeys(('SIGKILL', 'SIGTERM', 'SIGSTOP'), 0)
        self.over = False
        self._random = random.Random(args.seed)
        self._due: list[tuple[float, str, str]] = []
        self.begin()

    def begin(self) -> None:
        """Count the time from now on."""
        self.begun = self._next = self._weighed = time.monotonic()

    def parameters(self, node: str) -> dict[str, Any]:
        """Give the parameters of a node."""
        arm, rate = self.args.arm, self.args.rate
        return {
            'arm_simulator': {'arm': arm, 'rate': rate, 'payload': PAYLOAD,
                              'seed': self.args.seed,
                              **queues(('joint_states', 'link_strains'))},
            'oscillation_damper': {'arm': arm, **queues(('velocity_commands',))},
            'reference_generator': {'arm': arm, 'rate': rate,
                                    **queues(('joint_reference',))},
            'monitor': {'model': self.args.model, 'methods': ['strain'],
                        **queues(('joint_motion', 'strain_residuals'),
                                 ('joint_states', 'link_strains'))},
            'bag_recorder': {'bag': str(self.folder / f'bag_{len(self.lives)}'),
                             'topics': list(RECORDED)}}[node]

    def start(self, node: str) -> None:
        """Start a node."""
        values = self.parameters(node)
        self.processes.start(node, **values)
        self.current[node] = Life(node, time.monotonic(), bag=values.get('bag', ''))
        self.lives.append(self.current[node])

    def immune(self) -> str:
        """Name the node whose turn it is to live."""
        share = (time.monotonic() - self.begun) / (60.0 * self.args.minutes)
        return NODES[min(int(share * len(NODES)), len(NODES) - 1)]

    def step(self) -> None:
        """Do what is due."""
        now = time.monotonic()
        for item in [item for item in self._due if item[0] <= now]:
            self._due.remove(item)
            self._do(item[1], item[2])
        for node, life in self.current.items():
            self._bury(node, life)
        if now - self._weighed > WEIGH:
            self._weighed = now
            for node, life in self.current.items():
                if life.ended is None:
                    life.memory.append((now, usage(self.processes.running[node].pid)[1]))
        if now >= self._next:
            self._next = now + self._random.expovariate(1.0 / self.args.every)
            self._strike(now)

    def _bury(self, node: str, life: Life) -> None:
        if life.code is None:
            life.code = self.processes.running[node].poll()
            if life.code is None:
                return
            life.asked = life.ended is not None
            if life.ended is None:
                life.ended = time.monotonic()
            if not self.over:
                again = time.monotonic() + self._random.uniform(0.0, 2.0)
                self._due.append((again, 'start', node))

    def _strike(self, now: float) -> None:
        node = self._random.choice(NODES)
        kind = self._random.choice(('SIGKILL', 'SIGTERM', 'SIGSTOP'))
        life = self.current[node]
        if life.ended is not None or life.paused(now) or (
                kind != 'SIGSTOP' and node == self.immune()):
            return
        self._do(kind, node)

    def _do(self, what: str, node: str) -> None:
        now, life = time.monotonic(), self.current[node]
        if what == 'start':
            self.start(node)
            return
        if life.code is not None:
            return
        self.processes.signal(node, getattr(signal, what))
        if what == 'SIGSTOP':
            pause = self._random.uniform(0.1, LONGEST_PAUSE)
            life.pauses.append((now, now + pause))
            self._due.append((now + pause, 'SIGCONT', node))
        elif what != 'SIGCONT':
            life.ended, life.by = now, what
        if what in self.counts:
            self.counts[what] += 1

    def finish(self) -> None:
        """Ask all that live to end."""
        self.over = True
        for node, life in self.current.items():
            if life.ended is None:
                life.ended, life.by = time.monotonic(), 'SIGTERM'
                self.processes.signal(node, signal.SIGCONT)
                self.processes.signal(node, signal.SIGTERM)
        for node, life in self.current.items():
            try:
                self.processes.running[node].wait(20)
            except subprocess.TimeoutExpired:
                self.processes.signal(node, signal.SIGKILL)
                self.processes.running[node].wait()
            self._bury(node, life)


class User:
    """Sends goals, resets what asks for it, and takes down what goes on."""

    def __init__(self, args: argparse.Namespace) -> None:
        self.arm = load_arm(args.arm)
        self.listener = Listener(self.arm, 'soak_user')
        names = self.arm.active_joints
        self.tracks: dict[str, Track] = {
            topic: self.listener.track(topic, names if topic == 'joint_states' else ())
            for topic in (*RECORDED, 'joint_motion', 'strain_residuals')}
        self._random = np.random.default_rng(args.seed)
        self._range = joint_range(self.arm)
        self._goal = self._look = time.monotonic()
        self.resets = 0

    def step(self) -> None:
        """Do what is due."""
        self.listener.spin(LOOK)
        now = time.monotonic()
        if now - self._goal > GOALS:
            self._goal = now
            share = self._random.uniform(0.1, 0.9, len(self.arm.active_joints))
            low, high = self._range.lower, self._range.upper
            self.listener.go(low + share * (high - low))
        if now - self._look > 2.0:
            self._look = now
            for node in ('oscillation_damper', 'reference_generator', 'monitor'):
                found = self.listener.diagnoses(node, -40)
                if found and self._asks(found[-1]):
                    self.resets += self.listener.ask_reset(node)

    @staticmethod
    def _asks(told: tuple[float, Any]) -> bool:
        """Say whether a fresh diagnosis asks for a reset."""
        stamp, status = told
        state = {item.key: item.value for item in status.values}.get('state', '')
        return time.time() - stamp < 1.5 and (state == 'fault' or '/reset' in status.message)


def soak(args: argparse.Namespace, folder: Path) -> tuple[list[Line], dict[str, Any]]:
    """Run and judge."""
    # an interrupt must not end the context before the nodes have ended
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    chaos, user = Chaos(args, folder), User(args)
    try:
        for node in NODES:
            chaos.start(node)
        user.listener.wait(lambda: all(len(track) for track in user.tracks.values()), 'the nodes')
        chaos.begin()
        while time.monotonic() - chaos.begun < 60.0 * args.minutes:
            user.step()
            chaos.step()
        chaos.finish()
        user.listener.spin(1.0)
        observed = Observed(
            user.arm, 1.0 / args.rate, load_bundle(args.model).preprocessing.settle, user.tracks,
            chaos.lives, user.listener.diagnoses('monitor'),
            min(60.0, 60.0 * args.minutes / len(NODES) / 3.0))
        return verdict(observed), {**chaos.counts, 'resets': user.resets, 'seed': args.seed,
                                   'minutes': args.minutes, 'rate': args.rate}
    finally:
        chaos.processes.end()
        user.listener.node.destroy_node()
        rclpy.shutdown()


def main() -> int:
    """Print the table; 1 if anything did not hold."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--minutes', type=float, default=15.0)
    parser.add_argument('--rate', type=float, default=500.0, help='of all topics [Hz]')
    parser.add_argument('--seed', type=int, default=1, help='of kills, goals and noise')
    parser.add_argument('--every', type=float, default=6.0, help='mean time between kills [s]')
    parser.add_argument('--arm', default='config/tudor.yaml', metavar='YAML')
    parser.add_argument('--model', help='bundle of the simulated arm; made here by default')
    parser.add_argument('--json', action='store_true')
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        warnings.simplefilter('ignore', TudorWarning)  # of bags that killed recorders left
        try:
            if args.model is None:
                args.model = make_model(args.arm, Path(folder))
            lines, done = soak(args, Path(folder))
        except KeyboardInterrupt:
            return 130
    if args.json:
        print(json.dumps({**done, 'lines': [line.__dict__ for line in lines]}))
    else:
        print(f'{args.minutes:g} min at {args.rate:g} Hz, seed {args.seed}: '
              f'{done["SIGKILL"]} SIGKILL, {done["SIGTERM"]} SIGTERM, {done["SIGSTOP"]} SIGSTOP; '
              f'{done["resets"]} resets')
        print('\n'.join(line.text() for line in lines))
    return 0 if all(line.held for line in lines) else 1


if __name__ == '__main__':
    sys.exit(main())
