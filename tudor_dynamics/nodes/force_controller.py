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

from collections.abc import Collection
from typing import Any

from geometry_msgs.msg import WrenchStamped
import numpy as np
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.kinematics import base_frame
from tudor_dynamics.control.force_control import ForceController, ForceSettings, Phase
from tudor_dynamics.models.bundle import load_bundle
from tudor_dynamics.nodes.common.base import ERROR, Figure, OK, WARN
from tudor_dynamics.nodes.common.interfaces import (
    JOINT_REFERENCE, RESET, RETREAT, TIP_FORCE, WANTED_FORCE)
from tudor_dynamics.nodes.common.messages import joint_state, nanoseconds, wrench_stamped
from tudor_dynamics.nodes.common.moving import MovingNode
from tudor_dynamics.nodes.settings import SILENT
from tudor_dynamics.online.contact_fronts import StaticStrain
from tudor_dynamics.typing import FloatArray


class ForceControllerNode(MovingNode):
    """Force control node."""

    # Active, it answers every message of positions with a reference, which the damper takes as any
    # other. Whatever goes wrong ends in a held pose until `~/reset`.

    FIGURES: tuple[Figure, ...] = (
        Figure('state', lambda controller: controller.phase.name.lower(), 'controller'),
        Figure('cause', lambda controller: controller.cause, 'controller'),
        Figure('wanted [N]', lambda controller: f'{controller.wanted:.3g}', 'controller'),
        Figure('force [N]', lambda controller: f'{controller.force:.3g}', 'controller'),
        Figure('weight by', lambda node: node.controller and node.static.source))
    ending = 'the node was shut down and sends no references; start the node again'

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('force_controller', SILENT, **kwargs)
        self.controller: ForceController | None = None
        self._reference = self.publish_on(JointState, JOINT_REFERENCE)
        self._tip_force = self.publish_on(WrenchStamped, TIP_FORCE)
        self.serve(RESET, self._reset)
        self.serve(RETREAT, self._retreat)
        self.autostart()

    def build(self) -> tuple[Arm, Collection[str]]:
        """Make the controller, and what knows the weight of the arm."""
        arm = self.described_arm("the keys 'gauges' and 'sensors'", 'force control')
        sign = -1.0 if self.value('normal').startswith('-') else 1.0
        x, y, z = (sign * float(axis == self.value('normal')[-1]) for axis in 'xyz')
        names = ('approach_speed', 'reach', 'touch', 'integral', 'proportional', 'give',
                 'largest', 'lost')
        self.controller = ForceController(
            arm, ForceSettings(**{name: float(self.value(name)) for name in names}), (x, y, z))
        models = {} if not self.value('model') else load_bundle(
            self.value('model'), arm=arm).beside_robot().models.get('strain', {})
        self.static = StaticStrain(
            arm, models.get('elastic') or next(iter(models.values()), None), (x, y, z))
        self._base = base_frame(arm.full_model)
        return arm, arm.gauge_names

    def subscribe_inputs(self) -> list[Subscription]:
        return [self.subscribe(Float64, WANTED_FORCE, self._on_wanted)]

    def stop(self) -> None:
        """Give no more references: who commands the joints brakes and holds them."""
        if self.controller is not None:
            self.controller.stop('deactivated')

    def _reset(self) -> str:
        if self.controller is None:
            return 'not configured yet: there is nothing to reset'
        self.controller.clear()
        return f'accepts forces on {WANTED_FORCE} again'

    def _retreat(self) -> str:
        if self.controller is None:
            return 'not configured yet: the tip touches no surface'
        self.controller.retreat()
        return 'the tip leaves the surface'

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

    def answer(
        self, controller: ForceController, message: JointState, dt: float, q: FloatArray,
    ) -> None:
        """Give a reference, and say what force the tip bears."""
        pose = controller.pose if controller.pose is not None else q
        weight, share = self.static.at(pose, controller.force)
        silent = nanoseconds(message.header.stamp) * 1e-9 - self._read > SILENT
        strain = np.where(silent, np.nan, self._strain) - weight
        place, speed = controller.step(dt, q, strain, share)
        self._reference.publish(joint_state(
            message.header.stamp, list(self._joints.names), position=place, velocity=speed))
        if self._tip_force.get_subscription_count():
            force = controller.sensing.normal * np.nan_to_num(controller.force)
            self._tip_force.publish(wrench_stamped(message.header.stamp, self._base, force))

    def verdict(self) -> tuple[bytes, str]:
        """Say why the pose is held."""
        level, message = super().verdict()
        controller = self.controller
        if controller is None or level != OK:
            return level, message
        if controller.phase is Phase.HELD:
            return ERROR, f'{controller.cause}; the arm stands until you call the service ~/reset'
        if self.static.source == 'none':
            return WARN, ('the weight of the arm in the gauge readings is unknown; set the '
                          "parameter 'model', or add the key 'links' to the arm description")
        return OK, controller.cause
