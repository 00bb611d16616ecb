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

"""Thresholds learned while the robot moves: what counts, when it is enough, what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from threshold_making import CHANNELS, ringing

from tudor_dynamics.errors import FitError
from tudor_dynamics.online.streams import Motion, Residual
from tudor_dynamics.online.threshold_learning import (
    Calibration, FreeMotion, learn_thresholds, thresholds_to_dict)
from tudor_dynamics.typing import FloatArray


def collect(calibration: Calibration, record: FreeMotion, method: str = 'strain') -> int:
    """Hand over residuals one by one, until it is enough; give how many."""
    for k, (stamp, row, value) in enumerate(zip(
            record.stamp.tolist(), record.motion, record.residual, strict=True)):
        if calibration.done:
            return k
        calibration.add(method, Residual(Motion(stamp, 9.0, 0.01, row), value, value, value))
    return len(record.stamp)


def later(record: FreeMotion, seconds: float) -> FreeMotion:
    """Give the same at another time."""
    return replace(record, stamp=record.stamp + round(seconds * 1e9))


def test_it_learns_what_is_learned_of_recordings() -> None:
    """The same thresholds as from the same motion in a bag."""
    calibration, record = Calibration({'strain': CHANNELS}, 30.0), ringing(40, 1)
    n = collect(calibration, record)
    assert 3000 < n <= 3002  # steps of 10 ms, whose sum is rounded
    used = FreeMotion(record.stamp[:n], record.motion[:n], record.residual[:n])
    assert thresholds_to_dict(calibration.learn()['strain']) == thresholds_to_dict(
        learn_thresholds([used], CHANNELS))


def test_gaps_do_not_count_as_free_motion() -> None:
    """Two parts with a minute between them are two records, and no more than their sum."""
    calibration = Calibration({'strain': CHANNELS}, 30.0)
    parts = [ringing(20, 1), later(ringing(20, 2), 80.0)]
    assert collect(calibration, parts[0]) == 2000 and not calibration.done
    assert collect(calibration, parts[1]) < 1100 and calibration.done
    assert calibration.learn()['strain'].seconds == pytest.approx(30.0, abs=0.1)


def test_all_methods_have_to_have_enough() -> None:
    """It ends with the method that has waited longest for its samples."""
    calibration = Calibration({'strain': CHANNELS, 'effort': CHANNELS}, 10.0)
    collect(calibration, ringing(12, 1))
    assert not calibration.done
    collect(calibration, ringing(12, 2), 'effort')
    assert calibration.done
    assert set(calibration.learn()) == {'strain', 'effort'}


def test_friction_of_the_places_passed_is_added() -> None:
    """What may hold a joint is asked at places of the motion, and stands in the thresholds."""
    asked: list[FloatArray] = []

    def stiction(method: str, q: FloatArray) -> FloatArray:
        asked.append(q)
        return np.array([0.5, 0.0])

    calibration, record = Calibration({'effort': CHANNELS}, 20.0, stiction), ringing(25, 3)
    n = collect(calibration, record, 'effort')
    assert calibration.learn()['effort'].stiction == pytest.approx([0.5, 0.0])
    assert np.array_equal(asked[0], record.motion[:n:100, :2])


def test_a_dead_sensor_and_too_little_motion_are_refused() -> None:
    """The messages say which method, and how much there was."""
    record = ringing(20, 1)
    dead = replace(record, residual=np.column_stack(
        [record.residual[:, 0], np.zeros(len(record.residual))]))
    calibration = Calibration({'strain': CHANNELS}, 15.0)
    collect(calibration, dead)
    with pytest.raises(FitError, match='strain: the residual of .* never changes'):
        calibration.learn()
    calibration = Calibration({'strain': CHANNELS}, 15.0)
    collect(calibration, ringing(5, 1))
    with pytest.raises(FitError, match='8 s or more without contact or lost'):
        calibration.learn()
    with pytest.raises(FitError, match='no motion to learn'):
        Calibration({'strain': CHANNELS}, 15.0).learn()
