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

"""A recording replayed through a monitor that follows the load, as beside the robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.load.live import LoadFound, PayloadStage
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.online.monitor import Monitor, MonitorSettings
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True, eq=False)
class FollowedLoad:
    """A recording that was watched."""

    t: FloatArray  # time since its beginning, (samples,) [s]
    # What is thought to be carried, and its standard deviation, (samples,) [kg].
    mass: FloatArray
    std: FloatArray
    events: tuple[float, ...]  # times of collisions [s]
    loads: tuple[LoadFound, ...]  # what turned out to be a load
    times: tuple[float, ...]  # when it did [s]
    told_by: str  # output that shows the load; empty where it is not followed


def follow_load(
    bundle: ModelBundle, recording: Recording, known: float, *, estimate: bool = True,
    announced: Sequence[float] = (),
) -> FollowedLoad:
    """Replay a recording that begins with a known load [kg]; announced: times of changes [s]."""
    live = bundle.beside_robot()
    stage = PayloadStage(live, known) if estimate else None
    methods = ('strain',) if stage is None else (stage.output,)
    monitor = Monitor(live.at(known), MonitorSettings(methods=methods), payload=stage)
    begin, waiting = int(recording.stamp[0]), sorted(announced)
    mass, std = np.full(len(recording.stamp), known), np.zeros(len(recording.stamp))
    events: list[float] = []
    loads: list[LoadFound] = []
    measured = {output: values for output in monitor.watch.outputs
                if (values := getattr(recording, output)) is not None}
    for k, stamp in enumerate(recording.stamp.tolist()):
        if stage is not None and waiting and (stamp - begin) * 1e-9 >= waiting[0]:
            del waiting[0]
            stage.expect()
        velocity = None if recording.dq is None else recording.dq[k]
        found = [monitor.add_joints(stamp, recording.q[k], velocity)]
        found += [monitor.add_measured(output, stamp, values[k])
                  for output, values in measured.items()]
        events += [(event.stamp - begin) * 1e-9 for item in found for event in item.events]
        loads += [load for item in found for load in item.loads]
        if stage is not None:
            mass[k], std[k] = stage.mass, stage.std
    return FollowedLoad(recording.t, mass, std, tuple(events), tuple(loads),
                        tuple((load.stamp - begin) * 1e-9 for load in loads),
                        '' if stage is None else stage.output)
