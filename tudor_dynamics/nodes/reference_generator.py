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

from concurrent.futures import ThreadPoolExecutor
from functools import partial
import sys
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import InertiaStamped
import numpy as np
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from trajectory_msgs.msg import JointTrajectory

from tudor_dynamics.control.damper import STRAIN_SCALE
from tudor_dynamics.control.references import ReferenceSource, Tolerances, yielding_speed
from tudor_dynamics.control.schedule import load_schedule
from tudor_dynamics.control.shaped_motion import Shaping
from tudor_dynamics.errors import TudorError
from tudor_dynamics.models.bundle_io import load_bundle
from tudor_dynamics.models.tuning import refiner_of
from tudor_dynamics.nodes.common.base import Figure, latched, OK, TudorNode, WARN
from tudor_dynamics.nodes.common.interfaces import (
    COLLISION, DIAGNOSTICS, JOINT_REFERENCE, JOINT_TRAJECTORY, PAYLOAD_TOPIC, RESET, RESIDUALS)
from tudor_dynamics.nodes.common.messages import (
    joint_state, NamedReader, nanoseconds, trajectory_of)
from tudor_dynamics.nodes.common.runner import run
from tudor_dynamics.nodes.settings import ALIVE, MONITORS_LOOK


class ReferenceGeneratorNode(TudorNode):
    """
    Reference node; ``**kwargs`` go to rclpy's Node.

    It begins where the joints are: nothing is published before the first joint states.
    """

    FIGURES: tuple[Figure, ...] = (
        Figure('reaction', lambda node: node.value('reaction')),
        Figure('shaping', lambda source: source.shaping.kind, 'source'),
        Figure('not shaped', lambda source: source.shaping.note or None, 'source'),
        Figure('monitors', lambda node: node.source and (', '.join(node.monitors) or 'none')),
        Figure('trajectory', lambda source: _progress(source), 'source'),
        Figure('begun again', lambda source: source.note or None, 'source'))

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('reference_generator', **kwargs)
        self.source: ReferenceSource | None = None
        self._last: int | None = None
        self._heard: dict[str, tuple[float, bool]] = {}
        self.monitors: list[str] = []
        self._unwatched = ''
        self._output = self.publish_on(JointState, JOINT_REFERENCE)
        self.serve(RESET, self._reset)
        try:
            self._arm = self.described_arm('limits')
            self.source = ReferenceSource(
                self._arm, self.value('reaction'), self.value('retreat_time'),
                self.value('timeout'), self._shaping())
        except TudorError as err:
            self.fail(err)
            return
        arm = self._arm
        self.robot = arm.name
        self.apply()
        if self.value('mode') == 'aprbs':
            self.source.wander(self.value('seed'))
        self._names = list(arm.active_joints)
        self._joints = NamedReader(self._names, self.drops)
        self._residuals = NamedReader(arm.gauge_names, self.drops)
        self._inputs = [
            self.subscribe(JointState, arm.spec.joint_topic, self._on_joints),
            self.subscribe(JointTrajectory, JOINT_TRAJECTORY, self._on_goal),
            self.subscribe(JointState, RESIDUALS['strain'], self._on_residuals),
            self.create_subscription(Bool, COLLISION, self._on_collision, latched()),
            self.create_subscription(
                InertiaStamped, PAYLOAD_TOPIC, self._on_payload, latched()),
            self.create_subscription(
                DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, QoSProfile(depth=20))]
        self._step_timer = self.create_timer(1.0 / self.value('rate'), self._step)
        self._look()
        self._look_timer = self.every(MONITORS_LOOK, self._look)

    def _shaping(self) -> Shaping:
        path, model = self.value('gain_schedule'), self.value('model')
        shaping = Shaping(
            self.value('shaping'), load_schedule(path, self._arm) if path else None,
            self.value('shaping_frequency'), self.value('shaping_damping'))
        if model and shaping.kind == 'elastic':
            bundle = load_bundle(model, arm=self._arm).beside_robot()
            shaping.refine = refiner_of(self._arm, bundle)
            shaping.beside = ThreadPoolExecutor(1)
        return shaping

    def apply(self) -> None:
        """Take changed reactions and times into use."""
        if self.source is not None:
            self.source.configure(self.value('reaction'), self.value('retreat_time'))
            self.source.timeout = self.value('timeout')
            self.source.partial = self.value('allow_partial_joints_goal')
            self.source.tolerances = Tolerances(
                self.value('path_tolerance'), self.value('goal_tolerance'),
                self.value('goal_time'))

    def _reset(self) -> str:
        if self.source is None:
            return 'nothing to reset yet'
        self.source.reset(self.steady())
        return 'goals are taken again'

    def _on_joints(self, message: JointState) -> None:
        begun = self.meter.begin()
        assert self.source is not None
        q = self._joints.read(message, 'position')
        if q is None or not np.isfinite(q).all():
            return
        self.source.measured(self.steady(), q)
        self.meter.end(begun)

    def _on_goal(self, message: JointTrajectory) -> None:
        assert self.source is not None
        if not message.points:  # controllers stop at this
            self.source.stop()
            return
        stamp = nanoseconds(message.header.stamp)
        since = 1e-9 * (self.get_clock().now().nanoseconds - stamp) if stamp else 0.0
        try:
            why = self.source.take(trajectory_of(message), since)
        except TudorError as err:
            why = str(err)
        if why:
            self.drops['goal_refused'] += 1
            self.get_logger().error(f'goal refused: {why}')

    def _on_payload(self, message: InertiaStamped) -> None:
        assert self.source is not None
        mass = float(message.inertia.m)
        self.source.shaping.payload = mass if np.isfinite(mass) and mass >= 0.0 else None

    def _on_collision(self, message: Bool) -> None:
        assert self.source is not None
        falling = self.source.collision and not message.data
        self.source.collide(bool(message.data))
        if falling and self.value('resume'):
            self.source.clear()

    def _on_residuals(self, message: JointState) -> None:
        motion = None if self.source is None else self.source.motion
        if motion is None or motion.reaction != 'comply':
            return
        values = self._residuals.read(message, 'position')
        if values is None:
            return
        gain = float(self.value('comply_gain'))
        motion.yielding[:] = 0.0
        for joint, index, scale in self._feedback():
            motion.yielding[joint] = yielding_speed(float(values[index]), scale, gain)

    def _feedback(self) -> list[tuple[int, int, float]]:
        """Give for each joint the first gauge after it, with its unit per m/m."""
        found: dict[int, tuple[int, int, float]] = {}
        for index, gauge in enumerate(self._arm.gauges):
            if gauge.joint in self._names and gauge.unit in STRAIN_SCALE:
                joint = self._names.index(gauge.joint)
                found.setdefault(joint, (joint, index, STRAIN_SCALE[gauge.unit]))
        return list(found.values())

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name, _, namespace = status.name.partition(': ')
            if namespace.startswith('/'):
                able = status.level in (OK, WARN)
                self._heard[f'{namespace.rstrip("/")}/{name}'] = (self.steady(), able)

    def _look(self) -> None:
        """See who publishes collisions, and whether they are alive."""
        assert self.source is not None
        self.monitors = self.publishing(self.resolve_topic_name(COLLISION))
        now = self.steady()
        heard = [self._heard.get(name) for name in self.monitors]
        alive = [item for item in heard if item is not None and now - item[0] < ALIVE]
        if any(able for _, able in alive):
            self._unwatched = ''
        elif alive:
            self._unwatched = 'the monitor says that it cannot judge the arm'
        elif self.monitors:
            self._unwatched = f'{", ".join(self.monitors)} gives no sign of life'
        else:
            self._unwatched = f'nobody publishes {COLLISION}'
        self.source.halt(self._unwatched if self.value('require_monitor') else '')
        self._heard = {name: item for name, item in self._heard.items() if now - item[0] < 60.0}

    def _step(self) -> None:
        source = self.source
        assert source is not None
        stamp = self.get_clock().now()
        now = int(stamp.nanoseconds)
        last, self._last = self._last, now
        if last is None or now <= last:
            return
        reference = source.step(self.steady(), (now - last) * 1e-9)
        if reference is not None:
            q, dq = reference
            self._output.publish(joint_state(stamp.to_msg(), self._names, position=q, velocity=dq))

    def verdict(self) -> tuple[bytes, str]:
        """Say whether goals are taken, and whether anybody watches the arm."""
        level, message = super().verdict()
        source = self.source
        if source is None or level != OK:
            return level, message
        if source.reacting or source.collision:
            return WARN, f'collision: {self.value("reaction")}; ~/reset takes goals again'
        if source.halted:
            return WARN, f'no goals are taken: {source.halted}'
        if len(self.monitors) > 1:
            return WARN, (f'{len(self.monitors)} nodes publish {COLLISION}: '
                          f'{", ".join(self.monitors)}')
        if self._unwatched and self.monitors:
            return WARN, f'nobody watches for collisions any more: {self._unwatched}'
        return level, message


def _progress(source: ReferenceSource) -> str | None:
    progress = None if source.motion is None else source.motion.follower.progress
    if progress is None:
        return source.outcome or None
    time, end = progress
    return f'begins in {-time:.1f} s' if time < 0.0 else f'{time:.1f} of {end:.1f} s'


main = partial(run, ReferenceGeneratorNode)


if __name__ == '__main__':
    sys.exit(main())
