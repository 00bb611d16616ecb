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

"""Bags and messages of Float64MultiArray and DynamicJointState, as rosbags encodes them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_types_from_msg, get_typestore, Stores

from tudor_dynamics.bags.messages import Signals
from tudor_dynamics.bags.writer import encode

ARRAY = 'std_msgs/msg/Float64MultiArray'
DYNAMIC = 'control_msgs/msg/DynamicJointState'
STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(get_types_from_msg('string[] interface_names\nfloat64[] values',
                                  'control_msgs/msg/InterfaceValue'))
STORE.register(get_types_from_msg(
    'std_msgs/Header header\nstring[] joint_names\ncontrol_msgs/InterfaceValue[] interface_values',
    DYNAMIC))
DELAY = 3_000_000
"""Between a stamp and the log time of its message [ns]."""


def array(values: np.ndarray, labels: tuple[str, ...] = ()) -> bytes:
    """Encode an array by rosbags."""
    kinds = STORE.types
    dim = [kinds['std_msgs/msg/MultiArrayDimension'](label=label, size=1, stride=1)
           for label in labels]
    layout = kinds['std_msgs/msg/MultiArrayLayout'](dim=dim, data_offset=0)
    return bytes(STORE.serialize_cdr(kinds[ARRAY](layout=layout, data=np.array(values)), ARRAY))


def dynamic(stamp: int, joints: dict[str, dict[str, float]]) -> bytes:
    """Encode the interfaces of joints by rosbags."""
    kinds = STORE.types
    header = kinds['std_msgs/msg/Header'](
        stamp=kinds['builtin_interfaces/msg/Time'](
            sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id='base')
    values = [kinds['control_msgs/msg/InterfaceValue'](
        interface_names=list(of), values=np.array(list(of.values()))) for of in joints.values()]
    return bytes(STORE.serialize_cdr(kinds[DYNAMIC](
        header=header, joint_names=list(joints), interface_values=values), DYNAMIC))


@dataclass(frozen=True)
class Topic:
    """Messages of one topic with their log times."""

    name: str
    msgtype: str
    log_time: np.ndarray
    data: list[bytes]


def topic_of(signals: Signals) -> Topic:
    """Give signals with the usual delay."""
    return Topic(signals.topic, signals.msgtype, signals.stamp + DELAY, encode(signals).data)


def write(path: Path, *topics: Topic, plugin: StoragePlugin = StoragePlugin.MCAP) -> Path:
    """Write topics of any of these types."""
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        for topic in topics:
            connection = writer.add_connection(topic.name, topic.msgtype, typestore=STORE)
            for time, data in zip(topic.log_time.tolist(), topic.data, strict=True):
                writer.write(connection, time, data)
    return path
