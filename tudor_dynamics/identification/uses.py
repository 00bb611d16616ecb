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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import FitError, SignalError
from tudor_dynamics.identification import settings
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.identification.fit import FittedOutput
from tudor_dynamics.identification.validation import Grade
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.regressor import output_units
from tudor_dynamics.online.monitor import MomentumObserver
from tudor_dynamics.online.threshold_learning import (
    FreeMotion, learn_thresholds, thresholds_to_dict)
from tudor_dynamics.online.thresholds import MethodThresholds
from tudor_dynamics.signals.preprocessing import prepare
from tudor_dynamics.typing import FloatArray


def free_motion(
    cases: Sequence[tuple[Model, BagData]],
    output: str,
    spec: PreprocessingSpec,
    *,
    momentum: bool = False,
    strain: Sequence[tuple[Model, BagData]] = (),
) -> list[FreeMotion]:
    """Compute the residuals of every sample as the running robot has them: by causal filters."""
    live = spec.model_copy(update={'filter': 'causal', 'rate': None})
    correcting = {id(bag): model for model, bag in strain}
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
                residual = measured - model.observe(s, correcting.get(id(bag)))
            keep = s.decimation.keep
            records.append(FreeMotion(s.stamp[keep], s.motion[keep], residual[keep]))
    return records


def learn_all(
    unseen: Sequence[tuple[str, str, Sequence[tuple[Model, BagData]]]],
    spec: PreprocessingSpec,
) -> tuple[dict[tuple[str, str], MethodThresholds], dict[tuple[str, str], str]]:
    """Learn thresholds from bags not fitted to, by method and kind; or the reason for none."""
    found: dict[tuple[str, str], MethodThresholds] = {}
    missing: dict[tuple[str, str], str] = {}
    for output, kind, cases in unseen:
        if not cases:
            missing[output, kind] = 'there is no motion that the model has not seen'
            continue
        channels = cases[0][0].channels
        held = np.zeros(len(channels))
        if output == 'effort':
            # the friction that may hold each joint while it stands, as all models have it
            held = np.max([model.stiction(_poses(bag, settings.STICTION_POSES))
                           for model, bag in cases], axis=0)
        strain = next((other for what, of, other in unseen
                       if what == 'strain' and of == kind), ())
        records = {output: free_motion(cases, output, spec, strain=strain)}
        if output == 'effort' and kind == 'analytical':
            records['momentum'] = free_motion(cases, output, spec, momentum=True)
        for method, motion in records.items():
            try:
                learned = learn_thresholds(motion, channels, held)
            except FitError as err:
                missing[method, kind] = str(err)
                continue
            if (all(tail.scale > 0 and np.isfinite(tail.location) for tail in learned.tails)
                    and (learned.profile[:, 0] > 0).all()):
                found[method, kind] = learned
            else:
                missing[method, kind] = 'a residual is zero throughout'
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
    if model.has_memory:
        return ()
    still = _at_rest(bag, settings.PHYSICS_POSES)
    rest = model.predict(still)
    return (*_inertias(model, still, rest), *_weights(model, arm, still, rest))


def _inertias(model: Model, still: FloatArray, rest: FloatArray) -> list[str]:
    """Accelerate each joint by itself: a positive mass matrix answers with the same sign."""
    n = rest.shape[1]
    found = []
    for joint, name in enumerate(model.channels):
        pushed = still.copy()
        pushed[:, 2 * n + joint] = 1.0
        inertia = model.predict(pushed)[:, joint] - rest[:, joint]
        share = float(np.mean(inertia < 0.0))
        if share > settings.NEGATIVE_SHARE:
            found.append(f'the inertia about {name} comes out negative at {100.0 * share:.0f} % '
                         f'of the poses (least {inertia.min():.2g} per unit of acceleration): '
                         'no arm has one; faster motion of this joint would show it')
    return found


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
            found.append(f'the weight that {name} feels is {slope:.2g} times that of the '
                         'description: check masses, the unit of its effort, and what the arm '
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

    def __str__(self) -> str:
        """Write it on one line."""
        level = 'not known' if self.level is None else self.level.value
        return f'{self.name}: {level}: {self.why}'

    def as_dict(self) -> dict[str, Any]:
        """Give it as plain values."""
        return {'use': self.name, 'verdict': None if self.level is None else self.level.value,
                'why': self.why}


def short(value: float) -> str:
    """Write a number with two digits, and no power of ten where it is at least 1e-4."""
    return f'{float(f"{value:.2g}"):g}'


def uses_of(
    item: FittedOutput, arm: Arm, thresholds: Mapping[str, MethodThresholds],
    missing: Mapping[str, str],
) -> list[Use]:
    """Judge a model by each of its uses."""
    said: dict[str, tuple[Grade | None, str]] = {
        'prediction': (item.verdict.level, '; '.join(item.verdict.reasons))}
    if item.output == 'effort':
        said['feed-forward'] = _feedforward(item)
    for method, learned in thresholds.items():
        said[f'collision detection ({method})'] = _collisions(item, arm, learned)
    for method, why in missing.items():
        said[f'collision detection ({method})'] = None, f'no thresholds: {why}'
    payload = _payload(item, arm)
    if payload is not None:
        said['payload'] = payload
    return [Use(item.output, item.kind, name, *verdict) for name, verdict in said.items()]


def _grade(value: float, bounds: tuple[float, float]) -> Grade:
    """Judge a figure by the upper bounds of what is good and of what is usable."""
    good, usable = bounds
    return Grade.GOOD if value <= good else Grade.USABLE if value <= usable else Grade.DO_NOT_USE


def _feedforward(item: FittedOutput) -> tuple[Grade, str]:
    """
    Say what a controller still has to do where efforts are fed forward.

    It gives what is missing either way: an effort of which a model knows a half is no good
    prediction, and half of the work.
    """
    score = item.validation.score
    each = ', '.join(f'{name} {100.0 * own.relative_error:.0f} %'
                     for name, own in score.channels.items())
    return _grade(score.relative_error, settings.LEFT_TO_CONTROL), (
        f'{100.0 * score.relative_error:.0f} % of the efforts are left to the controller ({each})')


def _collisions(item: FittedOutput, arm: Arm, learned: MethodThresholds) -> tuple[Grade, str]:
    n, per_hour = len(learned.channels), settings.FALSE_ALARMS
    ratios = learned.ratios(per_hour)[:n]
    rest = learned.profile[:n, 0] * ratios + learned.stiction
    columns = np.zeros(learned.profile.shape[1])
    reach = np.where(np.isfinite(learned.reach), learned.reach, 0.0)
    columns[0], columns[1:1 + learned.n_joints] = 1.0, 0.5 * reach
    moving = learned.profile[:n] @ columns * ratios
    measured = np.vstack([trace.measured for trace in item.validation.traces])
    span = np.maximum(np.ptp(np.quantile(measured, [0.005, 0.995], axis=0), axis=0), 1e-300)
    share = np.maximum(moving, rest) / span
    # a touch is felt by all joints before it, so the better half decides
    half = float(np.sort(share)[(n - 1) // 2])
    units = output_units(arm, item.output)
    each = ', '.join(
        f'{name} {short(a)} at rest, {short(b)} {units[name]} in motion '
        f'({100 * c:.0f} % of its range)'
        for name, a, b, c in zip(learned.channels, rest, moving, share, strict=True))
    doubt = learned.doubt(per_hour)
    wide = '' if doubt < settings.WIDE else (
        f', and {doubt:.1f} times as wide as they would be from hours')
    return _grade(half, settings.THRESHOLD_SHARE), (
        f'told at {per_hour:g} false alarm per hour: {each}; thresholds from '
        f'{learned.seconds:.0f} s of free motion{wide}')


def _payload(item: FittedOutput, arm: Arm) -> tuple[Grade, str] | None:
    """Say from which share of an arm's own weight another weight shows."""
    if not item.validation.cases:
        return None
    model, bag = item.validation.cases[0]
    if model.has_memory:
        return None
    weight = model.predict(_at_rest(bag, settings.POSES))
    span = np.ptp(weight, axis=0)
    if not np.any(span > settings.WEIGHTLESS * np.max(np.abs(weight), initial=1e-300)):
        return None  # a level axis carries no weight
    means = []
    for trace in item.validation.traces:
        period = float(np.median(np.diff(trace.t))) if len(trace.t) > 1 else settings.MEAN
        step = max(1, round(settings.MEAN / max(period, 1e-9)))
        whole = len(trace.t) // step * step
        error = (trace.measured - trace.predicted)[:whole]
        means.append(error.reshape(-1, step, error.shape[1]).mean(axis=1))
    if not sum(map(len, means)):
        return None  # no stretch is as long as the mean
    error = np.sqrt(np.mean(np.vstack(means) ** 2, axis=0))
    share = 2.0 * error / np.maximum(span, 1e-300)
    best = int(np.argmin(share))
    name, unit = model.channels[best], output_units(arm, item.output)[model.channels[best]]
    return _grade(float(share[best]), settings.WEIGHT_SHARE), (
        f'best seen by {name}: its own weight makes {span[best]:.3g} {unit} over these poses, a '
        f'mean over {settings.MEAN:g} s is off by {short(error[best])}, so that '
        f'{100.0 * share[best]:.0f} % of it show')
