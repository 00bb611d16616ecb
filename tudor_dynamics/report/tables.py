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

"""Rows of the report's tables, and the words for verdict, conditioning and preprocessing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

from tudor_dynamics.arm import Arm, PreprocessingSpec
from tudor_dynamics.identification.bag_facts import BagFacts
from tudor_dynamics.identification.fit import FitResult, FittedOutput
from tudor_dynamics.identification.verdict import Grade, LARGEST_CONDITION
from tudor_dynamics.models.kinds import KINDS

UNCERTAIN = 30.0
"""Relative standard error above which a coefficient is marked [%]."""
SHOWN = 50
"""Bags that a page lists."""
GOOD_CONDITION = 100.0
"""Condition number up to which least squares is said to be well conditioned (Gautier)."""


@dataclass(frozen=True)
class Coefficient:
    """One row of the table of coefficients; ``relative_error`` in percent."""

    name: str  # name of the parameter
    value: float  # estimate in its unit
    unit: str  # unit of the value
    standard_error: float  # standard deviation, in the same unit
    relative_error: float  # standard deviation over value [%]
    note: str  # whether it is uncertain, or not excited


@dataclass(frozen=True)
class CoefficientGroup:
    """Coefficients that some channels share, with their conditioning in words."""

    channels: tuple[str, ...]  # channels that share them
    condition: float  # condition number of the scaled regressor
    conditioning: str  # what that number means, in words
    rows: tuple[Coefficient, ...]  # a row for each parameter


@dataclass(frozen=True)
class BagRow:
    """A bag of the fit; times in seconds."""

    name: str  # bag, or part of one
    role: str  # whether it was learned from or judged by
    recorded: int  # samples as recorded
    used: int  # samples that are left after decimation
    duration: float  # length of the bag [s]
    rate: float  # samples per second as recorded [Hz]
    gaps: int  # number of gaps
    longest_gap: float  # length of the longest gap [s]
    dropped: str  # messages that were left out, in words
    checksum: str  # SHA-256 over the storage files
    warnings: tuple[str, ...]  # what is odd about the bag


@dataclass(frozen=True)
class Overall:
    """Verdict over all models: a level for the colour, a word, and a sentence."""

    level: str  # level of the worst output, for the colour
    word: str  # verdict in a word
    sentence: str  # verdict in a sentence


def model_name(item: FittedOutput) -> str:
    """Name a model: its output and kind."""
    return f'{item.output} {KINDS[item.kind].label}'


def headline(fitted: Sequence[FittedOutput]) -> list[FittedOutput]:
    """Leave kinds out that are there for comparison, unless they are all that there is."""
    return [item for item in fitted if not KINDS[item.kind].compared] or list(fitted)


def overall(
    fitted: Sequence[FittedOutput], detects: Grade | None = None,
) -> Overall:
    """Sum the verdicts up."""
    fitted = headline(fitted)
    names = {level: [model_name(item) for item in fitted if item.verdict.level is level]
             for level in Grade}
    levels = [level for level in Grade if names[level]]
    if len(levels) == 1:
        sentence = {
            Grade.GOOD: 'Every model may be used on motion like that of the bags.',
            Grade.USABLE: 'Every model may be used with care: mind the reasons below.',
            Grade.DO_NOT_USE: 'None of the models predicts well enough to be relied on.'}
        only = levels[0]
        if only is Grade.DO_NOT_USE and detects is Grade.GOOD:
            return Overall(Grade.USABLE.name.lower(), 'usable to detect collisions',
                           sentence[only] + ' But they detect collisions: see below.')
        return Overall(only.name.lower(), only.value, sentence[only])
    text = '; '.join(f'{level.value}: {", ".join(names[level])}' for level in levels) + '.'
    worst = Grade.USABLE
    word = 'usable in part' if names[Grade.DO_NOT_USE] else 'usable'
    return Overall(worst.name.lower(), word, text[0].upper() + text[1:])


def coefficient_groups(item: FittedOutput, arm: Arm) -> list[CoefficientGroup]:
    """List the coefficients of a model that mean something by themselves."""
    groups = []
    for group in item.model.estimated(arm, item.output):
        rows = []
        for row in group['coefficients']:
            value, error = row['value'], row['standard_error']
            relative = 100.0 * error / abs(value) if value else math.inf
            note = ('not excited' if not row['excited'] else
                    'uncertain' if relative > UNCERTAIN else '')
            rows.append(Coefficient(row['name'], value, row['unit'], error, relative, note))
        excited = all(row['excited'] for row in group['coefficients'])
        groups.append(CoefficientGroup(
            tuple(group['channels']), group['condition'],
            _conditioning(group['condition'], excited), tuple(rows)))
    return groups


def _conditioning(condition: float, excited: bool) -> str:
    if not excited:
        return 'the motion does not show every parameter; the rest are determined'
    if condition <= GOOD_CONDITION:
        return 'well conditioned'
    if condition <= LARGEST_CONDITION:
        return 'some parameters are hard to tell apart; their standard errors say which'
    return 'badly conditioned: predictions hold on similar motion only'


def bag_rows(result: FitResult) -> list[BagRow]:
    """List the bags of a fit, training first."""
    return [_bag_row(bag, role) for role, bags in
            (('training', result.learned), ('validation', result.judged)) for bag in bags]


def _bag_row(bag: BagFacts, role: str) -> BagRow:
    dropped = ', '.join(f'{count} {cause}' for cause, count in sorted(bag.dropped.items())
                        if count)
    return BagRow(bag.bag, role, bag.recorded, bag.used, bag.duration, bag.rate, bag.gaps,
                  bag.longest_gap, dropped or 'none', bag.checksum[:12], bag.warnings)


def other_warnings(result: FitResult) -> list[str]:
    """Give the warnings that no single bag is to blame for."""
    of_bags = {warning for bag in (*result.learned, *result.judged) for warning in bag.warnings}
    return [warning for warning in result.warnings if warning not in of_bags]


def preprocessing_rows(spec: PreprocessingSpec, sample_rate: float) -> list[tuple[str, str]]:
    """Describe filters and rate: sample_rate [Hz]."""
    rows = []
    if spec.filter == 'causal':
        rows += [
            ('Filters', 'causal, as they run next to the robot'),
            ('Velocity', f'difference quotient, first-order low-pass {spec.velocity_cutoff:g} Hz'),
            ('Acceleration', 'difference quotient of the velocity, first-order low-pass '
                             f'{spec.acceleration_cutoff:g} Hz'),
            ('Low-pass over positions, velocities and outputs',
             'none' if spec.output_cutoff is None else f'{spec.output_cutoff:g} Hz')]
    else:
        cutoff = spec.cutoff or sample_rate / 10.0
        rows += [('Filters', f'zero-phase (offline only), Butterworth {cutoff:g} Hz')]
    rows += [
        ('Velocity of the driver', 'used where a bag has it' if spec.measured_velocity else
         'not used'),
        ('Rate', 'every sample' if spec.rate is None else f'decimated to {spec.rate:g} Hz'),
        ('Left out at the start of each stretch' +
         (', and at its end' if spec.filter == 'zero_phase' else ''), f'{spec.settle:g} s')]
    return rows


def sample_rate(result: FitResult) -> float:
    """Give the rate of the first training bag [Hz]."""
    return 1.0 / result.training[0].recording.dt
