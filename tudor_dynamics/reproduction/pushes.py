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

"""Which pushes are found: by strain, by current, and by the strain of the elastic model."""

from __future__ import annotations

from typing import Any

from tudor_dynamics.identification.bundling import bundle_of
from tudor_dynamics.identification.collisions.replay import evaluate_collisions, MethodResult
from tudor_dynamics.identification.collisions.score import LATE
from tudor_dynamics.identification.collisions.truth import find_truth
from tudor_dynamics.identification.fit import fit_models, FitSettings
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.monitoring.detector import DetectorSettings
from tudor_dynamics.monitoring.settings import MonitorSettings
from tudor_dynamics.monitoring.thresholds.excess import Rates
from tudor_dynamics.reproduction.elastic_fits import ElasticFit, FOUND, KIND
from tudor_dynamics.reproduction.fits import Fits
from tudor_dynamics.reproduction.judging import read, training_and_test
from tudor_dynamics.reproduction.plan import Campaign
from tudor_dynamics.reproduction.result_cache import Cached

FALSE_ALARMS = 1.0
"""Per hour, that thresholds are asked for."""
ELASTIC = 'elastic strain'
"""Method: the residual of the elastic model, corrected by its observer."""
TEXT = 'find collisions'


def collisions(fits: Fits, payload: float) -> Cached:
    """
    Let pushes be found by strain, by current, by a momentum observer, and by the elastic model.

    Models are learned from half of the free recordings, thresholds from the other half; judged
    are recordings with pushes, of other motions.

    Parameters
    ----------
    fits : Fits
        Recordings and models.
    payload : float
        Mass at the tip [kg].

    Returns
    -------
    Cached
        ``content['methods'][METHOD]`` has ``score``, ``roc`` (factor, false alarms per hour,
        detection rate), and for each push its ``force`` [N] and ``latency`` [s] (None: not found).

    """
    campaign = fits.campaign
    free = campaign.record(payload)
    campaign.record(payload, pushes=campaign.plan.pushes)
    campaign.progress(TEXT, 0.0)

    def rigid() -> Cached:
        arm = campaign.arm
        training, test = (read(arm, part) for part in training_and_test(free))
        result = fit_models(arm, training, test, None, arm.spec.preprocessing,
                            FitSettings(kinds=('analytical',)))
        campaign.progress(TEXT, 0.2)
        return Cached({'methods': _found(campaign, payload, bundle_of(result))}, {})

    depends = {**campaign.described(payload, damped=True), 'pushes': campaign.plan.pushes}
    methods = campaign.stages.result('collisions', depends, rigid).content['methods']
    if KIND in campaign.plan.kinds:
        campaign.progress(f'{TEXT}: elastic model', 0.4)
        warm = fits.elastic(payload).content[FOUND]

        def elastic() -> Cached:
            arm = campaign.carrying(payload)
            training, test = (read(arm, part) for part in training_and_test(free))
            fit = ElasticFit(arm, training[:fits.stimuli_for_search()], warm)
            found = _found(campaign, payload, fit.bundle(test))
            return Cached({'methods': {ELASTIC: found['strain']} if 'strain' in found else {}}, {})

        more = campaign.stages.result('collisions_elastic', {
            **depends, 'warm': warm, 'search': fits.stimuli_for_search()}, elastic)
        methods = {**methods, **more.content['methods']}
    campaign.progress(TEXT, 1.0)
    return Cached({'methods': methods}, {})


def _found(campaign: Campaign, payload: float, bundle: ModelBundle) -> dict[str, Any]:
    if not bundle.facts['thresholds']:
        return {}
    pushed = campaign.record(payload, pushes=campaign.plan.pushes)
    bags = [(str(path), bag.recording)
            for path, bag in zip(pushed, read(campaign.carrying(payload), pushed), strict=True)]
    kind = next(iter(bundle.models['strain']))
    found = evaluate_collisions(bundle, bags, MonitorSettings(
        kind=kind, rates=Rates(FALSE_ALARMS, 60.0 * FALSE_ALARMS), detector=DetectorSettings()),
        [find_truth(path) for path, _ in bags])
    return {item.method: {
        'score': item.score.as_dict(), 'roc': [list(point) for point in item.roc],
        'pushes': _pushes(item)} for item in found}


def _pushes(item: MethodResult) -> list[dict[str, float | None]]:
    """Give force and latency of each push, as `evaluate_collisions` counts them."""
    rows: list[dict[str, float | None]] = []
    for bag in item.watched:
        times = bag.alarms
        for push in bag.truth.pushes:
            hits = times[(times >= push.begin) & (times <= push.end + round(LATE * 1e9))]
            rows.append({'force': push.force,
                         'latency': float(hits[0] - push.begin) * 1e-9 if len(hits) else None})
    return rows
