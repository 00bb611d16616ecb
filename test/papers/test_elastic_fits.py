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

"""Elastic models of a campaign: what is searched, from where, and that it is searched once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from papers.campaign import Campaign, Plan, ResultCache
from papers.fits import collisions, Fits, one_model, stimuli_for_search
from papers.table1 import build, markdown
import pytest

from tudor_dynamics.identification.elastic_problem import Identified
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.models.elastic.model import PhysicalParameter


class Search:
    """Stands in for the search: takes the description's parameters, and remembers its calls."""

    def __init__(self) -> None:
        self.calls: list[tuple[set[float | None], int, dict[str, float] | None]] = []

    def __call__(self, arm, records, *, warm=None, knowledge=None, progress=None) -> Identified:
        """Give what is described, gauges too."""
        self.calls.append(({record.payload for record in records}, len(records), warm))
        values = {**DrivenArm(arm).parameters, 'alpha': 0.01 * len(self.calls)}
        del values['payload']
        n = len(arm.gauge_names)
        gains = {sensor.gauge: sensor.gain for sensor in arm.spec.sensors}
        return Identified(
            tuple(PhysicalParameter(name, value, '') for name, value in values.items()),
            np.array([[gains[name], 0.0] for name in arm.gauge_names]),
            np.ones((n, 2)), np.ones(n), 90.0, ())


@pytest.fixture(scope='module')
def plan(root: Path) -> Plan:
    """Four short stimuli of two payloads."""
    return Plan(str(root / 'config/tudor.yaml'), (0.0, 0.4), 4, 12.0, jobs=1, kinds=('elastic',),
                elastic_seconds=24.0)


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a place for stages that all tests here share."""
    return tmp_path_factory.mktemp('campaign')


@pytest.fixture
def search(monkeypatch: pytest.MonkeyPatch) -> Search:
    """Replace the search."""
    made = Search()
    monkeypatch.setattr('tudor_dynamics.identification.fit.identify', made)
    return made


def test_one_search_for_each_payload(plan: Plan, folder: Path, search: Search) -> None:
    """Strain and effort share a search, which begins where that of the next heavier one ended."""
    fits = Fits(Campaign(plan, ResultCache(folder)))
    table = build(fits, 'stimulus')
    assert [call[:2] for call in search.calls] == [({0.4}, 2), ({0.0}, 2), ({0.0, 0.4}, 2)]
    first, second, together = (call[2] for call in search.calls)
    assert first is None
    assert second is not None and second['alpha'] == 0.01 and 'payload' not in second
    assert together == second
    for block in table.blocks:
        for row in block.rows:
            assert row.cells['elastic'].rmse is not None
            assert row.cells['analytical'].rmse is None
    effort = [row.cells['elastic'].fit for row in table.blocks[1].rows]
    assert min(effort) > 50.0  # regressed on what the arm of the description needs
    for item in table.shared:
        known = [value is not None for value in item.together.values()]
        assert known == [item.model == 'elastic'] * 2
    text = markdown(table)
    assert 'identified from 2 of the 2 training stimuli of each payload (24 of 24 s)' in text


def test_finished_searches_are_used_again(plan: Plan, folder: Path, search: Search) -> None:
    """A second table searches nothing; another limit does."""
    build(Fits(Campaign(plan, ResultCache(folder))), 'stimulus')
    assert not search.calls
    less = Fits(Campaign(replace(plan, elastic_seconds=12.0), ResultCache(folder)))
    one_model(less)
    # one stimulus at each end it is as before, and it begins at the same values
    assert [call[:2] for call in search.calls] == [({0.4}, 1)]


def test_undamped_is_the_same_arm(plan: Plan, folder: Path, search: Search) -> None:
    """Without the damper the search begins at what was found with it; other kinds stand beside."""
    fits = Fits(Campaign(plan, ResultCache(folder)))
    result = fits.separate(0.4, damped=False, kinds=('analytical', 'elastic'))
    assert search.calls[-1][0] == {0.4} and search.calls[-1][2] is not None
    assert {*result.content['strain']} == {'analytical', 'elastic'} == {*result.content['effort']}
    assert result.arrays['strain_elastic'].shape == result.arrays['strain_analytical'].shape
    assert result.content['ringing']


def test_pushes_are_looked_for_with_either_model(
    plan: Plan, folder: Path, search: Search,
) -> None:
    """The elastic model's strain stands beside the rigid methods, and judges the same pushes."""
    small = replace(plan, payloads=(0.0,), stimuli=2, seconds=24.0, elastic_seconds=24.0, pushes=2)
    fits = Fits(Campaign(small, ResultCache(folder / 'pushes')))
    methods = collisions(fits, 0.0).content['methods']
    assert {*methods} == {'strain', 'effort', 'momentum', 'elastic strain'}
    forces = [[push['force'] for push in item['pushes']] for item in methods.values()]
    assert forces[0] and all(other == forces[0] for other in forces)
    assert all(item['score']['pushes'] == len(forces[0]) for item in methods.values())
    assert [call[2] is None for call in search.calls] == [True, False]
    assert collisions(fits, 0.0).content['methods'] == methods and len(search.calls) == 2
    plain = Fits(Campaign(replace(small, kinds=('analytical',)), ResultCache(folder / 'pushes')))
    assert 'elastic strain' not in collisions(plain, 0.0).content['methods']


@pytest.mark.parametrize(('limit', 'count'), [
    (160.0, 2), (159.0, 1), (10.0, 1), (1e9, 5)])
def test_share_of_the_training_stimuli(limit: float, count: int) -> None:
    """As many as the limit allows, at least one, at most all."""
    assert stimuli_for_search(5, 80.0, limit) == count
