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

"""Schema of the arm description in ``config/*.yaml``: keys, units, bounds; coupled drives."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, field_validator, model_validator

from tudor_dynamics.arm.hardware import (
    check_drives, check_links, check_overlap, DamperSpec, Finite, InertiaPart, LinkSpec, MotorSpec,
    Name, NonNegative, Positive, SensorSpec, SimulationSpec, Spec, Vector3)
from tudor_dynamics.typing import FloatArray


# -- Coupled drives: motors that turn with more than one joint, as in wrists and SCARAs

LARGEST_CONDITION = 1e6
"""A matrix beyond it does not tell the joints from the motors."""


class CouplingPair(Spec):
    """One motor that another joint turns as well."""

    motor: Name
    """Joint whose motor it is."""
    joint: Name
    """Other joint that turns it."""
    ratio: Finite
    """Turns of the motor for one turn of that joint, in turns of the motor for one of its own;
    -1 where it turns the other way [1, or rad/m or m/rad where one of both slides]."""

    @model_validator(mode='after')
    def _two_joints(self) -> CouplingPair:
        if self.motor == self.joint:
            raise ValueError(f'{self.motor!r} is coupled with itself; name another joint')
        return self


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

    @model_validator(mode='after')
    def _one_form(self) -> CouplingsSpec:
        if (self.matrix is None) == (not self.pairs):
            raise ValueError('give either pairs: [{motor, joint, ratio}, ...] or matrix: [[...]]')
        return self


def coupling_matrix(couplings: CouplingsSpec, joints: Sequence[str]) -> FloatArray:
    """Give the speeds of all motors by those of all joints; returns (joints, joints)."""
    n = len(joints)
    if couplings.matrix is not None:
        if len(couplings.matrix) != n or any(len(row) != n for row in couplings.matrix):
            raise ValueError(f'couplings.matrix: expected {n} rows of {n} numbers, one a joint')
        matrix = np.array(couplings.matrix)
    else:
        matrix = np.eye(n)
        for pair in couplings.pairs:
            for name in (pair.motor, pair.joint):
                if name not in joints:
                    raise ValueError(f'couplings names the joint {name!r}, which is not among the '
                                     f'joints {list(joints)}')
            matrix[joints.index(pair.motor), joints.index(pair.joint)] += pair.ratio
    if not np.linalg.cond(matrix) < LARGEST_CONDITION:
        raise ValueError('couplings: different motions of the joints are the same motion of the '
                         'motors; correct the ratios')
    return matrix


def check_couplings(
    couplings: CouplingsSpec | None, joints: Sequence[str], active: Sequence[str],
) -> None:
    """Refuse couplings that cannot be; couplings: None where nothing is coupled."""
    if couplings is None:
        return
    matrix = coupling_matrix(couplings, joints)
    at_motors = 'motors' in (couplings.positions, couplings.efforts)
    for i, motor in enumerate(joints):
        for j, joint in enumerate(joints):
            if at_motors and i != j and matrix[i, j] and (motor in active) != (joint in active):
                raise ValueError(f'couplings: {motor!r} and {joint!r} are coupled, and what is '
                                 'measured at their motors needs both among active_joints')


# -- The arm description as it stands in ``config/*.yaml``: keys, types, units, bounds.
#
# Every key is checked here and nowhere else. Unknown keys are refused, because a misspelt key that
# is silently ignored gives a wrong model.

EFFORT_UNITS = ('A', 'N m', 'N')
NEWTON_METRE = ('N m', 'Nm', 'N*m', 'N·m', 'N⋅m', 'N.m')
"""Spellings of one unit; the first is used everywhere."""
MAX_INDEX = 1000
"""Values of an array that may be named."""
AUTO = 'auto'
"""What stands for a key that is left open: the same as no key."""
FRICTION_KEYS = ('friction', 'asymmetric', 'friction_velocity', 'stribeck_velocity',
                 'presliding_distances')
"""Keys of a joint that say which friction is identified."""
FRICTION_TERMS = ('viscous', 'coulomb', 'offset', 'stribeck', 'cube_root', 'square', 'load',
                  'presliding')


def one_spelling(unit: Any) -> Any:
    """Write a unit as it is written everywhere; anything else stays what it is."""
    return NEWTON_METRE[0] if unit in NEWTON_METRE else unit


EffortUnit = Annotated[Literal['A', 'N m', 'N'], BeforeValidator(one_spelling)]
StrainUnit = Annotated[Literal['um/m', 'm/m', 'mV/V', 'V', 'N m'], BeforeValidator(one_spelling)]


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
    so it is not the D-H frame, which is at the far end; behind those of a modified one, so it is.
    A modified table may have a row more, for a flange that is fixed to the last link.
    """

    @model_validator(mode='after')
    def _one_source(self) -> KinematicsSpec:
        if (self.urdf is None) == (self.dh is None):
            raise ValueError('give either urdf: FILE or dh: [[a, alpha, d, theta_offset], ...]')
        if self.urdf is not None and self.convention != 'standard':
            raise ValueError('convention is that of D-H rows; leave it out with urdf')
        return self


class SourceSpec(Spec):
    """The topic of a value, and its place there where that is no JointState."""

    topic: Name
    index: Annotated[int, Field(ge=0, lt=MAX_INDEX)] | None = None
    """Place of the value in a std_msgs/Float64MultiArray, from 0; its messages have no stamp, so
    the log time counts in a bag, and in a node when they arrive."""
    interface: Name | None = None
    """Interface in a control_msgs/DynamicJointState, such as current; for bags alone, nodes
    refuse it."""

    @model_validator(mode='after')
    def _one_kind(self) -> SourceSpec:
        if self.index is not None and self.interface is not None:
            raise ValueError('give index (Float64MultiArray) or interface (DynamicJointState), '
                             'not both')
        return self


class EffortSpec(SourceSpec):
    """The topic on which a joint's actuator effort arrives, and what it is measured in."""

    topic: Name = 'joint_states'
    """Topic of type sensor_msgs/JointState, whose field ``effort`` is read; of another type with
    ``index`` or ``interface``."""
    unit: EffortUnit = 'N m'
    """What the driver publishes: motor current, torque, or force of a prismatic joint."""
    torque_constant: Positive | None = None
    """Joint torque per ampere, gear and efficiency included; unknown by default
    [N m/A or N/A]."""

    @model_validator(mode='after')
    def _constant_needs_current(self) -> EffortSpec:
        if self.torque_constant is not None and self.unit != 'A':
            raise ValueError(f'torque_constant goes with unit: A, not with unit: {self.unit}')
        return self


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

    @model_validator(mode='after')
    def _ordered(self) -> LimitSpec:
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            raise ValueError(f'lower limit {self.lower} is not below upper limit {self.upper}')
        return self


class PlannedSpec(LimitSpec):
    """
    What planned motion keeps to: within ``limits``, with room for the damper.

    Positions leave room to stop where nothing is said.
    """

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
    effort: EffortSpec = EffortSpec()
    """Where the effort of its actuator comes from."""
    friction: tuple[Literal['viscous', 'coulomb', 'offset', 'stribeck', 'cube_root', 'square',
                            'load', 'presliding'], ...] = ('viscous', 'coulomb')
    """Terms of friction to identify, each a column of the regressor; ``auto``, or the key left
    out, for ``tudor fit`` to choose by left-out parts, from viscous and coulomb on."""
    asymmetric: bool = False
    """Separate viscous and Coulomb coefficients for each direction of motion."""
    rotor_inertia: bool = True
    """Identify the inertia of the motor, seen through the gear, as a parameter of its own."""
    friction_velocity: Positive = 0.02
    """Speed over which the sign of the velocity is smoothed [rad/s or m/s]."""
    stribeck_velocity: Positive = 0.1
    """Speed at which the Stribeck term has decayed to 1/e [rad/s or m/s]."""
    presliding_distances: tuple[Positive, ...] = Field((0.003,), min_length=1, max_length=8)
    """Displacements from rest to sliding of the term ``presliding``: springs that give way, each
    with a coefficient of its own [rad or m]."""
    hold: Finite = 0.0
    """Position of the joint where it is not active [rad or m]."""
    limits: LimitSpec | None = None
    """What nothing ever exceeds."""
    planned: PlannedSpec | None = None
    """What motion is planned with."""

    @model_validator(mode='after')
    def _plans_within_limits(self) -> JointSpec:
        planned, limits = self.planned or PlannedSpec(), self.limits or LimitSpec()
        for key, outwards in (('lower', -1.0), ('upper', 1.0), ('velocity', 1.0),
                              ('acceleration', 1.0)):
            inner, outer = getattr(planned, key), getattr(limits, key)
            if inner is not None and outer is not None and outwards * (inner - outer) > 0.0:
                raise ValueError(f'planned.{key} {inner:g} is beyond limits.{key} {outer:g}: '
                                 'nothing may be planned that must not happen')
        return self

    @model_validator(mode='before')
    @classmethod
    def _left_open(cls, content: Any) -> Any:
        if isinstance(content, dict) and content.get('friction') == AUTO:
            return {key: value for key, value in content.items() if key != 'friction'}
        return content

    @field_validator('friction', 'presliding_distances')
    @classmethod
    def _no_repetition(cls, terms: tuple[str | float, ...]) -> tuple[str | float, ...]:
        if len(set(terms)) != len(terms):
            raise ValueError(f'a friction term or displacement is named twice in {list(terms)}')
        return terms

    @property
    def bristles(self) -> tuple[float, ...]:
        """Displacements over which its friction gives way; empty where it does not [rad or m]."""
        return self.presliding_distances if 'presliding' in self.friction else ()


class GaugeSpec(SourceSpec):
    """A strain gauge (bridge) on the link behind a joint."""

    name: Name
    """Name as it stands in the messages of its topic."""
    joint: Name
    """Joint before it: the gauge sits on the link behind."""
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
            raise ValueError('a vector of no length gives no direction: give x, y, z or a vector')
        return vector


class PreprocessingSpec(Spec):
    """How positions become velocities and accelerations, and how often samples are used."""

    filter: Literal['causal', 'zero_phase'] = 'causal'  # noqa: A003
    """The papers' causal filters, or zero-phase ones (offline; causal ones beside the robot);
    ``auto``, or the key left out, for ``tudor fit`` to choose by left-out parts."""
    velocity_cutoff: Positive = 80.0
    """First-order low-pass behind the first difference quotient, causal [Hz]."""
    acceleration_cutoff: Positive = 20.0
    """First-order low-pass behind the second difference quotient, causal [Hz]."""
    output_cutoff: Positive | None = None
    """First-order low-pass over positions, velocities, efforts and strains, causal [Hz]."""
    cutoff: Positive | None = None
    """Butterworth cut-off, zero-phase; a tenth of the sample rate by default [Hz]."""
    measured_velocity: bool = True
    """Take the driver's velocity where the bag has it."""
    rate: Positive | None = 20.0
    """Rate to decimate to for identification and evaluation; null for every sample [Hz]."""
    settle: NonNegative = 0.5
    """What is left out at the start of each gapless stretch, and at its end if zero-phase [s]."""

    @model_validator(mode='before')
    @classmethod
    def _left_open(cls, content: Any) -> Any:
        if isinstance(content, dict) and content.get('filter') == AUTO:
            return {key: value for key, value in content.items() if key != 'filter'}
        return content


class ArmSpec(Spec):
    """A whole arm description."""

    name: Name
    """Name of the arm, for messages, reports and bundles."""
    kinematics: KinematicsSpec
    """Joints and links as a URDF or as D-H rows."""
    gravity: Vector3 = (0.0, 0.0, -9.81)
    """Gravity in the base frame; another one for an arm that hangs or leans [m/s^2]."""
    joints: tuple[JointSpec, ...] = Field(min_length=1, max_length=100)
    """One entry a joint, in the order of the D-H rows, where there are some."""
    active_joints: tuple[Name, ...] | None = None
    """Inputs and outputs of the model, all joints by default; the others are held."""
    joint_topic: Name = 'joint_states'
    """Topic of the positions, and of the velocities where the driver has them."""
    couplings: CouplingsSpec | None = None
    """Motors that turn with more than their own joint, as in wrists and SCARAs; none by
    default."""
    gauges: tuple[GaugeSpec, ...] = ()
    """Strain gauges; without them there is no strain model and no damper."""
    preprocessing: PreprocessingSpec = PreprocessingSpec()
    """Defaults of ``tudor fit`` for this arm."""
    motors: tuple[MotorSpec, ...] = ()
    """Motors and gears, one entry a joint that is simulated or damped."""
    sensors: tuple[SensorSpec, ...] = ()
    """What the simulated gauges read; of those without an entry, ideal strain."""
    damper: DamperSpec | None = None
    """Gains of joint cascade and strain feedback."""
    links: tuple[LinkSpec, ...] = ()
    """What moves behind each joint: rigid, or one beam."""
    payload: InertiaPart | None = None
    """Rigid part at the tip, in the axes of the tip frame; ``tudor record --payload`` replaces
    it."""
    simulation: SimulationSpec = SimulationSpec()
    """Structural damping, and how a run starts."""

    def _check_types(self) -> None:
        """Refuse a topic that is described as if it carried messages of two types."""
        kinds = {self.joint_topic.lstrip('/'): 'positions'}
        sources: tuple[SourceSpec, ...] = (*(joint.effort for joint in self.joints), *self.gauges)
        for source in sources:
            kind = ('index' if source.index is not None else
                    'interface' if source.interface is not None else 'positions')
            if kinds.setdefault(source.topic.lstrip('/'), kind) != kind:
                raise ValueError(f'the topic {source.topic} cannot carry messages of several '
                                 'types: give index, or interface, with all that it carries, '
                                 'and joint states on another one')

    @model_validator(mode='after')
    def _consistent(self) -> ArmSpec:
        names = [joint.name for joint in self.joints]
        for what, listed in (('joint', names), ('gauge', [g.name for g in self.gauges]),
                             ('active joint', list(self.active_joints or ()))):
            for name in listed:
                if listed.count(name) > 1:
                    raise ValueError(f'{what} {name!r} is named twice')
        for name in self.active_joints or ():
            if name not in names:
                raise ValueError(f'active joint {name!r} is not among the joints {names}')
        if self.active_joints is not None and not self.active_joints:
            raise ValueError('active_joints is empty: name at least one joint, or leave it out')
        check_couplings(self.couplings, names, self.active_joints or names)
        for gauge in self.gauges:
            if gauge.joint not in names:
                raise ValueError(f'gauge {gauge.name!r} names the joint {gauge.joint!r}, '
                                 f'which is not among the joints {names}')
        self._check_types()
        check_links(self.links, self.simulation, names)
        rows = self.kinematics.dh
        flange = self.kinematics.convention == 'modified'
        if rows is not None and len(rows) - len(names) not in (0, flange):
            raise ValueError(f'{len(rows)} D-H rows for {len(names)} joints: '
                             'give one row a joint, base first'
                             + (', and one more at most, for the flange' if flange else ''))
        check_drives(self.motors, self.sensors, self.damper, names,
                     [gauge.name for gauge in self.gauges])
        check_overlap(self.links, [motor.joint for motor in self.motors])
        return self
