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

"""Schema of the hardware that simulator and damper need: motors, sensors, damper, links."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator


# -- Field types that all parts of the arm description share

LARGEST = 1e15
"""Nothing of an arm comes near it in SI units; products of a few such numbers do not overflow."""
Finite = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, le=LARGEST, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, le=LARGEST, allow_inf_nan=False)]
Vector3 = tuple[Finite, Finite, Finite]
Name = Annotated[str, Field(min_length=1, max_length=200)]


class Spec(BaseModel):
    """
    Base of all parts of the description: immutable, no unknown keys.

    The string behind a key describes it, with its unit in brackets at the end of the first
    paragraph; ``docs/arm_yaml.md`` is made of these strings.
    """

    model_config = ConfigDict(extra='forbid', frozen=True, use_attribute_docstrings=True)


# -- Schema of motors, strain sensors and damper: what only the simulator and the damper need.
#
# A fitted model does not depend on these values, so they do not enter ``Arm.digest``: another
# damper gain does not make a model useless.

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


# -- Schema of the parts of an arm description that only the simulator needs.
#
# Links are rigid or one flexible beam each; a rigid corner between two beams is a joint that is
# held. Lengths in the axes of the link's joint frame, which turns with the joint.

Axis = Literal['x', 'y', 'z'] | Vector3


class SectionSpec(Spec):
    """Cross-section of a beam; give what the shape needs and nothing else."""

    shape: Literal['rectangle', 'tube', 'general']
    """Which of the values below are needed."""
    height: Positive | None = None
    """Rectangle: extent along the height axis, which is the bending direction [m]."""
    width: Positive | None = None
    """Rectangle: extent across [m]."""
    outer: Positive | None = None
    """Tube: outer diameter [m]."""
    inner: NonNegative | None = None
    """Tube: inner diameter, 0 for a solid shaft [m]."""
    area: Positive | None = None
    """General: area of the section [m^2]."""
    Iz: Positive | None = None
    """General: second moment for bending along the height axis [m^4]."""
    Iy: Positive | None = None
    """General: second moment for bending across [m^4]."""
    J: Positive | None = None
    """Torsion constant; needed for a general section, else computed [m^4]."""
    surface: Positive | None = None
    """General: distance of the gauges from the neutral line, along the height axis [m]."""

    @model_validator(mode='after')
    def _complete(self) -> SectionSpec:
        needed = {'rectangle': ('height', 'width'), 'tube': ('outer', 'inner'),
                  'general': ('area', 'Iz', 'Iy', 'J')}[self.shape]
        allowed = {*needed, 'J', 'surface'}
        for key in needed:
            if getattr(self, key) is None:
                raise ValueError(f'a {self.shape} section needs {", ".join(needed)}; '
                                 f'{key} is missing')
        for key in ('height', 'width', 'outer', 'inner', 'area', 'Iz', 'Iy'):
            if getattr(self, key) is not None and key not in allowed:
                raise ValueError(f'{key} does not go with a {self.shape} section, '
                                 f'which needs {", ".join(needed)}')
        if self.outer is not None and self.inner is not None and self.inner >= self.outer:
            raise ValueError(f'the inner diameter {self.inner} of the tube is not below '
                             f'the outer {self.outer}')
        return self


class MaterialSpec(Spec):
    """Isotropic material: E, rho, and one of G and nu."""

    E: Positive
    """Young's modulus [Pa]."""
    rho: Positive
    """Density of the material [kg/m^3]."""
    G: Positive | None = None
    """Shear modulus, in the place of nu [Pa]."""
    nu: Annotated[float, Field(gt=-1, le=0.5)] | None = None
    """Poisson's ratio, in the place of G."""

    @model_validator(mode='after')
    def _one_of(self) -> MaterialSpec:
        if (self.G is None) == (self.nu is None):
            raise ValueError('give either the shear modulus G or the Poisson ratio nu')
        return self


class InertiaPart(Spec):
    """Mass, centre and inertia of a rigid part, in the axes of the frame it is fixed to."""

    mass: NonNegative
    """Mass of the part [kg]."""
    center: Vector3 = (0.0, 0.0, 0.0)
    """Centre of mass, in the axes of the frame that the part is fixed to [m]."""
    inertia: tuple[Finite, Finite, Finite, Finite, Finite, Finite] | NonNegative = 0.0
    """Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre of mass, or one number for a cube
    [kg m^2]."""

    @model_validator(mode='after')
    def _physical(self) -> InertiaPart:
        if isinstance(self.inertia, tuple):
            xx, yy, zz, xy, xz, yz = self.inertia
            scale = 1e-9 * (abs(xx) + abs(yy) + abs(zz)) + 1e-300
            minors = (xx, yy, zz, xx * yy - xy * xy, xx * zz - xz * xz, yy * zz - yz * yz)
            if min(minors) < -scale or max(
                    xx - yy - zz, yy - xx - zz, zz - xx - yy) > scale:
                raise ValueError('the inertia (Ixx, Iyy, Izz, Ixy, Ixz, Iyz) is not that of a '
                                 'body: principal moments must be positive and each no larger '
                                 'than the sum of the others')
        return self


class LumpedSpec(InertiaPart):
    """A rigid part fixed to a node of a beam; centre and inertia in the beam's joint frame."""

    node: Annotated[int, Field(ge=0)] | Literal['base', 'tip'] = 'tip'
    """Node, counted from 0 at the start of the beam."""


class BeamSpec(Spec):
    """One straight flexible beam."""

    section: SectionSpec
    """Cross-section, the same all along."""
    material: MaterialSpec
    """What it is made of."""
    elements: Annotated[int, Field(ge=1, le=60)] = 2
    """Beam elements it is divided into; two are enough for the lowest modes."""
    start: Vector3 = (0.0, 0.0, 0.0)
    """Where the beam is clamped, in the joint frame: the rigid offset of the hub [m]."""
    end: Vector3 | None = None
    """End of the beam in the joint frame; the next joint (or the tip) by default [m]."""
    length: Finite | None = None
    """Alternative to ``end``: length along ``direction`` [m]."""
    direction: Axis = 'x'
    """Direction of the beam in the joint frame, with ``length``."""
    height_axis: Axis | None = None
    """Direction of the section's height in the joint frame; in the plane of motion by default."""
    stretch: bool = True
    """Bending shortens the beam, and its normal force stiffens it; false: linear beam."""
    lumped: tuple[LumpedSpec, ...] = ()
    """Rigid parts fixed to nodes."""

    @model_validator(mode='after')
    def _geometry(self) -> BeamSpec:
        if self.length is not None and self.length <= 0:
            raise ValueError(f'the length of a beam must be positive, found {self.length} m')
        if self.length is not None and self.end is not None:
            raise ValueError('give either the end of the beam or its length, not both')
        for part in self.lumped:
            if isinstance(part.node, int) and part.node > self.elements:
                raise ValueError(f'a lumped part sits at node {part.node}, but a beam of '
                                 f'{self.elements} elements has nodes 0 to {self.elements}')
        return self


class LinkSpec(Spec):
    """The link behind one joint: rigid or flexible, and what sits at its hub."""

    joint: Name
    """Joint that moves this link."""
    rigid: InertiaPart | None = None
    """Rigid link, in the joint frame: with standard D-H rows not the row's own frame."""
    flexible: BeamSpec | None = None
    """Flexible link: one straight beam."""
    hub_inertia: NonNegative = 0.0
    """Rotor, gear and hub on the motor side, seen at the joint [kg m^2 or kg]."""
    joint_stiffness: Positive | None = None
    """Torsional stiffness between motor and link; rigid by default [N m/rad or N/m]."""
    joint_damping: NonNegative = 0.0
    """Damping of that spring [N m s/rad or N s/m]."""
    viscous_friction: NonNegative = 0.0
    """Friction of the joint [N m s/rad or N s/m]."""

    @model_validator(mode='after')
    def _damping_needs_spring(self) -> LinkSpec:
        if self.joint_damping > 0 and self.joint_stiffness is None:
            raise ValueError('joint_damping is the damping of the joint spring: give '
                             'joint_stiffness too, or use viscous_friction')
        return self


class RayleighSpec(Spec):
    """Structural damping C = alpha M + beta K."""

    alpha: NonNegative = 0.0
    """Damping by the masses, felt by slow modes [1/s]."""
    beta: NonNegative = 0.0
    """Damping by the stiffness, felt by fast modes [s]."""


class SimulationSpec(Spec):
    """How a run starts and what damps it."""

    rayleigh: RayleighSpec = RayleighSpec()
    """Structural damping of the beams."""
    initial: dict[Name, Finite] = Field(default_factory=dict)
    """Initial position by joint; 0, or where the joint is held [rad or m]."""
    start: Literal['equilibrium', 'undeformed'] = 'equilibrium'
    """Elastic state at the start: static under gravity, or straight."""


def six_components(inertia: tuple[float, ...] | float) -> tuple[float, ...]:
    """Give the six components of an inertia that may be one number [kg m^2]."""
    if isinstance(inertia, tuple):
        return inertia
    return (inertia, inertia, inertia, 0.0, 0.0, 0.0)


def check_links(links: tuple[LinkSpec, ...], simulation: SimulationSpec, names: list[str]) -> None:
    """Check that links and initial positions name joints of the arm."""
    seen: list[str] = []
    for link in links:
        if link.joint not in names:
            raise ValueError(f'links: {link.joint!r} is not among the joints {names}')
        if link.joint in seen:
            raise ValueError(f'links: joint {link.joint!r} has two entries; merge them')
        if link.rigid is not None and link.flexible is not None:
            raise ValueError(f'links: the link of joint {link.joint!r} is rigid and flexible; '
                             'leave one out')
        seen.append(link.joint)
    for name in simulation.initial:
        if name not in names:
            raise ValueError(f'simulation.initial: {name!r} is not among the joints {names}')


def check_overlap(links: tuple[LinkSpec, ...], motors: list[str]) -> None:
    """Check that rotor, gear and friction of a joint stand in one place."""
    for link in links:
        if link.joint not in motors:
            continue
        for key, other in (('hub_inertia', 'rotor_inertia'), ('joint_stiffness', 'stiffness'),
                           ('viscous_friction', 'viscous')):
            if getattr(link, key):
                raise ValueError(
                    f'links: joint {link.joint!r} has {key} and an entry in motors; what its '
                    f'drive adds stands in motors alone: give {other} there, remove {key} here')
