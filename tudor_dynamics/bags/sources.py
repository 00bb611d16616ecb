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

"""What to look for in a bag: topics, names, and what is plausible, from an arm description."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.schema import LimitSpec, SourceSpec
from tudor_dynamics.bags.layouts.carriers import DATA, DYNAMIC_JOINT_STATE, FLOAT64_MULTI_ARRAY
from tudor_dynamics.bags.layouts.cdr_layout import JOINT_STATE
from tudor_dynamics.bags.storage.raw import TopicInfo
from tudor_dynamics.errors import BagError

MANY_TURNS = 4 * math.pi
"""No revolute joint without limits in its description is taken to go farther than this [rad]."""
UNLIMITED = 1e6
"""Limits beyond this are none [rad or m]."""


@dataclass(frozen=True)
class ChannelSource:
    """Where the values of one joint or gauge stand."""

    topic: str  # as described (relative or absolute)
    name: str  # name in the messages; in an array the place, from 0
    field: str  # field of the messages: `effort`, `position`, `data`, or an interface
    msgtype: str = JOINT_STATE  # type that the messages must have


def channel_of(source: SourceSpec, name: str, field: str) -> ChannelSource:
    """Give the channel that a description names."""
    if source.index is not None:
        return ChannelSource(source.topic, str(source.index), DATA, FLOAT64_MULTI_ARRAY)
    if source.interface is not None:
        return ChannelSource(source.topic, name, source.interface, DYNAMIC_JOINT_STATE)
    return ChannelSource(source.topic, name, field)


@dataclass(frozen=True)
class Sources:
    """What a recording is made of."""

    joint_topic: str  # topic of the joint states, as described (relative or absolute)
    joints: tuple[str, ...]  # names of the joints, in the order of the columns
    prismatic: tuple[bool, ...]  # kind of each joint
    # Largest plausible `|q|` of each joint [rad or m]; None where any is.
    reach: tuple[float | None, ...]
    efforts: tuple[ChannelSource, ...]  # where each joint's effort stands
    gauges: tuple[str, ...] = ()  # names of the gauges
    strains: tuple[ChannelSource, ...] = ()  # where each gauge's reading stands

    @property
    def topics(self) -> tuple[str, ...]:
        """All topics as described, each once."""
        return tuple(dict.fromkeys((self.joint_topic, *(
            channel.topic for channel in (*self.efforts, *self.strains)))))


def plan_from_arm(arm: Arm) -> Sources:
    """Make the plan of an arm."""
    model = arm.full_model
    prismatic, reach = [], []
    for joint in arm.joints:
        inner = model.joints[model.getJointId(joint.name)]
        slides = inner.shortname().removeprefix('JointModel').startswith('P')
        given = joint.limits or LimitSpec()
        lower = (float(model.lowerPositionLimit[inner.idx_q]) if given.lower is None
                 else given.lower)
        upper = (float(model.upperPositionLimit[inner.idx_q]) if given.upper is None
                 else given.upper)
        bound: float | None = None
        if max(-lower, upper) < UNLIMITED:
            # Twice the limits: a soft limit overrun or a zero set elsewhere is no matter of units.
            bound = 2 * max(abs(lower), abs(upper), upper - lower)
        elif not slides and joint.type != 'continuous' and arm.spec.kinematics.urdf is None:
            bound = MANY_TURNS
        prismatic.append(slides)
        reach.append(bound)
    return Sources(
        arm.spec.joint_topic, arm.active_joints, tuple(prismatic), tuple(reach),
        tuple(channel_of(joint.effort, joint.name, 'effort') for joint in arm.joints),
        arm.gauge_names,
        tuple(channel_of(gauge, gauge.name, 'position') for gauge in arm.gauges))


def resolve(
    name: str, topics: Mapping[str, TopicInfo], path: str, msgtype: str = JOINT_STATE,
) -> str | None:
    """Find a topic of the description in a bag."""
    relative = name.lstrip('/')
    for candidate in (name, f'/{relative}', relative):
        if candidate in topics:
            return candidate
    if name.startswith('/'):
        return None
    found = sorted(topic for topic, info in topics.items()
                   if topic.endswith(f'/{relative}') and info.msgtype == msgtype)
    if len(found) > 1:
        msg = (f'topic {name} is in several namespaces ({", ".join(found)}); write one '
               'of them in full in the arm description')
        raise BagError(msg, place=path)
    return found[0] if found else None
