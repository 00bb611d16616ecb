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

"""Node reference_generator: goals or an APRBS to a smooth reference; reacts to collisions."""

from __future__ import annotations

from collections.abc import Sequence
import sys
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from trajectory_msgs.msg import JointTrajectory

from tudor_dynamics.arm import load_arm
from tudor_dynamics.control.damper import STRAIN_SCALE
from tudor_dynamics.control.reaction import ReactingReference, yielding_speed
from tudor_dynamics.errors import ArmError, TudorError
from tudor_dynamics.nodes.base import latched, OK, TudorNode, WARN
from tudor_dynamics.nodes.interfaces import (
    COLLISION, JOINT_REFERENCE, JOINT_TRAJECTORY, RESET, RESIDUALS)
from tudor_dynamics.nodes.messages import joint_state, NamedReader
from tudor_dynamics.nodes.runner import run
from tudor_dynamics.signals.excitation import aprbs, joint_range
from tudor_dynamics.signals.motion_profile import motion_limits

LONGEST = 600.0
"""Length of an APRBS before it begins anew [s]."""
LARGEST_STEP = 0.1
"""A pause of the timer is not made up for beyond this [s]."""


class ReferenceGeneratorNode(TudorNode):
    """
    Reference node; ``**kwargs`` go to rclpy's Node.

    It begins where the joints are: nothing is published before the first joint states.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('reference_generator', **kwargs)
        self.reference: ReactingReference | None = None
        self._goals: list[tuple[float, Any]] = []
        self._elapsed = 0.0
        self._last: int | None = None
        self._collision = False
        self._robot = ''
        self._output = self.publish_on(JointState, JOINT_REFERENCE)
        self.serve(RESET, self._reset)
        try:
            if not self.value('arm'):
                msg = 'no arm: set the parameter arm to a description with limits'
                raise ArmError(msg)
            self._arm = load_arm(self.value('arm'))
            self._limits = motion_limits(self._arm)
            self._range = joint_range(self._arm)
        except TudorError as err:
            self.fault = str(err)
            self.get_logger().error(self.fault)
            return
        arm = self._arm
        self._robot = arm.name
        self._names = list(arm.active_joints)
        self._joints = NamedReader(self._names, self.drops)
        self._residuals = NamedReader(arm.gauge_names, self.drops)
        self._inputs = [
            self.subscribe(JointState, arm.spec.joint_topic, self._on_joints),
            self.subscribe(JointTrajectory, JOINT_TRAJECTORY, self._on_goal),
            self.subscribe(JointState, RESIDUALS['strain'], self._on_residuals),
            self.create_subscription(Bool, COLLISION, self._on_collision, latched())]
        self._step_timer = self.create_timer(1.0 / self.value('rate'), self._step)

    def apply(self) -> None:
        """Take changed reactions into use."""
        if self.reference is not None:
            self.reference.reaction = self.value('reaction')
            self.reference.retreat_time = self.value('retreat_time')

    def _reset(self) -> str:
        if self.reference is None:
            return 'nothing to reset yet'
        self.reference.clear()
        return 'goals are taken again'

    def _on_joints(self, message: JointState) -> None:
        begun = self.meter.begin()
        if self.reference is None:
            q = self._joints.read(message, 'position')
            if q is None or not np.isfinite(q).all():
                return
            self.reference = ReactingReference(self._limits, q, self.value('reaction'),
                                               self.value('retreat_time'))
            self._last = None
            if self.value('mode') == 'aprbs':
                self._plan_aprbs()
        self.meter.end(begun)

    def _plan_aprbs(self) -> None:
        targets = aprbs(self._range, LONGEST, self.value('seed'))
        goals = [(float(t), j, float(v)) for j in range(len(self._names))
                 for t, v in zip(targets.times[j], targets.values[j], strict=True)]
        self._goals = []
        for t, j, v in sorted(goals):
            target = np.full(len(self._names), np.nan)
            target[j] = v
            self._goals.append((self._elapsed + t, target))
        self._goals.reverse()

    def _on_goal(self, message: JointTrajectory) -> None:
        if self.reference is None or not message.points:
            self.drops['goal_refused'] += 1
            return
        names, point = list(message.joint_names), message.points[-1]
        known = [name for name in names if name in self._names]
        if not known or len(point.positions) != len(names):
            self.drops['goal_refused'] += 1
            self.get_logger().error(f'goal for {names} refused: the joints are {self._names}')
            return
        target = np.full(len(self._names), np.nan)
        for name in known:
            target[self._names.index(name)] = point.positions[names.index(name)]
        low, high = self._range.lower, self._range.upper
        with np.errstate(invalid='ignore'):
            outside = (target < low) | (target > high) | np.isinf(target)
        if outside.any():
            self.drops['goal_refused'] += 1
            self.get_logger().error(
                f'goal {target.tolist()} refused: outside {low.tolist()} .. {high.tolist()}')
            return
        if not self.reference.go(target):
            self.drops['goal_refused'] += 1
            self.get_logger().warning('goal refused: a collision is being reacted to')

    def _on_collision(self, message: Bool) -> None:
        rising = message.data and not self._collision
        falling = self._collision and not message.data
        self._collision = bool(message.data)
        if self.reference is None:
            return
        if rising:
            self.reference.collide()
        elif falling and self.value('resume'):
            self.reference.clear()

    def _on_residuals(self, message: JointState) -> None:
        reference = self.reference
        if reference is None or reference.reaction != 'comply':
            return
        values = self._residuals.read(message, 'position')
        if values is None:
            return
        gain = float(self.value('comply_gain'))
        reference.yielding[:] = 0.0
        for joint, index, scale in self._feedback():
            reference.yielding[joint] = yielding_speed(float(values[index]), scale, gain)

    def _feedback(self) -> list[tuple[int, int, float]]:
        """Give for each joint the first gauge behind it, with its unit per m/m."""
        found: dict[int, tuple[int, int, float]] = {}
        for index, gauge in enumerate(self._arm.gauges):
            if gauge.joint in self._names and gauge.unit in STRAIN_SCALE:
                joint = self._names.index(gauge.joint)
                found.setdefault(joint, (joint, index, STRAIN_SCALE[gauge.unit]))
        return list(found.values())

    def _step(self) -> None:
        reference = self.reference
        if reference is None:
            return
        stamp = self.get_clock().now()
        now = int(stamp.nanoseconds)
        last, self._last = self._last, now
        if last is None or now <= last:
            return
        dt = min((now - last) * 1e-9, LARGEST_STEP)
        self._elapsed += dt
        while self._goals and self._goals[-1][0] <= self._elapsed:
            reference.go(self._goals.pop()[1])
        if not self._goals and self.value('mode') == 'aprbs':
            self._plan_aprbs()
        reference.step(dt)
        self._output.publish(joint_state(stamp.to_msg(), self._names, position=reference.q,
                                         velocity=reference.dq))

    def hardware(self) -> str:
        """Give the name of the robot, by default that of the arm."""
        return str(self.value('robot')) or self._robot or 'none'

    def status(self) -> tuple[bytes, str, dict[str, str]]:
        """Tell what the reference does."""
        level, message, values = super().status()
        values['reaction'] = str(self.value('reaction'))
        if self.reference is not None and self.reference.reacting and level == OK:
            return WARN, f'collision: {self.value("reaction")}; ~/reset takes goals again', values
        return level, message, values


def main(args: Sequence[str] | None = None) -> int:
    """Run the node as a process."""
    return run(ReferenceGeneratorNode, args)


if __name__ == '__main__':
    sys.exit(main())
