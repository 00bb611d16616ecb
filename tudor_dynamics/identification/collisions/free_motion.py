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

"""Thresholds of a fit: learned from residuals of bags that the models were not fitted to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tudor_dynamics.arm import PreprocessingSpec
from tudor_dynamics.errors import FitError, SignalError
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.models.base import Model
from tudor_dynamics.monitoring.momentum_observer import MomentumObserver
from tudor_dynamics.monitoring.thresholds.io import thresholds_to_dict
from tudor_dynamics.monitoring.thresholds.learning import FreeMotion, learn_thresholds
from tudor_dynamics.monitoring.thresholds.thresholds import MethodThresholds
from tudor_dynamics.signals import prepare
from tudor_dynamics.typing import FloatArray

POSES = 200
"""Poses at which the friction of a joint is looked at."""


def live_preprocessing(spec: PreprocessingSpec) -> PreprocessingSpec:
    """Give the preprocessing of the running robot: causal, every sample."""
    return spec.model_copy(update={'filter': 'causal', 'rate': None})


def free_motion(
    cases: Sequence[tuple[Model, BagData]],
    output: str,
    spec: PreprocessingSpec,
    *,
    momentum: bool = False,
    strain: Sequence[tuple[Model, BagData]] = (),
) -> list[FreeMotion]:
    """Compute the residuals of every sample as the running robot has them."""
    correcting = {id(bag): model for model, bag in strain}
    records = []
    for model, bag in cases:
        try:
            stretches = prepare(bag.recording, live_preprocessing(spec))
        except SignalError:
            continue  # no stretch is long enough
        for s in stretches:
            measured, motion = getattr(s, output), s.motion
            if momentum:
                residual = MomentumObserver(model).process(s.stamp, model.inputs(s), measured)
            else:
                residual = measured - model.observe(s, correcting.get(id(bag)))
            keep = s.decimation.keep
            records.append(FreeMotion(s.stamp[keep], motion[keep], residual[keep]))
    return records


def stiction(cases: Sequence[tuple[Model, BagData]]) -> FloatArray:
    """
    Give the friction that may hold each joint while it stands, as all models have it.

    Returns (joints,) [unit of each joint's effort].
    """
    return np.asarray(np.max([
        model.stiction(bag.recording.q[::max(1, len(bag.recording.q) // POSES)])
        for model, bag in cases], axis=0))


def learn_all(
    unseen: Sequence[tuple[str, str, Sequence[tuple[Model, BagData]]]],
    spec: PreprocessingSpec,
) -> tuple[dict[tuple[str, str], MethodThresholds], dict[tuple[str, str], str]]:
    """Learn the thresholds of all methods that a fit allows."""
    found: dict[tuple[str, str], MethodThresholds] = {}
    missing: dict[tuple[str, str], str] = {}

    def learn(
        method: str, kind: str, records: list[FreeMotion], channels: tuple[str, ...],
        stiction: FloatArray,
    ) -> None:
        try:
            learned = learn_thresholds(records, channels, stiction)
        except FitError as err:
            missing[method, kind] = str(err)
            return
        if usable(learned):
            found[method, kind] = learned
        else:
            missing[method, kind] = 'a residual is zero throughout'

    for output, kind, cases in unseen:
        if not cases:
            missing[output, kind] = 'there is no motion that the model has not seen'
            continue
        channels = cases[0][0].channels
        strain = next((other for what, of, other in unseen
                       if what == 'strain' and of == kind), ())
        held = stiction(cases) if output == 'effort' else np.zeros(len(channels))
        learn(output, kind, free_motion(cases, output, spec, strain=strain), channels, held)
        if output == 'effort' and kind == 'analytical':
            learn('momentum', kind, free_motion(cases, output, spec, momentum=True), channels,
                  held)
    return found, missing


def as_plain(learned: Mapping[tuple[str, str], MethodThresholds]) -> dict[str, Any]:
    """Give thresholds as a bundle keeps them: method to kind to plain values."""
    found: dict[str, Any] = {}
    for (method, kind), thresholds in learned.items():
        found.setdefault(method, {})[kind] = thresholds_to_dict(thresholds)
    return found


def usable(thresholds: MethodThresholds) -> bool:
    """Say whether every statistic has a size; one that is zero throughout has none."""
    return bool(all(tail.scale > 0 and np.isfinite(tail.location) for tail in thresholds.tails)
                and (thresholds.profile[:, 0] > 0).all())
