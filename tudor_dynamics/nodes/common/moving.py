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

"""Base of the managed nodes that answer positions of an arm with what moves it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from functools import partial
from itertools import islice
from operator import itemgetter
from typing import Any

import numpy as np
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.errors import TudorError
from tudor_dynamics.nodes.common.base import Figure, TudorNode, WARN
from tudor_dynamics.nodes.common.messages import NamedReader, nanoseconds
from tudor_dynamics.nodes.settings import VERDICT_LOOK
from tudor_dynamics.online.streams import StampGate
from tudor_dynamics.typing import FloatArray


class MovingNode(LifecycleNodeMixin, TudorNode):
    """A managed node, because it commands motion; ``**kwargs`` go to rclpy's Node."""

    FIGURES: tuple[Figure, ...] = (Figure('phase', lambda node: node.phase),)
    feels = False  # whether efforts are heard
    ending = ''  # what a node that was shut down says
    _own = 'the topic of positions'  # until the arm is known

    def __init__(self, name: str, gap: float, **kwargs: Any) -> None:
        TudorNode.__init__(self, name, **kwargs)
        LifecycleNodeMixin.__init__(self)
        self.controller: Any = None
        self.gate = StampGate(gap)  # longer between positions is an interruption
        self.active = False
        self.phase = 'unconfigured'
        self._inputs: list[Subscription] = []
        self._verdict_timer = self.every(VERDICT_LOOK, self.notice)

    def autostart(self) -> None:
        """Configure and activate where that is asked for; at the end of a constructor."""
        if self.value('autostart'):
            self.trigger_configure()
            if self.controller is not None:
                self.trigger_activate()

    def build(self) -> tuple[Arm, Collection[str]]:
        """Make the controller; give the arm, and the gauges that the controller needs."""
        raise NotImplementedError

    def subscribe_inputs(self) -> list[Subscription]:
        """Subscribe to all but positions and strains."""
        raise NotImplementedError

    def answer(self, controller: Any, message: JointState, dt: float, q: FloatArray) -> None:
        """Answer positions (joints,) [rad or m]; dt [s]: 0 where none before them count."""
        raise NotImplementedError

    def begin(self) -> None:
        """Get ready for the first positions after an activation."""
        self.gate.reset()

    def stop(self) -> None:
        """Do what a deactivation needs."""

    def stamped(self, stamp: int) -> None:
        """Take the stamp of usable positions into account [ns]."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the arm, subscribe."""
        try:
            arm, gauges = self.build()
        except TudorError as err:
            self.controller = None
            self.fail(err)
            return TransitionCallbackReturn.FAILURE
        self.fault, self.robot = '', arm.name
        self.apply()
        self._joints = NamedReader(arm.active_joints, self.drops)
        self._strain = np.full(len(arm.gauges), np.nan)
        self._read = np.full(len(arm.gauges), -np.inf)  # stamps of the strains [s]
        self._fresh = np.zeros(len(arm.gauges), dtype=bool)  # strains since the last answer
        self._effort = np.full(len(arm.active_joints), np.nan)
        self._gauges = self._sources(arm.topics['strain'], arm.gauge_names, gauges)
        self._motors = self._sources(
            arm.topics['effort'], arm.active_joints, arm.active_joints if self.feels else ())
        self._own = arm.spec.joint_topic
        self._inputs = [self.subscribe(JointState, self._own, self._on_joints),
                        *self.subscribe_inputs()]
        self._inputs += [self.subscribe(JointState, topic, partial(self._on_values, topic))
                         for topic in self._gauges | self._motors if topic != self._own]
        self.phase = 'inactive'
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to answer positions."""
        if self.controller is None:
            return TransitionCallbackReturn.FAILURE
        self.begin()
        self.active, self.phase = True, 'active'
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Answer no more."""
        self.stop()
        self.active, self.phase = False, 'inactive'
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the arm."""
        for item in self._inputs:
            self.destroy_subscription(item)
        self._inputs, self.controller, self.phase = [], None, 'unconfigured'
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Answer no more, for good."""
        self.active, self.phase = False, 'finalized'
        self.ended = self.ending
        self.publish_diagnostics()
        return TransitionCallbackReturn.SUCCESS

    def _sources(
        self, topics: dict[str, list[str]], names: Sequence[str], wanted: Collection[str],
    ) -> dict[str, tuple[NamedReader, list[int]]]:
        """Give a reader for each topic that carries something wanted, and where it belongs."""
        heard = {topic: [name for name in some if name in wanted]
                 for topic, some in topics.items()}
        return {topic: (NamedReader(some, self.drops), [names.index(name) for name in some])
                for topic, some in heard.items() if some}

    def _on_values(self, topic: str, message: JointState) -> None:
        if topic in self._gauges:
            reader, index = self._gauges[topic]
            values = reader.read(message, 'position')
            if values is not None:
                self._strain[index], self._fresh[index] = values, True
                self._read[index] = nanoseconds(message.header.stamp) * 1e-9
        if topic in self._motors:
            reader, index = self._motors[topic]
            values = reader.read(message, 'effort', optional=True)
            if values is not None:
                self._effort[index] = values

    def _on_joints(self, message: JointState) -> None:
        begun = self.meter.begin()
        if not self.active or self.controller is None:
            return
        usable, queue = [], self._inputs[0].handle
        with queue:  # of those that wait the newest counts
            later = [item[0] for item in islice(
                iter(lambda: queue.take_message(JointState, False), None), self.depth)]
        for waiting in (message, *later):
            q = self._joints.read(waiting, 'position')
            if q is None:
                continue
            if not np.isfinite(q).all():
                self.drops['not_finite'] += 1
                self.gate.unusable()
                continue
            self._on_values(self._own, waiting)
            usable.append((nanoseconds(waiting.header.stamp), waiting, q))
        for _ in usable[1:]:
            self.drops['overtaken'] += 1
            self.gate.unusable()
        if not usable:
            return
        stamp, message, q = max(usable, key=itemgetter(0))
        self.stamped(stamp)
        dt = self.gate.step(stamp)
        if dt is None:
            return
        self.answer(self.controller, message, dt, q)
        self._fresh[:] = False
        self.meter.end(begun)

    def counters(self) -> list[Counter[str]]:
        return [self.drops, self.gate.drops]

    def verdict(self) -> tuple[bytes, str]:
        """Say that a node that is not active moves nothing."""
        level, message = super().verdict()
        if self.controller is not None and not self.active:
            step = {'inactive': 'activate', 'unconfigured': 'configure'}.get(self.phase, '')
            return WARN, self.ended or f'the node is {self.phase}' + (
                f'; run `ros2 lifecycle set {self.get_name()} {step}`' if step else '')
        return level, message
