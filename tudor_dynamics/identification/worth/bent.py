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

from typing import TYPE_CHECKING

import numpy as np

from tudor_dynamics.errors import TudorError
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.identification.standstill import motion_span
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.payload import PayloadModel
from tudor_dynamics.payload.bending_search import find_bending
from tudor_dynamics.payload.bent import BentLinks, KIND
from tudor_dynamics.payload.scale import Source
from tudor_dynamics.payload.watched import CUTOFF, Watched
from tudor_dynamics.payload.worth import LoadWorth
from tudor_dynamics.signals.smooth_states import SmoothStates

if TYPE_CHECKING:
    from tudor_dynamics.identification.fit import FitResult


def bent_links_of(result: FitResult) -> BentLinks | None:
    """
    Find how links bend, where that helps to tell loads.

    Returns None where strain tells no kilograms, or links hardly bend.
    """
    model = next((item.model for item in result.fitted
                  if (item.output, item.kind) == ('strain', KIND)), None)
    if not isinstance(model, AnalyticalModel):
        return None
    try:
        if (not isinstance(model, PayloadModel)
                and LoadWorth(result.arm, 'strain', model).source is Source.NOTHING):
            return None
        return find_bending(result.arm, model, [
            item for bag in result.training for item in watched(bag)])
    except TudorError:
        return None  # rigid links tell loads as well, if less so


def watched(bag: BagData) -> list[Watched]:
    """Give the stretches of a bag that move, as they were read, and what filters settle on."""
    recording = bag.recording
    if recording.strain is None:
        return []
    begin, end = motion_span(recording)
    t, found = recording.t, []
    for segment in recording.segments:
        first = max(segment.start, int(np.searchsorted(t, begin - SmoothStates(CUTOFF).settle)))
        inside = slice(first, min(segment.stop, int(np.searchsorted(t, end, 'right'))))
        strain, stamps = recording.strain[inside], recording.stamp[inside]
        if len(stamps) < 2 or not np.isfinite(strain).all():
            continue
        dt = np.diff(stamps) * 1e-9
        found.append(Watched(np.concatenate([dt[:1], dt]), recording.q[inside], strain,
                             bag.payload or 0.0, float(t[first])))
    return found
