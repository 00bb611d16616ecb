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

"""One model of all payloads, fitted to the least and the largest, and tested on all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tudor_dynamics.identification.fit import fit_models, FitSettings
from tudor_dynamics.models.kinds import KINDS
from tudor_dynamics.reproduction.elastic_fits import ElasticFit, FOUND, KIND, merged
from tudor_dynamics.reproduction.fits import Fits
from tudor_dynamics.reproduction.judging import judged, read, training_and_test
from tudor_dynamics.reproduction.plan import grams
from tudor_dynamics.reproduction.result_cache import Cached

TEXT = 'one model of all payloads'


def one_model(fits: Fits) -> dict[str, Any]:
    """
    Fit one model to the least and the largest payload, and test it on all.

    Parameters
    ----------
    fits : Fits
        Stages that it is computed from.

    Returns
    -------
    dict
        ``[payload in g][output][kind]`` are figures on the test recordings.

    """
    campaign, plan = fits.campaign, fits.campaign.plan
    payloads = plan.payloads
    recorded = {payload: campaign.record(payload) for payload in payloads}
    ends = (min(payloads), max(payloads))
    quick = tuple(kind for kind in plan.kinds if KINDS[kind].of_payloads is not None
                  and not KINDS[kind].model.has_memory)
    depends: dict[str, Any] = {
        'of': [campaign.described(payload, damped=True) for payload in payloads]}
    stages = campaign.stages
    campaign.progress(TEXT, 0.0)

    def make() -> Cached:
        arm = campaign.arm
        training = [bag for end in ends for bag in read(arm, training_and_test(recorded[end])[0])]
        test = [(grams(payload), bag) for payload in payloads
                for bag in read(arm, training_and_test(recorded[payload])[1])]
        found = fit_models(
            arm, training, [bag for _, bag in test], None, arm.spec.preprocessing,
            FitSettings(kinds=quick, payloads=ends),
            lambda what: campaign.progress(f'{TEXT}: {what}', 0.3))
        content: dict[str, Any] = {name: {} for name, _ in test}
        for item in found.fitted:
            for name in content:
                own = [trace for trace, (of, _) in zip(
                    item.validation.traces, test, strict=True) if of == name]
                content[name].setdefault(item.output, {})[item.kind] = judged(
                    arm, item.output, own)
        return Cached(content, {})

    together: dict[str, Any] = {grams(payload): {} for payload in payloads}
    if quick:
        together = stages.result('fit_all_payloads', {**depends, 'kinds': quick}, make).content
    if KIND in plan.kinds:
        warm = fits.elastic(ends[1]).content[FOUND]
        more = stages.result(
            'elastic_all_payloads', {**depends, 'warm': warm, 'search': _at_each_end(fits)},
            lambda: _elastic(fits, recorded, ends, warm)).content
        together = {name: merged(Cached(outputs, {}), Cached(more[name], {})).content
                    for name, outputs in together.items()}
    campaign.progress(TEXT, 1.0)
    return together


def _at_each_end(fits: Fits) -> int:
    """Give the stimuli of each payload: in all as much as the search has for one payload."""
    return max(1, fits.stimuli_for_search() // 2)


def _elastic(
    fits: Fits, recorded: dict[float, list[Path]], ends: tuple[float, float],
    warm: dict[str, float],
) -> Cached:
    campaign = fits.campaign
    arm = campaign.arm
    training = [bag for end in ends
                for bag in read(arm, training_and_test(recorded[end])[0][:_at_each_end(fits)])]
    fit = ElasticFit(arm, training, warm, ends,
                     lambda what: campaign.progress(f'{TEXT}: {what}', 0.6))
    return Cached({grams(payload): {
        output: {KIND: judged(arm, output, found.traces)}
        for output, found in fit.judge(read(arm, training_and_test(paths)[1])).items()}
        for payload, paths in recorded.items()}, {})
