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

"""From a fit to the bundle that is saved, and to the figures that are printed."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from tudor_dynamics.identification.choice.outcome import choices_to_list
from tudor_dynamics.identification.collisions.free_motion import as_plain
from tudor_dynamics.identification.fit import FitResult, FittedOutput
from tudor_dynamics.identification.metrics import rounded
from tudor_dynamics.identification.worth.assessment import assess, Assessment
from tudor_dynamics.identification.worth.bent import bent_links_of
from tudor_dynamics.identification.worth.comparison import spread
from tudor_dynamics.identification.worth.payload_errors import payload_errors
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.bundle import CausalModels, ModelBundle
from tudor_dynamics.payload.bent import FACT


def bundle_of(result: FitResult, assessment: Assessment | None = None) -> ModelBundle:
    """Collect the models of a fit with all that is known of their worth."""
    assessment = assess(result) if assessment is None else assessment
    bent = bent_links_of(result)
    facts = {
        'training': [bag.as_dict() for bag in result.learned],
        'test': [bag.as_dict() for bag in result.judged],
        'validation': figures(result),
        'ringing': [{'channel': r.channel, 'frequency': r.frequency, 'rms': r.rms,
                     'share': r.share} for r in result.ringing],
        'warnings': list(result.warnings), 'choices': choices_to_list(result.choices),
        'findings': [item.as_dict() for item in result.findings],
        **({'unused': [asdict(bag) for bag in result.unused]} if result.unused else {}),
        **assessment.as_dict(), 'thresholds': as_plain(assessment.thresholds),
        'payload_errors': payload_errors(result, bent),
        **({} if bent is None else {FACT: bent.as_dict(result.arm)})}
    causal = None
    if result.causal is not None:
        facts['causal_validation'] = figures(result.causal)
        causal = CausalModels(result.causal.preprocessing, _models(result.causal))
    return ModelBundle(result.arm, result.preprocessing, _models(result), facts, causal)


def _models(result: FitResult) -> dict[str, dict[str, Model]]:
    models: dict[str, dict[str, Model]] = {}
    for item in result.fitted:
        models.setdefault(item.output, {})[item.kind] = item.model
    return models


def figures(result: FitResult) -> dict[str, Any]:
    """Give the figures of a fit as plain values: output, model, then training and validation."""
    content: dict[str, Any] = {}
    for item in result.fitted:
        content.setdefault(item.output, {})[item.kind] = _figures(item)
    return content


def _figures(item: FittedOutput) -> dict[str, Any]:
    content: dict[str, Any] = {
        'verdict': item.verdict.level.value, 'reasons': list(item.verdict.reasons),
        'method': item.validation.method, 'validation': rounded(item.validation.score),
        'spread': {name: float(f'{value:.3g}') for name, value in spread(item.validation).items()},
        'noise': {name: float(f'{value:.3g}') for name, value in zip(
            item.validation.channels, item.noise.tolist(), strict=False)},
        'channel_verdicts': {name: level.value for name, level in item.verdict.channels.items()},
        'training': rounded(item.training.score)}
    if item.random is not None:
        content['random_split_optimistic'] = rounded(item.random.score)
    return content
