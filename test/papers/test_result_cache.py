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

"""Results that are kept: computed once, and again where anything has changed."""

from __future__ import annotations

from pathlib import Path
import shutil

import numpy as np
from papers import campaign
from papers.campaign import Cached, hub_gauges, ResultCache
import pytest

import tudor_dynamics as td


def test_computed_once(tmp_path: Path) -> None:
    """The same settings are read again, from another object too; others are computed."""
    calls = []

    def make() -> Cached:
        calls.append(1)
        return Cached({'n': len(calls)}, {'x': np.arange(3.0)})

    first = ResultCache(tmp_path).result('fit', {'seed': 1}, make)
    second = ResultCache(tmp_path).result('fit', {'seed': 1}, make)
    assert first.content == second.content == {'n': 1}
    assert second.arrays['x'].tolist() == [0.0, 1.0, 2.0]
    assert ResultCache(tmp_path).result('fit', {'seed': 2}, make).content == {'n': 2}
    # one directory a stage: what belongs to older settings is gone
    assert len(list((tmp_path / 'stages').iterdir())) == 1


def test_other_stages_are_left_alone(tmp_path: Path) -> None:
    """A stage whose name begins alike, and files of the user, stay when one is replaced."""
    stages = ResultCache(tmp_path)
    for name in ('fit_200g', 'fit_200g_damped'):
        stages.result(name, {'seed': 1}, lambda: Cached({}, {}))
    mine = stages.root / 'fit_200g-notes'
    mine.mkdir()
    stages.result('fit_200g', {'seed': 2}, lambda: Cached({}, {}))
    assert mine.is_dir()
    assert len(list(stages.root.glob('fit_200g_damped-*'))) == 1


def test_a_failure_leaves_nothing(tmp_path: Path) -> None:
    """What is interrupted is not taken for a result."""
    def fail() -> Cached:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ResultCache(tmp_path).result('fit', {}, fail)
    again = ResultCache(tmp_path).result('fit', {}, lambda: Cached({'n': 1}, {}))
    assert again.content == {'n': 1}


def test_sources_count(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A change in the study makes results again, one in the library recordings, too."""
    cache = ResultCache(tmp_path)

    def folders() -> list[Path]:
        return [cache.folder('one', {}, study=study) for study in (False, True)]

    before = folders()
    assert before == folders() and before[0] != before[1]
    copy = tmp_path / 'papers'
    shutil.copytree(campaign.HERE, copy)
    monkeypatch.setattr(campaign, 'HERE', copy)
    campaign.source_digest.cache_clear()
    assert folders() == before
    (copy / 'more.py').write_text('')
    campaign.source_digest.cache_clear()
    assert [a == b for a, b in zip(folders(), before, strict=True)] == [True, False]
    campaign.source_digest.cache_clear()


def test_no_directory(tmp_path: Path) -> None:
    """A file where the stages should go is refused."""
    (tmp_path / 'stages').write_text('')
    with pytest.raises(td.TudorError, match='no directory'):
        ResultCache(tmp_path)


def test_gauges_near_the_hubs(root: Path) -> None:
    """Of two gauges on a link, the one nearer to its joint counts for the table."""
    arm = td.load_arm(root / 'config/tudor.yaml')
    assert [arm.gauge_names[i] for i in hub_gauges(arm)] == ['link2_hub', 'link3_hub']
