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

"""Node trajectory_relay: checks trajectories for a JointTrajectoryController, and stops it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
import math
from typing import Any

import numpy as np
from rclpy.action import ActionClient
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from trajectory_msgs.msg import JointTrajectory

from tudor_dynamics.arm.limits import hard_limits, planned_limits
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.control.trajectory import braking, Follower, from_state, of_all, Path
from tudor_dynamics.errors import SignalError, TudorError, UsageError
from tudor_dynamics.models.bundle import load_bundle, ModelBundle, tool_of
from tudor_dynamics.models.still_timing import shaped_for, TIMING
from tudor_dynamics.nodes.common.base import Figure, latched, OK, strong, TudorNode, WARN
from tudor_dynamics.nodes.common.following import FollowServer, since_start
from tudor_dynamics.nodes.common.interfaces import COLLISION, JOINT_TRAJECTORY, RESET
from tudor_dynamics.nodes.common.messages import NamedReader, put_trajectory, trajectory_of
from tudor_dynamics.nodes.settings import PUBLISHERS_LOOK, SHORTEST_STOP, STATE_PERIOD
from tudor_dynamics.online.feedforward import Feedforward
from tudor_dynamics.signals.filters import MotionState
from tudor_dynamics.signals.motion_profile import spline
from tudor_dynamics.signals.settings import AT_REST
from tudor_dynamics.signals.shaping import convolved, impulses
from tudor_dynamics.typing import FloatArray


class TrajectoryRelayNode(TudorNode):
    """
    Relay node; ``**kwargs`` go to rclpy's Node.

    It knows where the controller leads the arm by what it has forwarded: nothing else may command
    the controller.
    """

    FIGURES: tuple[Figure, ...] = (
        Figure('controller', lambda node: node.value('controller')),
        Figure('forwarded', lambda node: node.forwarded),
        Figure('refused', lambda node: node.refused or None),
        Figure('shaping', lambda node: node.value('shaping')),
        Figure('not shaped', lambda node: node.not_shaped or None),
        Figure('efforts', lambda ahead: ', '.join(ahead.units), 'ahead'))

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('trajectory_relay', **kwargs)
        self.follower: Follower | None = None
        self.ahead: Feedforward | None = None
        self._client: ActionClient | None = None
        self.forwarded, self.refused, self.not_shaped = 0, '', ''
        self.collision = self.held = False
        self._q: FloatArray | None = None
        self._tool: ModelBundle | None = None  # the bundle that has one
        self._at, self._stepped = -math.inf, self.steady()
        self._payload = float(self.value('payload'))
        self._goal: Any = None  # what the controller drives of ours: its handle, once it has one
        controller = self.value('controller')
        self._output = self.publish_on(JointTrajectory, f'{controller}/joint_trajectory')
        self.serve(RESET, self._reset)
        try:
            arm = self.described_arm("the key 'limits'")
            if self.value('tool'):
                self._tool = load_bundle(self.value('tool'), arm=arm)
                tool_of(self._tool)
            if self.value('model'):
                bundle = load_bundle(self.value('model'), arm=arm)
                self.ahead = Feedforward(
                    bundle, kind=self.value('kind'), unit=self.value('unit'),
                    positions=self.value('positions'),
                    friction_at_rest=self.value('friction_at_rest'),
                    payload=None if bundle.payload_range is None else self._payload)
        except TudorError as err:
            self.fail(err)
            return
        self._arm = arm
        self.robot, self._names, self._own = arm.name, arm.active_joints, arm.spec.joint_topic
        self._units = arm.position_units
        self.follower = Follower(hard_limits(arm))
        self._braking = replace(
            self.follower.bounds, acceleration=planned_limits(arm).acceleration)
        self._joints = NamedReader(self._names, self.drops)
        self._inputs = [
            self.subscribe(JointState, arm.spec.joint_topic, self._on_joints),
            self.subscribe(JointTrajectory, JOINT_TRAJECTORY, self._on_trajectory, qos=strong()),
            self.create_subscription(Bool, COLLISION, self._on_collision, latched())]
        self.server = FollowServer(self, self._on_goal, self._stop)
        if self.server.action is not None:
            self._client = ActionClient(
                self, self.server.action, f'{controller}/follow_joint_trajectory')
        self._step_timer = self.every(STATE_PERIOD, self._step)
        self._look_timer = self.every(PUBLISHERS_LOOK, self._look)

    def _reset(self) -> str:
        if self.collision:
            raise UsageError(f'a collision is still reported on {COLLISION!r}', remedy='free the '
                             'arm, call the service reset of the monitor, then that of this node')
        self.held = False
        return 'accepts trajectories again'

    def _on_joints(self, message: JointState) -> None:
        begun = self.meter.begin()
        q = self._joints.read(message, 'position')
        if q is not None and np.isfinite(q).all():
            self._q, self._at = q, self.steady()
            self.meter.end(begun)

    def _on_collision(self, message: Bool) -> None:
        rising, self.collision = message.data and not self.collision, bool(message.data)
        if rising:
            self.held = True
            self._stop('collision')

    def _on_trajectory(self, message: JointTrajectory) -> None:
        if not message.points:
            self._stop(f'a trajectory without points came on {JOINT_TRAJECTORY}')
        elif not self._check(message):
            self._leave(f'a newer trajectory on {JOINT_TRAJECTORY} replaced this goal')
            self._output.publish(message)

    def _on_goal(self, goal: Any) -> str:
        """Forward a goal; give why not."""
        if self._client is None or not self._client.server_is_ready():
            return self._refuse(f'the controller {self.value("controller")!r} offers no action '
                                'follow_joint_trajectory; activate it')
        why = self._check(goal.trajectory)
        if not why:
            self._leave('a newer goal replaced this one')
            self._goal = mine = [None]
            self._client.send_goal_async(goal, partial(self._fed_back, mine)).add_done_callback(
                partial(self._accepted, mine))
        return why

    def _fed_back(self, mine: list[Any], message: Any) -> None:
        if self._goal is mine:
            self.server.feedback(message.feedback)

    def _accepted(self, mine: list[Any], future: Any) -> None:
        handle = future.result()
        if not handle.accepted:
            self._ended(mine, f'{self.value("controller")} rejected the goal; see its log')
            return
        mine[0] = handle
        handle.get_result_async().add_done_callback(lambda done: self._ended(
            mine, done.result().result.error_string, done.result().result.error_code))
        if self._goal is not mine:  # stopped before the controller had it
            handle.cancel_goal_async()

    def _ended(self, mine: list[Any], text: str, code: int | None = None) -> None:
        if self._goal is mine:
            self._goal = None
            if code != 0 and self.follower is not None:
                self.follower.leave()
            self.server.end(text, code)

    def _leave(self, why: str) -> None:
        """Forget the goal that the controller drives; it gives it up by itself."""
        self._goal = None
        self.server.end(why)

    def _refuse(self, why: str) -> str:
        self.drops['refused'] += 1
        self.refused = why
        self.get_logger().error(f'trajectory refused: {why}')
        return why

    def _check(self, message: JointTrajectory) -> str:
        """Check a trajectory from where the arm is led, and add efforts; give why not."""
        begun = self.meter.begin()
        try:
            self._take(message, since_start(self, message))
        except TudorError as err:
            return self._refuse(str(err))
        self.refused = ''
        self.forwarded += 1
        self.meter.end(begun)
        return ''

    def _take(self, message: JointTrajectory, since: float) -> None:
        follower = self.follower
        assert follower is not None
        if self.held or self.collision:
            raise SignalError('a collision was reported',
                              remedy='free the arm and call the service ~/reset')
        if self._q is None or self.steady() - self._at > self.value('timeout'):
            raise SignalError(f'no joint positions arrive on {self._own}; start the driver')
        self._step()
        state = self._state()
        held = state.q if follower.path is None else follower.path.target
        given = of_all(trajectory_of(message), self._names, held,
                       self.value('allow_partial_joints_goal'))
        sent = whole = self._shaped(given, since, state)
        if self.ahead is not None:
            if self.value('payload') != self._payload:
                self.ahead.carry(self.value('payload'))
                self._payload = self.value('payload')
            sent = self.ahead.along(whole)
        why = ''
        if since >= 0.0 and whole.t[0] <= since < whole.t[-1]:
            # controllers do not lead from where the arm is to points that are due: they jump
            curve = spline(whole)
            own = MotionState(*(curve(since, order) for order in range(3)))
            off = np.abs(own.q - state.q)
            if off.max() > self.value('start_tolerance'):
                name, away = self._names[int(off.argmax())], off.max()
                raise SignalError(
                    f'{name!r} is {away:.3g} {self._units[name]} away from the point that is due, '
                    f"more than {self.value('start_tolerance'):g} (parameter 'start_tolerance')",
                    remedy='begin where the arm is, or raise time_from_start of the points')
            why = Path(own, whole, since).beyond(follower.bounds)
            if not why:
                follower.leave()
                state = own
        if why := why or follower.take(whole, since, state, follower.path is None):
            raise SignalError(why)
        if sent is not given:
            put_trajectory(message, sent)

    def _shaped(self, whole: Trajectory, since: float, state: MotionState) -> Trajectory:
        """Shape a trajectory from rest to rest, the move to its first point included."""
        self.not_shaped = ''
        if self.value('shaping') == 'none':
            return whole
        try:
            kind, frequency = self.value('shaping'), self.value('shaping_frequency')
            tool = self._tool if kind == TIMING or not frequency else None
            if kind == TIMING and tool is None:
                raise SignalError("shaping is timing, but the parameter 'tool' is empty", remedy=(
                    'set it to what `tudor fit --models analytical vibration` wrote'))
            if tool is None and not frequency:
                raise SignalError('the frequency of the tool is not known', remedy='set the '
                                  "parameter 'shaping_frequency' [Hz], or 'tool' to the folder "
                                  'that `tudor fit --models analytical vibration` wrote')
            shape = partial(shaped_for, tool, kind=kind) if tool is not None else partial(
                convolved, shaper=impulses(kind, frequency, self.value('shaping_damping')))
            if np.abs(state.dq).max() > AT_REST:
                raise SignalError('the arm still moved when the trajectory came',
                                  remedy='send each motion after the one before has ended')
            begin = max(since, 0.0)
            return shape(from_state(whole, state, begin) if whole.t[0] > begin else whole)
        except SignalError as err:
            if self.value('not_shaped') == 'refuse':
                raise SignalError(f'it cannot be shaped, as {err}') from None
            self.not_shaped = str(err)
            return whole

    def _state(self) -> MotionState:
        assert self.follower is not None and self._q is not None
        return self.follower.state or MotionState(self._q, *np.zeros((2, len(self._q))))

    def _step(self) -> None:
        """Follow what was forwarded; what cannot begin after all is stopped."""
        self.notice()
        now = self.steady()
        dt, self._stepped = now - self._stepped, now
        if self.follower is None or self._q is None or dt <= 0.0:
            return
        _, why = self.follower.step(dt, self._state())
        if why:
            self._stop(self._refuse(why))

    def _stop(self, why: str) -> None:
        """Stop the controller: cancel the goal, or say where to rest as far as that is known."""
        if self.follower is None:
            return
        state = self.follower.state
        self.follower.leave()
        if self._goal is not None:  # where the controller has it not yet, once it has
            if self._goal[0] is not None:
                self._goal[0].cancel_goal_async()
        else:
            message = JointTrajectory(joint_names=list(self._names))
            if state is not None:  # newer controllers refuse to stop by a message of no points
                time, q = braking(state, self._braking, SHORTEST_STOP)
                put_trajectory(message, Trajectory(
                    self._names, np.array([time]), q[None], np.zeros((1, len(q)))))
            self._output.publish(message)
        self._leave(f'stopped: {why}')

    def _look(self) -> None:
        """See who else leads the controller."""
        self.crowded = self.crowd(self._output, 'command the controller', '')

    def verdict(self) -> tuple[bytes, str]:
        """Say what was refused, and who else leads the controller."""
        level, message = super().verdict()
        if self.follower is None:
            return level, message
        if self.crowded is not None:
            return self.crowded
        if level != OK:
            return level, message
        if self.held or self.collision:
            return WARN, 'a collision stopped the arm; free it, then call the service ~/reset'
        if not self._output.get_subscription_count():
            return WARN, f'no node hears {self._output.topic_name}; activate that controller'
        if self.refused:
            return WARN, f'trajectory refused: {self.refused}'
        return ((WARN, f'trajectory passed on unshaped, as {self.not_shaped}')
                if self.not_shaped else (level, message))

    def close(self) -> None:
        if self.follower is not None:
            self.server.destroy()
        if self._client is not None:
            self._client.destroy()
