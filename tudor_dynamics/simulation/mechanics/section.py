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

"""Cross-section and material of a beam as the numbers that its elements need."""

from __future__ import annotations

from dataclasses import dataclass
import math

from tudor_dynamics.arm.links import BeamSpec, MaterialSpec, SectionSpec


@dataclass(frozen=True)
class BeamProperties:
    """Stiffness and mass per length of a beam; y is the height axis of the section."""

    density: float  # mass per length [kg/m]
    polar: float  # polar moment of inertia per length [kg m]
    # Stiffness against stretch [N], bending about y and z, torsion [N m^2].
    EA: float
    EIy: float
    EIz: float
    GJ: float
    # Distance of the surface from the neutral line along y and z [m].
    surface_y: float
    surface_z: float


def rectangle_torsion(height: float, width: float) -> float:
    """
    Give the torsion constant of a rectangle [m^4].

    Saint-Venant's series (Timoshenko and Goodier, Theory of Elasticity, 1970, Eq. 169) by its
    first terms; 0.1406 h^4 for a square.

    Parameters
    ----------
    height, width : float
        Sides of the rectangle [m].

    Returns
    -------
    float
        Torsion constant [m^4].

    """
    short, long = min(height, width), max(height, width)
    total = sum(math.tanh(n * math.pi * long / (2.0 * short)) / n**5 for n in range(1, 30, 2))
    return long * short**3 / 3.0 * (1.0 - 192.0 / math.pi**5 * short / long * total)


def shear_modulus(material: MaterialSpec) -> float:
    """Give G, from the Poisson ratio where that was given [Pa]."""
    if material.G is not None:
        return material.G
    assert material.nu is not None  # the schema has one of the two
    return material.E / (2.0 * (1.0 + material.nu))


def _geometry(section: SectionSpec) -> tuple[float, float, float, float, float, float]:
    if section.shape == 'rectangle':
        assert section.height is not None and section.width is not None
        h, b = section.height, section.width
        return (b * h, h * b**3 / 12.0, b * h**3 / 12.0, rectangle_torsion(h, b), h / 2, b / 2)
    if section.shape == 'tube':
        assert section.outer is not None and section.inner is not None
        ro, ri = section.outer / 2.0, section.inner / 2.0
        second = math.pi / 4.0 * (ro**4 - ri**4)
        return math.pi * (ro**2 - ri**2), second, second, 2.0 * second, ro, ro
    assert section.area is not None and section.Iy is not None and section.Iz is not None
    # Without a surface, that of the rectangle with the same second moments.
    height = math.sqrt(12.0 * section.Iz / section.area)
    width = math.sqrt(12.0 * section.Iy / section.area)
    return section.area, section.Iy, section.Iz, section.J or 0.0, height / 2, width / 2


def beam_properties(beam: BeamSpec) -> BeamProperties:
    """Give the numbers of a beam."""
    area, second_y, second_z, torsion, surface_y, surface_z = _geometry(beam.section)
    torsion = beam.section.J or torsion
    material = beam.material
    return BeamProperties(
        density=material.rho * area, polar=material.rho * (second_y + second_z),
        EA=material.E * area, EIy=material.E * second_y, EIz=material.E * second_z,
        GJ=shear_modulus(material) * torsion,
        surface_y=beam.section.surface or surface_y, surface_z=surface_z)
