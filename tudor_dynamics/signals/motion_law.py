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

"""Planning and following of sin^2 motions of one joint, compiled."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled

# Columns of the plan of one joint: where it began, then segments.
TARGET, CLOCK, Q = range(3)
FIRST = 3  # duration, speed at the start, acceleration, kind of each segment
SEGMENTS = 5
PLAN = FIRST + 4 * SEGMENTS

PULSE, FADE = 0.0, 1.0
JERK = 20.0  # 1/s, times the acceleration limit: only pulses shorter than 0.16 s get smaller


@compiled
def _segment(kind: float, a: float, v: float, length: float, t: float) -> tuple[
        float, float, float]:
    """Give distance, speed and acceleration inside a segment."""
    if length <= 0.0:
        return 0.0, v, 0.0
    if kind == PULSE:
        w = 2.0 * math.pi / length
        return (v * t + 0.25 * a * t * t + 0.5 * a / (w * w) * (math.cos(w * t) - 1.0),
                v + 0.5 * a * (t - math.sin(w * t) / w), 0.5 * a * (1.0 - math.cos(w * t)))
    w = math.pi / length
    return (v * t + 0.25 * a * t * t + 0.5 * a / (w * w) * (1.0 - math.cos(w * t)),
            v + 0.5 * a * (t + math.sin(w * t) / w), 0.5 * a * (1.0 + math.cos(w * t)))


@compiled
def _pulse_time(change: float, a_max: float) -> float:
    """Give the duration of the pulse for a change of speed, within acceleration and jerk."""
    return max(2.0 * change / a_max, math.sqrt(2.0 * math.pi * change / (JERK * a_max)))


@compiled
def stopping_distance(speed: float, a_max: float) -> float:
    """Give the way [rad] on which one pulse takes a speed [rad/s] to rest."""
    return 0.5 * speed * _pulse_time(abs(speed), a_max)


@compiled
def _two_pulses(v: float, peak: float, a_max: float) -> float:
    """Give the distance of the pulses v -> peak -> 0."""
    return 0.5 * ((v + peak) * _pulse_time(peak - v, a_max) + peak * _pulse_time(peak, a_max))


@compiled
def _approach(plan: NDArray, at: int, distance: float, speed: float, v_max: float, a_max: float,
              ) -> None:
    """Fill the four segments from ``at`` on: from a speed without acceleration to rest."""
    # In the direction in which the arm still has to go once it has braked.
    braking = _pulse_time(abs(speed), a_max)
    stop = stopping_distance(speed, a_max)
    sign = 1.0 if distance >= stop else -1.0
    d, v = sign * distance, sign * speed
    k = FIRST + 4 * at
    plan[k] = 0.0
    if v < 0.0:
        # It brakes at once and turns only then: one pulse through both would stop later.
        plan[k], plan[k + 1], plan[k + 2], plan[k + 3] = (
            braking, speed, -2.0 * speed / braking, PULSE)
        d, v = sign * (distance - stop), 0.0
    # Two pulses, v -> peak -> 0; the distance grows with the peak.
    low, high = v, max(v_max, v)
    cruise = 0.0
    if _two_pulses(v, high, a_max) <= d:
        low = high
        cruise = (d - _two_pulses(v, high, a_max)) / high
    for _ in range(60):
        peak = 0.5 * (low + high)
        if _two_pulses(v, peak, a_max) < d:
            low = peak
        else:
            high = peak
    peak = 0.5 * (low + high)
    up, down = _pulse_time(peak - v, a_max), _pulse_time(peak, a_max)
    rows = ((up, v, 2.0 * (peak - v) / max(up, 1e-12)), (cruise, peak, 0.0),
            (down, peak, -2.0 * peak / max(down, 1e-12)))
    for i in range(3):
        k += 4
        plan[k], plan[k + 1], plan[k + 2] = rows[i][0], sign * rows[i][1], sign * rows[i][2]
        plan[k + 3] = PULSE


@compiled
def _lasts(plan: NDArray) -> float:
    """Give the time to the end of a plan."""
    total = -plan[CLOCK]
    for i in range(SEGMENTS):
        total += plan[FIRST + 4 * i]
    return total


@compiled
def plan_motion(plan: NDArray, q: float, dq: float, ddq: float, target: float, v_max: float,
                a_max: float) -> None:
    """
    Plan from the present state of motion to rest at a target.

    The acceleration either fades out first, with the jerk of the present pulse, or the pulse goes
    on to its end, whatever leads to the target sooner. An arm that brakes and has to turn back
    goes on to brake: it stops no later than it was to before.

    q, dq, ddq [rad, rad/s, rad/s^2], target [rad], v_max, a_max [rad/s, rad/s^2]; writes plan
    (PLAN,).
    """
    inside, begun, length, first, push, kind = False, plan[CLOCK], 0.0, 0.0, 0.0, PULSE
    for i in range(SEGMENTS):
        k = FIRST + 4 * i
        if begun < plan[k]:
            inside = True
            length, first, push, kind = plan[k], plan[k + 1], plan[k + 2], plan[k + 3]
            break
        begun -= plan[k]
    fade = 0.0
    if ddq != 0.0:
        fade = math.pi * 0.25 * v_max / a_max * min(abs(ddq) / a_max, 1.0)
        if inside and push != 0.0:
            fade = (0.5 if kind == PULSE else 1.0) * length * abs(ddq / push)
        if ddq * dq > 0.0 and abs(ddq) * fade > 2.0 * (v_max - abs(dq)):
            fade = 2.0 * max(v_max - abs(dq), 0.0) / abs(ddq)
        fade = max(fade, 1e-9)
    for i in range(PLAN):
        plan[i] = 0.0
    plan[TARGET], plan[Q] = target, q
    plan[FIRST], plan[FIRST + 1], plan[FIRST + 2], plan[FIRST + 3] = fade, dq, ddq, FADE
    moved, speed, _ = _segment(FADE, ddq, dq, fade, fade)
    _approach(plan, 1, target - q - moved, speed, v_max, a_max)
    if not inside or push == 0.0:
        return
    soonest = _lasts(plan)
    kept = plan.copy()
    moved, _, _ = _segment(kind, push, first, length, begun)
    whole, speed, _ = _segment(kind, push, first, length, length)
    plan[CLOCK], plan[Q] = begun, q - moved
    plan[FIRST], plan[FIRST + 1], plan[FIRST + 2], plan[FIRST + 3] = length, first, push, kind
    _approach(plan, 1, target - q + moved - whole, speed, v_max, a_max)
    turns = push * dq < 0.0 and (target - q + moved - whole) * dq <= 0.0
    if _lasts(plan) > soonest and not turns:
        for i in range(PLAN):
            plan[i] = kept[i]


@compiled
def follow_plan(plan: NDArray, dt: float) -> tuple[float, float, float]:
    """Advance a plan by a step [s] and give position, velocity and acceleration."""
    plan[CLOCK] += dt
    t, q = plan[CLOCK], plan[Q]
    for i in range(SEGMENTS):
        k = FIRST + 4 * i
        length = plan[k]
        inside = min(t, length)
        moved, speed, push = _segment(plan[k + 3], plan[k + 2], plan[k + 1], length, inside)
        q += moved
        t -= length
        if t < 0.0:
            return q, speed, push
    return plan[TARGET], 0.0, 0.0


@compiled
def follow_all(
    switches: NDArray, targets: NDArray, v_max: NDArray, a_max: NDArray, dt: float,
    q: NDArray, dq: NDArray, ddq: NDArray,
) -> None:
    """Fill the reference from its first row on; each joint follows its own targets."""
    plan = np.zeros(PLAN)
    for j in range(q.shape[1]):
        plan_motion(plan, q[0, j], 0.0, 0.0, q[0, j], v_max[j], a_max[j])
        due = 0
        for k in range(q.shape[0]):
            if k > 0:
                q[k, j], dq[k, j], ddq[k, j] = follow_plan(plan, dt)
            while due < switches.shape[1] and switches[j, due] <= k * dt + 1e-12:
                if targets[j, due] != plan[TARGET]:
                    plan_motion(plan, q[k, j], dq[k, j], ddq[k, j], targets[j, due], v_max[j],
                                a_max[j])
                due += 1
