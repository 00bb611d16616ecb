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

"""From bags to elastic models: what counts of a bag, what is found, and refusals."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

from elastic_making import (
    blade_arm, even, GAINS, lone_arm, LONE_EFFORT, lone_recording, LONE_TRUTH, OFFSETS, recorded,
    travel)
import numpy as np
import pytest
from sample_arms import recording_of

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.errors import FitError
from tudor_dynamics.identification.dataset import BagChoice, BagData, cut, filtered, part
from tudor_dynamics.identification.elastic_problem import (
    Identified, Record, record_of, records_of, RUN_IN)
from tudor_dynamics.identification.fit import (
    check_arm, ElasticTrainer, fit_models, FitResult, FitSettings, left_out)
from tudor_dynamics.identification.validation import Grade, trace
from tudor_dynamics.models.elastic.model import ElasticModel
from tudor_dynamics.signals.preprocessing import prepare
from tudor_dynamics.typing import FloatArray

RATE = 100.0
ARM = blade_arm()
SPEC = PreprocessingSpec(filter='causal', rate=None)


def whole(seconds: float = 24.0, gaps: tuple[int, ...] = ()) -> Recording:
    """Give a recording of the arm as described."""
    q = travel(seconds, RATE, 3)
    strain, response = recorded(ARM, {}, q, RATE, noise=0.0)
    return recording_of(q, RATE, strain=strain, effort=response.torque, gaps=gaps)


def model_of_it() -> ElasticModel:
    """Give the true model of the strain."""
    model = ElasticModel(ARM, 'strain')
    model.coefficients_ = (np.array([70.0, 12.0]), np.array([90.0, -7.0]))
    return model


def test_a_part_knows_what_was_before() -> None:
    """``BAG@50-100%`` begins in the oscillation of its first half, not at rest."""
    recording = whole()
    half = cut(recording, BagChoice('bag', 0.5, 1.0))
    assert half.earlier is not None
    first = len(recording.stamp) - len(half.stamp)
    assert np.array_equal(half.earlier[0], recording.stamp[:first])
    assert np.array_equal(half.earlier[1], recording.q[:first])
    (stretch,) = prepare(half, SPEC)
    assert stretch.before is not None and len(stretch.before) == first
    assert stretch.since == pytest.approx(0.01, abs=1e-9)
    assert stretch.before[1:, 0] == pytest.approx(0.01, abs=1e-9)
    predicted = model_of_it().follow(stretch)
    assert recording.strain is not None
    assert np.abs(predicted - recording.strain[first:]).max() < 1e-3
    alone = model_of_it().follow(replace(stretch, before=None))
    assert np.abs(alone - recording.strain[first:])[:50].max() > 1.0


def test_parts_of_parts() -> None:
    """A part of a part remembers all the way; a whole, a first half and a gap have no before."""
    recording = whole()
    quarter = cut(cut(recording, BagChoice('bag', 0.5, 1.0)), BagChoice('bag', 0.5, 1.0))
    assert quarter.earlier is not None
    first = len(recording.stamp) - len(quarter.stamp)
    assert np.array_equal(quarter.earlier[0], recording.stamp[:first])
    assert recording.earlier is None
    assert cut(recording, BagChoice('bag', 0.0, 0.5)).earlier is None
    broken = whole(gaps=(1500,))
    part = cut(broken, BagChoice('bag', 0.5, 1.0))
    assert part.earlier is not None
    assert prepare(part, SPEC)[-1].before is None  # after the gap nothing before counts
    after = cut(broken, BagChoice('bag', 0.75, 1.0))
    assert after.earlier is not None
    assert after.earlier[0][0] == broken.stamp[1500]


def stretch_of(q: FloatArray, **more: FloatArray | None) -> object:
    """Give the stretch of a recording."""
    (stretch,) = prepare(recording_of(q, RATE, **more), SPEC)  # type: ignore[arg-type]
    return stretch


def test_what_counts_of_a_stretch() -> None:
    """All where it rests first or its past is known; else what comes after a run-in."""
    recording = whole()
    resting = record_of(prepare(recording, SPEC)[0], 0.2)
    assert resting is not None and resting.skip < 100 and resting.payload == 0.2
    part = cut(recording, BagChoice('bag', 3.4 / 24.0, 1.0))  # in the middle of a ramp
    (stretch,) = prepare(part, SPEC)
    assert np.abs(stretch.states.dq[:30]).max() > 0.05
    known = record_of(stretch, None)
    assert known is not None and known.skip < 100 and known.before is not None
    assert known.dt[0] == pytest.approx(0.01)
    unknown = record_of(replace(stretch, before=None), None)
    assert unknown is not None and unknown.skip == pytest.approx(RUN_IN * RATE, abs=2)
    short = cut(recording, BagChoice('bag', 0.0, 0.3))
    assert record_of(prepare(short, SPEC)[0], None) is None
    bare = replace(recording, strain=None)
    assert record_of(prepare(bare, SPEC)[0], None) is None


def bag(recording: Recording, payload: float | None = None) -> BagData:
    """Make a bag of a recording."""
    path = 'runs/one' if recording.path == 'bag' else recording.path
    return BagData(BagChoice(path, 0.0, 1.0), recording, prepare(recording, SPEC), payload)


@pytest.fixture(scope='module')
def fitted() -> FitResult:
    """Fit the one blade, from a description whose stiffness, play and damping are wrong."""
    return fit_models(
        lone_arm(), [bag(lone_recording(3, 10.0), 0.2)], [bag(lone_recording(4, 10.0), 0.2)], None,
        SPEC, FitSettings(kinds=('analytical', 'elastic')))


def test_both_outputs_of_one_search(fitted: FitResult) -> None:
    """Strain and effort stand on one arm, are judged by the test bag, and beat the rigid model."""
    found = {(item.output, item.kind): item for item in fitted.fitted}
    assert list(found) == [(output, kind) for output in ('effort', 'strain')
                           for kind in ('analytical', 'elastic')]
    models = [found[output, 'elastic'].model for output in ('effort', 'strain')]
    assert all(isinstance(model, ElasticModel) for model in models)
    assert models[0].values == models[1].values  # type: ignore[attr-defined]
    assert found['strain', 'elastic'].validation.score.fit > 97.0
    assert found['strain', 'elastic'].validation.score.fit > (
        found['strain', 'analytical'].validation.score.fit + 10.0)
    assert found['effort', 'elastic'].validation.score.fit > 93.0
    assert found['strain', 'elastic'].verdict.level is Grade.GOOD
    assert found['strain', 'elastic'].validation.method == 'test bag runs/4'


def test_what_the_arm_is(fitted: FitResult) -> None:
    """Physical parameters, gauge, motor and payload as they were, with their standard errors."""
    assert fitted.elastic is not None
    physical = {parameter.name: parameter for parameter in fitted.elastic.physical}
    for name, truth in LONE_TRUTH.items():
        assert physical[name].shown
        assert physical[name].value == pytest.approx(truth, rel=0.1 if name == 'beta' else 0.03)
    assert physical['lumped(j1,1)'].value == pytest.approx(0.8, rel=0.02)
    models = {item.output: item.model for item in fitted.fitted if item.kind == 'elastic'}
    strain, effort = models['strain'], models['effort']
    assert isinstance(strain, ElasticModel) and isinstance(effort, ElasticModel)
    assert strain.values == {**{n: p.value for n, p in physical.items()}, 'payload': 0.2}
    assert strain.coefficients_ is not None and effort.coefficients_ is not None
    assert strain.coefficients_[0] == pytest.approx([GAINS[0], OFFSETS[0]], rel=0.03)
    assert strain.noise_ == pytest.approx([2.0], rel=0.15)
    needed = dict(zip(effort.columns[0], effort.coefficients_[0], strict=True))
    assert {name: needed[name] for name in LONE_EFFORT} == pytest.approx(LONE_EFFORT, rel=0.1)


def test_a_search_is_taken_over_behind_another_filter(
    fitted: FitResult, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The same bags after another filter: no search, the same arm, gauges and figures again."""
    def never(*_: object, **__: object) -> Identified:
        raise AssertionError('searched again')

    monkeypatch.setattr('tudor_dynamics.identification.fit.identify', never)
    spec = PreprocessingSpec(filter='zero_phase', cutoff=20.0, rate=None)
    again = fit_models(
        lone_arm(), *([filtered(item, spec) for item in some]
                      for some in (fitted.training, fitted.test)),
        None, spec, FitSettings(kinds=('elastic',)), known=fitted.searches)
    assert again.elastic is not None and fitted.elastic is not None
    assert {p.name: p.value for p in again.elastic.physical} == pytest.approx(
        {p.name: p.value for p in fitted.elastic.physical}, rel=1e-9)
    for item in again.fitted:
        assert item.validation.score.fit > 90.0, item.output
    assert not np.array_equal(again.elastic.gauges, fitted.elastic.gauges)


class Search:
    """Stands in for the search: what it gives depends on the bags and on where it began."""

    def __init__(self, found: Identified) -> None:
        self.found = found
        self.calls: list[tuple[list[float], dict[str, float] | None]] = []

    def __call__(self, arm: Arm, records: list[Record], **more: Any) -> Identified:
        """Stiffen the first gear by what the records measured, and by where it began."""
        sizes, warm = [float(np.abs(record.strain).mean()) for record in records], more['warm']
        self.calls.append((sizes, warm))
        first, *others = self.found.physical
        value = 1e-3 * sum(sizes) + (1.0 if warm is None else 1.0 + 0.1 * warm[first.name])
        return replace(self.found, physical=(
            replace(first, value=first.value * value), *others), fit=float(len(self.calls)))


@pytest.fixture
def search(fitted: FitResult, monkeypatch: pytest.MonkeyPatch) -> Search:
    """Replace the search."""
    assert fitted.elastic is not None
    made = Search(fitted.elastic)
    monkeypatch.setattr('tudor_dynamics.identification.fit.identify', made)
    return made


def runs(*seeds: int) -> list[BagData]:
    """Make a bag of each seed."""
    return [one_run(seed) for seed in seeds]


@lru_cache
def one_run(seed: int) -> BagData:
    """Make a bag."""
    return bag(lone_recording(seed, 9.0), 0.2)


def test_both_outputs_share_a_search(search: Search) -> None:
    """The same bags are searched once; given parameters are where every search begins."""
    trainer, bags = ElasticTrainer(lone_arm()), runs(3, 4)
    first = trainer.fit(bags, 'strain')
    assert trainer.fit(bags, 'effort').values == first.values
    assert len(search.calls) == 1 and search.calls[0][1] is None
    found, = trainer.searches.values()
    assert found.fit == 1.0
    known = dict(first.values)
    told = ElasticTrainer(lone_arm(), warm=known)
    told.fit(bags, 'strain')
    told.fit(bags[:1], 'strain')
    assert [warm for _, warm in search.calls[1:]] == [known, known]


@pytest.mark.parametrize('count', [2, 3, 4])
@pytest.mark.parametrize('left', [0, -1])
def test_a_fold_knows_nothing_of_what_is_left_out(
    search: Search, count: int, left: int,
) -> None:
    """Another recording in the place of the one left out: the very same model and prediction."""
    seeds, models, traces = list(range(3, 3 + count)), [], []
    judged = runs(seeds[left])[0]
    for seed in (seeds[left], 99):
        seeds[left] = seed
        bags, trainer = runs(*seeds), ElasticTrainer(lone_arm())
        trainer.fit(bags, 'strain')
        others = [item for k, item in enumerate(bags) if k != left % count]
        models.append(trainer.fit(others, 'strain'))
        traces.append(trace(models[-1], judged, 'strain').predicted)
    assert models[0].values == models[1].values
    assert np.array_equal(*traces)


def test_a_half_that_is_too_short(search: Search) -> None:
    """Where a half of the bags shows nothing by itself, folds that have it begin from nothing."""
    short = bag(lone_recording(3, 5.0), 0.2)
    bags, trainer = [short, *runs(4, 5)], ElasticTrainer(lone_arm())
    trainer.fit(bags, 'strain')
    trainer.fit([short, bags[1]], 'strain')
    assert [warm for _, warm in search.calls] == [None, None]


def test_what_is_held_out_of_an_only_bag(search: Search) -> None:
    """The part that is kept is searched from nothing, and the whole begins where that ended."""
    known: list[dict[str, float]] = []
    for changed in (False, True):
        whole_bag = bag(lone_recording(3, 12.0), 0.2)
        kept, held = (part(whole_bag, *span, SPEC) for span in ((0.0, 0.75), (0.75, 1.0)))
        assert held.recording.strain is not None and whole_bag.recording.strain is not None
        if changed:
            strain = whole_bag.recording.strain.copy()
            strain[-len(held.recording.strain):] *= 1.5
            whole_bag = bag(replace(whole_bag.recording, strain=strain), 0.2)
        trainer = ElasticTrainer(lone_arm(), kept=[kept])
        whole_model = trainer.fit([whole_bag], 'strain')
        part_model = trainer.fit([kept], 'strain')
        assert whole_model.values != part_model.values
        (_, first), (_, second) = search.calls[-2:]
        assert first is None
        assert second == {k: v for k, v in part_model.values.items() if k != 'payload'}
        known.append(part_model.values)
        assert trainer.searches[str(whole_bag.choice),].fit == len(search.calls)
    assert known[0] == known[1]


def test_folds_begin_at_half_of_the_bags(search: Search) -> None:
    """Where there are enough bags, each half is searched from nothing, and folds are not."""
    bags, trainer = runs(3, 4, 5, 6), ElasticTrainer(lone_arm())
    trainer.fit(bags, 'strain')
    search.calls.clear()
    for known, _ in left_out(bags, SPEC):
        trainer.fit(known, 'strain')
    assert [len(sizes) for sizes, warm in search.calls if warm is None] == [2, 2]
    assert [len(sizes) for sizes, warm in search.calls if warm is not None] == 4 * [3]


@pytest.mark.parametrize('missing', ['strain', 'time', 'links'])
def test_bags_that_do_not_allow_it(missing: str) -> None:
    """No strain, too short, or an arm without links: one line that says so."""
    arm, recording = ARM, whole()
    if missing == 'strain':
        recording = replace(recording, strain=None)
    elif missing == 'time':
        recording = cut(recording, BagChoice('bag', 0.0, 0.25))
    else:
        arm = blade_arm(links=[], motors=[])
    with pytest.raises(FitError) as caught:
        check_arm(arm)
        records_of([bag(recording)])
    text = str(caught.value)
    assert '\n' not in text and 'leave elastic out of models=' in text
    assert ('links' if missing == 'links' else 'runs/one') in text


def test_even_times() -> None:
    """Times between samples come from the stamps."""
    recording = whole(10.0)
    made = record_of(prepare(recording, SPEC)[0], None)
    assert made is not None
    assert made.dt == pytest.approx(even(len(recording.q), RATE), abs=1e-9)
