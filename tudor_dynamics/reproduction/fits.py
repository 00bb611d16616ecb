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

"""Models of each payload, and one model of all payloads, fitted to half of the stimuli."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
import warnings

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import TudorWarning
from tudor_dynamics.identification.dataset import BagChoice, BagData, load, OUTPUTS
from tudor_dynamics.identification.fit import fit_models, FitSettings, new_model
from tudor_dynamics.identification.metrics import score
from tudor_dynamics.identification.payloads import PAYLOAD_KINDS
from tudor_dynamics.identification.validation import Trace
from tudor_dynamics.reproduction.plan import Campaign, grams
from tudor_dynamics.reproduction.stages import Result

FloatArray = NDArray[np.float64]

SPLITS = ('stimulus', 'random')
SAMPLEWISE = ('analytical', 'elm')
"""Kinds that take single samples, as the random split hands them out."""


def hub_gauges(arm: Arm) -> list[int]:
    """Give the gauge nearest to each joint: the paper has one pair a link, close to the hub."""
    nearest: dict[str, int] = {}
    for index, gauge in enumerate(arm.gauges):
        known = nearest.get(gauge.joint)
        if known is None or gauge.distance < arm.gauges[known].distance:
            nearest[gauge.joint] = index
    return sorted(nearest.values())


def read(arm: Arm, paths: Sequence[Path]) -> list[BagData]:
    """Read and filter bags as the arm description says."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', TudorWarning)  # they are our own recordings
        return [load(BagChoice(str(path)), arm, arm.spec.preprocessing) for path in paths]


def halves(paths: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Split recordings into those for training and those for testing."""
    middle = len(paths) // 2
    return list(paths[:middle]), list(paths[middle:])


def figures(arm: Arm, output: str, measured: FloatArray, predicted: FloatArray) -> dict[str, Any]:
    """
    Judge a prediction as the table does.

    Parameters
    ----------
    arm : Arm
        Arm.
    output : {'effort', 'strain'}
        Output.
    measured, predicted : ndarray of shape (n_samples, n_channels)
        Output in its units; for strain, of all gauges.

    Returns
    -------
    dict
        ``rmse``, ``sigma_e``, ``fit`` and ``fit_printed`` over the gauges near the hubs (over all
        joints for effort), and ``channels`` with the figures of each channel.

    """
    names = list(arm.active_joints if output == 'effort' else arm.gauge_names)
    chosen = list(range(len(names))) if output == 'effort' else hub_gauges(arm)
    whole = score(measured[:, chosen], predicted[:, chosen], [names[i] for i in chosen])
    every = score(measured, predicted, names)
    return {'samples': whole.samples, 'rmse': whole.rmse, 'sigma_e': whole.sigma_e,
            'fit': whole.fit, 'fit_printed': whole.fit_printed,
            'channels': {name: {'rmse': item.rmse, 'fit': item.fit}
                         for name, item in every.channels.items()}}


def _joined(arm: Arm, output: str, traces: Sequence[Trace]) -> dict[str, Any]:
    return figures(arm, output, np.vstack([item.measured for item in traces]),
                   np.vstack([item.predicted for item in traces]))


class Fits:
    """
    Stages of fits.

    Parameters
    ----------
    campaign : Campaign
        Recordings.

    """

    def __init__(self, campaign: Campaign) -> None:
        self.campaign = campaign

    def separate(
        self, payload: float, *, damped: bool = True, split: str = 'stimulus',
        strain_form: str = 'exact', kinds: tuple[str, ...] | None = None,
    ) -> Result:
        """
        Fit models of one payload.

        Parameters
        ----------
        payload : float
            Mass at the tip [kg].
        damped : bool, default=True
            With the damper.
        split : {'stimulus', 'random'}, default='stimulus'
            Half of the recordings, or half of the samples at random as in the paper.
        strain_form : {'exact', 'paper'}, default='exact'
            Where the bending moment is taken.
        kinds : tuple of str, optional
            Models, in place of those of the plan.

        Returns
        -------
        Result
            ``content[output][kind]['training' | 'test']`` are figures; the arrays are those of
            one test recording: ``t``, and ``OUTPUT_measured``, ``OUTPUT_KIND`` [units of output].

        """
        campaign = self.campaign
        kinds = campaign.plan.kinds if kinds is None else kinds
        paths = campaign.record(payload, damped=damped)
        name = f'fit_{grams(payload)}_{"damped" if damped else "undamped"}'
        name += ('_random' if split == 'random' else '') + (
            '_paper' if strain_form == 'paper' else '')
        text = name.replace('_', ' ')
        campaign.progress(text, 0.0)
        settings = FitSettings(kinds=kinds, strain_form=strain_form)
        arm = campaign.carrying(payload)
        depends = {**campaign.described(payload, damped=damped), 'split': split, 'kinds': kinds,
                   'form': strain_form}

        def make() -> Result:
            if split == 'random':
                return _at_random(arm, read(arm, paths), settings)
            return _by_stimulus(arm, paths, settings,
                                lambda what: campaign.progress(f'{text}: {what}', 0.3))

        result = campaign.stages.result(name, depends, make)
        campaign.progress(text, 1.0)
        return result

    def of_all_payloads(self) -> Result:
        """
        Fit one model to the least and the largest payload, and test it on all.

        Returns
        -------
        Result
            ``content[payload in g][output][kind]`` are figures on the test recordings.

        """
        campaign = self.campaign
        payloads = campaign.plan.payloads
        recorded = {payload: campaign.record(payload) for payload in payloads}
        ends = (min(payloads), max(payloads))
        kinds = tuple(kind for kind in campaign.plan.kinds if kind in PAYLOAD_KINDS)
        campaign.progress('one model of all payloads', 0.0)

        def make() -> Result:
            arm = campaign.arm
            training = [bag for end in ends for bag in read(arm, halves(recorded[end])[0])]
            test = [(grams(payload), bag) for payload in payloads
                    for bag in read(arm, halves(recorded[payload])[1])]
            settings = FitSettings(kinds=kinds, payloads=ends)
            found = fit_models(
                arm, training, [bag for _, bag in test], None, arm.spec.preprocessing, settings,
                lambda what: campaign.progress(f'one model of all payloads: {what}', 0.3))
            content: dict[str, Any] = {name: {} for name, _ in test}
            for item in found.fitted:
                for name, outputs in content.items():
                    traces = [trace for trace, (own, _) in zip(
                        item.validation.traces, test, strict=True) if own == name]
                    outputs.setdefault(item.output, {})[item.kind] = _joined(
                        arm, item.output, traces)
            return Result(content, {})

        depends = {'of': [campaign.described(payload, damped=True) for payload in payloads],
                   'kinds': kinds}
        result = campaign.stages.result('fit_all_payloads', depends, make)
        campaign.progress('one model of all payloads', 1.0)
        return result


def _by_stimulus(
    arm: Arm, paths: Sequence[Path], settings: FitSettings, progress: Any,
) -> Result:
    first, second = (read(arm, part) for part in halves(paths))
    found = fit_models(arm, first, second, None, arm.spec.preprocessing, settings, progress)
    content: dict[str, Any] = {}
    arrays: dict[str, FloatArray] = {}
    for item in found.fitted:
        content.setdefault(item.output, {})[item.kind] = {
            'training': _joined(arm, item.output, item.training.traces),
            'test': _joined(arm, item.output, item.validation.traces)}
        trace = item.validation.traces[0]
        arrays['t'] = trace.t
        arrays[f'{item.output}_measured'] = trace.measured
        arrays[f'{item.output}_{item.kind}'] = trace.predicted
    content['ringing'] = [{'channel': item.channel, 'frequency': item.frequency, 'rms': item.rms}
                          for item in found.ringing]
    return Result(content, arrays)


def _at_random(arm: Arm, bags: Sequence[BagData], settings: FitSettings) -> Result:
    """Train on a random half of the samples of all recordings, test on the other, as the paper."""
    generator = np.random.default_rng(0)
    stretches = [s for bag in bags for s in bag.stretches]
    motion = np.vstack([s.motion[s.decimation.keep] for s in stretches])
    train = generator.permutation(len(motion)) < len(motion) // 2
    content: dict[str, Any] = {}
    for output in OUTPUTS:
        values = np.vstack([s.decimation(getattr(s, output)) for s in stretches])
        for kind in settings.kinds:
            if kind not in SAMPLEWISE:
                continue
            model = new_model(arm, output, kind, settings).fit(motion[train], values[train])
            predicted = model.predict(motion)
            content.setdefault(output, {})[kind] = {
                'training': figures(arm, output, values[train], predicted[train]),
                'test': figures(arm, output, values[~train], predicted[~train])}
    return Result(content, {})
