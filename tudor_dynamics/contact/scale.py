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

"""What the readings of gauges and the efforts of joints are in N m, and who says so."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.elastic.fitted import FittedElastic
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True, eq=False)
class Scale:
    """Gains of all gauges."""

    # Reading per moment, in units of the gauges; NaN where nobody knows, (gauges,) [1/(N m)].
    gain: FloatArray
    source: str  # who says so; empty for nobody

    @property
    def known(self) -> list[bool]:
        """Which gauges have one."""
        return [bool(value) for value in np.isfinite(self.gain)]


def gauge_scale(bundle: ModelBundle, kind: str) -> Scale:
    """Find the scale of the gauges."""
    model = bundle.models.get('strain', {}).get(kind)
    if isinstance(model, FittedElastic) and model.coefficients_ is not None:
        return Scale(np.array([values[0] for values in model.coefficients_]), 'elastic model')
    sensors = {sensor.gauge: sensor.gain for sensor in bundle.arm.spec.sensors}
    gain = np.array([sensors.get(name, np.nan) for name in bundle.arm.gauge_names])
    return Scale(gain, 'sensors of the arm description' if np.isfinite(gain).any() else '')


def strain_deviation(bundle: ModelBundle, kind: str) -> FloatArray:
    """
    Give what a model leaves over of strain in free motion, as a standard deviation.

    Returns (gauges,), NaN where nothing tells.
    """
    model = bundle.models['strain'][kind]
    names = bundle.arm.gauge_names
    noise = getattr(model, 'noise_', None)
    if noise is not None:
        return np.array(noise, dtype=float)
    facts: Any = bundle.facts.get('validation')
    try:
        channels = facts['strain'][kind]['validation']['channels']
        return np.array([float(channels[name]['rmse']) for name in names])
    except (KeyError, TypeError, ValueError):
        sensors = {sensor.gauge: sensor.noise for sensor in bundle.arm.spec.sensors}
        return np.array([sensors.get(name) or np.nan for name in names])


def torque_scale(arm: Arm) -> FloatArray:
    """Give the torque at active joints per unit of effort [N m or N]; NaN where unknown."""
    motors = {motor.joint: motor for motor in arm.spec.motors}
    return np.array([
        1.0 if joint.effort.unit != 'A' else
        motors[joint.name].joint_torque_constant if joint.name in motors else np.nan
        for joint in arm.joints])
