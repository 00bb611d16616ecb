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

"""Loads of bags by a fitted model, how bending was found, and the bundle of a fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
import math
from typing import Any

import numpy as np

from tudor_dynamics.errors import TudorError, UsageError
from tudor_dynamics.identification.dataset import BagData, motion_span, part
from tudor_dynamics.identification.fit import choices_to_list, FitResult, RowTrainer
from tudor_dynamics.identification.next_steps import assess, Assessment, spread
from tudor_dynamics.identification.tool import tool_of_bags
from tudor_dynamics.identification.uses import as_plain
from tudor_dynamics.identification.validation import rounded
from tudor_dynamics.load.bending import (
    bent_links, BentLinks, FACT, find_bending, KIND, relearned, Watched)
from tudor_dynamics.load.offline import estimate_payload, PayloadEstimate, Presence
from tudor_dynamics.load.rows import LoadWorth, Source
from tudor_dynamics.load.settings import CUTOFF
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.bundle import CausalModels, ModelBundle
from tudor_dynamics.signals.filters import SmoothStates


# -- How the links of a fit's arm bend: what its training bags show of it

def bent_links_of(result: FitResult) -> BentLinks | None:
    """Find how links bend; None where strain shows no kilograms, or links hardly bend."""
    model = next((item.model for item in result.fitted
                  if (item.output, item.kind) == ('strain', KIND)), None)
    if not isinstance(model, AnalyticalModel):
        return None
    try:
        if (model.payload_range is None
                and LoadWorth(result.arm, 'strain', model).source is Source.NOTHING):
            return None
        return find_bending(result.arm, model, [
            item for bag in result.training for item in watched(bag)])
    except TudorError:
        return None  # rigid links tell loads as well, if less so


def watched(bag: BagData) -> list[Watched]:
    """Give the stretches of a bag that move, as they were read, and what filters settle on."""
    recording = bag.recording
    if recording.strain is None:
        return []
    begin, end = motion_span(recording)
    t, found = recording.t, []
    for segment in recording.segments:
        first = max(segment.start, int(np.searchsorted(t, begin - SmoothStates(CUTOFF).settle)))
        inside = slice(first, min(segment.stop, int(np.searchsorted(t, end, 'right'))))
        strain, stamps = recording.strain[inside], recording.stamp[inside]
        if len(stamps) < 2 or not np.isfinite(strain).all():
            continue
        dt = np.diff(stamps) * 1e-9
        found.append(Watched(np.concatenate([dt[:1], dt]), recording.q[inside], strain,
                             bag.payload or 0.0, float(t[first])))
    return found


# -- How far off a load is that a model tells, on motion with a known load that it has not seen

PARTS = 4  # into which all training bags are cut; each part is left out once


def payload_errors(result: FitResult, bent: BentLinks | None = None) -> dict[str, float]:
    """Let models of a part of the training motion estimate the known load of the rest."""
    # what their errors have beyond the standard deviations of their own residuals is the error of
    # the models, a little more than that of a model of all the motion
    try:
        pieces = [[part(bag, i / PARTS, (i + 1) / PARTS, result.preprocessing)
                   for bag in result.training] for i in range(PARTS)]
    except TudorError:
        return {}  # too short to be cut
    found = {}
    for item in result.fitted:
        if item.kind != KIND:
            continue
        trainer = RowTrainer(KIND, result.arm, result.settings)
        errors, variances = [], []
        for i, left in enumerate(pieces):
            known = [bag for j, bags in enumerate(pieces) if j != i for bag in bags]
            try:
                model = trainer.fit(known, item.output)
                links = None
                if bent is not None and item.output == 'strain':
                    links = relearned(bent, [one for bag in known for one in watched(bag)])
                for bag in left:
                    seen = estimate_payload(
                        result.arm, {item.output: model}, bag.stretches, known=bag.payload or 0.0,
                        whole=False, bent=links, watched=[] if links is None else watched(bag))
                    if seen.verdict is Presence.UNKNOWN:
                        continue
                    one = seen.outputs[0]  # its mass is beyond what is known: the error
                    if math.isfinite(one.mass) and 0.0 < one.std < math.inf:
                        errors.append(one.mass)
                        variances.append(one.std ** 2)
            except TudorError:
                continue
        if errors:
            # parts that say little of a load say little of errors
            squares = np.average(np.square(errors), weights=1.0 / np.array(variances))
            noise = len(variances) / float(np.sum(1.0 / np.array(variances)))
            found[item.output] = math.sqrt(max(float(squares) - noise, 0.0))
    return found


# -- What the arm of bags carries, by the models of a bundle and what is known of their errors

def telling(bundle: ModelBundle, kind: str | None = None) -> dict[str, Model]:
    """Give the models of a bundle that show a load: by default analytical, else elastic."""
    have = sorted({name for kinds in bundle.models.values() for name in kinds})
    chosen = kind or ('elastic' if 'elastic' in have and 'analytical' not in have else
                      'analytical')
    found = {output: kinds[chosen] for output, kinds in bundle.models.items() if chosen in kinds}
    if chosen == 'elm' or not found:
        wanted = 'analytical or elastic' if chosen == 'elm' else chosen
        raise UsageError(f'the load is to be estimated by the model of kind {wanted}, but the fit '
                         f'has {" and ".join(have)} only', remedy='leave out kind=, or ' * bool(
                             kind) + 'fit one with tudor fit --models analytical elastic')
    return found


def payload_of(
    bundle: ModelBundle, bags: Sequence[BagData], kind: str | None = None,
) -> PayloadEstimate:
    """Estimate what the arm carries in bags that were read, the same in all of them."""
    stretches = [stretch for bag in bags for stretch in bag.stretches]
    models = telling(bundle, kind)
    rigid = not any(model.has_memory for model in models.values())
    kept = bundle.facts.get('payload_errors')
    errors: Mapping[str, float] = {
        output: float(value) for output, value in (kept if isinstance(kept, dict) else {}).items()
        if rigid and isinstance(value, (int, float)) and value >= 0.0}
    bent = bent_links(bundle.facts, bundle.arm) if rigid else None
    return estimate_payload(
        bundle.arm, models, stretches, known=bundle.payload or 0.0, errors=errors, bent=bent,
        watched=[] if bent is None else [item for bag in bags for item in watched(bag)])


# -- From a fit to the bundle that is saved, and to the figures that are printed

def bundle_of(result: FitResult, assessment: Assessment | None = None) -> ModelBundle:
    """Collect the models of a fit with all that is known of their quality."""
    assessment = assess(result) if assessment is None else assessment
    bent = bent_links_of(result)
    bare = bare_bundle_of(result)
    return replace(bare, facts={
        **bare.facts, **assessment.as_dict(), 'thresholds': as_plain(assessment.thresholds),
        'payload_errors': payload_errors(result, bent),
        **({} if bent is None else {FACT: bent.as_dict(result.arm)}),
        **({} if result.causal is None else {'causal_validation': figures(result.causal)})})


def bare_bundle_of(result: FitResult) -> ModelBundle:
    """Collect the models of a fit with their figures, without what they are good for."""
    facts = {
        'training': [bag.as_dict() for bag in result.learned],
        'test': [bag.as_dict() for bag in result.judged],
        'validation': figures(result),
        'ringing': [asdict(item) for item in result.ringing],
        'warnings': list(result.warnings), 'choices': choices_to_list(result.choices),
        'findings': [item.as_dict() for item in result.findings],
        **({'unused': [asdict(bag) for bag in result.unused]} if result.unused else {})}
    causal = (None if result.causal is None else
              CausalModels(result.causal.preprocessing, _models(result.causal)))
    models = _models(result)
    tool = None if not result.settings.tool else tool_of_bags(
        result.arm, result.training, models.get('effort', {}).get('analytical'))
    return ModelBundle(result.arm, result.preprocessing, models, facts, causal, tool=tool)


def _models(result: FitResult) -> dict[str, dict[str, Model]]:
    models: dict[str, dict[str, Model]] = {}
    for item in result.fitted:
        models.setdefault(item.output, {})[item.kind] = item.model
    return models


def figures(result: FitResult) -> dict[str, Any]:
    """Give the figures of a fit as plain values: output, model, then training and validation."""
    content: dict[str, Any] = {}
    for item in result.fitted:
        verdict, validation = item.verdict, item.validation
        content.setdefault(item.output, {})[item.kind] = {
            'verdict': verdict.level.value, 'reasons': list(verdict.reasons),
            'method': validation.method, 'validation': rounded(validation.score),
            'spread': {name: float(f'{value:.3g}') for name, value in spread(validation).items()},
            'noise': {name: float(f'{value:.3g}') for name, value in zip(
                validation.channels, item.noise.tolist(), strict=False)},
            'channel_verdicts': {name: level.value for name, level in verdict.channels.items()},
            'training': rounded(item.training.score)}
    return content
