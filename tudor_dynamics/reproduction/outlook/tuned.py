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
from typing import Any

import numpy as np

from tudor_dynamics.control.schedule import Schedule
from tudor_dynamics.models.elastic.fitted import PhysicalParameter
from tudor_dynamics.models.elastic.model import ElasticModel
from tudor_dynamics.models.tuning.design import design, fixed_ratios, Wish
from tudor_dynamics.models.tuning.small_motion import TunedArm
from tudor_dynamics.reproduction.elastic_fits import ElasticFit
from tudor_dynamics.reproduction.judging import read
from tudor_dynamics.reproduction.outlook.part import Setting
from tudor_dynamics.reproduction.plan import Campaign
from tudor_dynamics.reproduction.result_cache import Cached
from tudor_dynamics.typing import FloatArray

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
    """
    Give the arm with an elastic model that was identified from recordings of two payloads.

    Parameters
    ----------
    setting : Setting
        What the part computes with; quick ones take the description for the model.

    """
    arm = setting.campaign.arm
    return TunedArm(arm) if setting.quick else TunedArm(arm, identified_model(setting))


def identified_model(setting: Setting) -> ElasticModel:
    """
    Give an elastic model of strain that was identified from recordings of two known payloads.

    One payload alone would leave the scale of masses, and of forces, to what is described.

    Parameters
    ----------
    setting : Setting
        What the part computes with.

    """
    arm = setting.campaign.arm
    plan = replace(setting.campaign.plan, stimuli=STIMULI)
    campaign = Campaign(plan, setting.campaign.stages, setting.campaign.progress)
    depends: dict[str, Any] = {'of': [campaign.described(payload, damped=True)
                                      for payload in ENDS]}
    found = campaign.stages.result('outlook_elastic', depends, lambda: _identify(campaign))
    model = ElasticModel(arm, 'strain', tuple(
        PhysicalParameter(name, value, '') for name, value in found.content['physical'].items()))
    model.coefficients_ = tuple(np.array(values) for values in found.content['strain'])
    model.noise_ = np.array(found.content['noise'])
    return model


def _identify(campaign: Campaign) -> Cached:
    arm = campaign.arm
    bags = [bag for payload in ENDS for bag in read(arm, campaign.record(payload))]
    fit = ElasticFit(arm, bags, None, ENDS)
    strain = fit.models['strain']
    assert isinstance(strain, ElasticModel)
    assert strain.coefficients_ is not None and strain.noise_ is not None
    return Cached({'physical': fit.found, 'noise': strain.noise_.tolist(),
                   'strain': [values.tolist() for values in strain.coefficients_]}, {})


def schedule_of(setting: Setting, tuned: TunedArm) -> tuple[Schedule, FloatArray]:
    """
    Give the schedule of an arm, and the damping ratios that fixed gains have on its grid.

    Parameters
    ----------
    setting : Setting
        What the part computes with.
    tuned : TunedArm
        Arm with its model.

    """
    payloads = (ENDS[0], ENDS[1]) if setting.quick else PAYLOADS
    wish = Wish(delay=DELAY, payloads=payloads)
    schedule = design(tuned, wish)
    return schedule, fixed_ratios(tuned, wish.delay, schedule)
