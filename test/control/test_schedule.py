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

"""Schedules: what is written is read, what is damaged is refused; gains follow without a jump."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from schedule_making import content, point, schedule
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.control.schedule import Adaptation, load_schedule
from tudor_dynamics.control.settings import SCHEDULE_BLEND_TIME
from tudor_dynamics.errors import ScheduleError

CONFIG = Path(__file__).parent.parent.parent / 'config'


@settings(max_examples=50, deadline=None)
@given(st.floats(0.0, 0.4), st.floats(0.2, 3.0), st.floats(-1.3, 1.3))
def test_linear_values_are_interpolated_exactly(payload: float, a: float, b: float) -> None:
    """Between the nodes of a grid, linear functions are what they are."""
    found, wanted = schedule().at(payload, np.array([a, b])), point(payload, (a, b))
    np.testing.assert_allclose(found.gain, wanted.gain)
    np.testing.assert_allclose(found.load, wanted.load, atol=1e-9)
    np.testing.assert_allclose(found.inertia, wanted.inertia)
    assert found.modes[0].frequency == pytest.approx(wanted.modes[0].frequency)


def test_beyond_the_grid_its_edge_counts() -> None:
    """Nothing is extrapolated."""
    np.testing.assert_allclose(schedule().at(9.0, np.array([-5.0, 7.0])).row(),
                               point(0.4, (0.2, 1.3)).row())


def test_file_and_back(tmp_path: Path) -> None:
    """What was written is read again, for the arm that it is of."""
    path = tmp_path / 'schedule.yaml'
    schedule().save(path)
    again = load_schedule(path, load_arm(CONFIG / 'tudor.yaml'))
    np.testing.assert_allclose(again.at(0.1, np.ones(2)).row(), schedule().at(
        0.1, np.ones(2)).row(), rtol=1e-5)
    with pytest.raises(ScheduleError, match='the schedule is for .*, not '):
        load_schedule(path, load_arm(CONFIG / 'two_blade_arm.yaml'))


@pytest.mark.parametrize('more, cause', [
    ({'payload': (0.0, 0.0, 0.4)}, 'payload do not increase'),
    ({'pose': ((0.2, 1.6, 3.0),)}, '1 grid axes in pose'),
    ({'pose': ((0.2, 1.6), (-1.3, 1.3))}, 'for a grid of'),
    ({'damped': ('joint2', 'elbow')}, 'elbow'),
    ({'columns': ('gain(joint2)',)}, 'columns'),
    ({'nodes': content()['nodes'][:-1]}, 'for a grid of'),
    ({'nodes': (((-5.0,) + content()['nodes'][0][1:]), *content()['nodes'][1:])},
     r'gain\(joint2\) is -5'),
    ({'nodes': ((content()['nodes'][0][:-1]), *content()['nodes'][1:])}, 'for a grid of')])
def test_contradictions_are_refused(more: dict[str, Any], cause: str) -> None:
    """Axes, columns and nodes have to fit, and gains to be gains."""
    with pytest.raises(ScheduleError, match=cause):
        schedule(**more)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.binary(min_size=1, max_size=4))
def test_damaged_files_are_read_or_refused(tmp_path_factory: Any, at: int, data: bytes) -> None:
    """Whatever a few bytes are changed to, the answer is a schedule or one error."""
    path = tmp_path_factory.mktemp('damaged') / 'schedule.yaml'
    schedule().save(path)
    text = path.read_bytes()
    at %= len(text)
    path.write_bytes(text[:at] + data + text[at + len(data):])
    try:
        load_schedule(path).at(0.1, np.ones(2))
    except ScheduleError as err:
        assert '\n' not in str(err)


def test_no_file(tmp_path: Path) -> None:
    """The path, and what to do."""
    with pytest.raises(ScheduleError, match='nothing.yaml: .*tudor tune'):
        load_schedule(tmp_path / 'nothing.yaml')


def walk(to: Adaptation, begin: float, seconds: float, q: Any = (1.0, 0.0)) -> list[float]:
    """Let time pass at a pose; the weights on the way."""
    weights = []
    for k in range(round(seconds / 0.01)):
        to.step(begin + 0.01 * k, 0.01, np.asarray(q, dtype=float), np.zeros(2))
        weights.append(to.weight)
    return weights


def test_payload_that_was_never_told() -> None:
    """Nothing is known: nothing is scheduled."""
    to = Adaptation(schedule(), np.ones(2))
    assert to.step(0.0, 0.01, np.ones(2), np.zeros(2)) is None
    assert to.weight == 0.0 and to.payload is None and 'no load was reported' in to.unknown


def test_payload_is_told_and_gets_old() -> None:
    """Gains come within a second without a jump, and go again when nobody tells any more."""
    to = Adaptation(schedule(), np.ones(2))
    to.timeout = 2.0
    assert to.tell(0.0, 0.2) == ''
    weights = walk(to, 0.0, 1.5)
    assert max(np.diff(weights)) <= 0.01 / SCHEDULE_BLEND_TIME + 1e-9 and weights[-1] == 1.0
    weights = walk(to, 1.5, 2.0)
    assert weights[0] == 1.0 and weights[-1] == 0.0 and 'reported for 2 s' in to.unknown


def test_another_payload_is_followed() -> None:
    """The payload in use follows the one that was told; none that is impossible is taken."""
    to = Adaptation(schedule(), np.ones(2))
    to.tell(0.0, 0.0)
    walk(to, 0.0, 2.0)
    to.tell(2.0, 0.4)
    walk(to, 2.0, 0.3)
    assert 0.2 < (to.payload or 0.0) < 0.3
    assert to.mean_frequency > 0.5  # the mean lacks the weight of what was picked up
    walk(to, 2.3, 3.0)
    assert to.payload == pytest.approx(0.4, abs=1e-3)
    assert to.mean_frequency == pytest.approx(0.1, abs=0.02)
    assert 'outside the 0 to 0.4 kg' in to.tell(6.0, 2.0) and not to.known(6.0)
    assert 'outside' in to.tell(6.0, float('nan'))


def test_mean_goes_along_with_the_load() -> None:
    """Pose and acceleration change the load; the payload itself does not."""
    to = Adaptation(schedule(), np.full(2, 5.0))
    to.tell(0.0, 0.2)
    walk(to, 0.0, 2.0)
    shift = to.step(2.0, 0.01, np.array([1.1, 0.0]), np.zeros(2))
    assert shift is not None and shift[0] == pytest.approx(30.0, abs=0.1)
    total, speed = np.zeros(2), 0.0
    for k in range(30):
        speed += 0.01
        more = to.step(2.01 + 0.01 * k, 0.01, np.array([1.1, 0.0]), np.array([speed, 0.0]))
        assert more is not None
        total += more
    np.testing.assert_allclose(total, np.array([10.0, 2.0]) * 1.2, rtol=0.01)  # of 1 rad/s^2
    to.forget()
    first = to.step(3.0, 0.01, np.array([2.0, 0.0]), np.zeros(2))
    assert first is not None and not first.any()
