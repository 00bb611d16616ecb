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

"""Bags added to a model, or taken from it, without going through the others again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import ModelError, UsageError
from tudor_dynamics.identification.bag_choice import parse_choice
from tudor_dynamics.identification.bag_facts import facts_of
from tudor_dynamics.identification.dataset import BagData, load, training_blocks
from tudor_dynamics.identification.part_errors import part_errors
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.bundle import CausalModels, ModelBundle
from tudor_dynamics.models.estimation.products import Products, triangular
from tudor_dynamics.typing import FloatArray

Part = list[list[Products]]


@dataclass(frozen=True, eq=False)
class Changed:
    """A bundle with other bags."""

    # Its models are those of a fit to all its bags with the same choices. Validation and
    # thresholds among its facts are still of the model before.
    bundle: ModelBundle
    # Output to bag to the relative error of each channel, when this bag alone is left out.
    left_out: dict[str, dict[str, FloatArray]]


def change_bags(
    bundle: ModelBundle, add: Sequence[str] = (), drop: Sequence[str] = (),
) -> Changed:
    """Add bags to the models of a bundle, and take others away."""
    names = _parts(bundle)
    choices = [parse_choice(text) for text in add]
    keys = [str(choice) for choice in choices]
    missing = [name for name in drop if name not in names]
    if missing:
        raise UsageError(f'--drop {missing[0]}: the model was not fitted to it',
                         remedy=f'name one of {", ".join(names)}')
    again = [key for key in keys if key in names and key not in drop]
    if again:
        raise UsageError(f'--add {again[0]}: the model was fitted to it already',
                         remedy='leave it out')
    if not {*names} - {*drop} and not keys:
        raise UsageError('no bag would be left to learn from', remedy='drop fewer bags')
    facts = dict(bundle.facts)
    listed = facts.get('training')
    training = [item for item in (listed if isinstance(listed, list) else [])
                if isinstance(item, dict) and item.get('bag') not in drop]
    data = [load(choice, bundle.arm, bundle.preprocessing, learn=True) for choice in choices]
    _refuse_copies(data, training)
    facts['training'] = [*training, *(facts_of(bag).as_dict() for bag in data)]
    history = facts.get('changed')
    facts['changed'] = [*(history if isinstance(history, list) else []),
                        {'added': keys, 'dropped': list(drop)}]
    models = _changed(bundle.arm, bundle.models, data, drop)
    causal = None
    if bundle.causal is not None:
        spec = bundle.causal.preprocessing
        others = [load(choice, bundle.arm, spec, learn=True) for choice in choices]
        causal = CausalModels(spec, _changed(bundle.arm, bundle.causal.models, others, drop))
    left_out = {output: _left_out(model) for output, kinds in models.items()
                for model in kinds.values() if isinstance(model, AnalyticalModel)}
    return Changed(replace(bundle, models=models, causal=causal, facts=facts), left_out)


def _parts(bundle: ModelBundle) -> list[str]:
    """Name the bags; refuse models that are no sum over them."""
    sets = [bundle.models, *([] if bundle.causal is None else [bundle.causal.models])]
    names: list[str] | None = None
    for output, kind, model in ((output, kind, model) for models in sets
                                for output, kinds in models.items()
                                for kind, model in kinds.items()):
        if not isinstance(model, AnalyticalModel):
            raise ModelError(f'the {kind} model of {output} is no sum over its bags',
                             remedy='fit again, with all of them')
        listed = bundle.facts.get('training')
        own = [item.get('bag') for item in (listed if isinstance(listed, list) else [])
               if isinstance(item, dict)]
        if not model.data_ or {*model.data_} != {*own}:
            raise ModelError(
                f'the {kind} model of {output} has not kept what each of its bags came to (older '
                "models, Huber's estimator, friction that grows with the load, and more than "
                '100 MB of data keep none, or their sum alone)',
                remedy='fit again, with all bags')
        names = list(model.data_) if names is None else names
    return names or []


def _refuse_copies(data: Sequence[BagData], training: Sequence[Mapping[str, Any]]) -> None:
    for bag in data:
        for item in training:
            same = item.get('sha256') == bag.recording.checksum
            if same and bag.choice.overlaps(parse_choice(str(item.get('bag')))):
                raise UsageError(f'--add {bag.choice}: the same samples as {item["bag"]}, which '
                                 'the model was fitted to', remedy='leave it out')


def _changed(
    arm: Arm, models: Mapping[str, Mapping[str, Model]], data: Sequence[BagData],
    drop: Sequence[str],
) -> dict[str, dict[str, Model]]:
    return {output: {kind: _one(model, output, data, drop) for kind, model in kinds.items()}
            for output, kinds in models.items()}


def _one(
    model: Model, output: str, data: Sequence[BagData], drop: Sequence[str],
) -> AnalyticalModel:
    """Fit one model to the sum of what stays and what comes."""
    assert isinstance(model, AnalyticalModel)
    lacking = [str(bag.choice) for bag in data if not bag.has(output)]
    if lacking:
        raise UsageError(f'--add {lacking[0]}: it has no {output}, of which there is a model',
                         remedy='add bags with all outputs of the model')
    kept = {name: part for name, part in model.data_.items() if name not in drop}
    factors = triangular(model.data_.values())
    for bag in data:
        blocks = training_blocks([bag], output, with_payload=model.payload_range is not None,
                                 inputs=model.inputs)
        kept[str(bag.choice)] = model.products(blocks, triangular=factors)
    return model.like().fit_data(kept)


def _left_out(model: AnalyticalModel) -> dict[str, FloatArray]:
    """Leave each bag out once, and give the relative errors on it."""
    found = {}
    for name, part in model.data_.items():
        others = {other: item for other, item in model.data_.items() if other != name}
        if not others:
            continue
        blind = model.like().fit_data(others)
        errors = part_errors(blind, part)
        found[name] = np.sqrt(errors.squares / np.maximum(errors.power, 1e-300))
    return found
