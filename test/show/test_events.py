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

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tudor_dynamics.identification.detection import (
    CollisionScore, DetectedEvent, KnownPush, MethodResult, roc_of, Truth, WatchedBag)
from tudor_dynamics.online.detector import CollisionEvent
from tudor_dynamics.show.figures import event_figure, LOWEST, roc_figure
from tudor_dynamics.show.pictures import draw, draw_events, MOST, write_picture

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
                      Truth('marks', (KnownPush(at(4.0), at(4.5)),)), sightings)


def result(*bags: WatchedBag, method: str = 'strain') -> MethodResult:
    """Give what a method made of bags."""
    found = sum(len(bag.sightings) for bag in bags)
    score = CollisionScore(found, len(bags), found, 1.0, 0.2, 0.2, 0, 0.01, 0.0)
    return MethodResult(method, score, bags, roc_of(bags, 0.01))


def axes_of(bag: WatchedBag) -> Any:
    """Draw one bag."""
    return draw_events([result(bag)]).axes[0]


def test_events_and_pushes_stand_at_the_time_of_the_bag() -> None:
    """Zero is the first sample of the bag, also where the first ones are left out."""
    panel, = event_figure(result(watched()), 0)['panels']
    assert panel['traces'][1]['x'] == pytest.approx([4.2])
    axes = axes_of(watched())
    ratio, events, threshold = axes.lines
    assert ratio.get_xdata()[0] == pytest.approx(1.0)
    assert events.get_xdata() == pytest.approx([4.2])
    assert list(threshold.get_ydata()) == [1.0, 1.0]
    push, = axes.patches
    box = push.get_extents().transformed(axes.transData.inverted())
    assert (box.x0, box.x1) == pytest.approx((4.0, 4.5), abs=1e-6)
    assert axes.get_title() == 'strain: 1 of 1 pushes found, 1 events in run'


def test_what_is_small_stands_at_the_lower_edge() -> None:
    """The logarithm of nothing is no place."""
    axes = axes_of(watched())
    low, high = axes.get_ylim()
    assert low == LOWEST and high == pytest.approx(6.0)
    assert min(axes.lines[0].get_ydata()) == LOWEST


def test_nothing_found_and_nothing_watched() -> None:
    """No triangle; a bag without samples has no picture."""
    assert len(axes_of(watched(found=False)).lines[1].get_xdata()) == 0
    empty = WatchedBag('run', np.zeros(0, np.int64), np.zeros(0), Truth(), ())
    assert event_figure(result(empty), 0)['panels'] == []


def test_the_curve_of_a_method() -> None:
    """A line with its band, and a point with its interval for the thresholds in force."""
    plot = roc_figure({'strain': result(watched()).roc})
    curve, now = plot['panels'][0]['traces']
    assert curve['name'] == 'strain' and now['name'] == 'strain, threshold in force'
    assert now['x'] == [0.0] and now['y'] == [100.0]
    assert draw(plot).axes[0].get_ylabel() == 'pushes found of 1 [%]'


@pytest.mark.parametrize('suffix', ['png', 'svg'])
def test_the_file(tmp_path: Path, suffix: str) -> None:
    """Whole, of the kind that its name says, and nothing beside it."""
    target = tmp_path / f'events.{suffix}'
    write_picture(target, draw_events,
                  [result(watched('a$b')), result(watched(), method='effort')])
    content = target.read_bytes()
    assert content.startswith(b'\x89PNG' if suffix == 'png' else b'<?xml')
    assert list(tmp_path.iterdir()) == [target]


def test_no_more_bags_than_can_be_looked_at() -> None:
    """The first ones, each method below the other."""
    bags = [watched(f'run{i}') for i in range(MOST + 3)]
    drawn = draw_events([result(*bags), result(*bags, method='effort')]).axes
    assert [axes.get_title() for axes in drawn] == [
        f'{method}: 1 events in run{bag}' for bag in range(MOST)
        for method in ('strain', 'effort')]
