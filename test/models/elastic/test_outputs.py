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

"""Outputs of elastic models for one sample at a time are those of all samples at once."""

from __future__ import annotations

from elastic_making import blade
import numpy as np
import pytest
from sample_arms import gauge, planar_arm

from tudor_dynamics.errors import NotFittedError
from tudor_dynamics.models.elastic.arm import Response
from tudor_dynamics.models.elastic.model import effort_rows, ElasticModel

FRICTION = [
    ({}, {}),
    ({'friction': ['viscous', 'coulomb'], 'asymmetric': True},
     {'friction': ['viscous', 'coulomb', 'offset'], 'rotor_inertia': True}),
    ({'friction': ['stribeck', 'cube_root', 'square'], 'rotor_inertia': True},
     {'friction': ['viscous']})]


@pytest.mark.parametrize('friction', FRICTION)
@pytest.mark.parametrize('output', ['strain', 'effort'])
def test_same_numbers(output: str, friction: tuple[dict, dict]) -> None:
    """Whatever the joints have of friction, rotor inertia and offset."""
    joints = [{'name': name, **terms} for name, terms in zip(('j1', 'j2'), friction, strict=True)]
    arm = planar_arm(joints, [gauge('g1', 'j1', 0.05), gauge('g2', 'j2', 0.05)], links=[
        {'joint': name, 'flexible': blade()} for name in ('j1', 'j2')])
    model = ElasticModel(arm, output)
    with pytest.raises(NotFittedError, match='no coefficients'):
        model.prepared()
    random = np.random.default_rng(1)
    model.coefficients_ = tuple(random.normal(size=len(names)) for names in model.columns)
    motion = random.normal(size=(20, 6))
    motion[3, 2:4] = 0.0
    response = Response(random.normal(size=(20, 2)), random.normal(size=(20, 2)))
    wanted = response.moment * np.array(model.coefficients_)[:, 0] + np.array(
        model.coefficients_)[:, 1] if output == 'strain' else np.column_stack([
            rows @ values for rows, values in zip(
                effort_rows(arm, response, motion), model.coefficients_, strict=True)])
    outputs = model.prepared()
    assert outputs(response, motion) == pytest.approx(wanted, rel=1e-12, abs=1e-14)
    one = Response(response.moment[3:4], response.torque[3:4])
    assert np.array_equal(outputs(one, motion[3:4])[0], outputs(response, motion)[3])
    assert np.ptp(wanted, axis=0).min() > 0.1
