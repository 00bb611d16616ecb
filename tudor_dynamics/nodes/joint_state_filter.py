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

"""Node joint_state_filter: positions in, positions with velocities and accelerations out."""

from __future__ import annotations

from collections import Counter
from typing import Any

from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import TudorError
from tudor_dynamics.models.bundle import load_bundle
from tudor_dynamics.nodes.common.base import TudorNode
from tudor_dynamics.nodes.common.interfaces import (
    FILTERED_JOINT_STATES, JOINT_MOTION, JOINT_STATES, RESET)
from tudor_dynamics.nodes.common.messages import (
    JointSample, JointStateEncoder, ListenedPublisher, MotionEncoder, NamedReader)
from tudor_dynamics.nodes.settings import DEEP
from tudor_dynamics.online.monitor import warm_up_filter
from tudor_dynamics.online.streams import LowPass, StateFilter


class JointStateFilterNode(TudorNode):
    """Filter node; ``**kwargs`` go to rclpy's Node."""

    depth = DEEP

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('joint_state_filter', **kwargs)
        topic = JOINT_STATES
        self._names: list[str] = list(self.value('joints'))
        self._reader: NamedReader | None = None
        spec = PreprocessingSpec(
            velocity_cutoff=self.value('velocity_cutoff'),
            acceleration_cutoff=self.value('acceleration_cutoff'),
            output_cutoff=self.value('output_cutoff') or None,
            measured_velocity=self.value('measured_velocity'))
        if self.value('model'):
            try:
                bundle = load_bundle(self.value('model')).beside_robot()
            except TudorError as err:
                self.fault = str(err)
            else:
                spec, topic = bundle.preprocessing, bundle.arm.spec.joint_topic
                self._names = self._names or list(bundle.arm.active_joints)
                self.robot = bundle.arm.name
        warm_up_filter(spec)
        self.filter = StateFilter(spec, self.value('gap'))
        self._effort = LowPass(spec.output_cutoff)
        self._states = ListenedPublisher(self.publish_on(JointState, FILTERED_JOINT_STATES))
        self._motion = self.publish_on(JointTrajectory, JOINT_MOTION)
        self.serve(RESET, self._reset)
        self._subscription = self.hear(topic, self._on_joints)

    def _reset(self) -> str:
        self.filter.reset()
        return 'the filter restarts with the next sample'

    def _on_joints(self, message: JointSample) -> None:
        begun = self.meter.begin()
        if self.fault:
            return
        if self._reader is None:
            self._names = self._names or list(message.name)
            self._reader = NamedReader(self._names, self.drops)
            self._motion_encoder = MotionEncoder(self._names)
            self._encoders = [JointStateEncoder(self._names, fields) for fields in (
                ('position', 'velocity'), ('position', 'velocity', 'effort'))]
        q = self._reader.read(message, 'position')
        if q is None:
            return
        velocity = self._reader.read(message, 'velocity', optional=True)
        motion = self.filter.step(message.stamp, q, velocity)
        if motion is None:
            return
        n, row, stamp = len(self._names), motion.row, motion.stamp
        self._motion.publish(self._motion_encoder.encode(stamp, round(motion.elapsed * 1e9), row))
        effort = self._reader.read(message, 'effort', optional=True)
        states = [row[:n], row[n:2 * n]]
        if effort is not None:
            states.append(self._effort.step(motion.dt, effort))
        self._states.encoder = self._encoders[effort is not None]
        self._states.publish(stamp, *states)
        self.meter.end(begun)

    def counters(self) -> list[Counter[str]]:
        return [self.drops, self.filter.drops]
