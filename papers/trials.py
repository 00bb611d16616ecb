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

"""Single trials on the simulated arm: a tap, a move, a payload that is picked up."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from papers.campaign import FloatArray
from papers.tuned import DELAY, RATE
import tudor_dynamics as td

TAP, TAP_TIME = 6.0, 0.05
"""Force across the last link, and its time: small enough for the limits of the drives [N, s]."""
BAND = 10.0
"""A strain within it of its final value has settled [um/m]."""
NEAR = math.radians(0.2)
WATCHED = 4.0
"""Behind the end of a reference [s]."""
SMOOTHED = 5
"""Samples that are averaged against noise."""
NOTHING = 1e-4
"""Payload of an empty hand that will pick something up [kg]."""


def place(arm: td.Arm, shares: FloatArray) -> FloatArray:
    """Give a pose by its shares of the planned range of each joint [rad]."""
    planned = td.planned_limits(arm)
    return np.asarray(planned.lower + shares * (planned.upper - planned.lower))


def resting_at(arm: td.Arm, q: FloatArray) -> td.Arm:
    """Give the arm that begins at the pose q [rad]."""
    simulation = arm.spec.simulation.model_copy(update={
        'initial': dict(zip(arm.active_joints, q.tolist(), strict=True))})
    return replace(arm, spec=arm.spec.model_copy(update={'simulation': simulation}))


def rig_of(
    arm: td.Arm, schedule: td.Schedule | None, q: FloatArray, payload: float, told: float,
    seed: int,
) -> td.Rig:
    """Let an arm rest at a pose, its gains following a schedule."""
    rig = td.Rig(resting_at(arm, q), rate=RATE, payload=payload, delay=DELAY - 1.0 / RATE,
                 seed=seed)
    if schedule is not None:
        rig.follow(schedule, max(told, 0.0))
    rig.run(1.5)
    return rig


def tapped(
    arm: td.Arm, schedule: td.Schedule | None, q: FloatArray, payload: float, error: float,
    frequencies: tuple[float, float], seed: int,
) -> tuple[float, FloatArray]:
    """Tap the tip from both sides, and look how far the strain swings back."""
    first, second = frequencies
    across = np.array([-math.sin(q.sum()), 0.0, math.cos(q.sum())])
    seen = []
    for side in (1.0, -1.0):
        rig = rig_of(arm, schedule, q, payload, payload + side * error, seed)
        rig.process.force = side * TAP * across
        rig.run(TAP_TIME)
        rig.process.force = np.zeros(3)
        begin = len(rig.trace.t)
        rig.run(1.8 / first)
        seen.append(rig.trace.array('strain')[begin:, _gauge(rig)])
    strain = 0.5 * (seen[0] - seen[1])
    window = max(round(RATE / second), 1)  # over a period of the second mode
    smooth = np.convolve(strain, np.full(window, 1.0 / window), 'same')
    top = int(np.argmax(np.abs(smooth[:int(0.6 * RATE / first)])))
    behind = smooth[top:top + int(1.2 * RATE / first)] * np.sign(smooth[top])
    decrement = math.log(float(behind[0]) / max(float(-behind.min()), 1e-3))
    return decrement / math.hypot(math.pi, decrement), strain


def _gauge(rig: td.Rig) -> int:
    assert rig.controller is not None
    return rig.arm.gauge_names.index(rig.controller.damper.gauges[0])


@dataclass(frozen=True, eq=False)
class Moved:
    """What a move came to."""

    # Behind the end of the reference, until the strain is within 10 um/m of its final value, and
    # until the joints are within 0.2 deg of the target [s]
    settled: float
    back: float
    overshoot: float  # Largest distance of a joint from its target behind that end [deg]
    followed: bool  # Whether the arm was with its reference all the time
    t: FloatArray  # Since that end [s]; strain [um/m]; first joint less its reference [deg]
    strain: FloatArray
    error: FloatArray


def moved(
    arm: td.Arm, schedule: td.Schedule | None, ends: tuple[FloatArray, FloatArray], payload: float,
    told: float, seed: int,
) -> Moved:
    """Move from pose to pose."""
    rig = rig_of(arm, schedule, ends[0], payload, told, seed)
    assert rig.source is not None
    rig.source.go(ends[1])
    rig.step()
    assert rig.source.motion is not None
    remaining = rig.source.motion.remaining
    over = rig.t + remaining
    rig.run(remaining + WATCHED)
    t = np.array(rig.trace.t) - over
    strain = rig.trace.array('strain')[:, _gauge(rig)]
    strain = np.convolve(strain, np.full(SMOOTHED, 1.0 / SMOOTHED), 'same')
    behind = (t > 0.0) & (t < t[-1] - 2.0 * SMOOTHED / RATE)
    final = strain[behind][-round(0.5 * RATE):].mean()
    q, q_ref = rig.trace.array('q'), rig.trace.array('q_ref')
    away = np.abs(q - ends[1]).max(axis=1)

    def last(outside: FloatArray) -> float:
        times = t[behind & outside]
        return float(times[-1]) if times.size else 0.0
    return Moved(last(np.abs(strain - final) > BAND), last(away > NEAR),
                 float(np.degrees(away[behind].max())), rig.source.note == '', t, strain,
                 np.degrees(q - q_ref)[:, 0])


@dataclass(frozen=True, eq=False)
class PickedUp:
    """What picking up in motion came to."""

    swing: float  # From 4 to 5 s behind it: range of the strain [um/m] and largest command [deg/s]
    command: float
    # Whether the damper was not switched off for a swing; whether the arm was with its reference
    # all the time
    quiet: bool
    followed: bool
    t: FloatArray  # Since the payload is there [s]; strain [um/m]; payload in use [kg]
    strain: FloatArray
    payload: FloatArray


def picked_up(
    arm: td.Arm, schedule: td.Schedule, ends: tuple[FloatArray, FloatArray], payload: float,
    late: float, seed: int,
) -> PickedUp:
    """Let a payload appear at the tip in the middle of a move."""
    rig = rig_of(arm, schedule, ends[0], NOTHING, 0.0, seed)
    controller, source = rig.controller, rig.source
    assert controller is not None and source is not None and controller.adaptation is not None
    source.go(ends[1])
    rig.step()
    assert source.motion is not None
    rig.run(0.5 * source.motion.remaining)
    begin = len(rig.trace.t)
    rig.process.loop.set_payload(payload)
    used = []
    for k in range(round(5.0 * RATE)):
        if k == round(late * RATE):
            controller.adaptation.tell(rig.t, payload)
        rig.step()
        used.append(controller.adaptation.payload or 0.0)
    strain = rig.trace.array('strain')[begin:, _gauge(rig)]
    command = np.degrees(np.abs(rig.trace.array('command')[begin:]))
    end = round(4.0 * RATE)
    return PickedUp(float(np.ptp(strain[end:])), float(command[end:].max()),
                    controller.gains.excited == '', source.note == '',
                    np.arange(len(strain)) / RATE, strain, np.array(used))
