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


# -- Thresholds of a fit: learned from residuals of bags that the models were not fitted to

FREE_MOTION_POSES = 200
"""Poses at which the friction of a joint is looked at."""


def live_preprocessing(spec: PreprocessingSpec) -> PreprocessingSpec:
    """Give the preprocessing of the running robot: causal, every sample."""
    return spec.model_copy(update={'filter': 'causal', 'rate': None})


def free_motion(
    cases: Sequence[tuple[Model, BagData]],
    output: str,
    spec: PreprocessingSpec,
    *,
    momentum: bool = False,
    strain: Sequence[tuple[Model, BagData]] = (),
) -> list[FreeMotion]:
    """Compute the residuals of every sample as the running robot has them."""
    correcting = {id(bag): model for model, bag in strain}
    records = []
    for model, bag in cases:
        try:
            stretches = prepare(bag.recording, live_preprocessing(spec))
        except SignalError:
            continue  # no stretch is long enough
        for s in stretches:
            measured, motion = getattr(s, output), s.motion
            if momentum:
                residual = MomentumObserver(model).process(s.stamp, model.inputs(s), measured)
            else:
                residual = measured - model.observe(s, correcting.get(id(bag)))
            keep = s.decimation.keep
            records.append(FreeMotion(s.stamp[keep], motion[keep], residual[keep]))
    return records


def stiction(cases: Sequence[tuple[Model, BagData]]) -> FloatArray:
    """
    Give the friction that may hold each joint while it stands, as all models have it.

    Returns (joints,) [unit of each joint's effort].
    """
    return np.asarray(np.max([
        model.stiction(bag.recording.q[::max(1, len(bag.recording.q) // FREE_MOTION_POSES)])
        for model, bag in cases], axis=0))


def learn_all(
    unseen: Sequence[tuple[str, str, Sequence[tuple[Model, BagData]]]],
    spec: PreprocessingSpec,
) -> tuple[dict[tuple[str, str], MethodThresholds], dict[tuple[str, str], str]]:
    """Learn the thresholds of all methods that a fit allows."""
    found: dict[tuple[str, str], MethodThresholds] = {}
    missing: dict[tuple[str, str], str] = {}

    def learn(
        method: str, kind: str, records: list[FreeMotion], channels: tuple[str, ...],
        stiction: FloatArray,
    ) -> None:
        try:
            learned = learn_thresholds(records, channels, stiction)
        except FitError as err:
            missing[method, kind] = str(err)
            return
        if usable(learned):
            found[method, kind] = learned
        else:
            missing[method, kind] = 'a residual is zero throughout'

    for output, kind, cases in unseen:
        if not cases:
            missing[output, kind] = 'there is no motion that the model has not seen'
            continue
        channels = cases[0][0].channels
        strain = next((other for what, of, other in unseen
                       if what == 'strain' and of == kind), ())
        held = stiction(cases) if output == 'effort' else np.zeros(len(channels))
        learn(output, kind, free_motion(cases, output, spec, strain=strain), channels, held)
        if output == 'effort' and kind == 'analytical':
            learn('momentum', kind, free_motion(cases, output, spec, momentum=True), channels,
                  held)
    return found, missing


def as_plain(learned: Mapping[tuple[str, str], MethodThresholds]) -> dict[str, Any]:
    """Give thresholds as a bundle keeps them: method to kind to plain values."""
    found: dict[str, Any] = {}
    for (method, kind), thresholds in learned.items():
        found.setdefault(method, {})[kind] = thresholds_to_dict(thresholds)
    return found


def usable(thresholds: MethodThresholds) -> bool:
    """Say whether every statistic has a size; one that is zero throughout has none."""
    return bool(all(tail.scale > 0 and np.isfinite(tail.location) for tail in thresholds.tails)
                and (thresholds.profile[:, 0] > 0).all())


# -- What no arm can be: negative inertias, and weights far from those of its own description

PHYSICS_POSES = 200
FEW = 0.02
"""Share of poses at which an inertia may be negative, where parameters are uncertain."""
FAR = 1.5
"""Factor between the identified weight and the described one from which on it is marked."""
SHOWS = 0.1
"""Share of the largest weight below which the weight of a joint is not compared."""


def marks(model: Model, arm: Arm, data: Sequence[BagData]) -> tuple[str, ...]:
    """Look for what no arm can be in a model of efforts."""
    if model.has_memory or not data:
        return ()
    q = np.vstack([bag.recording.q for bag in data])
    q = q[::max(1, len(q) // PHYSICS_POSES)]
    n = q.shape[1]
    still = np.hstack([q, np.zeros((len(q), 2 * n))])
    rest = model.predict(still)
    return (*_inertias(model, still, rest), *_weights(model, arm, q, rest))


def _inertias(model: Model, still: FloatArray, rest: FloatArray) -> list[str]:
    """Accelerate each joint by itself: a positive mass matrix answers with the same sign."""
    n = rest.shape[1]
    found = []
    for joint, name in enumerate(model.channels):
        pushed = still.copy()
        pushed[:, 2 * n + joint] = 1.0
        inertia = model.predict(pushed)[:, joint] - rest[:, joint]
        share = float(np.mean(inertia < 0.0))
        if share > FEW:
            found.append(f'the inertia about {name} comes out negative at {100.0 * share:.0f} % '
                         f'of the poses (least {inertia.min():.2g} per unit of acceleration): '
                         'no arm has one; faster motion of this joint would show it')
    return found


def _weights(model: Model, arm: Arm, q: FloatArray, rest: FloatArray) -> list[str]:
    """Compare what weight makes with the masses of the description, where it has some."""
    data = arm.model.createData()
    described = np.array([pin.computeGeneralizedGravity(arm.model, data, row).copy()
                          for row in q])
    described -= described.mean(axis=0)
    identified = rest - rest.mean(axis=0)
    sizes = np.linalg.norm(described, axis=0)
    found = []
    for joint, name in enumerate(model.channels):
        if arm.joints[joint].effort.unit == 'A' or sizes[joint] <= SHOWS * sizes.max():
            continue
        slope = float(identified[:, joint] @ described[:, joint] / sizes[joint]**2)
        if not 1.0 / FAR <= slope <= FAR:
            found.append(f'the weight that {name} feels is {slope:.2g} times that of the '
                         'description: check masses, the unit of its effort, and what the arm '
                         'carries')
    return found


# -- What models may be used for, one verdict each: prediction, feed-forward, collisions, payload

RATE = 1.0
"""False alarms per hour for which a collision detector is judged [1/h]."""
GOOD_SHARE, USABLE_SHARE = 0.25, 1.0
"""Threshold over the range of the output, at half of the largest speed."""
GOOD_WEIGHT, USABLE_WEIGHT = 0.05, 0.2
"""Error of a mean over `MEAN` over the range of what weight makes."""
GOOD_LEFT, USABLE_LEFT = 0.3, 0.7
"""Relative error of the efforts: what of them feed-forward leaves to the controller."""
MEAN = 1.0
"""Time over which a payload is averaged [s]."""
POSES = 2000
WEIGHTLESS = 1e-9
"""Part of what an output is at rest from which on it changes with the pose."""


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
    found = [Use(item.output, item.kind, 'prediction', item.verdict.level,
                 '; '.join(item.verdict.reasons))]
    if item.output == 'effort':
        found.append(_feedforward(item))
    for method, learned in thresholds.items():
        found.append(_collisions(item, arm, method, learned))
    for method, why in missing.items():
        found.append(Use(item.output, item.kind, f'collision detection ({method})', None,
                         f'no thresholds: {why}'))
    payload = _payload(item, arm)
    return found if payload is None else [*found, payload]


def _feedforward(item: FittedOutput) -> Use:
    """
    Say what a controller still has to do where efforts are fed forward.

    It gives what is missing either way: an effort of which a model knows a half is no good
    prediction, and half of the work.
    """
    score = item.validation.score
    level = (Grade.GOOD if score.relative_error <= GOOD_LEFT else Grade.USABLE
             if score.relative_error <= USABLE_LEFT else Grade.DO_NOT_USE)
    each = ', '.join(f'{name} {100.0 * own.relative_error:.0f} %'
                     for name, own in score.channels.items())
    return Use(item.output, item.kind, 'feed-forward', level,
               f'{100.0 * score.relative_error:.0f} % of the efforts are left to the controller '
               f'({each})')


def _collisions(
    item: FittedOutput, arm: Arm, method: str, learned: MethodThresholds,
) -> Use:
    n = len(learned.channels)
    ratios = learned.ratios(RATE)[:n]
    rest = learned.profile[:n, 0] * ratios + learned.stiction
    columns = np.zeros(learned.profile.shape[1])
    reach = np.where(np.isfinite(learned.reach), learned.reach, 0.0)
    columns[0], columns[1:1 + learned.n_joints] = 1.0, 0.5 * reach
    moving = learned.profile[:n] @ columns * ratios
    measured = np.vstack([trace.measured for trace in item.validation.traces])
    span = np.maximum(np.ptp(np.quantile(measured, [0.005, 0.995], axis=0), axis=0), 1e-300)
    share = np.maximum(moving, rest) / span
    levels = [Grade.GOOD if one <= GOOD_SHARE else Grade.USABLE if one <= USABLE_SHARE
              else Grade.DO_NOT_USE for one in share.tolist()]
    # a touch is felt by all joints before it, so the better half decides
    level = sorted(levels, key=list(Grade).index)[(n - 1) // 2]
    units = output_units(arm, item.output)
    each = ', '.join(
        f'{name} {short(a)} at rest, {short(b)} {units[name]} in motion '
        f'({100 * c:.0f} % of its range)'
        for name, a, b, c in zip(learned.channels, rest, moving, share, strict=True))
    doubt = learned.doubt(RATE)
    wide = '' if doubt < 1.2 else f', and {doubt:.1f} times as wide as they would be from hours'
    return Use(item.output, item.kind, f'collision detection ({method})', level,
               f'told at {RATE:g} false alarm per hour: {each}; thresholds from '
               f'{learned.seconds:.0f} s of free motion{wide}')


def weights(model: Model, data: Sequence[BagData]) -> FloatArray | None:
    """
    Give what weight makes of the outputs at the poses of bags.

    Returns (poses, channels) [its unit], None of a model that does not predict single samples.
    """
    if model.has_memory:
        return None
    q = np.vstack([bag.recording.q for bag in data])
    q = q[::max(1, len(q) // POSES)]
    return model.predict(np.hstack([q, np.zeros_like(q), np.zeros_like(q)]))


def _payload(item: FittedOutput, arm: Arm) -> Use | None:
    """Say from which share of an arm's own weight another weight shows."""
    if not item.validation.cases:
        return None
    model, bag = item.validation.cases[0]
    weight = weights(model, [bag])
    if weight is None:
        return None
    span = np.ptp(weight, axis=0)
    means = []
    for trace in item.validation.traces:
        step = max(1, round(MEAN / max(float(np.median(np.diff(trace.t))), 1e-9)))
        whole = len(trace.t) // step * step
        error = (trace.measured - trace.predicted)[:whole]
        means.append(error.reshape(-1, step, error.shape[1]).mean(axis=1))
    error = np.sqrt(np.mean(np.vstack(means) ** 2, axis=0)) if means else np.full(len(span), 1.0)
    if not np.any(span > WEIGHTLESS * np.max(np.abs(weight), initial=1e-300)):
        return None  # a level axis carries no weight
    share = 2.0 * error / np.maximum(span, 1e-300)
    best = int(np.argmin(share))
    name, unit = model.channels[best], output_units(arm, item.output)[model.channels[best]]
    level = (Grade.GOOD if share[best] <= GOOD_WEIGHT else Grade.USABLE
             if share[best] <= USABLE_WEIGHT else Grade.DO_NOT_USE)
    return Use(item.output, item.kind, 'payload', level,
               f'best seen by {name}: its own weight makes {span[best]:.3g} {unit} over these '
               f'poses, a mean over {MEAN:g} s is off by {short(error[best])}, so that '
               f'{100.0 * share[best]:.0f} % of it show')
