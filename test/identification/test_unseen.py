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

"""Motion that a model has not seen: which bags, by which models, and how much of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import pytest
from sample_arms import recording_of

from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.identification.dataset import BagChoice, BagData
from tudor_dynamics.identification.fit import ENOUGH, left_out, PARTS, unseen_cases
from tudor_dynamics.identification.validation import Validation
from tudor_dynamics.signals.preprocessing import prepare

SPEC = PreprocessingSpec(filter='causal', rate=None)


def bag(path: str, seconds: float, gaps: tuple[int, ...] = ()) -> BagData:
    """Make a bag of a moving joint at 50 Hz."""
    t = np.arange(round(50 * seconds)) / 50.0
    q = np.sin(t)[:, None]
    recording = recording_of(q, 50.0, effort=q, gaps=gaps, path=path)
    return BagData(BagChoice(path), recording, prepare(recording, SPEC), None)


@dataclass(frozen=True)
class Knowing:
    """Stands in for a model: knows what it was fitted to."""

    seen: tuple[str, ...] = ()
    has_memory: bool = False
    payload_range: None = None


def fit(bags: Sequence[BagData]) -> Any:
    """Remember the bags."""
    return Knowing(tuple(str(item.choice) for item in bags))


def judged(*bags: BagData) -> Validation:
    """Give a validation by bags that a model of all others predicted."""
    return Validation('bags', cast(Any, None), (), ('j1',), tuple(
        (cast(Any, Knowing(('all others',))), item) for item in bags))


def test_each_bag_is_left_out_once() -> None:
    """Of several bags: the others are what is known."""
    bags = [bag(name, 10.0) for name in 'abc']
    found = left_out(bags, SPEC)
    assert [(''.join(item.choice.path for item in known), one.choice.path)
            for known, one in found] == [('bc', 'a'), ('ac', 'b'), ('ab', 'c')]


def test_the_only_bag_of_a_load_is_left_out_in_parts() -> None:
    """A model of all loads is judged by each load that it knows; bags of one load as before."""
    bags = [replace(bag(name, 10.0), payload=mass) for name, mass in zip(
        'abc', (0.0, 0.0, 0.2), strict=True)]
    assert [one.choice.path for _, one in left_out(bags, SPEC)] == ['a', 'b', 'c']
    found = left_out(bags, SPEC, loads=True)
    assert [one.choice.path for _, one in found] == ['a', 'b', 'c', 'c']
    for known, _ in found[2:]:
        assert [item.payload for item in known] == [0.0, 0.0, 0.2]


@pytest.mark.parametrize(('seconds', 'count'), [
    (40.0, PARTS), (13.0, 3), (8.1, 2), (7.9, 0), (3.0, 0)])
def test_an_only_bag_is_left_out_in_parts(seconds: float, count: int) -> None:
    """As many parts as are long enough; together they are the bag, and none knows itself."""
    whole = bag('a', seconds)
    found = left_out([whole], SPEC)
    assert len(found) == count
    for known, one in found:
        inside = set(one.recording.stamp.tolist())
        outside = {stamp for item in known for stamp in item.recording.stamp.tolist()}
        assert not inside & outside
        assert inside | outside == set(whole.recording.stamp.tolist())


def test_a_part_without_a_stretch_is_passed_over() -> None:
    """Where the middle of a bag is in pieces, the other parts remain."""
    whole = bag('a', 40.0, gaps=tuple(range(420, 780, 5)))
    found = left_out([whole], SPEC)
    assert 0 < len(found) < PARTS


def test_bags_of_the_validation_come_first_and_training_fills_up() -> None:
    """Until there is enough; each by a model that has not seen it."""
    test, training = bag('test', 60.0), [bag(name, 60.0) for name in 'abcd']
    model: Any = Knowing(('a', 'b', 'c', 'd'))
    found = unseen_cases(fit, model, judged(test), left_out(training, SPEC))
    assert [item.choice.path for _, item in found] == ['test', 'a', 'b']
    assert sum(float(item.recording.t[-1]) for _, item in found) >= ENOUGH
    for fitted, item in found[1:]:
        assert item.choice.path not in cast(Any, fitted).seen


def test_bags_that_were_left_out_already_are_not_again() -> None:
    """Leaving one bag out is the validation itself."""
    training = [bag(name, 20.0) for name in 'ab']
    model: Any = Knowing(('a', 'b'))
    validation = judged(*training)
    found = unseen_cases(fit, model, validation, left_out(training, SPEC))
    assert found == validation.cases


def test_an_only_bag_is_taken_in_parts_throughout() -> None:
    """Its end, by which it was judged, counts once."""
    whole = bag('a', 30.0)
    model: Any = Knowing(('a',))
    others = left_out([whole], SPEC)
    found = unseen_cases(fit, model, judged(others[-1][1]), others)
    assert [str(item.choice) for _, item in found] == [str(one.choice) for _, one in others]
    stamps = [stamp for _, item in found for stamp in item.recording.stamp.tolist()]
    assert len(stamps) == len(set(stamps))


def test_models_with_a_memory_are_fitted_to_nothing_else() -> None:
    """They take long; what they were judged by has to do."""
    model: Any = Knowing(('a',), has_memory=True)
    validation = judged(bag('test', 10.0))

    def never(_: Sequence[BagData]) -> Any:
        raise AssertionError('fitted')

    found = unseen_cases(never, model, validation, left_out([bag('a', 40.0)], SPEC))
    assert found == validation.cases
