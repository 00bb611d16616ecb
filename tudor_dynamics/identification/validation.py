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
Validation: what a model is worth on motion that it has not seen.

By whole bag, as Malzahn et al. do by whole stimuli: the samples of one bag are neighbours in
time, so that leaving out single samples at random shows a model nearly the same samples twice.
That split is offered for comparison, and called optimistic.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
import operator

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.errors import FitError
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.identification.metrics import Score, Tally, tally
from tudor_dynamics.identification.payloads import model_for
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.training import Inputs
from tudor_dynamics.typing import FloatArray


STANDING = 0.02
"""Slower joints stand [rad/s or m/s]."""
SLOW = 0.05
"""The same as a share of the largest speed, where that is less."""


@dataclass(frozen=True, eq=False)
class Trace:
    """Measured against predicted output of one bag, at the samples used."""

    bag: str  # bag, or part of one
    t: FloatArray  # time since the start of the bag, (samples,) [s]
    stamp: NDArray[np.int64]  # header stamps, (samples,) [ns]
    # Outputs in their units, (samples, channels).
    measured: FloatArray
    predicted: FloatArray
    # (samples, channels): whether the joint of each channel moves, of a strain any joint.
    moving: NDArray[np.bool_] | None = None

    def tally(self) -> Tally:
        """Sum up the prediction for figures over several bags."""
        return tally(self.measured, self.predicted, self.moving)


@dataclass(frozen=True, eq=False)
class Validation:
    """Result of a validation of one model for one output."""

    method: str  # how it was done, in words
    score: Score  # figures over all samples of all bags
    traces: tuple[Trace, ...]  # one for each bag
    channels: tuple[str, ...]  # names of the channels
    # Each bag with the model that predicted it; empty for a random split.
    cases: tuple[tuple[Model, BagData], ...] = ()

    def __repr__(self) -> str:
        """Write how it was done, and the fit of each channel."""
        channels = ', '.join(f'{name} {item.fit:.1f} %'
                             for name, item in self.score.channels.items())
        return f'Validation by {self.method}: fit {self.score.fit:.1f} % ({channels})'


def trace(model: Model, data: BagData, output: str) -> Trace:
    """Predict an output over a bag; nothing but motion goes into the model."""
    parts = [(s.t[s.decimation.keep], s.stamp[s.decimation.keep],
              s.decimation(getattr(s, output)), model.follow_kept(s),
              np.abs(s.states.dq[s.decimation.keep]))
             for s in data.stretches]
    t, stamp, measured, predicted, speed = (
        np.concatenate(column) for column in zip(*parts, strict=True))
    # a slow arm moves too: its own largest speed is the measure
    moving = speed > np.minimum(STANDING, SLOW * speed.max(axis=0))
    if output != 'effort':
        moving = np.repeat(moving.any(axis=1)[:, None], measured.shape[1], axis=1)
    return Trace(str(data.choice), t, stamp, measured, predicted, moving)


def validate(
    model: Model, data: Sequence[BagData], output: str, method: str,
) -> Validation:
    """Judge a fitted model on bags."""
    cases = [(model_for(model, bag), bag) for bag in data]
    return _summary([trace(at, bag, output) for at, bag in cases], model.channels, method, cases)


def _summary(
    traces: list[Trace],
    channels: tuple[str, ...],
    method: str,
    cases: Sequence[tuple[Model, BagData]] = (),
) -> Validation:
    total = reduce(operator.add, (item.tally() for item in traces))
    return Validation(method, total.score(channels), tuple(traces), channels, tuple(cases))


def leave_one_bag_out(
    fit: Callable[[Sequence[BagData]], Model], data: Sequence[BagData], output: str,
) -> Validation:
    """Predict each bag by a model fitted to the others."""
    traces, cases = [], []
    for i, bag in enumerate(data):
        model = model_for(fit([other for j, other in enumerate(data) if j != i]), bag)
        traces.append(trace(model, bag, output))
        cases.append((model, bag))
    return _summary(traces, model.channels, f'leave one bag out, {len(data)} bags', cases)


def validate_unseen(
    fit: Callable[[Sequence[BagData]], Model], model: Model,
    training: Sequence[BagData], test: Sequence[BagData],
    holdout: tuple[BagData, BagData] | None, output: str,
) -> Validation:
    """Judge by what a model has not seen: test bags, each bag left out, or a part held out."""
    if test:
        names = ', '.join(str(bag.choice) for bag in test)
        return validate(model, test, output, f'test bag {names}' if len(test) == 1
                        else f'{len(test)} test bags')
    if len(training) > 1:
        return leave_one_bag_out(fit, training, output)
    if holdout is None:
        msg = 'one training bag, no test bag and nothing held out: the fit cannot be judged'
        raise FitError(msg)
    first, last = holdout
    share = last.recording.t[-1] / (first.recording.t[-1] + last.recording.t[-1])
    return validate(fit([first]), [last], output,
                    f'the last {100 * share:.0f} % of the only bag, fitted to the rest')


def random_split(
    fit: Callable[[FloatArray, FloatArray], Model],
    data: Sequence[BagData],
    output: str,
    *,
    inputs: Inputs,
    seed: int = 0,
) -> Validation:
    """Train on a random half of the samples and test on the other (optimistic)."""
    generator = np.random.default_rng(seed)
    motions, values, halves, times, stamps = [], [], [], [], []
    for bag in data:
        for s in bag.stretches:
            motions.append(inputs(s)[s.decimation.keep])
            values.append(s.decimation(getattr(s, output)))
            halves.append(generator.permutation(s.n_kept) < s.n_kept // 2)
            times.append(s.t[s.decimation.keep])
            stamps.append(s.stamp[s.decimation.keep])
    motion, value, train = np.vstack(motions), np.vstack(values), np.concatenate(halves)
    model = fit(motion[train], value[train])
    item = Trace('random half', np.concatenate(times)[~train], np.concatenate(stamps)[~train],
                 value[~train], model.predict(motion[~train]))
    return _summary([item], model.channels, 'random half of the samples (optimistic)')
