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

"""Node monitors: a monitor for each of several arms, all in one process."""

from __future__ import annotations

from collections.abc import Callable
from threading import Thread
import time
import traceback
from typing import Any

from rclpy.exceptions import InvalidNamespaceException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from rclpy.validate_namespace import validate_namespace

from tudor_dynamics.errors import TudorError
from tudor_dynamics.nodes.common.base import ERROR, Figure, OK, TudorNode, WARN
from tudor_dynamics.nodes.monitor import MonitorNode
from tudor_dynamics.nodes.settings import ARMS_LOOK


class GuardedMonitorNode(MonitorNode):
    """A monitor whose faults do not end those of other arms."""

    # An executor passes on what a callback raises, and so ends every node that it serves. Here the
    # node alone falls silent, until whoever looks after it makes another one.

    failure = ''  # what a callback raised, with its traceback; empty while nothing has

    def _call(self, callback: Callable[..., Any], *args: Any) -> Any:
        if self.failure:
            return None
        try:
            return callback(*args)
        except Exception:  # whatever it is, the other nodes go on
            self.failure = traceback.format_exc()
            return None

    def create_subscription(  # type: ignore[override]
        self, kind: Any, topic: str, callback: Callable[[Any], None], *args: Any, **options: Any,
    ) -> Subscription:
        """Subscribe as rclpy does."""
        return super().create_subscription(
            kind, topic, lambda message: self._call(callback, message), *args, **options)

    def create_timer(  # type: ignore[override]
        self, period: float, callback: Callable[[], None], *args: Any, **options: Any,
    ) -> Timer:
        """Make a timer as rclpy does."""
        return super().create_timer(period, lambda: self._call(callback), *args, **options)

    def create_service(  # type: ignore[override]
        self, kind: Any, name: str, callback: Callable[[Any, Any], Any], *args: Any,
        **options: Any,
    ) -> Service:
        """Offer a service as rclpy does; a node that has failed answers with nothing done."""
        return super().create_service(kind, name, lambda request, response: (
            self._call(callback, request, response) or response), *args, **options)


class WatchedArm:
    """The monitor of one arm: made, ended when it fails, and made again."""

    def __init__(self, namespace: str, options: dict[str, Any]) -> None:
        self.namespace = namespace
        # Rules of its own go before those of the process: __ns and __node are for all nodes in it.
        self._options = {**options, 'cli_args': [
            '--ros-args', '-r', f'__ns:={namespace}', '-r', '__node:=monitor']}
        self.node: GuardedMonitorNode | None = None
        self.fault = ''  # why there is no monitor
        self.failures = 0
        self._due = 0.0
        self._maker: Thread | None = None
        self._made: GuardedMonitorNode | None = None

    def make(self) -> None:
        """Make the monitor; what keeps it from being made is the fault."""
        try:
            self._made = GuardedMonitorNode(**self._options)
        except Exception as err:  # rclpy's errors of parameters are not one family
            self.fault = ' '.join(f'{type(err).__name__}: {err}'.split())

    def look(self, host: TudorNode, pause: float) -> None:
        """Take what was made into use, end what has failed, make it again after a pause [s]."""
        node, now = self.node, host.steady()
        if node is not None and node.failure:
            host.get_logger().error(f'{self.namespace}: a defect of tudor, please report it: '
                                    f'{node.failure}')
            last = node.failure.strip().splitlines()[-1]
            self.fault = f'its monitor failed and restarts in {pause:g} s ({last})'
            self.failures += 1
            self._due = now + pause
            self.end(host)
        elif self._made is not None:
            self.node, self._made, self._maker, self.fault = self._made, None, None, ''
            host.executor.add_node(self.node)
        elif self._maker is not None and not self._maker.is_alive():
            self._maker, self._due = None, now + pause  # it could not be made: once more, later
        elif self.failures and node is None and self._maker is None and now >= self._due:
            # in a thread: a model is loaded, which takes longer than the queues of the others last
            self._maker = Thread(target=self.make, daemon=True)
            self._maker.start()

    def end(self, host: TudorNode) -> None:
        """End the monitor."""
        node, self.node = self.node or self._made, None
        if node is None:
            return
        if host.executor is not None and node.executor is not None:
            host.executor.remove_node(node)
        node.close()
        node.destroy_node()


class MonitorsNode(TudorNode):
    """Node that keeps the monitors of several arms."""

    # Each is a node `monitor` in the namespace of its arm, with parameters, services and
    # diagnostics of its own, as if it were a process.

    FIGURES: tuple[Figure, ...] = (
        Figure('CPU [%]', lambda node: node.cpu()),
        Figure('arms', lambda node: len(node.arms)),
        Figure('watched', lambda node: sum(arm.node is not None for arm in node.arms)),
        Figure('failures ARM', lambda node: {
            arm.namespace: arm.failures for arm in node.arms if arm.failures}))

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('monitors', **kwargs)
        self.arms = tuple(WatchedArm(namespace, kwargs) for namespace in self._namespaces())
        for arm in self.arms:
            arm.make()
        if not self.arms:
            self.fault = ("the parameter 'namespaces' is empty; set it to the namespaces of the "
                          "arms, such as ['left', 'right'], or run the node monitor for one arm")
        refused = [f'{arm.namespace}: {arm.fault}' for arm in self.arms if arm.fault]
        if refused and len(refused) == len(self.arms):
            self.close()
            raise TudorError(f'no arm can be watched; {"; ".join(refused)}')
        self._cpu = time.process_time(), self.steady()
        self._looking = self.every(ARMS_LOOK, self._look)

    def _namespaces(self) -> list[str]:
        """Give the namespaces of the arms, from the root, or refuse them."""
        found: list[str] = []
        for name in self.value('namespaces'):
            try:
                namespace = expand_topic_name(name, self.get_name(), self.get_namespace())
                validate_namespace(namespace)
            except (InvalidNamespaceException, ValueError) as err:
                msg = f"the parameter 'namespaces' has {name!r}, which is no namespace ({err})"
                raise TudorError(msg) from None
            if namespace in found:
                raise TudorError(
                    f"the parameter 'namespaces' has {name!r} twice; give each arm its own")
            found.append(namespace)
        return found

    def _look(self) -> None:
        for arm in self.arms:
            arm.look(self, float(self.value('pause')))

    def about(self) -> dict[str, str]:
        return {**super().about(), 'arms': ' '.join(arm.namespace for arm in self.arms)}

    def cpu(self) -> str:
        """Give the share of a processor since this was last asked for [%]."""
        (cpu, at), self._cpu = self._cpu, (time.process_time(), self.steady())
        return f'{100.0 * (self._cpu[0] - cpu) / max(self._cpu[1] - at, 1e-9):.0f}'

    def verdict(self) -> tuple[bytes, str]:
        """Say which arms are not watched; what the others see their own monitors say."""
        level, message = super().verdict()
        faults = [f'the arm in {arm.namespace} is not watched ({arm.fault}); see the traceback in '
                  'the log of this node' for arm in self.arms if arm.fault]
        failed = [arm.namespace for arm in self.arms if arm.failures]
        if level == OK and faults:
            return ERROR, '; '.join(faults)
        if level == OK and failed:
            return WARN, (f'the monitor of namespace {", ".join(failed)} failed and runs again; '
                          'report the error in the log of this node, as '
                          'docs/howto/report_a_bug.md says')
        return level, message

    def close(self) -> None:
        for arm in self.arms:
            arm.end(self)
