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

"""Is a model still what it was: growth of errors against chance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tudor_dynamics.identification.next_steps import changes, spread, touched
from tudor_dynamics.identification.validation import score, Trace, Validation


def _validation(seed: int, error: float, size: float = 10.0, seconds: float = 60.0) -> Validation:
    """Make a prediction of a sine with errors that are correlated over some samples."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 0.05)
    measured = size * np.sin(t)[:, None]
    noise = np.convolve(rng.normal(size=len(t) + 9), np.ones(10) / np.sqrt(10), 'valid')
    predicted = measured + error * noise[:, None]
    stamp = (t * 1e9).astype(np.int64)
    return Validation('x', score(measured, predicted, ('a',)),
                      (Trace('bag', t, stamp, measured, predicted),), ('a',))


def _facts(validation: Validation) -> dict:
    return {'validation': {'effort': {'analytical': {
        'validation': validation.score.as_dict(), 'spread': spread(validation)}}}}


def test_chance_is_no_change() -> None:
    """Other motions of the same arm leave a model what it was, 200 times out of 200."""
    facts = _facts(_validation(0, 1.0))
    for seed in range(1, 201):
        change, = changes(facts, {'effort': {'analytical': _validation(seed, 1.0, seconds=20.0)}})
        assert not change.changed


def test_a_model_that_is_worse() -> None:
    """Errors twice as large are told, with what they were."""
    facts = _facts(_validation(0, 1.0))
    change, = changes(facts, {'effort': {'analytical': _validation(1, 2.0)}})
    assert change.changed and change.sigmas > 3.0
    assert f'the RMS error has grown since the validation; now {change.now:.3g} (' in str(change)
    assert change.now / change.then == pytest.approx(2.0, rel=0.15)


def test_a_short_excess_is_no_change_of_the_model() -> None:
    """A push makes an error large for a moment; friction that changed does so everywhere."""
    facts = _facts(_validation(0, 1.0))
    pushed = _validation(1, 0.9)
    trace, = pushed.traces
    measured = trace.measured + np.where((trace.t > 20.0) & (trace.t < 24.0), 20.0, 0.0)[:, None]
    pushed = replace(pushed, score=score(measured, trace.predicted, ('a',)),
                     traces=(replace(trace, measured=measured),))
    change, = changes(facts, {'effort': {'analytical': pushed}})
    assert change.changed
    assert 'worst at 2' in touched(change, pushed) and 's of bag' in touched(change, pushed)
    worn = _validation(1, 2.0)
    change, = changes(facts, {'effort': {'analytical': worn}})
    assert change.changed and not touched(change, worn)


def test_livelier_motion_is_no_change() -> None:
    """Errors that grow with the output are those of another motion, not of another arm."""
    facts = _facts(_validation(0, 1.0))
    change, = changes(facts, {'effort': {'analytical': _validation(1, 2.0, size=20.0)}})
    assert change.now > 1.7 * change.then and not change.changed


def test_a_bundle_that_knows_nothing() -> None:
    """Nothing is said where the bundle has no figures; old ones have no spread and want more."""
    found = {'effort': {'analytical': _validation(1, 2.0)}}
    assert changes({}, found) == ()
    facts = _facts(_validation(0, 1.0))
    del facts['validation']['effort']['analytical']['spread']
    change, = changes(facts, found)
    assert not change.changed
    assert changes(facts, {'effort': {'analytical': _validation(1, 4.0)}})[0].changed
