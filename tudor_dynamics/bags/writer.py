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

"""Arrays become a rosbag2: the same arrays, the same bytes; all of the bag or nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
import sqlite3
from typing import Literal

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.sources import refuse_interfaces
from tudor_dynamics.bags.layouts.messages import JointStateSeries, Series
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.storage.raw import one_line
from tudor_dynamics.errors import BagError
from tudor_dynamics.files import whole

PLUGINS = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}
METADATA_VERSION: Literal[9] = 9
"""Of metadata.yaml, as Jazzy writes it."""
FAILURES = (OSError, sqlite3.Error)
"""What a storage raises where the disk takes no more; SQLite has its own way."""


def reason(err: Exception) -> str:
    """Say why something could not be written."""
    return (err.strerror or str(err)) if isinstance(err, OSError) else one_line(err)


def write_bag(
    path: str | Path,
    series: Sequence[Series],
    *,
    storage: str = 'mcap',
    custom: Mapping[str, str] | None = None,
) -> None:
    """
    Write a rosbag2 directory.

    The log time of a message is its stamp; messages of all topics are written in the order of
    their stamps. The directory appears under its name only when it is complete.

    Parameters
    ----------
    path : str or Path
        Directory to make; must not exist.
    series : sequence of Series
        Topics with all their messages.
    storage : {'mcap', 'sqlite3'}
        Format of the storage file.
    custom : dict of str to str, optional
        Goes into ``custom_data`` of the metadata, such as ``payload`` [kg].

    Raises
    ------
    BagError
        If the path exists or cannot be written, or arrays do not fit together.

    """
    path = Path(path)
    if storage not in PLUGINS:
        msg = f'{path}: storage {storage!r} is unknown; use one of {", ".join(PLUGINS)}'
        raise BagError(msg)
    if path.exists() or path.is_symlink():
        msg = f'{path}: exists already and is not overwritten; give another name or remove it'
        raise BagError(msg)
    try:
        with whole(path, replace=False) as scratch:
            _write(scratch, series, PLUGINS[storage], custom or {})
    except FAILURES as err:
        msg = f'{path}: cannot be written ({reason(err)}); check path, rights and disk'
        raise BagError(msg) from None


def _write(
    path: Path, series: Sequence[Series], plugin: StoragePlugin,
    custom: Mapping[str, str],
) -> None:
    typestore = get_typestore(Stores.ROS2_JAZZY)
    encoded = [item.encode() for item in series]
    with Writer(path, version=METADATA_VERSION, storage_plugin=plugin) as writer:
        for key, value in custom.items():
            writer.set_custom_data(key, value)
        connections = [writer.add_connection(item.topic, item.msgtype, typestore=typestore)
                       for item in series]
        stamps = np.concatenate([np.empty(0, np.int64), *(item.stamp for item in series)])
        which = np.repeat(np.arange(len(series)), [len(item.stamp) for item in series])
        within = np.concatenate([np.empty(0, np.int64),
                                 *(np.arange(len(item.stamp)) for item in series)])
        order = np.argsort(stamps, kind='stable')
        for stamp, topic, row in zip(stamps[order].tolist(), which[order].tolist(),
                                     within[order].astype(int).tolist(), strict=True):
            writer.write(connections[topic], stamp, encoded[topic][row])


def recording_series(
    recording: Recording, arm: Arm, *, namespace: str = '',
) -> list[JointStateSeries]:
    """
    Lay a recording out on the topics of its arm.

    Parameters
    ----------
    recording : Recording
        Signals of the arm's active joints and gauges.
    arm : Arm
        Names and topics.
    namespace : str
        Put before the topics, e.g. ``/arm``.

    Returns
    -------
    list of JointStateSeries
        Joint states, then topics with efforts, then topics with strains.

    """
    refuse_interfaces(arm, 'a bag that is written here')
    stamp, joints = recording.stamp, arm.active_joints
    columns: dict[str, list[int]] = {}
    if recording.effort is not None:
        for index, joint in enumerate(arm.joints):
            columns.setdefault(joint.effort.topic, []).append(index)
    own = columns.pop(arm.spec.joint_topic, None)
    effort = None
    if own is not None:
        assert recording.effort is not None
        # An array of JointState is as long as name: efforts from elsewhere are NaN here.
        effort = np.full(recording.effort.shape, np.nan)
        effort[:, own] = recording.effort[:, own]
    result = [JointStateSeries(_full(namespace, arm.spec.joint_topic), stamp, joints,
                               recording.q, recording.dq, effort)]
    for topic, chosen in columns.items():
        assert recording.effort is not None
        result.append(JointStateSeries(_full(namespace, topic), stamp,
                                       [joints[i] for i in chosen],
                                       effort=recording.effort[:, chosen]))
    if recording.strain is not None:
        topics: dict[str, list[int]] = {}
        for index, gauge in enumerate(arm.gauges):
            topics.setdefault(gauge.topic, []).append(index)
        for topic, chosen in topics.items():
            result.append(JointStateSeries(_full(namespace, topic), stamp,
                                           [arm.gauge_names[i] for i in chosen],
                                           recording.strain[:, chosen]))
    return result


def _full(namespace: str, topic: str) -> str:
    return topic if topic.startswith('/') else f'{namespace.rstrip("/")}/{topic}'
