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

"""
Where things stand in Float64MultiArray and DynamicJointState.

Neither says what it carries as a JointState does: an array has places, and a joint has interfaces.
The arm description names place or interface.
"""

from __future__ import annotations

from tudor_dynamics.bags.layouts.cdr_layout import CdrError, Cursor, Layout, MAX_NAMES

FLOAT64_MULTI_ARRAY = 'std_msgs/msg/Float64MultiArray'
DYNAMIC_JOINT_STATE = 'control_msgs/msg/DynamicJointState'
DATA = 'data'
"""Name of the only field of a Float64MultiArray."""


def array_layout(buffer: bytes) -> Layout:
    """Parse the structure of a Float64MultiArray."""
    cursor = Cursor(buffer)
    dimensions = cursor.count()
    if dimensions > min(len(buffer) // 12, MAX_NAMES):  # label, size and stride take twelve bytes
        raise CdrError(f'announces {dimensions} dimensions in {len(buffer)} bytes; at most '
                       f'{MAX_NAMES} are read')
    for _ in range(dimensions):
        cursor.text()
        cursor.count()
        cursor.count()
    cursor.count()  # data_offset
    place = cursor.doubles()
    if place[1] > MAX_NAMES:
        raise CdrError(f'has {place[1]} values; at most {MAX_NAMES} are read')
    return cursor.finish('', tuple(map(str, range(place[1]))), {DATA: place}, stamped=False)


def dynamic_layout(buffer: bytes) -> Layout:
    """Parse the structure of a DynamicJointState."""
    cursor = Cursor(buffer)
    frame_id = cursor.header()
    joints = cursor.names()
    count = cursor.count()
    if count != len(joints):
        raise CdrError(f'has interfaces of {count} joints for {len(joints)} names')
    parts: dict[str, tuple[int, int]] = {}
    scattered: dict[str, list[tuple[str, int] | None]] = {}
    for number, joint in enumerate(joints):
        interfaces = cursor.names()
        place = cursor.doubles()
        if place[1] != len(interfaces):
            raise CdrError(f'{joint!r} has {place[1]} values for {len(interfaces)} interfaces')
        key = f'joint {number}'
        parts[key] = place
        for column, interface in enumerate(interfaces):
            where = scattered.setdefault(interface, [None] * len(joints))
            if where[number] is not None:
                raise CdrError(f'{joint!r} has the interface {interface!r} twice')
            where[number] = (key, column)
        if len(scattered) > MAX_NAMES:
            raise CdrError(f'has more than {MAX_NAMES} interfaces')
    return cursor.finish(frame_id, joints, parts,
                         scattered={name: tuple(of) for name, of in scattered.items()})
