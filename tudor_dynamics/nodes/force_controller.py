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

"""Node force_controller: holds a force of the tip, in place of reference_generator."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import partial
import sys
from typing import Any

from geometry_msgs.msg import WrenchStamped
import numpy as np
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from tudor_dynamics.arm.description import Arm, load_arm, refuse_interfaces
from tudor_dynamics.control.force_control import ForceController, ForceSettings, Phase
from tudor_dynamics.errors import ArmError, TudorError
from tudor_dynamics.models.bundle_io import load_bundle
from tudor_dynamics.nodes.common.base import ERROR, OK, TudorNode, WARN
from tudor_dynamics.nodes.common.interfaces import (
    JOINT_REFERENCE, RESET, RETREAT, TIP_FORCE, WANTED_FORCE)
from tudor_dynamics.nodes.common.messages import joint_state, NamedReader, nanoseconds
from tudor_dynamics.nodes.common.runner import run
from tudor_dynamics.online.contact_levers import StaticStrain
from tudor_dynamics.online.streams import StampGate

SILENT = 0.1
"""Strains that are older than positions by more are missing; a longer gap between positions is an
interruption [s]."""


class ForceControllerNode(LifecycleNodeMixin, TudorNode):
    """
    Force control node, a managed one because it commands motion; ``**kwargs`` go to rclpy's Node.

    Active, it answers every message of positions with a reference, which the damper takes as any
    other. Whatever goes wrong ends in a held pose until ``~/reset``.
    """

    def __init__(self, **kwargs: Any) -> None:
        TudorNode.__init__(self, 'force_controller', **kwargs)
        LifecycleNodeMixin.__init__(self)
        self.controller: ForceController | None = None
        self.gate = StampGate(SILENT)
        self.active = False
        self._phase = 'unconfigured'
        self._robot = ''
        self._inputs: list[Any] = []
        self._last: int | None = None
        self._reference = self.publish_on(JointState, JOINT_REFERENCE)
        self._told = self.publish_on(WrenchStamped, TIP_FORCE)
        self.serve(RESET, self._reset)
        self.serve(RETREAT, self._retreat)
        if self.value('autostart'):
            self.trigger_configure()
            if self.controller is not None:
                self.trigger_activate()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read arm and model, subscribe."""
        try:
            if not self.value('arm'):
                msg = 'no arm: set the parameter arm to a description with gauges and sensors'
                raise ArmError(msg)
            arm = load_arm(self.value('arm'))
            refuse_interfaces(arm, 'force control')
            sign = -1.0 if self.value('normal').startswith('-') else 1.0
            x, y, z = (sign * float(axis == self.value('normal')[-1]) for axis in 'xyz')
            names = ('approach_speed', 'reach', 'touch', 'integral', 'proportional', 'give',
                     'largest', 'lost')
            self.controller = ForceController(
                arm, ForceSettings(**{name: float(self.value(name)) for name in names}),
                (x, y, z))
            self._static = self._load_static(arm, (x, y, z))
        except TudorError as err:
            self.fault = str(err)
            self.get_logger().error(self.fault)
            return TransitionCallbackReturn.FAILURE
        self.fault = ''
        self._robot, self._arm = arm.name, arm
        self._joints = NamedReader(arm.active_joints, self.drops)
        self._strain = np.full(len(arm.gauges), np.nan)
        self._heard = np.full(len(arm.gauges), -np.inf)
        topics: dict[str, list[str]] = {}
        for gauge in arm.gauges:
            topics.setdefault(gauge.topic, []).append(gauge.name)
        self._readers = {
            topic: (NamedReader(names, self.drops), [arm.gauge_names.index(n) for n in names])
            for topic, names in topics.items()}
        own = arm.spec.joint_topic
        self._inputs = [self.subscribe(JointState, own, self._on_joints),
                        self.subscribe(Float64, WANTED_FORCE, self._on_wanted)]
        self._inputs += [self.subscribe(JointState, topic, partial(self._on_strains, topic))
                         for topic in topics if topic != own]
        self._phase = 'inactive'
        return TransitionCallbackReturn.SUCCESS

    def _load_static(self, arm: Arm, normal: tuple[float, float, float]) -> StaticStrain:
        if not self.value('model'):
            return StaticStrain(arm, None, normal)
        models = load_bundle(self.value('model'), arm=arm).beside_robot().models.get('strain', {})
        return StaticStrain(arm, models.get('elastic') or next(iter(models.values()), None),
                            normal)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to give references: the pose where the arm is."""
        if self.controller is None:
            return TransitionCallbackReturn.FAILURE
        self.gate.reset()
        self.active, self._phase = True, 'active'
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Give no more references: who commands the joints brakes and holds them."""
        if self.controller is not None:
            self.controller.stop('deactivated')
        self.active, self._phase = False, 'inactive'
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the arm."""
        for item in self._inputs:
            self.destroy_subscription(item)
        self._inputs, self.controller, self._phase = [], None, 'unconfigured'
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Give no more references, for good."""
        self.active, self._phase = False, 'finalized'
        self.end('shut down: no references are given any more')
        return TransitionCallbackReturn.SUCCESS

    def _reset(self) -> str:
        if self.controller is None:
            return 'nothing to reset yet'
        self.controller.clear()
        return 'forces are taken again'

    def _retreat(self) -> str:
        if self.controller is None:
            return 'nothing to leave yet'
        self.controller.retreat()
        return 'leaves the surface'

    def _on_wanted(self, message: Float64) -> None:
        if self.controller is None or not self.active:
            return
        if message.data <= 0.0:
            self.controller.retreat()
            return
        why = self.controller.press(float(message.data))
        if why:
            self.drops['force_refused'] += 1
            self.get_logger().error(f'force refused: {why}')

    def _on_strains(self, topic: str, message: JointState) -> None:
        reader, index = self._readers[topic]
        values = reader.read(message, 'position')
        if values is not None:
            self._strain[index] = values
            self._heard[index] = nanoseconds(message.header.stamp) * 1e-9

    def _on_joints(self, message: JointState) -> None:
        begun = self.meter.begin()
        controller = self.controller
        if not self.active or controller is None:
            return
        q = self._joints.read(message, 'position')
        if q is None:
            return
        if not np.isfinite(q).all():
            self.drops['not_finite'] += 1
            self.gate.unusable()
            return
        if self._arm.spec.joint_topic in self._readers:
            self._on_strains(self._arm.spec.joint_topic, message)
        stamp = nanoseconds(message.header.stamp)
        tick = self.gate.step(stamp)
        if tick is None:
            return
        pose = controller.pose if controller.pose is not None else q
        readings = self._static.at(pose, controller.force)
        silent = stamp * 1e-9 - self._heard > SILENT
        strain = np.where(silent, np.nan, self._strain) - readings.weight
        place, speed = controller.step(0.0 if tick.first else tick.dt, q, strain, readings.share)
        self._reference.publish(joint_state(
            message.header.stamp, list(self._arm.active_joints), position=place, velocity=speed))
        if self._told.get_subscription_count():
            wrench = WrenchStamped()
            wrench.header.stamp, wrench.header.frame_id = message.header.stamp, 'base'
            force = controller.sensing.normal * np.nan_to_num(controller.force)
            wrench.wrench.force.x, wrench.wrench.force.y, wrench.wrench.force.z = (
                float(value) for value in force)
            self._told.publish(wrench)
        self.meter.end(begun)

    def hardware(self) -> str:
        """Give the name of the robot, by default that of the arm."""
        return str(self.value('robot')) or self._robot or 'none'

    def counters(self) -> list[Counter[str]]:
        """Add the drops by stamps."""
        return [self.drops, self.gate.drops]

    def status(self) -> tuple[bytes, str, dict[str, str]]:
        """Tell phase, force, and why it is held."""
        level, message, values = super().status()
        values['phase'] = self._phase
        controller = self.controller
        if controller is None:
            return level, message, values
        values['state'] = controller.phase.name.lower()
        values['cause'] = controller.cause
        values['wanted [N]'] = f'{controller.wanted:.3g}'
        values['force [N]'] = f'{controller.force:.3g}'
        values['weight by'] = self._static.source
        if not self.active:
            return WARN, self.ended or self._phase, values
        if level != OK:
            return level, message, values
        if controller.phase is Phase.HELD:
            return (ERROR, f'{controller.cause}: the pose is held, ~/reset takes forces again',
                    values)
        if self._static.source == 'none':
            return WARN, ('nothing tells what gauges read of the weight: give model, or links in '
                          'the arm description'), values
        return OK, controller.cause, values


def main(args: Sequence[str] | None = None) -> int:
    """Run the node as a process."""
    return run(ForceControllerNode, args)


if __name__ == '__main__':
    sys.exit(main())
