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
Figures of a page as data, and how names, numbers and units are written for its readers.

A figure is panels in rows, each with traces; `templates/report.js` says what they look like.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import json
import math
import re
from typing import Any

from jinja2.utils import htmlsafe_json_dumps
from markupsafe import Markup
import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.kinematics import gauge_point
from tudor_dynamics.identification.dataset import all_stretches, BagData
from tudor_dynamics.identification.detection import MethodResult, Roc
from tudor_dynamics.identification.fit import FitResult
from tudor_dynamics.identification.next_steps import Assessment
from tudor_dynamics.identification.ringdowns import ModeMap, Ringdown
from tudor_dynamics.identification.uses import free_motion
from tudor_dynamics.identification.validation import Trace, Validation
from tudor_dynamics.models.regressor import output_units
from tudor_dynamics.online.thresholds import held_friction, motion_features
from tudor_dynamics.typing import FloatArray


Plot = dict[str, Any]  # a figure, a panel or a trace, as plain values
LONGEST_NAME = 40  # characters of a name in a figure


def number(value: float, digits: int = 3) -> str:
    """Write a number for a reader."""
    if not math.isfinite(value):
        return 'n/a' if math.isnan(value) else ('∞' if value > 0 else '−∞')
    if value == 0.0:
        return '0'
    exponent = math.floor(math.log10(abs(float(f'{value:.{digits - 1}e}'))))
    if -4 <= exponent < 6:
        text = f'{value:.{max(0, digits - 1 - exponent)}f}'
    else:
        text = f'{value:.{digits - 1}e}'
    return text.replace('-', '−')


def pretty_unit(unit: str) -> str:
    """Write a unit as it is printed: µ, a dot between factors, raised exponents."""
    text = re.sub(r'\((\w)\)', r'\1', unit.replace('um/m', 'µm/m'))
    for plain, raised in (('^2', '²'), ('^(1/3)', '^⅓'), (' ', '·')):
        text = text.replace(plain, raised)
    return text


def pretty_name(name: str, longest: int = LONGEST_NAME) -> str:
    """Cut a name that would run out of a figure, and leave out what SVG cannot hold."""
    short = name if len(name) <= longest else name[:longest - 3] + '...'
    return ''.join(c if c.isprintable() else '?' for c in short)


def label(name: str, unit: str = '') -> str:
    """Write a channel with its unit; unit: none if empty."""
    return f'{pretty_name(name)} [{pretty_unit(unit)}]' if unit else pretty_name(name)


MAX_POINTS = 2000  # points a signal keeps at most: the extremes of each stretch of samples
SIGNAL_BINS = 60


def encoded(plot: Plot) -> Markup:
    """Write a figure as JSON for a page: each array once, in single precision as base64."""
    names: dict[int, str] = {}
    data: dict[str, str] = {}

    def name(array: FloatArray) -> str:
        own = names.setdefault(id(array), f'#{len(names)}')
        if own not in data:
            data[own] = base64.b64encode(array.astype('<f4').tobytes()).decode('ascii')
        return own
    plain = json.loads(json.dumps(plot, default=name))
    return htmlsafe_json_dumps({**plain, 'data': data})


def trace(look: str, x: Any, y: Any, name: str = '', **more: Any) -> Plot:
    """Give one trace; x and y: numbers, or texts."""
    def plain(values: Any) -> Any:
        return values if len(values) and isinstance(values[0], str) else np.asarray(values)
    return {'look': look, 'x': plain(x), 'y': plain(y), 'name': pretty_name(name), **more}


def shares(look: str, edges: FloatArray, values: FloatArray, name: str) -> Plot:
    """Give as stairs how many of some values lie between edges [%]."""
    share = 100.0 * np.histogram(values, edges)[0] / len(values)
    return trace(look, edges, np.append(share, share[-1]), name, stairs=True)


def panel(title: str, x: str, y: str, *traces: Plot, **more: Any) -> Plot:
    """Give one panel with titles of its axes."""
    return {'title': title, 'xlabel': x, 'ylabel': y, 'traces': traces, **more}


def decimated(t: FloatArray, *signals: FloatArray) -> tuple[FloatArray, ...]:
    """Keep the extremes of each signal in each stretch of samples; break the lines at gaps."""
    if len(t) > MAX_POINTS:
        size = -(-len(t) // (MAX_POINTS // 2))
        kept = [np.array([0, len(t) - 1])]
        for x in signals:
            rows = np.pad(x, (0, -len(x) % size), mode='edge').reshape(-1, size)
            first = size * np.arange(len(rows))
            kept += [first + rows.argmin(axis=1), first + rows.argmax(axis=1)]
        index = np.unique(np.minimum(np.concatenate(kept), len(t) - 1))
        t, *signals = t[index], *(x[index] for x in signals)  # type: ignore[assignment]
    if len(t) < 3:
        return t, *signals
    step = np.diff(t)
    breaks = np.flatnonzero(step > 8.0 * np.median(step)) + 1
    return tuple(np.insert(x, breaks, np.nan) for x in (t, *signals))


@dataclass(frozen=True, eq=False)
class JointPositions:
    """One joint's positions, in training and in validation."""

    name: str
    unit: str
    # (samples,): positions; `test` is empty where there is no test bag.
    training: FloatArray
    test: FloatArray


def scale(reference: FloatArray, others: Sequence[FloatArray]) -> tuple[float, float]:
    """Scale by the measured signal; a model that runs away does not squash the rest."""
    low, high = float(np.min(reference)), float(np.max(reference))
    room = 0.5 * (high - low) or 1.0
    bottom = max(min([low, *(float(np.min(x)) for x in others)]), low - room)
    top = min(max([high, *(float(np.max(x)) for x in others)]), high + room)
    pad = 0.04 * (top - bottom) or 1.0
    return bottom - pad, top + pad


def _reach(errors: Sequence[FloatArray], percentile: float) -> float:
    """Scale that shows nearly all errors, unless one model's are far larger than another's."""
    sizes = [float(np.percentile(np.abs(x), percentile)) for x in errors]
    return min(max(sizes), 4.0 * min(sizes)) or max(sizes) or 1.0


def signal_figure(
    arm: Arm, output: str, judged: Mapping[str, Validation], channel: str,
    stretch: tuple[float, float],  # to be looked at first [s]
) -> Plot:
    """Draw a channel of the first validation bag: measured against predicted, and the residual."""
    first, unit = next(iter(judged.values())), output_units(arm, output)[channel]
    i, kinds, shown = first.channels.index(channel), list(judged), first.traces[0]
    measured = shown.measured[:, i]
    predicted = [item.traces[0].predicted[:, i] for item in judged.values()]
    residuals = [measured - values for values in predicted]
    t, *drawn = decimated(shown.t, measured, *predicted, *residuals)
    bound = 1.1 * _reach(residuals, 99.8)
    return {'columns': 1, 'linked': True, 'stretch': stretch, 'panels': [
        panel('', '', label(output, unit), *(trace(name, t, x, name) for name, x in zip(
            ['measured', *kinds], drawn, strict=False)), ylim=scale(measured, predicted)),
        panel('measured − predicted', 'time [s]', label('residual', unit), *(
            trace(kind, t, x, kind) for kind, x in zip(
                kinds, drawn[1 + len(kinds):], strict=True)), height=120, ylim=(-bound, bound))]}


def error_figure(arm: Arm, output: str, judged: Mapping[str, Validation]) -> Plot:
    """Draw how the error of each channel is distributed over all validation bags."""
    units, panels = output_units(arm, output), []
    for i, name in enumerate(next(iter(judged.values())).channels):
        errors = {kind: np.concatenate([
            trace.measured[:, i] - trace.predicted[:, i] for trace in item.traces])
            for kind, item in judged.items()}
        bound = _reach([*errors.values()], 99.5)
        edges = np.linspace(-bound, bound, SIGNAL_BINS + 1)
        # what lies beyond is counted in the outermost bins, not dropped
        panels.append(panel(pretty_name(name), label('error', units[name]), '% of samples', *(
            shares(kind, edges, np.clip(values, -bound, bound), kind)
            for kind, values in errors.items())))
    return {'columns': 3, 'panels': panels}


DETAIL = 10.0  # length of the stretch shown in detail [s]
MAX_PAIRS = 3


def _speed(trace: Trace, data: Sequence[BagData]) -> FloatArray:
    """Squared speed over all joints at a trace's samples, each joint by its own spread."""
    for bag in sorted(data, key=lambda item: str(item.choice) != trace.bag):
        stamp = np.concatenate([s.stamp[s.decimation.keep] for s in bag.stretches])
        dq = np.vstack([s.states.dq[s.decimation.keep] for s in bag.stretches])
        # a part of a bag need not have been decimated to the same samples as the whole
        place = np.minimum(np.searchsorted(stamp, trace.stamp), len(stamp) - 1)
        if stamp[0] - 10**9 <= trace.stamp[0] and trace.stamp[-1] <= stamp[-1] + 10**9:
            spread = np.maximum(dq.std(axis=0), 1e-12)
            return np.sum((dq[place] / spread) ** 2, axis=1)
    return np.ones(len(trace.t))


def liveliest(trace: Trace, data: Sequence[BagData]) -> tuple[float, float]:
    """Find the stretch with the most motion [s]."""
    t = trace.t
    length = min(DETAIL, 0.5 * float(t[-1] - t[0]))
    total = np.concatenate([[0.0], np.cumsum(_speed(trace, data))])
    end = np.searchsorted(t, t + length)
    possible = t <= t[-1] - length
    best = int(np.argmax(np.where(possible, total[end] - total[:-1], -1.0)))
    return float(t[best]), float(t[best]) + length


def joint_axes(result: FitResult) -> list[JointPositions]:
    """Collect the positions of each joint at the samples used, in training and in validation."""
    training, test = _kept(result.training, 'q'), _kept(result.test, 'q')
    return [JointPositions(joint.name, result.arm.position_units[joint.name], training[:, i],
                           test[:, i] if len(test) else np.zeros(0))
            for i, joint in enumerate(result.arm.joints)]


def _kept(data: Sequence[BagData], signal: str) -> FloatArray:
    parts = [getattr(s.states, signal)[s.decimation.keep] for s in all_stretches(data)]
    return np.vstack(parts) if parts else np.zeros((0, 0))


def joint_pairs(axes: Sequence[JointPositions]) -> list[tuple[JointPositions, JointPositions]]:
    """Pair neighbours among the joints that move; their combinations matter most."""
    moving = [axis for axis in axes if np.ptp(axis.training) > 1e-3]
    return list(zip(moving, moving[1:], strict=False))[:MAX_PAIRS]


def coverage(result: FitResult) -> list[dict[str, Any]]:
    """Say where each joint has been and how fast, in training and in the test, if there is one."""
    rows = []
    for axis in joint_axes(result):
        low, high = float(axis.training.min()), float(axis.training.max())
        row: dict[str, Any] = {'joint': axis.name, 'unit': axis.unit, 'training': (low, high)}
        if len(axis.test):
            row['test'] = float(axis.test.min()), float(axis.test.max())
            row['outside'] = 100.0 * float(np.mean((axis.test < low) | (axis.test > high)))
        rows.append(row)
    for prefix, data in (('', result.training), ('test_', result.test)):
        for name, signal in (('speed', 'dq'), ('acceleration', 'ddq')):
            peaks = np.abs(_kept(data, signal)).max(axis=0, initial=0.0)
            for row, peak in zip(rows, peaks.tolist(), strict=False):
                row[prefix + name] = peak
    return rows


COVERAGE_BINS = 40
MAX_DOTS = 700  # validation samples shown as dots, evenly chosen


def _edges(axis: JointPositions) -> FloatArray:
    values = np.concatenate([axis.training, axis.test])
    low, high = float(values.min()), float(values.max())
    if high - low < 1e-9:
        low, high = low - 0.5, high + 0.5
    return np.linspace(low, high, COVERAGE_BINS + 1)


def density_figure(joints: Sequence[JointPositions]) -> Plot:
    """Draw how often each position was visited."""
    return {'columns': 3, 'panels': [
        panel('', label(joint.name, joint.unit), '% of samples', *(
            shares(look, _edges(joint), values, name) for look, name, values in (
                ('fill', 'training', joint.training), ('other', 'validation', joint.test))
            if len(values))) for joint in joints]}


def pair_figure(pairs: Sequence[tuple[JointPositions, JointPositions]]) -> Plot:
    """Draw which combinations of two joints' positions were visited."""
    panels = []
    for first, second in pairs:
        x, y = _edges(first), _edges(second)
        count = np.histogram2d(first.training, second.training, (x, y))[0]
        traces = [shades(x, y, np.where(count > 0, np.log1p(count), np.nan), 'training',
                         plain=True)]
        if len(first.test):
            chosen = np.unique(np.linspace(0, len(first.test) - 1, MAX_DOTS).astype(int))
            traces.append(trace('dots', first.test[chosen], second.test[chosen], 'validation'))
        panels.append(panel('', label(first.name, first.unit), label(second.name, second.unit),
                            *traces, height=260))
    return {'columns': max(2, len(pairs)), 'panels': panels}


def shades(x: FloatArray, y: FloatArray, values: FloatArray, name: str, **more: Any) -> Plot:
    """Give a map: x and y are edges of its cells, values (x, y), NaN where there is nothing."""
    return trace('map', x, y, name, z=values.T, **more)


# -- The elastic model: its first modes, and ring-downs

WIDE = 4.0  # ratio of largest to smallest from which a scale is one of factors

ORDINAL = ('first', 'second')
SHOWN = (('frequency', 1.0, 'frequency [Hz]'), ('damping', 100.0, 'damping ratio [%]'))
"""What a mode has, the factor that it is drawn with, and its title."""


def mode_figure(
    found: ModeMap, axes_labels: Sequence[tuple[str, str]], ringdowns: Sequence[Ringdown],
) -> Plot:
    """Draw frequency and damping ratio of the first modes over one joint or two."""
    names = [label(*names) for names in axes_labels]
    panels = []
    for what, factor, title in SHOWN:
        values = factor * getattr(found, what)
        if len(found.joints) == 1:
            middle = 0.5 * (found.edges[0][1:] + found.edges[0][:-1])
            panels.append(panel('', names[0], title, *(
                trace(look, middle, row, f'{order} mode', points=True)
                for look, order, row in zip(('analytical', 'elm'), ORDINAL, values, strict=False)),
                trace('ring', [r.q[found.joints[0]] for r in ringdowns],
                      [factor * getattr(r.measured, what) for r in ringdowns],
                      'ring-down measured'), low=0.0))
            continue
        panels += [panel(
            f'{order} mode: {title}', names[0], names[1],
            shades(found.edges[0], found.edges[1], row, ''), trace(
                'ring', [r.q[found.joints[0]] for r in ringdowns],
                [r.q[found.joints[1]] for r in ringdowns], 'ring-down measured here'), height=230)
            for order, row in zip(ORDINAL, values, strict=False)]
    return {'columns': 2, 'panels': panels}


def ringdown_figure(ringdowns: Sequence[Ringdown]) -> Plot:
    """Draw predicted against measured ring-downs."""
    panels = []
    for what, factor, title in SHOWN:
        every, traces = [factor * getattr(r.measured, what) for r in ringdowns], []
        for look, name, words in (('held', 'held', 'joints held'),
                                  ('moved', 'simulated', 'along the measured motion')):
            known = [r for r in ringdowns if getattr(r, name) is not None]
            x, y = ([factor * getattr(mode, what) for mode in modes] for modes in (
                [r.measured for r in known], [getattr(r, name) for r in known]))
            traces.append(trace(look, x, y, words))
            every += y
        ends = [min(every), max(every)]
        panels.append(panel(
            '', f'measured {title}', f'model: {title}', trace('limit', ends, ends, 'as measured'),
            *traces, height=240,
            **({'scale': 'log'} if 0.0 < WIDE * ends[0] < ends[1] else {})))
    return {'columns': 2, 'panels': panels}


# -- The arm as it stands, seen from the side and from above

def arm_figure(arm: Arm, q: FloatArray) -> Plot:
    """Draw joints, tip and gauges at a pose (active joints,) [rad or m]."""
    model, data, pose = arm.model, arm.model.createData(), np.zeros(arm.model.nq)
    pose[arm.velocity_index] = q
    pin.framesForwardKinematics(model, data, pose)
    names = ['base', *arm.active_joints]
    at = np.array([np.zeros(3), *(data.oMi[model.getJointId(name)].translation
                                  for name in arm.active_joints)])
    ends = [frame for frame in range(model.nframes) if model.frames[frame].parentJoint
            == model.njoints - 1]
    last = np.array([data.oMf[frame].translation for frame in ends])
    tip = last[np.argmax(np.linalg.norm(last - at[-1], axis=1))]
    links = np.vstack([at, tip])
    gauges = np.array([data.oMi[model.getJointId(gauge.joint)].act(gauge_point(gauge))
                       for gauge in arm.gauges if gauge.joint in names]).reshape(-1, 3)
    weight = np.asarray(model.gravity.linear)
    up = (-weight / np.linalg.norm(weight) if np.any(weight) else np.array([0.0, 0.0, 1.0]))
    level = links - np.outer(links @ up, up)
    # what is not along the weight, longest extent first
    along = np.linalg.svd(level - level.mean(axis=0))[2][0]
    along = along - (along @ up) * up
    along /= np.linalg.norm(along) or 1.0
    if np.sum((tip - at[0]) * along) < 0.0:
        along = -along
    views = {'from the side': (along, up), 'from above': (along, np.cross(up, along))}
    panels = []
    for view, (right, high) in views.items():
        if view == 'from above' and np.ptp(links @ high) < 1e-3:
            continue  # an arm in a plane that stands
        panels.append(panel(
            view, '[m]', '', trace('link', links @ right, links @ high, 'links'),
            trace('joint', at[1:] @ right, at[1:] @ high, 'joints', text=[
                pretty_name(name, 16) for name in arm.active_joints]),
            *([trace('gauge', gauges @ right, gauges @ high, 'gauges',
                     text=[pretty_name(name, 16) for name in arm.gauge_names])]
              if len(gauges) else []),
            equal=True, height=240))
    return {'columns': 2, 'half': True, 'panels': panels}


# -- Collisions: residuals against thresholds, ratios with pushes and events, and the ROC

ALLOWED = 1.0  # false alarms per hour for which thresholds are drawn
LOWEST = 0.05  # ratios below are drawn there


def threshold_figure(
    result: FitResult, assessment: Assessment, output: str, kind: str,
) -> Plot | None:
    """Draw residuals of unseen free motion between the thresholds on what lasts."""
    learned = assessment.thresholds.get((output, kind))
    live = result.causal or result
    cases = [item.unseen for item in live.fitted if (item.output, item.kind) == (output, kind)]
    if learned is None or not cases:
        return None
    records = free_motion(cases[0][:1], output, live.preprocessing)
    if not records:
        return None
    units, n = output_units(result.arm, output), len(learned.channels)
    begun = records[0].stamp[0]
    t = np.concatenate([(item.stamp - begun) * 1e-9 for item in records])
    residual = np.vstack([item.residual for item in records])
    columns = np.vstack([motion_features(item.stamp, item.motion) for item in records])
    bound = columns @ learned.profile[:n].T * learned.ratios(ALLOWED)[:n]
    if output == 'effort':
        bound = bound + held_friction(learned.stiction, columns[:, 1:1 + n])
    panels = []
    for i, name in enumerate(learned.channels):
        time, value, limit = decimated(t, residual[:, i], bound[:, i])
        panels.append(panel(
            pretty_name(name), 'time [s]', label('residual', units[name]),
            trace('limit', time, limit, 'threshold'),
            trace('limit', time, -limit, 'threshold'), trace(kind, time, value, 'residual')))
    return {'columns': 2, 'panels': panels, 'linked': True}


def event_figure(result: MethodResult, bag: int) -> Plot:
    """Draw ratios to the thresholds, pushes and events of one bag."""
    watched, sightings = result.watched[bag], result.watched[bag].sightings
    if not len(watched.stamp):
        return {'columns': 1, 'panels': []}
    origin = int(watched.heard[0])
    t, ratio = decimated(
        np.asarray((watched.stamp - origin) * 1e-9), np.maximum(watched.ratio, LOWEST))
    top = 2.0 * max(float(watched.ratio.max(initial=0.0)), 1.5)
    return {'columns': 1, 'panels': [panel(
        '', 'time [s]', 'ratio to threshold', trace('analytical', t, ratio, 'ratio'),
        trace('event', [item.time for item in sightings], [0.75 * top] * len(sightings), 'event',
              text=[f'{pretty_name(item.channel)}, {item.ratio:.1f} times' for item in sightings]),
        scale='log y', ylim=(LOWEST, top), at=1.0,
        spans=[((push.begin - origin) * 1e-9, (push.end - origin) * 1e-9, str(number))
               for number, push in enumerate(watched.truth.pushes, 1)])]}


def roc_figure(curves: Mapping[str, Roc]) -> Plot:
    """Draw pushes found against false events per hour, with intervals of 90 %."""
    traces = []
    for (method, roc), look in zip(
            curves.items(), ('analytical', 'elm', 'elastic', 'measured'), strict=False):
        low, high = roc.found_interval()
        traces += [trace(look, roc.per_hour(), roc.share(), method, stairs=True, low=low,
                         high=high),
                   trace(look, roc.per_hour()[[roc.now]], roc.share()[[roc.now]],
                         f'{method}, threshold in force', points=True,
                         across=roc.false_interval(roc.now))]
    pushes = next(iter(curves.values())).pushes
    # what matters stands left; the rest is there to be zoomed out to
    reach = 3.0 * max(10.0 * ALLOWED, *(roc.false_interval(roc.now)[1] for roc in curves.values()))
    return {'columns': 1, 'panels': [panel(
        '', 'false events per hour', f'pushes found of {pushes} [%]', *traces, height=300,
        ylim=(-2, 104), xlim=(-0.03 * reach, reach))]}
