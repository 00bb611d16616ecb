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
The arm description as it stands in ``config/*.yaml``: keys, types, units, bounds, and who reads.

Every key is checked here and nowhere else. Unknown keys are refused, because a misspelt key that
is silently ignored gives a wrong model. A key is one entry: its type with bounds and readers, its
default, and the string after it, of which ``docs/reference/arm_yaml.md`` is made.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import math
import re
from typing import Annotated, Any, get_args, Literal

import numpy as np
from pydantic import (
    BaseModel, BeforeValidator, ConfigDict, Field, field_validator, model_validator,
    ValidationError)

from tudor_dynamics.errors import meant
from tudor_dynamics.typing import FloatArray

LARGEST = 1e15
"""Nothing of an arm comes near it in SI units; products of a few such numbers do not overflow
(1e15 to the 20th power is the largest double)."""
Finite = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, le=LARGEST, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, le=LARGEST, allow_inf_nan=False)]
Vector3 = tuple[Finite, Finite, Finite]
Name = Annotated[str, Field(min_length=1, max_length=200)]


def read_by(letters: str) -> Any:
    """
    Say who reads a key, or the keys of a part that say nothing.

    M: fit and models; E: the elastic model; S: ``tudor simulate``; R: ``tudor record``; D: the
    damper; G: the reference generator. A key without a word has the readers of its part.
    """
    return Field(json_schema_extra={'read_by': letters})


class Spec(BaseModel):
    """
    Base of all parts of the description: immutable, no unknown keys.

    The string after a key describes it, with its unit in brackets at the end of the first
    paragraph; ``docs/reference/arm_yaml.md`` is made of these strings.
    """

    model_config = ConfigDict(extra='forbid', frozen=True, use_attribute_docstrings=True)

    def mistakes(self) -> Iterator[str]:
        """Say what is wrong with keys that are right by themselves; the first one counts."""
        yield from ()

    @model_validator(mode='after')
    def _without_mistakes(self) -> Spec:
        for text in self.mistakes():
            raise ValueError(text)
        return self


NEWTON_METRE = ('N m', 'Nm', 'N*m', 'N·m', 'N⋅m', 'N.m')
"""Spellings of one unit; the first is used everywhere."""
MAX_INDEX = 1000  # values of an array that may be named
AUTO = 'auto'  # what stands for a key that is left open: the same as no key
FrictionTerm = Literal['viscous', 'coulomb', 'offset', 'stribeck', 'cube_root', 'square', 'load',
                       'presliding']
FRICTION_TERMS: tuple[str, ...] = get_args(FrictionTerm)
"""Names; what each of them does stands in ``models/friction.py``."""
STATE_KEYS = {'presliding': 'presliding_distances'}
"""Term with a state to the key of a joint that has a value for each of its columns."""
FRICTION_KEYS = ('friction', 'asymmetric', 'friction_velocity', 'stribeck_velocity',
                 *STATE_KEYS.values())
"""Keys of a joint that say which friction is identified."""


def without_auto(key: str) -> Callable[[Any], Any]:
    """Make a check that takes ``auto`` for a key that is left open."""
    def check(content: Any) -> Any:
        if isinstance(content, dict) and content.get(key) == AUTO:
            return {name: value for name, value in content.items() if name != key}
        return content
    return check


def one_spelling(unit: Any) -> Any:
    """Write a unit as it is written everywhere; anything else stays what it is."""
    return NEWTON_METRE[0] if unit in NEWTON_METRE else unit


EffortUnit = Annotated[Literal['A', 'N m', 'N'], BeforeValidator(one_spelling)]
StrainUnit = Annotated[Literal['um/m', 'm/m', 'mV/V', 'V', 'N m'], BeforeValidator(one_spelling)]


LARGEST_CONDITION = 1e6
"""Of a coupling matrix: beyond it, motions of single joints cannot be distinguished by the
motors."""


class KinematicsSpec(Spec):
    """Where the kinematics come from: a URDF file, or D-H rows; one of the two."""

    urdf: str | None = None
    """Path of a URDF file, relative to the description; its rigid links come along."""
    dh: tuple[tuple[Finite, Finite, Finite, Finite], ...] | None = None
    """One row ``[a, alpha, d, theta_offset]`` a joint, base first [m, rad, m, rad]."""
    convention: Literal['standard', 'modified'] = 'standard'
    """Of the rows: standard (Siciliano), or modified (Craig), as Franka and KUKA publish it.

    Everything else of a link (centres of mass, beams, gauges) is given in the frame of its joint,
    which turns with it, z along its axis. Its origin stands before the d and a of a standard row,
    so it is not the D-H frame, which is at the far end; after those of a modified one, so it is.
    A modified table may have a row more, for a flange that is fixed to the last link.
    """

    def mistakes(self) -> Iterator[str]:
        if (self.urdf is None) == (self.dh is None):
            yield 'give either urdf: FILE or dh: [[a, alpha, d, theta_offset], ...]'
        if self.urdf is not None and self.convention != 'standard':
            yield 'convention is for D-H rows only; remove it, or give dh, not urdf'


class SourceSpec(Spec):
    """The topic of a value, and its place there where that is no JointState."""

    topic: Name
    index: Annotated[int, Field(ge=0, lt=MAX_INDEX)] | None = None
    """Place of the value in a std_msgs/Float64MultiArray, from 0; its messages have no stamp, so
    the log time counts in a bag, and in a node when they arrive."""
    interface: Name | None = None
    """Interface in a control_msgs/DynamicJointState, such as current; for bags alone, nodes
    refuse it."""

    def mistakes(self) -> Iterator[str]:
        if self.index is not None and self.interface is not None:
            yield ('give either index (of a Float64MultiArray) or interface (of a '
                   'DynamicJointState), not both')

    def for_digest(self) -> dict[str, Any]:
        """Give all keys with their values, without those that older versions did not have."""
        return {key: value for key, value in self.model_dump(mode='json').items()
                if value is not None or key not in ('index', 'interface')}


class EffortSpec(SourceSpec):
    """The topic on which a joint's actuator effort arrives, and what it is measured in."""

    topic: Name = 'joint_states'
    """Topic of type sensor_msgs/JointState, whose field ``effort`` is read; of another type with
    ``index`` or ``interface``."""
    unit: EffortUnit = 'N m'
    """What the driver publishes: motor current, torque, or force of a prismatic joint."""
    torque_constant: Annotated[Positive | None, read_by('ME')] = None
    """Joint torque per ampere, gear and efficiency included; unknown by default [N m/A or N/A]."""

    def mistakes(self) -> Iterator[str]:
        yield from super().mistakes()
        if self.torque_constant is not None and self.unit != 'A':
            yield f'torque_constant needs unit: A, but unit is {self.unit}; correct it'


class LimitSpec(Spec):
    """What the motion of a joint never exceeds; what is missing is taken from the URDF."""

    lower: Finite | None = None
    """Smallest position [rad or m]."""
    upper: Finite | None = None
    """Largest position [rad or m]."""
    velocity: Positive | None = None
    """Largest speed in either direction [rad/s or m/s]."""
    acceleration: Positive | None = None
    """Largest acceleration of the drive; by default what its motor can do without load
    [rad/s^2 or m/s^2]."""

    def mistakes(self) -> Iterator[str]:
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            yield f'lower {self.lower} is not below upper {self.upper}; correct either'


class PlannedSpec(LimitSpec):
    """What planned motion keeps to: within ``limits``, with room for the damper and to stop."""

    velocity: Positive | None = None
    """Largest speed; two thirds of that of ``limits`` by default [rad/s or m/s]."""
    acceleration: Positive | None = None
    """Largest acceleration; a third of that of ``limits`` by default [rad/s^2 or m/s^2]."""


class JointSpec(Spec):
    """One joint, by the name that its messages carry."""

    name: Name
    """Name as it stands in JointState messages, and in the URDF."""
    type: Literal['revolute', 'continuous', 'prismatic'] | None = None  # noqa: A003
    """Needed with D-H rows (default revolute); a URDF has it already."""
    effort: Annotated[EffortSpec, read_by('MER')] = EffortSpec()
    """Where the effort of its actuator comes from."""
    friction: Annotated[tuple[FrictionTerm, ...], read_by('ME')] = ('viscous', 'coulomb')
    """Terms of friction to identify, each a column of the regressor; where the key is left out, or
    ``auto``, ``tudor fit`` chooses by left-out parts, and all else takes the default."""
    asymmetric: Annotated[bool, read_by('ME')] = False
    """Separate viscous and Coulomb coefficients for each direction of motion."""
    rotor_inertia: Annotated[bool, read_by('ME')] = True
    """Identify the inertia of the motor, seen through the gear, as a parameter of its own."""
    friction_velocity: Annotated[Positive, read_by('ME')] = 0.02
    """Speed over which the sign of the velocity is smoothed [rad/s or m/s]."""
    stribeck_velocity: Annotated[Positive, read_by('ME')] = 0.1
    """Speed at which the Stribeck term has decayed to 1/e [rad/s or m/s]."""
    presliding_distances: tuple[Positive, ...] = Field((0.003,), min_length=1, max_length=8)
    """Displacements from rest to sliding of the term ``presliding``: springs that give way, each
    with a coefficient of its own [rad or m]."""
    hold: Annotated[Finite, read_by('MESR')] = 0.0
    """Position of the joint where it is not active [rad or m]."""
    limits: Annotated[LimitSpec | None, read_by('MRDG')] = None
    """What nothing ever exceeds."""
    planned: Annotated[PlannedSpec | None, read_by('RDG')] = None
    """What motion is planned with."""

    def mistakes(self) -> Iterator[str]:
        planned, limits = self.planned or PlannedSpec(), self.limits or LimitSpec()
        for key, outwards in (('lower', -1.0), ('upper', 1.0), ('velocity', 1.0),
                              ('acceleration', 1.0)):
            inner, outer = getattr(planned, key), getattr(limits, key)
            if inner is not None and outer is not None and outwards * (inner - outer) > 0.0:
                yield (f'planned.{key} {inner:g} is beyond limits.{key} {outer:g}, within '
                       'which plans must keep; correct either value')

    _open = model_validator(mode='before')(without_auto('friction'))

    @field_validator('friction', *STATE_KEYS.values())
    @classmethod
    def _no_repetition(cls, terms: tuple[str | float, ...]) -> tuple[str | float, ...]:
        if len(set(terms)) != len(terms):
            raise ValueError(f'{", ".join(map(str, terms))} has an entry twice; list each once')
        return terms

    def state_values(self, term: str) -> tuple[float, ...]:
        """Give the values of a friction term with a state, one a column; none without it."""
        values: tuple[float, ...] = (getattr(self, STATE_KEYS[term])
                                     if term in STATE_KEYS and term in self.friction else ())
        return values

    def for_digest(self) -> dict[str, Any]:
        """Give the keys that a fitted model depends on, with their values."""
        content = self.model_dump(mode='json', exclude={'effort', 'limits', 'planned'})
        for term, key in STATE_KEYS.items():
            if term not in self.friction:  # digests of versions that did not have it still hold
                del content[key]
        return {**content, 'effort': self.effort.for_digest()}


class GaugeSpec(SourceSpec):
    """A strain gauge (bridge) on the link after a joint."""

    name: Name
    """Name as it stands in the messages of its topic."""
    joint: Name
    """Joint before it: the gauge sits on the link after it."""
    distance: NonNegative
    """Place along the link, from the joint axis: x_s of the papers [m]."""
    axis: Literal['x', 'y', 'z'] | Vector3 | None = None
    """Bending axis in the joint's frame; the joint's own axis by default."""
    direction: Literal['x', 'y', 'z'] | Vector3 = 'x'
    """Direction of the link in the joint's frame."""
    topic: Name = 'link_strains'
    """Topic of type sensor_msgs/JointState, whose field ``position`` is read; of another type with
    ``index`` or ``interface``."""
    unit: StrainUnit = 'um/m'
    """What its amplifier publishes; the damper needs a strain, um/m or m/m."""

    @field_validator('axis', 'direction')
    @classmethod
    def _has_length(cls, vector: str | Vector3 | None) -> str | Vector3 | None:
        if isinstance(vector, tuple) and math.hypot(*vector) < 1e-12:
            raise ValueError('a vector of length 0 has no direction; give x, y, z or [0, 0, 1]')
        return vector


class CouplingPair(Spec):
    """One motor that another joint turns as well."""

    motor: Name
    """Joint whose motor it is."""
    joint: Name
    """Other joint that turns it."""
    ratio: Finite
    """Turns of the motor for one turn of that joint, in turns of the motor for one of its own;
    -1 where it turns the other way [1, or rad/m or m/rad where one of both slides]."""

    def mistakes(self) -> Iterator[str]:
        if self.motor == self.joint:
            yield f'motor and joint are both {self.motor!r}; name two different joints'


class CouplingsSpec(Spec):
    """How motors turn with joints; friction and rotor inertia act where the motors are."""

    pairs: tuple[CouplingPair, ...] = ()
    """Motors with the other joints that turn them."""
    matrix: tuple[tuple[Finite, ...], ...] | None = Field(default=None, max_length=100)
    """In place of ``pairs``: speeds of the motors, as the joints' own would be without coupling,
    by speeds of the joints; a row a motor and a column a joint, in the order of ``joints`` [1, or
    rad/m or m/rad]."""
    positions: Literal['joints', 'motors'] = 'joints'
    """What positions and velocities in the messages are those of."""
    efforts: Literal['joints', 'motors'] = 'joints'
    """What efforts in the messages are those of."""

    def mistakes(self) -> Iterator[str]:
        if (self.matrix is None) == (not self.pairs):
            yield 'give either pairs: [{motor, joint, ratio}, ...] or matrix: [[...]]'

    def speeds(self, joints: Sequence[str]) -> FloatArray:
        """Give the speeds of all motors by those of all joints; returns (joints, joints)."""
        n = len(joints)
        if self.matrix is not None:
            if len(self.matrix) != n or any(len(row) != n for row in self.matrix):
                raise ValueError(f'couplings.matrix: expected {n} rows of {n} numbers: a row '
                                 'for each motor, a column for each joint')
            matrix = np.array(self.matrix)
        else:
            matrix = np.eye(n)
            for pair in self.pairs:
                for name in (pair.motor, pair.joint):
                    if name not in joints:
                        raise ValueError(f'couplings names the joint {name!r}, which is not among '
                                         f'the joints {", ".join(joints)}; correct the name')
                matrix[joints.index(pair.motor), joints.index(pair.joint)] += pair.ratio
        if not np.linalg.cond(matrix) < LARGEST_CONDITION:
            raise ValueError('couplings: the positions of the motors do not determine those of '
                             'the joints (singular matrix); correct the ratios')
        return matrix


class PreprocessingSpec(Spec):
    """How positions become velocities and accelerations, and how often samples are used."""

    filter: Annotated[Literal['causal', 'zero_phase'], read_by('ME')] = 'causal'  # noqa: A003
    """The papers' causal filters, or zero-phase ones (offline; causal ones beside the robot); left
    out, or ``auto``: ``tudor fit`` chooses by left-out parts, all else takes the default."""
    velocity_cutoff: Positive = 80.0
    """First-order low-pass after the first difference quotient, causal [Hz]."""
    acceleration_cutoff: Annotated[Positive, read_by('ME')] = 20.0
    """First-order low-pass after the second difference quotient, causal [Hz]."""
    output_cutoff: Annotated[Positive | None, read_by('ME')] = None
    """First-order low-pass over positions, velocities, efforts and strains, causal [Hz]."""
    cutoff: Annotated[Positive | None, read_by('ME')] = None
    """Butterworth cut-off, zero-phase; a tenth of the sample rate by default [Hz]."""
    measured_velocity: Annotated[bool, read_by('ME')] = True
    """Take the driver's velocity where the bag has it."""
    rate: Annotated[Positive | None, read_by('ME')] = 20.0
    """Rate to decimate to for identification and evaluation; null for every sample [Hz]."""
    settle: Annotated[NonNegative, read_by('ME')] = 0.5
    """What is left out at the start of each gapless stretch, and at its end if zero-phase [s]."""

    _open = model_validator(mode='before')(without_auto('filter'))


PerDirection = Annotated[tuple[NonNegative, NonNegative], BeforeValidator(
    lambda value: (value, value) if isinstance(value, (int, float)) else value)]
"""Magnitudes for positive and for negative motion; one number stands for both."""

DRIVE_TIMEOUT = 0.1
"""Time without a command from which on drives stop, where the description does not say [s]."""
LONGEST_FULL_DELAY = 0.05
"""A delay is measured up to 0.25 s, which has to switch off any damper: at five times the full
delay (`control.settings.DELAY_LONGEST`, ``DELAY_GONE``) [s]."""
LOOP_PHASE = 0.25
"""Largest position gain times the lag of the drives: as `control.settings.DELAY_PHASE`."""


class MotorSpec(Spec):
    """Motor, gear, encoder and current measurement of one revolute joint."""

    model_config = ConfigDict(json_schema_extra={'read_by': 'R'})

    joint: Annotated[Name, read_by('ESRDG')]
    """Joint that it drives."""
    gear_ratio: Annotated[Positive, read_by('SRDG')]
    """Turns of the motor for one turn of the joint."""
    torque_constant: Annotated[Positive, read_by('SRDG')]
    """Torque at the motor shaft per ampere [N m/A]."""
    efficiency: Annotated[float, Field(gt=0, le=1), read_by('SRDG')] = 1.0
    """Part of that torque that arrives after the gear, the same in both directions."""
    rotor_inertia: Annotated[NonNegative, read_by('SRDG')] = 0.0
    """Inertia of the rotor, at the motor shaft [kg m^2]."""
    viscous: Annotated[PerDirection, read_by('SR')] = (0.0, 0.0)
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
    current_limit: Annotated[Positive | None, read_by('RDG')] = None
    """Largest current of the drive, in either direction [A]."""
    stiffness: Annotated[Positive | None, read_by('ESR')] = None
    """Torsion of the gear, seen at the joint; rigid by default [N m/rad]."""
    damping: Annotated[NonNegative, read_by('ESR')] = 0.0
    """Damping of that torsion [N m s/rad]."""
    backlash: Annotated[float, Field(ge=0, lt=math.pi), read_by('ER')] = 0.0
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
        """Inertia of the rotor as seen from the joint [kg m^2]."""
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

    def mistakes(self) -> Iterator[str]:
        if self.gain == 0:
            yield ('with a gain of 0 the gauge would measure nothing; give its reading '
                   'per N m, or remove this entry')


class DamperJointSpec(Spec):
    """Strain feedback of one joint."""

    joint: Name
    """Joint that yields."""
    gauge: Name
    """Gauge that it yields to, in um/m or m/m."""
    gain: Annotated[float, Field(ge=0, le=1e4)]
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
    """Rate of the law in the simulator; the node runs at that of its messages [Hz]."""
    full_delay: Annotated[float, Field(gt=0, le=LONGEST_FULL_DELAY)] = 0.01
    """Delay of the loop up to which the gains hold; beyond, the damper takes less [s]."""
    drive_timeout: Annotated[float, Field(ge=0, le=1)] = DRIVE_TIMEOUT
    """Time without a command from which on the drives brake by themselves, as planned motion does:
    before each position limit there is room left for that [s]."""
    joints: tuple[DamperJointSpec, ...] = Field(min_length=1, max_length=100)
    """Joints with strain feedback, each with its gauge and gain."""

    def mistakes(self) -> Iterator[str]:
        if self.mean_frequency >= self.velocity_bandwidth:
            yield (f'mean_frequency {self.mean_frequency} Hz is not below velocity_bandwidth '
                   f'{self.velocity_bandwidth} Hz; the damper acts in between: lower '
                   'mean_frequency')
        largest = LOOP_PHASE * 2.0 * math.pi * self.velocity_bandwidth
        if self.position_gain > largest:
            yield (f'position_gain {self.position_gain:g} 1/s is above the {largest:.3g} 1/s that '
                   f'drives with a velocity_bandwidth of {self.velocity_bandwidth:g} Hz stand; '
                   'lower position_gain')
        if self.rate <= 2 * self.velocity_bandwidth:
            yield (f'rate {self.rate} Hz is not above twice the velocity_bandwidth of '
                   f'{self.velocity_bandwidth} Hz; increase rate')


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
    """Distance of the gauges from the neutral line, along the height axis [m]."""

    def mistakes(self) -> Iterator[str]:
        needed = {'rectangle': ('height', 'width'), 'tube': ('outer', 'inner'),
                  'general': ('area', 'Iz', 'Iy', 'J')}[self.shape]
        allowed = {*needed, 'J', 'surface'}
        for key in needed:
            if getattr(self, key) is None:
                yield f'a {self.shape} section needs {", ".join(needed)}; {key} is missing; add it'
        for key in ('height', 'width', 'outer', 'inner', 'area', 'Iz', 'Iy'):
            if getattr(self, key) is not None and key not in allowed:
                yield (f'a {self.shape} section has no {key}, but {", ".join(needed)}; '
                       f'remove {key}, or correct shape')
        if self.outer is not None and self.inner is not None and self.inner >= self.outer:
            yield (f'the inner diameter {self.inner:g} m of the tube is not below the '
                   f'outer diameter {self.outer:g} m; correct inner or outer')


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

    def mistakes(self) -> Iterator[str]:
        if (self.G is None) == (self.nu is None):
            yield (f'shear modulus G and Poisson ratio nu are both '
                   f'{"missing" if self.G is None else "given"}; give one of them')


class InertiaPart(Spec):
    """Mass, centre and inertia of a rigid part, in the axes of the frame it is fixed to."""

    mass: NonNegative
    """Mass of the part [kg]."""
    center: Vector3 = (0.0, 0.0, 0.0)
    """Centre of mass, in the axes of the frame that the part is fixed to [m]."""
    inertia: tuple[Finite, Finite, Finite, Finite, Finite, Finite] | NonNegative = 0.0
    """Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre of mass, or one number for a cube [kg m^2]."""

    def mistakes(self) -> Iterator[str]:
        if isinstance(self.inertia, tuple):
            xx, yy, zz, xy, xz, yz = self.inertia
            moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            scale = 1e-9 * float(np.abs(moments).sum()) + 1e-300
            if moments[0] < -scale or moments[2] - moments[0] - moments[1] > scale:
                a, b, c = (f'{moment:.4g}' for moment in moments)
                why = f'{a} is negative' if moments[0] < -scale else f'{c} is above {a} + {b}'
                yield (f'no rigid body has the principal moments of inertia {a}, {b}, {c} kg m^2, '
                       f'as {why}; correct Ixx, Iyy, Izz, Ixy, Ixz, Iyz')

    @property
    def components(self) -> tuple[float, ...]:
        """All six components of the inertia [kg m^2]."""
        if isinstance(self.inertia, tuple):
            return self.inertia
        return (self.inertia, self.inertia, self.inertia, 0.0, 0.0, 0.0)


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

    def mistakes(self) -> Iterator[str]:
        if self.length is not None and self.length <= 0:
            yield f'the length of a beam must be positive, found {self.length} m'
        if self.length is not None and self.end is not None:
            yield 'give either the end of the beam or its length, not both'
        for part in self.lumped:
            if isinstance(part.node, int) and part.node > self.elements:
                yield (f'an entry under lumped has the node {part.node}, but the last node is '
                       f"{self.elements}; correct its key 'node', or raise 'elements'")


class LinkSpec(Spec):
    """The link after one joint: rigid or flexible, and what sits at its hub."""

    joint: Name
    """Joint that moves this link."""
    rigid: InertiaPart | None = None
    """Rigid link, in the joint frame: with standard D-H rows not the row's own frame."""
    flexible: BeamSpec | None = None
    """Flexible link: one straight beam."""
    hub_inertia: Annotated[NonNegative, read_by('SR')] = 0.0
    """Rotor, gear and hub on the motor side, seen at the joint [kg m^2 or kg]."""
    joint_stiffness: Positive | None = None
    """Torsional stiffness between motor and link; rigid by default [N m/rad or N/m]."""
    joint_damping: NonNegative = 0.0
    """Damping of that spring [N m s/rad or N s/m]."""
    viscous_friction: Annotated[NonNegative, read_by('SR')] = 0.0
    """Friction of the joint [N m s/rad or N s/m]."""

    def mistakes(self) -> Iterator[str]:
        if self.joint_damping > 0 and self.joint_stiffness is None:
            yield ('joint_damping damps the spring of an elastic joint; give its '
                   'joint_stiffness too, or, for a rigid joint, viscous_friction')


class RayleighSpec(Spec):
    """Structural damping C = alpha M + beta K."""

    alpha: NonNegative = 0.0
    """Damping by the masses, of slow modes above all [1/s]."""
    beta: NonNegative = 0.0
    """Damping by the stiffness, of fast modes above all [s]."""


class SimulationSpec(Spec):
    """How a run starts and what damps it."""

    rayleigh: RayleighSpec = RayleighSpec()
    """Structural damping of the beams."""
    initial: Annotated[dict[Name, Finite], read_by('SR')] = Field(default_factory=dict)
    """Initial position by joint; 0, or where the joint is held [rad or m]."""
    start: Annotated[Literal['equilibrium', 'undeformed'], read_by('S')] = 'equilibrium'
    """Elastic state at the start: static under gravity, or straight."""


class ArmSpec(Spec):
    """A whole arm description."""

    name: Name
    """Name of the arm, for messages, reports and models."""
    kinematics: KinematicsSpec
    """Joints and links as a URDF or as D-H rows."""
    gravity: Vector3 = (0.0, 0.0, -9.81)
    """Gravity in the base frame; another one for an arm that hangs or leans [m/s^2]."""
    joints: tuple[JointSpec, ...] = Field(min_length=1, max_length=100)
    """One entry a joint, in the order of the D-H rows, where there are some."""
    active_joints: tuple[Name, ...] | None = None
    """Inputs and outputs of the model, all joints by default; the others are held."""
    joint_topic: Annotated[Name, read_by('MSRDG')] = 'joint_states'
    """Topic of the positions, and of the velocities where the driver has them."""
    couplings: Annotated[CouplingsSpec | None, read_by('M')] = None
    """Motors that turn with more than their own joint, as in wrists and SCARAs; none by
    default."""
    gauges: Annotated[tuple[GaugeSpec, ...], read_by('MESRD')] = ()
    """Strain gauges; without them there is no strain model and no damper."""
    preprocessing: Annotated[PreprocessingSpec, read_by('MER')] = PreprocessingSpec()
    """Defaults of ``tudor fit`` for this arm."""
    motors: Annotated[tuple[MotorSpec, ...], read_by('ESRDG')] = ()
    """Motors and gears, one entry a joint that is simulated or damped."""
    sensors: Annotated[tuple[SensorSpec, ...], read_by('R')] = ()
    """Gains of gauges: newtons from them, and what simulated ones read (else ideal strain)."""
    damper: Annotated[DamperSpec | None, read_by('RD')] = None
    """Gains of joint cascade and strain feedback."""
    links: Annotated[tuple[LinkSpec, ...], read_by('ESR')] = ()
    """What moves after each joint: rigid, or one beam."""
    payload: Annotated[InertiaPart | None, read_by('ESR')] = None
    """Rigid part at the tip, in the axes of the tip frame; ``tudor record --payload`` replaces
    it."""
    simulation: Annotated[SimulationSpec, read_by('ESR')] = SimulationSpec()
    """Structural damping, and how a run starts."""

    def mistakes(self) -> Iterator[str]:
        names = [joint.name for joint in self.joints]
        gauges = [gauge.name for gauge in self.gauges]
        for what, listed in (('joint', names), ('gauge', gauges),
                             ('active joint', list(self.active_joints or ()))):
            for name in listed:
                if listed.count(name) > 1:
                    yield f'{what} {name!r} has two entries; rename or remove one'
        for name in self.active_joints or ():
            if name not in names:
                yield f'active joint {name!r} is not a joint; use one of {", ".join(names)}'
        if self.active_joints is not None and not self.active_joints:
            yield 'active_joints is empty; name at least one joint, or leave it out'
        yield from self._wrong_couplings(names)
        for gauge in self.gauges:
            if gauge.joint not in names:
                yield (f'gauge {gauge.name!r} names the joint {gauge.joint!r}, '
                       f'which is not among the joints {", ".join(names)}; correct joint')
        yield from self._wrong_types()
        for link in self.links:
            if link.rigid is not None and link.flexible is not None:
                yield (f'links: joint {link.joint!r} has both rigid and flexible; '
                       'remove one of them')
        rows = self.kinematics.dh
        flange = self.kinematics.convention == 'modified'
        if rows is not None and len(rows) - len(names) not in (0, flange):
            yield (f'{len(rows)} D-H rows for {len(names)} joints; give one row for each joint, '
                   'base first' + (', and at most one more, for a flange' if flange else ''))
        yield from self._wrong_drives(names, gauges)

    def _wrong_couplings(self, joints: list[str]) -> Iterator[str]:
        """Find couplings that cannot be."""
        if self.couplings is None:
            return
        matrix, active = self.couplings.speeds(joints), self.active_joints or joints
        at_motors = 'motors' in (self.couplings.positions, self.couplings.efforts)
        for i, motor in enumerate(joints):
            for j, joint in enumerate(joints):
                if (at_motors and i != j and matrix[i, j]
                        and (motor in active) != (joint in active)):
                    yield (f'couplings: {joint!r} also turns the motor of {motor!r}; '
                           'list both in active_joints, or neither')

    def _wrong_types(self) -> Iterator[str]:
        """Find a topic that is described as if it carried messages of two types."""
        kinds = {self.joint_topic.lstrip('/'): 'positions'}
        sources: tuple[SourceSpec, ...] = (*(joint.effort for joint in self.joints), *self.gauges)
        for source in sources:
            kind = ('index' if source.index is not None else
                    'interface' if source.interface is not None else 'positions')
            if kinds.setdefault(source.topic.lstrip('/'), kind) != kind:
                yield (f'values on topic {source.topic} are described with different message '
                       'types; give all of them index, all interface, or (for JointState) neither')

    def _wrong_drives(self, joints: list[str], gauges: list[str]) -> Iterator[str]:
        """Find links and drives that name no part of the arm, or are described twice."""
        damped = () if self.damper is None else self.damper.joints
        for key, what, named, known, once in (
                ('links', 'joint', [link.joint for link in self.links], joints, True),
                ('simulation.initial', 'joint', list(self.simulation.initial), joints, True),
                ('motors', 'joint', [motor.joint for motor in self.motors], joints, True),
                ('sensors', 'gauge', [sensor.gauge for sensor in self.sensors], gauges, True),
                ('damper', 'joint', [item.joint for item in damped], joints, True),
                ('damper', 'gauge', [item.gauge for item in damped], gauges, False)):
            for name in dict.fromkeys(named):
                if name not in known:
                    yield (f'{key} names the {what} {name!r}, which is not among the '
                           f'{what}s {", ".join(known)}; correct the name')
                if once and named.count(name) > 1:
                    yield f'{key}: {what} {name!r} has two entries; merge them'
        motors = {motor.joint for motor in self.motors}
        for link in self.links:
            for key, other in (('hub_inertia', 'rotor_inertia'), ('joint_stiffness', 'stiffness'),
                               ('viscous_friction', 'viscous')):
                if link.joint in motors and getattr(link, key):
                    yield (f'links: joint {link.joint!r} has {key}, though motors describes its '
                           f'drive; remove {key} here, and give {other} in motors')


MAX_PARTS = 8  # mistakes that one message names


def _keys(part: type[Spec]) -> set[str]:
    """Collect the keys of a part and of all that are made from it."""
    return {*part.model_fields}.union(*(_keys(other) for other in part.__subclasses__()))


PLAIN: dict[str, Any] = {
    r'^\w+ should': 'must', 'tuple': 'list', ' after validation': '',
    'a valid dictionary.*': 'keys with values', r'a valid (list|string)': r'a \1',
    'a valid date.*': 'a date such as 2026-01-31', 'greater than or equal to': 'at least',
    'less than or equal to': 'at most', 'greater than': 'above', 'less than': 'below',
    r'\b\d+\.?\d{5,}': lambda found: f'{float(found[0]):g}'}
"""What pydantic says, and the same in words and numbers of this package."""


def validation_message(err: ValidationError, add: str = '; add it') -> str:
    """Put a pydantic error on one line: each key, what is wrong, what was found."""
    def short(text: str) -> str:
        return text if len(text) <= 100 else f'{text[:100]}...'

    parts, missing, items = [], [], err.errors(include_url=False)
    # what holds a wrong part seems to lack it, too
    around = {item['loc'][:size] for item in items for size in range(len(item['loc']))}
    for item in (one for one in items if one['loc'] not in around):
        where = short(''.join(f'[{part}]' if isinstance(part, int) else f'.{part}'
                              for part in item['loc'] if part != '[key]').lstrip('.'))
        own, found = item.get('ctx', {}).get('error'), item.get('input')
        text = str(own) if isinstance(own, Exception) else item['msg']
        for old, new in PLAIN.items():
            text = re.sub(old, new, text)
        if item['type'] == 'missing':
            missing.append(where)
            continue
        if item['type'] == 'extra_forbidden':
            text = 'is an unknown key; correct or remove it' + meant(
                str(item['loc'][-1]), _keys(Spec))
        elif not isinstance(found, (dict, list)) and f"'{found}'" not in text:
            text += f', found {"no value" if found is None else short(repr(found))}'
        if text.startswith(('is ', 'must ')):
            text = f'{where or "the content"} {text}'
        elif where:
            text = f'{where}: {text}'
        parts.append(text)
    if len(missing) > 1:
        rest = f' and {len(missing) - MAX_PARTS} more' * (len(missing) > MAX_PARTS)
        parts.insert(0, f'{", ".join(missing[:MAX_PARTS])}{rest} are missing'
                     f'{add.replace("add it", "add them")}')
    elif missing:
        parts.insert(0, f'{missing[0]} is missing{add}')
    more = f'; and {len(parts) - MAX_PARTS} more' if len(parts) > MAX_PARTS else ''
    return '; '.join(parts[:MAX_PARTS]) + more
