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

"""Friction columns: formulas, both directions apart, continuity at standstill."""

from __future__ import annotations

import numpy as np
import pytest

from tudor_dynamics.arm.schema import JointSpec
from tudor_dynamics.models.friction import friction_columns, friction_names

ALL = ('viscous', 'coulomb', 'offset', 'stribeck', 'cube_root', 'square')


def test_formulas() -> None:
    """Far from standstill each column is the textbook's term, signed by the velocity."""
    joint = JointSpec(name='a', friction=ALL, friction_velocity=0.01, stribeck_velocity=0.5)
    assert friction_names(joint) == tuple(f'{term}(a)' for term in ALL)
    for v in (-0.4, 0.3, 8.0):
        sign = np.sign(v)
        expected = [v, sign, 1.0, sign * np.exp(-(v / 0.5) ** 2), np.cbrt(v), sign * v * v]
        assert np.allclose(friction_columns(joint, np.array([v]))[0], expected, rtol=1e-3)


def test_directions_apart() -> None:
    """
    Malzahn et al., Eq. (2) as meant: k_v+, k_v-, k_c+, k_c- act in their own direction alone.

    Printed, k_v+ is a constant, so that two of four columns are equal; these have full rank.
    """
    joint = JointSpec(name='a', asymmetric=True)
    assert friction_names(joint) == ('viscous+(a)', 'viscous-(a)', 'coulomb+(a)', 'coulomb-(a)')
    columns = friction_columns(joint, np.array([-2.0, -0.5, 0.5, 2.0]))
    assert np.allclose(columns, [[0, -2, 0, 1], [0, -0.5, 0, 1], [0.5, 0, 1, 0], [2, 0, 1, 0]])
    assert np.linalg.matrix_rank(columns) == 4


@pytest.mark.parametrize('asymmetric', [False, True])
def test_continuous_at_standstill(asymmetric: bool) -> None:
    """The last bit of an encoder does not throw the friction from one direction to the other."""
    joint = JointSpec(name='a', friction=ALL, asymmetric=asymmetric)
    columns = friction_columns(joint, np.array([-1e-9, 0.0, 1e-9]))
    assert np.all(np.isfinite(columns))
    assert np.max(np.abs(np.diff(columns, axis=0))) < 1e-6


def test_no_friction() -> None:
    """A joint without friction terms has no columns."""
    assert friction_columns(JointSpec(name='a', friction=()), np.zeros(3)).shape == (3, 0)
