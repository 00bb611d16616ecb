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

"""Units of outputs and parameters."""

from __future__ import annotations

import pytest
from sample_arms import gauge, planar_arm

from tudor_dynamics.models.regressor import output_units, parameter_unit


def test_outputs() -> None:
    """Channels have the units of the arm description."""
    arm = planar_arm([{'name': 'j1', 'effort': {'unit': 'A'}}, {'name': 'j2'}],
                     [{**gauge('g', 'j1', 0.1), 'unit': 'mV/V'}])
    assert output_units(arm, 'effort') == {'j1': 'A', 'j2': 'N m'}
    assert output_units(arm, 'strain') == {'g': 'mV/V'}


@pytest.mark.parametrize(('column', 'unit', 'scaled', 'prismatic', 'expected'), [
    ('m(j)', 'N m', False, False, 'kg'), ('mx(j)', 'N m', False, False, 'kg m'),
    ('Ixy(j)', 'N m', False, False, 'kg m^2'), ('Ia(j)', 'N m', False, False, 'kg m^2'),
    ('Ia(j)', 'N', False, True, 'kg'), ('viscous+(j)', 'N m', False, False, 'N m s/rad'),
    ('viscous(j)', 'N', False, True, 'N s/m'), ('coulomb-(j)', 'A', True, False, 'A'),
    ('cube_root(j)', 'A', True, False, 'A (s/rad)^(1/3)'), ('offset', 'um/m', True, False, 'um/m'),
    ('mx(g)', 'um/m', True, False, 'kg m (um/m)/(N m)')])
def test_parameters(
    column: str, unit: str, scaled: bool, prismatic: bool, expected: str,
) -> None:
    """A parameter times its column gives the unit of the output."""
    assert parameter_unit(column, unit, scaled=scaled, prismatic=prismatic) == expected
