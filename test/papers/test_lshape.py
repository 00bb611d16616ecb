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

"""The L-shaped mechanism against an independent computation."""

from __future__ import annotations

import json

import numpy as np
from papers.__main__ import main
from papers.lshape import agreement, END, l_shape, run_paper, run_reference
import pytest

import tudor_dynamics as td

# Frequencies [Hz] of lshape_reference.npz: 16 elements of another kind, computed with Exudyn.
CLAMPED = (7.87021, 8.77163, 22.17569, 23.88531, 117.09545, 117.87882, 170.36061, 172.72836)
HINGED = (8.77163, 13.00743, 23.88531, 35.85204)


def test_clamped_frequencies():
    """Two elements a beam: modes 1 to 4 within 0.1 %, 5 to 8 within 1.5 %."""
    found = td.modes(td.Plant(td.build_mechanism(l_shape(2))), 8).frequency
    error = np.abs(found / CLAMPED - 1.0)
    assert error[:4].max() < 1e-3
    assert error[4:].max() < 1.5e-2


def test_hinged_frequencies():
    """With the motor free and its hub of 4.3e-3 kg m^2: within 0.2 %."""
    found = td.modes(td.Plant(td.build_mechanism(l_shape(2))), 5, ('motor',)).frequency
    assert abs(found[0]) < 1e-3
    assert np.abs(found[1:] / HINGED - 1.0).max() < 2e-3


@pytest.mark.shared
@pytest.mark.parametrize(('elements', 'dt', 'bound'), [(4, 2.5e-4, 0.03), (2, 5e-4, 0.08)])
def test_motion_of_the_reference(shared_data, elements, dt, bound):
    """Accelerations, moments and the final angle over 5 s."""
    with np.load(shared_data / 'lshape_reference.npz') as file:
        reference = {name: file[name] for name in file.files}
    found = agreement(run_reference(elements, dt, reference), reference)
    assert max(found.elbow_acceleration, found.tip_acceleration, found.moment_link1,
               found.moment_link2) < bound
    assert abs(found.final_angle_deg) < 0.1


def test_the_test_of_the_paper():
    """Two opposite steps take the arm from 135 deg to rest near 30 deg."""
    found = run_paper(2, 1e-3, 3.0)
    run = found.run
    angle = run.q[:, 0]
    assert np.degrees(angle[0]) == pytest.approx(135.0)
    assert np.abs(angle[:500] - angle[0]).max() < 1e-6  # statically balanced before the steps
    late = angle[run.t > 1.3]
    assert np.degrees(np.abs(late - END)).max() < 5.0
    tip = run.acceleration[:, found.mechanism.tip]
    # 11.3 Hz is the first mode that the motor moves, with 0.09 kg at the elbow.
    content = np.abs(np.fft.rfft(tip[1200:, 1] * np.hanning(len(tip) - 1200)))
    frequency = np.fft.rfftfreq(len(tip) - 1200, 1e-3)
    assert frequency[content.argmax()] == pytest.approx(11.3, abs=0.6)


def test_it_draws_the_figures_of_the_paper(tmp_path, capsys):
    """Figures 4 to 9 and the arrays."""
    assert main(['lshape', '--out', str(tmp_path), '--dt', '0.001', '--json']) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures['angle_start_deg'] == pytest.approx(135.0)
    assert figures['angle_after_steps_deg'] == pytest.approx(30.0, abs=1.5)
    assert figures['hinged_hz'][2] == pytest.approx(11.3, abs=0.2)
    names = {path.name for path in tmp_path.iterdir()}
    assert {'figure_4_torque.png', 'figure_5_6_elbow_acceleration.png', 'lshape.npz',
            'figure_7_8_tip_acceleration.png', 'figure_9_moment_link2.png'} <= names
