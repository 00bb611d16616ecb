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
from pathlib import Path

from elastic_making import lone_arm, lone_recording, LONE_TRUTH
import pytest

from tudor_dynamics.bags import write_bag
from tudor_dynamics.bags.writer import recording_series
from tudor_dynamics.identification.bag_choice import BagChoice
from tudor_dynamics.library.fleet.stiffness import stiffnesses


def test_stiffness_over_time(tmp_path: Path) -> None:
    """A blade is found as stiff as it is, date after date; a date without strain says why."""
    arm = lone_arm()
    for number in (3, 4):
        write_bag(tmp_path / f'bag_{number}', recording_series(lone_recording(number), arm))
    days = [datetime.date(2026, 1, day) for day in (1, 2, 3)]
    counts: list[int] = []
    seen, unused = stiffnesses({'cell': arm}, {
        ('cell', days[1]): [(BagChoice('bag_4'), 0.2)],
        ('cell', days[2]): [(BagChoice('none'), None)],
        ('cell', days[0]): [(BagChoice('bag_3'), 0.2)],
    }, arm.spec.preprocessing, tmp_path, 1, counts.append)
    assert counts[-1] == 3
    assert [str(item).split(':')[0] for item in unused] == ['cell 2026-01-03']
    assert 'no stiffness' in unused[0].why
    assert {(item.date, item.quantity.name) for item in seen} == {
        (day, f'stiffness: {part}') for day in days[:2] for part in ('bending', 'gear')}
    for item in seen:
        truth = LONE_TRUTH[f'{item.quantity.name.partition(": ")[2]}(j1)']
        assert item.output == 'elastic' and item.quantity.channel == 'j1'
        assert item.quantity.value == pytest.approx(truth, rel=0.1)
        assert 0.0 < item.quantity.error < 0.2 * truth
