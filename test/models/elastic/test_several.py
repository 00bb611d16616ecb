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

"""Arms side by side do what each does by itself."""

from __future__ import annotations

from elastic_making import blade_arm, even, travel
import numpy as np
import pytest

from tudor_dynamics.compiled import LANES
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.models.elastic.arm import DrivenArm, follow_motions, follow_together, SAMPLE
from tudor_dynamics.typing import FloatArray

ARM = blade_arm()
RATE = 100.0
Q = travel(6.0, RATE, 3)
DT = even(len(Q), RATE)
NAMES = ('bending(j1)', 'gear(j2)', 'lumped(j1,1)', 'play(j1)', 'beta', 'payload', 'lag')


def arms(count: int) -> list[DrivenArm]:
    """Give arms of which each differs from the first in one parameter, and some lag."""
    made = [DrivenArm(ARM) for _ in range(count)]
    for arm, name in zip(made[1:], NAMES, strict=False):
        arm.set_parameters({name: 1.2 * (arm.parameters[name] or 0.02)})
    return made


def alone(measured: FloatArray | None = None, gains: FloatArray | None = None) -> list[FloatArray]:
    """Follow with one after the other."""
    found = [arm.follow(Q, DT).moment if measured is None or gains is None
             else follow_together([arm], Q, DT, [measured], gains)[0] for arm in arms(LANES)]
    return [moment for moment in found if moment is not None]


@pytest.mark.parametrize('count', [1, 3, LANES])
def test_as_each_by_itself(count: int) -> None:
    """Moments to rounding, whatever the number; they differ from one to the next."""
    together = follow_together(arms(count), Q, DT)
    for one, other in zip(alone()[:count], together, strict=True):
        assert other is not None and np.abs(one - other).max() < 1e-9
    assert len({float(np.abs(one).sum()) for one in together if one is not None}) == count


def test_drawn_towards_measured_moments() -> None:
    """With gains, each towards its own moments."""
    front = DrivenArm(ARM)
    measured = 1.1 * front.follow(Q, DT).moment
    gains = front.gains_along(Q, DT, measured, np.array([0.02, 0.02]), 2.0)
    free, drawn = alone(), alone(measured, gains)
    together = follow_together(arms(LANES), Q, DT, [measured] * LANES, gains)
    for one, other in zip(drawn, together, strict=True):
        assert other is not None and np.abs(one - other).max() < 1e-9
    assert max(np.abs(a - b).max() for a, b in zip(free, drawn, strict=True)) > 0.01


def test_who_diverges_leaves_the_others_alone() -> None:
    """An arm of impossible parameters gives nothing; the rest is as without it."""
    several = arms(4)
    several[2].set_parameters({'bending(j1)': 1e-3, 'bending(j2)': 1e-3})
    moments = follow_together(several, Q, DT)
    assert [one is None for one in moments] == [False, False, True, False]
    for k in (0, 1, 3):
        other = moments[k]
        assert other is not None and np.abs(alone()[k] - other).max() < 1e-9


def test_gains_are_those_of_the_observer() -> None:
    """Sample by sample: follow, correct, and what the covariance says then."""
    arm, deviation = DrivenArm(ARM), np.array([0.02, 0.03])
    q, dt = Q[:80], DT[:80].copy()
    dt[40] = 0.0  # begins again
    measured = 1.1 * arm.follow(q, dt).moment
    gains = arm.gains_along(q, dt, measured, deviation, 2.0)
    arm.follow(q[:1], np.zeros(1))
    arm.start_observer(deviation, 2.0)
    m = arm.size
    for k in range(len(q)):
        if dt[k] <= 0.0:
            arm.forget()
        moment = arm.follow(q[k:k + 1], dt[k:k + 1]).moment[0]
        step = float(dt[k]) or SAMPLE
        assert arm.correct(measured[k] - moment, step)
        mass, damping, stiffness = arm.small
        gain = arm._covariance[:, :m] @ arm.shown.T / (deviation**2 * (SAMPLE / step))
        bent = -np.linalg.solve(mass, stiffness @ gain[:m] + damping @ gain[m:])
        for found, expected in zip(gains[k], (gain[:m], gain[m:], bent), strict=True):
            assert np.allclose(found, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())


def test_motions_of_one_arm_as_each_by_itself() -> None:
    """From one pose, more of them than lanes; moments to rounding."""
    arm = DrivenArm(ARM)
    share = np.minimum(np.arange(len(Q)) / RATE, 1.0)
    motions = np.array([Q + 0.01 * k * share[:, None] for k in range(LANES + 2)])
    together = follow_motions(arm, motions, 1.0 / RATE)
    assert together.shape[:2] == motions.shape[:2]
    for motion, moment in zip(motions, together, strict=True):
        assert np.abs(arm.follow(motion, DT).moment - moment).max() < 1e-9
    assert np.ptp(together[:, -1], axis=0).max() > 1e-3


def test_motion_that_diverges_is_told() -> None:
    """An impossible motion is refused, with the sample."""
    motions = np.array([Q, Q])
    motions[1, 5:] = 1e9
    with pytest.raises(SimulationError, match='after 4 samples of a planned motion'):
        follow_motions(DrivenArm(ARM), motions, 1.0 / RATE)
