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

import argparse
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
import math
import sys
import time
from typing import Any

import numpy as np
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from tudor_dynamics.arm.description import Arm, load_arm, refuse_interfaces
from tudor_dynamics.arm.limits import hard_limits
from tudor_dynamics.control.damper import check_sign, grows, Sign, SignResult, StepResponse
from tudor_dynamics.errors import ArmError, TudorError
from tudor_dynamics.nodes.common.base import strong, weak
from tudor_dynamics.nodes.common.interfaces import JOINT_TRAJECTORY
from tudor_dynamics.nodes.common.messages import floats, NamedReader, nanoseconds
from tudor_dynamics.nodes.common.runner import new_executor
from tudor_dynamics.nodes.settings import PATIENCE, RECORD
from tudor_dynamics.signals.motion_profile import motion_limits, MotionPlanner


class SignTester(Node):
    """Makes steps and listens to the link."""

    def __init__(self, arm: Arm, **kwargs: Any) -> None:
        super().__init__('damper_sign_test', **kwargs)
        if arm.spec.damper is None:
            msg = f'{arm.source}: no damper is described, so there is none to test'
            raise ArmError(msg)
        refuse_interfaces(arm, 'the sign test')
        self.arm = arm
        self._limits = motion_limits(arm)
        drops: Counter[str] = Counter()
        self._reader = NamedReader(arm.active_joints, drops)
        self._gauges = [NamedReader([gauge.name], drops) for gauge in arm.gauges]
        self._goal: Any = None
        self._strain: list[list[tuple[int, float]]] = [[] for _ in arm.gauges]
        self._executor = new_executor('single', self.context)
        self._executor.add_node(self)
        self._goals = self.create_publisher(JointTrajectory, JOINT_TRAJECTORY, strong())
        self._damping = self.create_client(SetParameters, 'oscillation_damper/set_parameters')
        self.create_subscription(JointState, arm.spec.joint_topic, self._on_joints, weak())
        for topic in dict.fromkeys(gauge.topic for gauge in arm.gauges):
            self.create_subscription(JointState, topic, partial(self._on_strains, topic), weak())

    def _on_joints(self, message: JointState) -> None:
        q = self._reader.read(message, 'position')
        if self._goal is None and q is not None and np.isfinite(q).all():
            self._goal = q.copy()

    def _on_strains(self, topic: str, message: JointState) -> None:
        for place, gauge in enumerate(self.arm.gauges):
            if gauge.topic == topic:
                values = self._gauges[place].read(message, 'position')
                if values is not None:
                    self._strain[place].append(
                        (nanoseconds(message.header.stamp), float(values[0])))

    def spin_until(self, done: Callable[[], bool], seconds: float) -> bool:
        """Handle messages until something is done or the time is over."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and rclpy.ok(context=self.context):
            if done():
                return True
            self._executor.spin_once(timeout_sec=0.02)
        return done()

    def wait(self) -> None:
        """Wait for the arm and the nodes; a TudorError says what is missing."""
        for done, what in (
                (self._damping.service_is_ready, 'the node oscillation_damper'),
                (lambda: self._goals.get_subscription_count() > 0, 'the node reference_generator'),
                (lambda: self._goal is not None, f'positions on {self.arm.spec.joint_topic}'),
                (lambda: all(len(heard) > 1 for heard in self._strain), 'strains of the gauges')):
            if not self.spin_until(done, PATIENCE):
                msg = (f'{what} did not come within {PATIENCE:g} s; start the arm and its '
                       'nodes first')
                raise TudorError(msg)

    def set_damping(self, share: float) -> None:
        """Set the share of the damper's gain."""
        request = SetParameters.Request(
            parameters=[Parameter('damping', value=float(share)).to_parameter_msg()])
        future = self._damping.call_async(request)
        if not self.spin_until(future.done, PATIENCE) or not future.result().results[0].successful:
            msg = f'oscillation_damper did not take damping {share:g}; the test stops here'
            raise TudorError(msg)

    def listen(self, gauge: int, seconds: float, *, watch: bool = False) -> StepResponse:
        """Record the strain of a gauge; with ``watch`` the damper goes off where it grows."""
        self._strain[gauge].clear()
        end = time.monotonic() + seconds
        watching = watch
        while time.monotonic() < end:
            self.spin_until(lambda: False, 0.1)
            response = self._response(gauge)
            if watching and response is not None and grows(response.strain, response.dt):
                self.set_damping(0.0)
                watching = False
        response = self._response(gauge)
        if response is None:
            msg = f'no strain of {self.arm.gauge_names[gauge]} for {seconds:g} s'
            raise TudorError(msg)
        return response

    def _response(self, gauge: int) -> StepResponse | None:
        heard = self._strain[gauge]
        if len(heard) < 20:
            return None
        stamp, strain = np.array([item[0] for item in heard]) * 1e-9, np.array(
            [item[1] for item in heard])
        grid = np.linspace(stamp[0], stamp[-1], len(stamp))  # lost messages leave no dent
        return StepResponse(float(grid[1] - grid[0]), np.interp(grid, stamp, strain))

    def _gauge(self, joint: str) -> int:
        """Give the gauge that the damper of a joint listens to."""
        assert self.arm.spec.damper is not None
        return self.arm.gauge_names.index(
            next(item.gauge for item in self.arm.spec.damper.joints if item.joint == joint))

    def measure(self, joint: str, step: float, share: float) -> StepResponse:
        """Make a step with a share of the damper's gain and record what the link does."""
        index = self.arm.active_joints.index(joint)
        self.set_damping(share)
        planner = MotionPlanner(self._limits, self._goal)  # the one that the reference follows
        self._goal[index] += step
        planner.go(self._goal)
        self._goals.publish(JointTrajectory(
            joint_names=[joint],
            points=[JointTrajectoryPoint(positions=floats(self._goal[index:index + 1]))]))
        self.spin_until(lambda: False, planner.remaining + 0.1)
        return self.listen(self._gauge(joint), RECORD, watch=share > 0.0)

    def test(self, joint: str, step: float) -> SignResult:
        """Test one joint."""
        index = self.arm.active_joints.index(joint)
        if self._goal[index] + step > hard_limits(self.arm).upper[index]:
            step = -step  # there is room on the other side
        self.set_damping(0.0)
        rest = self.listen(self._gauge(joint), 2.5)
        return check_sign(joint, self.measure, step=step, rest=rest)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='damper_sign_test', formatter_class=argparse.RawDescriptionHelpFormatter,
        description='Make small steps of each joint without and with the damper: it must damp.',
        epilog='example, the arm and its nodes running:\n'
               '  ros2 run tudor_dynamics damper_sign_test --arm my_arm.yaml --step 3\n\n'
               'exit codes: 0 every sign is right, 1 a sign is wrong or unclear, 2 wrong input')
    parser.add_argument('--arm', required=True, metavar='YAML', help='arm description')
    parser.add_argument('--joints', nargs='+', metavar='JOINT',
                        help='joints to test (default: all with a damper and a gauge)')
    parser.add_argument('--step', type=float, default=3.0, metavar='DEG',
                        help='size of the steps (default: 3)')
    parser.add_argument('--slide', type=float, default=10.0, metavar='MM',
                        help='size of the steps of prismatic joints (default: 10)')
    return parser


def step_size(arm: Arm, joint: str, degrees: float, millimetres: float) -> float:
    """Give the step of a joint by its kind [rad or m]."""
    return 1e-3 * millimetres if arm.is_prismatic(joint) else math.radians(degrees)


def tested_joints(arm: Arm, wanted: Sequence[str] | None) -> list[str]:
    """Give the joints to test; a TudorError for one that cannot be."""
    damped = [joint.joint for joint in arm.spec.damper.joints] if arm.spec.damper else []
    able = [name for name in arm.active_joints if name in damped]
    for name in wanted or ():
        if name not in able:
            msg = f'joint {name!r} has no damper with a gauge; those that have: {able}'
            raise ArmError(msg)
    return list(wanted) if wanted else able


def main(args: Sequence[str] | None = None) -> int:
    """Run the test as a process; args: those of the process by default."""
    words = list(sys.argv if args is None else args)
    options = _parser().parse_args(rclpy.utilities.remove_ros_args(words)[1:])
    node: SignTester | None = None
    try:
        arm = load_arm(options.arm)
        joints = tested_joints(arm, options.joints)
        if not 0.0 < options.step <= 20.0:
            msg = f'--step {options.step:g}: expected more than 0 and at most 20 degrees'
            raise ArmError(msg)
        if not 0.0 < options.slide <= 100.0:
            msg = f'--slide {options.slide:g}: expected more than 0 and at most 100 mm'
            raise ArmError(msg)
        rclpy.init(args=words)
        node = SignTester(arm)
        node.wait()
        results = []
        for joint in joints:
            results.append(node.test(joint, step_size(
                arm, joint, options.step, options.slide)))
            print(results[-1].text, flush=True)
        right = all(result.sign is Sign.RIGHT for result in results)
        node.set_damping(1.0 if right else 0.0)
        print('the damper is on' if right else 'the damper is off')
        return 0 if right else 1
    except TudorError as err:
        print(f'damper_sign_test: {" ".join(str(err).split())}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    finally:
        if node is not None:
            node.destroy_node()
        if rclpy.ok():
            rclpy.shutdown()


if __name__ == '__main__':
    sys.exit(main())
