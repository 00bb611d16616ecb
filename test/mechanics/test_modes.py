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

"""The elastic-link arm: frequencies, static strains and damping by hand-made numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tudor_dynamics.arm.description import arm_from_dict
from tudor_dynamics.mechanics.mechanism import build_mechanism
from tudor_dynamics.mechanics.plant import Plant
from tudor_dynamics.mechanics.run import modes, Probe
import yaml


def elastic_arm(root, *, q3=0.0, payload=0.0, gravity=0.0):
    """Plant and description of config/elastic_arm.yaml in a pose."""
    content = yaml.safe_load((root / 'config' / 'elastic_arm.yaml').read_text())
    content['simulation']['initial'] = {'joint3': float(np.radians(q3))}
    content['payload'] = {'mass': payload}
    content['gravity'] = [0.0, 0.0, -gravity]
    arm = arm_from_dict(content, base=Path('.'), source='elastic_arm')
    return arm, Plant(build_mechanism(arm), 5e-4)


@pytest.mark.parametrize(('q3', 'payload', 'expected'), [
    (0, 0.0, (3.05, 14.7)), (45, 0.0, (3.14, 13.9)), (90, 0.0, (3.38, 12.5)),
    (0, 0.1, (2.53, 10.6)), (90, 0.1, (2.99, 8.1)), (0, 0.4, (1.79, 8.7)),
    (90, 0.4, (2.27, 5.6))])
def test_frequencies_in_the_plane(root, q3, payload, expected):
    """Joints locked; values of another finite-element code, made for the ring-down of the arm."""
    _, plant = elastic_arm(root, q3=q3, payload=payload)
    result = modes(plant, 6)
    # Bending in the vertical plane turns the nodes about z of their links.
    turns = [i for i, name in enumerate(plant.mechanism.coordinate_names) if name.startswith('rz')]
    planar = np.linalg.norm(result.shape[:, turns], axis=1) > 0.1
    assert result.frequency[planar][:2] == pytest.approx(expected, rel=0.012)


def test_damping_of_the_first_mode(root):
    """About one per cent, as the ring-down of the real arm has; it decays as fast in a run."""
    _, plant = elastic_arm(root)
    for joint in plant.mechanism.joints:
        plant.drive(joint, 'hold')
    result = modes(plant, 2)
    ratio, frequency = float(result.damping[0]), float(result.frequency[0])
    assert 0.008 < ratio < 0.012
    plant.coordinates[:] += 0.01 * result.shape[0]
    periods = []
    for _ in range(2):
        peak = 0.0
        for _ in range(int(round(5.0 / frequency / 5e-4))):
            plant.step()
            peak = max(peak, float(np.abs(plant.coordinates).max()))
        periods.append(peak)
    # Five periods between the two peaks.
    assert np.log(periods[0] / periods[1]) / (10 * np.pi) == pytest.approx(ratio, rel=0.1)


def test_static_strain_of_the_horizontal_arm(root):
    """Positive for the load of the horizontal arm, and the moment of all that is outboard."""
    arm, plant = elastic_arm(root, gravity=9.81)
    seen = Probe(plant, arm=arm).observe()
    length, line = 0.393, 7850 * 0.004 * 0.015
    blade = line * length
    moments = []
    for place in (0.05, 0.24):
        rest = length - place
        moments.append(9.81 * (0.82 * rest + blade * (rest + length / 2) + line * rest**2 / 2))
    expected = [moments[0], moments[1], *(9.81 * line * (length - x)**2 / 2 for x in (0.05, 0.24))]
    # The droop of some centimetres shortens the levers a little.
    assert seen.gauge_moment == pytest.approx(expected, rel=0.02)
    bending = 2.06e11 * 0.015 * 0.004**3 / 12
    assert seen.strain == pytest.approx(1e6 * seen.gauge_moment * 0.002 / bending, rel=1e-6)


def test_strain_changes_its_sign_with_the_load(root):
    """Folded back over the shoulder the load bends the other way."""
    arm, plant = elastic_arm(root, gravity=9.81)
    probe = Probe(plant, arm=arm)
    plant.reset([0.0, np.pi, 0.0])
    assert (probe.observe().strain < 0.0).all()


def test_joint_and_link_of_one_name(root, tmp_path):
    """Where a joint is called ``tip`` like the link after it, the beam ends there, too."""
    text = (root / 'config' / 'tudor.urdf').read_text()
    ends = []
    for name in ('tip_mount', 'tip'):
        (tmp_path / 'tudor.urdf').write_text(text.replace('"tip_mount"', f'"{name}"'))
        content = yaml.safe_load((root / 'config' / 'tudor.yaml').read_text())
        arm = arm_from_dict(content, base=tmp_path, source='tudor')
        probe = Probe(Plant(build_mechanism(arm), 5e-4))
        ends.append(probe.observe().position)
    np.testing.assert_array_equal(*ends)
