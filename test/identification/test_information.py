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

"""What motions show of parameters: covariances, and slopes by the motion."""

from __future__ import annotations

import numpy as np
import pytest
from sample_arms import arm_of, gauge, multisine, planar_arm, random_states, SIX_ROWS

from tudor_dynamics.identification.excitation import covariance_of, Information, mean_error
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import block_of
from tudor_dynamics.models.estimation import expected
from tudor_dynamics.models.regressor import regressor_of


def subjects(arm, noise):
    """Models of all outputs of an arm, each channel with noise of its own."""
    models = {output: AnalyticalModel(regressor_of(arm, output, 'exact'), len(arm.active_joints))
              for output in (('effort', 'strain') if arm.gauges else ('effort',))}
    return models, {output: noise * (1.0 + np.arange(len(model.channels)))
                    for output, model in models.items()}


def test_covariance_is_that_of_least_squares():
    """A simulated fit scatters by what the information says: 400 draws of noise, 7 % sure."""
    arm = planar_arm()
    models, noises = subjects(arm, 0.1)
    model, size = models['effort'], noises['effort']
    motion = multisine(np.arange(300) * 0.05, 2)
    [matrix] = Information(models, noises).matrices(motion)
    kept = model.base_[0].kept
    rows = model.regressor.rows(motion)[:, :, kept]
    weighted = (rows / size[:, None]).reshape(-1, len(kept))
    noise = np.random.default_rng(0).normal(size=(len(weighted), 400))
    scatter = np.linalg.lstsq(weighted, noise, rcond=None)[0].std(axis=1)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance_of(matrix))), scatter, rtol=0.12)
    products = model.products(block_of(motion, np.zeros((300, 2))))
    np.testing.assert_allclose(
        expected(products[0], size**2).standard_errors,
        np.sqrt(np.diag(covariance_of(matrix))), rtol=1e-6)


@pytest.mark.parametrize('gauges', [False, True])
def test_slope_by_the_motion(gauges):
    """The slope of the cost is that of differences, for efforts and strains together."""
    arm = planar_arm(gauges=[gauge('g', 'j2', 0.1)] if gauges else None)
    information = Information(*subjects(arm, 0.1))
    motion = multisine(np.arange(60) * 0.2, 2, seed=3)
    cost, slope = information.cost(motion)
    assert cost == pytest.approx(mean_error([
        covariance_of(item) for item in information.matrices(motion)])[0])
    way = np.random.default_rng(1).normal(size=motion.shape)
    change = (information.cost(motion + 1e-6 * way)[0]
              - information.cost(motion - 1e-6 * way)[0]) / 2e-6
    assert np.sum(slope * way) == pytest.approx(change, rel=1e-3)


def test_what_is_not_shown_is_expensive_but_finite():
    """A motion of one joint alone leaves the others' parameters without information."""
    joints = [{'name': f'j{i}'} for i in range(1, 7)]
    information = Information(*subjects(arm_of(SIX_ROWS, joints), 1.0))
    still = np.zeros((50, 18))
    still[:, 0] = np.sin(np.arange(50) * 0.1)
    poor, slope = information.cost(still)
    rich, _ = information.cost(random_states(50, 6))
    assert np.isfinite(poor) and np.isfinite(slope).all() and poor > rich + 2.0


def test_units_do_not_matter():
    """Another unit of a parameter moves the cost by a constant, and no motion past another."""
    [matrix] = Information(*subjects(planar_arm(), 0.1)).matrices(
        multisine(np.arange(100) * 0.1, 2))
    scale = np.logspace(-3, 3, len(matrix))
    one, two = (mean_error([covariance_of(item)])[0]
                for item in (matrix, matrix * np.outer(scale, scale)))
    assert one - two == pytest.approx(np.mean(np.log(scale)), abs=1e-6)
