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

"""Elastic models in the bundle: nothing lost, nothing impossible accepted."""

from __future__ import annotations

from collections.abc import Callable
import copy
import math
from pathlib import Path
from typing import Any

from elastic_making import along, blade_arm, even, GAINS, OFFSETS, travel
import numpy as np
import pytest

from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import ModelError, NotFittedError
from tudor_dynamics.models.bundle import load_bundle, ModelBundle, save_bundle
from tudor_dynamics.models.elastic.model import ElasticModel, PhysicalParameter

ARM = blade_arm()
PHYSICAL = (PhysicalParameter('bending(j1)', 15.25, 'N m^2', 0.125, True),
            PhysicalParameter('play(j2)', 0.003, 'rad', 0.004, False),
            PhysicalParameter('payload', 0.2, 'kg'))


def model_of(output: str, **more: Any) -> ElasticModel:
    """Make a model that has learned something."""
    model = ElasticModel(ARM, output, PHYSICAL, **more)
    model.coefficients_ = (
        tuple(np.column_stack([GAINS, OFFSETS])) if output == 'strain'
        else tuple(np.linspace(0.1, 0.7, len(c)) for c in model.columns))
    model.standard_errors_ = tuple(np.full(len(c), 0.01) for c in model.columns)
    model.noise_ = np.array([2.0, 3.0])
    return model


def same(one: ElasticModel, other: ElasticModel) -> None:
    """Every value to the last bit."""
    for a, b in zip(one.physical, other.physical, strict=True):
        assert (a.name, a.value, a.unit, a.shown) == (b.name, b.value, b.unit, b.shown)
        assert a.standard_error == b.standard_error or (
            math.isnan(a.standard_error) and math.isnan(b.standard_error))
    for name in ('coefficients_', 'standard_errors_'):
        for x, y in zip(getattr(one, name), getattr(other, name), strict=True):
            assert np.array_equal(x, y)
    assert np.array_equal(one.noise_, other.noise_)
    assert one.payload_range == other.payload_range


def test_round_trip_through_a_bundle(tmp_path: Path) -> None:
    """Saved and loaded, effort and strain, it predicts the same to the last bit."""
    before = {output: {'elastic': model_of(output)} for output in ('effort', 'strain')}
    save_bundle(ModelBundle(ARM, PreprocessingSpec(), before, {}), tmp_path / 'model')
    after = load_bundle(tmp_path / 'model')
    q = travel(2.0, 100.0, hold=2.0)
    motion = np.hstack([q, np.gradient(q, 0.01, axis=0), np.zeros_like(q)])
    dt = even(len(q), 100.0)
    for output in ('effort', 'strain'):
        one, other = before[output]['elastic'], after.models[output]['elastic']
        assert isinstance(other, ElasticModel)
        same(one, other)
        assert np.array_equal(along(one, motion, dt), along(other, motion, dt))


def test_round_trip_of_all_payloads() -> None:
    """The range of payloads comes back."""
    model = model_of('strain', payload_range=(0.0, 0.4))
    same(model, ElasticModel.from_dict(model.to_dict(ARM, 'strain'), ARM, 'strain'))


def test_nothing_learned_is_not_saved() -> None:
    """A model without coefficients is refused."""
    with pytest.raises(NotFittedError):
        ElasticModel(ARM, 'strain').to_dict(ARM, 'strain')


def _first(key: str, name: str, value: Any) -> Callable[[dict[str, Any]], None]:
    return lambda content: content[key][0].__setitem__(name, value)


def _coefficient(name: str, value: Any) -> Callable[[dict[str, Any]], None]:
    return lambda content: content['channels'][0]['coefficients'][0].__setitem__(name, value)


@pytest.mark.parametrize(('damage', 'words'), [
    (_first('physical', 'name', 'bending(j9)'), 'bending(j9)'),
    (_first('physical', 'value', math.nan), 'nan'),
    (_first('physical', 'value', -1.0), '0 or more'),
    (_first('physical', 'unit', 'N m'), 'N m^2'),
    (_first('channels', 'channel', 'g7'), 'g7'),
    (_first('channels', 'residual_std', -1.0), 'residual_std'),
    (_first('channels', 'residual_std', math.inf), 'residual_std'),
    (_coefficient('column', 'gain'), 'gain'),
    (_coefficient('value', math.nan), 'expected a finite number'),
    (_coefficient('value', 1e300), 'expected a finite number up to 1e+15'),
    (_first('physical', 'value', 1e300), 'expected a finite number'),
    (_coefficient('standard_error', math.nan), '.inf where the error is unknown, found nan'),
    (lambda content: content['channels'].pop(), 'channels'),
    (lambda content: content['channels'][1]['coefficients'].pop(), 'columns'),
    (lambda content: content.__setitem__('payload_range', [0.4, 0.1]), 'rising masses'),
    (lambda content: content.__setitem__('payload_range', [0.1, math.nan]), 'rising masses')])
def test_damage_is_refused(damage: Callable[[dict[str, Any]], None], words: str) -> None:
    """Unknown parameter, channel or column, wrong unit, no number: told, never used."""
    content = copy.deepcopy(model_of('strain').to_dict(ARM, 'strain'))
    ElasticModel.from_dict(content, ARM, 'strain')
    damage(content)
    with pytest.raises(ModelError) as caught:
        ElasticModel.from_dict(content, ARM, 'strain')
    assert words in str(caught.value)


def test_model_of_an_arm_without_links() -> None:
    """An arm that has lost its links cannot carry the model."""
    content = model_of('strain').to_dict(ARM, 'strain')
    with pytest.raises(ModelError, match='links'):
        ElasticModel.from_dict(content, blade_arm(links=[], motors=[]), 'strain')
