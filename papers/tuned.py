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

"""What parts have in common: an elastic model of two payloads, and a schedule by it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from papers.campaign import Campaign, ELASTIC, fit, FloatArray, training_and_test
from papers.fits import elastic_settings
from papers.outlook import Setting
import tudor_dynamics as td
from tudor_dynamics.models.tuning import design, fixed_ratios, TunedArm, Wish

ENDS = (0.0, 0.4)
"""Payloads of the recordings that the model is identified from [kg]."""
STIMULI = 1
"""Recordings of each."""
PAYLOADS = (0.0, 0.1, 0.2, 0.3, 0.4)
DELAY = 0.006
"""Of the loop in the studies: 4 ms on the way, a sample of 2 ms [s]."""
RATE = 500.0
"""Of the loop [Hz]."""


def tuned_arm(setting: Setting) -> TunedArm:
    """Give the arm with an elastic model that was identified from recordings of two payloads."""
    if setting.quick:  # the description has to do
        return TunedArm(setting.campaign.arm)
    return TunedArm(setting.campaign.arm, strain_model(elastic_models(setting)))


def strain_model(models: td.ModelBundle) -> td.ElasticModel:
    """Give the elastic model of the strain."""
    model = models.models['strain'][ELASTIC]
    assert isinstance(model, td.ElasticModel)
    return model


def elastic_models(setting: Setting) -> td.ModelBundle:
    """
    Give elastic models that were identified from recordings of two known payloads.

    One payload alone would leave the scale of masses, and of forces, to what is described. Quick
    ones are of what is described.

    """
    arm = setting.campaign.carrying(0.0)
    if setting.quick:
        model = td.ElasticModel(arm, 'strain')
        gains = {sensor.gauge: sensor.gain for sensor in arm.spec.sensors}
        model.coefficients_ = tuple(np.array([gains[name], 0.0]) for name in arm.gauge_names)
        model.noise_ = np.full(len(arm.gauges), 6.0)
        return td.ModelBundle(arm, arm.spec.preprocessing, {'strain': {ELASTIC: model}}, {})
    plan = replace(setting.campaign.plan, stimuli=2 * STIMULI)
    campaign = Campaign(plan, setting.campaign.stages, setting.campaign.progress)
    folder = campaign.stages.folder('outlook_elastic', {
        'of': [campaign.described(payload, damped=True) for payload in ENDS]}, study=True)
    if not folder.exists():
        parts = [training_and_test(campaign.record(payload)) for payload in ENDS]
        models = fit(campaign.arm, [path for first, _ in parts for path in first],
                     [path for _, second in parts for path in second],
                     elastic_settings(None, ENDS))
        td.save_bundle(models, folder)
    return td.load_bundle(folder)


def schedule_of(setting: Setting, tuned: TunedArm) -> tuple[td.Schedule, FloatArray]:
    """Give the schedule of an arm, and the damping ratios that fixed gains have on its grid."""
    wish = Wish(delay=DELAY, payloads=ENDS if setting.quick else PAYLOADS)
    schedule = design(tuned, wish)
    return schedule, fixed_ratios(tuned, wish.delay, schedule)
