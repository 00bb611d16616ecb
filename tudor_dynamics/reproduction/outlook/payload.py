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

"""Payload: what the arm carries, from strains and currents."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure
import numpy as np

from tudor_dynamics.identification.fit import fit_models, FitSettings
from tudor_dynamics.report.style import BLUE
from tudor_dynamics.reproduction.figures import look
from tudor_dynamics.reproduction.figures.pictures import Picture
from tudor_dynamics.reproduction.judging import read
from tudor_dynamics.reproduction.outlook.part import Floor, Section, Setting
from tudor_dynamics.reproduction.plan import Campaign
from tudor_dynamics.reproduction.result_cache import Cached

ENDS = (0.0, 0.4)
"""Payloads that the model is fitted to [kg]."""
BETWEEN = (0.1, 0.2, 0.3)
CLOSE = 0.005
"""Error of a mass that is asked for [kg]."""


def section(setting: Setting) -> Section:
    """
    Compute the section.

    Parameters
    ----------
    setting : Setting
        What it is computed with.

    """
    campaign = setting.campaign
    depends: dict[str, Any] = {'of': [campaign.described(payload, damped=True)
                                      for payload in (*ENDS, *BETWEEN)]}
    found = campaign.stages.result('payload_offline', depends, lambda: _offline(campaign))
    content = found.content
    worst = max(abs(mass - float(truth)) for truth, masses in content.items() for mass in masses)
    floor = Floor('simulated arm, model of 0 and 400 g: error at 100, 200, 300 g', 'within 5 g',
                  f'{1000.0 * worst:.1f} g', worst < CLOSE)
    return Section(
        ('A model of two payloads knows what each further kilogram does to every output. The mass '
         'is what explains, by least squares, the strain that the model without payload leaves '
         'over.',), (floor,),
        (Picture('payload_offline', 'Payload', 'Masses from strains',
                 'Each recording of 100, 200 and 300 g by itself; the model has seen 0 and 400 g.',
                 lambda: _draw(content)),), {'masses': content})


def _offline(campaign: Campaign) -> Cached:
    arm = campaign.arm
    training = [bag for end in ENDS for bag in read(arm, campaign.record(end))]
    fitted = fit_models(arm, training, [], None, arm.spec.preprocessing, FitSettings(
        kinds=('analytical',), payloads=ENDS))
    strain = next(item for item in fitted.fitted if item.output == 'strain')
    errors = strain.validation.score.channels.values()
    weights = 1.0 / np.array([channel.rmse for channel in errors])
    empty, loaded = strain.model.at(ENDS[0]), strain.model.at(ENDS[1])
    content: dict[str, Any] = {}
    for payload in BETWEEN:
        for bag in read(arm, campaign.record(payload)):
            left, each = [], []
            for stretch in bag.stretches:
                assert stretch.strain is not None  # campaigns are those of arms with gauges
                kept = stretch.decimation(stretch.strain)
                base = empty.follow_kept(stretch)
                left.append((kept - base) * weights)
                each.append((loaded.follow_kept(stretch) - base) * weights)
            one, rest = np.vstack(each), np.vstack(left)
            centred = one - one.mean(axis=0)  # gauges have offsets
            content.setdefault(f'{payload:g}', []).append(
                float(ENDS[1] * np.sum(centred * rest) / np.sum(centred ** 2)))
    return Cached(content, {})


def _draw(content: dict[str, Any]) -> Figure:
    figure, axes = look.new_figure(3.0, 1)
    for truth, masses in content.items():
        axes[0, 0].plot([1000.0 * float(truth)] * len(masses),
                        [1000.0 * (mass - float(truth)) for mass in masses], 'o', color=BLUE,
                        markersize=4)
    axes[0, 0].axhspan(-1000.0 * CLOSE, 1000.0 * CLOSE, color='#dddddd', zorder=0)
    axes[0, 0].set_xlabel('payload [g]')
    axes[0, 0].set_ylabel('error of the mass [g]')
    return figure
