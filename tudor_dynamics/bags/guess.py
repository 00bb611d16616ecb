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

"""A plan from the topics of a bag, where no arm description is at hand."""

from __future__ import annotations

from collections.abc import Mapping

from tudor_dynamics.bags.joint_states import DecodedTopic
from tudor_dynamics.bags.layouts.cdr_layout import JOINT_STATE
from tudor_dynamics.bags.sources import ChannelSource, MANY_TURNS, Sources

STRAIN_WORDS = ('strain', 'gauge')
"""A topic of JointState whose name has one of these carries strains, where no arm is given."""


def guess_plan(topics: Mapping[str, DecodedTopic]) -> Sources | None:
    """
    Guess what an arm description would say, from the topics alone.

    Returns None where no topic has positions.
    """
    def with_field(what: str) -> dict[str, list[str]]:
        found = {}
        for name, states in topics.items():
            blocks = [block for block in states.blocks if block.layout.size(what)]
            if blocks:
                largest = max(blocks, key=lambda block: len(block.index))
                found[name] = list(largest.layout.names)
        return found

    def is_strain(name: str) -> bool:
        return any(word in name.lower() for word in STRAIN_WORDS)

    topics = {name: states for name, states in topics.items() if states.msgtype == JOINT_STATE}
    positions, efforts = with_field('position'), with_field('effort')
    candidates = [name for name in positions if not is_strain(name)]
    if not candidates:
        return None
    topic = max(candidates, key=lambda name: (name.endswith('joint_states'),
                                              len(topics[name].stamp)))
    joints = tuple(dict.fromkeys(positions[topic]))
    sources = [name for name in (topic, *sorted(efforts))
               if set(joints) <= set(efforts.get(name, ()))]
    strains = {gauge: ChannelSource(name, gauge, 'position') for name, gauges in positions.items()
               if is_strain(name) for gauge in gauges}
    source = sources[0] if sources else topic
    return Sources(topic, joints, (False,) * len(joints), (MANY_TURNS,) * len(joints),
                   tuple(ChannelSource(source, joint, 'effort') for joint in joints),
                   tuple(strains), tuple(strains.values()))
