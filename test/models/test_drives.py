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

"""Rotors that have mass, friction that takes energy."""

from __future__ import annotations

from types import SimpleNamespace

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from sample_arms import arm_of
from tudor_dynamics.models.consistent import BodyProblem, energy_rows, raised, speed_grid
from tudor_dynamics.models.friction import friction_columns, friction_names

SPEEDS = np.array([2.0, 0.5])
JOINTS = [{'name': 'a', 'friction': ['viscous', 'coulomb', 'stribeck', 'offset', 'load']},
          {'name': 'b', 'asymmetric': True, 'friction': ['viscous', 'coulomb', 'cube_root']}]
ARM = arm_of([[0.3, 0.0, 0.0, 0.0]] * 2, JOINTS)
COLUMNS = tuple(name for joint in ARM.joints
                for name in (f'Ia({joint.name})', *friction_names(joint)))
ROWS = energy_rows(ARM, COLUMNS, SPEEDS)


def power(values):
    """Give friction against the motion over the speeds, both ways, of both joints."""
    found = []
    for joint, largest in zip(ARM.joints, SPEEDS, strict=True):
        speed = np.concatenate([-np.linspace(joint.friction_velocity, largest, 50),
                                np.linspace(joint.friction_velocity, largest, 50)])
        terms = [values[COLUMNS.index(name)] * (not name.startswith(('offset', 'load')))
                 for name in friction_names(joint)]
        found.append(friction_columns(joint, speed) @ terms * np.sign(speed))
    return np.concatenate(found)


def test_what_takes_energy_is_not_refused():
    values = dict.fromkeys(COLUMNS, 0.0)
    values.update({'Ia(a)': 0.1, 'viscous(a)': -0.4, 'coulomb(a)': 1.0, 'stribeck(a)': 0.3,
                   'offset(a)': -5.0, 'load(a)': -0.1, 'coulomb+(b)': 1.0, 'coulomb-(b)': -1.0,
                   'viscous+(b)': 0.2, 'viscous-(b)': -0.5})
    given = np.array([values[name] for name in COLUMNS])
    assert np.all(ROWS @ given >= 0.0), 'friction may fall with the speed'
    assert np.all(power(given) >= 0.0)
    assert np.array_equal(raised(given, COLUMNS, ROWS), given)


@pytest.mark.parametrize(('name', 'value'), [
    ('Ia(b)', -0.1), ('viscous(a)', -0.1), ('coulomb(a)', -0.2), ('stribeck(a)', -1.0),
    ('coulomb-(b)', 0.1), ('viscous+(b)', -0.1)])
def test_what_drives_by_itself_is_refused(name, value):
    values = np.zeros(len(COLUMNS))
    values[COLUMNS.index(name)] = value
    assert np.min(ROWS @ values) < 0.0


@settings(max_examples=40)
@given(st.lists(st.floats(-2.0, 2.0), min_size=len(COLUMNS), max_size=len(COLUMNS)))
def test_what_falls_short_is_raised(values):
    found = raised(np.array(values), COLUMNS, ROWS)
    assert np.min(ROWS @ found) > -1e-9
    short = -min(np.min(ROWS @ np.array(values)), 0.0)
    coulomb = [i for i, name in enumerate(COLUMNS) if name.startswith('coulomb')]
    assert np.abs(found - values)[coulomb].max() <= 1.5 * short + 1e-9, 'and not by more'
    assert np.min(power(found)) > -0.02 * (1.0 + np.abs(found).max()), 'and between the speeds'


def test_the_speeds_are_those_asked_for():
    grid = speed_grid(2.0, 0.1)
    assert (grid.min(), grid.max(), np.abs(grid).min()) == pytest.approx((-2.0, 2.0, 0.1))
    assert np.abs(speed_grid(0.0, 0.1)).max() == pytest.approx(0.2)


def test_drives_that_hardly_show_have_no_size():
    """Their columns are zero: no overflow, which fits to bags that lost messages showed."""
    matrix = np.zeros((4, 13))
    matrix[:, 10] = 2e3
    problem = SimpleNamespace(columns=range(13), first=10, parts=[(0, matrix, np.full(4, 6e10))])
    with np.errstate(all='raise'):
        np.testing.assert_allclose(BodyProblem._sizes(problem), [3e7, 1.0, 1.0])
