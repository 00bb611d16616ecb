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
from collections.abc import Sequence
from functools import partial
import sys
import time
from typing import Any

import numpy as np
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from tudor_dynamics.arm import load_arm
from tudor_dynamics.control.damper import MEANING, Status
from tudor_dynamics.control.damper_law import SEEN, STATUS
from tudor_dynamics.control.velocity_controller import VelocityController
from tudor_dynamics.errors import ArmError, TudorError
from tudor_dynamics.monitoring.stamps import StampGate
from tudor_dynamics.nodes.base import ERROR, OK, STALE, TudorNode, WARN
from tudor_dynamics.nodes.interfaces import JOINT_REFERENCE, RESET, VELOCITY_COMMANDS
from tudor_dynamics.nodes.messages import floats, NamedReader, nanoseconds
from tudor_dynamics.nodes.runner import run

WATCH = 0.02
"""Period of the watchdog [s]."""


class OscillationDamperNode(LifecycleNodeMixin, TudorNode):
    """
    Damper node, a managed one because it commands motion; ``**kwargs`` go to rclpy's Node.

    Active, it answers every message of positions with commands. Where positions or reference
    fail to come for ``timeout`` it commands standstill.
    """

    def __init__(self, **kwargs: Any) -> None:
        TudorNode.__init__(self, 'oscillation_damper', **kwargs)
        LifecycleNodeMixin.__init__(self)
        self.controller: VelocityController | None = None
        self.gate = StampGate()
        self.active = False
        self._strain = np.zeros(0)
        self._fresh = np.zeros(0, dtype=bool)
        self._gauges: dict[str, tuple[NamedReader, list[int]]] = {}
        self._q_ref: Any = None
        self._dq_ref: Any = None
        self._reference_at = self._joints_at = -np.inf
        self._stopped = ''
        self._referred = False
        self._faults: dict[int, Status] = {}
        self._output = self.publish_on(Float64MultiArray, VELOCITY_COMMANDS)
        self.serve(RESET, self._reset)
        self._inputs: list[Any] = []
        self._watchdog = self.create_timer(WATCH, self._watch)
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
            self.controller = VelocityController(arm)
        except TudorError as err:
            self.fault = str(err)
            self.get_logger().error(self.fault)
            return TransitionCallbackReturn.FAILURE
        self.fault = ''
        self._robot = arm.name
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
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to command."""
        if self.controller is None:
            return TransitionCallbackReturn.FAILURE
        self._reset()
        self.active = True
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Command standstill once, then nothing."""
        self.active = False
        self._stand_still()
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the arm."""
        for item in self._inputs:
            self.destroy_subscription(item)
        self._inputs, self.controller = [], None
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Command standstill."""
        if self.active:
            self.on_deactivate(state)
        return TransitionCallbackReturn.SUCCESS

    def apply(self) -> None:
        """Take changed gains into use."""
        if self.controller is None:
            return
        self.controller.share = self.value('damping')
        gain = self.value('position_gain')
        if gain > 0.0:
            self.controller.position_gain = gain

    def _reset(self) -> str:
        if self.controller is not None:
            self.controller.reset()
        self.gate.reset()
        self._q_ref = self._dq_ref = None
        self._referred = False
        self._faults = {}
        return 'the damper fades in anew'

    def _on_strains(self, topic: str, message: JointState) -> None:
        reader, index = self._gauges[topic]
        values = reader.read(message, 'position')
        if values is not None:
            self._strain[index], self._fresh[index] = values, True

    def _on_reference(self, message: JointState) -> None:
        q = self._references.read(message, 'position')
        dq = self._references.read(message, 'velocity')
        if q is None or dq is None:
            return
        if not (np.isfinite(q).all() and np.isfinite(dq).all()):
            self.drops['not_finite'] += 1
            return
        self._q_ref, self._dq_ref, self._referred = q, dq, True
        self._reference_at = time.monotonic()

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
            return
        if self._own in self._gauges:
            self._on_strains(self._own, message)
        tick = self.gate.step(nanoseconds(message.header.stamp))
        if tick is None:
            return
        now = time.monotonic()
        self._joints_at = now
        if self._q_ref is None:
            self._q_ref = q.copy()  # without any reference the arm stays where it is
            self._dq_ref = np.zeros_like(q)
            self._reference_at = now
        stale = now - self._reference_at > self.value('timeout')
        if tick.first:
            return
        dq_ref = np.zeros_like(q) if stale else self._dq_ref
        q_ref = q if stale and np.any(self._dq_ref) else self._q_ref
        command = controller.step(tick.dt, q, q_ref, dq_ref, self._strain, self._fresh)
        self._fresh[:] = False
        state = controller.damper.state
        for place in np.flatnonzero((state[:, STATUS] >= Status.MISSING) & (state[:, SEEN] > 0)):
            # a jump is over before anybody looks: remembered until the gauge is trusted again
            self._faults[int(place)] = controller.damper.status[place]
        self._stopped = ''
        self._output.publish(Float64MultiArray(data=floats(command)))
        self.meter.end(begun)

    def _watch(self) -> None:
        if self.active and self._joints_at > -np.inf and (
                time.monotonic() - self._joints_at > self.value('timeout')):
            self._stopped = 'no positions: standstill is commanded'
            self._stand_still()

    def _stand_still(self) -> None:
        if self.controller is not None:
            zero = np.zeros(len(self.controller.joints))
            self._output.publish(Float64MultiArray(data=floats(zero)))

    def hardware(self) -> str:
        """Give the name of the robot, by default that of the arm."""
        return str(self.value('robot')) or getattr(self, '_robot', '') or 'none'

    def counters(self) -> list[Counter[str]]:
        """Add the drops by stamps."""
        return [self.drops, self.gate.drops]

    def status(self) -> tuple[bytes, str, dict[str, str]]:
        """Tell what the damper of each joint does."""
        level, message, values = super().status()
        values['state'] = 'active' if self.active else 'inactive'
        if self.controller is None:
            return level, message, values
        damper = self.controller.damper
        for joint, text in zip(damper.joints, damper.report(), strict=True):
            values[f'damper {joint}'] = text
        bad = self._gauge_faults()
        if level == OK and self.active and bad:
            return ERROR, '; '.join(bad), values
        if self._stopped and self.active:
            return STALE, self._stopped, values
        if level == OK and not self.active:
            return WARN, 'inactive', values
        if level == OK and not self._referred:
            return WARN, 'no reference yet: the joints are held where they are', values
        if level == OK and time.monotonic() - self._reference_at > self.value('timeout'):
            return STALE, 'no reference: the joints are held', values
        return level, message, values

    def _gauge_faults(self) -> list[str]:
        """Name the gauges that are not trusted, and why; forget those that are again."""
        assert self.controller is not None
        damper = self.controller.damper
        faults = self._faults | {place: status for place, status in enumerate(damper.status)
                                 if status >= Status.MISSING}
        told = [f'{damper.joints[place]} ({damper.gauges[place]}): {MEANING[fault]}'
                for place, fault in faults.items()]
        self._faults = {place: fault for place, fault in self._faults.items()
                        if damper.status[place] not in (Status.DAMPING, Status.SATURATED)}
        return told

    def close(self) -> None:
        """Leave the joints at standstill."""
        if self.active and self.context.ok():
            self._stand_still()


def main(args: Sequence[str] | None = None) -> int:
    """Run the node as a process."""
    return run(OscillationDamperNode, args)


if __name__ == '__main__':
    sys.exit(main())
