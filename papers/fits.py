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

"""
Models of each payload and of all of them, fitted to half of the stimuli, and pushes found by them.

The search for an elastic model simulates the arm along all it learns from, hundreds of times, so
it is given a part of the training stimuli only; it is judged by all the test stimuli, as the other
models are. Payload after payload is the same arm with another mass at the tip: each search begins
with what was found for the next heavier one.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from papers.campaign import (
    Cached, Campaign, ELASTIC, figures, fit, FloatArray, grams, judged, MIXED_KINDS, OUTPUTS,
    predict, QUICK_KINDS, training_and_test)
import tudor_dynamics as td

FOUND = 'identified'
"""Key of the physical parameters in the content of a result."""
ONE_MODEL, PUSHES = 'one model of all payloads', 'find collisions'
"""What progress calls them."""
ELASTIC_STRAIN = 'elastic strain'
"""Method: the residual of the elastic model, corrected by its observer."""
LATE = 0.3
"""After the end of a push an event still counts as found [s]."""


def stimuli_for_search(count: int, seconds: float, limit: float) -> int:
    """Give the number of training stimuli of some length for the search, up to a limit [s]."""
    return min(count, max(1, int(limit / seconds + 1e-9)))


def merged(first: Cached, second: Cached) -> Cached:
    """Put the figures of more kinds of models beside those of some, on the same recording."""
    content: dict[str, Any] = dict(first.content)
    for name, value in second.content.items():
        known = content.get(name)
        content[name] = {**known, **value} if isinstance(known, dict) else known or value
    return Cached(content, {**second.arrays, **first.arrays})


def physical(models: td.ModelBundle) -> dict[str, float]:
    """Give the physical parameters of an elastic model."""
    model = models.models['strain'][ELASTIC]
    assert isinstance(model, td.ElasticModel)
    return {item.name: item.value for item in model.physical if item.name != 'payload'}


def elastic_settings(
    warm: dict[str, float] | None, payloads: tuple[float, float] | None = None,
) -> td.FitSettings:
    """Let a search begin where another one ended."""
    return td.FitSettings(kinds=(ELASTIC,), elastic_start=warm, payloads=payloads)


class Fits:
    """Fits to the recordings of a campaign."""

    def __init__(self, campaign: Campaign) -> None:
        self.campaign = campaign

    def separate(
        self, payload: float, *, damped: bool = True, split: str = 'stimulus',
        strain_form: str = 'exact', kinds: tuple[str, ...] | None = None,
    ) -> Cached:
        """
        Fit models of one payload [kg].

        The split is by ``stimulus`` as in the paper, or ``random``: half of the samples.
        ``content[output][kind]['training' | 'test']`` are figures; the arrays are those of one
        test recording: ``t``, and ``OUTPUT_measured``, ``OUTPUT_KIND`` [units of the output].

        """
        kinds = self.campaign.plan.kinds if kinds is None else kinds
        quick = tuple(kind for kind in kinds if kind in QUICK_KINDS)
        result = Cached({}, {})
        if quick:
            result = self._quick(payload, damped, split, strain_form, quick)
        # single samples have no past: the elastic model has no random split
        if ELASTIC in kinds and split == 'stimulus':
            result = merged(result, self.elastic(payload, damped=damped))
        return result

    def _quick(
        self, payload: float, damped: bool, split: str, strain_form: str, kinds: tuple[str, ...],
    ) -> Cached:
        campaign = self.campaign
        paths = campaign.record(payload, damped=damped)
        name = f'fit_{grams(payload)}_{"damped" if damped else "undamped"}'
        name += ('_random' if split == 'random' else '') + (
            '_paper' if strain_form == 'paper' else '')
        text = name.replace('_', ' ')
        campaign.progress(text, 0.0)
        settings = td.FitSettings(kinds=kinds, strain_form=strain_form)
        arm = campaign.carrying(payload)
        depends = {**campaign.described(payload, damped=damped), 'split': split, 'kinds': kinds,
                   'form': strain_form}

        def make() -> Cached:
            training, test = training_and_test(paths)
            models = fit(arm, training, test, settings,
                         lambda what: campaign.progress(f'{text}: {what}', 0.3))
            if split == 'random':
                return _at_random(models, paths, settings.settled())
            return _by_stimulus(models, training, test)

        result = campaign.stages.result(name, depends, make)
        campaign.progress(text, 1.0)
        return result

    def elastic(self, payload: float, *, damped: bool = True) -> Cached:
        """
        Identify the elastic model of one payload [kg].

        As ``separate``; the training figures are those of what the search was given, and
        ``content['identified']`` are the physical parameters.

        """
        campaign = self.campaign
        paths = campaign.record(payload, damped=damped)
        warm = self._found_before(payload, damped)
        name = f'elastic_{grams(payload)}_{"damped" if damped else "undamped"}'
        text = name.replace('_', ' ')
        campaign.progress(text, 0.0)

        def make() -> Cached:
            training, test = training_and_test(paths)
            training = training[:self.stimuli_for_search()]
            models = fit(campaign.carrying(payload), training, test, elastic_settings(warm),
                         lambda what: campaign.progress(f'{text}: {what}', 0.3))
            campaign.progress(f'{text}: figures', 0.8)
            found = _by_stimulus(models, training, test)
            return Cached({**found.content, FOUND: physical(models)}, found.arrays)

        depends = {**campaign.described(payload, damped=damped), 'warm': warm,
                   'search': self.stimuli_for_search()}
        result = campaign.stages.result(name, depends, make)
        campaign.progress(text, 1.0)
        return result

    def stimuli_for_search(self) -> int:
        """Say how many of the training stimuli an elastic model is identified from."""
        plan = self.campaign.plan
        return stimuli_for_search(plan.stimuli // 2, plan.seconds, plan.elastic_seconds)

    def _found_before(self, payload: float, damped: bool) -> dict[str, float] | None:
        """Give what is known of the arm when this search begins."""
        # the heaviest first: what the arm carries shows how it bends
        before = [other for other in sorted(self.campaign.plan.payloads, reverse=True)
                  if other > payload]
        if not damped:
            before = [payload]  # the same arm: damping is the business of its control
        if not before:
            return None
        found: dict[str, float] = self.elastic(before[-1]).content[FOUND]
        return found


def _by_stimulus(
    models: td.ModelBundle, training: Sequence[Path], test: Sequence[Path],
) -> Cached:
    seen, unseen = predict(models, training), predict(models, test)
    content: dict[str, Any] = {}
    arrays: dict[str, FloatArray] = {}
    for output, kinds in unseen.outputs.items():
        for kind, found in kinds.items():
            content.setdefault(output, {})[kind] = {
                'training': judged(models.arm, output, seen.outputs[output][kind].traces),
                'test': judged(models.arm, output, found.traces)}
            trace = found.traces[0]
            arrays |= {'t': trace.t, f'{output}_measured': trace.measured,
                       f'{output}_{kind}': trace.predicted}
    content['ringing'] = models.facts['ringing']
    return Cached(content, arrays)


def _at_random(
    models: td.ModelBundle, paths: Sequence[Path], settings: td.FitSettings,
) -> Cached:
    """Train on a random half of the samples of all recordings, test on the other."""
    stretches = [stretch for bag in predict(models, paths).data for stretch in bag.stretches]
    count = sum(stretch.n_kept for stretch in stretches)
    train = np.random.default_rng(0).permutation(count) < count // 2
    content: dict[str, Any] = {}
    for output in OUTPUTS:
        values = np.vstack([s.decimation(getattr(s, output)) for s in stretches])
        for kind, known in models.models[output].items():
            model: Any = type(known)
            model = model.new(models.arm, output, settings)  # the same, not fitted yet
            motion = np.vstack([model.inputs(s)[s.decimation.keep] for s in stretches])
            model.fit(motion[train], values[train])
            predicted = model.predict(motion)
            content.setdefault(output, {})[kind] = {
                'training': figures(models.arm, output, values[train], predicted[train]),
                'test': figures(models.arm, output, values[~train], predicted[~train])}
    return Cached(content)


def one_model(fits: Fits) -> dict[str, Any]:
    """
    Fit one model to the least and the largest payload, and test it on all.

    ``[payload in g][output][kind]`` are figures on the test recordings.

    """
    campaign, plan = fits.campaign, fits.campaign.plan
    recorded = {payload: campaign.record(payload) for payload in plan.payloads}
    ends = (min(plan.payloads), max(plan.payloads))
    depends: dict[str, Any] = {
        'of': [campaign.described(payload, damped=True) for payload in plan.payloads]}
    campaign.progress(ONE_MODEL, 0.0)

    def make(settings: td.FitSettings, each: int | None) -> Cached:
        parts = {payload: training_and_test(paths) for payload, paths in recorded.items()}
        models = fit(campaign.arm, [path for end in ends for path in parts[end][0][:each]],
                     [path for _, test in parts.values() for path in test], settings,
                     lambda what: campaign.progress(f'{ONE_MODEL}: {what}', 0.3))
        return Cached({grams(payload): {
            output: {kind: judged(campaign.arm, output, found.traces)
                     for kind, found in kinds.items()}
            for output, kinds in predict(models, test).outputs.items()}
            for payload, (_, test) in parts.items()})

    together: dict[str, Any] = {grams(payload): {} for payload in plan.payloads}
    quick = tuple(kind for kind in plan.kinds if kind in MIXED_KINDS)
    if quick:
        together = campaign.stages.result(
            'fit_all_payloads', {**depends, 'kinds': quick},
            lambda: make(td.FitSettings(kinds=quick, payloads=ends), None)).content
    if ELASTIC in plan.kinds:
        warm = fits.elastic(ends[1]).content[FOUND]
        # in all as much as the search has for one payload
        each = max(1, fits.stimuli_for_search() // 2)
        more = campaign.stages.result(
            'elastic_all_payloads', {**depends, 'warm': warm, 'search': each},
            lambda: make(elastic_settings(warm, ends), each)).content
        together = {name: merged(Cached(outputs), Cached(more[name])).content
                    for name, outputs in together.items()}
    campaign.progress(ONE_MODEL, 1.0)
    return together


def collisions(fits: Fits, payload: float) -> Cached:
    """
    Let pushes be found by strain, by current, by a momentum observer, and by the elastic model.

    Models are learned from half of the free recordings, thresholds from the other half; judged
    are recordings with pushes, of other motions. ``content['methods'][METHOD]`` has ``score``,
    ``roc`` (factor, false alarms per hour, detection rate), and for each push its ``force`` [N]
    and ``latency`` [s] (None: not found).

    """
    campaign = fits.campaign
    training, test = training_and_test(campaign.record(payload))
    pushed = campaign.record(payload, pushes=campaign.plan.pushes)
    campaign.progress(PUSHES, 0.0)

    def rigid() -> Cached:
        models = fit(campaign.arm, training, test, td.FitSettings(kinds=('analytical',)),
                     bare=False)
        campaign.progress(PUSHES, 0.2)
        return Cached({'methods': {method: item for method, item in _found(models, pushed).items()
                                   if method != 'all'}})  # of a monitor, not of the paper

    depends = {**campaign.described(payload, damped=True), 'pushes': campaign.plan.pushes}
    methods = campaign.stages.result('collisions', depends, rigid).content['methods']
    if ELASTIC in campaign.plan.kinds:
        campaign.progress(f'{PUSHES}: elastic model', 0.4)
        warm = fits.elastic(payload).content[FOUND]

        def elastic() -> Cached:
            models = fit(campaign.carrying(payload), training[:fits.stimuli_for_search()], test,
                         elastic_settings(warm), bare=False)
            found = _found(models, pushed)
            return Cached({'methods': {ELASTIC_STRAIN: found['strain']}
                           if 'strain' in found else {}})

        more = campaign.stages.result('collisions_elastic', {
            **depends, 'warm': warm, 'search': fits.stimuli_for_search()}, elastic)
        methods = {**methods, **more.content['methods']}
    campaign.progress(PUSHES, 1.0)
    return Cached({'methods': methods})


def _found(models: td.ModelBundle, pushed: Sequence[Path]) -> dict[str, Any]:
    if not models.facts['thresholds']:
        return {}
    found = td.detect(models, pushed, td.MonitorSettings(kind=next(iter(models.models['strain']))))
    return {item.method: {
        'score': item.score.as_dict(), 'roc': [list(point) for point in item.roc],
        'pushes': _pushes(item)} for item in found}


def _pushes(item: Any) -> list[dict[str, float | None]]:
    """Give force and latency of each push, as they are counted in the score."""
    rows: list[dict[str, float | None]] = []
    for bag in item.watched:
        times = bag.alarms
        for push in bag.truth.pushes:
            hits = times[(times >= push.begin) & (times <= push.end + round(LATE * 1e9))]
            rows.append({'force': push.force,
                         'latency': float(hits[0] - push.begin) * 1e-9 if len(hits) else None})
    return rows
