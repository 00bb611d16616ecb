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

"""Frequencies, damping ratios and ring-downs of elastic arms whose truth is known."""

from __future__ import annotations

from math import pi, radians, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tudor_dynamics.arm.description import Arm, arm_from_dict, load_arm
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification.dataset import BagChoice, BagData
from tudor_dynamics.identification.ringdowns import (
    busiest, clear_ring, enclosed, find_ringdowns, mode_map, MODES, Ringdown, STILL, vibrations)
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.models.elastic.model import driven_arm
from tudor_dynamics.signals.preprocessing import prepare

CONFIG = Path(__file__).parents[2] / 'config'
LENGTH, BENDING, DENSITY, TIP = 0.4, 16.0, 0.47, 0.3
BETA = 2e-3
RATE = 200.0

# Finite elements of the reference arm with linear gears of 232 and 162 N m/rad, without gravity
# and play, fitted to ring-downs of the public recordings: first and second frequency [Hz] with q3
# at 0, 45 and 90 deg, by payload [kg].
TABLE = {
    0.0: ((3.05, 14.7), (3.14, 13.9), (3.38, 12.5)),
    0.1: ((2.53, 10.6), (2.64, 9.6), (2.99, 8.1)),
    0.2: ((2.20, 9.5), (2.31, 8.3), (2.69, 6.8)),
    0.3: ((1.97, 9.0), (2.08, 7.7), (2.46, 6.0)),
    0.4: ((1.79, 8.7), (1.90, 7.3), (2.27, 5.6))}
NO_PLAY = {'play(joint2)': 0.0, 'play(joint3)': 0.0}


def blade(**more: Any) -> Arm:
    """Describe one blade with a mass at its tip on a rigid joint, swinging in a plane."""
    section = {'shape': 'rectangle', 'height': 0.004, 'width': 0.015}
    inertia = 0.015 * 0.004**3 / 12.0
    return arm_from_dict({
        'name': 'blade', 'gravity': [0.0, 0.0, 0.0],
        'kinematics': {'dh': [[LENGTH, 0.0, 0.0, 0.0]]},
        'joints': [{'name': 'hinge'}],
        'gauges': [{'name': 'root', 'joint': 'hinge', 'distance': 0.03}],
        'links': [{'joint': 'hinge', 'flexible': {
            'section': section, 'material': {
                'E': BENDING / inertia, 'nu': 0.3, 'rho': DENSITY / (0.004 * 0.015)},
            'lumped': [{'mass': TIP}]}}],
        'simulation': {'rayleigh': {'beta': BETA}}, **more}, base=Path(), source='test')


def swinging(driven: DrivenArm, *, noise: float, name: str = 'swings') -> BagData:
    """Record a joint that turns, stops, and turns again; strain is 100 times the moment."""
    t = np.arange(round(8.0 * RATE)) / RATE
    turn = np.clip(np.column_stack([t - 1.0, t - 4.5]) / 0.1, 0.0, 1.0)
    q = 0.3 * np.sum(turn - np.sin(2.0 * pi * turn) / (2.0 * pi), axis=1)[:, None]
    dt = np.full(len(t), 1.0 / RATE)
    dt[0] = 0.0
    strain = 100.0 * driven.follow(q, dt).moment
    strain += noise * np.random.default_rng(3).standard_normal(strain.shape)
    recording = Recording(name, np.round(t * 1e9).astype(np.int64), q, None, None, strain,
                          (slice(0, len(t)),), 1.0 / RATE)
    return BagData(BagChoice(name), recording,
                   tuple(prepare(recording, driven.arm.spec.preprocessing)))


def moving_rings(found: tuple[Ringdown, ...]) -> list[Ringdown]:
    """Leave out what stands before the first turn."""
    return [ring for ring in found if ring.begin > 1.0]


@pytest.mark.parametrize('payload', TABLE)
def test_frequencies_of_the_reference_arm(payload: float) -> None:
    """Both frequencies of the arm without play are those of the table, but for weight and sag."""
    driven = driven_arm(load_arm(CONFIG / 'tudor.yaml'), {**NO_PLAY, 'payload': payload})
    for degrees, (first, second) in zip((0.0, 45.0, 90.0), TABLE[payload], strict=True):
        found = vibrations(driven, np.array([0.0, radians(degrees)]))
        assert found[0].frequency == pytest.approx(first, rel=0.06)
        assert found[1].frequency == pytest.approx(second, rel=0.06)


def test_play_makes_unloaded_gears_soft() -> None:
    """Where weight leaves a gear in its play, the frequency falls and nothing else changes."""
    arm = load_arm(CONFIG / 'tudor.yaml')
    play, none = driven_arm(arm, {}), driven_arm(arm, NO_PLAY)
    level, hanging = np.zeros(2), np.array([0.0, -pi / 2])
    assert vibrations(play, level)[0].frequency == pytest.approx(
        vibrations(none, level)[0].frequency, rel=0.01)
    assert vibrations(play, hanging)[1].frequency < 0.8 * vibrations(none, hanging)[1].frequency


def test_every_pose_has_an_equilibrium() -> None:
    """Also where a link stands upright or hangs, and its gear lies loose in its play."""
    driven = driven_arm(load_arm(CONFIG / 'tudor.yaml'), {})
    for q2 in np.linspace(0.0, 3.0, 31):
        for upright in (pi / 2 - q2, -pi / 2 - q2):
            for q3 in upright + np.linspace(-0.06, 0.06, 13):
                assert vibrations(driven, np.array([q2, q3]))[0].frequency > 0.1


def test_blade_with_a_mass() -> None:
    """Rayleigh's frequency of a cantilever with a tip mass; damping beta w / 2, which adds up."""
    driven = driven_arm(blade(), {'gear(hinge)': 1e7})
    mode = vibrations(driven, np.zeros(1))[0]
    w = sqrt(3.0 * BENDING / (LENGTH**3 * (TIP + 33.0 / 140.0 * DENSITY * LENGTH)))
    assert mode.damping == pytest.approx(0.5 * BETA * w, rel=0.01)
    assert mode.frequency == pytest.approx(w / (2.0 * pi) * sqrt(1.0 - mode.damping**2), rel=0.01)


def test_small_motion_follows_the_tangents() -> None:
    """A simulated arm that a nudge of its drives sets off swings as its linearisation says."""
    driven = driven_arm(load_arm(CONFIG / 'tudor.yaml'), NO_PLAY)
    q = np.array([0.6, 0.5])
    expected = vibrations(driven, q)
    path = np.tile(q, (1500, 1))
    path[20:] += [2e-4, 0.0]
    dt = np.full(len(path), 2e-3)
    dt[0] = 0.0
    share, ring = clear_ring(driven.follow(path, dt).moment[300:, 0], 2e-3)
    assert ring is not None and share > 0.9
    assert ring.frequency == pytest.approx(expected[0].frequency, rel=0.01)
    assert ring.damping == pytest.approx(expected[0].damping, rel=0.1)


def test_map_covers_what_the_bags_enclose() -> None:
    """Cells that were visited or lie between have modes, others none, axes are the busy joints."""
    driven = driven_arm(load_arm(CONFIG / 'tudor.yaml'), NO_PLAY)
    angle = np.linspace(0.0, 2.0 * pi, 200)
    positions = np.column_stack([0.9 + 0.4 * np.cos(angle), 0.2 + 0.6 * np.sin(angle)])
    found = mode_map(driven, positions, cells=8)
    assert found is not None and found.joints == (0, 1)
    assert found.frequency.shape == found.damping.shape == (MODES, 8, 8)
    assert np.isfinite(found.frequency[:, 3:5, 3:5]).all()
    assert np.isnan(found.frequency[:, [0, 0, -1, -1], [0, -1, 0, -1]]).all()
    middle = [0.5 * (edge[3] + edge[4]) for edge in found.edges]
    one = vibrations(driven, np.array(middle))
    assert found.frequency[:, 3, 3] == pytest.approx([mode.frequency for mode in one])
    assert found.damping[:, 3, 3] == pytest.approx([mode.damping for mode in one])


def test_maps_of_few_joints() -> None:
    """One moving joint makes a line, none makes no map."""
    driven = driven_arm(load_arm(CONFIG / 'tudor.yaml'), NO_PLAY)
    positions = np.column_stack([np.full(50, 0.5), np.linspace(-1.0, 1.0, 50)])
    found = mode_map(driven, positions, cells=5)
    assert found is not None and found.joints == (1,)
    assert found.frequency.shape == (MODES, 5)
    # symmetric about the stretched arm, but for the sag
    assert found.frequency[0, 0] == pytest.approx(found.frequency[0, 4], rel=0.05)
    assert found.frequency[0, 2] < found.frequency[0, 0]
    assert mode_map(driven, np.zeros((9, 2))) is None


def test_choice_of_joints() -> None:
    """The two that move most, in the order of the arm."""
    t = np.linspace(0.0, 1.0, 30)
    assert busiest(np.column_stack([t, 0.1 * t, 3.0 * t])) == (0, 2)
    assert busiest(np.column_stack([0.0 * t, t])) == (1,)


def test_hull_of_cells_in_a_line() -> None:
    """Cells in a line enclose nothing, those of a corner enclose the triangle."""
    line = np.eye(5, dtype=bool)
    assert np.array_equal(enclosed(line), line)
    corner = np.zeros((5, 5), dtype=bool)
    corner[[0, 0, 4], [0, 4, 0]] = True
    assert enclosed(corner).sum() == 15


def test_ringdowns_of_a_blade() -> None:
    """Two stops, two ring-downs: measured, held and simulated agree with the truth."""
    driven = driven_arm(blade(), {'gear(hinge)': 1e5})
    values = dict(driven.parameters)
    bag = swinging(driven, noise=0.5)
    found = moving_rings(find_ringdowns(driven, values, [bag]))
    assert len(found) == 2
    for ring, place in zip(found, (0.3, 0.6), strict=True):
        truth = vibrations(driven, np.array([place]))[0]
        assert ring.q[0] == pytest.approx(place, abs=1e-3)
        assert (ring.bag, ring.gauge) == ('swings', 'root')
        assert ring.held == truth
        assert ring.measured.frequency == pytest.approx(truth.frequency, rel=0.01)
        assert ring.measured.damping == pytest.approx(truth.damping, rel=0.1)
        assert ring.simulated is not None
        assert ring.simulated.frequency == pytest.approx(ring.measured.frequency, rel=0.005)


def test_wrong_model_is_found_out() -> None:
    """Half of the stiffness shows as 1 / sqrt(2) of the frequency, held and simulated."""
    driven = driven_arm(blade(), {'gear(hinge)': 1e7})
    bag = swinging(driven, noise=0.5)
    wrong = {**driven.parameters, 'bending(hinge)': 0.5 * BENDING}
    ring = moving_rings(find_ringdowns(driven, wrong, [bag]))[0]
    assert ring.held is not None and ring.simulated is not None
    for mode in (ring.held, ring.simulated):
        assert mode.frequency / ring.measured.frequency == pytest.approx(sqrt(0.5), rel=0.02)


def test_noise_is_no_ringdown() -> None:
    """Standstill with noise alone gives nothing, and so does a joint that never stops."""
    driven = driven_arm(blade(), {'gear(hinge)': 1e7})
    bag = swinging(driven, noise=1e4)
    assert find_ringdowns(driven, dict(driven.parameters), [bag]) == ()
    slow = bag.stretches[0]
    slow.states.dq[:] = 2.0 * STILL
    assert find_ringdowns(driven, dict(driven.parameters), [bag]) == ()
