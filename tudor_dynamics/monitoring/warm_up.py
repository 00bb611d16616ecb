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

"""
A few samples of an arm at rest, so that nothing is compiled or loaded beside the robot.

Compiled functions are compiled at their first call, on a new installation for seconds, and read
from the disk at the first call in each process, for tens of milliseconds. Samples would be lost
meanwhile.
"""

from __future__ import annotations

import numpy as np

from tudor_dynamics.arm import PreprocessingSpec
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.monitoring.health import SensorHealth
from tudor_dynamics.monitoring.monitor import Monitor
from tudor_dynamics.monitoring.predictor import OUTPUTS
from tudor_dynamics.monitoring.settings import MonitorSettings
from tudor_dynamics.monitoring.state_filter import StateFilter
from tudor_dynamics.monitoring.thresholds.onset import LAGS, STEP, WINDOW

PERIOD = 10_000_000
"""Time between samples [ns]."""


def warm_up(bundle: ModelBundle, settings: MonitorSettings) -> None:
    """Run the whole chain on an arm at rest."""
    monitor = Monitor(bundle, settings)
    arm = bundle.arm
    sizes = {'effort': len(arm.active_joints), 'strain': len(arm.gauge_names)}
    health = SensorHealth(arm.active_joints, 1.0)
    q = np.zeros(len(arm.active_joints))
    needed = bundle.preprocessing.settle + (LAGS + WINDOW) * STEP + 0.1
    monitor.wanted = {*OUTPUTS}
    for k in range(round(needed * 1e9) // PERIOD):
        monitor.add_joints(k * PERIOD, q, q)
        health.step(k * PERIOD, q)
        for output in monitor.watch.outputs:
            monitor.add_measured(output, k * PERIOD, np.zeros(sizes[output]))


def warm_up_filter(spec: PreprocessingSpec) -> None:
    """Filter an arm at rest, with velocities and without."""
    for measured in (None, np.zeros(1)):
        warmed = StateFilter(spec)
        for k in range(3):
            warmed.step(k * PERIOD, np.zeros(1), measured)
