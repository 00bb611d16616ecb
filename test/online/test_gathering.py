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

"""Readings on several topics: put together by stamps."""

from __future__ import annotations

from hypothesis import given, settings, strategies as st
import numpy as np

from tudor_dynamics.online.streams import Gathering

MS = 1_000_000


def test_a_single_topic_passes() -> None:
    """Nothing is kept back or changed."""
    gathering = Gathering(['a', 'b'], {'x': ['a', 'b']})
    values = np.array([1.0, 2.0])
    assert gathering.add('x', 5, values) == [(5, values)]


def test_other_stamps_are_interpolated_and_channels_keep_their_order() -> None:
    """The second topic is 3 ms late: its line is met exactly, on the stamps of the first."""
    gathering = Gathering(['b', 'c', 'a'], {'x': ['c'], 'y': ['a', 'b']})
    found = []
    for k in range(20):
        t = k * 10 * MS
        found += gathering.add('x', t, np.array([float(k)]))
        late = t + 3 * MS
        found += gathering.add('y', late, np.array([late / MS, 1000.0 - late / MS]))
    assert len(found) == 19
    for when, row in found:
        at = when / MS
        np.testing.assert_allclose(row, [1000.0 - at, at / 10.0, at], rtol=1e-12)
    assert [drops['no_neighbour'] for drops in gathering.drops] == [0, 1]


@given(st.lists(st.tuples(st.sampled_from('xyz'), st.integers(-3, 40)), max_size=60))
@settings(max_examples=60, deadline=None)
def test_any_order_gives_whole_rows_in_order(events: list[tuple[str, int]]) -> None:
    """Whatever comes in whatever order: rows are whole, finite, and ascend."""
    gathering = Gathering(['a', 'b', 'c'], {'x': ['a'], 'y': ['b'], 'z': ['c']})
    found = []
    for topic, tick in events:
        found += gathering.add(topic, tick * 10 * MS, np.array([float(tick)]))
    assert all(row.shape == (3,) and np.isfinite(row).all() for _, row in found)
    assert all(a[0] < b[0] for a, b in zip(found, found[1:]))
