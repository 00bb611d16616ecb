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

"""What benches over topics share: nodes as processes, a listener among them, a model for them."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Sequence
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
import numpy as np
from numpy.typing import NDArray
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray, Header
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.nodes.common.base import latched
from tudor_dynamics.nodes.common.messages import (
    floats, JointStateDecoder, MotionDecoder, nanoseconds)
from tudor_dynamics.nodes.common.runner import new_executor, spin_for
from tudor_dynamics.typing import FloatArray

PAYLOAD = 0.2
"""Mass at the tip of the arm and of its model [kg]."""
DEEP = 5000
"""Queue of a listener that must not lose anything."""
HEARD = {'joint_states': JointState, 'link_strains': JointState, 'joint_reference': JointState,
         'strain_residuals': JointState, 'joint_motion': JointTrajectory,
         'applied_wrench': WrenchStamped, 'velocity_commands': Float64MultiArray}
EVENTS = {'collision': Bool, 'collision_event': Header, '/diagnostics': DiagnosticArray}


def usage(pid: int | str) -> tuple[float, float]:
    """CPU time [s] and resident memory [MB] of a process."""
    fields = Path(f'/proc/{pid}/stat').read_text().rsplit(')', 1)[1].split()
    pages = int(Path(f'/proc/{pid}/statm').read_text().split()[1])
    return ((int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK'),
            pages * os.sysconf('SC_PAGE_SIZE') / 1e6)


class Processes:
    """Nodes as processes, ended together."""

    def __init__(self) -> None:
        self.running: dict[str, subprocess.Popen] = {}
        self._server: subprocess.Popen | None = None

    def start(self, node: str, **values: Any) -> None:
        """Start a node with parameters."""
        words = [word for name, value in values.items()
                 for word in ('-p', f'{name}:={json.dumps(value)}')]
        self.running[node] = subprocess.Popen(
            [sys.executable, '-m', 'tudor_dynamics.nodes', node, '--ros-args', *words],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def serve_discovery(self, address: str, port: int = 11811) -> None:
        """Start the discovery server of Fast DDS; rclpy's wheels bring it and its libraries."""
        own = Path(sys.prefix) / 'bin' / 'fast-discovery-server'
        self._server = subprocess.Popen(
            [str(own) if own.exists() else own.name, '-i', '0', '-l', address, '-p', str(port)],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def signal(self, node: str, number: int) -> None:
        """Send a signal to a node."""
        self.running[node].send_signal(number)

    def cpu(self) -> dict[str, float]:
        """Give the CPU time of each [s]."""
        return {name: usage(process.pid)[0] for name, process in self.running.items()}

    def end(self) -> dict[str, int]:
        """Ask all to end; give their exit codes."""
        if self._server is not None:
            self._server.kill()
            self._server.wait()
        for process in self.running.values():
            process.send_signal(signal.SIGCONT)
            process.send_signal(signal.SIGINT)
        for process in self.running.values():
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        return {name: int(process.returncode) for name, process in self.running.items()}


class Track:
    """
    Stamps, arrivals and values of a topic, taken message by message.

    names: none for stamps alone.
    """

    def __init__(self, topic: str, names: Sequence[str] = ()) -> None:
        self.kind, self.names = HEARD[topic], list(names)
        self._decoder: Any = (JointStateDecoder if self.kind is JointState
                              else MotionDecoder)(Counter())
        self._stamp, self._arrival, self._values = array('q'), array('d'), array('d')
        self._elapsed = array('q')

    def take(self, data: bytes) -> None:
        """Take a message."""
        self._arrival.append(time.monotonic())
        if self.kind is Float64MultiArray:
            self._values.extend(deserialize_message(data, self.kind).data)
            return
        sample = self._decoder.decode(data)
        self._stamp.append(sample.stamp)
        if self.kind is JointTrajectory:
            self._elapsed.append(sample.elapsed)
        if self.names:
            self._values.extend(float(sample.position[sample.name.index(name)])
                                for name in self.names)

    def __len__(self) -> int:
        return len(self._arrival)

    @property
    def stamp(self) -> NDArray[np.int64]:
        """Stamps in the order of arrival [ns]."""
        return np.array(self._stamp, dtype=np.int64)

    @property
    def elapsed(self) -> NDArray[np.int64]:
        """Give the times since the filter began, of motions [ns]."""
        return np.array(self._elapsed, dtype=np.int64)

    @property
    def arrival(self) -> FloatArray:
        """Give the times of arrival on the steady clock [s]."""
        return np.array(self._arrival)

    @property
    def values(self) -> FloatArray:
        """Values, a row a message."""
        return np.array(self._values).reshape(len(self._arrival), -1)


class Listener:
    """Hears everything, undecoded, and acts as a user would."""

    def __init__(self, arm: Arm, name: str = 'user') -> None:
        self.arm = arm
        self.node = rclpy.create_node(name)
        self.executor = new_executor('events')
        self.executor.add_node(self.node)
        self.raw: dict[str, list[bytes]] = {topic: [] for topic in HEARD}
        self.events: dict[str, list[Any]] = {topic: [] for topic in EVENTS}
        self._resets: dict[str, Any] = {}
        self._ears: dict[str, Any] = {}
        for topic, kind in EVENTS.items():
            self.node.create_subscription(
                kind, topic, self.events[topic].append,
                latched() if topic == 'collision' else QoSProfile(depth=100))
        self.goals = self.node.create_publisher(JointTrajectory, 'joint_trajectory', 10)
        self.wrench = self.node.create_publisher(WrenchStamped, 'external_wrench', 10)

    def hear(self, *topics: str) -> None:
        """Hear these topics and no others: every message costs the machine under test."""
        for topic in set(self._ears) - set(topics):
            self.node.destroy_subscription(self._ears.pop(topic))
        for topic in set(topics) - set(self._ears):
            self._ears[topic] = self.node.create_subscription(
                HEARD[topic], topic, self.raw[topic].append, QoSProfile(depth=1000), raw=True)

    def track(self, topic: str, names: Sequence[str] = (), *, reliable: bool = True) -> Track:
        """Take a topic as it comes; with best effort as the nodes hear it."""
        track = Track(topic, names)
        kind = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        self.node.create_subscription(
            HEARD[topic], topic, track.take, QoSProfile(depth=DEEP, reliability=kind), raw=True)
        return track

    def spin(self, seconds: float) -> None:
        """Handle messages for a while."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            spin_for(self.executor, min(left, 0.2))

    def wait(self, done: Callable[[], bool], what: str, seconds: float = 180.0) -> None:
        """Handle messages until something is so."""
        end = time.monotonic() + seconds
        while not done():
            if time.monotonic() > end:
                raise SystemExit(f'{what}: not within {seconds:g} s')
            self.executor.spin_once(timeout_sec=0.02)

    def newest(self, topic: str = 'joint_states') -> Any:
        """Decode the newest message of a topic."""
        return deserialize_message(self.raw[topic][-1], HEARD[topic])

    def now(self) -> float:
        """Give the newest stamp of the arm [s]."""
        return nanoseconds(self.newest().header.stamp) * 1e-9

    def let_pass(self, seconds: float) -> None:
        """Let time of the arm pass [s]."""
        until = self.now() + seconds
        self.wait(lambda: self.now() >= until, 'time of the simulator', 60.0 * max(seconds, 1.0))

    def go(self, target: Sequence[float] | FloatArray) -> None:
        """Send a goal [rad]."""
        self.goals.publish(JointTrajectory(
            joint_names=list(self.arm.active_joints),
            points=[JointTrajectoryPoint(positions=floats(np.asarray(target, dtype=float)))]))

    def push(self, force: Sequence[float]) -> None:
        """Let a force act on the tip [N]."""
        message = WrenchStamped()
        message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = force
        self.wrench.publish(message)

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """Call a service."""
        client = self.node.create_client(kind, service)
        self.wait(client.service_is_ready, service)
        for _ in range(6):  # an answer is lost where the server does not know the reader yet
            future, asked = client.call_async(request), time.monotonic()
            self.wait(lambda: future.done() or time.monotonic() > asked + 10.0, service)
            if future.done():
                return future.result()
        raise SystemExit(f'{service}: no answer')

    def reset(self, node: str) -> bool:
        """Call ``~/reset`` of a node; say whether it was done."""
        return bool(self.call(Trigger, f'{node}/reset', Trigger.Request()).success)

    def ask_reset(self, node: str) -> bool:
        """Call ``~/reset`` of a node without waiting; False where it is not there."""
        if node not in self._resets:
            self._resets[node] = self.node.create_client(Trigger, f'{node}/reset')
        client = self._resets[node]
        if not client.service_is_ready():
            return False
        client.call_async(Trigger.Request())
        return True

    def configure(self, node: str, **values: Any) -> None:
        """Set parameters."""
        answer = self.call(SetParameters, f'{node}/set_parameters', SetParameters.Request(
            parameters=[Parameter(k, value=v).to_parameter_msg() for k, v in values.items()]))
        refused = [item.reason for item in answer.results if not item.successful]
        if refused:
            raise SystemExit(f'{node}: {refused}')

    def diagnoses(self, node: str, begin: int = 0) -> list[tuple[float, Any]]:
        """Give time [s] and status of what a node told, from a place in the events on."""
        return [(nanoseconds(told.header.stamp) * 1e-9, status)
                for told in self.events['/diagnostics'][begin:] for status in told.status
                if status.name.startswith(f'{node}: /')]

    def status(self, node: str) -> Any:
        """Wait for the next diagnosis of a node."""
        begin = len(self.events['/diagnostics'])
        self.wait(lambda: bool(self.diagnoses(node, begin)), f'a diagnosis of {node}')
        return self.diagnoses(node, begin)[-1][1]

    def series(self, topic: str, field: str, names: Sequence[str] = ()) -> tuple[
            FloatArray, FloatArray]:
        """Give stamps [s] and values of all that was heard on a topic."""
        messages = [deserialize_message(raw, HEARD[topic]) for raw in self.raw[topic]]
        t = np.array([nanoseconds(m.header.stamp) * 1e-9 for m in messages])
        if field == 'force':
            values = np.array([[getattr(m.wrench.force, x) for x in 'xyz'] for m in messages])
        else:
            index = [list(messages[0].name).index(name) for name in names]
            values = np.array([list(getattr(m, field)) for m in messages])[:, index]
        order = np.argsort(t, kind='stable')
        return t[order], values[order]


def make_model(arm_path: str, folder: Path) -> str:
    """Record the simulated arm, damped as it will be, and fit a model to it."""
    tudor = [sys.executable, '-m', 'tudor_dynamics']
    subprocess.run([*tudor, 'record', '--arm', arm_path, '--payload', str(PAYLOAD), '--stimuli',
                    '3', '--seconds', '60', '--jobs', '1', '--out', str(folder / 'bags')],
                   check=True, capture_output=True)
    subprocess.run([*tudor, 'fit', *(str(folder / f'bags/stimulus_0{k}') for k in (1, 2, 3)),
                    '--arm', arm_path, '--models', 'analytical', '--out', str(folder / 'model')],
                   check=True, capture_output=True)
    return str(folder / 'model')
