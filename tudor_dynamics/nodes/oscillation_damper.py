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
from collections.abc import Callable, Sequence
from functools import partial
import sys
import time
from typing import Any

from geometry_msgs.msg import InertiaStamped
import numpy as np
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from tudor_dynamics.arm.description import load_arm, refuse_interfaces
from tudor_dynamics.control.damper import MEANING, SEEN, STATUS, Status
from tudor_dynamics.control.gains import Adaptation, load_schedule
from tudor_dynamics.control.motion_controller import MotionController, State, WATCH
from tudor_dynamics.errors import ArmError, TudorError
from tudor_dynamics.nodes.common.base import ClockWatch, ERROR, latched, STALE, TudorNode, WARN
from tudor_dynamics.nodes.common.interfaces import (
    JOINT_REFERENCE, PAYLOAD_TOPIC, RESET, VELOCITY_COMMANDS)
from tudor_dynamics.nodes.common.messages import floats, NamedReader, nanoseconds
from tudor_dynamics.nodes.common.runner import run
from tudor_dynamics.online.streams import StampGate

BRAKING = 2.0
"""A process that ends waits no longer than this for the arm to stand [s]."""
LONGEST_GAP = 60.0
"""The controller says itself what an interruption is; this is for clocks that are set [s]."""


class OscillationDamperNode(LifecycleNodeMixin, TudorNode):
    """
    Damper node, a managed one because it commands motion; ``**kwargs`` go to rclpy's Node.

    Active, it answers every message of positions with commands. Where positions fail to come for
    ``timeout``, at deactivation and at the end it brakes to standstill.
    """

    def __init__(self, **kwargs: Any) -> None:
        TudorNode.__init__(self, 'oscillation_damper', **kwargs)
        LifecycleNodeMixin.__init__(self)
        self.controller: MotionController | None = None
        self.gate = StampGate(LONGEST_GAP)
        self.clocks = ClockWatch()
        self.ros_time: Callable[[], int] = lambda: int(self.get_clock().now().nanoseconds)
        self.active = False
        self._phase = 'unconfigured'
        self._strain = np.zeros(0)
        self._fresh = np.zeros(0, dtype=bool)
        self._gauges: dict[str, tuple[NamedReader, list[int]]] = {}
        self._faults: dict[int, Status] = {}
        self._cuts: Counter[str] = Counter()
        self._refused: Counter[str] = Counter()
        self._output = self.publish_on(Float64MultiArray, VELOCITY_COMMANDS)
        self.serve(RESET, self._reset)
        self._inputs: list[Any] = []
        self._watchdog = self.every(WATCH, self._watch)
        if self.value('autostart'):
            self.trigger_configure()
            if self.controller is not None:
                self.trigger_activate()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the arm, subscribe."""
        try:
            if not self.value('arm'):
                msg = 'no arm: set the parameter arm to a description with a damper'
                raise ArmError(msg)
            arm = load_arm(self.value('arm'))
            refuse_interfaces(arm, 'the damper')
            controller = MotionController(arm)
            if self.value('gain_schedule'):
                controller.adaptation = Adaptation(
                    load_schedule(self.value('gain_schedule'), arm),
                    controller.planned.acceleration)
            self.controller = controller
        except TudorError as err:
            self.fault = str(err)
            self.get_logger().error(self.fault)
            return TransitionCallbackReturn.FAILURE
        self.fault = ''
        self._robot = arm.name
        for text in self.controller.limits.missing:
            self.get_logger().warning(f'{text}; nothing bounds it: add it to limits: of the joint')
        self.apply()
        self._joints = NamedReader(self.controller.joints, self.drops)
        self._references = NamedReader(self.controller.joints, self.drops)
        self._strain = np.full(len(arm.gauges), np.nan)
        self._fresh = np.zeros(len(arm.gauges), dtype=bool)
        wanted: dict[str, list[str]] = {}
        for gauge in arm.gauges:
            if gauge.name in self.controller.damper.gauges:
                wanted.setdefault(gauge.topic, []).append(gauge.name)
        self._gauges = {
            topic: (NamedReader(names, self.drops), [arm.gauge_names.index(n) for n in names])
            for topic, names in wanted.items()}
        self._own = arm.spec.joint_topic
        self._inputs = [self.subscribe(JointState, self._own, self._on_joints),
                        self.subscribe(JointState, JOINT_REFERENCE, self._on_reference)]
        self._inputs += [self.subscribe(JointState, topic, partial(self._on_strains, topic))
                         for topic in wanted if topic != self._own]
        self._inputs.append(self.create_subscription(
            InertiaStamped, PAYLOAD_TOPIC, self._on_payload, latched()))
        self._phase = 'inactive'
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to command: hold the arm where it is."""
        if self.controller is None:
            return TransitionCallbackReturn.FAILURE
        self._reset()
        self.active, self._phase = True, 'active'
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Brake to standstill, then command nothing."""
        self.active, self._phase = False, 'inactive'
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the arm."""
        self._brake_down()
        for item in self._inputs:
            self.destroy_subscription(item)
        self._inputs, self.controller, self._phase = [], None, 'unconfigured'
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Brake to standstill, for good."""
        self.active, self._phase = False, 'finalized'
        self.end('shut down: the joints are braked to standstill, and no more is commanded')
        return TransitionCallbackReturn.SUCCESS

    def apply(self) -> None:
        """Take changed gains and the timeout into use."""
        if self.controller is None:
            return
        self.controller.gains.share = self.value('damping')
        self.controller.timeout = self.value('timeout')
        if self.controller.adaptation is not None:
            self.controller.adaptation.timeout = self.value('payload_timeout')
        self.controller.gains.set_position_gain(self.value('position_gain'))

    def _reset(self) -> str:
        if self.controller is not None:
            self.controller.reset()
        self.gate.reset()
        self.clocks.reset()
        self._faults = {}
        return 'the arm is held, and the damper fades in anew'

    def _on_strains(self, topic: str, message: JointState) -> None:
        reader, index = self._gauges[topic]
        values = reader.read(message, 'position')
        if values is not None:
            self._strain[index], self._fresh[index] = values, True

    def _on_reference(self, message: JointState) -> None:
        q = self._references.read(message, 'position')
        dq = self._references.read(message, 'velocity')
        if q is not None and dq is not None and self.controller is not None:
            self.controller.reference.add(self.steady(), q, dq)

    def _on_payload(self, message: InertiaStamped) -> None:
        if self.controller is not None and self.controller.adaptation is not None:
            if self.controller.adaptation.tell(self.steady(), float(message.inertia.m)):
                self.drops['payload_refused'] += 1

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
        if self._own in self._gauges:
            self._on_strains(self._own, message)
        stamp = nanoseconds(message.header.stamp)
        self.clocks.step(stamp, self.ros_time())
        tick = self.gate.step(stamp)
        if tick is None:
            return
        command = controller.step(self.steady(), tick.dt, q, self._strain, self._fresh)
        self._fresh[:] = False
        state = controller.damper.state
        for place in np.flatnonzero((state[:, STATUS] >= Status.MISSING) & (state[:, SEEN] > 0)):
            # a jump is over before anybody looks: remembered until the gauge is trusted again
            self._faults[int(place)] = controller.damper.status[place]
        self._publish(command)
        self.meter.end(begun)

    def _publish(self, command: Any) -> bool:
        if command is not None:
            self._output.publish(Float64MultiArray(data=floats(command)))
        return command is not None

    def _watch(self) -> None:
        """Brake where positions fail to come, and behind a deactivation."""
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
            time.sleep(WATCH)

    def hardware(self) -> str:
        """Give the name of the robot, by default that of the arm."""
        return str(self.value('robot')) or getattr(self, '_robot', '') or 'none'

    def counters(self) -> list[Counter[str]]:
        """Add the drops by stamps."""
        return [self.drops, self.gate.drops]

    def status(self) -> tuple[bytes, str, dict[str, str]]:
        """Tell what the joints do, what the loop is like, and what the damper makes of it."""
        level, message, values = super().status()
        controller = self.controller
        values['phase'] = self._phase
        if controller is None:
            return level, message, values
        values['state'] = controller.state.name.lower()
        values['cause'] = controller.cause
        values |= self._loop(controller)
        for joint, text in zip(controller.damper.joints, controller.damper.report(), strict=True):
            values[f'damper {joint}'] = text
        if not self.active:
            return WARN, self.ended or self._phase, values
        worst = self._worst(controller)
        return (*(worst or (level, message)), values)

    def _loop(self, controller: MotionController) -> dict[str, str]:
        """Give figures of the loop, and what was cut and refused since the last diagnosis."""
        gains, delay = controller.gains, controller.gains.delay.delay
        values = {
            'loop delay [ms]': 'unknown before motion' if delay is None else f'{1e3 * delay:.1f}',
            'age of stamps [ms]': self.clocks.text(),
            'damping in use': f'{gains.share * gains.allowed_share:.2f}',
            'position gain in use [1/s]': f'{gains.position_gain_in_use(controller.period):.2f}'}
        if controller.adaptation is not None:
            values |= controller.adaptation.report()
        for name, now, before in (('cut', controller.cuts, self._cuts),
                                  ('refused', controller.reference.refused, self._refused)):
            since = now - before
            values |= {f'{name}: {key}': str(count) for key, count in sorted(since.items())}
            before.clear()
            before.update(now)
        return values

    def _worst(self, controller: MotionController) -> tuple[bytes, str] | None:
        """Give the level and the words of what matters most; None where all is well."""
        if controller.state is State.FAULT:
            return ERROR, f'{controller.cause}; the joints stand, ~/reset takes them up again'
        gains = controller.gains
        if gains.excited:
            return ERROR, (f'the damper is off: {gains.excited}; look at its sign, its gain '
                           'and the delay of the loop, then ~/reset')
        bad = self._gauge_faults(controller)
        if bad:
            return ERROR, '; '.join(bad)
        clock = self.clocks.fault()
        if clock:
            return ERROR, clock
        if controller.missing:
            return STALE, f'{controller.cause}: standstill is commanded'
        if controller.state is State.HOLDING:
            return (STALE if controller.unreferenced else WARN,
                    f'{controller.cause}: the joints are held')
        delay = gains.delay.delay
        if gains.allowed_share < 1.0 and delay is not None:
            off = 'is off' if gains.allowed_share == 0.0 else 'takes less'
            return WARN, (f'the damper {off}: the loop has a delay of {1e3 * delay:.0f} ms, its '
                          f'gains hold up to {1e3 * gains.full_delay:.0f} ms')
        gain = gains.position_gain_in_use(controller.period)
        if gain < gains.position_gain:
            return WARN, (f'position gain {gain:.2g} 1/s instead of {gains.position_gain:.2g}: '
                          'the delay of the loop allows no more')
        adaptation = controller.adaptation
        if adaptation is not None and not adaptation.known(self.steady()):
            return WARN, f'fixed gains: {adaptation.unknown}'
        odd = controller.reference.refusal or self.clocks.offset()
        if odd:
            return WARN, odd
        if controller.limits.missing:
            return WARN, f'not bounded, {"; ".join(controller.limits.missing)}'
        return None

    def _gauge_faults(self, controller: MotionController) -> list[str]:
        """Name the gauges that are not trusted, and why; forget those that are again."""
        damper = controller.damper
        faults = self._faults | {place: status for place, status in enumerate(damper.status)
                                 if status >= Status.MISSING}
        told = [f'{damper.joints[place]} ({damper.gauges[place]}): {MEANING[fault]}'
                for place, fault in faults.items()]
        self._faults = {place: fault for place, fault in self._faults.items()
                        if damper.status[place] not in (Status.DAMPING, Status.SATURATED)}
        return told

    def close(self) -> None:
        """Leave the joints at standstill."""
        self.active = False
        self._brake_down()


def main(args: Sequence[str] | None = None) -> int:
    """Run the node as a process."""
    return run(OscillationDamperNode, args)


if __name__ == '__main__':
    sys.exit(main())
