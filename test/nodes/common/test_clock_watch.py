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

"""Stamps against the clock of the node: age, another clock, no stamps at all."""

from __future__ import annotations

import pytest

from tudor_dynamics.nodes.common.base import ClockWatch

SECOND = 1_000_000_000


def watched(offset: int, count: int = 100) -> ClockWatch:
    """Watch samples whose stamps are older than the clock by so much [ns]."""
    watch = ClockWatch()
    for k in range(count):
        watch.step(k * SECOND // 100 + SECOND, k * SECOND // 100 + SECOND + offset)
    return watch


def test_age_is_no_fault() -> None:
    """Samples of 3 ms are just that old."""
    watch = watched(3_000_000)
    assert watch.age == pytest.approx(0.003) and watch.text() == '3.0'
    assert watch.fault() == watch.offset('joint_states') == ''


@pytest.mark.parametrize('offset, words', [(-2 * SECOND, '2 s in the future'),
                                           (7 * SECOND, '7 s in the past')])
def test_another_clock(offset: int, words: str) -> None:
    """An offset is named with its size and direction, but only once it is certain."""
    assert words in watched(offset).offset('joint_states')
    assert watched(offset, 5).offset('joint_states') == ''


def test_no_stamps() -> None:
    """Zeros are named, as what the driver has to do about them."""
    watch = ClockWatch()
    for _ in range(30):
        watch.step(0, SECOND)
    assert 'header.stamp' in watch.fault()
    watch.reset()
    assert watch.fault() == '' and watch.text() == 'unknown'
