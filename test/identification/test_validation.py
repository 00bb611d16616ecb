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

"""Validation on motion that was not learned from, and the verdict's raw material."""

from __future__ import annotations

from collections.abc import Sequence
import warnings

from harmonic_kind import HarmonicModel
import numpy as np
import pytest
from sample_arms import multisine, recording_of

from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import TudorWarning
from tudor_dynamics.identification.dataset import BagChoice, BagData
from tudor_dynamics.identification.fit import left_out
from tudor_dynamics.identification.validation import cases_of, method_of, trace, validated
from tudor_dynamics.signals.preprocessing import prepare
from tudor_dynamics.typing import FloatArray

SPEC = PreprocessingSpec(rate=20.0)


class Constant(HarmonicModel):
    """Predicts the mean of what it was fitted to."""

    def __init__(self, level: FloatArray) -> None:
        super().__init__(('a', 'b'))
        self.level = level

    def predict(self, motion: FloatArray) -> FloatArray:
        """Give the mean for each sample."""
        return np.tile(self.level, (len(motion), 1))


def _bag(level: float, spec: PreprocessingSpec = SPEC) -> BagData:
    q = multisine(np.arange(600) * 0.01, 2)[:, :2]
    recording = recording_of(q, 100.0, strain=np.full((600, 2), level), gaps=(300,),
                             path=f'bag{level:g}')
    return BagData(BagChoice(recording.path), recording, tuple(prepare(recording, spec)))


def test_no_bag_is_judged_by_what_it_taught() -> None:
    """Each bag is predicted by a model of the others alone."""
    bags = [_bag(level) for level in (1.0, 10.0, 100.0)]
    fitted: list[set[str]] = []

    def fit(some: Sequence[BagData]) -> Constant:
        fitted.append({str(bag.choice) for bag in some})
        return Constant(np.mean([bag.recording.strain[0] for bag in some], axis=0))

    found = validated([(fit(known), bag) for known, bag in left_out(bags, SPEC)], 'strain',
                      method_of([], len(bags), len(bags)))
    assert found.method == 'leave one bag out, 3 bags'
    for item, names in zip(found.traces, fitted, strict=True):
        assert item.bag not in names and len(names) == 2
    expected = [[55.0, 50.5, 5.5]] * 2
    assert np.allclose([[t.predicted[0, i] for t in found.traces] for i in range(2)], expected)
    assert found.score.samples == sum(bag.samples for bag in bags)


@pytest.mark.parametrize('kind', ['causal', 'zero_phase'])
def test_traces_carry_time(kind: str) -> None:
    """A trace has the stamps of the samples used, over all stretches of a bag."""
    bag = _bag(3.0, PreprocessingSpec(filter=kind, rate=20.0))
    found = trace(Constant(np.array([3.0, 4.0])), bag, 'strain')
    assert len(found.t) == len(found.stamp) == len(found.measured) == bag.samples
    assert np.all(np.diff(found.stamp) > 0)
    assert np.allclose((found.stamp - bag.recording.stamp[0]) * 1e-9, found.t)
    assert np.max(np.diff(found.t)) > 2.0  # the gap
    assert np.allclose(found.measured, 3.0) and np.allclose(found.predicted[:, 1], 4.0)


def test_an_unknown_past_is_said() -> None:
    """Where a bag begins in motion, or after a gap in it, and no strain shows the links."""
    class Remembering(Constant):
        has_memory = True

    def read(q: FloatArray, **outputs: FloatArray) -> BagData:
        recording = recording_of(q, 100.0, gaps=(300,), path='bag', **outputs)
        return BagData(BagChoice('bag'), recording, tuple(prepare(recording, SPEC)))
    model, q = Remembering(np.zeros(2)), multisine(np.arange(600) * 0.01, 2)[:, :2]
    with pytest.warns(TudorWarning, match='begins in motion, or goes on so after a gap, w'):
        trace(model, read(q, effort=np.zeros((600, 2))), 'effort')
    rest = np.repeat(np.interp(np.arange(600), [100, 250, 350, 600], [0.0, 1.0, 1.0, 0.0])[
        :, None], 2, axis=1)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        trace(model, read(rest, effort=np.zeros((600, 2))), 'effort')
        trace(model, read(q, effort=np.zeros((600, 2)), strain=np.zeros((600, 2))), 'effort')
        trace(Constant(np.zeros(2)), read(q, effort=np.zeros((600, 2))), 'effort')


def test_validate() -> None:
    """Figures are over all samples of all bags."""
    found = validated(cases_of(Constant(np.zeros(2)), [_bag(3.0), _bag(4.0)]), 'strain',
                      'two bags')
    assert found.method == 'two bags'
    assert found.score.rmse == pytest.approx(np.sqrt((9 + 16) / 2))
    assert found.channels == ('a', 'b')
