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

"""What to do next, in the order of what it would bring, with the command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
import math
import os
import shlex
from typing import Any

from tudor_dynamics.identification.bag_facts import BagFacts
from tudor_dynamics.identification.fit import FitResult, FittedOutput
from tudor_dynamics.identification.verdict import Grade, LARGEST_GAP
from tudor_dynamics.identification.worth.uses import short, Use
from tudor_dynamics.monitoring.thresholds.thresholds import MethodThresholds

FINDING, NO_THRESHOLDS, UNTESTED, WIDE = 100.0, 50.0, 8.0, 6.0
"""What a remedy brings where no figure tells it, beside points of fit."""
HARMLESS = 1.0
MILD = ('standstill', 'jitter')
"""Findings that cost little."""
WIDER = 1.2
"""Doubt about thresholds that more motion is worth."""
LITTLE = 0.5
"""Points of fit that are not worth a step."""
NAMED = 20
"""Bags that a command names one by one."""


@dataclass(frozen=True)
class NextStep:
    """One thing to do."""

    gain: float  # what it would bring, in points of fit or as much as those [%]
    what: str  # what to do, and why
    command: str = ''  # command that does it; empty where there is none

    def as_dict(self) -> dict[str, Any]:
        """Give it as plain values."""
        return asdict(self)


def next_steps(
    result: FitResult, uses: Sequence[Use],
    learned: Mapping[tuple[str, str], MethodThresholds], missing: Sequence[str],
) -> tuple[NextStep, ...]:
    """List what to do next."""
    found = [NextStep(HARMLESS if item.kind in MILD else FINDING,
                      f'{item.title}: {item.what}; {item.remedy}') for item in result.findings]
    if missing:
        found.append(NextStep(
            NO_THRESHOLDS, f'no collision thresholds ({"; ".join(missing)}): record a minute in '
            'which nothing touches the arm, and fit it too', _fit(result, more='BAG')))
    elif learned and (doubt := max(item.doubt(1.0) for item in learned.values())) > WIDER:
        seconds = min(item.seconds for item in learned.values())
        found.append(NextStep(
            WIDE * math.log(doubt) / math.log(2.0), f'thresholds from {seconds:.0f} s of free '
            f'motion are {doubt:.1f} times as wide as from hours: record more in which nothing '
            'touches the arm', _fit(result, more='BAG')))
    found += _elastic(result)
    headline = [item for item in result.fitted if item.kind != 'elm'] or list(result.fitted)
    for item in headline:
        found += _of_model(result, item)
    if len(result.learned) == 1 and not result.judged:
        found.append(NextStep(
            UNTESTED, 'one bag cannot tell how the model does on another day: record a second, of '
            'another motion', _fit(result, more='BAG')))
    if not found and any(use.level is not Grade.DO_NOT_USE for use in uses):
        found.append(NextStep(0.0, 'try it beside the robot',
                              'ros2 run tudor_dynamics monitor --ros-args -p model:=MODEL'))
    return tuple(sorted(found, key=lambda step: -step.gain))


def _elastic(result: FitResult) -> list[NextStep]:
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
    text = (f'{loudest.channel} rings at {loudest.frequency:.2f} Hz, {100 * loudest.share:.0f} % '
            'of what is left above 0.5 Hz, and no rigid model can know it: ')
    if result.arm.gauges and result.arm.spec.links:
        return [NextStep(gain, f'{text}fit the elastic model as well',
                         _fit(result, options=('--models', 'analytical', 'elastic')))]
    if not result.arm.gauges:
        return [NextStep(gain, f'{text}damp the arm while it is recorded, or leave the ringing '
                         'out', _fit(result, options=('--filter', 'zero_phase', '--rate', '5')))]
    return [NextStep(gain, f'{text}describe what bends (links and motors, docs/elastic.md) and '
                     'fit the elastic model as well',
                     _fit(result, options=('--models', 'analytical', 'elastic')))]


def _of_model(result: FitResult, item: FittedOutput) -> list[NextStep]:
    name, validation = f'{item.output} {item.kind}', item.validation.score
    found = []
    gap = item.training.score.fit - validation.fit
    if gap > LARGEST_GAP:
        found.append(NextStep(
            gap, f'{name}: {gap:.0f} points worse than in training: more bags, of more motion',
            _fit(result, more='BAG')))
    known = item.model.conditioning()
    if known.unexcited:
        shown = ', '.join(known.unexcited[:3]) + (' ...' if len(known.unexcited) > 3 else '')
        found.append(NextStep(
            5.0, f'{name}: the motion does not show {shown}: record one that does; the condition '
            'numbers of planned motions say how well', 'tudor record --arm '
            f'{shlex.quote(result.arm.source)} --stimuli 2 --seconds 20 --best-of 3 --conditions '
            '--out none'))
    held = [(channel, score, score.standing_rmse, score.moving_rmse)
            for channel, score in validation.channels.items()
            if score.standing_rmse is not None and score.moving_rmse is not None
            and score.standing_rmse > 2.0 * score.moving_rmse]
    gain = max((max(0.0, 100.0 - score.fit) * (1.0 - moving / score.rmse)
                for _, score, _, moving in held), default=0.0)
    if gain > LITTLE:
        each = ', '.join(f'{channel} {short(rest)} after {short(moving)}'
                         for channel, _, rest, moving in held)
        found.append(NextStep(
            gain, f'{name}: further off at rest than in motion ({each}): friction that holds a '
            'joint, which no motion tells; judge what stands by its changes, or by strain'))
    return found


def _fit(result: FitResult, more: str = '', options: Sequence[str] = ()) -> str:
    """Write the command of a fit like this one, with something else."""
    words = ['tudor', 'fit', *_names(result.learned)]
    if result.judged:
        # what follows --test would be a test as well
        words += [more] if more else []
        words += ['--test', *_names(result.judged)]
    elif more:
        words.append(more)
    words += ['--arm', result.arm.source, *options, '--out', 'MODEL']
    return shlex.join(words)


def _names(bags: Sequence[BagFacts]) -> list[str]:
    """Name bags as the command line may; many by the folder that all of them are in."""
    names = [bag.bag for bag in bags]
    return names if len(names) <= NAMED else [os.path.commonpath(names) or '.']
