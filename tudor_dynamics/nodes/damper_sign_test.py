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
Program damper_sign_test: whether the running damper damps, or a gauge counts the wrong way.

It talks to ``oscillation_damper`` and ``reference_generator`` as a user would: small goals, the
damper's gain through its parameter ``damping``, strains from the gauges. It leaves the damper off
unless every joint tested is found right.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.control.damper import check_sign, grows, Sign, SignResult, StepResponse
from tudor_dynamics.errors import TudorError
from tudor_dynamics.nodes.common.base import weak
from tudor_dynamics.nodes.common.messages import floats, NamedReader, nanoseconds
from tudor_dynamics.nodes.common.trial import DAMPER, run_trial, step_size, Trial, trial_parser
from tudor_dynamics.nodes.settings import RECORD
from tudor_dynamics.signals.motion_profile import motion_limits, MotionPlanner


class SignTester(Trial):
    """Makes steps and listens to the link."""

    def __init__(self, arm: Arm, **kwargs: Any) -> None:
        super().__init__('damper_sign_test', arm, **kwargs)
        self._limits = motion_limits(arm)
        self._gauges = [NamedReader([gauge.name], self.drops) for gauge in arm.gauges]
        self._goal = np.zeros(len(arm.active_joints))
        self._strain: list[list[tuple[int, float]]] = [[] for _ in arm.gauges]
        for topic in dict.fromkeys(gauge.topic for gauge in arm.gauges):
            self.create_subscription(JointState, topic, partial(self._on_strains, topic), weak())

    def _on_strains(self, topic: str, message: JointState) -> None:
        for place, gauge in enumerate(self.arm.gauges):
            if gauge.topic == topic:
                values = self._gauges[place].read(message, 'position')
                if values is not None:
                    self._strain[place].append(
                        (nanoseconds(message.header.stamp), float(values[0])))

    def needs(self) -> list[Any]:
        """Wait for strains, too."""
        return [*super().needs(), (lambda: all(len(heard) > 1 for heard in self._strain),
                                   f'strains on {", ".join(self.arm.topics["strain"])}')]

    def listen(self, gauge: int, seconds: float, *, watch: bool = False) -> StepResponse:
        """Record the strain of a gauge; with ``watch`` the damper goes off where it grows."""
        self._strain[gauge].clear()
        end = self.steady() + seconds
        while self.steady() < end:
            self.spin_until(lambda: False, 0.1)
            response = self._response(gauge)
            if watch and response is not None and grows(response.strain, response.dt):
                self.set_damping(0.0)
                watch = False
        response = self._response(gauge)
        if response is None:
            raise TudorError(f'gauge {self.arm.gauge_names[gauge]!r} sent under 20 strains in '
                             f'{seconds:g} s on {self.arm.gauges[gauge].topic}; check its driver')
        return response

    def _response(self, gauge: int) -> StepResponse | None:
        heard = self._strain[gauge]
        if len(heard) < 20:
            return None
        stamp, strain = np.array(heard).T * [[1e-9], [1.0]]
        grid = np.linspace(stamp[0], stamp[-1], len(stamp))  # lost messages leave no dent
        return StepResponse(float(grid[1] - grid[0]), np.interp(grid, stamp, strain))

    def _gauge(self, joint: str) -> int:
        """Give the gauge that the damper of a joint listens to."""
        return self.arm.gauge_names.index(
            next(item.gauge for item in self.damped if item.joint == joint))

    def measure(self, joint: str, step: float, share: float) -> StepResponse:
        """Make a step with a share of the damper's gain and record what the link does."""
        index = self.arm.active_joints.index(joint)
        self.set_damping(share)
        planner = MotionPlanner(self._limits, self._goal)  # the one that the reference follows
        self._goal[index] += step
        planner.go(self._goal)
        self._go(index)
        self.spin_until(lambda: False, planner.remaining + 0.1)
        response = self.listen(self._gauge(joint), RECORD, watch=share > 0.0)
        if abs(self.q[index] - self._goal[index]) > 0.5 * abs(step):
            raise TudorError(f'{joint} is at {self.q[index]:.3g}, not at {self._goal[index]:.3g} '
                             f'{self.arm.position_units[joint]}; see the diagnostics of {DAMPER}, '
                             'then test again')
        return response

    def _go(self, index: int) -> None:
        self._goals.publish(JointTrajectory(
            joint_names=[self.arm.active_joints[index]],
            points=[JointTrajectoryPoint(positions=floats(self._goal[index:index + 1]))]))

    def test(self, joint: str, step: float) -> SignResult:
        """Test one joint."""
        index = self.arm.active_joints.index(joint)
        self.set_damping(0.0)
        rest = self.listen(self._gauge(joint), 2.5)
        return check_sign(joint, self.measure, rest=rest,
                          step=self.roomy(index, self._goal[index], step))

    def run(self, joints: Sequence[str], options: Namespace) -> int:
        self._goal = self.q.copy()
        for index in range(len(self._goal)):  # the reference comes to an arm that was held
            self._go(index)
        self.spin_until(lambda: False, 1.0)
        right = True
        for joint in joints:
            result = self.test(joint, step_size(self.arm, joint, options))
            right = right and result.sign is Sign.RIGHT
            print(result.text, flush=True)
        self.set_damping(1.0 if right else 0.0)
        print(f'the damper is {"on" if right else "off"}: its parameter damping is now {right:d}')
        return 0 if right else 1


def damped_joints(arm: Arm) -> list[str]:
    """Give the active joints that have a damper."""
    damped = [joint.joint for joint in arm.spec.damper.joints] if arm.spec.damper else []
    return [name for name in arm.active_joints if name in damped]


main = partial(run_trial, trial_parser(
    'damper_sign_test',
    'Move each joint by small steps: the link must ring less with the damper than without.',
    ['--arm my_arm.yaml --step 3'], '0 every sign is right, 1 a sign is wrong or unclear',
    3.0, 10.0), SignTester, damped_joints, 'is not in damper.joints of the arm', (20.0, 100.0))
