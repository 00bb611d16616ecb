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

"""Efforts and strains that do not come as JointStates: in arrays, and as interfaces of joints."""

from __future__ import annotations

from collections.abc import Iterator

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import SourceSpec
from tudor_dynamics.errors import ArmError


def sources(arm: Arm) -> Iterator[tuple[str, SourceSpec]]:
    """Give where the efforts of the active joints and the readings of the gauges come from."""
    for joint in arm.joints:
        yield joint.name, joint.effort
    for gauge in arm.gauges:
        yield gauge.name, gauge


def array_places(arm: Arm) -> dict[str, dict[str, int]]:
    """Give the topics that carry arrays."""
    found: dict[str, dict[str, int]] = {}
    for name, source in sources(arm):
        if source.index is not None:
            found.setdefault(source.topic, {})[name] = source.index
    return found


def refuse_interfaces(arm: Arm, who: str, *, arrays: bool = False) -> None:
    """Refuse an arm whose efforts or strains come in messages that somebody does not take."""
    taken = 'JointState and Float64MultiArray' if arrays else 'JointState'
    for name, source in sources(arm):
        if source.interface is not None or (source.index is not None and not arrays):
            kind = 'Float64MultiArray' if source.interface is None else 'DynamicJointState'
            raise ArmError(
                f'{name} comes in a {kind} on {source.topic}; {who} takes {taken}',
                place=arm.source, remedy='publish it as a JointState, and describe that topic')
