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

"""A node that works with a model bundle, and with the load that grippers announce."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial
from threading import Thread
from typing import Any

from action_msgs.msg import GoalStatus, GoalStatusArray
from geometry_msgs.msg import Inertia, InertiaStamped, Vector3
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool

from tudor_dynamics.arm.description import Arm, array_places, refuse_interfaces
from tudor_dynamics.errors import ModelError, TudorError
from tudor_dynamics.load.live import (
    carried_load, CarriedLoad, load_facts, load_text, PayloadStage)
from tudor_dynamics.models.bundle import GIVE_FOLDER, load_bundle, ModelBundle
from tudor_dynamics.nodes.common.base import ERROR, Figure, latched, OK, TudorNode, WARN
from tudor_dynamics.nodes.common.interfaces import EXPECT_PAYLOAD, GRIPPERS, PAYLOAD_TOPIC, RELOAD
from tudor_dynamics.nodes.common.messages import ArrayDecoder, JointSample, time_message
from tudor_dynamics.nodes.settings import CHANGED, DEEP, EVERY, MOVED


AT_WORK = (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING)


class Gripper:
    """Listens to a gripper, and announces a load where it may come or go."""

    def __init__(
        self, node: TudorNode, announce: Callable[[], None],
        arm_joints: Callable[[], Collection[str]],
    ) -> None:
        self._announce, self._arm_joints = announce, arm_joints
        self._closed: bool | None = None
        self._places: dict[str, float] = {}
        self._goals: set[bytes] = set()
        topic = str(node.value('gripper_topic'))
        if topic:
            kind, self._acts = {
                GRIPPERS[0]: (Bool, self._switched), GRIPPERS[1]: (JointState, self._moved),
                GRIPPERS[2]: (GoalStatusArray, self._sent)}[str(node.value('gripper_type'))]
            self._subscription = node.subscribe(kind, topic, self._take)

    def _take(self, message: Any) -> None:
        if self._acts(message):
            self._announce()

    def _switched(self, message: Bool) -> bool:
        before, self._closed = self._closed, message.data
        return before is not None and message.data != before

    def _moved(self, message: JointState) -> bool:
        own, moved = self._arm_joints(), False
        for name, place in zip(message.name, message.position, strict=False):
            if name in own:
                continue
            before = self._places.setdefault(name, place)
            if not abs(place - before) <= MOVED:  # NaN never comes to rest, and is no place
                moved = moved or place == place
                self._places[name] = place
        return moved

    def _sent(self, message: GoalStatusArray) -> bool:
        before, self._goals = self._goals, {
            bytes(status.goal_info.goal_id.uuid) for status in message.status_list
            if status.status in AT_WORK}
        return bool(self._goals - before)


class PayloadPort:
    """What a node has to do with the load; load: None where the load is a parameter."""

    def __init__(self, node: ModelNode, source: str) -> None:
        self._node, self.source = node, source
        self.load: CarriedLoad | None = None
        self._taken_back = self._announced = 0
        self._last: tuple[int, float] | None = None
        if source == 'estimate':
            self._publisher = node.publish_on(InertiaStamped, PAYLOAD_TOPIC, latch=True)
            node.serve(EXPECT_PAYLOAD, self._expect)
        elif source == 'topic':
            self._subscription = node.subscribe(
                InertiaStamped, PAYLOAD_TOPIC, self._heard, qos=latched())

    def use(self, load: CarriedLoad | None) -> None:
        """Put another one into use; a load that is known stays."""
        if load is not None and self.load is not None and self.source == 'topic':
            load.carry(self.load.mass)
        self.load = load

    def publish(self, stamp: int, taken_back: int = 0) -> None:
        """Publish the load where it has changed: stamp [ns]."""
        load = self.load
        self._taken_back += taken_back
        if not isinstance(load, PayloadStage):
            return
        if self._last is not None and not taken_back:
            since, mass = self._last
            if 0 <= stamp - since < EVERY or abs(load.mass - mass) < CHANGED * load.std:
                return
        self._last = stamp, load.mass
        message = InertiaStamped()
        message.header.stamp, message.header.frame_id = time_message(stamp), load.frame
        x, y, z = (float(value) for value in load.place)
        # a point: what one kilogram more or less turns by is in its place
        message.inertia = Inertia(m=float(load.mass), com=Vector3(x=x, y=y, z=z))
        self._publisher.publish(message)

    def _heard(self, message: InertiaStamped) -> None:
        mass = float(message.inertia.m)
        if self.load is not None and 0.0 <= mass < float('inf'):
            self.load.carry(mass)
            self._node.asked('load')

    def _expect(self) -> str:
        if not isinstance(self.load, PayloadStage):
            raise TudorError('no model that estimates the load is in use; see the diagnostics')
        self.announce()
        return 'a load picked up or released within 3 s is not reported as a collision'

    def announce(self) -> None:
        """Let a load come or go now; of no effect where the load is a parameter."""
        if self.load is not None:
            self.load.expect()
            self._node.asked('expect')
            self._announced += 1

    def values(self) -> dict[str, str]:
        """Give what diagnostics say of the load."""
        load, facts = self.load, self._node.load_facts()
        found = {'load': load_text(**facts), 'payload [kg]': f'{facts["mass"]:.4g}',
                 'payload source': facts['source']} if facts else {}
        if isinstance(load, PayloadStage):
            found['payload std [kg]'] = f'{load.std:.4f}'
            found['payload estimated from'] = load.output + (', bent links' if load.bent else '')
        return found if load is None else found | {
            'collisions that were loads': str(self._taken_back),
            'loads announced': str(self._announced)}


class ModelNode(TudorNode):
    """Base of nodes with a model: until one can be loaded they say why, and wait for ~/reload."""

    depth = DEEP
    FIGURES: tuple[Figure, ...] = (
        Figure('model', lambda node: 'none' if node.bundle is None else node.source),
        Figure('arm', lambda bundle: f'{bundle.arm.name} {bundle.arm.digest[:12]}', 'bundle'),
        Figure('', lambda port: port.values(), 'port'))

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self.bundle: ModelBundle | None = None
        self.source = str(self.value('model'))
        self._whole: ModelBundle | None = None  # as it was read, perhaps of all payloads
        self._payload = self.payload
        self.port = PayloadPort(self, str(self.value('payload_source'))
                                if 'payload_source' in self.params else 'estimate')
        self._reload_fault = ''
        self._ready: Callable[[], None] | None = None
        self._loader: Thread | None = None

    @property
    def payload(self) -> float:
        """Mass at the tip as the parameter has it [kg]."""
        return float(self.value('payload'))

    def start(self) -> None:
        """Load the model and offer to do so again; to be called at the end of the constructor."""
        try:
            self._whole = self._load()
            self._adopt(*self._prepared(self._whole))
        except TudorError as err:
            self.fault = str(err)
        self.serve(RELOAD, self._reload)
        self._poll = self.every(0.05, self._take_over)
        self._poll.cancel()

    def _load(self) -> ModelBundle:
        if not self.source:
            raise ModelError("the parameter 'model' is empty", remedy=GIVE_FOLDER)
        arm = None if self.bundle is None else self.bundle.arm
        return self.choose(load_bundle(self.source, arm=arm))

    def choose(self, loaded: ModelBundle) -> ModelBundle:
        """Take what of a bundle works beside a robot that is measured; or refuse it."""
        refuse_interfaces(loaded.arm, f'node {self.get_name()}', arrays=True)
        return loaded.beside_robot()

    def _prepared(self, whole: ModelBundle) -> tuple[ModelBundle, Any, CarriedLoad | None]:
        bundle, load = whole.at(self.payload), carried_load(self.port.source, whole, self.payload)
        return bundle, self.prepare(bundle, whole, load), load

    def check(self, values: dict[str, Any]) -> None:
        """Refuse a payload that the model knows nothing of."""
        if 'payload' in values and self._whole is not None:
            self._whole.at(float(values['payload']))

    def apply(self) -> None:
        if self._whole is not None and self.payload != self._payload:
            self._payload = self.payload
            self._adopt(*self._prepared(self._whole))

    def _adopt(self, bundle: ModelBundle, prepared: Any, load: CarriedLoad | None) -> None:
        self.port.use(load)
        self.use(bundle, prepared)
        self.robot = bundle.arm.name

    def prepare(self, bundle: ModelBundle, whole: ModelBundle, load: CarriedLoad | None) -> Any:
        """Build what works with a model, at its payload or as read; in a thread when reloading."""
        raise NotImplementedError

    def use(self, bundle: ModelBundle, prepared: Any) -> None:
        """Put what was prepared into use, between two samples."""
        raise NotImplementedError

    def _reload(self) -> str:
        """Load beside the running model, and answer at once: the diagnostics have the outcome."""
        if self._loader is not None:
            raise TudorError('still loading a model or thresholds; call the service again later')

        def load() -> Callable[[], None]:
            whole = self._load()
            prepared = self._prepared(whole)

            def take() -> None:
                self.fault = self._reload_fault = ''
                self._whole = whole
                self._adopt(*prepared)
                self.get_logger().info(f'model {self.source} is now in use')
            return take

        def refuse(why: str) -> None:
            self._reload_fault = why
            self.get_logger().error(
                self.named(f'model not loaded, as {why}; then call the service ~/reload'))
        self.in_background(load, refuse)
        return f'loading {self.source}'

    def in_background(
        self, work: Callable[[], Callable[[], None]], refuse: Callable[[str], None],
    ) -> None:
        """Work in a thread; what comes of it, or its refusal, is called between two samples."""
        def run() -> None:
            try:
                self._ready = work()
            except TudorError as err:
                self._ready = partial(refuse, str(err))
        self._loader = Thread(target=run, daemon=True)
        self._loader.start()
        self._poll.reset()

    def _take_over(self) -> None:
        if self._ready is None:
            return
        ready, self._ready, self._loader = self._ready, None, None
        self._poll.cancel()
        ready()

    def hear_sensors(
        self, arm: Arm, topic: str, callback: Callable[[JointSample], None],
    ) -> Subscription:
        """Subscribe to a topic of efforts or strains, of the type that the arm describes."""
        places = array_places(arm).get(topic)
        return self.hear(topic, callback, None if places is None else ArrayDecoder(
            places, lambda: self.ros_time(), self.drops))

    def asked(self, what: str) -> None:
        """Take note of what changes load or detector and is no measurement."""

    def about(self) -> dict[str, str]:
        arm = 'none' if self.bundle is None else self.bundle.arm.name
        return {**super().about(), 'arm': arm}

    def load_facts(self) -> dict[str, Any]:
        """Give mass, deviation and source of the load; nothing without a model."""
        return {} if self._whole is None else load_facts(self.port.load, self._whole, self.payload)

    def verdict(self) -> tuple[bytes, str]:
        """Say where the model does not fit the load, and why another one was refused."""
        level, message = super().verdict()
        if level != OK:
            return level, message
        known = None if self._whole is None else self._whole.payload_range
        if known is not None and not known[0] <= self.payload <= known[1]:
            return WARN, (f"the parameter 'payload' is {self.payload:g} kg, but the model knows "
                          f'{known[0]:g} to {known[1]:g} kg; fit a model to such loads')
        if self._reload_fault:
            return ERROR, ('the new model cannot be used, so the previous one stays in use. '
                           f'Reason: {self._reload_fault}')
        return level, message
