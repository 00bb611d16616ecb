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

"""A fleet: who is unlike the others or drifts is named, and nobody else."""

from __future__ import annotations

import json
from pathlib import Path
import shutil

from fleet_making import write_fleet
import pytest

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.cli.main import main
from tudor_dynamics.fleet.study import load_plan, study, StudySettings
from tudor_dynamics.identification.choice import Choices
from tudor_dynamics.identification.fit import FitSettings
from tudor_dynamics.identification.many_bags import Summing
from tudor_dynamics.models.bundle import load_bundle


def other_friction(number: int, date: int) -> float:
    """Give cell_2 more friction, and let that of cell_5 grow."""
    return {1: 1.5, 4: 1.0 + 0.2 * date}.get(number, 1.0)


@pytest.fixture(scope='module')
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a fleet of six arms at four dates."""
    return write_fleet(tmp_path_factory.mktemp('fleet'), 6, other_friction)


def test_who_is_unlike_is_named(
    plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """Both are named for the friction of their elbow, no other arm for anything."""
    assert main(['fleet', str(plan), '--out', str(tmp_path / 'out'), '--no-models', '--jobs', '1',
                 '--json']) == 1
    found = json.loads(capsys.readouterr().out)
    assert {item['arm'] for item in found['named']} == {'cell_2', 'cell_5'}
    whys = {(item['arm'], item['kind']) for item in found['named']}
    assert {('cell_2', 'unlike'), ('cell_5', 'drift')} <= whys
    assert ('cell_2', 'drift') not in whys and ('cell_2', 'aged') not in whys
    assert all('elbow' in item['what'] for item in found['named']
               if item['what'].startswith('friction'))
    unlike, = (item for item in found['named']
               if item['arm'] == 'cell_2' and item['what'].startswith('friction'))
    assert unlike['value'] / unlike['expected'] == pytest.approx(1.5, abs=0.15)
    drift, = (item for item in found['named'] if item['kind'] == 'drift')
    assert drift['value'] / drift['expected'] == pytest.approx(1.6, abs=0.2)
    page = (tmp_path / 'out/fleet.html').read_text()
    assert '2 of 6 arms are named' in page and page.count('<figure class="plot"') >= 6
    rings = [item for item in found['quantities'] if item['quantity'] == 'ring-down frequency']
    assert len(rings) == 2 * 6 * 4
    assert all(item['value'] == pytest.approx(3.0, abs=0.1) for item in rings)


def test_alike_arms_are_not_named(tmp_path: Path) -> None:
    """Where nothing is wrong, nobody is named."""
    plan = write_fleet(tmp_path, 4, lambda number, date: 1.0, dates=3)
    fleet = study(load_plan(plan), StudySettings(plan.parent, tmp_path / 'out', models=False))
    assert not fleet.named and not fleet.unused and not fleet.models


def test_each_arm_has_a_model(tmp_path: Path) -> None:
    """Of its last date, by the choices of all; made once."""
    plan = write_fleet(tmp_path, 2, lambda number, date: 1.0, dates=2)
    run = StudySettings(plan.parent, tmp_path / 'out')
    fleet = study(load_plan(plan), run)
    assert fleet.models == {'cell_1': 'models/cell_1', 'cell_2': 'models/cell_2'}
    reports = [tmp_path / 'out' / model / 'report.html' for model in fleet.models.values()]
    made = [report.stat().st_mtime_ns for report in reports]
    bundle = load_bundle(reports[0].parent)
    training = bundle.facts['training']
    assert isinstance(training, list) and '2026-03-10' in training[0]['bag']
    assert study(load_plan(plan), run).models == fleet.models
    assert made == [report.stat().st_mtime_ns for report in reports]


def test_what_was_done_is_not_done_again(tmp_path: Path) -> None:
    """A second run takes up sums and models; a broken bag and a copy are left out, and named."""
    folder = tmp_path / 'fleet'
    plan = write_fleet(folder, 3, lambda number, date: 1.0, dates=2)
    damaged = folder / 'cell_3/2026-03-10/run/run.mcap'
    damaged.write_bytes(damaged.read_bytes()[:4000])
    shutil.copytree(folder / 'cell_1/2026-01-10/run', folder / 'cell_2/2026-01-10/copy')
    run = StudySettings(folder, tmp_path / 'out', models=False)
    first = study(load_plan(plan), run)
    sums = {file: file.stat().st_mtime_ns for file in (tmp_path / 'out/sums').iterdir()}
    assert len(sums) == 6 * (3 * 2 - 1)
    again = study(load_plan(plan), run)
    assert sums == {file: file.stat().st_mtime_ns for file in (tmp_path / 'out/sums').iterdir()}
    assert first.as_dict() == again.as_dict()
    unused = {item.bag: item.why for item in first.unused}
    assert any('cell_3/2026-03-10/run' in bag for bag in unused)
    assert 'is a copy of a bag of cell_1 2026-01-10' in unused['cell_2/2026-01-10/copy']


@pytest.mark.parametrize(('text', 'words'), [
    ('', 'plan.yaml: the content must be keys with values, found no value'), ('arms: []', 'arms'),
    ('arms: 3', 'arms'), ('[', 'plan.yaml'),
    ('arms: [{name: a, bags: {2026-01-10: x}}]', "arm 'a' has no description"),
    ('arms: [{name: a/b, arm: x, bags: {2026-01-10: x}}]',
     "plan.yaml: arms[0].name: 'a/b' cannot name a folder; take letters and digits; docs/"),
    ('arms: [{name: a, arm: x, bags: {monday: x}}]',
     "plan.yaml: arms[0].bags.monday must be a date such as 2026-01-31, found 'monday'; docs/"),
    ('{arm: x, arms: [{name: a, bags: {2026-01-10: x}}, {name: a, bags: {2026-01-10: x}}]}',
     "two arms are called 'a'"),
    ('{arm: nowhere.yaml, arms: [{name: a, bags: {2026-01-10: x}}]}', 'nowhere.yaml'),
    ('{arm: cell.yaml, arms: [{name: a, bags: {2026-01-10: x}}]}', 'x')])
def test_wrong_plans(
    text: str, words: str, plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """One line, exit code 2, nothing written."""
    shutil.copy(plan.parent / 'cell.yaml', tmp_path)
    (tmp_path / 'plan.yaml').write_text(text)
    assert main(['fleet', str(tmp_path / 'plan.yaml'), '--out', str(tmp_path / 'out')]) == 2
    told = capsys.readouterr().err
    assert words in told and len(told.splitlines()) == 1
    assert not (tmp_path / 'out').exists()


def test_all_that_was_chosen_of_friction_is_taken(
    plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also over which way it gives way."""
    given: list[Arm] = []

    def chosen(arm: Arm, *_: object, **__: object) -> Choices:
        given.append(arm.with_joints({'elbow': {
            'friction': ('viscous', 'presliding'), 'presliding_distances': (0.001, 0.02)}}))
        return Choices(given[0], arm.spec.preprocessing, FitSettings().settled(), ())

    monkeypatch.setattr('tudor_dynamics.fleet.study.choose', chosen)
    monkeypatch.setattr('tudor_dynamics.fleet.study.go_through', taken := Taken())
    with pytest.raises(Taken.Here):
        study(load_plan(plan), StudySettings(plan.parent, tmp_path, models=False))
    assert taken.joints == given[0].joints


class Taken:
    """Keeps the joints that bags are gone through with."""

    class Here(Exception):
        """Raised there, as the rest is of no concern."""

    def __call__(self, asked: list[Summing], *_: object) -> None:
        """Stand in for the pass over all bags."""
        self.joints = asked[0].task.arm.joints
        raise self.Here
