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

"""A private ROS context for each test, a model of the sample bags, and a feeder in lock-step."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import gc
from pathlib import Path
import time
from typing import Any

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402, I100
from patience import PATIENCE  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import qos_check_compatible, QoSCompatibility, QoSProfile  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from tudor_dynamics.arm.description import load_arm  # noqa: E402
from tudor_dynamics.bags.reader import read_recording  # noqa: E402
from tudor_dynamics.bags.recording import Recording  # noqa: E402
from tudor_dynamics.nodes.common.messages import floats, nanoseconds, time_message  # noqa: E402
from tudor_dynamics.nodes.common.runner import new_executor  # noqa: E402

ANSWER = 10.0
"""How long a service is waited for before it is called again [s]."""
JOINTS, GAUGES = ['joint2', 'joint3'], ['link2_hub', 'link3_hub']


def overrides(**values: Any) -> list[Parameter]:
    """Parameters of a node."""
    return [Parameter(name, value=value) for name, value in values.items()]


class Hand:
    """A steady clock that a test turns by hand [s]."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        """Tell the time."""
        return self.now


class World:
    """Nodes on one executor, with publishers of the sensors and ears on any topic."""

    def __init__(self, kind: str = 'events') -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.executor = new_executor(kind, self.context)
        self.nodes: list[Any] = []
        self.probe = rclpy.create_node('probe', context=self.context)
        self.executor.add_node(self.probe)
        self.heard: dict[str, list[Any]] = {}
        self.outputs: dict[str, Any] = {}
        self.listen('/diagnostics', DiagnosticArray)

    def add(self, factory: Callable[..., Any], **values: Any) -> Any:
        """Start a node."""
        node = factory(context=self.context, parameter_overrides=overrides(**values))
        self.nodes.append(node)
        self.executor.add_node(node)
        return node

    def end(self, node: Any) -> None:
        """End a node as its process would."""
        self.executor.remove_node(node)
        self.nodes.remove(node)
        node.close()
        node.destroy_node()

    def listen(self, topic: str, kind: Any = JointState, qos: Any = None) -> list[Any]:
        """Collect the messages of a topic."""
        sink = self.heard.setdefault(topic, [])
        self.probe.create_subscription(kind, topic, sink.append, qos or QoSProfile(depth=1000))
        return sink

    def output(self, topic: str, kind: Any = JointState) -> Any:
        """Give a publisher of the probe."""
        if topic not in self.outputs:
            self.outputs[topic] = self.probe.create_publisher(kind, topic, QoSProfile(depth=1000))
        return self.outputs[topic]

    def spin(self, until: Callable[[], bool], seconds: float = PATIENCE) -> bool:
        """Spin until something is true."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if until():
                return True
            self.executor.spin_once(timeout_sec=0.02)
        return until()

    def call(self, kind: Any, service: str, request: Any | None = None) -> Any:
        """
        Call a service of another node; give its answer.

        An answer is lost where the server does not know the client's reader yet, although the
        service is ready for the client: then it is asked again.
        """
        client = self.probe.create_client(kind, service)
        assert self.spin(client.service_is_ready), f'{service} is not there'
        for _ in range(round(PATIENCE / ANSWER)):
            future = client.call_async(request or kind.Request())
            if self.spin(future.done, ANSWER):
                self.probe.destroy_client(client)
                return future.result()
        raise AssertionError(f'{service} does not answer')

    def rest(self, seconds: float) -> None:
        """Spin for a while."""
        self.spin(lambda: False, seconds)

    def meet(self, *topics: str) -> None:
        """Wait until somebody hears the probe on these topics, and all that can meet has met."""
        assert self.spin(lambda: all(
            self.output(topic).get_subscription_count() for topic in topics))
        assert self.spin(self._matched())
        self.rest(0.05)

    def _matched(self) -> Callable[[], bool]:
        """
        Say when writers and readers of the nodes here know of each other.

        Each side learns of the other by itself, and a reader takes nothing from a writer that it
        does not know.
        """
        nodes = [self.probe, *self.nodes]
        writers = [item for node in nodes for item in node.publishers]
        readers = [item for node in nodes for item in node.subscriptions]
        pairs = [(writer, reader) for writer in writers for reader in readers
                 if writer.topic_name == reader.topic_name and qos_check_compatible(
                     writer.qos_profile, reader.qos_profile)[0] != QoSCompatibility.ERROR]
        wanted = [(w.get_subscription_count, sum(w is a for a, _ in pairs)) for w in writers]
        wanted += [(r.get_publisher_count, sum(r is b for _, b in pairs)) for r in readers]
        return lambda: all(count() >= number for count, number in wanted)

    def wait(self, topic: str, count: int) -> int:
        """Wait for so many messages on a topic, and a moment more; give how many came."""
        self.spin(lambda: len(self.heard[topic]) >= count)
        self.rest(0.1)
        return len(self.heard[topic])

    def status(self, node: str, wanted: Callable[[Any], bool] = lambda _: True) -> Any:
        """Wait for the next diagnosis of a node; of the queued ones, for one that is wanted."""
        heard = self.heard['/diagnostics']
        heard.clear()

        def found() -> list[Any]:
            return [s for array in heard for s in array.status
                    if s.name.startswith(f'{node}: /') and wanted(s)]
        assert self.spin(lambda: bool(found())), f'no such diagnosis of {node}'
        return found()[-1]

    def close(self) -> None:
        """End everything."""
        for node in list(self.nodes):
            self.end(node)
        self.executor.shutdown()
        self.probe.destroy_node()
        rclpy.shutdown(context=self.context)
        gc.collect()
        gc.freeze()  # what is left stays, and need not be looked at after the next test


def values_of(status: Any) -> dict[str, str]:
    """Key to value of a diagnosis."""
    return {item.key: item.value for item in status.values}


def node_class(name: str) -> type:
    """Give the class of a node."""
    module = __import__(f'tudor_dynamics.nodes.{name}', fromlist=['x'])
    return getattr(module, ''.join(part.title() for part in name.split('_')) + 'Node')


def joint_message(stamp: int, names: list[str], **fields: np.ndarray) -> JointState:
    """Make a JointState."""
    message = JointState(name=names)
    message.header.stamp = time_message(stamp)
    for name, values in fields.items():
        setattr(message, name, floats(np.asarray(values, dtype=float)))
    return message


def series(messages: list[Any], field: str) -> tuple[np.ndarray, np.ndarray]:
    """Stamps and values of heard JointStates."""
    return (np.array([nanoseconds(m.header.stamp) for m in messages]),
            np.array([list(getattr(m, field)) for m in messages]))


def feed(
    world: World, recording: Recording, progress: Callable[[], int], *, first: int = 0,
    last: int | None = None, change: Callable[[int, dict[str, JointState]], None] | None = None,
    batch: int = 4, pace: float = 0.0, gauges: list[str] = GAUGES,  # noqa: B006
) -> None:
    """Publish a recording, never more samples ahead of ``progress`` than queues can hold."""
    last = len(recording.stamp) if last is None else last
    for k in range(first, last):
        s = int(recording.stamp[k])
        messages = {'joint_states': joint_message(s, JOINTS, position=recording.q[k])}
        if recording.dq is not None:
            messages['joint_states'].velocity = floats(recording.dq[k])
        if recording.effort is not None:
            messages['motor_currents'] = joint_message(s, JOINTS, effort=recording.effort[k])
        if recording.strain is not None:
            messages['link_strains'] = joint_message(s, gauges, position=recording.strain[k])
        if change is not None:
            change(k, messages)
        for topic, message in messages.items():
            world.output(topic).publish(message)
        if pace:
            world.rest(pace)
        elif (k - first) % batch == batch - 1:
            done = k - first + 1
            assert world.spin(lambda: progress() >= done), (  # noqa: B023
                f'stuck at sample {k}: {progress()} of {done}')


@pytest.fixture
def world() -> Iterator[World]:
    """Make a private world."""
    made = World()
    yield made
    made.close()


@pytest.fixture(scope='session')
def model(two_blades: Path) -> Path:
    """Model of the sample bags."""
    return two_blades


@pytest.fixture(scope='session')
def recording(root: Path) -> Recording:
    """Sample bag that the model has not seen."""
    arm = load_arm(root / 'config/two_blade_arm.yaml')
    return read_recording(root / 'bags/two_blade_test', arm)
