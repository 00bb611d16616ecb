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

"""Hands a recording to a monitor as the robot would: message by message."""

from __future__ import annotations

from collections.abc import Iterator

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.monitoring.monitor import Monitor
from tudor_dynamics.monitoring.watch import Found


def replay(monitor: Monitor, recording: Recording) -> Iterator[tuple[int, Found]]:
    """
    Replay a recording.

    Parameters
    ----------
    monitor : Monitor
        Monitor, as it runs beside the robot.
    recording : Recording
        Signals of one bag.

    Yields
    ------
    (int, Found)
        Header stamp [ns] and what became known with the messages of that stamp.

    """
    outputs = [(output, values) for output, values in
               (('effort', recording.effort), ('strain', recording.strain)) if values is not None]
    for k, stamp in enumerate(recording.stamp.tolist()):
        found = monitor.add_joints(stamp, recording.q[k],
                                   None if recording.dq is None else recording.dq[k])
        for output, values in outputs:
            more = monitor.add_measured(output, stamp, values[k])
            found.residuals += more.residuals
            found.excesses += more.excesses
            found.events += more.events
        yield stamp, found
