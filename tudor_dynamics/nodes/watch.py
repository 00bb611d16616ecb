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

"""Node watch: a live view of what a monitor publishes, for ``tudor watch``."""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
import json
import sys
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from std_msgs.msg import Bool, String

from tudor_dynamics.errors import forget_output
from tudor_dynamics.nodes.common.base import ERROR, latched, OK, STALE, TudorNode
from tudor_dynamics.nodes.common.interfaces import (
    COLLISION, COLLISION_RECORD, CONTACT, DIAGNOSTICS, RATIOS, RESIDUALS, THRESHOLDS)
from tudor_dynamics.nodes.common.messages import JointSample
from tudor_dynamics.nodes.settings import UNHEARD
from tudor_dynamics.online.detector import Level
from tudor_dynamics.online.monitor import FIELD
from tudor_dynamics.show.live import DRAWN, LiveView, PARTS, RATIO, shown, UNKNOWN


class WatchNode(TudorNode):
    """Node of the live view; ``**kwargs`` go to rclpy's Node."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('watch', **kwargs)
        self.view = LiveView(f'monitor in {self.get_namespace()}')
        self._levels = {Level.FREE}
        self.meter.begin()  # what comes from a monitor
        self._advice = ('nothing comes from a monitor; to start one: ros2 run tudor_dynamics '
                        f'monitor --ros-args -r __ns:={self.get_namespace()} -p model:=MODEL')
        for part, topics in zip(PARTS, (RATIOS, RESIDUALS, THRESHOLDS), strict=True):
            for method, topic in topics.items():
                self.hear(topic, partial(self._on_values, part, method))
        for level, topic in ((Level.CONTACT, CONTACT), (Level.COLLISION, COLLISION)):
            self.subscribe(Bool, topic, partial(self._on_level, level), qos=latched())
        self.subscribe(String, COLLISION_RECORD, self._on_event, qos=latched())
        self.create_subscription(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, 10)
        self._open = ExitStack()
        self._draw = self._open.enter_context(
            shown(self.view, self.value('web') or None, terminal=sys.stdout.isatty()))
        self._drawing = self.every(DRAWN, self._look)

    def _look(self) -> None:
        """Draw; nothing is known of an arm whose monitor is silent."""
        silence = self.steady() - (self.meter.last_arrival or 0.0)
        if silence > UNHEARD:
            self.view.level, self.view.state = UNKNOWN, f'silent for {silence:.0f} s'
            self.view.states = {}
            self.view.values = {}  # peaks are of the past, and stay
            if self.view.warning != self._advice:
                self.view.warning = self._advice
                self._print(self._advice)
        self._draw()

    def _heard(self) -> float:
        """Take into account that a monitor is there, which says the level again."""
        if self.view.level == UNKNOWN:
            self.view.state = self.view.warning = ''
        self.view.level = max(self._levels).name.lower()
        return self.meter.begin()

    def _print(self, line: str) -> None:
        """Print a line where no terminal watches."""
        try:
            if not sys.stdout.isatty():
                print(line, flush=True)
        except BrokenPipeError:  # who read it has gone
            forget_output()
            self.exit_code = 0

    def _on_values(self, part: str, method: str, message: JointSample) -> None:
        begun = self._heard() if part == RATIO else self.meter.begin()
        values = np.asarray(getattr(message, FIELD[method]), dtype=float)
        if len(values) and len(values) == len(message.name):
            self.view.take(message.stamp, method, part, message.name, values)
        self.meter.end(begun)

    def _on_level(self, level: Level, message: Bool) -> None:
        (self._levels.add if message.data else self._levels.discard)(level)
        self._heard()

    def _on_event(self, message: String) -> None:
        try:
            record = json.loads(message.data)
            self._print(self.view.event(
                int(record['onset']), str(record['method']), str(record['link']),
                {str(name): float(value) for name, value in record['ratio'].items()}))
        except (AttributeError, KeyError, TypeError, ValueError):
            self.drops['unknown_record'] += 1

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name, _, namespace = status.name.partition(': ')
            if name in ('monitor', 'collision_detector') and namespace == self.get_namespace():
                self._heard()
                self.view.diagnosed({item.key: item.value for item in status.values})
                self.view.warning = '' if status.level == OK else status.message
                self.view.level = UNKNOWN if status.level in (ERROR, STALE) else self.view.level

    def close(self) -> None:
        """Leave the terminal as it was."""
        super().close()
        self._open.close()
