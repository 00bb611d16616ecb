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

"""Assessment of a fit, what to do next, and comparison with plans and earlier figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
import math
import os
from pathlib import Path
import shlex
import shutil
from typing import Any

import numpy as np

from tudor_dynamics.errors import TudorError, UsageError
from tudor_dynamics.files import other_name
from tudor_dynamics.identification import settings
from tudor_dynamics.identification.dataset import BagFacts
from tudor_dynamics.identification.excitation import expected_errors, Noise, played
from tudor_dynamics.identification.excitation_plan import PlanFolder
from tudor_dynamics.identification.fit import FitResult, FittedOutput, headline
from tudor_dynamics.identification.uses import learn_all, marks, short, Use, uses_of
from tudor_dynamics.identification.validation import Grade, LARGEST_GAP, Validation
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.online.thresholds import MethodThresholds
from tudor_dynamics.signals.motion_profile import motion_limits
from tudor_dynamics.signals.preprocessing import prepare


MILD = ('standstill', 'jitter', 'rings')  # findings that cost little
NAMED = 20  # bags that a command names one by one


@dataclass(frozen=True)
class NextStep:
    """One thing to do."""

    gain: float  # what it would bring, in points of fit or as much as those [%]
    what: str  # what to do, and why
    command: str = ''  # command that does it; empty where there is none


def next_steps(
    result: FitResult, uses: Sequence[Use], learned: Mapping[tuple[str, str], MethodThresholds],
    missing: Sequence[str], out: Path | None = None,
) -> tuple[NextStep, ...]:
    """List what to do next, each command as it can be run; out: where the model is written."""
    found = [NextStep(settings.MILD_GAIN if item.kind in MILD else settings.FINDING_GAIN,
                      f'{item.title}: {item.what}; {item.remedy}') for item in result.findings]
    if missing:
        found.append(NextStep(
            settings.THRESHOLDS_GAIN, f'no collision thresholds ({"; ".join(missing)}): record a '
            'minute of motion in which nothing touches the arm, and add that bag to the fit'))
    doubt = max((item.doubt(settings.FALSE_ALARMS) for item in learned.values()), default=0.0)
    if doubt > settings.WIDE and not missing:
        seconds = min(item.seconds for item in learned.values())
        found.append(NextStep(
            settings.DOUBT_GAIN * math.log2(doubt), f'collision thresholds from {seconds:.0f} s '
            f'of motion are {doubt:.1f} times as high as from hours: record more motion in which '
            'nothing touches the arm, and add it to the fit'))
    found += _elastic(result, out)
    for item in headline(result.fitted):
        found += _of_model(result, item, out)
    if len(result.learned) == 1 and not result.judged:
        found.append(NextStep(
            settings.UNTESTED_GAIN, 'one bag does not show how well the model predicts on another '
            'day: record a second bag with another motion, and add it to the fit'))
    if not found and any(use.level in (Grade.GOOD, Grade.USABLE) for use in uses):
        ros = out is not None and shutil.which('ros2') is not None
        found.append(NextStep(0.0, 'run the monitor node (docs/reference/nodes.md)', shlex.join([
            'ros2', 'run', 'tudor_dynamics', 'monitor', '--ros-args', '-p', f'model:={out}'])
            if ros else ''))
    return tuple(sorted(found, key=lambda step: -step.gain))


def _elastic(result: FitResult, out: Path | None) -> list[NextStep]:
    """Send to the elastic model what rings under a rigid one."""
    if not result.ringing or result.elastic is not None:
        return []
    strain = next((item for item in result.fitted
                   if item.output == 'strain' and item.kind == 'analytical'), None)
    loudest = max(result.ringing, key=lambda item: item.share)
    gain = 0.0
    if strain is not None and loudest.channel in strain.validation.score.channels:
        fit = max(strain.validation.score.channels[loudest.channel].fit, 0.0)
        gain = (100.0 - fit) * (1.0 - math.sqrt(max(1.0 - loudest.share, 0.0)))
    advice = 'fit an elastic model as well'
    options = ['--models', 'analytical', 'elastic']
    if not result.arm.gauges:
        advice = 'damp the arm during the recording, or filter the ringing out'
        options = ['--filter', 'zero_phase', '--rate', '5']
    elif not result.arm.spec.links:
        advice = f'describe links and motors (docs/explanation/elastic.md), then {advice}'
        options = []
    return [NextStep(
        gain, f'{loudest.channel} rings at {loudest.frequency:.2f} Hz, which a rigid model cannot '
        f'predict ({100 * loudest.share:.0f} % of the residual above 0.5 Hz): {advice}',
        _fit(result, out, options) if options else '')]


def _of_model(result: FitResult, item: FittedOutput, out: Path | None) -> list[NextStep]:
    name, validation = f'{item.output} {item.kind}', item.validation.score
    found = []
    gap = item.training.score.fit - validation.fit
    if gap > LARGEST_GAP:
        found.append(NextStep(
            gap, f'{name}: the fit is {gap:.0f} percentage points below that on the training '
            'bags; record bags with other motion'))
    known = item.model.conditioning()
    if known.unexcited:
        shown = ', '.join(known.unexcited[:3]) + (' ...' if len(known.unexcited) > 3 else '')
        found.append(NextStep(
            settings.UNEXCITED_GAIN, f'{name}: the motion does not determine {shown}; record one '
            'planned by tudor excite with joint limits and floor height', _excite(result, out)))
    held = [(channel, score, score.standing_rmse, score.moving_rmse)
            for channel, score in validation.channels.items()
            if score.standing_rmse is not None and score.moving_rmse is not None
            and score.standing_rmse > settings.STANDING * score.moving_rmse]
    gain = max((max(0.0, 100.0 - score.fit) * (1.0 - moving / score.rmse)
                for _, score, _, moving in held), default=0.0)
    if gain > settings.SMALLEST_GAIN:
        each = ', '.join(f'{channel} {short(rest)}, in motion {short(moving)}'
                         for channel, _, rest, moving in held)
        found.append(NextStep(
            gain, f'{name}: the RMS error is larger at rest ({each}), as motion does not show '
            'static friction; judge the arm at rest by changes of the effort, or by strain'))
    return found


def fit_with(bundle: ModelBundle, bags: Sequence[str], model: str, load: float | None) -> str:
    """Write the command of a fit to the bags of a bundle and others; '' where one is gone."""
    facts = {key: [(str(item['bag']), item.get('payload')) for item in bundle.facts.get(key, ())]
             for key in ('training', 'test')}
    facts['training'] += [(bag, load) for bag in bags if bag not in dict(facts['training'])]
    paths = [bag.rpartition('@')[0] or bag for known in facts.values() for bag, _ in known]
    if not all(map(os.path.exists, [*paths, bundle.arm.source])):
        return ''
    masses = {path: mass for path, (_, mass) in zip(paths, sum(facts.values(), []), strict=True)}
    payloads = [f'{path}={mass:g}' for path, mass in masses.items() if mass is not None]
    return shlex.join([
        'tudor', 'fit', *dict(facts['training']), *(['--test', *dict(facts['test'])] * bool(
            facts['test'])), *(['--payload-of', *payloads] * bool(payloads)),
        '--arm', bundle.arm.source, '--out', str(other_name(Path(model)))])


def touched(change: ErrorChange, validation: Validation) -> str:
    """Say where an error comes from a short time alone; '' where it does not."""
    place = validation.channels.index(change.channel)
    blocks = sorted(((float(np.mean(item.residual[number == k, place] ** 2)),
                      item.bag, settings.MEAN * float(k)) for item in validation.traces
                     for number in [np.floor(item.t / settings.MEAN)] for k in np.unique(number)),
                    reverse=True)
    few = math.floor(settings.SHORT * len(blocks))
    if not few or math.sqrt(np.mean([size for size, _, _ in blocks[few:]])) > change.then:
        return ''
    _, bag, begin = blocks[0]
    return (f'{change.channel}: the error has grown in at most {100.0 * settings.SHORT:.0f} % of '
            f'the time, worst at {begin:.1f} s of {bag}')


def _fit(result: FitResult, out: Path | None, options: Sequence[str]) -> str:
    """Write the command of a fit like this one, with other options, beside this one."""
    test = ['--test', *_names(result.judged)] if result.judged else []
    return shlex.join(['tudor', 'fit', *_names(result.learned), *test, '--arm', result.arm.source,
                       *options, '--out', str(other_name(out or Path('model')))])


def _excite(result: FitResult, out: Path | None) -> str:
    """Write the command that plans motion; nothing where it would lack limits or a file."""
    try:
        motion_limits(result.arm)
    except TudorError:
        return ''
    plan = other_name((out or Path('model')).with_name('plan'))
    return '' if not os.path.isfile(result.arm.source) else shlex.join(
        ['tudor', 'excite', result.arm.source, '--floor', '0', '--out', str(plan)])


def _names(bags: Sequence[BagFacts]) -> list[str]:
    """Name bags as the command line may; many by the folder that all of them are in."""
    names = [bag.bag for bag in bags]
    return names if len(names) <= NAMED else [os.path.commonpath(names) or '.']


@dataclass(frozen=True, eq=False)
class Assessment:
    """What a fit is good enough for."""

    uses: tuple[Use, ...]  # verdicts, model by model
    thresholds: dict[tuple[str, str], MethodThresholds]  # method and kind to what was learned
    missing: tuple[str, ...]  # methods without thresholds, with the reason
    marks: tuple[str, ...]  # what no arm can be
    steps: tuple[NextStep, ...]  # what to do next, that with the largest gain first

    @property
    def detects(self) -> Grade | None:
        """Give how well the best model detects collisions; None without thresholds."""
        found = [use.level for use in self.uses
                 if use.name.startswith('collision') and use.level is not None]
        return min(found, key=list(Grade).index, default=None)

    def as_dict(self) -> dict[str, Any]:
        """Give verdicts and steps as plain values."""
        uses: dict[str, Any] = {}
        for use in self.uses:
            uses.setdefault(use.output, {}).setdefault(use.kind, []).append(use.as_dict())
        return {'uses': uses, 'marks': list(self.marks),
                'without_thresholds': list(self.missing),
                'next_steps': [asdict(step) for step in self.steps]}


def assess(result: FitResult, out: Path | None = None) -> Assessment:
    """Judge a fit by what it is to be used for; out: where its model is written."""
    # on the robot filters are causal: thresholds are those of the models that run there
    live = result.causal or result
    learned, reasons = learn_all([(item.output, item.kind, item.unseen) for item in live.fitted],
                                 live.preprocessing)
    uses: list[Use] = []
    found: list[str] = []
    units = next((item for item in result.findings if item.kind in settings.UNITS), None)
    doubt = '' if units is None else f'mend this finding first: {units.title}'
    for item in result.fitted:
        uses += uses_of(item, result.arm, learned, reasons, doubt)
        if (item.output, item.kind) == ('effort', 'analytical') and item.validation.cases:
            model, bag = item.validation.cases[0]
            found += marks(model, result.arm, bag)
    missing = tuple(f'{method} {kind}: {why}' for (method, kind), why in reasons.items())
    return Assessment(tuple(uses), learned, missing, tuple(found),
                      next_steps(result, uses, learned, missing, out))


@dataclass(frozen=True)
class ErrorChange:
    """Errors of one channel, then and now."""

    # What is predicted, by which kind of model.
    output: str
    kind: str
    channel: str
    # Root mean square error in the validation and on the bags, in the unit of the output.
    then: float
    now: float
    # Relative error in the validation and on the bags.
    relative_then: float
    relative_now: float
    sigmas: float  # growth of the logarithm of the mean squared error over its standard error
    changed: bool  # whether the model is no longer what it was

    def __str__(self) -> str:
        """Write it on one line."""
        said = 'has grown since the validation' if self.changed else 'is as in the validation'
        return (f'{self.output} {self.kind}, {self.channel}: the RMS error {said}; now '
                f'{self.now:.3g} ({100 * self.relative_now:.1f} % of the signal), then '
                f'{self.then:.3g} ({100 * self.relative_then:.1f} %), growth {self.sigmas:+.1f} '
                'standard errors')

    def as_dict(self) -> dict[str, Any]:
        """Give it as plain values."""
        content = asdict(self)
        return {key: content[key] for key in content if key not in ('output', 'kind', 'channel')}


def spread(validation: Validation) -> dict[str, float]:
    """Say how well the mean squared errors of a validation are known."""
    means = []
    for trace in validation.traces:
        number = np.floor((trace.t - trace.t[0]) / settings.CORRELATED).astype(int)
        squares = trace.residual ** 2
        means += [squares[number == k].mean(axis=0) for k in np.unique(number)
                  if np.sum(number == k) > 1]
    if len(means) < 2:
        return dict.fromkeys(validation.channels, settings.UNKNOWN_SPREAD)
    blocks = np.array(means)
    errors = blocks.std(axis=0, ddof=1) / math.sqrt(len(blocks)) / np.maximum(
        blocks.mean(axis=0), 1e-300)
    return dict(zip(validation.channels, errors.tolist(), strict=True))


def changes(
    facts: Mapping[str, Any], found: Mapping[str, Mapping[str, Validation]],
) -> tuple[ErrorChange, ...]:
    """Compare errors on bags with those of the validation that a bundle has."""
    said = []
    for output, kinds in found.items():
        for kind, validation in kinds.items():
            now = spread(validation)
            for channel, score in validation.score.channels.items():
                try:
                    known = facts['validation'][output][kind]
                    old = known['validation']['channels'][channel]
                    then, relative = float(old['rmse']), float(old['relative_error'])
                    doubt = float(known.get('spread', {}).get(channel, settings.UNKNOWN_SPREAD))
                except (KeyError, TypeError, ValueError):
                    continue  # of a bundle made by hand, of which nothing is known
                said.append(change_of(
                    (output, kind, channel), (then, score.rmse),
                    (relative, score.relative_error), (doubt, now[channel])))
    return tuple(said)


def change_of(
    name: tuple[str, str, str], errors: tuple[float, float], relative: tuple[float, float],
    doubts: tuple[float, float],
) -> ErrorChange:
    """Compare errors of one channel, then and now: errors [unit of the output]."""
    growth = errors[1] / max(errors[0], 1e-300)
    sigmas = 2.0 * math.log(max(growth, 1e-12)) / math.hypot(*(
        max(x, settings.LEAST_SPREAD) for x in doubts))
    changed = (growth > settings.GROWTH and sigmas > settings.SIGMAS
               and relative[1] > settings.RELATIVE_GROWTH * relative[0])
    return ErrorChange(*name, *errors, *relative, sigmas, changed)


@dataclass(frozen=True)
class Promise:
    """One parameter."""

    output: str  # what it predicts
    channels: tuple[str, ...]  # channels that share it
    # The base parameter and its unit.
    name: str
    unit: str
    expected: float  # by the planned motion and the stated noise, for as many samples
    by_noise: float  # the same by the noise that the fit left, in place of the stated one
    reached: float  # standard error of the fit


@dataclass(frozen=True)
class Comparison:
    """A plan and a fit."""

    promises: tuple[Promise, ...]  # all parameters that both know
    runs: float  # length of the training bags over that of the plan, in samples that are used
    stated: bool  # whether anybody stated the noise of the plan

    def ratios(self) -> dict[str, float]:
        """Give medians of what was reached over what was promised, and the part within 30 %."""
        ratios = {}
        for key in ('expected', 'by_noise'):
            values = np.array([item.reached / getattr(item, key) for item in self.promises
                               if np.isfinite(item.reached) and np.isfinite(item.expected)])
            if len(values):
                ratios[f'median_over_{key}'] = float(np.median(values))
                ratios[f'within_30_percent_of_{key}'] = float(np.mean(
                    np.abs(values - 1.0) <= settings.PROMISE_KEPT))
        return ratios

    def content(self) -> dict[str, object]:
        """Give it as plain values for JSON."""
        return {'runs': self.runs, 'noise_stated': self.stated, **self.ratios(),
                'parameters': [asdict(item) for item in self.promises]}


def compare_with_plan(result: FitResult, plan: PlanFolder) -> Comparison:
    """Compare a fit with the plan of its recordings."""
    arm, names = result.arm, plan.trajectory.joints
    if sorted(names) != sorted(arm.active_joints):
        msg = f'the plan moves {", ".join(names)}, but the arm has {", ".join(arm.active_joints)}'
        raise UsageError(msg, place=plan.path, remedy=f'give a plan of arm {arm.name!r}')
    trajectory = plan.trajectory.of(arm.active_joints)
    models = {item.output: item.model for item in result.fitted
              if isinstance(item.model, AnalyticalModel) and item.model.payload_range is None
              and len(plan.noise.size.get(item.output, ())) == len(item.model.channels)}
    if not models:
        raise UsageError('a plan is compared with an analytical model of one load, which this '
                         'fit does not have', place=plan.path, remedy='leave the plan out')
    planned = sum(stretch.n_kept for stretch in prepare(
        played(trajectory, arm), result.preprocessing))
    runs = sum(facts.used for facts in result.learned) / planned
    residual = {output: model.deviations() for output, model in models.items()}
    reached = [error for model in models.values() for group in model.groups_
               for error in group.estimate.standard_errors.tolist()]
    promised, honest = (expected_errors(models, arm, trajectory, result.preprocessing, noise)
                        for noise in (plan.noise, Noise(residual, residual=True)))
    return Comparison(tuple(
        Promise(one.output, one.channels, one.name, one.unit, one.value / math.sqrt(runs),
                other.value / math.sqrt(runs), error)
        for one, other, error in zip(promised, honest, reached, strict=True)), runs, plan.stated)
