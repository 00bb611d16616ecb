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

"""A run as files: one ``.npz`` with everything, and a rosbag2 as the real arm would record it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.sources import refuse_interfaces
from tudor_dynamics.bags.layouts.messages import ImuSeries, JointStateSeries, Series
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.simulation.mechanics.mechanism import Mechanism
from tudor_dynamics.simulation.plant.inertial import InertialSensors
from tudor_dynamics.simulation.plant.run import Run

START_NS = 1_000_000_000
"""Stamp of the first message: 1 s, as 0 means no stamp to many tools [ns]."""


def run_series(run: Run, arm: Arm, mechanism: Mechanism) -> list[Series]:
    """Lay a run out on the topics of joint states, strains and accelerations."""
    refuse_interfaces(arm, 'a bag that is written here')
    stamp = START_NS + np.rint((run.t - run.t[0]) * 1e9).astype(np.int64)
    series: list[Series] = [JointStateSeries(
        '/' + arm.spec.joint_topic.lstrip('/'), stamp, mechanism.joints, run.q, run.dq,
        run.effort)]
    topics: dict[str, list[int]] = {}
    for index, gauge in enumerate(arm.gauges):
        topics.setdefault(gauge.topic, []).append(index)
    for topic, chosen in topics.items():
        series.append(JointStateSeries(
            '/' + topic.lstrip('/'), stamp, [arm.gauge_names[i] for i in chosen],
            run.strain[:, chosen], effort=run.gauge_moment[:, chosen]))
    for index, name in enumerate(InertialSensors(mechanism).names):
        series.append(ImuSeries(
            f'/imu/{name}', stamp, run.orientation(index), run.sensor_turning[:, index],
            run.sensor_acceleration[:, index], f'{name}_imu'))
    return series


def save_run(folder: Path, run: Run, arm: Arm, mechanism: Mechanism, *, bag: bool = True) -> None:
    """Write ``run.npz`` and ``bag/`` into a folder."""
    run.save(folder / 'run.npz', joints=np.array(mechanism.joints),
             gauges=np.array(arm.gauge_names, dtype=str), beams=np.array(list(mechanism.beams)),
             tip=np.array(mechanism.tip), sensors=np.array(InertialSensors(mechanism).names))
    if bag:
        write_bag(folder / 'bag', run_series(run, arm, mechanism))
