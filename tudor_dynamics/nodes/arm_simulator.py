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

"""Node arm_simulator: an elastic arm in place of a real one, with the topics of its drivers."""

from __future__ import annotations

from functools import partial
import math
from threading import Event, Lock
import time
from typing import Any

from geometry_msgs.msg import WrenchStamped
import numpy as np
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from tudor_dynamics.arm.description import Arm, by_topic
from tudor_dynamics.arm.kinematics import base_frame
from tudor_dynamics.errors import TudorError
from tudor_dynamics.mechanics.closed_loop import ArmProcess
from tudor_dynamics.mechanics.hardware import Floor, Imperfections
from tudor_dynamics.nodes.common.base import ERROR, Figure, OK, TudorNode, WARN
from tudor_dynamics.nodes.common.interfaces import (
    APPLIED_WRENCH, CLOCK, EXTERNAL_WRENCH, RESET, VELOCITY_COMMANDS)
from tudor_dynamics.nodes.common.messages import joint_state, time_message, wrench_stamped
from tudor_dynamics.nodes.settings import ANSWERED, LATE, LISTENS


class ArmSimulatorNode(TudorNode):
    """Simulator node; ``**kwargs`` go to rclpy's Node."""

    FIGURES: tuple[Figure, ...] = (
        Figure('simulated time [s]', lambda arm: f'{arm.t:.1f}', 'arm'),
        Figure('gave up real time', lambda node: node.arm and node.late))

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('arm_simulator', **kwargs)
        self.arm: ArmProcess | None = None
        self._answer, self._commanded = Event(), -math.inf  # to the newest sample; when one came
        self._lock = Lock()
        self.late = 0
        try:
            description = self.described_arm("the keys 'links' and 'motors'", 'a simulated arm')
            arm = self.arm = ArmProcess(
                description, rate=self.value('rate'), payload=self.value('payload'),
                damping=self.value('damping'), seed=self.value('seed'),
                imperfections=(Imperfections() if self.value('imperfections')
                               else Imperfections.none()))
        except TudorError as err:
            self.fail(err)
            return
        self.robot = description.name
        for floor in (None, Floor(10.0, 1.0)):  # loads compiled code: late otherwise
            arm.floor = floor
            arm.step()
        arm.reset()
        self._connect(description, arm)
        self.apply()
        self._run_beside(partial(self._live, arm))

    def _connect(self, arm: Arm, rig: ArmProcess) -> None:
        self._names = list(arm.active_joints)
        # with the held ones robot_state_publisher has the whole arm
        self._all = list(arm.movable_joints)
        self._active = [self._all.index(name) for name in self._names]
        self._held = np.array([rig.held.get(name, 0.0) for name in self._all])
        self._gauges, self._base = list(arm.gauge_names), base_frame(arm.full_model)
        self._joints = self.publish_on(JointState, arm.spec.joint_topic)
        efforts = by_topic(joint.effort for joint in arm.joints)
        strains = by_topic(arm.gauges)
        # what comes with the positions: others have no effort there
        self._own_efforts = efforts.pop(arm.spec.joint_topic, [])
        self._own_strains = strains.pop(arm.spec.joint_topic, [])
        self._efforts, self._strains = (
            [(self.publish_on(JointState, topic), index, [names[k] for k in index])
             for topic, index in topics.items()]
            for topics, names in ((efforts, self._names), (strains, self._gauges)))
        self._wrench = self.publish_on(WrenchStamped, APPLIED_WRENCH)
        self._ticks = self.create_publisher(Clock, CLOCK, 10) if self.value('clock') else None
        self._inputs = [
            self.subscribe(Float64MultiArray, VELOCITY_COMMANDS, partial(self._on_command, rig)),
            self.subscribe(WrenchStamped, EXTERNAL_WRENCH, partial(self._on_wrench, rig))]
        self.serve(RESET, partial(self._reset, rig))

    def apply(self) -> None:
        if self.arm is None:
            return
        floor = (Floor(self.value('obstacle_height'), self.value('obstacle_stiffness'))
                 if self.value('obstacle') else None)
        with self._lock:
            self.arm.floor = floor
            self.arm.command_timeout = self.value('command_timeout')

    def _reset(self, arm: ArmProcess) -> str:
        with self._lock:
            arm.reset()
        return 'the arm rests at its initial pose'

    def _on_command(self, arm: ArmProcess, message: Float64MultiArray) -> None:
        begun = self.meter.begin()
        command = np.array(message.data)
        if len(command) != len(self._names) or not np.isfinite(command).all():
            self.drops['impossible_command'] += 1
            return
        if arm.failure:
            self.drops['diverged'] += 1
            return
        with self._lock:
            arm.command(command)
        self._commanded = self.steady()
        self._answer.set()
        self.meter.end(begun)

    def _on_wrench(self, arm: ArmProcess, message: WrenchStamped) -> None:
        force = message.wrench.force
        values = np.array([force.x, force.y, force.z])
        if not np.isfinite(values).all():
            self.drops['impossible_wrench'] += 1
            return
        with self._lock:
            arm.force = values

    def _live(self, arm: ArmProcess) -> None:
        """Run the arm against the wall clock; the executor serves the topics meanwhile."""
        period = 1.0 / self.value('rate') / self.value('factor')
        simulated = bool(self.value('clock'))
        lockstep = simulated and self.value('lockstep')
        origin = self.get_clock().now().nanoseconds if not simulated else 1_000_000_000
        due = time.perf_counter()
        failure = ''
        while not self._closing.is_set():
            with self._lock:
                sample = arm.step()
            if arm.failure != failure:
                failure = arm.failure
                if failure:
                    self.get_logger().error(failure)
            self._answer.clear()
            self._publish(sample, origin)
            if lockstep and self.steady() - self._commanded < self.value('timeout'):
                self._answer.wait(ANSWERED)
            due += period
            wait = due - time.perf_counter()
            # Late, too: what takes commands needs its turn, or an arm that hurries has old ones.
            self._closing.wait(max(wait, LISTENS * period))
            if wait < -LATE:
                self.late += not lockstep
                due -= wait
                if not simulated and self.value('factor') == 1.0:
                    # as of an arm that has halted: stamps must not lag everybody's clock
                    origin -= round(wait * 1e9)

    def _publish(self, sample: Any, origin: int) -> None:
        stamp = time_message(origin + round(sample.t * 1e9))
        if self._ticks is not None:
            self._ticks.publish(Clock(clock=stamp))
        for publisher, index, names in self._efforts:
            publisher.publish(joint_state(stamp, names, effort=sample.current[index]))
        for publisher, index, names in self._strains:
            publisher.publish(joint_state(stamp, names, position=sample.strain[index]))
        # positions, with efforts and strains where they come with them
        gauges = self._own_strains
        missing = np.full(len(gauges), np.nan)
        q, dq = self._held.copy(), np.zeros(len(self._all))
        q[self._active], dq[self._active] = sample.q, sample.dq
        fields = {'position': np.concatenate([q, sample.strain[gauges]]),
                  'velocity': np.concatenate([dq, missing])}
        if self._own_efforts:
            effort = np.full(len(self._all), np.nan)
            effort[[self._active[k] for k in self._own_efforts]] = (
                sample.current[self._own_efforts])
            fields['effort'] = np.concatenate([effort, missing])
        self._joints.publish(joint_state(
            stamp, self._all + [self._gauges[k] for k in gauges], **fields))
        if self._wrench.get_subscription_count():
            self._wrench.publish(wrench_stamped(stamp, self._base, sample.force))

    def verdict(self) -> tuple[bytes, str]:
        """Say whether the simulation keeps up."""
        level, message = super().verdict()
        if self.fault or self.arm is None:
            return level, message
        if self.arm.failure:
            return ERROR, (f'{self.arm.failure}; the arm rests at its initial pose until you call '
                           'the service ~/reset')
        if level != OK:
            return WARN, (f'no commands arrive on {VELOCITY_COMMANDS}, so the joints stand still; '
                          'start oscillation_damper')
        return level, message
