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

"""
Why a monitor alarmed: explanations of a residual that compete, and what the data flow was.

Each explanation is fitted to the residual around the event, in all channels and before any
autoregression, which mixes these: a force at a place on a link with any course; a channel with any
course; a mass at the tip from a time on; a stream that is late. They are compared by what
remains, and pay for each number that they are free to choose. What is wrong with samples is proven
the other way round: without it, the event does not come again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
import math
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray
import pinocchio as pin

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.kinematics import link_frame
from tudor_dynamics.load.live import CarriedLoad
from tudor_dynamics.load.rows import LoadRows
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.online.black_box import Heard, JOINTS, Replay
from tudor_dynamics.online.contact_levers import gauge_gain, torque_scale
from tudor_dynamics.online.detector import CollisionEvent
from tudor_dynamics.online.monitor import MonitorSettings, SOURCE, Watch
from tudor_dynamics.online.settings import (
    ALIKE, BIN, COST, ENOUGH, EVIDENCE, FITTED, LATE_STEPS, LEAD, LIKELY, LOOK, LOUD, NOISE,
    PERIODS, PLACES, PUSH_DEVIATION, QUIET, SHARED, STANDING, STAYS, UNLIKE, UNSURE, WEAK)
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True)
class Explanation:
    """What an event is taken for."""

    cause: str  # one of `REMEDIES`
    text: str  # the evidence
    remains: dict[str, float]  # by explanation: share of the residual that it leaves


REMEDIES = {
    'touch': 'look at what is there; a touch that is meant needs no alarm, such as of a gripper',
    'load': 'set the parameter payload, or payload_source to estimate',
    'samples': 'find what holds up driver or machine; tudor info names gaps and stamps',
    'clock': 'let one clock stamp all topics, or synchronise the hosts (chrony, PTP)',
    'motion': 'record such motion and fit with it, or learn thresholds from it (~/calibrate)',
    'friction': 'fit with bags in which joints stand and start',
    'sensor': 'check cable, plug and amplifier of that channel',
    'threshold': 'allow fewer false alarms (false_alarms_per_hour), or fit with more free motion',
    'unexplained': 'keep the bag; tudor evaluate --plot shows what exceeded'}
"""Causes, and what to do."""


@dataclass(frozen=True, eq=False)
class _Window:
    """The residual around an event, in bins, in units of its noise."""

    t: FloatArray  # middle of each bin since the onset, (bins,) [s]
    row: FloatArray  # motion, (bins, 3 joints)
    z: FloatArray  # residual, (bins, channels)
    scale: FloatArray  # unit of `z`, in the unit of each channel, (bins, channels)
    late: FloatArray  # by `LATE_STEPS`, what predictions change, (steps, bins, channels)
    channels: tuple[tuple[str, str], ...]  # output and name


def _window(bundle: ModelBundle, seen: Replay, event: CollisionEvent) -> _Window:
    """Put residuals of all outputs side by side, and average over bins."""
    of = {SOURCE[method]: {item.residual.motion.stamp: item for name, item in seen.excesses
                           if name == method} for method in seen.monitor.watch.methods}
    own = SOURCE[event.method]
    near = round(LOOK * 1e9)
    common = {stamp for stamp in of[own] if all(stamp in other for other in of.values())}
    inside = [abs(stamp - event.onset) < near for stamp in common]
    if sum(inside) < 0.5 * sum(abs(stamp - event.onset) < near for stamp in of[own]):
        of, common = {own: of[own]}, set(of[own])
    stamps = sorted(common)
    rows = np.array([of[own][stamp].residual.motion.row for stamp in stamps])
    value, limit, predicted = np.array([np.concatenate([
        (item.residual.value, item.threshold, item.residual.predicted)
        for item in (items[stamp] for items in of.values())], axis=1) for stamp in stamps]
    ).transpose(1, 0, 2)
    t = (np.array(stamps) - event.onset) * 1e-9
    before = value[t < -0.5] / limit[t < -0.5]
    sigma = (np.clip(np.sqrt((before**2).mean(axis=0)), *NOISE[:2]) if len(before) > 100
             else np.full(value.shape[1], NOISE[2]))
    place = np.floor((t + LEAD) / BIN).astype(int)
    bins = np.unique(place[(t > -LEAD) & (t < LOOK)])

    def mean(values: FloatArray) -> FloatArray:
        return np.array([values[place == k].mean(axis=0) for k in bins])
    scale = mean(limit) * sigma
    loud = ((mean(value) / scale)**2).sum(axis=1) > LOUD * value.shape[1]
    quiet = round(QUIET / BIN)
    bins = bins[:max(2 * quiet, int(np.flatnonzero(loud)[-1]) + quiet if loud.any() else 0)]
    scale = scale[:len(bins)]
    late = np.array([mean(np.column_stack([np.interp(t + step, t, column)
                                           for column in predicted.T]) - predicted) / scale
                     for step in LATE_STEPS])
    return _Window((bins + 0.5) * BIN - LEAD, mean(rows), mean(value) / scale, scale, late, tuple(
        (output, name) for output in of for name in bundle.arm.channels[output]))


# -- What a force at a place, and a mass at the tip, do to all channels

def _per_moment(bundle: ModelBundle, kind: str) -> dict[tuple[str, str], float]:
    """
    Give what a torque does to joints and gauges [unit per N m].

    Where no gain of a gauge is known, predictions of a resting arm tell it: the moment at a gauge
    is about the torque of its joint.
    """
    arm, models = bundle.arm, {output: kinds.get('analytical', next(iter(kinds.values())))
                               for output, kinds in bundle.models.items()}
    torque = np.nan_to_num(torque_scale(arm), nan=1.0)
    found = {('effort', name): 1.0 / scale
             for name, scale in zip(arm.active_joints, torque, strict=True)}
    rest = np.zeros((200, 3 * len(arm.active_joints)))
    rest[:, :len(torque)] = np.random.default_rng(0).uniform(-math.pi, math.pi, (200, len(torque)))
    y = {output: model.predict(rest) for output, model in models.items()}
    gains = gauge_gain(arm, bundle.models.get('strain', {}).get(kind))
    for g, gauge in enumerate(arm.gauges):
        if not math.isfinite(gains[g]) and len(y) == 2 and gauge.joint in arm.active_joints:
            j = arm.active_joints.index(gauge.joint)
            x = (y['effort'][:, j] - y['effort'][:, j].mean()) * torque[j]
            gains[g] = float(x @ y['strain'][:, g]) / max(float(x @ x), 1e-300)
        found['strain', gauge.name] = float(np.nan_to_num(gains[g], nan=1.0))
    return found


DIRECTIONS = np.array([[math.cos(a) * math.cos(b), math.sin(a) * math.cos(b), math.sin(b)]
                       for b in (0.0, math.pi / 4) for a in np.arange(8) * math.pi / 8]
                      + [[0.0, 0.0, 1.0]])
"""Of forces, in the frame of a link."""


def _touches(arm: Arm, window: _Window, gains: dict[tuple[str, str], float]) -> tuple[
        list[tuple[str, float]], FloatArray]:
    """
    Give where forces may act, joint and distance [m], and what 1 N there does to the channels.

    The latter is of shape (places, directions, bins, channels), in units of `_Window.z`.
    """
    model, plain = arm.gauge_model, arm.model
    data = model.createData()
    points = []  # with the place in the frame of the joint
    for name in arm.active_joints:
        index = plain.getJointId(name)
        end = max([plain.jointPlacements[k].translation for k in range(1, plain.njoints)
                   if plain.parents[k] == index] + [
            frame.placement.translation for frame in plain.frames
            if frame.parentJoint == index], key=np.linalg.norm, default=np.zeros(3))
        points += [(name, share * end) for share in PLACES if end.any()]
    places = [(name, float(np.linalg.norm(point))) for name, point in points]
    columns = [model.joints[model.getJointId(name)].idx_q for name in arm.active_joints]
    ids = [model.getJointId(name) for _, name in window.channels]
    inboard = {gauge.name: (gauge.joint, gauge.distance) for gauge in arm.gauges}
    feels = np.array([[
        k in model.supports[model.getJointId(name)] or (
            channel in inboard and inboard[channel] < (name, distance)
            and inboard[channel][0] == name)
        for k, (_, channel) in zip(ids, window.channels, strict=True)]
        for name, distance in places])
    factor = np.array([gains[channel] for channel in window.channels])
    out = np.zeros((len(places), len(DIRECTIONS), len(window.t), len(ids)))
    q = np.zeros(model.nq)
    for b, row in enumerate(window.row):
        q[columns] = row[:len(columns)]
        pin.computeJointJacobians(model, data, q)
        spatial = data.J[:, [model.joints[k].idx_v for k in ids]]
        for p, (name, point) in enumerate(points):
            link = data.oMi[model.getJointId(name)]
            force = DIRECTIONS @ link.rotation.T
            wrench = np.hstack([force, np.cross(link.act(point), force)])
            out[p, :, b] = -(wrench @ spatial) * feels[p] * factor / window.scale[b]
    return places, out


# -- The competition

def _left(z: FloatArray, fit: FloatArray) -> FloatArray:
    """Give what a fit leaves of each bin; no fit is better than a part of itself."""
    return np.asarray(((z - fit)**2 / (1.0 + (FITTED * fit)**2)).sum(axis=-1))


@dataclass(frozen=True)
class _Rival:
    """An explanation of the residual."""

    cause: str
    cost: float  # what remains, and the numbers that it chose
    free: int  # channels that it is free to explain at each time
    text: str
    channel: int = -1


def _rivals(bundle: ModelBundle, kind: str, window: _Window) -> list[_Rival]:
    z, arm = window.z, bundle.arm
    whole = (z**2).sum(axis=1)
    gains = _per_moment(bundle, kind)
    members = {output: np.array([name == output for name, _ in window.channels])
               for output, _ in window.channels}
    rivals = [_Rival('nothing', float(whole.sum()), 0, '')]
    places, patterns = _touches(arm, window, gains)
    course = (patterns * z).sum(axis=-1) / ((patterns**2).sum(axis=-1) + PUSH_DEVIATION**-2)
    each = np.minimum(whole, _left(z, course[..., None] * patterns) + COST
                      + (course / PUSH_DEVIATION)**2)
    total = each.sum(axis=-1) + 3.0 * COST
    force = np.where(each < whole, np.abs(course), 0.0).max(axis=-1)
    alike = total < ALIKE * total.min()  # of those, the weakest is the likeliest
    p, d = np.unravel_index(int(np.argmin(np.where(alike, force, np.inf))), total.shape)
    near = [distance for k, (joint, distance) in enumerate(places)
            if joint == places[p][0] and alike[k].any()]
    rivals.append(_Rival(
        'touch', float(total.min()), 1, f'{link_frame(arm.full_model, places[p][0])} is touched '
        f'for {(each[p, d] < whole).sum() * BIN:.2g} s, {min(near):.2f} to {max(near):.2f} m '
        f'from {places[p][0]}, with about {force[p, d]:.2g} N'))
    begins = range(int(np.searchsorted(window.t, 0.2)) + 1)
    # 1 kg at the tip, from a bin on; it may take four to come
    weight = np.hstack([LoadRows(arm, output).point(window.row) for output in members]) * [
        gains[channel] for channel in window.channels] / window.scale
    for b in begins:
        later, there = weight[b + 4:], z[b + 4:]
        mass = float((later * there).sum() / max((later**2).sum(), 1e-12))
        left = _left(z, mass * weight)
        left[:b + 4] = np.r_[whole[:b], np.minimum(whole, left)[b:b + 4]]
        rivals.append(_Rival('load', float(left.sum()) + 2.0 * COST, 0,
                             f'{mass:+.3f} kg at the tip from then on'))
    for c, (output, name) in enumerate(window.channels):
        cost = np.minimum(whole, whole - z[:, c]**2 + COST).sum() + COST
        rivals.append(_Rival('sensor', float(cost), 1,
                             f'{output} of {name}, and no other channel: no force does that', c))
    for output, own in members.items():
        if own.sum() > 1:
            cost = np.minimum(whole, (z[:, ~own]**2).sum(axis=1) + own.sum() * COST).sum() + COST
            rivals.append(_Rival('sensor', float(cost), int(own.sum()),
                                 f'all channels of {output}, each in its own way'))
    for label, own in {'joints': np.ones(len(window.channels)), **members}.items():
        for step, change in zip(LATE_STEPS, window.late, strict=True):
            left = _left(z, change * own)
            cost = UNSURE * min(whole[:b].sum() + left[b:].sum() for b in begins) + 4.0 * COST
            rivals.append(_Rival('clock', float(cost), 0, f'{label} are stamped '
                                 f'{1e3 * abs(step):.0f} ms off from then on'))
    for hertz in np.arange(PERIODS / (len(z) * BIN), 9.0, 0.2):
        phase = 2.0 * math.pi * hertz * window.t
        basis = np.column_stack([np.cos(phase), np.sin(phase), window.t * np.cos(phase),
                                 window.t * np.sin(phase)])
        fit = basis @ np.linalg.lstsq(basis, z, rcond=None)[0]
        rivals.append(_Rival('motion', float(_left(z, fit).sum())
                             + COST * (1 + 4 * z.shape[1]), 0, f'it oscillates at {hertz:.1f} Hz'))
    return rivals


# -- What is wrong with samples: without it, the event does not come again

Repair = tuple[str, str, list[Heard]]
"""A cause, its evidence, and the messages of a topic without it."""


def _repairs(arm: Arm, heard: Sequence[Heard], onset: int) -> Iterator[Repair]:
    """Give what is wrong around an event with stamps, samples, and positions, and mend each."""
    for topic in dict.fromkeys((item.output, item.topic) for item in heard):
        own = [item for item in heard if (item.output, item.topic) == topic]
        rest = [item for item in heard if (item.output, item.topic) != topic]
        stamp = np.array([item.stamp for item in own])
        offset, since = np.array([item.time for item in own]) - stamp, (stamp - onset) * 1e-9
        if len(own) < 50 or not since.min() < -2.0 or not since.max() > 0.0:
            continue
        period = float(np.median(np.diff(stamp)))
        for cause, text, mended in (*_clock(own, offset, since, period),
                                    *_flow(own, stamp, since, period),
                                    *(_leap(arm, own, since) if topic[0] == JOINTS else ())):
            yield cause, f'{topic[1]}: {text}', sorted([*rest, *mended], key=attrgetter('time'))


def _clock(own: Sequence[Heard], offset: NDArray[np.int64], since: FloatArray,
           period: float) -> Iterator[Repair]:
    """Find stamps that jump against arrival; not all of a bag that is played faster."""
    before = float(np.median(offset[since < -2.0]))
    jump = float(np.median(offset[since > -0.1])) - before
    if max(4e6, 0.75 * period) < abs(jump) < 2.0 * np.abs(np.diff(offset)).max():
        moved = ((offset - before) / jump > 0.5).tolist()
        yield 'clock', f'stamps jump by {-1e-6 * jump:.0f} ms against their arrival', [
            replace(item, stamp=item.stamp + round(jump)) if change else item
            for item, change in zip(own, moved, strict=True)]


def _flow(own: Sequence[Heard], stamp: NDArray[np.int64], since: FloatArray,
          period: float) -> Iterator[Repair]:
    """Find samples that are lost, repeated, or stamped at other times than they were taken."""
    near = np.flatnonzero((since > -2.0) & (since < 1.0)).tolist()
    if len(near) < 20:
        return
    place = np.rint((stamp[near] - stamp[near[0]]) / period)
    for k in range(len(place) - 2, -1, -1):  # what is late is stamped close to the next
        place[k] = min(place[k], place[k + 1] - 1.0)
    even = stamp[near[0]] + place * period
    values = np.array([own[k].values for k in near])
    still = np.r_[False, (np.diff(values, axis=0) == 0.0).all(axis=1)]
    looked = (since[near] > -0.8) & (since[near] < 0.2)
    wrong = {'samples are lost': np.r_[0.0, np.diff(place) - 1.0][looked].sum(),
             'samples repeat the one before': still[looked].sum(),
             'stamps are irregular': (np.abs(stamp[near] - even) > 0.2 * period)[looked].sum()}
    if max(wrong.values()) < 2 or still.sum() > 0.5 * len(still):
        return
    text = ', '.join(f'{count:.0f} {what}' for what, count in wrong.items() if count >= 2)
    good = ~still
    grid = np.arange(place[good][0], place[good][-1] + 1.0)
    from scipy.interpolate import CubicSpline  # slow to import

    mended = CubicSpline(place[good], values[good])(grid)
    arrival = np.interp(grid, place, [own[k].time for k in near])
    yield 'samples', text, [replace(item, velocity=None) for item in own[:near[0]]] + [
        Heard(int(arrival[k]), own[0].output, own[0].topic,
              round(float(stamp[near[0]] + grid[k] * period)), mended[k])
        for k in range(len(grid))] + [
            replace(item, velocity=None) for item in own[near[-1] + 1:]]


def _leap(arm: Arm, own: Sequence[Heard], since: FloatArray) -> Iterator[Repair]:
    """Find a joint whose position leaps from one sample to the next."""
    values = np.array([item.values for item in own])
    steps = np.diff(values, axis=0)
    for j, name in enumerate(arm.active_joints):
        usual = np.convolve(steps[:, j], np.ones(5) / 5.0, 'same')
        off = np.where((since[1:] > -0.8) & (since[1:] < 0.2), np.abs(steps[:, j] - usual), 0.0)
        k = int(np.argmax(off))
        if off[k] > 10.0 * np.median(np.abs(steps[:, j] - usual)) + 1e-3:
            leap = 1.25 * (steps[k, j] - usual[k])  # a fifth of it is in the mean
            shift = leap * (np.arange(values.shape[1]) == j)
            yield 'sensor', f'{name} leaps by {leap:.3g} rad or m', [*own[:k + 1], *(
                replace(item, values=item.values - shift) for item in own[k + 1:])]


# -- The verdict

def explain(
    bundle: ModelBundle, settings: MonitorSettings, heard: Sequence[Heard],
    event: CollisionEvent, load: Callable[[], CarriedLoad | None] = lambda: None,
) -> Explanation:
    """Name the cause of an event of these messages; load makes what the monitor knows of one."""
    for cause, text, mended in _repairs(bundle.arm, heard, event.onset):
        again = Replay(bundle, settings, mended, load()).events
        if all(abs(other.stamp - event.stamp) > 5e8 for other in again):
            return Explanation(cause, f'{text}; with that mended, the event does not come', {})
    efforts = 'momentum' if event.method == 'momentum' else 'effort'
    wide = replace(settings, contact=False, methods=tuple(
        name for name in (efforts, 'strain')
        if ('analytical' if name == 'momentum' else settings.kind) in bundle.models.get(
            SOURCE[name], {})))
    seen = Replay(bundle, wide, heard, load())
    if not any(abs(item.residual.motion.stamp - event.stamp) < 1e9 * QUIET
               and SOURCE[name] == SOURCE[event.method] for name, item in seen.excesses):
        return Explanation('unexplained', 'around it the bag shows too little to judge', {})
    window = _window(bundle, seen, event)
    best: dict[str, _Rival] = {}
    for rival in _rivals(bundle.beside_robot(), settings.kind, window):
        if rival.cause not in best or rival.cost < best[rival.cause].cost:
            best[rival.cause] = rival
    zero, noise = best['nothing'].cost, float(np.minimum(
        (window.z**2).sum(axis=1), len(window.channels)).sum())
    remains = {rival.cause: max(0.0, (rival.cost - noise) / max(zero - noise, 1.0))
               for rival in best.values()}
    watch = seen.monitor.watch
    unlike = max((factor for factor, _ in watch.widened.values()), default=1.0)
    first = min((rival for rival in best.values() if rival.cause != 'motion'
                 or unlike > UNLIKE), key=lambda rival: rival.cost)
    if first.cause == 'touch' and remains['load'] < STAYS and window.t[-1] > LOOK - 5 * BIN:
        first = best['load']  # it does not end, and one number says as much as its whole course
    cause, text = first.cause, first.text
    if cause == 'sensor' and first.channel >= 0 and _breaks_loose(bundle.arm, window, first):
        cause, text = 'friction', f'{text.split(",")[0]} is off as its joint starts or turns'
    elif cause == 'motion':
        text += f'; thresholds are widened {unlike:.2g} times for this motion'
    peak = max(float(np.max(item.collision)) for name, item in seen.excesses
               if -0.1 < (item.residual.motion.stamp - event.onset) * 1e-9 < 1.0)
    enough = SHARED if first.free > 1 else ENOUGH * (1.0 - first.free / len(window.channels))
    if zero - first.cost < EVIDENCE or first.cost > WEAK * zero or remains[first.cause] > enough:
        often = _often(watch, event.method, peak)
        cause = 'threshold' if often > LIKELY else 'unexplained'
        text = (f'{peak:.2f} times the threshold, and nothing on the list explains it: by chance '
                f'that comes {often:.2g} times an hour')
    return Explanation(cause, text, dict(sorted(remains.items(), key=lambda item: item[1])))


def _often(watch: Watch, method: str, ratio: float) -> float:
    """Say how many times an hour a ratio to the threshold in force is exceeded by chance."""
    stage = watch.stages[method]
    now, n = stage.thresholds.ratios(stage.rates.collision), len(stage.thresholds.channels)
    asked = np.geomspace(1e-4, 3600.0, 100)
    reached = [float(np.median(stage.thresholds.ratios(rate)[:n] / now[:n])) for rate in asked]
    return float(asked[int(np.argmin(np.abs(np.array(reached) - ratio)))])


def _breaks_loose(arm: Arm, window: _Window, rival: _Rival) -> bool:
    """Say whether a joint starts or turns as its effort begins to be off, for a moment."""
    output, name = window.channels[rival.channel]
    if output != 'effort':
        return False
    speed = window.row[:, len(arm.active_joints) + arm.active_joints.index(name)]
    z = np.abs(window.z[:, rival.channel])
    peak = int(np.argmax(z * (window.t < 0.6)))
    lately = speed[max(0, peak - round(0.4 / BIN)):peak + 1]
    soon, later = z[peak:peak + round(0.3 / BIN)], z[peak + round(1.0 / BIN):]
    return (bool(np.abs(lately).min() < STANDING or lately.min() < 0.0 < lately.max())
            and not (len(later) and bool(later.mean() > 0.4 * soon.mean())))
