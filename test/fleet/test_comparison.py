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

"""Numbers that arms are compared by: what they are, how certain, and how they are said."""

from __future__ import annotations

import datetime
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tudor_dynamics.fleet.comparison import (
    Fleet, Measure, Named, named_outliers, Observation, page_of, parted, quantities, Quantity,
    ring_quantities)
from tudor_dynamics.identification.dataset import BagChoice, SurveyedBag, Unused

DAYS = [datetime.date(2026, 1, day) for day in (1, 11, 21)]


def model(value: float) -> Any:
    """Stand in for a model with one parameter."""
    return SimpleNamespace(coefficients=lambda: np.array([[value]]))


def seen(arm: str, day: datetime.date, value: float, error: float = 0.01) -> Observation:
    """Give the friction of an arm's elbow at a date."""
    return Observation(arm, day, 'effort', Quantity('friction', 'elbow', 'A', value, error))


def test_standard_error_of_a_mean_is_the_usual_one() -> None:
    """Parts left out give, of a mean of parts, their scatter over the root of their number."""
    parts = np.array([1.0, 1.4, 0.7, 1.1, 0.9, 1.3])
    others = [model(np.delete(parts, i).mean()) for i in range(len(parts))]
    friction = Measure('friction', 'elbow', 'A', np.array([[2.0]]))
    found, = quantities([friction], model(parts.mean()), others)
    assert found.value == pytest.approx(2.0 * parts.mean())
    assert found.error == pytest.approx(2.0 * parts.std(ddof=1) / np.sqrt(6))
    assert (found.name, found.channel, found.unit) == ('friction', 'elbow', 'A')
    assert quantities([friction], model(1.0), others[:3]) == []  # too few parts for an error


def test_ring_downs_of_a_date_are_one_number() -> None:
    """Their median, which one odd ring-down hardly moves; two are too few to say how certain."""
    measured = [('hub', 3.0 + 0.01 * i, 0.02) for i in range(-3, 4)]
    frequency, damping = ring_quantities([*measured, ('mid', 5.0, 0.1), ('mid', 5.1, 0.1)])
    assert (frequency.name, frequency.channel, frequency.unit) == (
        'ring-down frequency', 'hub', 'Hz')
    assert frequency.value == pytest.approx(3.0) and 0.0 < frequency.error < 0.02
    assert damping.value == pytest.approx(0.02) and damping.unit == ''
    odd, _ = ring_quantities([*measured, ('hub', 30.0, 0.5)])
    assert odd.value == pytest.approx(3.0, abs=0.01) and odd.error < 0.03


@pytest.mark.parametrize(('bags', 'least', 'count'), [(1, 6, 6), (2, 6, 6), (4, 6, 8), (9, 6, 9)])
def test_few_bags_are_divided(bags: int, least: int, count: int) -> None:
    """There are enough parts, equally long, and together they are the bags."""
    whole = [SurveyedBag(BagChoice(f'bag_{i}', 0.2, 0.8), 'a' * 64, 0.1) for i in range(bags)]
    found = parted(whole, least)
    assert len(found) == count
    for bag in whole:
        own = [part.choice for part in found if part.choice.path == bag.choice.path]
        assert own[0].begin == pytest.approx(0.2) and own[-1].end == pytest.approx(0.8)
        for one, other in zip(own, own[1:], strict=False):
            assert one.end == pytest.approx(other.begin)
        assert {part.payload for part in found} == {0.1}


def test_an_outlier_is_named_in_words() -> None:
    """By arm, quantity, both values and how certain the difference is; uncertain numbers not."""
    arms = [f'cell_{i}' for i in range(6)]
    found = named_outliers([seen(arm, day, 1.5 if arm == 'cell_2' else 1.0)
                            for arm in arms for day in DAYS])
    assert [(item.arm, item.kind) for item in found] == [('cell_2', 'unlike')]
    assert str(found[0]).startswith(
        'cell_2: differs from the others: friction, elbow (effort): 1.5 A, the others 1 (+')
    assert named_outliers([seen(arm, DAYS[0], 9.0 if arm == 'cell_2' else 1.0, np.inf)
                           for arm in arms]) == []
    assert named_outliers([]) == []


def test_page_shows_who_is_named() -> None:
    """Each quantity has its picture; texts of bags and arms are no markup."""
    numbers = tuple(seen(arm, day, 1.0) for arm in ('cell <1>', 'cell_2') for day in DAYS)
    named = Named('cell <1>', 'drift', 'friction, elbow (effort)', 'A', 1.4, 1.0, 9.0)
    assert 'cell <1>: drifts: ' in str(named) and '(+9.0 standard errors)' in str(named)
    fleet = Fleet('line', ('cell <1>', 'cell_2'), numbers, (named,), ('filters: causal',), {},
                  (Unused('bag_7', 'cannot be read'),))
    page = page_of(fleet)
    assert page.count('<figure class="plot"') == 1 and '1 of 2 arms' in page
    assert 'cell &lt;1&gt;' in page and 'cell <1>' not in page
    assert 'bag_7' in page and 'cannot be read' in page
    content = fleet.as_dict()
    assert content['named'][0]['sigmas'] == 9.0 and len(content['quantities']) == 6
    assert content['quantities'][0]['date'] == '2026-01-01'
