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

"""An arm with the gauges that its recordings have."""

from __future__ import annotations

from collections.abc import Sequence
import warnings

from tudor_dynamics.arm import Arm
from tudor_dynamics.bags.info import recorded_names
from tudor_dynamics.errors import TudorWarning
from tudor_dynamics.identification.bag_choice import BagChoice


def with_recorded_gauges(arm: Arm, bags: Sequence[BagChoice]) -> Arm:
    """Leave out gauges of the description that no bag has, where bags have others."""
    if len(arm.gauges) < 2 or any(gauge.interface or gauge.index is not None
                                  for gauge in arm.gauges):
        return arm
    topics = {gauge.topic for gauge in arm.gauges}
    found = frozenset[str]().union(*(recorded_names(path, topics)
                                     for path in dict.fromkeys(bag.path for bag in bags)))
    missing = [name for name in arm.gauge_names if name not in found]
    damped = () if arm.spec.damper is None else arm.spec.damper.joints
    if not missing or len(missing) == len(arm.gauges) or {*missing} & {i.gauge for i in damped}:
        return arm
    msg = (f'{arm.name}: no bag has the gauges {", ".join(missing)} of the description; the '
           'models are of the others alone')
    warnings.warn(msg, TudorWarning, stacklevel=2)
    return arm.with_gauges(found)
