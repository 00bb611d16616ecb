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

"""What the arm of bags carries, by the models of a bundle and what is known of their errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tudor_dynamics.errors import UsageError
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.identification.worth.bent import watched
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.payload.bent import bent_links
from tudor_dynamics.payload.estimate import PayloadEstimate
from tudor_dynamics.payload.offline import estimate_payload


def telling(bundle: ModelBundle, kind: str | None = None) -> dict[str, Model]:
    """
    Give the models of a bundle that can tell a load.

    kind: analytical by default, elastic where that is not there.
    """
    have = sorted({name for kinds in bundle.models.values() for name in kinds})
    chosen = kind or ('elastic' if 'elastic' in have and 'analytical' not in have else
                      'analytical')
    found = {output: kinds[chosen] for output, kinds in bundle.models.items() if chosen in kinds}
    if chosen == 'elm' or not found:
        msg = (f'the bundle has models of the kinds {have}; a load is told by an analytical or an '
               'elastic one: fit that, or name it')
        raise UsageError(msg)
    return found


def payload_of(
    bundle: ModelBundle, bags: Sequence[BagData], kind: str | None = None,
) -> PayloadEstimate:
    """Estimate what the arm carries in bags that were read, the same in all of them."""
    stretches = [stretch for bag in bags for stretch in bag.stretches]
    models = telling(bundle, kind)
    rigid = not any(model.has_memory for model in models.values())
    kept = bundle.facts.get('payload_errors')
    errors: Mapping[str, float] = {
        output: float(value) for output, value in (kept if isinstance(kept, dict) else {}).items()
        if rigid and isinstance(value, (int, float)) and value >= 0.0}
    bent = bent_links(bundle.facts, bundle.arm) if rigid else None
    return estimate_payload(
        bundle.arm, models, stretches, known=bundle.payload or 0.0, errors=errors, bent=bent,
        watched=[] if bent is None else [item for bag in bags for item in watched(bag)])
