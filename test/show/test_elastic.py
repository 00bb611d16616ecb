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

"""The report's section on the elastic arm, on a blade whose parameters are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
import re
from typing import Any

import numpy as np
import pytest

from tudor_dynamics.arm.description import Arm, arm_from_dict
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification.dataset import BagChoice, BagData
from tudor_dynamics.identification.elastic_problem import Identified, Start
from tudor_dynamics.identification.elastic_search import FACTORS
from tudor_dynamics.identification.fit import fit_models, FitResult, FitSettings
from tudor_dynamics.identification.ringdowns import ModeMap, Ringdown
from tudor_dynamics.models.elastic.model import driven_arm, PhysicalParameter
from tudor_dynamics.models.elastic.parameters import physical_unit
from tudor_dynamics.show.figures import encoded, mode_figure
from tudor_dynamics.show.page import (
    MOST_ROWS, NOT_SHOWN, render, start_rows, strongest, summary)
from tudor_dynamics.signals.filters import Vibration
from tudor_dynamics.signals.preprocessing import prepare

RATE = 100.0
HOSTILE = '<b>hinge & $\\frac{x'


def two_blades(name: str = 'elbow') -> Arm:
    """Describe two blades with an elbow mass, swinging in a plane."""
    flexible = {'section': {'shape': 'rectangle', 'height': 0.004, 'width': 0.015},
                'material': {'E': 2e11, 'nu': 0.3, 'rho': 7850}}
    joints = ['shoulder', name]
    return arm_from_dict({
        'name': 'blades', 'gravity': [0.0, -9.81, 0.0],
        'kinematics': {'dh': [[0.35, 0.0, 0.0, 0.0]] * 2},
        'joints': [{'name': joint} for joint in joints],
        'gauges': [{'name': f'bridge{i}', 'joint': joint, 'distance': 0.03}
                   for i, joint in enumerate(joints)],
        'links': [{'joint': joints[0], 'flexible': {**flexible, 'lumped': [{'mass': 0.5}]}},
                  {'joint': joints[1], 'flexible': flexible}],
        'motors': [{'joint': joint, 'gear_ratio': 200, 'torque_constant': 0.05,
                    'stiffness': 200.0, 'damping': 0.2} for joint in joints],
        'simulation': {'rayleigh': {'beta': 1e-3}}}, base=Path(), source='test')


def bag(arm: Arm, name: str, seed: int) -> BagData:
    """Record an arm that moves off gently, stops with a jerk after 7 s, and rings for 3 s."""
    t = np.arange(round(10.0 * RATE)) / RATE
    s = np.clip(t - 0.5, 0.0, 6.5) * (1.0 + 0.02 * seed)
    q = np.column_stack([0.9 - 0.4 * np.cos(1.1 * s), 0.5 * np.cos(1.7 * s)])
    dt = np.full(len(t), 1.0 / RATE)
    dt[0] = 0.0
    strain = 80.0 * driven_arm(arm, {}).follow(q, dt).moment + [3.0, -2.0]
    strain += 0.2 * np.random.default_rng(seed).standard_normal(strain.shape)
    recording = Recording(name, np.round(t * 1e9).astype(np.int64), q, None, None, strain,
                          (slice(0, len(t)),), 1.0 / RATE)
    return BagData(BagChoice(f'some/where/{name}'), recording,
                   tuple(prepare(recording, arm.spec.preprocessing)))


def truth(arm: Arm) -> Identified:
    """Give the description's own values as what was found, one of them not shown."""
    described = driven_arm(arm, {}).parameters
    physical = tuple(
        PhysicalParameter(name, value, physical_unit(arm, name), 0.01 * value, name != 'beta')
        for name, value in described.items() if value > 0.0)
    return Identified(physical, np.array([[80.0, 3.0], [80.0, -2.0]]),
                      np.array([[0.5, 0.1], [0.6, 0.2]]), np.array([0.2, 0.2]), 98.7,
                      (Start(1.0, None, 97.6), Start(float(FACTORS[-1]), None, 41.2)))


def fitted(arm: Arm, monkeypatch: pytest.MonkeyPatch, **settings: Any) -> FitResult:
    """Fit an elastic model whose search is short of a miracle: it finds the truth at once."""
    monkeypatch.setattr('tudor_dynamics.identification.fit.identify', lambda *_, **__: truth(arm))
    bags = [bag(arm, f'run{seed}', seed) for seed in (1, 2)]
    return fit_models(arm, bags[:1], bags[1:], None, arm.spec.preprocessing,
                      FitSettings(**{'kinds': ('analytical', 'elastic'), **settings}))


def words(html: str) -> str:
    """Give the text of a page without tags."""
    text = re.sub(r'<(style|script).*?</\1>|<[^>]*>', ' ', html, flags=re.DOTALL)
    return ' '.join(text.split())


def figures(html: str) -> list[str]:
    """Give what the figures are drawn from."""
    return re.findall(r'<script type="application/json">(.*?)</script>', html)


def test_section_says_what_was_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parameters in words, gauges, modes, ring-downs, starts, settings, reading."""
    result = fitted(two_blades(), monkeypatch)
    assert result.elastic is not None and result.elastic.fit == 98.7
    html = render(result)
    text = words(html)
    assert 'id="elastic"' in html and 'href="#elastic"' in html
    assert 'to 98.7 %.' in text
    assert 'bending stiffness of the link after shoulder 16.0 0.16 N·m² 16.0' in text
    assert 'mass on the link after shoulder 0.500 0.0050 kg 0.500' in text
    assert text.count(NOT_SHOWN) == 2  # one row, and how to read it
    assert 'The payload of 0 kg was given' in text
    assert 'bridge0 80.0 0.50 (µm/m)/(N·m) 3.00 0.10 µm/m' in text
    assert '1.00 as described 97.6 best' in text
    assert '2.46 as described 41.2 at the edge of what was tried' in text
    assert 'Elastic model robust least squares' in text
    assert 'Frequency and damping ratio over the pose' in text
    assert '2 stretches of the training and validation bags' in text
    assert 'run1' in text and 'some/where/run1' in text
    drawn = figures(html)
    assert sum('first mode: frequency [Hz]' in text and 'ring-down measured here' in text
               and 'shoulder [rad]' in text for text in drawn) == 1
    assert sum('measured frequency [Hz]' in text for text in drawn) == 1
    assert sum('"elastic"' in text and '"analytical"' in text for text in drawn) == 3
    assert html == render(result)


def test_true_model_predicts_its_ringdowns(monkeypatch: pytest.MonkeyPatch) -> None:
    """The sentence over the ring-downs of the true arm says next to no deviation."""
    text = words(render(fitted(two_blades(), monkeypatch, kinds=('elastic',))))
    held = re.search(r'joints held \(2 of 2\), the frequency is off by ([\d.]+) %', text)
    moved = re.search(r'measured motion \(2 of 2\), the frequency is off by ([\d.]+) %', text)
    assert held is not None and float(held[1]) < 1.0
    assert moved is not None and float(moved[1]) < 0.5


def test_no_elastic_model_no_section(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without an elastic model nothing of it stands in the page."""
    result = fitted(two_blades(), monkeypatch, kinds=('analytical',))
    assert result.elastic is None
    html = render(result)
    assert 'id="elastic"' not in html and '#elastic' not in html
    assert 'Elastic model' not in html and 'Ring-down' not in html


def test_hostile_joint_names(monkeypatch: pytest.MonkeyPatch) -> None:
    """Markup and mathematics in the name of a joint come out as text."""
    html = render(fitted(two_blades(HOSTILE), monkeypatch, kinds=('elastic',)))
    assert '<b>hinge' not in html
    assert 'stiffness of the gear of &lt;b&gt;hinge &amp; $' in html


def test_resting_arm_has_neither_map_nor_ringdowns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bags without motion give a section that says so."""
    arm = two_blades()
    result = fitted(arm, monkeypatch, kinds=('elastic',))
    still = []
    for data in (*result.training, *result.test):
        shape = data.recording.q.shape
        noise = np.random.default_rng(5).standard_normal(shape)
        recording = replace(data.recording, q=np.zeros(shape), strain=noise)
        still.append(BagData(data.choice, recording,
                             tuple(prepare(recording, arm.spec.preprocessing))))
    html = render(replace(result, training=(still[0],), test=(still[1],)))
    assert 'None: the bags have no stretch of 1.2 s or more' in words(html)
    assert 'Frequency and damping over the pose' not in words(html)


def ring(amplitude: float, held: Vibration | None = None) -> Ringdown:
    """Make a ring-down of 3 Hz and 2 %."""
    return Ringdown('a/b@0-50%', 1.0, 2.0, (-1e-9, 0.5), 'bridge', amplitude,
                    Vibration(3.0, 0.02), held, None)


def test_strongest_ringdowns_are_listed() -> None:
    """A long list is cut to the strongest, in their order; zero has no sign."""
    many = [ring(float(k % 30)) for k in range(60)]
    rows = strongest(many)
    assert len(rows) == MOST_ROWS
    assert min(ring.amplitude for ring, _, _ in rows) >= 30 - MOST_ROWS / 2
    assert rows[0][1:] == ('b@0-50%', '0.00, 0.50')


def test_summary_of_deviations() -> None:
    """Median deviation with its sign, and how many could be compared."""
    text = summary([ring(1.0, Vibration(3.3, 0.01)), ring(1.0)])
    assert 'joints held (1 of 2), the frequency is off by 10.0 %' in text
    assert 'less than measured by 1 percentage points' in text
    assert summary([ring(1.0)]) == ''


def test_starts_are_sorted_and_marked() -> None:
    """By share and factor; the best is marked, also at the edge."""
    rows = start_rows((Start(1.5, None, 80.0), Start(float(FACTORS[0]), None, 90.0),
                       Start(1.1, 0.5, 70.0)))
    assert [(start.fit, share, note) for start, share, note in rows] == [
        (90.0, 'as described', 'best, at the edge of what was tried'),
        (80.0, 'as described', ''), (70.0, '50 %', '')]


def test_one_joint_is_a_line() -> None:
    """Modes over one joint are lines, with the ring-downs measured among them."""
    edges = np.linspace(0.0, 1.0, 5)
    found = ModeMap((0,), (edges,), np.array([[3.0, 3.1, 3.2, 3.3], [9.0, np.nan, 8.0, 7.0]]),
                    np.full((2, 4), 0.02))
    drawn = encoded(mode_figure(found, [('hinge', 'rad')], [ring(1.0)]))
    for text in ('first mode', 'second mode', 'ring-down measured', 'hinge [rad]'):
        assert text in drawn
