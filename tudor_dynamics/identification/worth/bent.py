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

"""How the links of a fit's arm bend: what its training bags show of it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from tudor_dynamics.errors import TudorError
from tudor_dynamics.identification.fit import FitResult
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.payload import PayloadModel
from tudor_dynamics.payload.bending_search import find_bending, Watched
from tudor_dynamics.payload.bent import FACT, KIND
from tudor_dynamics.payload.scale import Source
from tudor_dynamics.payload.worth import LoadWorth


def bent_facts(result: FitResult) -> dict[str, Any]:
    """
    Find how links bend, where that helps to tell loads.

    Parameters
    ----------
    result : FitResult
        Fit with its bags.

    Returns
    -------
    dict
        For the facts of the bundle; empty where strain tells no kilograms, or links hardly bend.

    """
    model = next((item.model for item in result.fitted
                  if (item.output, item.kind) == ('strain', KIND)), None)
    if not isinstance(model, AnalyticalModel):
        return {}
    try:
        if (not isinstance(model, PayloadModel)
                and LoadWorth(result.arm, 'strain', model).source is Source.NOTHING):
            return {}
        found = find_bending(result.arm, model, list(_watched(result)))
    except TudorError:
        return {}  # rigid links tell loads as well, if less so
    return {} if found is None else {FACT: found.as_dict(result.arm)}


def _watched(result: FitResult) -> Iterator[Watched]:
    for bag in result.training:
        recording = bag.recording
        for segment in recording.segments:
            strain = None if recording.strain is None else recording.strain[segment]
            stamps = recording.stamp[segment]
            if strain is None or len(stamps) < 2 or not np.isfinite(strain).all():
                continue
            dt = np.diff(stamps) * 1e-9
            yield Watched(np.concatenate([dt[:1], dt]), recording.q[segment], strain,
                          bag.payload or 0.0)
