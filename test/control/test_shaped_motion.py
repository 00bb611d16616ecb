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

"""Shaped moves: within limits, at their targets, interrupted at any time; no swing is left."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
import math
from typing import Any

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from schedule_making import schedule
from tudor_dynamics.arm.limits import Limits
from tudor_dynamics.control.references import ReactingReference
from tudor_dynamics.control.shaped_motion import ShapedPlanner, Shaping
from tudor_dynamics.errors import SignalError, SimulationError, UsageError
from tudor_dynamics.signals.motion_profile import MotionPlanner
from tudor_dynamics.signals.shaping import impulses, PathModes, plan_shaped, Profile

LIMITS = Limits(np.full(2, -9.0), np.full(2, 9.0), np.full(2, 1.2), np.full(2, 3.5))
STEP = 2e-3


def shaping(kind: str, payload: float | None = 0.2) -> Shaping:
    """Shape by the schedule of the tests of schedules."""
    return Shaping(kind, schedule(), payload=payload)


def driven(planner: MotionPlanner, steps: int) -> np.ndarray:
    """Let a planner go on; (samples, 3, joints)."""
    found = []
    for _ in range(steps):
        planner.step(STEP)
        found.append([planner.q.copy(), planner.dq.copy(), planner.ddq.copy()])
    return np.array(found)


def swing_after(motion: np.ndarray, frequency: float, damping: float) -> float:
    """Give the swing of an oscillator that the first joint's acceleration has driven."""
    w, state = 2.0 * math.pi * frequency, np.zeros(2)
    largest = 0.0
    for k, row in enumerate(np.vstack([motion[:, 2], np.zeros((1000, 2))])):
        for _ in range(4):
            rate = -w**2 * state[0] - 2.0 * damping * w * state[1] + row[0]
            state[1] += 0.25 * STEP * rate
            state[0] += 0.25 * STEP * state[1]
        if k >= len(motion):
            largest = max(largest, abs(float(state[0])))
    return largest


@pytest.mark.parametrize('kind', ['zv', 'zvd', 'elastic'])
def test_no_swing_is_left(kind: str) -> None:
    """An oscillator of the mode is at rest after the move; it would swing without shaping."""
    start, target = np.array([0.5, 0.0]), np.array([0.9, 0.0])
    plain, shaped = MotionPlanner(LIMITS, start), ShapedPlanner(LIMITS, start, shaping(kind))
    plain.go(target)
    shaped.go(target)
    period = 1.0 / 2.8
    longer = {'zv': 0.5, 'zvd': 1.0, 'elastic': 0.5}[kind] * period
    assert shaped.remaining == pytest.approx(plain.remaining + longer, abs=2e-3)
    length = math.ceil((plain.remaining + longer) / STEP) + 2
    left = [swing_after(driven(planner, length), 2.8, 0.01) for planner in (plain, shaped)]
    assert left[1] < 0.04 * left[0]
    np.testing.assert_array_equal(shaped.q, target)
    assert not shaped.dq.any() and shaped.remaining == 0.0


@settings(max_examples=25, deadline=None)
@given(st.sampled_from(['zv', 'zvd', 'elastic']), st.floats(0.3, 2.9), st.floats(-1.2, 1.2),
       st.floats(0.3, 2.9), st.floats(-1.2, 1.2), st.floats(0.0, 0.4))
def test_limits_hold(kind: str, a: float, b: float, c: float, d: float, payload: float) -> None:
    """Position, speed and acceleration of any shaped move are those of plain ones."""
    start, target = np.array([a, b]), np.array([c, d])
    planner = ShapedPlanner(LIMITS, start, shaping(kind, payload))
    planner.go(target)
    motion = driven(planner, math.ceil(planner.remaining / STEP) + 3)
    low, high = np.minimum(start, target), np.maximum(start, target)
    assert np.all(motion[:, 0] >= low - 1e-6) and np.all(motion[:, 0] <= high + 1e-6)
    assert np.all(np.abs(motion[:, 1]) <= LIMITS.velocity * (1.0 + 1e-3))
    assert np.all(np.abs(motion[:, 2]) <= LIMITS.acceleration * (1.0 + 1e-3))
    np.testing.assert_allclose(planner.q, target, atol=1e-9)
    # positions are what the speeds add up to
    moved = np.cumsum(motion[:, 1], axis=0) * STEP
    np.testing.assert_allclose(moved[-1], target - start, atol=4e-3)


@settings(max_examples=25, deadline=None)
@given(st.sampled_from(['zv', 'elastic']), st.floats(0.02, 0.98),
       st.sampled_from(['go', 'nan', 'brake']), st.floats(0.4, 2.8))
def test_interrupted_anywhere(kind: str, share: float, what: str, other: float) -> None:
    """A new target, one of a joint alone, or a stop: no jump of speed, and rest in the end."""
    planner = ShapedPlanner(LIMITS, np.array([0.5, 0.3]), shaping(kind))
    target = np.array([1.4, -0.4])
    planner.go(target)
    driven(planner, int(share * planner.remaining / STEP))
    before, q = planner.dq.copy(), planner.q.copy()
    if what == 'brake':
        planner.brake()
        # at once: no longer than a pulse of the planned acceleration takes
        assert planner.remaining <= 2.0 * 1.2 / 3.5 + 0.01
    else:
        planner.go(np.array([other, np.nan if what == 'nan' else 0.0]))
    motion = driven(planner, math.ceil(planner.remaining / STEP) + 3)
    steps = np.abs(np.diff(np.vstack([before, motion[:, 1]]), axis=0))
    assert steps.max() <= 1.05 * 3.5 * STEP
    assert np.abs(motion[0, 0] - q).max() <= 1.3 * STEP
    assert planner.remaining == 0.0
    if what != 'brake':
        assert planner.q[0] == pytest.approx(other)
        assert planner.q[1] == pytest.approx(-0.4 if what == 'nan' else 0.0)


def test_payload_unknown() -> None:
    """Then it moves as without shaping, and says so."""
    for kind in ('zv', 'elastic'):
        how = shaping(kind, None)
        planner = ShapedPlanner(LIMITS, np.zeros(2), how)
        plain = MotionPlanner(LIMITS, np.zeros(2))
        planner.go(np.ones(2))
        plain.go(np.ones(2))
        assert planner.remaining == plain.remaining and 'payload' in how.note


def test_collision_brakes_at_once() -> None:
    """The retreat from a shaped move begins as from any other."""
    motion = ReactingReference(LIMITS, np.zeros(2), 'hold', shaping=shaping('elastic'))
    motion.go(np.array([1.5, 0.5]))
    for _ in range(300):
        motion.step(STEP)
    motion.collide()
    for _ in range(math.ceil(0.7 / STEP)):
        motion.step(STEP)
    assert not motion.dq.any()


def test_impulses() -> None:
    """Known values: without damping halves, or quarters; Singer and Seering's K with it."""
    np.testing.assert_allclose(impulses('zv', 2.0, 0.0).weight, [0.5, 0.5])
    np.testing.assert_allclose(impulses('zv', 2.0, 0.0).time, [0.0, 0.25])
    np.testing.assert_allclose(impulses('zvd', 2.0, 0.0).weight, [0.25, 0.5, 0.25])
    k = math.exp(-0.1 * math.pi / math.sqrt(0.99))
    np.testing.assert_allclose(impulses('zv', 2.0, 0.1).weight, [1 / (1 + k), k / (1 + k)])
    with pytest.raises(SignalError, match='above 0'):
        impulses('zv', 0.0, 0.0)


def test_modes_that_change_on_the_way() -> None:
    """The frequency falls by a third along the move: an oscillator with it is at rest after it."""
    def omega(q: np.ndarray) -> np.ndarray:
        return 2.0 * math.pi * (3.0 - 1.0 * q)

    def along(path: np.ndarray) -> PathModes:
        n = len(path)
        return PathModes(omega(path[:, :1]), np.full((n, 1), 0.01), np.ones((n, 1, 1)), np.ones(1))
    limits = Limits(*(np.array([x]) for x in (-9.0, 9.0, 1.2, 3.5)))

    def left(motion: np.ndarray) -> float:
        state, largest, fine = np.zeros(2), 0.0, 8
        for k in range(len(motion) + 400):
            row = motion[min(k, len(motion) - 1)]
            w = float(omega(row[0])[0])
            for _ in range(fine):
                state[1] += STEP / fine * (
                    -w**2 * state[0] - 0.02 * w * state[1]
                    + (row[2, 0] if k < len(motion) else 0.0))
                state[0] += STEP / fine * state[1]
            if k >= len(motion):
                largest = max(largest, abs(float(state[0])))
        return largest
    profile = plan_shaped(np.zeros(1), np.ones(1), limits, along)
    shaped = np.array([profile.at(STEP * k) for k in range(math.ceil(profile.duration / STEP))])
    plain = MotionPlanner(limits, np.zeros(1))
    plain.go(np.ones(1))
    assert left(shaped) < 0.1 * left(driven(plain, math.ceil(plain.remaining / STEP)))


def test_what_contradicts_itself() -> None:
    """Each says what to set."""
    for values in ({'kind': 'elastic'}, {'kind': 'zv'}, {'kind': 'other'}):
        with pytest.raises(UsageError):
            Shaping(**values)


class Later(Executor):
    """Does what it is given when it is told to."""

    def __init__(self) -> None:
        self.open: list[tuple[Future[Any], Callable[[], Any]]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Keep it."""
        future: Future[Any] = Future()
        self.open.append((future, lambda: fn(*args, **kwargs)))
        return future

    def work(self) -> int:
        """Do what nobody has cancelled; give how many."""
        done = 0
        for future, call in self.open:
            if future.set_running_or_notify_cancel():
                future.set_result(call())
                done += 1
        self.open.clear()
        return done


def test_planned_beside() -> None:
    """The joints rest until the move is planned, then do the same as without waiting."""
    later, start, target = Later(), np.array([0.5, 0.3]), np.array([1.4, -0.4])
    how = shaping('elastic')
    how.beside = later
    planner, other = (ShapedPlanner(LIMITS, start, each) for each in (how, shaping('elastic')))
    planner.go(target)
    other.go(target)
    waited = driven(planner, 40)
    assert np.all(waited[:, 0] == start) and not waited[:, 1:].any() and planner.remaining > 0.0
    assert later.work() == 1
    steps = math.ceil(other.remaining / STEP) + 2
    np.testing.assert_array_equal(driven(planner, steps), driven(other, steps))
    assert planner.remaining == 0.0


def test_other_wishes_while_it_is_planned() -> None:
    """A new target, of one joint alone too, takes its place; a stop ends it."""
    later, start = Later(), np.array([0.5, 0.3])
    how = shaping('elastic')
    how.beside = later
    planner = ShapedPlanner(LIMITS, start, how)
    planner.go(np.array([1.4, -0.4]))
    planner.go(np.array([1.0, np.nan]))
    assert later.work() == 1 and how.note == ''
    driven(planner, 1500)
    np.testing.assert_allclose(planner.q, [1.0, -0.4])
    planner.go(start)
    planner.brake()
    assert later.work() == 0
    driven(planner, 50)
    np.testing.assert_allclose(planner.q, [1.0, -0.4])
    planner.go(start)
    how.payload = None  # forgotten before it was planned: it moves as without shaping
    assert later.work() == 1 and 'payload' in how.note
    driven(planner, 1500)
    np.testing.assert_allclose(planner.q, start)


def test_moves_are_refined() -> None:
    """By what is given, with payload and period of the target; an error leaves the first move."""
    seen: list[tuple[float, float]] = []

    def better(profile: Profile, limits: Limits, payload: float, period: float) -> Profile:
        seen.append((payload, period))
        if len(seen) > 1:
            raise SimulationError('it diverges')
        return Profile(0.5 * profile.step, profile.q, 2.0 * profile.dq, 4.0 * profile.ddq)
    start, target = np.array([0.5, 0.0]), np.array([0.9, 0.0])
    how = shaping('elastic')
    how.refine = better
    plain = shaping('elastic').profile(start, target, LIMITS)
    first, second = (how.profile(start, target, LIMITS) for _ in range(2))
    assert plain is not None and first is not None and second is not None
    assert first.duration == pytest.approx(0.5 * plain.duration)
    np.testing.assert_array_equal(second.ddq, plain.ddq)
    assert 'it diverges' in how.note
    assert seen[0] == pytest.approx((0.2, 1.0 / 2.8))
