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

"""The driven arm linearised: the derivatives of the very balance that moves it."""

from __future__ import annotations

from dataclasses import replace
from math import pi
from pathlib import Path

from elastic_making import blade, blade_arm, lone_arm
import numpy as np
import pytest

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.mechanics.mechanism import build_mechanism
from tudor_dynamics.mechanics.plant import Plant
from tudor_dynamics.mechanics.run import modes
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.models.elastic.kernel import DDZ, DZ, FORCE, residual, Z
from tudor_dynamics.typing import FloatArray

CONFIG = Path(__file__).parents[3] / 'config'
POSES = np.array([[0.0, 0.0, 0.0], [0.6, 0.5, -0.3], [1.5, -1.2, 0.7], [-1.4, 0.2, 0.1]])
"""Level, oblique, upright and hanging [rad or m]."""


def arm_named(name: str) -> Arm:
    """Give an arm of the tests, or of ``config``."""
    if name.endswith('.yaml'):
        return load_arm(CONFIG / name)
    return {'two blades': blade_arm, 'one blade': lone_arm}[name]()


def stretching(arm: Arm, stretch: bool) -> Arm:
    """Give the arm with beams that bending shortens, or linear ones."""
    links = tuple(link if link.flexible is None else link.model_copy(update={
        'flexible': link.flexible.model_copy(update={'stretch': stretch})})
        for link in arm.spec.links)
    return replace(arm, spec=arm.spec.model_copy(update={'links': links}))


def differences(driven: DrivenArm) -> tuple[FloatArray, ...]:
    """Differentiate what is missing for a true motion: stiffness, damping, mass."""
    tables, vectors = driven.tables, driven.tables.equations.vectors
    rest, free, found = vectors.copy(), tables.equations.free, []
    for row, nudge in ((Z, 1e-5), (DZ, 1e-3), (DDZ, 1.0)):
        columns = []
        for i in free:
            sides = []
            for step in (nudge, -nudge):
                vectors[:] = rest
                vectors[row, i] += step
                residual(vectors, tables.gears, tables.chain, driven.loaded)
                sides.append(vectors[FORCE, free])
            columns.append((sides[0] - sides[1]) / (2.0 * nudge))
        found.append(np.column_stack(columns))
    vectors[:] = rest
    return tuple(found)


def frequencies(mass: FloatArray, stiffness: FloatArray) -> FloatArray:
    """Give undamped frequencies [Hz]."""
    squares = np.linalg.eigvals(np.linalg.solve(mass, stiffness))
    assert np.abs(squares.imag).max() < 1e-6 * np.abs(squares).max()
    return np.asarray(np.sqrt(np.sort(squares.real)) / (2.0 * pi))


@pytest.mark.parametrize('stretch', [True, False])
@pytest.mark.parametrize('name', ['two blades', 'one blade', 'tudor.yaml', 'elastic_arm.yaml',
                                  'single_flexible_link.yaml'])
def test_derivatives_of_the_balance(name: str, stretch: bool) -> None:
    """Stiffness, damping and mass at any pose and payload are those of ``residual``."""
    driven = DrivenArm(stretching(arm_named(name), stretch))
    driven.set_parameters({n: 0.0 for n in driven.parameters if n.startswith('play(')})
    for payload in (0.0, 0.4):
        driven.set_parameters({'payload': payload})
        for pose in POSES:
            small = driven.linearised(pose[:len(driven.tables.gears.place)])
            stiffness, damping, mass = differences(driven)
            for found, expected in ((small.stiffness, stiffness), (small.damping, damping),
                                    (small.mass, mass)):
                assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()
            assert np.abs(small.mass - small.mass.T).max() < 1e-9 * small.mass.max()
            assert frequencies(small.mass, small.stiffness) == pytest.approx(
                frequencies(mass, stiffness), rel=1e-5)


@pytest.mark.parametrize('stretch', [True, False])
@pytest.mark.parametrize('payload', [0.0, 0.4])
def test_observer_has_the_same_mass(stretch: bool, payload: float) -> None:
    """The observer's matrices: the same mass; of the stiffness, all but what the weight does."""
    driven = DrivenArm(stretching(load_arm(CONFIG / 'tudor.yaml'), stretch))
    driven.set_parameters({'payload': payload, 'play(joint2)': 0.0, 'play(joint3)': 0.0})
    for pose in POSES[:, :2]:
        small = driven.linearised(pose)
        driven.start_observer(np.full(len(driven.arm.gauges), 0.02), 8.0)
        driven.follow(np.tile(pose, (3, 1)), np.array([0.0, 1e-3, 1e-3]))
        driven.linearise()
        mass, _, stiffness = driven.small
        assert np.abs(mass - small.mass).max() < 1e-9 * small.mass.max()
        assert frequencies(mass, stiffness) == pytest.approx(
            frequencies(small.mass, small.stiffness), rel=0.08)


@pytest.mark.parametrize('stretch', [True, False])
def test_linearising_changes_nothing(stretch: bool) -> None:
    """The state is the same after it, what follows from bending included."""
    driven = DrivenArm(stretching(load_arm(CONFIG / 'tudor.yaml'), stretch))
    pose = np.array([0.6, 0.5])
    driven.follow(pose[None], np.zeros(1))
    rest = driven.tables.equations.vectors.copy()
    driven.linearised(pose)
    np.testing.assert_array_equal(driven.tables.equations.vectors[:FORCE], rest[:FORCE])


@pytest.mark.parametrize('q', [(0.0, 0.0), (0.6, 0.5), (1.5, -1.2)])
def test_frequencies_of_the_full_plant(q: tuple[float, float]) -> None:
    """Four elements a link, joints held, under weight: the first two modes are among theirs."""
    arm = blade_arm(links=[
        {'joint': 'j1', 'flexible': blade(lumped=[{'mass': 0.8}], stretch=True, elements=4)},
        {'joint': 'j2', 'flexible': blade(stretch=True, elements=4)}])
    plant = Plant(build_mechanism(arm), 1e-3)
    plant.reset(np.array(q))
    expected = modes(plant, 8).frequency
    driven = DrivenArm(arm)
    driven.set_parameters({'gear(j1)': 1e6, 'gear(j2)': 1e6, 'play(j1)': 0.0, 'play(j2)': 0.0})
    small = driven.linearised(np.array(q))
    for found in frequencies(small.mass, small.stiffness)[:2]:
        assert np.abs(expected / found - 1.0).min() < 5e-3
