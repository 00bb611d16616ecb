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

"""Recordings altered by hand: units, signs, names, lags, stamps, and values of single channels."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

from faults.injected import Fault
import numpy as np

from tudor_dynamics.bags.reader import increasing, set_backs
from tudor_dynamics.bags.recording import (
    Oddities, plan_from_arm, SetBack, split_at_gaps, without_zero_velocities)
from tudor_dynamics.bags.storage import Notes
from tudor_dynamics.signals.preprocessing import retimed


def put(data, **arrays):
    """Give a bag with other arrays."""
    return replace(data, recording=replace(data.recording, **arrays))


def column(values, i, function):
    """Change one column."""
    changed = values.copy()
    changed[:, i] = function(values[:, i])
    return changed


def swapped(values, i, j):
    """Exchange two columns."""
    if values is None:
        return None
    changed = values.copy()
    changed[:, [i, j]] = values[:, [j, i]]
    return changed


def moving(recording):
    """Give the joints that move."""
    return [i for i, span in enumerate(np.ptp(recording.q, axis=0)) if span > 0.05]


def of_units_and_names(bag, rng):
    """Go through units, signs and exchanged names that fit a bag."""
    arm, data = bag.arm, bag.data
    r, names, gauges = data.recording, arm.active_joints, arm.gauge_names
    known = any(inertia.mass > 0.0 for inertia in list(arm.model.inertias)[1:])
    torques = all(joint.effort.unit != 'A' for joint in arm.joints)
    joints = moving(r)
    if r.effort is not None:
        i = int(rng.choice(joints))
        yield Fault('effort_unit', ('effort_unit',), arm,
                    (put(data, effort=column(r.effort, i, lambda x: 1e3 * x)),),
                    channels=(names[i],), size=1e3)
        yield Fault('effort_unit', ('effort_unit',), arm, (put(data, effort=1e3 * r.effort),),
                    channels=names, size=1e3)
        if torques and known:
            constants = rng.uniform(8.0, 12.0, len(names))
            yield Fault('effort_unit', ('effort_unit',), arm,
                        (put(data, effort=r.effort / constants),), channels=names,
                        size=1.0 / float(np.median(constants)), least=0.15)
        for i in rng.permutation(joints)[:2]:
            i = int(i)
            yield Fault('effort_sign', ('effort_sign', 'joint_sign'), arm,
                        (put(data, effort=column(r.effort, i, np.negative)),),
                        channels=(names[i],))
    if len(names) > 1 and (r.effort is not None or len(gauges) > 1):
        for i in rng.permutation(joints)[:2]:
            i = int(i)
            turned = column(r.q, i, np.negative)
            dq = None if r.dq is None else column(r.dq, i, np.negative)
            yield Fault('joint_sign', ('joint_sign', 'effort_sign'), arm,
                        (put(data, q=turned, dq=dq),), channels=(names[i],))
    pairs = list(combinations(joints, 2))
    for k in rng.permutation(len(pairs))[:2]:
        i, j = pairs[int(k)]
        both = names[i], names[j]
        if r.effort is not None:
            yield Fault('efforts_exchanged', ('efforts_exchanged',), arm,
                        (put(data, effort=swapped(r.effort, i, j)),), channels=both)
        yield Fault('joints_exchanged', ('joints_exchanged',), arm,
                    (put(data, q=swapped(r.q, i, j), dq=swapped(r.dq, i, j),
                         effort=swapped(r.effort, i, j)),), channels=both)
    if r.strain is not None:
        # two gauges of one link read the same but for a scale, which each gauge has to itself
        apart = [(i, j) for i, j in combinations(range(len(gauges)), 2)
                 if arm.gauges[i].joint != arm.gauges[j].joint]
        for k in rng.permutation(len(apart))[:2]:
            i, j = apart[int(k)]
            yield Fault('gauges_exchanged', ('gauges_exchanged',), arm,
                        (put(data, strain=swapped(r.strain, i, j)),),
                        channels=(gauges[i], gauges[j]))


def late(recording, values, seconds):
    """Delay an output."""
    return np.stack([np.interp(recording.t - seconds, recording.t, x) for x in values.T], axis=1)


def of_time(bag, rng):
    """Go through lags, jitter and clocks that fit a bag."""
    arm, data = bag.arm, bag.data
    r = data.recording
    for what in ('effort', 'strain'):
        values = getattr(r, what)
        if values is None or not np.ptp(values, axis=0).any():
            continue
        for seconds in (0.02, 0.05, 0.1):
            yield Fault(f'{what}_late', (f'{what}_late',), arm,
                        (put(data, **{what: late(r, values, seconds)}),), size=seconds,
                        least=0.02)  # drivers and links have lags of their own
    plan = plan_from_arm(arm)
    dq = r.dq if r.dq is not None else np.gradient(r.q, r.t, axis=0)
    yield Fault('velocity_late', ('velocity_late',), arm,
                (put(data, dq=late(r, dq, 0.06)),), size=0.06)
    zero = without_zero_velocities(replace(r, dq=np.zeros_like(r.q)), plan,
                                   Notes('', quiet=True))
    yield Fault('velocity_zeros', ('velocity_zeros',), arm, (replace(data, recording=zero),))
    # beside steps of 5 ms, stamps of 1 ms off do not say any more which sample is which
    if r.dt > 4.9e-3 and np.std(np.diff(r.stamp[r.segments[0]])) < 0.02e9 * r.dt:
        for size in (1e-3, 0.5e-3):
            late_by = np.round(rng.normal(0.0, size * 1e9, len(r.stamp))).astype(np.int64)
            stamp = np.maximum.accumulate(r.stamp + late_by)
            stamp += np.arange(len(stamp))  # increasing, also where two of them met
            again, found = retimed(replace(r, stamp=stamp))
            yield Fault('jitter', ('jitter',), arm,
                        (replace(data, recording=again, timing=found),), size=size, part=0.3)
    yield from _set_back(bag, rng)


def _set_back(bag, rng):
    r = bag.data.recording
    if len(r.segments) > 1 or r.t[-1] < 10.0:
        return
    for seconds in (0.3, 2.0):
        at = float(rng.uniform(0.3, 0.6)) * float(r.t[-1])
        stamp = r.stamp - np.where(r.t > at, round(seconds * 1e9), 0)
        keep, _, _ = increasing(stamp)
        (newest, size, lost), = set_backs(stamp)
        kept = stamp[keep]
        cut = int(np.searchsorted(kept, newest, side='right'))
        parts = tuple(piece for part in split_at_gaps(kept) for piece in (
            (slice(part.start, cut), slice(cut, part.stop))
            if part.start < cut < part.stop else (part,)))
        arrays = {name: None if getattr(r, name) is None else getattr(r, name)[keep]
                  for name in ('q', 'dq', 'effort', 'strain')}
        odd = Oddities((SetBack((newest - stamp[0]) * 1e-9, size * 1e-9, lost),))
        yield Fault('clock_set_back', ('clock_set_back',), bag.arm,
                    (put(bag.data, stamp=kept, segments=parts, oddities=odd, **arrays),),
                    time=at, seconds=0.1, size=seconds, part=0.1)


def of_channels(bag, rng):
    """Go through faults of single channels that fit a bag."""
    arm, data = bag.arm, bag.data
    r = data.recording
    joints, n = moving(r), len(r.stamp)
    i, k = int(rng.choice(joints)), int(rng.integers(n // 10, n - n // 10))
    yield Fault('outlier', ('outlier',), arm,
                (put(data, q=_at(r.q, k, i, r.q[k, i] + 5.0)),),
                channels=(arm.active_joints[i],), time=float(r.t[k]), seconds=0.05, size=5.0,
                part=0.1)
    what = 'strain' if r.strain is not None else 'effort'
    names = arm.gauge_names if what == 'strain' else arm.active_joints
    values = getattr(r, what)
    if values is None:
        return
    usable = [j for j in range(len(names)) if np.ptp(values[:, j]) > 0.0
              and (what == 'strain' or j in joints)]
    j = int(rng.choice(usable))
    yield Fault('outlier', ('outlier',), arm, (put(data, **{what: _at(values, k, j, 1e10)}),),
                channels=(names[j],), time=float(r.t[k]), seconds=0.05, size=1e10, part=0.1)
    j = int(rng.choice(usable))
    x, t = values[:, j], r.t
    low, high = np.percentile(x, [1.0, 99.0])

    def fault(kind, changed, **more):
        return Fault(kind, (kind,), arm,
                     (put(data, **{what: column(values, j, lambda _: changed)}),),
                     channels=(names[j],), **more)

    bound = low + float(rng.uniform(0.6, 0.85)) * (high - low)
    yield fault('saturated', np.minimum(x, bound), size=bound, part=0.01)
    begin, seconds = _while_moving(r, rng)
    held = (t >= begin) & (t < begin + seconds)
    yield fault('held', np.where(held, x[np.argmax(held)], x), time=begin, size=seconds)
    dead = float(rng.uniform(0.35, 0.7)) * t[-1]
    yield fault('dying', np.where(t < dead, x, x[np.searchsorted(t, dead)]), time=dead)
    noise = 0.01 * float(np.std(x)) * rng.standard_normal(n)
    fading = np.where(t < dead, x, x.mean() + (x - x.mean()) * np.exp(-(t - dead)) + noise)
    yield fault('dying', fading, time=dead, seconds=0.15 * t[-1])
    for part in (0.5, 1.0):
        rise = float(rng.choice([-1.0, 1.0])) * part * (high - low)
        yield fault('drift', x + rise * t / t[-1], size=rise, part=0.35)
    yield fault('constant', np.full(n, float(x.mean())))


def _at(values, row, i, value):
    changed = values.copy()
    changed[row, i] = value
    return changed


def _while_moving(r, rng):
    """Choose two seconds in which the arm moves."""
    width = round(2.0 / r.dt)
    spans = np.subtract(*np.percentile(r.q, [99.0, 1.0], axis=0))
    for _ in range(200):
        k = int(rng.integers(len(r.stamp) // 10, len(r.stamp) - width - len(r.stamp) // 10))
        pieces = r.q[k:k + width:max(1, width // 20)]
        if np.all(np.any(np.abs(np.diff(pieces, axis=0)) > 5e-3 * spans, axis=1)):
            break
    return float(r.t[k]), 2.0


def still_ends(bag, rng):
    """Let the arm stand still before and after its motion."""
    arm, data = bag.arm, bag.data
    r = data.recording
    if len(r.segments) > 1:
        return
    seconds = float(rng.uniform(4.0, 8.0))
    n = round(seconds / r.dt)
    steps = np.arange(1, n + 1) * round(r.dt * 1e9)
    stamp = np.concatenate([r.stamp[0] - steps[::-1], r.stamp, r.stamp[-1] + steps])

    def stretched(values):
        if values is None:
            return None
        noise = 0.01 * np.std(values, axis=0) * rng.standard_normal((2, n, values.shape[1]))
        return np.vstack([values[:1] + noise[0], values, values[-1:] + noise[1]])

    q = np.vstack([np.repeat(r.q[:1], n, axis=0), r.q, np.repeat(r.q[-1:], n, axis=0)])
    dq = None if r.dq is None else np.vstack(
        [np.zeros((n, r.dq.shape[1])), r.dq, np.zeros((n, r.dq.shape[1]))])
    yield Fault('standstill', ('standstill',), arm,
                (put(data, stamp=stamp, q=q, dq=dq, effort=stretched(r.effort),
                     strain=stretched(r.strain), segments=(slice(0, len(stamp)),)),),
                size=2.0 * seconds + standing(r), part=0.5)


def standing(recording):
    """Give the time for which the arm stands still at the ends of a recording as it is."""
    q, t = recording.q, recording.t
    near = 0.01 * np.ptp(q, axis=0)
    left = np.flatnonzero(np.any(np.abs(q - q[0]) > near, axis=1))
    back = np.flatnonzero(np.any(np.abs(q - q[-1]) > near, axis=1))
    return float(t[left[0]] + t[-1] - t[back[-1]])
