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

"""Motion unlike that of the recordings: thresholds widen, and a push does not widen them."""

from __future__ import annotations

from dataclasses import replace
import json
import math
from typing import Any

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from threshold_making import CHANNELS, ringing, walk

from tudor_dynamics.errors import ModelError
from tudor_dynamics.online.detector import ExcessStage, follow, levels, Rates
from tudor_dynamics.online.settings import LEVEL_QUANTILE, LOWEST_LEVEL, WIDEST
from tudor_dynamics.online.threshold_learning import (
    FreeMotion, thresholds_from_dict, thresholds_to_dict)
from tudor_dynamics.online.thresholds import MethodThresholds
from tudor_dynamics.typing import FloatArray

RATES = Rates(6.0, 60.0)


def scaled(record: FreeMotion, size: float, speed: float = 1.0) -> FreeMotion:
    """Scale residuals and speeds."""
    motion = record.motion.copy()
    motion[:, 2:4] *= speed
    return FreeMotion(record.stamp, motion, size * record.residual)


def test_larger_residuals_widen_in_place_of_alarms(learned: MethodThresholds) -> None:
    """Two and a half times what was learned, for half a minute: no alarm once that is known."""
    record = scaled(ringing(40, 21), 2.5)
    stage = ExcessStage(learned, RATES)
    known = record.t > 5.0
    alarms = np.array([x.collision.max() > 1.0 for x in walk(stage, record)])[known]
    assert (stage.widening > 1.6).all() and (stage.widening < 3.5).all()
    assert alarms.sum() <= 2  # of 3500 samples; it takes two in a row for an event
    without = ExcessStage(replace(learned, usual=np.full(2, 1e9), reach=np.full(2, 1e9)), RATES)
    blind = np.array([x.collision.max() > 1.0 for x in walk(without, record)])[known]
    assert blind.sum() > 50
    assert (without.widening == 1.0).all()


def test_free_motion_as_learned_hardly_widens(learned: MethodThresholds) -> None:
    """The usual level is that of the recordings: seldom more than a fifth above it."""
    stage = ExcessStage(learned, RATES)
    seen = []
    for x in walk(stage, ringing(60, 22)):
        seen.append(stage.widening.max())
        assert x.threshold.shape == (2,)
    assert np.quantile(seen, 0.9) < 1.2


def test_a_memory_goes_on_to_the_last_bit(learned: MethodThresholds) -> None:
    """A stage that hears the last 30 s alone is as that which heard all, with its memory."""
    record = scaled(ringing(60, 24), 1.5)
    stage = ExcessStage(learned, RATES)
    walked = walk(stage, record)
    both = json.loads(json.dumps(stage.memory.before(int(record.stamp[-1]))))
    memory, later = both
    assert 20.0 < (record.stamp[-1] - memory['stamp']) * 1e-9 <= 25.0
    assert later['stamp'] - memory['stamp'] == 10_000_000_000
    late = record.t > record.t[-1] - 30.0
    last = FreeMotion(record.stamp[late], record.motion[late], record.residual[late])

    def ratios(*memories: dict[str, Any]) -> FloatArray:
        other = ExcessStage(learned, RATES)
        other.memory.recall(memories)
        return np.array([x.collision for x in walk(other, last)])[-900:]
    expected = np.array([x.collision for x in walked])[-900:]
    for known in (both, both[:1], both[1:]):
        assert np.array_equal(ratios(*known), expected)
    assert not np.array_equal(ratios(), expected)
    other = [*memory['of'][:-1], 2.0 * memory['of'][-1]]
    assert np.array_equal(ratios({**memory, 'of': other}), ratios())  # of other thresholds
    assert not stage.memory.before(-1)  # the clock was set back
    assert not stage.memory.before(int(record.stamp[-1]) + 26 * 10**9)  # or there was a pause


def test_a_push_hardly_widens(learned: MethodThresholds) -> None:
    """Half a second far above the threshold: the next one would be found as well."""
    record = ringing(30, 23)
    push = np.where((record.t > 15.0) & (record.t < 15.5), 80.0, 0.0)
    stage = ExcessStage(learned, RATES)
    found = walk(stage, record, push)
    assert max(x.collision.max() for x in found) > 3.0
    assert (stage.widening < 1.3).all()


def test_speeds_beyond_those_learned_widen_at_once(learned: MethodThresholds) -> None:
    """Half as fast again: half as wide again, with the first sample that shows it."""
    stage = ExcessStage(learned, RATES)
    walk(stage, scaled(ringing(3, 24), 1.0, 1.5))
    assert stage.widening.max() == pytest.approx(1.5, rel=0.05)
    walk(stage, scaled(ringing(3, 24), 1.0, 30.0))
    assert stage.widening.max() == WIDEST


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(0.0) | st.just(math.nan), min_size=1, max_size=60))
def test_level_and_widening_stay_in_their_bounds(ratios: list[float]) -> None:
    """Whatever a sensor says, also what is no number."""
    usual = np.array([0.7])
    level, widening = usual.copy(), np.ones(1)
    for ratio in ratios:
        follow(0.01, np.array([0.5]), np.array([ratio]), usual, np.array([1.0]), level, widening)
        assert LOWEST_LEVEL * usual[0] <= level[0] <= WIDEST * usual[0]
        assert 1.0 <= widening[0] <= WIDEST


def test_the_level_is_a_quantile() -> None:
    """Four fifths of the samples stay below the level of noise."""
    ratio = np.abs(np.random.default_rng(1).standard_normal((6000, 1)))
    found = levels(
        np.full(len(ratio), 0.01), ratio, np.quantile(ratio, LEVEL_QUANTILE, axis=0))
    assert np.mean(ratio < found) == pytest.approx(0.8, abs=0.03)


def test_round_trip(learned: MethodThresholds) -> None:
    """What is known survives, what cannot be is refused."""
    content = thresholds_to_dict(learned)
    again = thresholds_from_dict(content, CHANNELS, 2)
    assert np.allclose(again.usual, learned.usual, rtol=1e-9)
    assert np.allclose(again.reach, learned.reach, rtol=1e-9)
    assert thresholds_to_dict(again) == content
    for bad in ({'usual': [1.0]}, {'usual': [1.0, -1.0]}, {'reach': [math.nan, 1.0]},
                {'reach': 'no'}, {'usual': [[1.0, 1.0]]}):
        with pytest.raises(ModelError, match='fit the model again'):
            thresholds_from_dict({**content, **bad}, CHANNELS, 2)
