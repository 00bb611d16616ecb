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

"""Changes of a node's diagnosis in its log: one line each."""

from __future__ import annotations

from collections.abc import Callable
import re
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

NAMES = {DiagnosticStatus.OK: 'OK', DiagnosticStatus.WARN: 'WARN',
         DiagnosticStatus.ERROR: 'ERROR', DiagnosticStatus.STALE: 'STALE'}
FAULTS = (DiagnosticStatus.WARN, DiagnosticStatus.ERROR)
REPEAT = 5.0
"""Time before another fault of the same level is logged [s]."""


class LevelLog:
    """
    Logs changes of the level, and from time to time another fault of the same level.

    steady: clock that never stops [s].
    """

    def __init__(self, logger: Any, steady: Callable[[], float]) -> None:
        self._logger, self._steady = logger, steady
        self._level: bytes | None = None
        self._text = ''
        self._at = 0.0

    def take(self, level: bytes, message: str) -> None:
        """Take a diagnosis."""
        now, text = self._steady(), re.sub(r'[\d.]+', '', message)  # figures change all the time
        before = self._level
        if level == before and (
                level not in FAULTS or text == self._text or now - self._at < REPEAT):
            return
        self._level, self._text, self._at = level, text, now
        line = f'{"start" if before is None else NAMES[before]} -> {NAMES[level]}: {message}'
        # rclpy keeps one severity for each place of the source
        if level == DiagnosticStatus.OK:
            self._logger.info(line)
        elif level == DiagnosticStatus.ERROR:
            self._logger.error(line)
        else:
            self._logger.warning(line)
