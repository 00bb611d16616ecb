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
Schema of motors, strain sensors and damper: what only the simulator and the damper need.

A fitted model does not depend on these values, so they do not enter ``Arm.digest``: another
damper gain does not make a model useless.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from tudor_dynamics.arm.fields import Finite, Name, NonNegative, Positive, Spec


def _both_directions(value: Any) -> Any:
    return (value, value) if isinstance(value, (int, float)) else value


PerDirection = Annotated[tuple[NonNegative, NonNegative], BeforeValidator(_both_directions)]
"""Magnitudes for positive and for negative motion; one number stands for both."""

DRIVE_TIMEOUT = 0.1
"""Time without a command from which on drives stop, where the description does not say [s]."""


class MotorSpec(Spec):
    """Motor, gear, encoder and current measurement of one revolute joint."""

    joint: Name
    """Joint that it drives."""
    gear_ratio: Positive
    """Turns of the motor for one turn of the joint."""
    torque_constant: Positive
    """Torque at the motor shaft per ampere [N m/A]."""
    efficiency: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Part of that torque that arrives behind the gear, the same in both directions."""
    rotor_inertia: NonNegative = 0.0
    """Inertia of the rotor, at the motor shaft [kg m^2]."""
    viscous: PerDirection = (0.0, 0.0)
    """Current against viscous friction, by the speed of the joint; one number, or one for each
    direction [A s/rad]."""
    coulomb: PerDirection = (0.0, 0.0)
    """Current against Coulomb friction; one number, or one for each direction [A]."""
    breakaway: Annotated[float, Field(ge=1, le=10)] = 1.0
    """Stiction: friction at rest as a multiple of Coulomb friction."""
    load_friction: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Coulomb friction on top, per torque through the gear: 1/efficiency - 1 of the teeth."""
    presliding: Annotated[float, Field(ge=0, lt=math.pi)] = 0.0
    """How far friction gives way like a spring before it slides, seen at the joint [rad]."""
    current_limit: Positive | None = None
    """Largest current of the drive, in either direction [A]."""
    stiffness: Positive | None = None
    """Torsion of the gear, seen at the joint; rigid by default [N m/rad]."""
    damping: NonNegative = 0.0
    """Damping of that torsion [N m s/rad]."""
    backlash: Annotated[float, Field(ge=0, lt=math.pi)] = 0.0
    """Full width of the play, seen at the joint [rad]."""
    encoder_lines: Annotated[int, Field(gt=0, le=2**31)] | None = None
    """Lines of the encoder, each giving four counts; ideal by default."""
    encoder_on: Literal['motor', 'joint'] = 'motor'
    """Shaft that carries the encoder."""
    current_noise: NonNegative = 0.0
    """Standard deviation of the measured current [A]."""
    current_ripple: NonNegative = 0.0
    """Amplitude of an error of the measured current that comes once a turn of the motor [A]."""
    current_ripple_phase: Finite = 0.0
    """That error is ripple * cos(angle of the motor + phase) [rad]."""
    current_resolution: NonNegative = 0.0
    """Step of the measured current, 0 for none [A]."""

    @property
    def joint_torque_constant(self) -> float:
        """Torque at the joint per ampere, efficiency included [N m/A]."""
        return self.torque_constant * self.gear_ratio * self.efficiency

    @property
    def reflected_inertia(self) -> float:
        """Inertia of the rotor as the joint feels it [kg m^2]."""
        return self.rotor_inertia * self.gear_ratio**2

    @property
    def encoder_resolution(self) -> float:
        """Smallest step of the measured joint angle, 0 for an ideal encoder [rad]."""
        if self.encoder_lines is None:
            return 0.0
        turn = 2 * math.pi / (4 * self.encoder_lines)
        return turn / self.gear_ratio if self.encoder_on == 'motor' else turn


class SensorSpec(Spec):
    """How one strain gauge turns a bending moment into a reading."""

    gauge: Name
    """Gauge that it describes."""
    gain: Finite
    """Reading per bending moment [unit of the gauge per N m]."""
    offset: Finite = 0.0
    """Reading without load [unit of the gauge]."""
    noise: NonNegative = 0.0
    """Standard deviation of the reading [unit of the gauge]."""
    resolution: NonNegative = 0.0
    """Step of the reading, 0 for none [unit of the gauge]."""

    @model_validator(mode='after')
    def _sensitive(self) -> SensorSpec:
        if self.gain == 0:
            raise ValueError('gain 0 means a gauge that measures nothing: '
                             'give the reading per N m, or leave the sensor out')
        return self


class DamperJointSpec(Spec):
    """Strain feedback of one joint."""

    joint: Name
    """Joint that yields."""
    gauge: Name
    """Gauge that it yields to, in um/m or m/m."""
    gain: NonNegative
    """Yielding speed of the joint per mean-free strain [rad/s per m/m]."""


class DamperSpec(Spec):
    """Position loop with mean-free strain feedback, on top of a velocity loop."""

    position_gain: Positive
    """Speed per position error [1/s]."""
    mean_frequency: Positive
    """Corner below which strain counts as load and not as oscillation: DC blocker [Hz]."""
    moving_frequency: Positive | None = None
    """The same while the reference moves, when the load changes with the pose; by default
    mean_frequency [Hz]."""
    mean_window: Positive | None = None
    """Take the mean over a moving window instead [s]."""
    velocity_bandwidth: Positive
    """Bandwidth of the velocity loop inside [Hz]."""
    rate: Annotated[float, Field(gt=0, le=1e6)] = 2000.0
    """Rate at which the law runs [Hz]."""
    full_delay: Positive = 0.01
    """Delay of the loop up to which the gains hold; beyond, the damper takes less [s]."""
    drive_timeout: NonNegative = DRIVE_TIMEOUT
    """Time without a command from which on the drives brake by themselves, as planned motion does:
    before each position limit there is room left for that [s]."""
    joints: tuple[DamperJointSpec, ...] = Field(min_length=1, max_length=100)
    """Joints with strain feedback, each with its gauge and gain."""

    @model_validator(mode='after')
    def _separate_bands(self) -> DamperSpec:
        if self.mean_frequency >= self.velocity_bandwidth:
            raise ValueError(
                f'mean_frequency {self.mean_frequency} Hz is not below velocity_bandwidth '
                f'{self.velocity_bandwidth} Hz: nothing is left between them to damp')
        if self.rate <= 2 * self.velocity_bandwidth:
            raise ValueError(f'rate {self.rate} Hz is too slow for velocity_bandwidth '
                             f'{self.velocity_bandwidth} Hz: give more than twice as much')
        return self


def _check_names(
    key: str, what: str, named: Sequence[str], known: Sequence[str], *, once: bool,
) -> None:
    for name in named:
        if name not in known:
            raise ValueError(f'{key} names the {what} {name!r}, which is not among the '
                             f'{what}s {list(known)}')
        if once and named.count(name) > 1:
            raise ValueError(f'{key} has the {what} {name!r} twice')


def check_drives(
    motors: Sequence[MotorSpec],
    sensors: Sequence[SensorSpec],
    damper: DamperSpec | None,
    joints: Sequence[str],
    gauges: Sequence[str],
) -> None:
    """Check that the names in these parts are those of the arm, each once."""
    _check_names('motors', 'joint', [m.joint for m in motors], joints, once=True)
    _check_names('sensors', 'gauge', [s.gauge for s in sensors], gauges, once=True)
    if damper is not None:
        _check_names('damper', 'joint', [d.joint for d in damper.joints], joints, once=True)
        _check_names('damper', 'gauge', [d.gauge for d in damper.joints], gauges, once=False)
