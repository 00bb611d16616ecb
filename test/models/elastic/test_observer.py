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

"""The observer of a driven arm: ringing that no motion explains, and its numerics."""

from __future__ import annotations

from elastic_making import blade_arm, even, pushed, stepwise
import numpy as np
import pytest

from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.typing import FloatArray

RATE, SECONDS = 100.0, 6.0
DEVIATION = np.array([0.02, 0.02])
"""Of the measured moments [N m]."""
TIME = np.arange(round(SECONDS * RATE)) / RATE


def still(*q: float) -> FloatArray:
    """Stay at a position."""
    return np.tile(np.array(q), (len(TIME), 1))


def observe(
    driven: DrivenArm, q: FloatArray, measured: FloatArray, rate: float = RATE,
) -> FloatArray:
    """Run the observer along; gives the innovations [N m]."""
    dt = even(len(q), rate)
    left = []
    for k in range(len(q)):
        moment = driven.follow(q[k:k + 1], dt[k:k + 1]).moment[0]
        left.append(measured[k] - moment)
        assert k == 0 or driven.correct(left[-1], 1.0 / rate)
    return np.array(left)


def kick() -> FloatArray:
    """Push the tip for a tenth of a second, at 1 s [N]."""
    force = np.zeros((len(TIME), 3))
    during = (TIME >= 1.0) & (TIME < 1.1)
    force[during, 1] = 15.0 * np.sin(np.pi * (TIME[during] - 1.0) / 0.1)
    return force


@pytest.mark.parametrize('lag', [0.0, 0.02, 0.05])
def test_ringing_from_a_push_is_taken_over(lag: float) -> None:
    """
    Unknown to the model, a push rings on in the residual; with the observer for a second.

    Gauges that lag show the push later, and are corrected as well.
    """
    arm = blade_arm()
    q = still(0.4, 0.3)
    measured = pushed(arm, q, RATE, kick(), {'lag': lag})
    alone = measured - DrivenArm(arm).follow(q, even(len(q), RATE)).moment
    driven = DrivenArm(arm)
    driven.set_parameters({'lag': lag})
    driven.start_observer(DEVIATION, 8.0)
    left = observe(driven, q, measured)
    hit, later = (TIME >= 1.0) & (TIME < 1.3), (TIME >= 2.1) & (TIME < 3.1)
    size = np.abs(alone[hit]).max(axis=0)
    assert (size > 0.2).all()
    assert (np.abs(alone[later]).max(axis=0) > 0.3 * size)[0]
    assert (np.abs(left[later]).max(axis=0) < 0.05 * size).all()
    assert (np.abs(left[hit]).max(axis=0) > 0.3 * size).all()  # the push itself still shows
    assert np.abs(left[TIME < 1.0]).max() < 1e-9


@pytest.mark.parametrize('rate', [100.0, 1000.0])
def test_covariance_stays_one(rate: float) -> None:
    """Symmetric, no negative variance, and settled, after a thousand corrections in motion."""
    arm = blade_arm()
    t = np.arange(1001) / rate
    q = stepwise(t, np.array([[0.4, 0.2], [1.4, -0.7]]), ramp=0.6)
    truth = DrivenArm(arm).follow(q, even(len(q), rate)).moment
    driven = DrivenArm(arm)
    driven.start_observer(DEVIATION, 8.0)
    observe(driven, q, truth + np.random.default_rng(0).normal(0.0, 0.02, truth.shape), rate)
    found = driven._covariance
    scale = np.sqrt(np.diag(found))
    # a force out of the plane shows at no gauge: its variance grows, and nothing depends on it
    seen = np.arange(len(found)) != len(found) - 1
    whitened = (found / np.outer(scale, scale))[np.ix_(seen, seen)]
    assert np.abs(whitened - whitened.T).max() < 1e-9
    assert np.linalg.eigvalsh(whitened).min() > -1e-9
    assert np.isfinite(found).all() and (np.diag(found) > 0.0).all()


def test_a_gauge_that_does_not_count() -> None:
    """One gauge at NaN is as good as one that says nothing; all of them, no correction at all."""
    arm = blade_arm()
    q = still(0.4, 0.3)
    measured = pushed(arm, q, RATE, kick())
    deaf = DrivenArm(arm)
    deaf.start_observer(DEVIATION * [1.0, 1e9], 8.0)
    blind = DrivenArm(arm)
    blind.start_observer(DEVIATION, 8.0)
    blind._noise = deaf._noise  # which the deviations set
    half = measured.copy()
    half[:, 1] = np.nan
    one, other = observe(deaf, q, measured), observe(blind, q, half)
    assert np.abs(one[:, 0] - other[:, 0]).max() < 1e-6
    assert np.isnan(other[:, 1]).all()
    none = DrivenArm(arm)
    none.start_observer(DEVIATION, 8.0)
    dt = even(len(q), RATE)
    for k in range(50):
        moment = none.follow(q[k:k + 1], dt[k:k + 1]).moment[0]
        none.correct(np.full(2, np.nan), 1.0 / RATE)
    alone = DrivenArm(arm).follow(q[:50], dt[:50]).moment
    assert np.array_equal(moment, alone[-1])


def test_to_forget_is_to_begin_anew() -> None:
    """Forgotten and at rest, the observer gives what it gave at first."""
    arm = blade_arm()
    q = still(0.4, 0.3)[:200]
    measured = pushed(arm, q, RATE, kick()[:200])
    driven = DrivenArm(arm)
    driven.start_observer(DEVIATION, 8.0)
    first = observe(driven, q, measured)
    driven.forget()
    again = observe(driven, q, measured)
    assert np.array_equal(first, again)
