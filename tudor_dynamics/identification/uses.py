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

"""What a fit may be used for: thresholds from free motion, physical plausibility, verdicts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
import math
from typing import Any

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import GaugeSpec, PreprocessingSpec
from tudor_dynamics.control.damper import STRAIN_SCALE
from tudor_dynamics.errors import FitError, SignalError
from tudor_dynamics.identification import settings
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.identification.fit import FittedOutput
from tudor_dynamics.identification.validation import Grade
from tudor_dynamics.load.rows import find_scale, LoadRows, LoadWorth
from tudor_dynamics.mechanics.mechanism import beam_properties
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.elastic.model import ElasticModel
from tudor_dynamics.models.regressor import output_units
from tudor_dynamics.online.contact_fronts import gauge_gain, torque_scale
from tudor_dynamics.online.monitor import MomentumObserver, SOURCE
from tudor_dynamics.online.settings import BLOCK
from tudor_dynamics.online.threshold_learning import (
    FreeMotion, learn_thresholds, thresholds_to_dict)
from tudor_dynamics.online.thresholds import MethodThresholds
from tudor_dynamics.signals.preprocessing import prepare
from tudor_dynamics.typing import FloatArray


def free_motion(
    cases: Sequence[tuple[Model, BagData]], output: str, spec: PreprocessingSpec, *,
    momentum: bool = False,
) -> list[FreeMotion]:
    """Compute the residuals of every sample as the running robot has them: by causal filters."""
    live = spec.model_copy(update={'filter': 'causal', 'rate': None})
    records = []
    for model, bag in cases:
        try:
            stretches = prepare(bag.recording, live)
        except SignalError:
            continue  # no stretch is long enough
        for s in stretches:
            measured = getattr(s, output)
            if momentum:
                residual = MomentumObserver(model).process(s.stamp, model.inputs(s), measured)
            else:
                residual = measured - model.observe(s)
            keep = s.decimation.keep
            records.append(FreeMotion(s.stamp[keep], s.motion[keep], residual[keep],
                                      str(bag.choice)))
    return records


def learn_all(
    unseen: Sequence[tuple[str, str, Sequence[tuple[Model, BagData]]]], spec: PreprocessingSpec,
) -> tuple[dict[tuple[str, str], MethodThresholds], dict[tuple[str, str], str]]:
    """Learn thresholds from bags not fitted to, by method and kind; or the reason for none."""
    found: dict[tuple[str, str], MethodThresholds] = {}
    missing: dict[tuple[str, str], str] = {}
    for output, kind, cases in unseen:
        if not cases:
            missing[output, kind] = 'no bag was left out of the fit to learn them from'
            continue
        channels = cases[0][0].channels
        held = np.zeros(len(channels))
        if output == 'effort':
            # the friction that may hold each joint while it stands, as all models have it
            held = np.max([model.stiction(_poses(bag, settings.STICTION_POSES))
                           for model, bag in cases], axis=0)
        records = {output: free_motion(cases, output, spec)}
        if output == 'effort' and kind == 'analytical':
            records['momentum'] = free_motion(cases, output, spec, momentum=True)
        for method, motion in records.items():
            try:
                learned = learn_thresholds(motion, channels, held)
            except FitError as err:
                missing[method, kind] = str(err)
                continue
            known = [*(learned.profile[:, 0] > 0), *(
                tail.scale > 0 and np.isfinite(tail.location) for tail in learned.tails)]
            if all(known):
                found[method, kind] = learned
            else:
                name = channels[known.index(False) % len(channels)]
                missing[method, kind] = f'the residual of {name!r} is always 0; check its sensor'
    return found, missing


def _poses(bag: BagData, count: int) -> FloatArray:
    q = bag.recording.q
    return q[::max(1, len(q) // count)]


def _at_rest(bag: BagData, count: int) -> FloatArray:
    """Give the motion of an arm that stands at poses of a bag: (poses, 3 joints)."""
    q = _poses(bag, count)
    return np.hstack([q, np.zeros((len(q), 2 * q.shape[1]))])


def as_plain(learned: Mapping[tuple[str, str], MethodThresholds]) -> dict[str, Any]:
    """Give thresholds as a bundle keeps them: method to kind to plain values."""
    found: dict[str, Any] = {}
    for (method, kind), thresholds in learned.items():
        found.setdefault(method, {})[kind] = thresholds_to_dict(thresholds)
    return found


def marks(model: Model, arm: Arm, bag: BagData) -> tuple[str, ...]:
    """Look in a model of efforts for what no arm can be: negative inertias, a weight far off."""
    still = _at_rest(bag, settings.PHYSICS_POSES)
    rest = model.predict(still)
    n = rest.shape[1]
    found = []
    # each joint is accelerated by itself: a positive mass matrix answers with the same sign
    for joint, name in enumerate(model.channels):
        pushed = still.copy()
        pushed[:, 2 * n + joint] = 1.0
        inertia = model.predict(pushed)[:, joint] - rest[:, joint]
        share = float(np.mean(inertia < 0.0))
        if share > settings.NEGATIVE_SHARE:
            found.append(f'the inertia about {name} is negative at {100.0 * share:.0f} % '
                         'of the poses, which is impossible; record faster motion of this joint')
    return (*found, *_weights(model, arm, still, rest))


def _weights(model: Model, arm: Arm, still: FloatArray, rest: FloatArray) -> list[str]:
    """Compare what weight makes with the masses of the description, where it has some."""
    data = arm.model.createData()
    described = np.array([pin.computeGeneralizedGravity(arm.model, data, q).copy()
                          for q in np.split(still, 3, axis=1)[0]])
    described -= described.mean(axis=0)
    identified = rest - rest.mean(axis=0)
    sizes = np.linalg.norm(described, axis=0)
    found = []
    for joint, name in enumerate(model.channels):
        if arm.joints[joint].effort.unit == 'A' or sizes[joint] <= settings.WEIGHTY * sizes.max():
            continue
        slope = float(identified[:, joint] @ described[:, joint] / sizes[joint]**2)
        if not 1.0 / settings.WEIGHT_OFF <= slope <= settings.WEIGHT_OFF:
            found.append(f'the load of gravity on {name} is {slope:.2g} times that of the '
                         'description; check masses, the unit of its effort, and what the arm '
                         'carries')
    return found


@dataclass(frozen=True)
class Use:
    """One use of one model."""

    # Model, by what it predicts and what it is.
    output: str
    kind: str
    name: str  # `prediction`, `feed-forward`, `collision detection (METHOD)` or `payload`
    level: Grade | None  # may it be used; None where that cannot be said
    why: str  # figures that it is from
    channels: Mapping[str, Grade | None] = field(default_factory=dict)  # the same of each channel
    noticed: Mapping[str, str] = field(default_factory=dict)  # smallest touch, by channel

    def __str__(self) -> str:
        """Write it on one line."""
        level = 'not known' if self.level is None else self.level.value
        return f'{self.name}: {level}: {self.why}'

    def as_dict(self) -> dict[str, Any]:
        """Give it as plain values."""
        words = {name: None if level is None else level.value
                 for name, level in {'': self.level, **self.channels}.items()}
        return {'use': self.name, 'verdict': words.pop(''), 'why': self.why, 'channels': words,
                **({'noticed': dict(self.noticed)} if self.noticed else {})}


def short(value: float) -> str:
    """Write a number with two digits, and no power of ten where it is at least 1e-4."""
    return f'{float(f"{value:.2g}"):g}'


Said = tuple[Grade | None, str, Mapping[str, Grade | None]]


def uses_of(
    item: FittedOutput, arm: Arm, thresholds: Mapping[tuple[str, str], MethodThresholds],
    missing: Mapping[tuple[str, str], str], doubt: str = '',
) -> list[Use]:
    """Judge a model by each of its uses; doubt: why newtons and kilograms cannot be relied on."""
    use, own, tip = partial(Use, item.output, item.kind), (item.output, item.kind), _tip(item, arm)
    verdict, detection = item.verdict, 'collision detection ({})'
    found = [use('prediction', verdict.level, '; '.join(verdict.reasons), verdict.channels)]
    if item.output == 'effort':
        found.append(use('feed-forward', *_feedforward(item)))
    for (method, kind), learned in thresholds.items():
        if (SOURCE[method], kind) == own:
            found.append(use(detection.format(method), *(
                _collisions(arm, item.output, learned, tip)
                if item.validation.score.relative_error < 1 else
                (Grade.DO_NOT_USE, 'the prediction error is as large as the signal', {}, {}))))
    found += [use(detection.format(method), None, f'no thresholds: {why}')
              for (method, kind), why in missing.items() if (SOURCE[method], kind) == own]
    payload = _payload(item, tip)
    if payload is not None:
        found.append(use('payload', *payload))
    return [found[0], *(use(one.name, None, doubt) if doubt else one for one in found[1:])]


def _grade(value: float, bounds: tuple[float, float]) -> Grade:
    """Judge a figure by the upper bounds of what is good and of what is usable."""
    good, usable = bounds
    return Grade.GOOD if value <= good else Grade.USABLE if value <= usable else Grade.DO_NOT_USE


def _worst(levels: Iterable[Grade | None]) -> Grade | None:
    known = [level for level in levels if level is not None]
    return max(known, key=list(Grade).index, default=None)


def _feedforward(item: FittedOutput) -> Said:
    """Say what a controller still has to do where efforts are fed forward, and at which joints."""
    # it gives what is missing either way: a joint of whose effort more is missing than is fed is
    # left to it
    left = {name: own.relative_error for name, own in item.validation.score.channels.items()}
    levels = {name: _grade(value, settings.LEFT_TO_CONTROL) for name, value in left.items()}
    fed = [name for name in left if levels[name] is not Grade.DO_NOT_USE]
    each = ', '.join(f'{name} {100.0 * value:.0f} %' for name, value in left.items())
    joints = 'all joints' if len(fed) == len(left) else ', '.join(fed) or 'no joint'
    level = Grade.DO_NOT_USE if not fed else (
        Grade.GOOD if _worst(levels.values()) is Grade.GOOD else Grade.USABLE)
    return level, f'use it at {joints}; share of effort left to the controller: {each}', levels


@dataclass(frozen=True, eq=False)
class _Tip:
    """What forces at the tip add to the readings of each channel; NaN where nobody knows."""

    still: FloatArray  # arm at rest, (poses, 3 joints)
    torque: FloatArray  # (channels,): readings per N m, or per N of a joint that moves along
    force: FloatArray  # (poses, channels, 3): readings per N along the axes of the base
    mass: FloatArray  # (poses, channels): readings per kg, where `tudor payload` finds them too


def _tip(item: FittedOutput, arm: Arm) -> _Tip | None:
    """Find what forces at the tip do, at poses of the bag that the model was judged by."""
    if not item.validation.cases:
        return None
    _, bag = item.validation.cases[0]
    still = _at_rest(bag, settings.TIP_POSES)
    known, scale = _scales(item, arm, bag)
    # a kilogram in a gravity of one is a newton
    sides = [LoadRows(arm.under(axis), item.output).point(still) * scale for axis in np.eye(3)]
    constants = np.array([joint.effort.torque_constant or 1.0 for joint in arm.joints])
    torque = scale / constants if item.output == 'effort' else scale
    return _Tip(still, torque, np.stack(sides, axis=2),
                LoadRows(arm, item.output).point(still) * known)


def _scales(item: FittedOutput, arm: Arm, bag: BagData) -> tuple[FloatArray, FloatArray]:
    """Find the unit of an output by that of the rows of a load; then by links and motors, too."""
    model = item.model
    kept = [(s.motion[s.decimation.keep], s.decimation(getattr(s, item.output)))
            for s in bag.stretches]
    motion, measured = (np.vstack(part) for part in zip(*kept, strict=True))
    if isinstance(model, AnalyticalModel) and model.payload_range is not None:
        plain = LoadRows(arm, item.output).point(motion).std(axis=0)
        own = LoadWorth(arm, item.output, model).along(motion).std(axis=0)
        known = np.divide(own, plain, out=np.full(len(own), np.nan), where=plain > 0.0)
        return known, known
    scale = find_scale(arm, item.output, motion, measured).factor
    other = (1.0 / torque_scale(arm) if item.output == 'effort' else
             np.array([_gain(arm, gauge) for gauge in arm.gauges]))
    if isinstance(model, ElasticModel) and item.output == 'strain':
        other = scale = gauge_gain(arm, model)
    known = np.where(scale != 0.0, scale, np.nan)
    return known, np.where(np.isnan(known), other, known)


def _gain(arm: Arm, gauge: GaugeSpec) -> float:
    """Give the reading of a gauge per N m, by the link that it sits on; NaN if unknown."""
    if gauge.unit == 'N m':
        return 1.0
    beam = next((link.flexible for link in arm.spec.links if link.joint == gauge.joint), None)
    if beam is None or gauge.unit not in STRAIN_SCALE:
        return math.nan
    known = beam_properties(beam)
    return STRAIN_SCALE[gauge.unit] * known.surface_y / known.EIz


def _collisions(arm: Arm, output: str, learned: MethodThresholds, tip: _Tip | None) -> tuple[
        Grade | None, str, Mapping[str, Grade | None], Mapping[str, str]]:
    """Say which torque, and which force at the tip, is noticed within `settings.NOTICED`."""
    # it is a step, on the arm in motion or at rest, whichever hides more. The force acts along the
    # way that a joint moves the tip, in the median over the poses
    n, per_hour = len(learned.channels), settings.FALSE_ALARMS
    ratios = learned.ratios(per_hour)[:2 * n]
    columns = np.zeros(learned.profile.shape[1])
    columns[0] = 1.0
    rest = learned.profile @ columns * ratios + np.append(learned.stiction, np.zeros(n))
    columns[1:1 + learned.n_joints] = 0.5 * learned.reach
    levels = np.maximum(rest, learned.profile @ columns * ratios)
    # readings of a step by the residual, and by the onset statistic while its steps come in
    within = max(1, min(len(learned.taps), math.floor(settings.NOTICED / learned.step)))
    seen = np.hstack([np.eye(n), *np.cumsum(learned.taps[:within], axis=0)])
    levels = np.concatenate([levels[:n], np.tile(levels[n:], within)])
    torques = 1.0 / np.max(np.abs(seen) / levels, axis=1)
    units, doubt = output_units(arm, output), learned.doubt(per_hour)
    grades: dict[str, Grade | None] = {}
    noticed = {}
    for i, name in enumerate(learned.channels):
        force, grades[name] = math.nan, None
        if tip is not None and np.isfinite(tip.torque[i]):
            lever = np.linalg.norm(tip.force[:, i], axis=1)
            way = tip.force[:, i] / np.maximum(lever, 1e-300)[:, None]
            known = np.nan_to_num(tip.force)
            least = 1.0 / np.max(np.abs(np.einsum('pck,pk->pc', known, way) @ seen) / levels
                                 + 1e-300, axis=1)
            if np.median(lever) > settings.LEVER * abs(tip.torque[i]):
                force = float(np.median(least))
                grades[name] = _grade(force, settings.TIP_FORCE)
            along = output == 'effort' and arm.is_prismatic(name)
            tipped = '' if math.isnan(force) else f' ({short(force)} N at the tip)'
            noticed[name] = (f'{short(torques[i] / abs(tip.torque[i]))} '
                             f'{"N" if along else "N m"}{tipped}')
        else:
            noticed[name] = f'{short(torques[i])} {units[name]}'
    wide = '' if doubt < settings.WIDE else (
        f'; from hours of motion they would be {doubt:.1f} times lower')
    # a new block is the largest of n + 1 with a chance of one in as many, whatever the law
    sure = 3600.0 / BLOCK / (learned.seconds / BLOCK + 1.0)
    level, each = _worst(grades.values()), ', '.join(map(' '.join, noticed.items()))
    unknown = '' if level is not None else (
        'forces in N need effort.torque_constant, sensors[].gain or masses in the description; ')
    return level, (
        f'{unknown}detected within {1e3 * settings.NOTICED:.0f} ms at {per_hour:g} false alarm '
        f'per hour: {each}; thresholds are from {learned.seconds:.0f} s without '
        f'contact (which alone ensures at most {short(sure)} false alarms per hour){wide}'
    ), grades, noticed


def _payload(item: FittedOutput, tip: _Tip | None) -> Said | None:
    """Say how many kilograms a mean is off, by the channel that shows a load best."""
    if tip is None:
        return None
    model = item.validation.cases[0][0]
    weight = np.zeros_like(tip.mass) if model.has_memory else model.predict(tip.still)
    span = np.ptp(weight, axis=0)
    if not np.any(span > settings.WEIGHTLESS * np.max(np.abs(weight), initial=1e-300)):
        return None  # a level axis carries no weight
    means = []
    for trace in item.validation.traces:
        period = float(np.median(np.diff(trace.t))) if len(trace.t) > 1 else settings.MEAN
        step = max(1, round(settings.MEAN / max(period, 1e-9)))
        whole = len(trace.t) // step * step
        error = trace.residual[:whole]
        means.append(error.reshape(-1, step, error.shape[1]).mean(axis=1))
    if not sum(map(len, means)):
        return None  # no stretch is as long as the mean
    error = 2.0 * np.sqrt(np.mean(np.vstack(means) ** 2, axis=0))
    column = np.sqrt(np.mean(tip.mass ** 2, axis=0))
    kilograms = np.where(column > 0.0, error / np.maximum(column, 1e-300), np.nan)
    if not np.isfinite(kilograms).any():
        return None, ('masses in kg need effort.torque_constant, sensors[].gain or masses in '
                      'the description, or a fit of two loads (tudor fit --payload-of)'), {}
    best = int(np.nanargmin(kilograms))
    share = float(error[best] / max(span[best], 1e-300))
    return _grade(share, settings.WEIGHT_SHARE), (
        f'uncertain by {short(kilograms[best])} kg (two standard deviations of '
        f'{model.channels[best]}, averaged over {settings.MEAN:g} s), {100.0 * share:.0f} % of '
        "how much the arm's weight varies between poses"), {}
