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
Base of the programs that move an arm a little and judge what it does.

They talk to ``oscillation_damper`` and ``reference_generator`` as a user would.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections import Counter
from collections.abc import Callable, Sequence
import math
import sys
from typing import Any

import numpy as np
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from tudor_dynamics.arm.description import Arm, load_arm, refuse_interfaces
from tudor_dynamics.arm.limits import hard_limits
from tudor_dynamics.errors import ArmError, TudorError
from tudor_dynamics.nodes.common.base import steady_clock, strong, weak
from tudor_dynamics.nodes.common.interfaces import JOINT_TRAJECTORY
from tudor_dynamics.nodes.common.messages import NamedReader
from tudor_dynamics.nodes.common.runner import new_executor
from tudor_dynamics.nodes.settings import ATTEMPTS, PATIENCE
from tudor_dynamics.typing import FloatArray

DAMPER = 'oscillation_damper'


class Trial(Node):
    """Sends goals, sets the damper's gain, and listens; q (joints,) [rad or m]: where it is."""

    def __init__(self, name: str, arm: Arm, **kwargs: Any) -> None:
        self.damped = arm.damper.joints
        refuse_interfaces(arm, name)
        super().__init__(name, **kwargs)
        self.arm, self.steady = arm, steady_clock(self)
        self.drops: Counter[str] = Counter()
        self.q: FloatArray = np.full(len(arm.active_joints), np.nan)  # until it is known
        self._reader = NamedReader(arm.active_joints, self.drops)
        self._executor = new_executor('single', self.context)
        self._executor.add_node(self)
        self._goals = self.create_publisher(JointTrajectory, JOINT_TRAJECTORY, strong())
        self._damping = self.create_client(SetParameters, f'{DAMPER}/set_parameters')
        self.create_subscription(JointState, arm.spec.joint_topic, self.on_joints, weak())

    def on_joints(self, message: JointState) -> None:
        """Take positions."""
        q = self._reader.read(message, 'position')
        if q is not None and np.isfinite(q).all():
            self.q = q
            self.heard(message)

    def heard(self, message: JointState) -> None:
        """Take a message with positions that can be used."""

    def spin_until(self, done: Callable[[], bool], seconds: float) -> bool:
        """Handle messages until something is done or the time is over."""
        end = self.steady() + seconds
        while self.steady() < end and rclpy.ok(context=self.context):
            if done():
                return True
            self._executor.spin_once(timeout_sec=0.02)
        return done()

    def needs(self) -> list[tuple[Callable[[], bool], str]]:
        """Give what a test waits for, and what it is called."""
        return [
            (self._damping.service_is_ready, f'the node {DAMPER}'),
            (lambda: self._goals.get_subscription_count() > 0, 'the node reference_generator'),
            (lambda: bool(np.isfinite(self.q).all()), f'positions on {self.arm.spec.joint_topic}')]

    def wait(self) -> None:
        """Wait for the arm and the nodes; a TudorError says what is missing."""
        for done, what in self.needs():
            if not self.spin_until(done, PATIENCE):
                raise TudorError(f'{what} did not appear within {PATIENCE:g} s; start the driver '
                                 f'of the arm, {DAMPER} and reference_generator first')

    def call(self, client: Any, request: Any, what: str) -> Any:
        """Call a service; a TudorError says that it did not answer."""
        if self.spin_until(client.service_is_ready, PATIENCE):
            for _ in range(ATTEMPTS):  # an answer gets lost where the server does not know us yet
                future = client.call_async(request)
                if self.spin_until(future.done, PATIENCE / ATTEMPTS):
                    return future.result()
        raise TudorError(f'the node {what} did not answer within {PATIENCE:g} s; restart it')

    def parameter(self, node: str, name: str) -> ParameterValue:
        """Read a parameter of another node."""
        client = self.create_client(GetParameters, f'{node}/get_parameters')
        return self.call(client, GetParameters.Request(names=[name]), node).values[0]

    def set_damping(self, share: float) -> None:
        """Set the share of the damper's gain."""
        request = SetParameters.Request(
            parameters=[Parameter('damping', value=float(share)).to_parameter_msg()])
        if not (result := self.call(self._damping, request, DAMPER).results[0]).successful:
            raise TudorError(
                f"{DAMPER} refused {share:g} for its parameter 'damping' ({result.reason})")

    def roomy(self, joint: int, place: float, step: float) -> float:
        """Give a step, or the one to the other side where there is no room for it."""
        return step if place + step <= hard_limits(self.arm).upper[joint] else -step

    def run(self, joints: Sequence[str], options: Namespace) -> int:
        """Test joints; returns the exit code."""
        raise NotImplementedError


def trial_parser(
    name: str, description: str, examples: Sequence[str], codes: str, step: float, slide: float,
) -> ArgumentParser:
    """Make the parser that the programs share: step [deg], slide [mm]."""
    lines = '\n'.join(f'  ros2 run tudor_dynamics {name} {words}' for words in examples)
    parser = ArgumentParser(
        prog=name, formatter_class=RawDescriptionHelpFormatter, description=description,
        epilog=f'example, the arm and its nodes running:\n{lines}\n\n'
               f'exit codes: {codes}, 2 wrong input')
    parser.add_argument('--arm', required=True, metavar='YAML', help='arm description')
    parser.add_argument('--joints', nargs='+', metavar='JOINT',
                        help='joints to test (default: all that can be)')
    parser.add_argument('--step', type=float, default=step, metavar='DEG',
                        help='size of the steps (default: %(default)g)')
    parser.add_argument('--slide', type=float, default=slide, metavar='MM',
                        help='size of the steps of prismatic joints (default: %(default)g)')
    return parser


def step_size(arm: Arm, joint: str, options: Namespace) -> float:
    """Give the step of a joint by its kind [rad or m]."""
    return 1e-3 * options.slide if arm.is_prismatic(joint) else math.radians(options.step)


def run_trial(
    parser: ArgumentParser, make: Callable[[Arm], Trial], testable: Callable[[Arm], Sequence[str]],
    others: str, largest: tuple[float, float], args: Sequence[str] | None = None,
) -> int:
    """Run a test as a process; others: what other joints are; largest: step, slide [deg, mm]."""
    words = list(sys.argv if args is None else args)
    options = parser.parse_args(rclpy.utilities.remove_ros_args(words)[1:])
    node: Trial | None = None
    try:
        arm = load_arm(options.arm)
        able = list(testable(arm))
        joints = options.joints or able
        for name in joints:
            if name not in able:
                raise ArmError(f'--joints: {name!r} {others}; choose from {", ".join(able)}')
        for name, value, bound, unit in (
                ('step', options.step, largest[0], 'degrees'),
                ('slide', options.slide, largest[1], 'mm')):
            if not 0.0 < value <= bound:
                raise ArmError(f'--{name} {value:g}: give more than 0, up to {bound:g} {unit}')
        rclpy.init(args=words)
        node = make(arm)
        node.wait()
        return node.run(joints, options)
    except TudorError as err:
        print(f'{parser.prog}: {" ".join(str(err).split())}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    finally:
        if node is not None:
            node.destroy_node()
        if rclpy.ok():
            rclpy.shutdown()
