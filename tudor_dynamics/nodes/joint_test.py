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
Program joint_test: whether each joint answers its own commands, by nudges of half a degree.

It compares the commands of ``oscillation_damper`` with positions. It stops at the first joint that
answers wrongly, and leaves ``oscillation_damper`` inactive then.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from functools import partial
import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.control.joint_answers import (
    JointAnswer, JointRecord, nudges, order_fault, pose_fault)
from tudor_dynamics.control.settings import (
    ASTRAY_AFTER, NUDGE, NUDGE_DWELL, NUDGE_LARGEST, NUDGE_SLIDE, NUDGE_STANDS)
from tudor_dynamics.errors import TudorError
from tudor_dynamics.nodes.common.base import weak
from tudor_dynamics.nodes.common.interfaces import DIAGNOSTICS, VELOCITY_COMMANDS
from tudor_dynamics.nodes.common.messages import nanoseconds, put_trajectory
from tudor_dynamics.nodes.common.trial import DAMPER, run_trial, step_size, Trial, trial_parser
from tudor_dynamics.nodes.settings import PATIENCE


class JointTester(Trial):
    """Nudges joints and compares positions with commands."""

    def __init__(self, arm: Arm, **kwargs: Any) -> None:
        super().__init__('joint_test', arm, **kwargs)
        self._record: JointRecord | None = None
        self._commands = 0
        self._said: dict[str, str] = {}
        self._change = self.create_client(ChangeState, f'{DAMPER}/change_state')
        self._state = self.create_client(GetState, f'{DAMPER}/get_state')
        self._tested = self.create_client(Trigger, f'{DAMPER}/joints_tested')
        self.create_subscription(Float64MultiArray, VELOCITY_COMMANDS, self._on_command, weak(100))
        self.create_subscription(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, 20)

    def heard(self, message: JointState) -> None:
        """Record positions, and velocities where the driver has them."""
        if self._record is not None:
            dq = self._reader.read(message, 'velocity') if len(message.velocity) else None
            self._record.positions(1e-9 * nanoseconds(message.header.stamp), self.q, dq)

    def _on_command(self, message: Float64MultiArray) -> None:
        self._commands += 1
        if self._record is not None and len(message.data) == len(self.arm.active_joints):
            self._record.command(np.array(message.data))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name = status.name.partition(':')[0]
            if status.level != DiagnosticStatus.OK and name in (DAMPER, 'reference_generator'):
                self._said[name] = status.message

    def _activate(self, wanted: bool) -> None:
        """Activate the damper, or let it brake and command nothing any more."""
        found = self.call(self._state, GetState.Request(), DAMPER).current_state.id
        if found != (State.PRIMARY_STATE_ACTIVE if wanted else State.PRIMARY_STATE_INACTIVE):
            self.call(self._change, ChangeState.Request(transition=Transition(
                id=Transition.TRANSITION_ACTIVATE if wanted
                else Transition.TRANSITION_DEACTIVATE)), DAMPER)

    def _send(self, way: Trajectory) -> None:
        self._goals.publish(put_trajectory(JointTrajectory(), way))

    def start(self) -> None:
        """Let the damper hold the arm where it stands, whatever was before."""
        self._activate(False)
        self.spin_until(lambda: False, NUDGE_STANDS)  # it brakes, and the reference comes to it
        self._send(Trajectory(self.arm.active_joints, np.zeros(1), self.q[np.newaxis]))
        self.spin_until(lambda: False, NUDGE_STANDS)
        self._activate(True)
        self._commands = 0
        if not self.spin_until(lambda: self._commands > 0, PATIENCE):
            raise TudorError(self._hinted(f'{DAMPER} sends no {VELOCITY_COMMANDS}; see its log'))

    def _hinted(self, what: str) -> str:
        return '; '.join([what, *(f'{name} says: {text}' for name, text in self._said.items())])

    def nudge(self, joint: str, step: float) -> JointAnswer:
        """Nudge a joint; where any goes astray, stop all."""
        index = self.arm.active_joints.index(joint)
        place = float(self.q[index])
        record = self._record = JointRecord(self.arm, index, step)
        if not self.spin_until(lambda: record.astray, NUDGE_STANDS):
            record.begin()
            self._said.clear()
            way = nudges(joint, place, self.roomy(index, place, step))
            self._send(way)
            self.spin_until(lambda: record.astray, float(way.t[-1]) + NUDGE_DWELL)
        if record.astray:
            self._activate(False)
            self.spin_until(lambda: False, ASTRAY_AFTER)
        self._record = None
        return record.judge()

    def run(self, joints: Sequence[str], options: Namespace) -> int:
        fault = options.controller and order_fault(
            self.arm.active_joints,
            self.parameter(options.controller, 'joints').string_array_value)
        fault = fault or pose_fault(self.arm, self.q)
        if fault:
            print(f'{fault}; nothing was moved')
            return 1
        damping = self.parameter(DAMPER, 'damping').double_value
        self.set_damping(0.0)
        self.start()
        for joint in joints:
            step = step_size(self.arm, joint, options)
            largest = NUDGE_LARGEST * step
            answer = self.nudge(joint, step)
            while answer.right is None and 2.0 * step <= largest:
                print(f'{answer.text}; this is unclear, so a larger step follows', flush=True)
                step *= 2.0
                self.start()
                answer = self.nudge(joint, step)
            print(answer.text, flush=True)
            if not answer.right:
                break
        if answer.right is False:
            self._activate(False)
        self.set_damping(damping)
        if not answer.right:
            end = (f'{DAMPER} is inactive now; correct this, then test again before any motion'
                   if answer.right is False else 'unclear; take a larger --step or --slide')
            print(self._hinted(end))
            return 1
        if set(joints) == set(self.arm.active_joints) and self._tested.service_is_ready():
            result = self.call(self._tested, Trigger.Request(), DAMPER)
            if not result.success:
                print(f'{DAMPER} rejects the result of the test: {result.message}')
                return 1
        print('all joints that were tested answer their commands')
        return 0


parser = trial_parser(
    'joint_test', 'Move each joint a little: it alone must move, as far as commanded.',
    ['--arm my_arm.yaml', '--arm my_arm.yaml --controller velocity_controller --step 1'],
    '0 all joints are right, 1 one is wrong or unclear', math.degrees(NUDGE), 1e3 * NUDGE_SLIDE)
parser.add_argument('--controller', metavar='NAME',
                    help="controller of ros2_control whose parameter 'joints' has to be in the "
                    "order of the arm's active joints")
main = partial(run_trial, parser, JointTester, lambda arm: arm.active_joints,
               'is not an active joint of the arm', (5.0, 20.0))
