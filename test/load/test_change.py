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

"""When a load changed, and whether it was a load."""

from __future__ import annotations

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from tudor_dynamics.load.live import LoadObserver, ramp, RecentPast
from tudor_dynamics.load.settings import BLOCK
from tudor_dynamics.typing import FloatArray

DT = 0.01


def worths(seconds: float, seed: int = 0) -> FloatArray:
    """Give what a kilogram adds to two channels of an arm that moves."""
    t = np.arange(0.0, seconds, DT)
    phase = np.random.default_rng(seed).uniform(0.0, 6.0, 2)
    return np.column_stack([200.0 + 150.0 * np.sin(2.0 * t + phase[0]),
                            120.0 * np.cos(3.0 * t + phase[1])])


def ringing(count: int) -> FloatArray:
    """Give what inertia makes of a weight that is carried up and down."""
    return np.asarray(1.0 + 0.3 * np.sin(9.0 * DT * np.arange(count)))[:, None]


def noise(count: int, seed: int = 1) -> FloatArray:
    """Give noise of the density 0.1, which is white to the highest frequency."""
    return np.random.default_rng(seed).standard_normal((count, 2)) * np.sqrt(0.1 / DT)


@settings(max_examples=25, deadline=None)
@given(mass=st.floats(-0.4, 0.4).filter(lambda m: abs(m) > 0.05), carried=st.floats(0.0, 0.4),
       block=st.integers(2, 15), seed=st.integers(0, 99))
def test_best_change(mass: float, carried: float, block: int, seed: int) -> None:
    """Sums of blocks give the instant and the mass, and what is left, as all samples would."""
    worth = worths(1.0, seed)
    x = np.array([carried, 1.5, -2.0])
    since = np.arange(len(worth)) // round(BLOCK / DT) - block
    seen = ramp(0.03, 40)
    step = np.where(since >= 0, seen[np.maximum(since, 0)], 0.0)
    left = worth * (carried + mass * step)[:, None] + x[1:]
    past = RecentPast(2, 2.0, 0.03)
    weight = worths(1.0, seed + 1)
    for sample, kilogram, still in zip(left, worth, weight, strict=True):
        past.add(DT, sample, kilogram, still)
    found = past.changed(x, 0.1)
    assert found is not None and found.since == pytest.approx((20 - block) * BLOCK)
    assert found.mass == pytest.approx(mass, rel=1e-6)
    assert found.left == pytest.approx(0.0, abs=1e-6 * found.came)
    came = (left - worth * carried - x[1:])[since >= 0]
    assert found.came == pytest.approx(DT * np.sum(came ** 2))
    assert found.gain == pytest.approx(found.came)
    pressing = (weight * step[:, None])[since >= 0]
    assert found.pressed == pytest.approx(DT * (
        np.sum(came ** 2) - np.sum(came * pressing) ** 2 / np.sum(pressing ** 2)))


def followed(
    observer: LoadObserver, left: FloatArray, worth: FloatArray, *, announced: float = -1.0,
    weight: FloatArray | None = None,
) -> tuple[list[float], list[tuple[float, float]]]:
    """Give masses, and times and sizes of what was told to be a load; links ring."""
    masses, told = [], []
    weight = worth / ringing(len(worth)) if weight is None else weight
    for k, (sample, kilogram, still) in enumerate(zip(left, worth, weight, strict=True)):
        expected = announced >= 0.0 and announced <= k * DT < announced + 3.0
        change = observer.step(DT if k else 0.0, sample, kilogram, still, held=False,
                               expected=expected)
        if change:
            told.append((k * DT, change))
        masses.append(observer.mass)
    return masses, told


@pytest.mark.parametrize('mass', [0.3, 0.1])
def test_picked_up_and_put_down(mass: float) -> None:
    """Told once each, within a second, and known to 10 g; before there is nothing."""
    worth = worths(14.0)
    t = np.arange(len(worth)) * DT
    carried = np.where((t > 5.0) & (t < 10.0), mass, 0.0)
    observer = LoadObserver(2, 0.4)
    masses, told = followed(observer, worth * carried[:, None] + noise(len(t)), worth)
    assert [round(change, 1) for _, change in told] == [mass, -mass]
    assert all(begin < time < begin + 1.0 for begin, (time, _) in zip((5.0, 10.0), told,
                                                                      strict=True))
    assert abs(masses[490]) < 0.01 > abs(masses[-1])
    assert abs(masses[610] - mass) < 0.01 and observer.std < 0.01


def test_announced() -> None:
    """It is followed as it comes, without being told of; the deviation says what is not known."""
    worth = worths(9.0)
    t = np.arange(len(worth)) * DT
    left = worth * np.where(t > 5.0, 0.25, 0.0)[:, None] + noise(len(t))
    observer = LoadObserver(2, 0.4)
    masses, told = followed(observer, left, worth, announced=4.8)
    assert not told
    assert abs(masses[495]) < 0.02 and abs(masses[560] - 0.25) < 0.02
    assert abs(masses[-1] - 0.25) < 0.01 and observer.std < 0.01
    again = LoadObserver(2, 0.4)
    followed(again, left[:500], worth[:500], announced=4.8)
    assert again.std > 0.01  # it may have come just now


def test_touched_and_recovered() -> None:
    """A moment that stays is no load: the mass waits, and goes on being learned after it."""
    worth = worths(16.0)
    t = np.arange(len(worth)) * DT
    touch = np.where((t > 5.0) & (t < 9.0), 1.0, 0.0)[:, None] * np.array([60.0, -40.0])
    observer = LoadObserver(2, 0.4)
    masses, told = followed(observer, worth * 0.2 + touch + noise(len(t)), worth)
    assert not told
    spread = np.abs(np.array(masses[480:]) - 0.2)
    assert spread.max() < 0.03 and spread[-1] < 0.01
    frozen = np.array(masses[560:900])
    assert np.all(frozen == frozen[0])
    # and a load that comes then is one
    more = worth * 0.35 + noise(len(t), 5)
    _, told = followed(observer, more, worth)
    assert observer.mass == pytest.approx(0.35, abs=0.01)


@pytest.mark.parametrize('inert', [False, True])
def test_held_downwards(inert: bool) -> None:
    """A force at the tip has the levers of a load, and no inertia: it is none, a mass is one."""
    weight = worths(9.0)
    t = np.arange(len(weight)) * DT
    worth = weight * ringing(len(t))
    came = np.where(t > 5.0, 0.25, 0.0)[:, None] * (worth if inert else weight)
    masses, told = followed(LoadObserver(2, 0.4), came + noise(len(t)), worth, weight=weight)
    assert [round(change, 2) for _, change in told] == ([0.25] if inert else [])
    assert abs(masses[-1] - (0.25 if inert else 0.0)) < 0.02


def test_still_links() -> None:
    """Where inertia shows nothing, what has come is a load when it has stayed for 3 s."""
    worth = worths(10.0)
    t = np.arange(len(worth)) * DT
    left = worth * np.where(t > 5.0, 0.25, 0.0)[:, None] + noise(len(t))
    masses, told = followed(LoadObserver(2, 0.4), left, worth, weight=worth)
    assert len(told) == 1 and 8.0 < told[0][0] < 9.0
    assert abs(masses[790]) < 0.02 and abs(masses[-1] - 0.25) < 0.01


def test_small_loads_wait() -> None:
    """What is lighter than what is told at once is taken when it stays, however it was held."""
    worth = worths(14.0)
    t = np.arange(len(worth)) * DT
    left = worth * np.where(t > 5.0, 0.03, 0.0)[:, None] + 0.2 * noise(len(t))
    observer = LoadObserver(2, 0.4)
    masses, _ = followed(observer, left, worth)
    assert masses[-1] == pytest.approx(0.03, abs=0.006)


def test_begins_anew() -> None:
    """Behind a gap no change is looked for across it; a reset knows nothing."""
    worth = worths(6.0)
    observer = LoadObserver(2, 0.4)
    followed(observer, worth * 0.2, worth)
    assert observer.mass == pytest.approx(0.2, abs=0.01)
    assert observer.step(0.0, worth[0] * 0.4, worth[0], worth[0], held=False) == 0.0
    assert observer.mass == pytest.approx(0.2, abs=0.01)
    observer.reset()
    assert observer.mass == 0.0 and observer.std == pytest.approx(0.4)
