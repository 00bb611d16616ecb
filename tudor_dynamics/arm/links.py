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
Schema of the parts of an arm description that only the simulator needs.

Links are rigid or one flexible beam each; a rigid corner between two beams is a joint that is
held. Lengths in the axes of the link's joint frame, which turns with the joint.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from tudor_dynamics.arm.fields import Finite, Name, NonNegative, Positive, Spec, Vector3

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
