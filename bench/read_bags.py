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
Reading a bag as arrays, and encoding arrays, against rosbags message by message.

Run ``python bench/read_bags.py`` (``--messages``, ``--joints``, ``--runs``). Bags are written to a
temporary directory and removed. Each figure is the processor's time, the median of several runs in
this process.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from statistics import median
import tempfile
from time import process_time

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore, Stores
from tables import show

from tudor_dynamics.arm.description import arm_from_dict
from tudor_dynamics.bags.messages import (
    FIELDS, joint_signals, JOINT_STATE, load_topics, Signals)
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.bags.writer import encode, write_bag

TOPIC = '/joint_states'


def sines(messages: int, joints: int) -> Signals:
    """Give sines, all fields present."""
    stamp = 1_700_000_000_000_000_000 + 1_000_000 * np.arange(messages)
    t = np.arange(messages)[:, None] * 1e-3
    rate = 1 + 0.3 * np.arange(joints)
    return joint_signals(
        TOPIC, stamp, [f'joint_{i}' for i in range(joints)], np.sin(rate * t),
        rate * np.cos(rate * t), 10 * np.sin(rate * t))


def encode_with_rosbags(signals: Signals) -> None:
    """Encode each message with rosbags."""
    store = get_typestore(Stores.ROS2_JAZZY)
    time, header, kind = (store.types[name] for name in (
        'builtin_interfaces/msg/Time', 'std_msgs/msg/Header', JOINT_STATE))
    names, columns = list(signals.names), [signals.values[field] for field in FIELDS]
    for row, stamp in enumerate(signals.stamp.tolist()):
        store.serialize_cdr(kind(header(time(*divmod(stamp, 10**9)), ''), names,
                                 *(values[row] for values in columns)), JOINT_STATE)


def with_rosbags(path: Path) -> None:
    """Decode each message with rosbags and make arrays."""
    stamp, position, velocity, effort = [], [], [], []
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            time = message.header.stamp
            stamp.append(time.sec * 1_000_000_000 + time.nanosec)
            position.append(message.position)
            velocity.append(message.velocity)
            effort.append(message.effort)
    for values in (stamp, position, velocity, effort):
        np.array(values)


def decode_only(path: Path) -> None:
    """Decode each message with rosbags and keep nothing."""
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)


def raw_only(path: Path) -> None:
    """Read the undecoded messages with rosbags."""
    with Reader(path) as reader:
        list(reader.messages())


def as_arrays(path: Path) -> None:
    """Read with this package: open to arrays of stamps, positions, velocities and efforts."""
    for states in load_topics(open_bag(path), [TOPIC]).values():
        for block in states.blocks:
            for field in ('position', 'velocity', 'effort'):
                block.values(field)


def as_recording(joints: int) -> Callable[[Path], None]:
    """Read with this package, with all checks, alignment and the checksum."""
    arm = arm_from_dict(
        {'name': 'bench', 'kinematics': {'dh': [[0.1, 0, 0, 0]] * joints},
         'joints': [{'name': f'joint_{i}'} for i in range(joints)]},
        base=Path(), source='bench')

    def run(path: Path) -> None:
        read_recording(path, arm)
    return run


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--messages', type=int, default=100_000)
    parser.add_argument('--joints', type=int, default=6)
    parser.add_argument('--runs', type=int, default=5)
    args = parser.parse_args()
    ways = {'rosbags, decode loop to arrays': with_rosbags,
            'rosbags, decode loop, nothing kept': decode_only,
            'rosbags, raw messages only': raw_only,
            'open to arrays (this package)': as_arrays,
            'read_recording (checks, checksum)': as_recording(args.joints)}
    signals = sines(args.messages, args.joints)
    with tempfile.TemporaryDirectory() as folder:
        times: dict[tuple[str, str], list[float]] = {}
        paths = {storage: Path(folder) / storage for storage in ('mcap', 'sqlite3')}
        for storage, path in paths.items():
            write_bag(path, [signals], storage=storage)
        for _ in range(args.runs):  # ways in turn, so that a busy moment hits them all
            for storage, path in paths.items():
                for name, way in ways.items():
                    start = process_time()
                    way(path)
                    times.setdefault((name, storage), []).append(process_time() - start)
    rows = []
    for name in ways:
        cells: list[str] = []
        for storage in paths:
            took = median(times[name, storage])
            loop = median(times['rosbags, decode loop, nothing kept', storage])
            cells += [f'{took:.3f} s', f'{loop / took:.1f}']
        rows.append((name, *cells))
    show((f'{args.messages} JointState messages of {args.joints} joints', 'mcap',
          'times as fast as the decode loop', 'sqlite3', 'times as fast'), rows)
    encodings: dict[Callable[[Signals], object], list[float]] = {
        encode: [], encode_with_rosbags: []}
    for _ in range(args.runs):
        for way, taken in encodings.items():
            start = process_time()
            way(signals)
            taken.append(process_time() - start)
    own, theirs = map(median, encodings.values())
    print(f'encoding: {own:.3f} s, with rosbags {theirs:.3f} s ({theirs / own:.0f}x)')


if __name__ == '__main__':
    main()
