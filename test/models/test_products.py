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

"""What training bags come to, kept beside the models."""

from __future__ import annotations

import numpy as np
import pytest
from robot_making import described_arm, efforts_of, fitted, motion_of
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import ModelError
from tudor_dynamics.files import dump_npz
from tudor_dynamics.models import bundle as stored
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import block_of
from tudor_dynamics.models.bundle import load_bundle, ModelBundle, save_bundle


def parts_of(arm, count=3, seconds=30.0):
    found = {}
    for seed in range(count):
        motion = motion_of(seconds, seed)
        found[f'bag{seed}'] = block_of(motion, efforts_of(arm, motion, 0.2, seed))
    return found


@pytest.mark.parametrize('seconds', [30.0, 1.5])  # the second is too short: triangular factors
def test_parts_survive_a_file_and_add_up(tmp_path, seconds):
    arm = described_arm(tmp_path)
    blank = fitted(arm, seconds=10.0)
    model = AnalyticalModel(blank.regressor, 4, base=blank.base_)
    model.fit_parts(parts_of(arm, seconds=seconds), {})
    save_bundle(ModelBundle(arm, PreprocessingSpec(), {'effort': {'analytical': model}}),
                tmp_path / 'model')
    again = load_bundle(tmp_path / 'model', with_data=True).models['effort']['analytical']
    assert isinstance(again, AnalyticalModel)
    refitted = AnalyticalModel(again.regressor, 4, base=again.base_).fit_data([again.data_])
    assert np.allclose(refitted.coefficients(), model.coefficients(), rtol=1e-10, atol=0.0)


def test_a_part_is_gone_through_once(tmp_path):
    arm = described_arm(tmp_path)
    blank = fitted(arm, seconds=10.0)
    seen = []

    def counted(name, blocks):
        def count():
            seen.append(name)
            return blocks()
        return count

    parts = {name: counted(name, blocks) for name, blocks in parts_of(arm).items()}
    known = {}
    whole = AnalyticalModel(blank.regressor, 4, base=blank.base_).fit_parts(parts, known)
    less = dict(list(parts.items())[:2])
    fewer = AnalyticalModel(blank.regressor, 4, base=blank.base_).fit_parts(less, known)
    assert sorted(seen) == sorted(parts)
    assert not np.allclose(whole.coefficients(), fewer.coefficients(), rtol=1e-6)
    alone = AnalyticalModel(blank.regressor, 4, base=blank.base_).fit_parts(less, {})
    assert np.array_equal(fewer.coefficients(), alone.coefficients())


@pytest.mark.parametrize('change', [
    lambda arrays: arrays.pop('effort_analytical_0'),
    lambda arrays: arrays.update(effort_analytical_0=arrays['effort_analytical_0'][:, :, 1:]),
    lambda arrays: arrays['effort_analytical_0'].fill(np.nan),
    lambda arrays: arrays['effort_analytical_0_n'].fill(-1.0)])
def test_data_of_another_model_are_refused(tmp_path, change):
    arm = described_arm(tmp_path)
    models = {'effort_analytical': fitted(arm, seconds=10.0)}
    arrays = stored.pack(models)
    change(arrays)
    with pytest.raises(ModelError, match='does not go with the models'):
        stored.unpack(models, dump_npz(arrays), tmp_path / 'data.npz')
