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

"""From bags to elastic models: what counts of a bag, the motion before a cut, and refusals."""

from __future__ import annotations

from dataclasses import replace

from elastic_making import blade_arm, even, FloatArray, recorded, travel
import numpy as np
import pytest
from sample_arms import recording_of

from tudor_dynamics.arm import PreprocessingSpec
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.errors import FitError
from tudor_dynamics.identification.dataset import BagChoice, BagData, cut
from tudor_dynamics.identification.elastic import ElasticTrainer, record_of, RUN_IN
from tudor_dynamics.models.elastic import ElasticModel
from tudor_dynamics.models.following import predict_stretch
from tudor_dynamics.signals import prepare

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
    predicted = predict_stretch(model_of_it(), stretch)
    assert recording.strain is not None
    assert np.abs(predicted - recording.strain[first:]).max() < 1e-3
    alone = predict_stretch(model_of_it(), replace(stretch, before=None))
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
    assert prepare(part, SPEC)[-1].before is None  # behind the gap nothing before counts
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


def bag(recording: Recording) -> BagData:
    """Make a bag of a recording."""
    return BagData(BagChoice('runs/one', 0.0, 1.0), recording, prepare(recording, SPEC))


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
        ElasticTrainer(arm).fit([bag(recording)], 'strain')
    text = str(caught.value)
    assert '\n' not in text and 'leave it out of --models' in text
    assert ('links' if missing == 'links' else 'runs/one') in text


def test_even_times() -> None:
    """Times between samples come from the stamps."""
    recording = whole(10.0)
    made = record_of(prepare(recording, SPEC)[0], None)
    assert made is not None
    assert made.dt == pytest.approx(even(len(recording.q), RATE), abs=1e-9)
