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

"""Pushes of a bag: from a wrench, from a Bool, from a table, or unknown."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from bag_making import joint_states, make_bag, times
import numpy as np
from numpy.typing import NDArray
import pytest
from sample_arms import recording_of

from tudor_dynamics.bags.messages import Signals, WRENCH_STAMPED
from tudor_dynamics.bags.reader import BOOL
from tudor_dynamics.bags.storage import RawMessages
from tudor_dynamics.errors import BagError, UsageError
from tudor_dynamics.identification.dataset import BagChoice, BagData
from tudor_dynamics.identification.detection import (
    DetectedEvent, find_truth, FREE, KnownPush, push_of, roc_of, score, table_of_pushes, Truth,
    truth_of_file, WatchedBag)
from tudor_dynamics.online.detector import CollisionEvent


def button(stamp: NDArray[np.int64], *value: bool) -> RawMessages:
    """Give messages of a Bool topic."""
    return RawMessages('/button', BOOL, stamp,
                       [b'\x00\x01\x00\x00' + bytes([item]) for item in value])


def test_truth_of_a_wrench(tmp_path: Path) -> None:
    """Each stretch of force is a push, with its mean force; short pauses do not end it."""
    stamp = times()
    force = np.zeros((300, 3))
    force[50:80, 0], force[84:90, 0], force[200:220, 1] = 2.0, 3.0, -4.0
    bag = make_bag(tmp_path / 'bag', joint_states(), Signals(
        '/applied_wrench', stamp, {'force': force, 'torque': np.zeros((300, 3))}, frame='tip',
        msgtype=WRENCH_STAMPED))
    found = find_truth(str(bag))
    assert found.known and found.source == 'applied_wrench'
    assert found.pushes == (KnownPush(int(stamp[50]), int(stamp[89]), 78.0 / 36.0),
                            KnownPush(int(stamp[200]), int(stamp[219]), 4.0))


@pytest.mark.filterwarnings('error')
def test_a_wrench_that_nobody_can_square(tmp_path: Path) -> None:
    """It is a push all the same, and its size is not infinite."""
    stamp, force = times(), np.zeros((300, 3))
    force[100:150] = 1e200
    bag = make_bag(tmp_path / 'b', joint_states(), Signals(
        '/applied_wrench', stamp, {'force': force, 'torque': np.zeros((300, 3))}, frame='tip',
        msgtype=WRENCH_STAMPED))
    push, = find_truth(str(bag)).pushes
    assert push.force == pytest.approx(3.0**0.5 * 1e200)


def test_truth_of_a_bool(tmp_path: Path) -> None:
    """A Bool on change counts from rise to fall, on the header stamps of the joint states."""
    stamp = times()
    late = 70_000_000  # ns by which the clock of the bag is later than that of the headers
    changes, pressed = stamp[[0, 40, 90, 250]], (False, True, False, True)
    bag = make_bag(tmp_path / 'bag', joint_states(), button(changes, *pressed))
    assert [(push.begin, push.end) for push in find_truth(str(bag), 'button').pushes] == [
        (stamp[40], stamp[90]), (stamp[250], stamp[250])]
    moved = make_bag(tmp_path / 'moved', joint_states(stamp), button(
        changes - late, *pressed))
    assert find_truth(str(moved), '/button').pushes[0].begin == stamp[40] - late
    with pytest.raises(BagError, match='has no messages on /other'):
        find_truth(str(bag), '/other')
    with pytest.raises(BagError, match='/joint_states is of type'):
        find_truth(str(bag), '/joint_states')


def watched_at(stamp: np.ndarray, places: list[int], truth: Truth) -> WatchedBag:
    """Give a bag that was judged throughout, with an event at each of some samples."""
    found = (CollisionEvent(int(time), int(time), 'strain', 'link') for time in stamp[places])
    return WatchedBag('a', stamp, np.zeros(len(stamp)), truth, tuple(
        DetectedEvent(event, 0.0, 'g', 1.0, 0.1) for event in found), stamp)


def test_a_bag_without_truth_is_unknown(tmp_path: Path) -> None:
    """Nothing is known where there is no topic: an event there is neither right nor false."""
    bag = make_bag(tmp_path / 'bag', joint_states())
    truth = find_truth(str(bag))
    assert not truth.known and truth.pushes == ()
    stamp = times(1000)
    watched = [watched_at(stamp, [10, 20], truth), watched_at(stamp, [30, 505], Truth(
        'x', (KnownPush(int(stamp[500]), int(stamp[550])),)))]
    alone = score(watched[:1])
    assert (alone.events, alone.false_alarms, alone.false_alarms_per_hour, alone.hours) == (
        2, None, None, 0.0)
    both = score(watched)
    assert (both.events, both.pushes, both.found, both.false_alarms) == (4, 1, 1, 1)
    assert both.latency_median == pytest.approx(0.05)
    free = score([watched_at(stamp, [10, 20], FREE)])
    assert free.false_alarms == 2
    # an event before a push is a false alarm
    soon = score([watched_at(stamp, [495], watched[1].truth)])
    assert (soon.found, soon.false_alarms) == (0, 1)
    # unless the push is marked by eye, perhaps a moment too late: then it is found at once
    by_eye = Truth('x', (replace(watched[1].truth.pushes[0], early=100_000_000),))
    early, soon = (score([watched_at(stamp, [place], by_eye)]) for place in (485, 495))
    assert (early.found, early.false_alarms) == (0, 1)
    assert (soon.found, soon.false_alarms, soon.latency_median) == (1, 0, 0.0)


def test_time_that_was_not_judged_is_not_free() -> None:
    """A sample stands for its period; a gap counts neither as free nor as a push."""
    stamp = times(3001)  # 30 s at 100 Hz
    judged = stamp[(stamp < stamp[500]) | (stamp >= stamp[1500])]
    item = WatchedBag('a', judged, np.zeros(len(judged)), FREE, (), stamp)
    free = score([item])
    assert 3600.0 * free.hours == pytest.approx(20.0)
    assert 3600.0 * free.unjudged == pytest.approx(10.0)
    # of a push and its 2 s afterwards, half lies in the gap
    push = KnownPush(int(stamp[1300]), int(stamp[1500]))
    pushed = score([replace(item, truth=Truth('x', (push,)))])
    assert 3600.0 * pushed.hours == pytest.approx(18.0)
    whole = score([watched_at(stamp, [], Truth('x', (push,)))])
    assert 3600.0 * whole.hours == pytest.approx(26.0) and whole.unjudged == 0.0
    assert item.not_judged == pytest.approx(1 / 3, abs=0.001)
    assert watched_at(stamp, [], FREE).not_judged == 0.0
    # what is not judged at the end counts, what settles at the begin does not
    assert replace(item, stamp=stamp[500:2501]).not_judged == pytest.approx(0.2, abs=0.001)
    assert replace(item, stamp=stamp[:0]).not_judged == 1.0
    # one sample in each 0.9 s is no time that is judged, however even they are
    assert replace(item, stamp=stamp[::90]).not_judged == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(('count', 'low', 'high'), [
    (0, 0.0, 2.996), (1, 0.0513, 4.744), (19, 12.44, 27.88)])
def test_how_many_times_what_was_promised_came(count: int, low: float, high: float) -> None:
    """The interval is the exact one of a Poisson count (Garwood, 1936), here of half an hour."""
    stamp = np.array([0, 1_800_000_000_000])
    item = watched_at(stamp, [0] * count, FREE)
    kept = score([item]).kept(2.0)
    assert kept is not None and kept['promised'] == pytest.approx(1.0)
    assert kept['ratio'] == pytest.approx(count)
    assert (kept['low'], kept['high']) == pytest.approx((low, high), rel=2e-3)
    assert score([replace(item, truth=Truth())]).kept(2.0) is None


def test_a_table_of_pushes(tmp_path: Path) -> None:
    """Seconds since the beginning of the bag, in any order, with names of columns or without."""
    table = tmp_path / 'pushes.csv'
    table.write_text('begin,end,by\n4.5, 5,hand\n\n# the second one was soft\n2.0,2.95\n')
    assert table_of_pushes(table) == [(2.0, 2.95, 0.0), (4.5, 5.0, 0.0)]
    table.write_text('begin,end,tolerance\n2.0,2.95,0.1\n4.5,5.0\n')
    assert table_of_pushes(table) == [(2.0, 2.95, 0.1), (4.5, 5.0, 0.0)]
    recording = recording_of(np.zeros((1000, 1)), 100.0)
    whole = truth_of_file(table, BagData(BagChoice('bag'), recording, ()))
    assert whole.source == str(table)
    first = int(recording.stamp[0])
    assert whole.pushes[0] == KnownPush(first + 2_000_000_000, first + 2_950_000_000,
                                        whole.pushes[0].force, early=100_000_000)
    part = truth_of_file(table, BagData(BagChoice('bag', 1.5, 9.0, seconds=True), recording, ()))
    assert part.pushes[0].begin == first + 500_000_000


@pytest.mark.parametrize('text', [
    '2.0', 'begin,end\n2,1\n', '1,2\nx,y\n', '-1,2\n', '1,nan\n', '1,2,-1\n',
    '1,1e300\n'])
def test_bad_tables(tmp_path: Path, text: str) -> None:
    """A line that is no push is named, with what was expected."""
    table = tmp_path / 'pushes.csv'
    table.write_text(text)
    with pytest.raises(UsageError, match=r'line \d: found .* expected begin,end'):
        table_of_pushes(table)
    with pytest.raises(UsageError, match='cannot be read'):
        table_of_pushes(tmp_path / 'none.csv')


def test_the_push_of_an_event() -> None:
    """An event belongs to the last push that has begun, until shortly after its end."""
    pushes = (KnownPush(0, 10**9), KnownPush(5 * 10**9, 6 * 10**9))
    assert [push_of(round(t * 1e9), pushes) for t in (0.5, 2.9, 3.1, 5.0, 9.0)] == [
        0, 0, None, 1, None]
    assert push_of(round(4.95e9), pushes) is None and push_of(-2 * 10**8, pushes) is None
    by_eye = (pushes[0], replace(pushes[1], early=10**8))
    assert push_of(round(4.95e9), by_eye) == 1 and push_of(round(4.85e9), by_eye) is None


def test_curve_of_all_thresholds() -> None:
    """Found by peaks, false by seconds; never less found by less; intervals are exact ones."""
    stamp = times(2000)
    ratio = np.full(2000, 0.05)
    pushes = tuple(KnownPush(int(stamp[k]), int(stamp[k + 30])) for k in (300, 900, 1500))
    ratio[310], ratio[905], ratio[1510] = 3.0, 0.8, 0.4
    ratio[[20, 21, 22]] = 2.0  # one false event
    ratio[1300] = 0.5
    item = WatchedBag('a', stamp, ratio, Truth('marks', pushes), (), stamp)
    roc = roc_of([item], 0.01)
    at = {round(float(factor), 6): (int(found), int(false)) for factor, found, false in zip(
        roc.factor, roc.found, roc.false, strict=True)}
    assert at[1.0] == (1, 1) and at[0.8] == (2, 1) and at[0.4] == (3, 2)
    assert roc.factor[roc.now] == 1.0
    assert np.all(np.diff(roc.factor) < 0.0)
    assert np.all(np.diff(roc.found) >= 0) and np.all(np.diff(roc.false) >= 0)
    assert roc.found[-1] == 3  # the lowest threshold finds all, however long its alarms last
    assert roc.per_hour()[roc.now] == pytest.approx(100.0)
    low, high = roc.found_interval()  # Clopper and Pearson, 1 of 3 and 3 of 3 at 90 %
    assert (low[roc.now], high[roc.now]) == pytest.approx((1.695, 86.465), abs=1e-3)
    assert (low[-1], high[-1]) == pytest.approx((36.840, 100.0), abs=1e-3)
    assert roc.false_interval(roc.now) == pytest.approx((5.129, 474.386), rel=1e-3)
    assert list(roc)[roc.now] == (1.0, pytest.approx(100.0), pytest.approx(1.0 / 3.0))
    silent = roc_of([replace(item, ratio=np.zeros(2000))], 0.01)
    assert np.all(silent.factor > 0.0) and not silent.found.any()
    unknown = roc_of([replace(item, truth=Truth())], 0.0)
    assert not unknown.pushes and not unknown.found.any() and not unknown.false.any()
