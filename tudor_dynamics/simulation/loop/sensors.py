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
What sensors make of the truth: counts, gain, offset, noise and resolution.

Noise is drawn outside of compiled code, one row a step over all channels, whether a channel's
noise is switched on or not: one seed gives each channel its own noise whatever the others do.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.drives import MotorSpec
from tudor_dynamics.compiled import compiled
from tudor_dynamics.simulation.loop.drive import Imperfections
from tudor_dynamics.simulation.plant.outputs import Probe
from tudor_dynamics.typing import FloatArray

# Columns of the parameters of one encoder and current measurement.
COUNT, AT_MOTOR, CURRENT_NOISE, CURRENT_STEP, RIPPLE, TURNS, PHASE = range(7)
DRIVE_SENSOR = 7
# Columns of the parameters of one gauge.
PER_MOMENT, PER_RATE, COLUMN, OFFSET, NOISE, RESOLUTION = range(6)
GAUGE = 6


@compiled
def stepped(value: float, resolution: float) -> float:
    """Round to whole steps; 0 for none."""
    return value if resolution <= 0.0 else resolution * math.floor(value / resolution + 0.5)


@compiled
def encoder_reading(sensor: NDArray, rotor: float, joint: float) -> float:
    """Give the angle that an encoder has counted [rad]."""
    value = rotor if sensor[AT_MOTOR] > 0.0 else joint
    count = sensor[COUNT]
    return value if count <= 0.0 else count * math.floor(value / count)


@compiled
def current_reading(sensor: NDArray, current: float, rotor: float, noise: float) -> float:
    """Give the measured current [A], the rotor's angle being that seen at the joint [rad]."""
    value = current + sensor[CURRENT_NOISE] * noise
    if sensor[RIPPLE] > 0.0:
        value += sensor[RIPPLE] * math.cos(sensor[TURNS] * rotor + sensor[PHASE])
    return stepped(value, sensor[CURRENT_STEP])


@compiled
def gauge_reading(gauge: NDArray, loads: NDArray, noise: float) -> float:
    """Give the reading of a gauge from the loads at its section."""
    axis = int(gauge[COLUMN])
    value = gauge[PER_MOMENT] * loads[3 + axis] + gauge[PER_RATE] * loads[6 + axis]
    return stepped(value + gauge[OFFSET] + gauge[NOISE] * noise, gauge[RESOLUTION])


def drive_sensor_row(motor: MotorSpec, chosen: Imperfections) -> FloatArray:
    """Lay out encoder and current measurement of one motor; returns (DRIVE_SENSOR,)."""
    return np.array([
        motor.encoder_resolution if chosen.encoder else 0.0,
        1.0 if motor.encoder_on == 'motor' else 0.0,
        motor.current_noise if chosen.current_noise else 0.0,
        motor.current_resolution if chosen.current_resolution else 0.0,
        motor.current_ripple if chosen.current_ripple else 0.0, motor.gear_ratio,
        motor.current_ripple_phase])


def gauge_rows(arm: Arm, probe: Probe, chosen: Imperfections) -> FloatArray:
    """
    Lay out the gauges of an arm; a gauge without an entry in ``sensors`` is ideal.

    Returns (gauges, GAUGE).
    """
    sensors = {sensor.gauge: sensor for sensor in arm.spec.sensors}
    rows = np.zeros((len(arm.gauges), GAUGE))
    for row, gauge, ideal in zip(rows, arm.gauges, probe.gains, strict=True):
        row[[PER_MOMENT, PER_RATE, COLUMN]] = ideal
        sensor = sensors.get(gauge.name)
        if sensor is not None:
            scale = sensor.gain / abs(ideal[0])
            row[[PER_MOMENT, PER_RATE]] *= scale
            row[OFFSET] = sensor.offset if chosen.strain_offset else 0.0
            row[NOISE] = sensor.noise if chosen.strain_noise else 0.0
            row[RESOLUTION] = sensor.resolution if chosen.strain_resolution else 0.0
    return rows
