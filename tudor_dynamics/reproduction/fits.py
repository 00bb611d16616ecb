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

"""Models of each payload, fitted to half of the stimuli."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.identification.dataset import BagData, OUTPUTS
from tudor_dynamics.identification.fit import fit_models, FitSettings
from tudor_dynamics.identification.trainers import blank
from tudor_dynamics.models.kinds import KINDS
from tudor_dynamics.reproduction.elastic_fits import (
    ElasticFit, FOUND, KIND, merged, stimuli_for_search)
from tudor_dynamics.reproduction.judging import figures, judged, read, training_and_test
from tudor_dynamics.reproduction.plan import Campaign, grams
from tudor_dynamics.reproduction.result_cache import Cached
from tudor_dynamics.typing import FloatArray

SPLITS = ('stimulus', 'random')


class Fits:
    """
    Stages of fits.

    Parameters
    ----------
    campaign : Campaign
        Recordings of the campaign.

    """

    def __init__(self, campaign: Campaign) -> None:
        self.campaign = campaign

    def separate(
        self, payload: float, *, damped: bool = True, split: str = 'stimulus',
        strain_form: str = 'exact', kinds: tuple[str, ...] | None = None,
    ) -> Cached:
        """
        Fit models of one payload.

        Parameters
        ----------
        payload : float
            Mass at the tip [kg].
        damped : bool, default=True
            With the damper.
        split : {'stimulus', 'random'}, default='stimulus'
            Half of the recordings as in the paper, or half of the samples at random.
        strain_form : {'exact', 'paper'}, default='exact'
            Where the bending moment is taken.
        kinds : tuple of str, optional
            Models, in place of those of the plan.

        Returns
        -------
        Cached
            ``content[output][kind]['training' | 'test']`` are figures; the arrays are those of
            one test recording: ``t``, and ``OUTPUT_measured``, ``OUTPUT_KIND`` [units of output].

        """
        campaign = self.campaign
        kinds = campaign.plan.kinds if kinds is None else kinds
        quick = tuple(kind for kind in kinds if not KINDS[kind].model.has_memory)
        result = Cached({}, {})
        if quick:
            result = self._quick(payload, damped, split, strain_form, quick)
        # single samples have no past: the elastic model has no random split
        if KIND in kinds and split == 'stimulus':
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
        settings = FitSettings(kinds=kinds, strain_form=strain_form).settled()
        arm = campaign.carrying(payload)
        depends = {**campaign.described(payload, damped=damped), 'split': split, 'kinds': kinds,
                   'form': strain_form}

        def make() -> Cached:
            if split == 'random':
                return _at_random(arm, read(arm, paths), settings)
            return _by_stimulus(arm, paths, settings,
                                lambda what: campaign.progress(f'{text}: {what}', 0.3))

        result = campaign.stages.result(name, depends, make)
        campaign.progress(text, 1.0)
        return result

    def elastic(self, payload: float, *, damped: bool = True) -> Cached:
        """
        Identify the elastic model of one payload.

        Parameters
        ----------
        payload : float
            Mass at the tip [kg].
        damped : bool, default=True
            With the damper.

        Returns
        -------
        Cached
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
            first, second = training_and_test(paths)
            arm = campaign.carrying(payload)
            training, test = read(arm, first[:self.stimuli_for_search()]), read(arm, second)
            fit = ElasticFit(arm, training, warm, None,
                             lambda what: campaign.progress(f'{text}: {what}', 0.3))
            campaign.progress(f'{text}: figures', 0.8)
            content: dict[str, Any] = {FOUND: fit.found}
            arrays: dict[str, FloatArray] = {}
            seen = fit.judge(training)
            for output, validation in fit.judge(test).items():
                content[output] = {KIND: {
                    'training': judged(arm, output, seen[output].traces),
                    'test': judged(arm, output, validation.traces)}}
                trace = validation.traces[0]
                arrays |= {'t': trace.t, f'{output}_measured': trace.measured,
                           f'{output}_{KIND}': trace.predicted}
            return Cached(content, arrays)

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
    arm: Arm, paths: Sequence[Path], settings: FitSettings, progress: Any,
) -> Cached:
    first, second = (read(arm, part) for part in training_and_test(paths))
    found = fit_models(arm, first, second, None, arm.spec.preprocessing, settings, progress)
    content: dict[str, Any] = {}
    arrays: dict[str, FloatArray] = {}
    for item in found.fitted:
        content.setdefault(item.output, {})[item.kind] = {
            'training': judged(arm, item.output, item.training.traces),
            'test': judged(arm, item.output, item.validation.traces)}
        trace = item.validation.traces[0]
        arrays['t'] = trace.t
        arrays[f'{item.output}_measured'] = trace.measured
        arrays[f'{item.output}_{item.kind}'] = trace.predicted
    content['ringing'] = [{'channel': item.channel, 'frequency': item.frequency, 'rms': item.rms}
                          for item in found.ringing]
    return Cached(content, arrays)


def _at_random(arm: Arm, bags: Sequence[BagData], settings: FitSettings) -> Cached:
    """Train on a random half of the samples of all recordings, test on the other."""
    generator = np.random.default_rng(0)
    stretches = [s for bag in bags for s in bag.stretches]
    count = sum(s.n_kept for s in stretches)
    train = generator.permutation(count) < count // 2
    content: dict[str, Any] = {}
    for output in OUTPUTS:
        values = np.vstack([s.decimation(getattr(s, output)) for s in stretches])
        for kind in settings.kinds:
            if KINDS[kind].model.has_memory:
                continue
            model = blank(kind, arm, output, settings)
            motion = np.vstack([model.inputs(s)[s.decimation.keep] for s in stretches])
            model.fit(motion[train], values[train])
            predicted = model.predict(motion)
            content.setdefault(output, {})[kind] = {
                'training': figures(arm, output, values[train], predicted[train]),
                'test': figures(arm, output, values[~train], predicted[~train])}
    return Cached(content, {})
