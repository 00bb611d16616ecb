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

from __future__ import annotations

from pathlib import Path
import re
import shutil

import numpy as np
import pytest

from tudor_dynamics._version import __version__
from tudor_dynamics.arm import load_arm
from tudor_dynamics.errors import UsageError
from tudor_dynamics.reproduction.judging import hub_gauges
from tudor_dynamics.reproduction.result_cache import (
    Cached, FITTING, RECORDING, ResultCache)
from tudor_dynamics.source_digest import PACKAGE, source_digest


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


def test_the_source_counts() -> None:
    """Recordings depend on fewer parts of the package than fits, and both on its version."""
    assert source_digest(RECORDING) != source_digest(FITTING)
    assert source_digest(FITTING).startswith(__version__)
    with pytest.raises(FileNotFoundError):
        source_digest(('signal',))  # a misspelt part must not count for nothing


@pytest.mark.parametrize(('changed', 'recorded'), [
    ('reproduction/judging.py', False), ('reproduction/plan.py', True),
    ('identification/metrics.py', False), ('identification/deeper/still.py', False),
    ('simulation/loop/drive.py', True), ('small_arrays.py', True)])
def test_what_makes_a_stage_anew(tmp_path: Path, changed: str, recorded: bool) -> None:
    """A change in any part that computes makes fits anew, and recordings where they use it."""
    def write(content: str) -> Path:
        package = tmp_path / content
        shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns('__pycache__'))
        file = package / changed
        file.parent.mkdir(exist_ok=True)
        with file.open('a') as stream:
            stream.write(f'# {content}\n')
        return package

    one, same, other = write('one'), tmp_path / 'same', write('other')
    shutil.copytree(one, same)
    assert source_digest(FITTING, one) == source_digest(FITTING, same)
    assert source_digest(FITTING, one) != source_digest(FITTING, other)
    assert (source_digest(RECORDING, one) != source_digest(RECORDING, other)) is recorded


@pytest.mark.parametrize('parts', [RECORDING[:-1], FITTING])
def test_no_part_is_missing(parts: tuple[str, ...]) -> None:
    """What the parts import of the package is among them."""
    for part in parts:
        path = PACKAGE / part
        for file in [path] if path.suffix else path.rglob('*.py'):
            for name in re.findall(r'^ *(?:from|import) tudor_dynamics\.(\w+)',
                                   file.read_text(encoding='utf-8'), re.MULTILINE):
                assert name in parts or (PACKAGE / f'{name}.py').is_file(), (file, name)


def test_no_directory(tmp_path: Path) -> None:
    """A file where the stages should go is refused."""
    (tmp_path / 'stages').write_text('')
    with pytest.raises(UsageError, match='no directory'):
        ResultCache(tmp_path)


def test_gauges_near_the_hubs(root: Path) -> None:
    """Of two gauges on a link, the one nearer to its joint counts for the table."""
    arm = load_arm(root / 'config/tudor.yaml')
    assert [arm.gauge_names[i] for i in hub_gauges(arm)] == ['link2_hub', 'link3_hub']
