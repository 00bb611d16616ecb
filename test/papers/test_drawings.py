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

"""The counterparts of figures of Malzahn et al.: what is drawn."""

from __future__ import annotations

import numpy as np
from papers.drawings import stimuli
import pytest
from sample_arms import multisine, planar_arm, recording_of


def test_figure_5() -> None:
    """Angle, velocity and acceleration of the first active joint, a column a stimulus."""
    t = np.arange(2000) * 0.01
    motions, bags = [multisine(t, 2, seed) for seed in (0, 1)], []
    for motion in motions:
        bags.append(recording_of(motion[:, :2], 100.0, effort=motion[:, :2]))
    arm = planar_arm(preprocessing={'filter': 'zero_phase'})
    axes = np.array(stimuli(arm, bags).axes).reshape(3, 2)
    assert [item.get_ylabel().split(' ')[0] for item in axes[:, 0]] == [
        'angle', 'velocity', 'acceleration']
    for column, motion in enumerate(motions):
        assert axes[0, column].get_title() == f'j1, stimulus {column + 1}'
        for row in range(3):
            (line,) = axes[row, column].get_lines()
            drawn = np.asarray(line.get_ydata())[200:-200]
            expected = np.degrees(motion[200:-200, 2 * row])
            assert drawn == pytest.approx(expected, abs=0.05 * np.abs(expected).max())
