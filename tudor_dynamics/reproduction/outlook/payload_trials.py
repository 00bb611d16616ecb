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

"""Loads told from recordings: by the bag, and sample by sample beside a detector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tudor_dynamics.bags import read_recording
from tudor_dynamics.identification.bundling import bundle_of
from tudor_dynamics.identification.fit import fit_models, FitSettings
from tudor_dynamics.identification.worth.carried import payload_of
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.monitoring.followed_load import follow_load, FollowedLoad
from tudor_dynamics.reproduction.judging import read
from tudor_dynamics.reproduction.outlook.part import Setting
from tudor_dynamics.reproduction.plan import Campaign
from tudor_dynamics.reproduction.result_cache import RECORDING
from tudor_dynamics.simulation.loop.campaign import record_stimuli, StimulusSpec
from tudor_dynamics.simulation.loop.closed_loop import ClosedLoop
from tudor_dynamics.simulation.loop.load_changes import carried_at, LoadChange, random_loads
from tudor_dynamics.simulation.loop.push_truth import random_pushes
from tudor_dynamics.simulation.loop.pushes import Push
from tudor_dynamics.simulation.loop.stimulus_motion import stimulus_seeds

ENDS = (0.0, 0.4)
"""Payloads that the model is fitted to [kg]."""
BETWEEN = (0.1, 0.2, 0.3)
EARLY = 0.2
"""Time before a load for which it is announced [s]."""
SOON, LATER = 1.0, 5.0
"""Times behind a change at which the mass is judged [s]."""
LOADED, PUSHED = 5000, 6000
"""Seeds of the recordings: others than those that windows and limits were chosen on."""


@dataclass(frozen=True)
class Size:
    """
    How much is recorded.

    Attributes
    ----------
    training : int
        Recordings of each payload that the model is fitted to.
    runs : int
        Recordings of each payload between.
    bags : int
        Recordings with loads that change; twice as many with pushes.
    seconds : float
        Length of each [s].
    each : int
        Loads or pushes in each.

    """

    training: int
    runs: int
    bags: int
    seconds: float
    each: int


def size_of(setting: Setting) -> Size:
    """Give the size of the trials."""
    return Size(1, 1, 1, 20.0, 2) if setting.quick else Size(5, 14, 5, 80.0, 10)


def _campaign(setting: Setting, stimuli: int) -> Campaign:
    plan = replace(setting.campaign.plan, stimuli=stimuli, seconds=size_of(setting).seconds)
    return Campaign(plan, setting.campaign.stages, setting.campaign.progress)


def fitted(setting: Setting) -> ModelBundle:
    """
    Fit a model to the least and the largest payload.

    Parameters
    ----------
    setting : Setting
        What it is computed with.

    """
    campaign = _campaign(setting, size_of(setting).training)
    arm = campaign.arm
    training = [bag for end in ENDS for bag in read(arm, campaign.record(end))]
    return bundle_of(fit_models(arm, training, [], None, arm.spec.preprocessing, FitSettings(
        kinds=('analytical',), payloads=ENDS)))


def offline(setting: Setting, bundle: ModelBundle) -> list[list[float]]:
    """
    Tell the load of recordings between the payloads of the model.

    Parameters
    ----------
    setting : Setting
        What it is computed with.
    bundle : ModelBundle
        Model of both ends.

    Returns
    -------
    list of list of float
        True mass, mass, standard deviation of each recording [kg].

    """
    campaign = _campaign(setting, size_of(setting).runs)
    found = []
    for payload in BETWEEN:
        for bag in read(campaign.arm, campaign.record(payload)):
            told = payload_of(bundle, [bag])
            found.append([payload, told.mass, told.mass_std])
    return found


def watch(
    bundle: ModelBundle, path: Path, known: float, *, estimate: bool,
    announced: Sequence[float] = (),
) -> FollowedLoad:
    """
    Replay a recording through a monitor; see `follow_load`.

    Parameters
    ----------
    bundle : ModelBundle
        Model of all payloads.
    path : Path
        Directory of the recording.
    known : float
        Payload at the beginning [kg].
    estimate : bool
        Whether the load is followed.
    announced : sequence of float
        Times at which a load is announced [s].

    """
    return follow_load(bundle, read_recording(str(path), bundle.arm), known, estimate=estimate,
                       announced=announced)


def _recorded(setting: Setting, name: str, specs: Sequence[StimulusSpec]) -> list[Path]:
    campaign = setting.campaign
    folder = campaign.stages.folder(name, {
        **campaign.described(0.0, damped=True), 'specs': [str(spec) for spec in specs]}, RECORDING)
    paths = [folder / f'stimulus_{k + 1:02d}' for k in range(len(specs))]
    missing = [k for k, path in enumerate(paths) if not path.exists()]
    if missing:
        record_stimuli(campaign.plan.arm, [specs[k] for k in missing],
                       [paths[k] for k in missing], campaign.plan.jobs)
    return paths


def picked_up(setting: Setting, bundle: ModelBundle, *, announced: bool) -> dict[str, Any]:
    """
    Let loads be picked up and put down while the arm moves.

    Parameters
    ----------
    setting : Setting
        What it is computed with.
    bundle : ModelBundle
        Model of all payloads.
    announced : bool
        Whether each is announced.

    Returns
    -------
    dict
        ``errors`` of the mass [kg] soon and later, ``told`` of the loads within a second,
        ``events`` close to them, ``corrections`` elsewhere; ``t``, ``mass`` and ``true`` of one.

    """
    size = size_of(setting)
    seeds = [stimulus_seeds(LOADED + setting.campaign.plan.seed, k) for k in range(size.bags)]
    changes: list[tuple[LoadChange, ...]] = [
        random_loads(size.each, size.seconds, 0.0, seed[2]) for seed in seeds]
    paths = _recorded(setting, 'bags_payload_loads', [
        StimulusSpec(0.0, size.seconds, 100.0, 1.0, 'aprbs', *seed, loads=loads)
        for seed, loads in zip(seeds, changes, strict=True)])
    errors, told, events, corrections = [], 0, 0, 0
    for path, loads in zip(paths, changes, strict=True):
        seen = watch(bundle, path, 0.0, estimate=True,
                     announced=[c.time - EARLY for c in loads] if announced else ())
        for change in loads:
            at = np.searchsorted(seen.t, [change.time + SOON, change.time + LATER])
            errors.append([float(seen.mass[min(i, len(seen.mass) - 1)] - change.mass)
                           for i in at])
            told += any(change.time <= t <= change.time + SOON for t in seen.times)
            events += any(change.time - EARLY <= t <= change.time + SOON for t in seen.events)
        corrections += sum(not any(c.time <= t <= c.time + SOON for c in loads)
                           for t in seen.times)
    return {'errors': errors, 'told': told, 'events': events, 'corrections': corrections,
            't': seen.t[::10].tolist(), 'mass': seen.mass[::10].tolist(),
            'true': carried_at(loads, 0.0, seen.t[::10]).tolist()}


def pushed(setting: Setting, bundle: ModelBundle, *, estimate: bool) -> dict[str, Any]:
    """
    Push the arm, every second time for seconds.

    Parameters
    ----------
    setting : Setting
        What it is computed with.
    bundle : ModelBundle
        Model of all payloads.
    estimate : bool
        Whether the load is followed.

    Returns
    -------
    dict
        Number of ``pushes``, how many are ``found``, with which ``latency`` [s] (median), and
        how many are ``told`` to be loads.

    """
    size = size_of(setting)
    count = 2 * size.bags
    arm = setting.campaign.arm
    mechanism = ClosedLoop(arm).plant.mechanism
    seeds = [stimulus_seeds(PUSHED + setting.campaign.plan.seed, k) for k in range(count)]
    known = [0.0 if k % 2 else 0.2 for k in range(count)]
    paths = _recorded(setting, 'bags_payload_pushes', [
        StimulusSpec(mass, size.seconds, 100.0, 1.0, 'aprbs', *seed, size.each, held=True)
        for mass, seed in zip(known, seeds, strict=True)])
    total = found = told = 0
    latency = []
    for path, mass, seed in zip(paths, known, seeds, strict=True):
        pushes: tuple[Push, ...] = random_pushes(arm, mechanism, size.each, size.seconds, seed[2],
                                                 held=True)
        seen = watch(bundle, path, mass, estimate=estimate)
        for push in pushes:
            total += 1
            end = push.time + push.duration
            hits = [t - push.time for t in seen.events if push.time <= t <= end + 0.5]
            found += bool(hits)
            latency += hits[:1]
            told += any(push.time <= t <= end + 0.7 for t in seen.times)
    return {'pushes': total, 'found': found, 'told': told,
            'latency': float(np.median(latency)) if latency else None}
