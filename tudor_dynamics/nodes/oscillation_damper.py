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

"""Node oscillation_damper: reference, positions and strains in, velocity commands out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
import time
from typing import Any

from geometry_msgs.msg import InertiaStamped
import numpy as np
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.control.damper import MEANING, SEEN, STATUS, Status
from tudor_dynamics.control.motion_controller import MotionController, State
from tudor_dynamics.control.schedule import Adaptation, load_schedule
from tudor_dynamics.control.settings import WATCH_PERIOD
from tudor_dynamics.errors import UsageError
from tudor_dynamics.nodes.common.base import ClockWatch, ERROR, Figure, latched, STALE, WARN
from tudor_dynamics.nodes.common.interfaces import (
    JOINT_REFERENCE, JOINTS_TESTED, PAYLOAD_TOPIC, RESET, VELOCITY_COMMANDS)
from tudor_dynamics.nodes.common.messages import floats, NamedReader
from tudor_dynamics.nodes.common.moving import MovingNode
from tudor_dynamics.nodes.settings import BRAKING, LONGEST_GAP, PUBLISHERS_LOOK
from tudor_dynamics.online.coverage import ALSO
from tudor_dynamics.typing import FloatArray


def _since(now: Counter[str], before: Counter[str]) -> dict[str, str]:
    """Give what has been counted since the last diagnosis, which then is this one."""
    since = now - before
    before.clear()
    before.update(now)
    return {cause: str(count) for cause, count in sorted(since.items())}


class OscillationDamperNode(MovingNode):
    """Damper node."""

    # Active, it answers every message of positions with commands. Where positions fail to come for
    # `timeout`, at deactivation and at the end it brakes to standstill.

    FIGURES: tuple[Figure, ...] = (
        Figure('state', lambda controller: controller.state.name.lower(), 'controller'),
        Figure('cause', lambda controller: controller.cause, 'controller'),
        Figure('loop delay [ms]', lambda controller: 'unknown until motion' if (
            delay := controller.gains.delay.delay) is None else f'{1e3 * delay:.1f}',
            'controller'),
        Figure('age of stamps [ms]', lambda node: node.controller and node.clocks.text()),
        Figure('damping in use', lambda controller: '{:.2f}'.format(
            controller.gains.share * controller.gains.allowed_share), 'controller'),
        Figure('position gain in use [1/s]', lambda controller: '{:.2f}'.format(
            controller.gains.position_gain_in_use), 'controller'),
        Figure('', lambda controller: controller.adaptation and controller.adaptation.report(),
               'controller'),
        Figure('cut: CAUSE', lambda node: node.controller and _since(
            node.controller.cuts, node.reported_cuts)),
        Figure('refused: CAUSE', lambda node: node.controller and _since(
            node.controller.reference.refused, node.reported_refusals)),
        Figure('ahead of commands [rad], JOINT', lambda controller: dict(zip(
            controller.joints, controller.watched.report(), strict=True)), 'controller'),
        Figure('damper JOINT', lambda controller: dict(zip(
            controller.damper.joints, controller.damper.report(), strict=True)), 'controller'))
    feels = True
    ending = 'the node was shut down, and the joints brake to standstill; start the node again'

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('oscillation_damper', LONGEST_GAP, **kwargs)
        self.controller: MotionController | None = None
        self.clocks = ClockWatch()
        self._faults: dict[int, Status] = {}
        self._drivers: set[bytes] = set()  # publishers of the positions that were answered
        self.reported_cuts: Counter[str] = Counter()
        self.reported_refusals: Counter[str] = Counter()
        self._output = self.publish_on(Float64MultiArray, VELOCITY_COMMANDS)
        self.serve(RESET, self._reset)
        self.serve(JOINTS_TESTED, self._tested)
        self._watchdog = self.every(WATCH_PERIOD, self._watch)
        self._look_timer = self.every(PUBLISHERS_LOOK, self._look)
        self.autostart()

    def build(self) -> tuple[Arm, Collection[str]]:
        arm = self.described_arm("the key 'damper'", 'the damper')
        controller = MotionController(arm)
        if self.value('gain_schedule'):
            controller.adaptation = Adaptation(
                load_schedule(self.value('gain_schedule'), arm), controller.planned.acceleration)
        for text in controller.limits.missing:
            self.get_logger().warning(f'{text} is described; add it to joints[].limits')
        self.controller = controller
        self._references = NamedReader(controller.joints, self.drops)
        return arm, controller.damper.gauges

    def subscribe_inputs(self) -> list[Subscription]:
        return [self.subscribe(JointState, JOINT_REFERENCE, self._on_reference),
                self.create_subscription(InertiaStamped, PAYLOAD_TOPIC, self._on_payload,
                                         latched())]

    def begin(self) -> None:
        """Hold the arm where it is."""
        self._reset()

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Brake to standstill, then forget the arm."""
        self._brake_down()
        return super().on_cleanup(state)

    def apply(self) -> None:
        if self.controller is None:
            return
        self.controller.gains.share = self.value('damping')
        self.controller.timeout = self.value('timeout')
        self.controller.required = self.value('require_joint_test')
        if self.controller.adaptation is not None:
            self.controller.adaptation.timeout = self.value('payload_timeout')
        self.controller.gains.asked = self.value('position_gain')

    def _reset(self) -> str:
        if self.controller is None or not self.controller.reset():
            self.gate.reset()
            self.clocks.reset()
        self._faults = {}
        return 'the arm holds its pose, and the damper fades in again'

    def _tested(self) -> str:
        if self.controller is None or not self.active:
            raise UsageError('the damper is not active', remedy='activate it and test again')
        self.controller.tested, self._drivers = True, self._origins()
        return 'follows any reference until the driver of the arm restarts'

    def _origins(self) -> set[bytes]:
        """Give what distinguishes a publisher of positions from its successor."""
        return {bytes(info.endpoint_gid) for info in self.get_publishers_info_by_topic(
            self.resolve_topic_name(self._own))}

    def _on_reference(self, message: JointState) -> None:
        q = self._references.read(message, 'position')
        dq = self._references.read(message, 'velocity')
        if q is not None and dq is not None and self.controller is not None:
            self.controller.reference.add(self.steady(), q, dq)

    def _on_payload(self, message: InertiaStamped) -> None:
        adaptation = None if self.controller is None else self.controller.adaptation
        if adaptation is not None and adaptation.tell(self.steady(), float(message.inertia.m)):
            self.drops['payload_refused'] += 1

    def stamped(self, stamp: int) -> None:
        """Compare stamps with the clock."""
        self.clocks.step(stamp, self.ros_time())

    def answer(
        self, controller: MotionController, message: JointState, dt: float, q: FloatArray,
    ) -> None:
        if controller.missing and self._drivers and self._origins() - self._drivers:
            controller.distrust()
            self._drivers = set()
        before = controller.state
        command = controller.step(
            self.steady(), dt, q, self._strain, self._fresh,
            age=self.clocks.newest, dq=self._joints.read(message, 'velocity', optional=True),
            effort=self._effort)
        self._publish(command)
        state = controller.damper.state
        for place in np.flatnonzero((state[:, STATUS] >= Status.MISSING) & (state[:, SEEN] > 0)):
            # a jump is over before anybody looks: remembered until the gauge is trusted again
            self._faults[int(place)] = controller.damper.status[place]
        period = round(1e9 * controller.watch_period)
        if abs(period - self._watchdog.timer_period_ns) > 0.05 * period:
            self._watchdog.timer_period_ns = period
        self._watchdog.reset()  # it is due only where no sample comes
        self._drivers = self._drivers or self._origins()
        if controller.state is not before:  # once the command is out
            self._look()

    def _publish(self, command: Any) -> bool:
        if command is not None:
            self._output.publish(Float64MultiArray(data=floats(command)))
        return command is not None

    def _watch(self) -> None:
        """Brake where positions fail to come, and after a deactivation."""
        controller = self.controller
        if controller is not None:
            now = self.steady()
            self._publish(controller.watch(now) if self.active else controller.stand_still(now))

    def _brake_down(self) -> None:
        """Brake to standstill before going on; for the end of a process."""
        controller = self.controller
        end = time.monotonic() + BRAKING
        while controller is not None and self.context.ok() and time.monotonic() < end:
            if not self._publish(controller.stand_still(self.steady())):
                break
            time.sleep(WATCH_PERIOD)

    def verdict(self) -> tuple[bytes, str]:
        """Say what matters most; docs/explanation/safety.md has causes, remedies and tests."""
        level, message = super().verdict()
        controller = self.controller
        if controller is None or not self.active:
            return level, message
        crowded = self.crowded if self.crowded and self.crowded[0] == ERROR else None
        if controller.state is State.FAULT:
            cause = f'{crowded[1]}. If that is not the reason: ' if crowded else ''
            return ERROR, (f'{cause}{controller.cause}; the joints stand still until you call the '
                           'service ~/reset')
        if clock := self.clocks.fault():
            return ERROR, f'{self._own}: {clock}'
        if controller.blind:
            return STALE, (f'no joint positions arrive on {self._own}, so no commands are sent; '
                           'start the driver of the arm')
        if controller.missing:
            return STALE, (f'{self._own}: {controller.cause}; until then the damper commands '
                           'standstill')
        if crowded:
            return crowded
        gains = controller.gains
        if gains.excited:
            return ERROR, (f'the damper is off, as {gains.excited}; run damper_sign_test, lower '
                           'damper.joints[].gain, then call the service ~/reset')
        if bad := self._gauge_faults(controller):
            return ERROR, ALSO.join(bad)
        if self.crowded:
            return self.crowded
        if controller.state is State.HOLDING:
            return (STALE if controller.unreferenced else WARN,
                    f'the joints are held: {controller.cause}')
        delay = f'{1e3 * (gains.assumed_delay + gains.late):.0f} ms'
        if gains.allowed_share < 1.0:
            off = 'is off' if gains.allowed_share == 0.0 else 'acts with reduced gain'
            return WARN, (f'the damper {off}, as joints answer after {delay} (limit '
                          f'{1e3 * gains.full_delay:.0f} ms); speed up driver and network')
        gain = gains.position_gain_in_use
        if gain < gains.position_gain:
            return WARN, (f'joints answer after {delay}, so the position gain is {gain:.2g} per s '
                          f'in place of {gains.position_gain:g}; speed up driver and network')
        adaptation = controller.adaptation
        if adaptation is not None and not adaptation.known(self.steady()):
            return WARN, f'gains do not follow the load, as {adaptation.unknown}'
        if note := controller.reference.refusal or self.clocks.offset(self._own):
            return WARN, note
        if (limits := controller.limits).missing:
            return WARN, ALSO.join(f'{x}; add it to joints[].limits' for x in limits.missing)
        return level, message

    def _look(self) -> None:
        """Count who commands the arm, and who says where it is: of each there may be one."""
        crowded = self.crowd(self._output, 'command the joints', self.robot and self._own)
        # who could command them at a fault may have left: it is said until the reset
        if not (self.controller and self.controller.state is State.FAULT) or (
                crowded and crowded[0] == ERROR):
            self.crowded = crowded
        self.notice()

    def _gauge_faults(self, controller: MotionController) -> list[str]:
        """Name the gauges that are not trusted, and why; forget those that are again."""
        damper = controller.damper
        faults = self._faults | {place: status for place, status in enumerate(damper.status)
                                 if status >= Status.MISSING}
        texts = [f'{damper.joints[place]}, gauge {damper.gauges[place]}: {MEANING[fault]}'
                 for place, fault in faults.items()]
        self._faults = {place: fault for place, fault in self._faults.items()
                        if damper.status[place] not in (Status.DAMPING, Status.SATURATED)}
        return texts

    def close(self) -> None:
        """Leave the joints at standstill."""
        self.active = False
        self._brake_down()
