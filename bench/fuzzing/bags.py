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

"""Bags of every storage and compression, damaged, and compared with rosbags' own decoding."""

from collections import Counter
import shutil
import signal
import sqlite3

from backports import zstd
from carrier_making import ARRAY, array, DYNAMIC, dynamic, STORE
from fuzzing.mutate import in_bytes, in_values, ODD_VALUES
import mcap_records as mcap
import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from tudor_dynamics.arm.description import arm_from_dict
from tudor_dynamics.bags.info import describe
from tudor_dynamics.bags.messages import (
    array_layout, decode, decode_topic, dynamic_layout, joint_signals, JOINT_STATE, Signals,
    WRENCH_STAMPED)
from tudor_dynamics.bags.reader import read_recording, read_wrenches
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.bags.writer import encode
from tudor_dynamics.errors import BagError
from tudor_dynamics.models.bundle import dump_yaml
import yaml

JOINTS = ('shoulder', 'elbow')
MESSAGES = 60
START = 1_700_000_000_000_000_000
MODES = {'': None, 'chunk': CompressionMode.STORAGE, 'message': CompressionMode.MESSAGE,
         'file': CompressionMode.FILE}
ROSBAGS_SECONDS = 4


def _of_array(message):
    return {('data', str(i)): x.tobytes() for i, x in enumerate(message.data)}


def _of_interfaces(message):
    return {(interface, joint): x.tobytes()
            for joint, values in zip(message.joint_names, message.interface_values)
            for interface, x in zip(values.interface_names, values.values)}


CARRIERS = {ARRAY: (array_layout, _of_array), DYNAMIC: (dynamic_layout, _of_interfaces)}


class Slow(BaseException):
    """Rosbags takes too long for a comparison."""


def _late(*_):
    raise Slow


def _write(path, plugin, mode):
    stamp = START + 20_000_000 * np.arange(MESSAGES)
    t = 0.02 * np.arange(MESSAGES)[:, None]
    rate = np.array([2.0, 3.0])
    q, dq = np.sin(rate * t), rate * np.cos(rate * t)
    series = [joint_signals('/joint_states', stamp, JOINTS, q, dq, 5 * q),
              joint_signals('/motor_currents', stamp[::2], JOINTS, effort=2 * q[::2]),
              Signals('/applied_wrench', stamp[::4], {
                  'force': np.ones((MESSAGES // 4, 3)), 'torque': np.zeros((MESSAGES // 4, 3))},
                  frame='link2', msgtype=WRENCH_STAMPED)]
    writer = Writer(path, version=9, storage_plugin=plugin)
    if mode is not None:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        writer.set_custom_data('payload', '0.2')
        topics = [(item.topic, item.msgtype, item.stamp, encode(item).data) for item in series]
        topics.append(('/bridge', ARRAY, stamp[::3], [array(50 * row) for row in q[::3]]))
        topics.append(('/dynamic_joint_states', DYNAMIC, stamp[::2], [
            dynamic(int(at), {name: {'current': x, 'temperature': 40.0}
                              for name, x in zip(JOINTS, row.tolist())})
            for at, row in zip(stamp[::2], q[::2])]))
        rows = sorted((time, which, data) for which, (_, _, times, messages) in enumerate(topics)
                      for time, data in zip(times.tolist(), messages))
        ids = [writer.add_connection(name, kind, typestore=STORE)
               for name, kind, _, _ in topics]
        for time, which, data in rows:
            writer.write(ids[which], time, data)


class Bags:
    """Directories with metadata, and bare files."""

    name = 'bags'

    def __init__(self, folder):
        """Write the samples."""
        self._samples, self._parsed = {}, {}
        for storage, plugin in (('mcap', StoragePlugin.MCAP), ('sqlite3', StoragePlugin.SQLITE3)):
            for name, mode in MODES.items():
                if (storage, name) != ('sqlite3', 'chunk'):
                    self._keep(folder / f'{storage}-{name}', plugin, mode, name)
        plain = self._samples['mcap-']
        for name, change in {
                'lz4': lambda c: mcap.change_chunks(c, lambda _, raw: ('lz4', raw)),
                'loose': mcap.without_chunks,
                'bare': lambda c: mcap.with_summary_of(c, ()),
                'sparse': lambda c: mcap.with_summary_of(
                    c, (mcap.STATISTICS, mcap.CHUNK_INDEX))}.items():
            metadata, file, content, _ = plain
            self._samples[f'mcap-{name}'] = metadata, file, change(content), ''
        self._turn = 0
        self.arm = arm_from_dict(
            {'name': 'pair', 'kinematics': {'dh': [[0.4, 0, 0, 0], [0.4, 0, 0, 0]]},
             'joints': [{'name': name, 'effort': {'topic': 'motor_currents', 'unit': 'A'}}
                        for name in JOINTS]}, base=folder, source='fuzz')
        # the same from an array and from interfaces
        self.carried = arm_from_dict(
            {'name': 'pair', 'kinematics': {'dh': [[0.4, 0, 0, 0], [0.4, 0, 0, 0]]},
             'joints': [{'name': name, 'effort': {
                 'topic': 'dynamic_joint_states', 'unit': 'A', 'interface': 'current'}}
                        for name in JOINTS],
             'gauges': [{'name': f'gauge{i}', 'joint': name, 'distance': 0.05, 'topic': 'bridge',
                         'index': i} for i, name in enumerate(JOINTS)]},
            base=folder, source='fuzz')

    def _keep(self, path, plugin, mode, name):
        _write(path / 'bag', plugin, mode)
        file, = (item for item in (path / 'bag').iterdir() if item.name != 'metadata.yaml')
        self._samples[path.name] = ((path / 'bag' / 'metadata.yaml').read_bytes(), file.name,
                                    file.read_bytes(), name)

    @property
    def samples(self):
        """Names of what can be damaged."""
        return sorted(self._samples)

    def make(self, rng, sample, folder):
        """Write one damaged bag; without a generator, a whole one."""
        metadata, name, content, mode = self._samples[sample]
        bag = folder / 'bag'
        shutil.rmtree(bag, ignore_errors=True)
        bag.mkdir(parents=True)
        bare = False
        if rng is not None:
            metadata, content = self._damage(rng, bag / 'scratch', metadata, content, mode)
            bare = mode in ('', 'chunk') and rng.random() < 0.4
        (bag / name).write_bytes(content)
        if not bare:
            (bag / 'metadata.yaml').write_bytes(metadata)
        return bag / name if bare else bag

    def _damage(self, rng, scratch, metadata, content, mode):
        kind = rng.random()
        if kind < 0.1:
            return in_bytes(rng, metadata), content
        if kind < 0.2:
            if metadata not in self._parsed:
                self._parsed[metadata] = yaml.safe_load(metadata)
            return dump_yaml(in_values(rng, self._parsed[metadata])).encode(), content
        if mode == 'file' and kind < 0.8:
            inner = zstd.decompress(content)
            return metadata, zstd.compress(self._deep(rng, scratch, inner))
        if kind < 0.6:
            return metadata, self._deep(rng, scratch, content)
        return metadata, in_bytes(rng, content)

    def _deep(self, rng, scratch, content):
        """Damage what checksums and compression cover."""
        if content.startswith(mcap.MAGIC):
            def change(compression, raw):
                return str(rng.choice(['', 'zstd', 'lz4', compression])), in_bytes(rng, raw)
            return mcap.change_chunks(content, change)
        if not content.startswith(b'SQLite') or rng.random() < 0.5:
            return in_bytes(rng, content)
        scratch.write_bytes(content)
        connection = sqlite3.connect(scratch)
        table, column = (('messages', 'topic_id'), ('messages', 'timestamp'),
                         ('messages', 'data'), ('topics', 'id'), ('topics', 'name'),
                         ('topics', 'type'), ('topics', 'offered_qos_profiles'))[
                             int(rng.integers(7))]
        value = ODD_VALUES[int(rng.integers(len(ODD_VALUES)))]
        if isinstance(value, (list, dict)) or (isinstance(value, int) and value > 2**62):
            value = rng.bytes(int(rng.integers(60)))
        if column == 'data' and rng.random() < 0.7:
            row = int(rng.integers(1, MESSAGES))
            old, = connection.execute('SELECT data FROM messages WHERE id = ?', (row,)).fetchone()
            value = in_bytes(rng, old)
        where = 'id = ?' if rng.random() < 0.7 else 'id <> ?'
        try:
            connection.execute(f'UPDATE {table} SET {column} = ? WHERE {where}',  # noqa: S608
                               (value, int(rng.integers(1, 6))))
            connection.commit()
        except sqlite3.Error:
            connection.rollback()
        connection.close()
        content = scratch.read_bytes()
        scratch.unlink()
        return content

    def use(self, path):
        """Read the bag in every way; BagError where it cannot be."""
        self._turn += 1
        ways = (describe, lambda p: read_recording(p, self.arm),
                lambda p: read_recording(p, self.carried), lambda p: read_wrenches(open_bag(p)))
        try:  # each takes its turn
            ways[self._turn % len(ways)](path)
        except BagError:
            pass
        bag = open_bag(path)
        return bag.read(bag.topics)

    def compare(self, path, found):
        """Say how what was read differs from what rosbags reads; None where it does not."""
        signal.signal(signal.SIGALRM, _late)
        signal.alarm(ROSBAGS_SECONDS)
        try:
            theirs = {}
            with Reader(path) as reader:
                files = [item.path for item in getattr(reader.storage, 'storages', ())]
                # a file that is listed twice is read twice by rosbags
                for connection, time, data in (
                        reader.messages() if len(set(files)) == len(files) else ()):
                    theirs.setdefault(connection.topic, []).append((time, bytes(data)))
        except (Exception, Slow):
            theirs = {}  # what rosbags cannot read is no reference
        finally:
            signal.alarm(0)
        for topic, messages in theirs.items():
            raw = found.get(topic)
            ours = [] if raw is None else list(zip(raw.log_time.tolist(), raw.data))
            lost = Counter(messages) - Counter(ours)
            if lost:
                return f'{topic}: {sum(lost.values())} messages that rosbags reads are lost'
            in_order = messages == sorted(messages, key=lambda item: item[0])
            if in_order and len(messages) == len(ours) and messages != ours:
                return f'{topic}: messages in another order'
        for topic, raw in found.items():
            text = self._compare_values(raw)
            if text is not None:
                return f'{topic}: {text}'
        return None

    def _compare_values(self, raw):
        if raw.msgtype in CARRIERS:
            return self._compare_carried(raw)
        if raw.msgtype != JOINT_STATE:
            return None
        try:
            states = decode_topic(raw, 'fuzz')
        except BagError:
            return None
        for block in states.blocks:
            for row, index in enumerate(block.index.tolist()):
                try:
                    message = STORE.deserialize_cdr(raw.data[index], JOINT_STATE)
                except Exception as err:
                    return f'message {index} is read, by rosbags not ({err!r})'
                stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                same = (stamp == int(block.stamp[row])
                        and tuple(message.name) == block.layout.names and all(
                            getattr(message, field).tobytes()
                            == block.values(field)[row].tobytes()
                            for field in ('position', 'velocity', 'effort')))
                if not same:
                    return f'message {index} has other values'
        return None

    def _compare_carried(self, raw):
        layout, values_of = CARRIERS[raw.msgtype]
        try:
            blocks = decode(raw.data, layout, 'fuzz')
        except BagError:
            return None
        for block in blocks:
            found = {field: block.values(field) for field in block.layout.fields}
            for row, index in enumerate(block.index.tolist()):
                try:
                    theirs = values_of(STORE.deserialize_cdr(raw.data[index], raw.msgtype))
                except Exception as err:
                    return f'message {index} is read, by rosbags not ({err!r})'
                ours = {(field, name): values[row, column].tobytes()
                        for field, values in found.items()
                        for column, name in enumerate(block.layout.names)}
                if any(ours.get(key) != value for key, value in theirs.items()):
                    return f'message {index} has other values'
        return None
