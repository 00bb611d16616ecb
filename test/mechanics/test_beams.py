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

"""Beams against textbook values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tudor_dynamics.arm.description import arm_from_dict
from tudor_dynamics.mechanics.mechanism import beam_properties, build_mechanism, rectangle_torsion
from tudor_dynamics.mechanics.plant import Plant
from tudor_dynamics.mechanics.run import largest_rotation, modes, Probe
from tudor_dynamics.mechanics.settings import LARGEST_ROTATION

E, LENGTH, SIDE, RHO = 7.0e10, 0.5, 0.008, 2700.0
EI = E * SIDE**4 / 12.0


def cantilever(elements=2, gravity=0.0, payload=None, **more):
    """Horizontal beam on a held joint, height in the vertical plane."""
    content = {
        'name': 'cantilever', 'kinematics': {'dh': [[LENGTH, 0.0, 0.0, 0.0]]},
        'gravity': [0.0, -gravity, 0.0], 'joints': [{'name': 'hub'}],
        'gauges': [{'name': 'gauge', 'joint': 'hub', 'distance': 0.1}],
        'links': [{'joint': 'hub', 'flexible': {
            'section': {'shape': 'rectangle', 'height': SIDE, 'width': SIDE},
            'material': {'E': E, 'nu': 0.33, 'rho': RHO}, 'elements': elements, **more}}]}
    if payload is not None:
        content['payload'] = {'mass': payload}
    arm = arm_from_dict(content, base=Path('.'), source='cantilever')
    plant = Plant(build_mechanism(arm), 1e-3)
    plant.drive('hub', 'hold')
    return arm, plant


@pytest.mark.parametrize(('load', 'exact'), [(0.25, 0.08275), (1.0, 0.30172), (2.0, 0.49346)])
@pytest.mark.parametrize('stretch', [True, False])
def test_large_bending_shows_in_the_rotation(load, exact, stretch):
    """
    Deflections under P L^2 / EI = load: too large the sooner, the more the nodes have turned.

    Exact: Bisshopp and Drucker, Quarterly of Applied Mathematics 3, 1945 (0.25: their elastica).
    """
    _, plant = cantilever(8, stretch=stretch)
    plant.reset(external_force=[0.0, load * EI / LENGTH**2, 0.0], equilibrium=True)
    tip = Probe(plant).observe().position[plant.mechanism.tip, 1] / LENGTH
    assert largest_rotation(plant) == pytest.approx(load / 2.0, rel=1e-6)
    error = float(tip / exact - 1.0)
    assert (error > 0.04) is (largest_rotation(plant) > LARGEST_ROTATION)
    assert error == pytest.approx({0.25: 0.007, 1.0: 0.10, 2.0: 0.35}[load], abs=0.005)


def test_rotations_of_a_rigid_arm():
    """Without a beam nothing bends."""
    arm = arm_from_dict({
        'name': 'rigid', 'kinematics': {'dh': [[LENGTH, 0.0, 0.0, 0.0]]},
        'joints': [{'name': 'hub'}],
        'links': [{'joint': 'hub', 'rigid': {'mass': 1.0, 'center': [0.2, 0.0, 0.0]}}]},
        base=Path('.'), source='rigid')
    assert largest_rotation(Plant(build_mechanism(arm), 1e-3)) == 0.0


def test_frequencies_of_a_cantilever():
    """Bending frequencies are (k L)^2 sqrt(EI/mu) / (2 pi L^2); Blevins, 1979, table 8-1."""
    _, plant = cantilever(10)
    found = modes(plant, 6).frequency
    scale = np.sqrt(EI / (RHO * SIDE**2)) / (2 * np.pi * LENGTH**2)
    expected = scale * np.array([1.87510407, 4.69409113, 7.85475744]) ** 2
    assert found[0::2] == pytest.approx(expected, rel=1e-3)
    assert found[1::2] == pytest.approx(expected, rel=1e-3)


def test_torsion_and_stretch_of_a_cantilever():
    """Torsion and axial frequencies of a bar are c / (4 L)."""
    _, plant = cantilever(12)
    found = modes(plant, 40).frequency
    shear = E / 2.66
    torsion = np.sqrt(shear * 0.1406 * SIDE**4 / (RHO * SIDE**4 / 6.0)) / (4 * LENGTH)
    axial = np.sqrt(E / RHO) / (4 * LENGTH)
    assert np.abs(found / torsion - 1.0).min() < 1.5e-3
    assert np.abs(found / axial - 1.0).min() < 1.5e-3


def test_deflection_under_a_tip_load():
    """A small weight at the tip gives F L^3 / 3 EI, and the strain F (L - x) c / EI."""
    mass = 0.02
    arm, plant = cantilever(2, 9.81, mass, stretch=False)
    probe = Probe(plant, [('hub', 0.1)], arm)
    seen = probe.observe()
    own = RHO * SIDE**2 * 9.81
    force = mass * 9.81
    deflection = force * LENGTH**3 / (3 * EI) + own * LENGTH**4 / (8 * EI)
    assert seen.position[plant.mechanism.tip, 1] == pytest.approx(-deflection, rel=1e-6)
    arm_length = LENGTH - 0.1
    moment = force * arm_length + own * arm_length**2 / 2
    # Gauges count positive for the load of a horizontal link, sections as EI times curvature.
    assert seen.gauge_moment[0] == pytest.approx(moment, rel=1e-3)
    assert seen.moment[0, 2] == pytest.approx(-moment, rel=1e-3)
    assert seen.strain[0] == pytest.approx(1e6 * moment * SIDE / 2 / EI, rel=1e-3)


def test_large_deflection_shortens_the_beam():
    """A beam that bends shortens by int w'^2 / 2; the linear beam does not."""
    for stretch in (True, False):
        _, plant = cantilever(8, 9.81, 0.5, stretch=stretch)
        shape = Probe(plant).observe().position[:9]
        slope = np.gradient(shape[:, 1], shape[:, 0])
        expected = 0.5 * np.trapezoid(slope**2, shape[:, 0])
        shortening = LENGTH - shape[-1, 0]
        if stretch:
            assert shortening == pytest.approx(expected, rel=0.1)
        else:
            assert abs(shortening) < 1e-6


def test_a_force_at_the_tip_is_felt():
    """A transverse force at the tip of a beam at rest bends it by F L^3 / 3 EI."""
    _, plant = cantilever(2)
    plant.reset(external_force=[0.0, 0.2, 0.0])
    tip = Probe(plant).observe().position[plant.mechanism.tip]
    assert tip[1] == pytest.approx(0.2 * LENGTH**3 / (3 * EI), rel=1e-3)
    plant.reset(external_force=[0.0, 0.0, 0.0, 0.1, 0.0, 0.0])
    twist = plant.coordinates[-3]
    assert twist == pytest.approx(0.1 * LENGTH / plant.mechanism.beams['hub'].GJ, rel=1e-6)


def test_torsion_constant_of_a_rectangle():
    """0.1406 a^4 for a square, 0.333 b h^3 for a thin strip (Timoshenko and Goodier, 1970)."""
    assert rectangle_torsion(1.0, 1.0) == pytest.approx(0.1406, rel=1e-3)
    assert rectangle_torsion(1.0, 10.0) == pytest.approx(0.312 * 10.0, rel=2e-3)
    assert rectangle_torsion(10.0, 1.0) == pytest.approx(rectangle_torsion(1.0, 10.0))


def test_tube_and_general_sections():
    """A tube described by its numbers is the same beam."""
    arm, _ = cantilever(1)
    beam = arm.spec.links[0].flexible
    tube = beam.section.model_copy(update={
        'shape': 'tube', 'outer': 0.02, 'inner': 0.016, 'height': None, 'width': None})
    first = beam_properties(beam.model_copy(update={'section': tube}))
    second_moment = np.pi / 64 * (0.02**4 - 0.016**4)
    general = tube.model_copy(update={
        'shape': 'general', 'outer': None, 'inner': None, 'surface': 0.01,
        'area': np.pi / 4 * (0.02**2 - 0.016**2), 'Iz': second_moment, 'Iy': second_moment,
        'J': 2 * second_moment})
    second = beam_properties(beam.model_copy(update={'section': general}))
    assert first.EIz == pytest.approx(second.EIz)
    assert first.GJ == pytest.approx(second.GJ)
    assert first.density == pytest.approx(second.density)
    assert first.surface_y == pytest.approx(0.01)
