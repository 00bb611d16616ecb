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

from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import InertiaStamped
import numpy as np
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.control.damper import STRAIN_SCALE
from tudor_dynamics.control.references import ReferenceSource, Tolerances, yielding_speed
from tudor_dynamics.control.schedule import load_schedule
from tudor_dynamics.control.shaped_motion import Shaping
from tudor_dynamics.errors import TudorError
from tudor_dynamics.models.bundle import load_bundle
from tudor_dynamics.models.tuning import refiner_of
from tudor_dynamics.nodes.common.base import ERROR, Figure, latched, OK, WARN
from tudor_dynamics.nodes.common.following import FollowServer, since_start, tolerances_of
from tudor_dynamics.nodes.common.interfaces import (
    COLLISION, DIAGNOSTICS, JOINT_REFERENCE, JOINT_TRAJECTORY, PAYLOAD_TOPIC, RESET, RESIDUALS,
    STATE)
from tudor_dynamics.nodes.common.messages import floats, joint_state, NamedReader, trajectory_of
from tudor_dynamics.nodes.common.moving import MovingNode
from tudor_dynamics.nodes.settings import ALIVE, LONGEST_GAP, MONITORS_LOOK, STATE_PERIOD
from tudor_dynamics.typing import FloatArray


class ReferenceGeneratorNode(MovingNode):
    """Reference node; ``**kwargs`` go to rclpy's Node."""

    # It begins where the joints are: nothing is published before the first joint states. Where it
    # is deactivated it brakes, then publishes no more.

    FIGURES: tuple[Figure, ...] = (
        Figure('reaction', lambda node: node.value('reaction')),
        Figure('shaping', lambda source: source.shaping.kind, 'source'),
        Figure('not shaped', lambda source: source.shaping.note or None, 'source'),
        Figure('monitors', lambda node: node.source and (', '.join(node.monitors) or 'none')),
        Figure('trajectory', lambda source: _progress(source), 'source'),
        Figure('off the reference JOINT [rad]', lambda source: _off(source), 'source'),
        Figure('begun again', lambda source: source.note or None, 'source'))
    ending = 'the node was shut down, and the arm brakes to standstill; start the node again'

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('reference_generator', LONGEST_GAP, **kwargs)
        self._last: int | None = None
        self._heard: dict[str, tuple[float, bool]] = {}
        self.monitors: list[str] = []
        self._unwatched = ''
        self._speed: FloatArray | None = None
        self._output = self.publish_on(JointState, JOINT_REFERENCE)
        self._states = self.publish_on(JointTrajectory, STATE)
        self.serve(RESET, self._reset)
        self._step_timer = self.create_timer(1.0 / self.value('rate'), self._step)
        self._look_timer = self.every(MONITORS_LOOK, self._look)
        self._state_timer = self.every(STATE_PERIOD, self._report)
        self.server = FollowServer(
            self, lambda goal: self._take(goal.trajectory, goal), self._stop_goal)
        self.autostart()

    @property
    def source(self) -> ReferenceSource | None:
        """Source of the reference; None while it is not configured."""
        return self.controller

    def build(self) -> tuple[Arm, Collection[str]]:
        arm = self._arm = self.described_arm("the key 'limits'")
        path, model = self.value('gain_schedule'), self.value('model')
        shaping = Shaping(
            self.value('shaping'), load_schedule(path, arm) if path else None,
            self.value('shaping_frequency'), self.value('shaping_damping'))
        if model and shaping.kind == 'elastic':
            shaping.refine = refiner_of(arm, load_bundle(model, arm=arm).beside_robot())
            shaping.beside = ThreadPoolExecutor(1)
        source = ReferenceSource(arm, self.value('reaction'), self.value('retreat_time'),
                                 self.value('timeout'), shaping)
        if self.value('mode') == 'aprbs':
            source.wander(self.value('seed'))
        self._names = list(arm.active_joints)
        self._residuals = NamedReader(arm.gauge_names, self.drops)
        self.controller = source
        return arm, ()

    def subscribe_inputs(self) -> list[Subscription]:
        """Subscribe to goals, and to what says whether they may be taken."""
        return [
            self.subscribe(JointTrajectory, JOINT_TRAJECTORY, self._on_goal),
            self.subscribe(JointState, RESIDUALS['strain'], self._on_residuals),
            self.create_subscription(Bool, COLLISION, self._on_collision, latched()),
            self.create_subscription(
                InertiaStamped, PAYLOAD_TOPIC, self._on_payload, latched()),
            self.create_subscription(
                DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, QoSProfile(depth=20))]

    def begin(self) -> None:
        """Begin where the arm is."""
        super().begin()
        self._last = None
        self.apply()
        self._look()

    def stop(self) -> None:
        if self.source is not None:
            self.source.hold(f'{self.get_name()} was deactivated')
            self._report()

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        if self.source is not None and self.source.shaping.beside is not None:
            self.source.shaping.beside.shutdown(wait=False)
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Brake, for good."""
        self.stop()
        return super().on_shutdown(state)

    def apply(self) -> None:
        if self.source is not None:
            self.source.configure(self.value('reaction'), self.value('retreat_time'))
            self.source.timeout = self.value('timeout')
            self.source.partial = self.value('allow_partial_joints_goal')
            self.source.tolerances = Tolerances(
                self.value('path_tolerance'), self.value('goal_tolerance'),
                self.value('goal_time'))

    def _reset(self) -> str:
        if self.source is None:
            return 'not configured yet: there is nothing to reset'
        self.source.reset(self.steady())
        return 'accepts goals again'

    def _on_joints(self, message: JointState) -> None:
        begun = self.meter.begin()
        q = self._joints.read(message, 'position')
        if self.source is None or q is None or not np.isfinite(q).all():
            return
        self.source.measured(self.steady(), q)
        self._speed = self._joints.read(message, 'velocity', optional=True)
        self.meter.end(begun)

    def _on_goal(self, message: JointTrajectory) -> None:
        if not message.points:  # controllers stop at this
            self.controller.stop(f'a trajectory without points came on {JOINT_TRAJECTORY}')
        elif not self._take(message):
            self.server.end(f'a newer trajectory on {JOINT_TRAJECTORY} replaced this goal')

    def _take(self, message: JointTrajectory, goal: Any = None) -> str:
        """Take a trajectory, of a goal with its tolerances; give why not."""
        self._report()
        source, why = self.source, f'{self.get_name()} is {self.phase}'
        if source is not None and self.active:
            try:
                own = None if goal is None else tolerances_of(
                    goal, source.names, source.tolerances)
                why = source.take(trajectory_of(message), since_start(self, message), own)
            except TudorError as err:
                why = str(err)
        if why:
            self.drops['goal_refused'] += 1
            self.get_logger().error(f'goal refused: {why}')
        return why

    def _stop_goal(self, why: str) -> None:
        if self.source is not None:
            self.source.stop(why)

    def _report(self) -> None:
        """Publish how far the reference is, and end a goal that is over."""
        source = self.source
        if source is None:
            return
        if source.outcome:
            self.server.end(source.outcome)
        if source.motion is None:
            return
        wanted, progress = source.motion.state, source.motion.follower.progress
        elapsed = divmod(round(1e9 * progress[0]), 1_000_000_000) if progress else (0, 0)
        desired = {'positions': wanted.q, 'velocities': wanted.dq, 'accelerations': wanted.ddq}
        actual = {'positions': source.actual}
        if self._speed is not None:
            actual['velocities'] = self._speed
        error = {name: desired[name] - values for name, values in actual.items()}
        points = [JointTrajectoryPoint(
            time_from_start=Duration(sec=elapsed[0], nanosec=elapsed[1]),
            **{name: floats(values) for name, values in some.items()})
            for some in (desired, actual, error)]
        message = JointTrajectory(joint_names=self._names, points=points)
        message.header.stamp = self.get_clock().now().to_msg()
        self._states.publish(message)
        self.server.report(message.header, self._names, points)

    def _on_payload(self, message: InertiaStamped) -> None:
        mass = float(message.inertia.m)
        self.controller.shaping.payload = mass if np.isfinite(mass) and mass >= 0.0 else None

    def _on_collision(self, message: Bool) -> None:
        falling = self.controller.collision and not message.data
        self.controller.collide(bool(message.data))
        if falling and self.value('resume'):
            self.controller.clear()

    def _on_residuals(self, message: JointState) -> None:
        motion = None if self.source is None else self.source.motion
        if motion is None or motion.reaction != 'comply':
            return
        values = self._residuals.read(message, 'position')
        if values is None:
            return
        gain = float(self.value('comply_gain'))
        motion.yielding[:] = 0.0
        # backwards: of several gauges after a joint the first one counts
        for gauge, value in zip(self._arm.gauges[::-1], values[::-1].tolist(), strict=True):
            if gauge.joint in self._names and gauge.unit in STRAIN_SCALE:
                motion.yielding[self._names.index(gauge.joint)] = yielding_speed(
                    value, STRAIN_SCALE[gauge.unit], gain)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name, _, namespace = status.name.partition(': ')
            if namespace.startswith('/'):
                able = status.level in (OK, WARN)
                self._heard[f'{namespace.rstrip("/")}/{name}'] = (self.steady(), able)

    def _look(self) -> None:
        """See who leads the arm, who says where it is, and who publishes collisions."""
        if self.source is None:
            return
        self.crowded = self.crowd(self._output, 'send references', self._own)
        self.monitors = self.publishing(self.resolve_topic_name(COLLISION))
        now = self.steady()
        heard = [self._heard.get(name) for name in self.monitors]
        alive = [item for item in heard if item is not None and now - item[0] < ALIVE]
        names = ', '.join(self.monitors)
        if any(able for _, able in alive):
            self._unwatched = ''
        elif alive:
            self._unwatched = f'{names} cannot detect collisions; see the diagnostics of {names}'
        elif self.monitors:
            self._unwatched = f'no diagnostics come from {names} any more; start {names} again'
        else:
            self._unwatched = f'no node publishes the topic {COLLISION!r}; start the node monitor'
        self.source.halt(self._unwatched if self.value('require_monitor') else '')
        self._heard = {name: item for name, item in self._heard.items() if now - item[0] < 60.0}

    def _step(self) -> None:
        source = self.source
        if source is None:
            return
        if not self.active and not (source.motion and source.motion.moving):
            source.motion = None  # it has braked
            return
        stamp = self.get_clock().now()
        now = int(stamp.nanoseconds)
        last, self._last = self._last, now
        if last is None or now <= last:
            return
        reference = source.step(self.steady(), (now - last) * 1e-9)
        if reference is not None:
            q, dq = reference
            self._output.publish(joint_state(stamp.to_msg(), self._names, position=q, velocity=dq))

    def close(self) -> None:
        self.server.destroy()

    def verdict(self) -> tuple[bytes, str]:
        """Say whether goals are taken, and whether anybody watches the arm."""
        level, message = super().verdict()
        source = self.source
        if source is None or not self.active:
            return level, message
        if self.crowded is not None and self.crowded[0] == ERROR:
            return self.crowded
        if level != OK:
            return level, message
        if source.reacting or source.collision:
            return WARN, (f'the node accepts no goals after a collision (reaction: '
                          f'{self.value("reaction")}); free the arm and call the service ~/reset')
        if source.halted:
            return WARN, f'the node accepts no goals, as {source.halted}'
        if self.crowded is not None:
            return self.crowded
        if len(self.monitors) > 1:
            return WARN, (f'the topic {COLLISION!r} has {len(self.monitors)} publishers, in nodes '
                          f'{", ".join(self.monitors)}; stop all but the one of this arm')
        if self._unwatched and self.monitors:
            return WARN, f'collisions are not detected any more, as {self._unwatched}'
        return level, message


def _progress(source: ReferenceSource) -> str | None:
    progress = None if source.motion is None else source.motion.follower.progress
    if progress is None:
        return source.outcome or None
    time, end = progress
    return f'begins in {-time:.1f} s' if time < 0.0 else f'{time:.1f} of {end:.1f} s'


def _off(source: ReferenceSource) -> dict[str, str] | None:
    if source.motion is None:
        return None
    return {name: f'{off:.4f}' for name, off in zip(
        source.names, np.abs(source.motion.q - source.actual), strict=True)}
