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

"""What all nodes share: parameters, quality of service, diagnostics, clocks, logs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
import re
from threading import Event, Thread
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import numpy as np
from rcl_interfaces.msg import (
    FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult)
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from std_srvs.srv import Trigger

from tudor_dynamics.arm.description import Arm, load_arm, refuse_interfaces
from tudor_dynamics.errors import ARGUMENT, ArmError, meant, TudorError
from tudor_dynamics.nodes.common.interfaces import CLOCK, DIAGNOSTICS, NODES, Param
from tudor_dynamics.nodes.common.messages import JointStateDecoder
from tudor_dynamics.nodes.common.runner import run
from tudor_dynamics.nodes.settings import (
    AGE_SHARE, DEPTH, EARLY, ENOUGH, LATENCIES, OLD, REPEAT, STANDS, TOO_MANY)
from tudor_dynamics.online.coverage import ALSO, MEANING, OF_OTHERS


OK, WARN, ERROR, STALE = (DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR,
                          DiagnosticStatus.STALE)
NAMES = {OK: 'OK', WARN: 'WARN', ERROR: 'ERROR', STALE: 'STALE'}


class Meter:
    """Counts messages and takes their time; `report` gives the figures since the last one."""

    def __init__(self, steady: Callable[[], float] = time.monotonic) -> None:
        self._steady = steady  # clock of ages and rates, which never stops nor is set [s]
        self.count = 0
        self.last_arrival: float | None = None
        self._latencies = np.zeros(LATENCIES)
        self._reported = 0
        self._since = steady()

    def begin(self) -> float:
        """Take the time at which a message arrives, and give what `end` needs."""
        self.last_arrival = self._steady()
        return time.perf_counter()

    def end(self, begun: float) -> None:
        """Take the time at which its results are published."""
        self._latencies[self.count % LATENCIES] = time.perf_counter() - begun
        self.count += 1

    def stale(self, timeout: float) -> bool:
        """Say whether nothing has come for a while, or ever [s]."""
        return self.last_arrival is None or self._steady() - self.last_arrival > timeout

    def report(self) -> dict[str, str]:
        """Give rate and latency as texts."""
        now = self._steady()
        seconds = max(now - self._since, 1e-9)
        values = {'rate [Hz]': f'{(self.count - self._reported) / seconds:.1f}',
                  'messages': str(self.count)}
        self._reported, self._since = self.count, now
        known = min(self.count, LATENCIES)
        if known:
            places = [min(known - 1, int(share * known)) for share in (0.5, 0.99)]
            # sorting all of them would take half a millisecond, in which samples wait
            ordered = np.partition(self._latencies[:known], places)
            for name, place in zip(('p50', 'p99'), places, strict=True):
                values[f'latency {name} [ms]'] = f'{1e3 * ordered[place]:.3f}'
        return values


class ClockWatch:
    """Compares stamps with the clock of the node that reads them."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.age: float | None = None
        self.newest: float | None = None  # age of the last stamp; None before a clock runs [s]
        self._zeros = self._count = 0

    def step(self, stamp: int, now: int) -> None:
        """Take a stamp into account, and the time of the node at which it came [ns]."""
        self._count += 1
        self._zeros = self._zeros + 1 if stamp == 0 else 0
        age = 1e-9 * (now - stamp)
        self.newest = age if now and stamp else None
        self.age = age if self.age is None else self.age + AGE_SHARE * (age - self.age)

    def text(self) -> str:
        """Give the age of stamps [ms]."""
        return 'unknown' if self.age is None else f'{1e3 * self.age:.1f}'

    def fault(self) -> str:
        """Say what is wrong with stamps that make the arm stand; empty for nothing."""
        if self._zeros >= ENOUGH:
            return ('all stamps of the positions are zero, so the sample time is unknown; let the '
                    'driver set header.stamp')
        return ''

    def offset(self, topic: str) -> str:
        """Say what is wrong with the clocks, though sample times are right; empty for nothing."""
        if self._count < ENOUGH or self.age is None or -EARLY <= self.age <= OLD:
            return ''
        where, most = ('in the future', EARLY) if self.age < 0.0 else ('in the past', OLD)
        return (f'stamps on {topic} are {abs(self.age):.3g} s {where} (limit {most:g} s); '
                'synchronise the clocks of node and driver; all nodes need the same use_sim_time')


UNUSABLE = {
    **{cause: MEANING[cause] for cause in ('unknown_names', OF_OTHERS, 'short_array', 'not_finite',
                                           'duplicate_stamp', 'backward_stamp')},
    'not_one_point': 'trajectories need one point each; correct the node that sends them',
    'impossible_command': 'commands need a finite value for each joint; correct the sender'}
"""Drops that are the fault of who sends, and what they mean."""
OWN_TOPICS = (DIAGNOSTICS, '/parameter_events', '/rosout', CLOCK)  # topics that every node has


def weak(depth: int = DEPTH) -> QoSProfile:
    """Ask for what any driver offers: best effort, keep the last messages."""
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)


def strong(depth: int = DEPTH) -> QoSProfile:
    """Offer what any subscriber takes: reliable, keep the last messages."""
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE)


def latched() -> QoSProfile:
    """Offer the last message to those who come later."""
    return QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                      durability=DurabilityPolicy.TRANSIENT_LOCAL)


def _descriptor(param: Param) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(description=param.describe(), read_only=not param.dynamic)
    if param.low is not None and param.high is not None:
        if isinstance(param.default, float):
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(param.low), to_value=float(param.high),
                                   step=0.0)]
        else:
            descriptor.integer_range = [
                IntegerRange(from_value=int(param.low), to_value=int(param.high), step=1)]
    if param.choices:
        descriptor.additional_constraints = f'one of {", ".join(param.choices)}'
    return descriptor


@dataclass(frozen=True)
class Figure:
    """A figure, or several alike, in a node's diagnostics."""

    key: str  # keys of a mapping stand for its word in capitals, or for all of it if it has none
    give: Callable[[Any], Any]  # from `of` to a text, a mapping, or None for no figure now
    of: str = ''  # attribute of the node that is asked, the node itself by default; None is not

    def read(self, node: Any) -> dict[str, str]:
        """Give keys and texts."""
        asked = getattr(node, self.of) if self.of else node
        found = None if asked is None else self.give(asked)
        if found is None:
            return {}
        if not isinstance(found, dict):
            return {self.key: str(found)}
        word = next((word for word in self.key.split() if word.isupper()), '')
        return {self.key.replace(word, name) if word else name: str(text)
                for name, text in found.items()}


class SimulatedClock:
    """
    Clock of ages beside a simulator [s]: its time, and the wall's where it stands or never began.

    A machine may be too busy for its simulator as long as it likes, and nothing becomes too old.
    """

    def __init__(self, ros: Callable[[], int]) -> None:
        self._ros, self._stamp = ros, 0
        self._now = self._wall = time.monotonic()

    def __call__(self) -> float:
        """Give the time [s]."""
        stamp, wall = self._ros(), time.monotonic()
        waits = STANDS if stamp else 0.0
        if stamp != self._stamp:
            self._now += max(stamp - self._stamp, 0) * 1e-9 if self._stamp else 0.0
            self._stamp, self._wall = stamp, wall
        elif wall - self._wall > waits:
            self._now += wall - self._wall - waits
            self._wall = wall - waits
        return self._now


def steady_clock(node: Node) -> Callable[[], float]:
    """Give the clock by which a node takes ages [s]."""
    return SimulatedClock(lambda: int(node.get_clock().now().nanoseconds)) if (
        node.get_parameter('use_sim_time').value) else time.monotonic


class TudorNode(Node):
    """Base of the nodes."""

    depth = DEPTH  # of its queues
    robot = _own = ''  # arm and topic of its positions, once known
    crowded: tuple[bytes, str] | None = None  # see `crowd`
    exit_code: int | None = None  # of the process, once a node ends by itself; set by any thread
    FIGURES: tuple[Figure, ...] = ()

    @classmethod
    def main(cls) -> int:
        """Run the node as a process until it is asked to stop; gives the exit code."""
        return run(cls)

    def __init__(
        self, name: str, *, steady: Callable[[], float] = time.monotonic, **kwargs: Any,
    ) -> None:
        super().__init__(name, **kwargs)
        self.steady = steady_clock(self) if steady is time.monotonic else steady
        self.ros_time: Callable[[], int] = lambda: int(self.get_clock().now().nanoseconds)  # [ns]
        self._steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.meter = Meter(lambda: self.steady())
        self.drops: Counter[str] = Counter()
        self.fault = self.ended = self._unknown = ''  # ended: why; all empty for nothing
        self._closing = Event()  # for what runs beside the executor
        self._beside: Thread | None = None
        self._logged: tuple[bytes | None, str, float] = None, '', 0.0  # level, text, when [s]
        self._before: Counter[str] = Counter()
        self._level = STALE  # of the last diagnosis, by the verdict
        self.params = {param.name: param for param in NODES[name]}
        for param in NODES[name]:
            # an empty list has no type in ROS, so it holds a blank
            self.declare_parameter(param.name, (list(param.default) or ['']) if isinstance(
                param.default, tuple) else param.default, _descriptor(param))
        self._check_choices([self.get_parameter(param) for param in self.params])
        self.add_on_set_parameters_callback(self._validate)
        self.add_post_set_parameters_callback(self._applied)
        self._diagnostics = self.create_publisher(
            DiagnosticArray, DIAGNOSTICS, QoSProfile(depth=1))
        self._timer = self.every(1.0, self.publish_diagnostics)
        self._start = self.every(0.0, self._announce)  # once the node is made

    def every(self, period: float, callback: Callable[[], None]) -> Timer:
        """Call something again and again, whatever the clock of ROS does: period [s]."""
        return self.create_timer(period, callback, clock=self._steady_clock)

    def value(self, name: str) -> Any:
        """Give the value of a parameter; lists of strings as tuples."""
        value = self.get_parameter(name).value
        if isinstance(value, (list, tuple)):
            return tuple(item for item in value if item != '')
        return value

    def _check_choices(self, parameters: Iterable[Parameter]) -> None:
        for parameter in parameters:
            param = self.params.get(parameter.name)
            if param is not None and param.choices and parameter.value not in param.choices:
                raise TudorError(f'the parameter {param.name} is {parameter.value!r}; set it to '
                                 f'one of {", ".join(param.choices)}')

    def _validate(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            self._check_choices(parameters)
            self.check({p.name: p.value for p in parameters})
        except TudorError as err:
            return SetParametersResult(successful=False, reason=str(err))
        return SetParametersResult(successful=True)

    def _applied(self, parameters: list[Parameter]) -> None:
        if any(parameter.name in self.params for parameter in parameters):
            self.apply()

    def check(self, values: dict[str, Any]) -> None:
        """Refuse values that go beyond what ranges say, by a TudorError."""

    def apply(self) -> None:
        """Take changed parameters into use."""

    def subscribe(
        self, kind: Any, topic: str, callback: Callable[[Any], None], *,
        qos: QoSProfile | None = None, raw: bool = False,
    ) -> Subscription:
        """Subscribe, by default as any driver allows; overridable by the standard parameters."""
        return self.create_subscription(
            kind, topic, callback, qos or weak(self.depth), raw=raw,
            qos_overriding_options=QoSOverridingOptions.with_default_policies())

    def hear(self, topic: str, callback: Callable[[Any], None], decoder: Any = None,
             ) -> Subscription:
        """Subscribe to what a decoder makes of a topic, by default that of JointStates."""
        decoder = decoder or JointStateDecoder(self.drops)

        def take(data: bytes) -> None:
            message = decoder.decode(data)
            if message is not None:
                callback(message)
        return self.subscribe(decoder.kind, topic, take, raw=True)

    def publish_on(self, kind: Any, topic: str, *, latch: bool = False) -> Publisher:
        """Make a publisher that any subscriber matches; overridable by the standard parameters."""
        return self.create_publisher(
            kind, topic, latched() if latch else strong(self.depth),
            qos_overriding_options=QoSOverridingOptions.with_default_policies())

    def publishing(self, topic: str) -> list[str]:
        """Name the nodes that publish on a topic, given by its whole name."""
        return [f'{info.node_namespace.rstrip("/")}/{info.node_name}'
                for info in self.get_publishers_info_by_topic(topic)]

    def rivals(self, publisher: Publisher) -> list[str]:
        """Name the other nodes that publish on the topic of a publisher of this node."""
        names = self.publishing(publisher.topic_name)
        if self.get_fully_qualified_name() in names:
            names.remove(self.get_fully_qualified_name())
        return sorted(names)

    def crowd(self, publisher: Publisher, verb: str, positions: str) -> tuple[bytes, str] | None:
        """Say who else does what a publisher does, or that several give positions on a topic."""
        rivals, sources = self.rivals(publisher), sorted(
            self.publishing(self.resolve_topic_name(positions)) if positions else ())
        if rivals:
            return ERROR, (f'{", ".join(rivals)} can also {verb} on {publisher.topic_name}; let '
                           'only one node publish there')
        return None if len(sources) < 2 else (WARN, (
            f'{len(sources)} publishers send positions on {positions}, in nodes '
            f'{", ".join(sources)}; stop all but the driver of this arm'))

    def named(self, text: str) -> str:
        """Give services of this node, and its parameters, the names by which they are called."""
        return ARGUMENT.sub(r'the parameter \1', text.replace(
            'service ~', f'service {self.get_fully_qualified_name()}'))

    def problems(self, message: str) -> tuple[str, dict[str, str]]:
        """Give the first problem of a verdict, and the others as values of a diagnosis."""
        first, *others = self.named(message).split(ALSO)
        return first, {f'problem {number}': text for number, text in enumerate(others, 2)}

    def serve(self, name: str, action: Callable[[], str]) -> None:
        """Offer a Trigger service."""
        def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                response.message, response.success = self.named(action()), True
            except TudorError as err:
                response.message, response.success = self.named(str(err)), False
            return response
        self.create_service(Trigger, name, answer)

    def hardware(self) -> str:
        """Give the hardware_id of the diagnostics, by default the name of the arm."""
        return str(self.value('robot')) or self.robot or 'none'

    def fail(self, err: TudorError) -> None:
        """Keep what makes the node useless, for its diagnostics, and log it."""
        self.fault = str(err)
        self.get_logger().error(self.fault)

    def described_arm(self, contents: str, reader: str = '') -> Arm:
        """Read the parameter ``arm``; a reader takes no interfaces but JointStates."""
        if not self.value('arm'):
            raise ArmError("the parameter 'arm' is empty; set it to the path of an arm.yaml with "
                           f'{contents}')
        arm = load_arm(self.value('arm'))
        if reader:
            refuse_interfaces(arm, reader)
        return arm

    def counters(self) -> list[Counter[str]]:
        """Give all counters of drops."""
        return [self.drops]

    def about(self) -> dict[str, str]:
        """Give what the line at the start says; subclasses add to it."""
        about: dict[str, str] = {name: str(self.get_parameter(name).value) for name in (
            'model', 'kind', 'arm', 'bag', 'rate') if name in self.params}
        for name, of in (('hears', self.subscriptions), ('publishes', self.publishers)):
            about[name] = ' '.join(item.topic_name for item in of
                                   if item.topic_name not in OWN_TOPICS) or 'nothing'
        return about

    def _announce(self) -> None:
        self._start.cancel()
        for name in self._parameter_overrides:  # a file may hold those of other nodes, too
            if not (self.has_parameter(name) or name.startswith('qos_overrides.')
                    or any(param.name == name for group in NODES.values() for param in group)):
                hint = meant(name, self.params) or '; remove it, or correct its name'
                self._unknown = f'the unknown parameter {name} is ignored{hint}'
        about = ', '.join(f'{name} {value or "none"}' for name, value in self.about().items())
        self.get_logger().info(f'started: {about}')

    def verdict(self) -> tuple[bytes, str]:
        """Give level and message of the diagnosis; subclasses judge further."""
        if self.ended:
            return WARN, self.ended
        if self.fault:
            return ERROR, self.fault
        if 'timeout' in self.params and self.meter.stale(float(self.value('timeout'))):
            topics = self._own or self.about()['hears'].replace(' ', ' or on ')
            return STALE, f'no message comes on {topics}; start the node that publishes there'
        return OK, 'running'

    def status(self) -> tuple[bytes, str, dict[str, str]]:
        """Give level, message and figures."""
        level, message = self.verdict()
        total = sum(self.counters(), Counter[str]())
        values = {'dropped': str(total.total()),
                  **{f'dropped: {cause}': str(n) for cause, n in sorted(total.items()) if n}}
        for kind in reversed(type(self).__mro__):
            for figure in kind.__dict__.get('FIGURES', ()):
                values.update(figure.read(self))
        return level, message, values

    def _unusable(self) -> str:
        """Say why many messages since the last diagnosis could not be used; empty if not."""
        now: Counter[str] = Counter({'used': self.meter.count})
        for item in self.counters():
            now.update({cause: count for cause, count in item.items() if cause in UNUSABLE})
        since, self._before = now - self._before, now
        used = since.pop('used', 0)
        if used:
            del since[OF_OTHERS]
        if not since or since.total() < TOO_MANY * (used + since.total()):
            return ''
        cause, count = since.most_common(1)[0]
        text = UNUSABLE[cause].format(on=self.about()['hears'].replace(' ', ' or '))
        return f'{count} messages of the last second could not be used, because {text}'

    def publish_diagnostics(self, extra: DiagnosticStatus | None = None) -> None:
        """Publish the state of the node; called once a second."""
        level, message, more = self.status()
        self._level = level
        unusable = self._unusable() or self._unknown
        if level == OK and unusable:
            level, message = WARN, unusable
        elif self._unknown:  # it may be why nothing arrives
            message = f'{message}{ALSO}{self._unknown}'
        message, others = self.problems(message)
        if others:
            plural = 's' * (len(others) > 1)
            message += f' ({len(others)} more problem{plural} in the values on {DIAGNOSTICS})'
        values = {**self.meter.report(), **more, **others}
        status = DiagnosticStatus(
            level=level, name=f'{self.get_name()}: {self.get_namespace()}', message=message,
            hardware_id=self.hardware(),
            values=[KeyValue(key=key, value=value) for key, value in values.items()])
        array = DiagnosticArray(status=[status] if extra is None else [status, extra])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)
        self._log(level, message)

    def notice(self) -> None:
        """Publish the state of the node at once where its level is another one."""
        if self.verdict()[0] != self._level:
            self.publish_diagnostics()

    def _log(self, level: bytes, message: str) -> None:
        """Log changes of the level, and from time to time another fault of the same level."""
        now, text = self.steady(), re.sub(r'[\d.]+', '', message)  # figures change all the time
        before, last, at = self._logged
        if level == before and (level not in (WARN, ERROR) or text == last or now - at < REPEAT):
            return
        self._logged = level, text, now
        line = f'{"start" if before is None else NAMES[before]} -> {NAMES[level]}: {message}'
        # rclpy keeps one severity for each place of the source
        if level == OK:
            self.get_logger().info(line)
        elif level == ERROR:
            self.get_logger().error(line)
        else:
            self.get_logger().warning(line)

    def _run_beside(self, work: Callable[[], None]) -> None:
        """Work beside the executor, in a thread that ends by itself or once the node stops."""
        self._beside = Thread(target=work, daemon=True)
        self._beside.start()

    def close(self) -> None:
        """End what runs beside the executor, before the node is destroyed."""
        self._closing.set()
        if self._beside is not None:
            self._beside.join(timeout=2.0)
