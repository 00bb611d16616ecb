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

"""Which link a joint or a gauge tells of."""

from __future__ import annotations

from tudor_dynamics.arm import Arm


def channel_links(arm: Arm) -> dict[str, tuple[int, str]]:
    """Say which link each joint and gauge belongs to."""
    model = arm.full_model
    bodies: dict[int, str] = {}
    for frame in model.frames:
        if frame.type.name == 'BODY':
            bodies.setdefault(int(frame.parentJoint), frame.name)

    def link(joint: str) -> tuple[int, str]:
        index = int(model.getJointId(joint))
        depth, place = 0, index
        while place:
            depth, place = depth + 1, int(model.parents[place])
        named = joint.replace('joint', 'link') if 'joint' in joint else f'{joint}_link'
        return depth, bodies.get(index, named)

    links = {joint: link(joint) for joint in arm.active_joints}
    links.update({gauge.name: link(gauge.joint) for gauge in arm.gauges})
    return links
