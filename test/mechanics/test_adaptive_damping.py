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

"""Damping by a schedule on the arm with all its imperfections, in lock-step."""

from __future__ import annotations

from functools import lru_cache

from motion_machine import broken_limits, go, tudor
import numpy as np
from tudor_dynamics.control.motion_controller import State
from tudor_dynamics.control.schedule import Adaptation, Schedule
from tudor_dynamics.mechanics import chain as at
from tudor_dynamics.mechanics.rig import Rig
from tudor_dynamics.models.tuning import design, TunedArm, Wish

TARGETS = np.radians([50.0, -30.0]), np.radians([140.0, 40.0])
ASKED = 0.65


@lru_cache
def schedule() -> Schedule:
    """Tune the reference arm as it was described."""
    return design(TunedArm(tudor()), Wish(ASKED, 0.005, (0.0, 0.4)))


def adaptive(payload: float | None, told: float | None, **more: float) -> Rig:
    """Let an arm with a payload stand at the first target, gains following what was told."""
    rig = Rig(tudor(), payload=payload, rate=250.0, **more)
    rig.process.loop.reset(TARGETS[0])
    controller = rig.controller
    controller.adaptation = Adaptation(schedule(), controller.planned.acceleration)
    if told is not None:
        controller.adaptation.tell(0.0, told)
    rig.run(2.0)
    return rig


def move(rig: Rig) -> tuple[float, float]:
    """Go to the second target; time to settle within 10 um/m [s], overshoot [deg]."""
    go(rig, TARGETS[1])
    rig.step()
    ends = rig.t + rig.source.motion.remaining
    rig.run(rig.source.motion.remaining + 4.0)
    t, strain = np.array(rig.trace.t), rig.trace.array('strain')[:, 0]
    strain = np.convolve(strain - strain[-250:].mean(), np.full(3, 1.0 / 3.0), 'same')
    behind = (t > ends) & (t < t[-1] - 0.02)
    away = t[behind & (np.abs(strain) > 10.0)]
    over = np.degrees((rig.trace.array('q')[behind] - TARGETS[1]).max())
    return (float(away[-1]) - ends if away.size else 0.0), float(over)


def test_settles_twice_as_fast_as_with_fixed_gains() -> None:
    """With 400 g, and with a third of the overshoot."""
    fixed, adapted = move(adaptive(0.4, None)), move(adaptive(0.4, 0.4))
    assert adapted[0] < 0.5 * fixed[0]
    assert adapted[1] < 0.3 * fixed[1]


def test_picked_up_in_motion() -> None:
    """400 g more from one sample to the next, told 0.8 s later: no limit cycle, within limits."""
    rig = adaptive(1e-4, 0.0, delay=0.01)
    go(rig, TARGETS[1])
    rig.run(0.7)
    rig.process.loop.plant.mechanism.body_float[-1, at.MASS] = 0.4
    rig.run(0.8)
    rig.controller.adaptation.tell(rig.t, 0.4)
    rig.run(4.0)
    begin = len(rig.trace.t)
    rig.run(1.0)
    assert np.ptp(rig.trace.array('strain')[begin:, 0]) < 30.0  # noise and play
    assert np.degrees(np.abs(rig.trace.array('command')[begin:])).max() < 2.0
    assert rig.controller.state is State.FOLLOWING and rig.controller.gains.excited == ''
    assert not broken_limits(rig)


def test_wrong_payload_does_no_harm() -> None:
    """400 g are told where there is nothing: it damps otherwise, and comes to rest."""
    rig = adaptive(0.0, 0.4)
    settled, _ = move(rig)
    assert settled < 3.0 and not broken_limits(rig)
    assert rig.controller.gains.excited == ''


def test_telling_is_smooth() -> None:
    """At rest, gains that come and go move nothing."""
    rig = adaptive(0.4, None)
    begin = len(rig.trace.t)
    rig.controller.adaptation.timeout = 2.0
    rig.controller.adaptation.tell(rig.t, 0.4)
    rig.run(4.0)
    assert rig.controller.adaptation.weight == 0.0
    assert np.degrees(np.ptp(rig.trace.array('q')[begin:], axis=0)).max() < 0.3


def test_delay_takes_of_scheduled_gains_what_they_do_not_bear() -> None:
    """A loop of 40 ms: quiet 5 s after a move, with a part of the gains."""
    rig = adaptive(0.4, 0.4, delay=0.04)
    move(rig)
    begin = len(rig.trace.t)
    rig.run(1.0)
    assert np.degrees(np.abs(rig.trace.array('command')[begin:])).max() < 1.0
    assert rig.controller.gains.allowed_share < 0.5
