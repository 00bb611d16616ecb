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

"""The picture of collisions: what stands where, and in what file."""

from __future__ import annotations

import numpy as np
import pytest

from tudor_dynamics.identification.detection import (
    CollisionScore, DetectedEvent, KnownPush, MethodResult, roc_of, Truth, WatchedBag)
from tudor_dynamics.online.detector import CollisionEvent
from tudor_dynamics.show.figures import event_figure, LOWEST, roc_figure

BEGIN = 1_700_000_000_000_000_000


def at(seconds: float) -> int:
    """Give the stamp of a time since the bag began [ns]."""
    return BEGIN + round(seconds * 1e9)


def watched(name: str = 'run', *, found: bool = True, settled: float = 1.0) -> WatchedBag:
    """Give 10 s of ratios with a push at 4 s, seen at 4.2 s; the first second is left out."""
    t = np.arange(settled, 10.0, 0.01)
    ratio = np.where((t > 4.0) & (t < 4.5), 3.0, 0.01)
    event = CollisionEvent(at(4.1), at(4.2), 'strain', 'link2', {'g': 9.0}, {'g': 3.0})
    sightings = (DetectedEvent(event, 4.2, 'g', 3.0, 0.4, 0),) if found else ()
    return WatchedBag(name, (BEGIN + np.round(t * 1e9)).astype(np.int64), ratio,
                      Truth('marks', (KnownPush(at(4.0), at(4.5)),)), sightings,
                      np.array([at(0.01 * k) for k in range(1000)]))


def result(*bags: WatchedBag, method: str = 'strain') -> MethodResult:
    """Give what a method made of bags."""
    found = sum(len(bag.sightings) for bag in bags)
    score = CollisionScore(found, len(bags), found, 1.0, 0.2, 0.2, 0, 0.01, 0.0)
    return MethodResult(method, score, bags, roc_of(bags, 0.01))


def test_events_and_pushes_stand_at_the_time_of_the_bag() -> None:
    """Zero is the first sample of the bag, also where the first ones are left out."""
    panel, = event_figure(result(watched()), 0)['panels']
    ratio, events = panel['traces']
    assert ratio['x'][0] == pytest.approx(1.0) and events['x'] == pytest.approx([4.2])
    assert panel['at'] == 1.0
    (begin, end, _), = panel['spans']
    assert (begin, end) == pytest.approx((4.0, 4.5), abs=1e-6)


def test_what_is_small_stands_at_the_lower_edge() -> None:
    """The logarithm of nothing is no place."""
    panel, = event_figure(result(watched()), 0)['panels']
    low, high = panel['ylim']
    assert low == LOWEST and high == pytest.approx(6.0)
    assert min(panel['traces'][0]['y']) == LOWEST


def test_nothing_found_and_nothing_watched() -> None:
    """No triangle; a bag without samples has no picture."""
    panel, = event_figure(result(watched(found=False)), 0)['panels']
    assert len(panel['traces'][1]['x']) == 0
    empty = WatchedBag('run', np.zeros(0, np.int64), np.zeros(0), Truth(), (), np.array([at(0.0)]))
    assert event_figure(result(empty), 0)['panels'] == []


def test_the_curve_of_a_method() -> None:
    """A line with its band, and a point with its interval for the thresholds in force."""
    plot = roc_figure({'strain': result(watched()).roc})
    curve, now = plot['panels'][0]['traces']
    assert curve['name'] == 'strain' and now['name'] == 'strain, threshold in force'
    assert now['x'] == [0.0] and now['y'] == [100.0]
    assert plot['panels'][0]['ylabel'] == 'pushes found of 1 [%]'
