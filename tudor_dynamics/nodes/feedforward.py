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

"""Node feedforward: the efforts that wanted motions need, for controllers that take them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import TudorError
from tudor_dynamics.load.live import CarriedLoad
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.nodes.common.base import Figure, OK, strong, WARN
from tudor_dynamics.nodes.common.interfaces import (
    STATES_WITH_EFFORT, TRAJECTORY_WITH_EFFORT, WANTED_STATES, WANTED_TRAJECTORY)
from tudor_dynamics.nodes.common.messages import (
    floats, joint_state, JointSample, NamedReader, time_message, trajectory_of)
from tudor_dynamics.nodes.common.model_node import ModelNode
from tudor_dynamics.nodes.settings import DEPTH
from tudor_dynamics.online.feedforward import Feedforward


class FeedforwardNode(ModelNode):
    """Feed-forward node; ``**kwargs`` go to rclpy's Node."""

    depth = DEPTH  # an old command is of no use
    FIGURES: tuple[Figure, ...] = (
        Figure('kind', lambda node: node.ahead and node.value('kind')),
        Figure('unit', lambda ahead: ', '.join(ahead.units), 'ahead'),
        Figure('positions', lambda node: node.ahead and node.value('positions')))

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('feedforward', **kwargs)
        self.ahead: Feedforward | None = None
        self._refused = ''
        self._trajectories = self.publish_on(JointTrajectory, TRAJECTORY_WITH_EFFORT)
        self._states = self.publish_on(JointState, STATES_WITH_EFFORT)
        self.start()
        # as the controller listens: a command is not to be lost
        self._wanted = self.subscribe(
            JointTrajectory, WANTED_TRAJECTORY, self._on_trajectory, qos=strong())
        self._single = self.hear(WANTED_STATES, self._on_state)

    def choose(self, loaded: ModelBundle) -> ModelBundle:
        """Take the models as they were fitted: a wanted motion passes no filter."""
        return loaded

    def prepare(
        self, bundle: ModelBundle, whole: ModelBundle, load: CarriedLoad | None,
    ) -> Feedforward:
        """Build the feed-forward, and let it work once."""
        ahead = Feedforward(
            whole, kind=self.value('kind'), unit=self.value('unit'),
            positions=self.value('positions'),
            friction_at_rest=self.value('friction_at_rest'),
            payload=None if whole.payload_range is None else self.payload)
        rest = np.zeros((2, len(ahead.joints)))
        ahead.along(Trajectory(ahead.joints, np.array([0.0, 1.0]), rest, rest))
        return ahead

    def use(self, bundle: ModelBundle, prepared: Feedforward) -> None:
        self.bundle, self.ahead = bundle, prepared
        self._reader = NamedReader(self.ahead.joints, self.drops)

    def _along(self, read: Callable[[], Trajectory]) -> Trajectory | None:
        """Give a wanted motion its efforts, by the load as it is known; None if it is refused."""
        assert self.ahead is not None
        try:
            wanted, load = read(), self.port.load
            if load is not None and load.mass != self.ahead.payload:
                self.ahead.carry(load.mass)
            found = self.ahead.along(wanted)
        except TudorError as err:
            self.drops['impossible_command'] += 1
            if str(err) != self._refused:
                self.get_logger().error(f'motion refused: {err}')
            self._refused = str(err)
            return None
        self._refused = ''
        return found

    def _on_trajectory(self, message: JointTrajectory) -> None:
        begun = self.meter.begin()
        if self.ahead is None:
            return
        if message.points:  # without any it asks controllers to stop, and goes through
            found = self._along(partial(trajectory_of, message))
            if found is None:
                return
            for k, point in enumerate(message.points):
                assert found.effort is not None
                point.effort = floats(found.effort[k])
                if self.value('positions') == 'motor':
                    assert found.dq is not None and found.ddq is not None
                    point.positions = floats(found.q[k])
                    point.velocities = floats(found.dq[k])
                    point.accelerations = floats(found.ddq[k])
        self._trajectories.publish(message)
        self.meter.end(begun)

    def _on_state(self, message: JointSample) -> None:
        begun = self.meter.begin()
        if self.ahead is None:
            return
        q = self._reader.read(message, 'position')
        dq = self._reader.read(message, 'velocity', optional=True)
        if q is None or not np.isfinite(q).all() or (dq is not None and not np.isfinite(dq).all()):
            self.drops['not_finite'] += q is not None
            return
        found = self._along(partial(Trajectory, self.ahead.joints, np.zeros(1), q[None],
                                    None if dq is None else dq[None]))
        if found is None or found.effort is None:
            return
        stamp = message.stamp
        self._states.publish(joint_state(
            time_message(stamp), list(self.ahead.joints), position=found.q[0],
            velocity=np.zeros_like(q) if dq is None else dq, effort=found.effort[0]))
        self.meter.end(begun)

    def verdict(self) -> tuple[bytes, str]:
        """Say what was refused last."""
        level, message = super().verdict()
        if self._refused and level == OK:
            return WARN, f'motion refused: {self._refused}'
        return level, message
