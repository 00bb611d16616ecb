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

import datetime

from elastic_making import lone_arm, lone_recording, LONE_TRUTH
import pytest

from tudor_dynamics.bags.writer import recording_series, write_bag
from tudor_dynamics.fleet import study
from tudor_dynamics.identification.dataset import BagChoice, SurveyedBag
from tudor_dynamics.identification.fit import FitSettings
from tudor_dynamics.identification.many_bags import Task

DAYS = [datetime.date(2026, 1, day) for day in (1, 2, 3)]
ALL = {('cell', DAYS[1]): [SurveyedBag(BagChoice('bag_4'), 'b' * 64, 0.2)],
       ('cell', DAYS[2]): [SurveyedBag(BagChoice('none'), 'c' * 64)],
       ('cell', DAYS[0]): [SurveyedBag(BagChoice('bag_3'), 'a' * 64, 0.2)]}


@pytest.fixture(scope='module')
def task(tmp_path_factory: pytest.TempPathFactory) -> Task:
    """Write a bag of each of two dates."""
    base, arm = tmp_path_factory.mktemp('fleet'), lone_arm()
    for number in (3, 4):
        write_bag(base / f'bag_{number}', recording_series(lone_recording(number), arm))
    return Task(arm, (arm.spec.preprocessing,), ('strain',), FitSettings(), base,
                base / 'sums')


def test_stiffness_over_time(task: Task) -> None:
    """A blade is found as stiff as it is, date after date; a date without strain says why."""
    counts: list[int] = []
    seen, unused = study.stiffnesses({'cell': task}, ALL, 1, counts.append)
    assert counts[-1] == 3
    assert [str(item).split(':')[0] for item in unused] == ["'cell 2026-01-03'"]
    assert 'no stiffness' in unused[0].why
    assert {(item.date, item.quantity.name) for item in seen} == {
        (day, f'stiffness: {part}') for day in DAYS[:2] for part in ('bending', 'gear')}
    for item in seen:
        truth = LONE_TRUTH[f'{item.quantity.name.partition(": ")[2]}(j1)']
        assert item.output == 'elastic' and item.quantity.channel == 'j1'
        assert item.quantity.value == pytest.approx(truth, rel=0.1)
        assert 0.0 < item.quantity.error < 0.2 * truth


def test_what_was_found_is_not_searched_for_again(
    task: Task, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A file that was cut off, a first date that changed: that alone is searched for."""
    searches: list[object] = []
    identify = study.identify

    def counted(*args: object, **options: object) -> object:
        searches.append(options['warm'])
        return identify(*args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(study, 'identify', counted)
    both = {when: bags for when, bags in ALL.items() if when[1] != DAYS[2]}
    found = study.stiffnesses({'cell': task}, both, 1, lambda _: None)
    last, = task.store.glob('b' * 24 + '*')
    searches.clear()
    assert study.stiffnesses({'cell': task}, both, 1, lambda _: None) == found
    assert not searches
    last.write_bytes(last.read_bytes()[:100])
    assert study.stiffnesses({'cell': task}, both, 1, lambda _: None) == found
    assert len(searches) == 1 and searches[0]  # begins where the first date ended
    searches.clear()
    other = {**both, ('cell', DAYS[0]): [SurveyedBag(BagChoice('bag_3'), 'd' * 64, 0.2)]}
    study.stiffnesses({'cell': task}, other, 1, lambda _: None)
    assert searches == [None]  # ends where it ended, so the next date is the same
