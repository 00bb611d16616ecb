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

"""Physical parameters of a driven elastic arm: one table of all that is known of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import math
from typing import Literal

import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.mechanics import chain as at
from tudor_dynamics.mechanics.mechanism import Mechanism
from tudor_dynamics.models.elastic import kernel as at_gear
from tudor_dynamics.models.settings import EDGE, LONGEST_LAG, RIGID_GEAR
from tudor_dynamics.typing import FloatArray


# -- Where the physical parameters of a driven arm are read from, and the tables they act in

Owner = Literal['link', 'part', 'tip', 'joint', 'arm']
"""What has parameters: each flexible link, lumped part and gear, the tip, the whole arm."""


@dataclass(frozen=True, eq=False)
class LumpedMass:
    """A lumped mass as it was described."""

    body: int  # body of the mechanism
    mass: float  # mass of the part [kg]
    inertia: FloatArray  # inertia about its centre, (6,) [kg m^2]


class Physics:
    """An arm as it was described, and the tables that its physical parameters change."""

    def __init__(self, arm: Arm, mechanism: Mechanism, springs: FloatArray) -> None:
        self.arm, self.mechanism, self.springs = arm, mechanism, springs
        self.motors = {motor.joint: motor for motor in arm.spec.motors}
        self.links = {link.joint: link for link in arm.spec.links}
        self.parts: dict[str, LumpedMass] = {}
        joint_of = {body: joint for joint, body in mechanism.body_of.items()}
        *bodies, payload = range(len(mechanism.body_int))
        for body in bodies:
            owner = joint_of.get(int(mechanism.body_int[body, at.PARENT]))
            part = self._part(body)
            if body not in joint_of and owner is not None and part.mass > 0.0:
                count = sum(name.startswith(f'{owner},') for name in self.parts)
                self.parts[f'{owner},{count + 1}'] = part
        self.parts[''] = self._part(payload)
        self.lag = 0.0
        self.owners: dict[Owner, tuple[str, ...]] = {
            'link': tuple(mechanism.beams), 'part': tuple(name for name in self.parts if name),
            'tip': ('',), 'joint': arm.active_joints, 'arm': ('',)}
        self._built = {joint: self.beam(joint).copy() for joint in mechanism.beams}
        for joint in mechanism.beams:
            self.beam(joint)[at.EA] = 0.0  # beams keep their length: the kernel sees to it
            flexible = self.links[joint].flexible
            # below zero: linear beams, which nothing draws in
            self.beam(joint)[at.STRETCH] = 0.0 if flexible and flexible.stretch else -1.0

    def _part(self, body: int) -> LumpedMass:
        floats = self.mechanism.body_float[body]
        return LumpedMass(body, float(floats[at.MASS]), floats[at.INERTIA:at.INERTIA + 6].copy())

    def beam(self, joint: str) -> FloatArray:
        """Give the row of the beam after a joint in the mechanism's table; a view."""
        return self.mechanism.body_float[self.mechanism.body_of[joint]]

    def scale_beam(self, joint: str, columns: list[int], factor: float) -> None:
        """Set properties of a beam by what they were as it was built."""
        self.beam(joint)[columns] = factor * self._built[joint][columns]

    def weigh(self, name: str, mass: float) -> None:
        """Set the mass of a part, its inertia in proportion: mass [kg]."""
        part = self.parts[name]
        floats = self.mechanism.body_float[part.body]
        floats[at.MASS] = mass
        if part.mass > 0.0:
            floats[at.INERTIA:at.INERTIA + 6] = part.inertia * (mass / part.mass)

    def gyration(self, name: str) -> float:
        """Give the radius of gyration of a part as it was described [m]."""
        part = self.parts[name]
        return math.sqrt(float(part.inertia[:3].mean()) / part.mass) if part.mass > 0.0 else 0.0

    def spread(self, name: str, radius: float) -> None:
        """Set the radius of gyration of a part, its axes as described: radius [m]."""
        part = self.parts[name]
        floats = self.mechanism.body_float[part.body]
        mean = part.inertia[:3].mean()  # nothing described is alike about all axes
        shape = part.inertia / mean if mean else np.repeat([1.0, 0.0], 3)
        floats[at.INERTIA:at.INERTIA + 6] = floats[at.MASS] * radius**2 * shape

    def spring(self, joint: str) -> FloatArray:
        """Give the row of the gear of a joint in the table of gears; a view."""
        return self.springs[self.arm.active_joints.index(joint)]

    @property
    def stiffest(self) -> float:
        """Largest stiffness of a link that turns at its end, held at its start [N m/rad]."""
        return max(3.0 * beam.EIz / float(self._built[joint][at.LENGTH])
                   for joint, beam in self.mechanism.beams.items())


# -- Physical parameters of a driven arm: one table of all that model, search and report know of
#    them.
#
# A new parameter is one entry of ``PHYSICAL``. Names are those of the entries, with the owner
# after them: ``bending(joint2)``, ``lumped(joint2,1)``, ``beta``.


@dataclass(frozen=True)
class ParameterKind:
    """A kind of physical parameter."""

    of: Owner  # what has one of its own, see `Physics.owners`
    unit: str  # unit of the value
    words: str  # what the report calls it, with {} for the joint
    described: Callable[[Physics, str], float]  # value that the description gives, by owner
    act: Callable[[Physics, str, float], None]  # writes a value into the tables, in order
    # How well one knows it from drawings and data sheets: standard deviation of its logarithm.
    # None where it is not searched.
    width: float | None = None
    least: float = 0.0  # start where nothing or zero is described; 0: not searched
    # Where strain shows a sum sharply and its shares weakly: the values add up (masses), their
    # inverses do (stiffnesses), or neither.
    adds: Literal[1, -1, 0] = 0
    early: bool = False  # whether it is searched already where starts are compared
    unit_along: str = ''  # unit for a prismatic joint; '' where it is the same
    bounds: tuple[float, float] = (0.0, math.inf)  # smallest and largest possible value


def _spring(physics: Physics, joint: str) -> tuple[float | None, float]:
    """Give stiffness (None: rigid) and damping of a gear, by motor, or else by link."""
    motor, link = physics.motors.get(joint), physics.links.get(joint)
    if link is not None and link.joint_stiffness is not None and (
            motor is None or motor.stiffness is None):
        return link.joint_stiffness, link.joint_damping
    return (None, 0.0) if motor is None else (motor.stiffness, motor.damping)


def _in_beams(column: int) -> Callable[[Physics, str, float], None]:
    def act(physics: Physics, _: str, value: float) -> None:
        for joint in physics.mechanism.beams:
            physics.beam(joint)[column] = value
    return act


def _in_gear(column: int) -> Callable[[Physics, str, float], None]:
    def act(physics: Physics, joint: str, value: float) -> None:
        physics.spring(joint)[column] = value
    return act


def _round(physics: Physics, joint: str, value: float) -> None:
    row = physics.spring(joint)
    row[at_gear.ROUND] = max(value * row[at_gear.PLAY], 1e-9)


def _delay(physics: Physics, _: str, value: float) -> None:
    physics.lag = value


PHYSICAL: dict[str, ParameterKind] = {
    'bending': ParameterKind(
        'link', 'N m^2', 'bending stiffness of the link after {}',
        lambda physics, joint: physics.mechanism.beams[joint].EIz,
        lambda physics, joint, value: physics.scale_beam(
            joint, [at.EIY, at.EIZ, at.GJ], value / physics.mechanism.beams[joint].EIz),
        width=0.5, adds=-1, early=True),
    'density': ParameterKind(
        'link', 'kg/m', 'mass per length of the link after {}',
        lambda physics, joint: physics.mechanism.beams[joint].density,
        lambda physics, joint, value: physics.scale_beam(
            joint, [at.DENSITY, at.POLAR], value / physics.mechanism.beams[joint].density),
        width=0.1, adds=1),
    'lumped': ParameterKind(
        'part', 'kg', 'mass on the link after {}',
        lambda physics, part: physics.parts[part].mass, Physics.weigh,
        width=0.5, adds=1),
    'gyration': ParameterKind(
        'part', 'm', 'radius of gyration of the mass on the link after {}',
        Physics.gyration, Physics.spread, width=0.5, least=0.02),
    'payload': ParameterKind(
        'tip', 'kg', 'load at the tip',
        lambda physics, tip: physics.parts[tip].mass, Physics.weigh,
        width=1.5, least=0.05, adds=1, early=True),
    'gear': ParameterKind(
        'joint', 'N m/rad', 'stiffness of the gear of {}',
        lambda physics, joint: _spring(physics, joint)[0] or RIGID_GEAR * physics.stiffest,
        _in_gear(at_gear.STIFF), width=1.0, adds=-1, early=True, unit_along='N/m'),
    'play': ParameterKind(
        'joint', 'rad', 'backlash of the gear of {}, half of it',
        lambda physics, joint: 0.5 * physics.motors[joint].backlash if joint in physics.motors
        else 0.0, _in_gear(at_gear.PLAY), width=1.0, least=0.002, unit_along='m'),
    'edge': ParameterKind(
        'joint', '1', 'part of the backlash of {} over which the teeth engage',
        lambda physics, joint: EDGE, _round, width=0.5),
    'tight': ParameterKind(
        'joint', 'N m s/rad', 'damping of the gear of {}, teeth in touch',
        lambda physics, joint: _spring(physics, joint)[1],
        _in_gear(at_gear.TIGHT), width=1.5, least=0.1, early=True, unit_along='N s/m'),
    'loose': ParameterKind(
        'joint', 'N m s/rad', 'damping of the gear of {}, inside the backlash',
        lambda physics, joint: _spring(physics, joint)[1],
        _in_gear(at_gear.LOOSE), width=2.0, least=0.1, early=True, unit_along='N s/m'),
    'alpha': ParameterKind(
        'arm', '1/s', 'structural damping of the links, per mass',
        lambda physics, arm: physics.arm.spec.simulation.rayleigh.alpha, _in_beams(at.ALPHA)),
    'beta': ParameterKind(
        'arm', 's', 'structural damping of the links, per stiffness',
        lambda physics, arm: physics.arm.spec.simulation.rayleigh.beta, _in_beams(at.BETA),
        width=1.5, least=3e-4, early=True),
    'lag': ParameterKind(
        'arm', 's', 'lag of the gauges after the encoders',
        lambda physics, arm: 0.0, _delay, width=1.5, least=3e-4,
        bounds=(0.0, LONGEST_LAG))}


def kind_of(name: str) -> ParameterKind:
    """Give the kind of a parameter by its name, such as ``gear(joint2)``."""
    return PHYSICAL[name.partition('(')[0]]


def _owner(name: str) -> str:
    return name.partition('(')[2][:-1]


def described(physics: Physics) -> dict[str, float]:
    """Give the parameters as far as the description knows them."""
    return {f'{name}({owner})' if owner else name: kind.described(physics, owner)
            for of, owners in physics.owners.items() for owner in owners
            for name, kind in PHYSICAL.items() if kind.of == of}


def apply(physics: Physics, values: Mapping[str, float]) -> None:
    """Write parameters into the tables of the arm."""
    for name, value in values.items():
        kind_of(name).act(physics, _owner(name), value)


def change(values: dict[str, float], changes: Mapping[str, float], name_of_arm: str) -> None:
    """Change physical parameters; none that does not exist, to nothing that cannot be."""
    for name, value in changes.items():
        if name not in values:
            msg = f'{name_of_arm} has no parameter {name!r}; it has {", ".join(values)}'
            raise SimulationError(msg)
        low, high = kind_of(name).bounds
        if not (math.isfinite(value) and low <= value <= high):
            upto = 'or more' if math.isinf(high) else f'to {high:g}'
            msg = f'parameter {name} of {name_of_arm}: {value}, expected {low:g} {upto}'
            raise SimulationError(msg)
        values[name] = float(value)


def physical_unit(arm: Arm, name: str) -> str:
    """Give the unit of a physical parameter; gears of prismatic joints count in N/m and m."""
    kind = kind_of(name)
    return kind.unit_along if kind.unit_along and arm.is_prismatic(_owner(name)) else kind.unit


def in_words(name: str) -> str:
    """Name a physical parameter for a reader."""
    kind, joint, number = kind_of(name), _owner(name), '1'
    if kind.of == 'part':
        joint, _, number = joint.rpartition(',')
    return kind.words.format(joint) + ('' if number == '1' else f', the {number}.')
