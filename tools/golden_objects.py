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
Replay bags through the objects that nodes hold, and through nodes, without middleware or clock.

Called by ``golden.py``: what a case notes is written to an NPZ file in the folder of the case. The
public names of the package are used; the others are looked up by `found`, wherever they stand.
"""

from __future__ import annotations

import ast
from collections import defaultdict, deque
from collections.abc import Callable, Iterator
import copy
import dataclasses
from enum import Enum
import importlib
from pathlib import Path
import sys
from typing import Any

import numpy as np
import tudor_dynamics as td

OUT = Path(sys.argv[1])
INTERNAL = ('PayloadStage', 'Rig')
"""Names that the package does not export and that are used here."""
LONGEST = 18.0
"""Seconds of a bag that go through nodes."""
MACHINE = ('latency', 'rate', 'blocked', 'age')
"""Words in keys of diagnostics whose values are those of this machine."""


def found(name: str) -> Any:
    """Give a class of the package by its name, wherever it stands."""
    assert name in INTERNAL
    package = Path(td.__file__).parent
    homes = [path for path in sorted(package.rglob('*.py'))
             if f'class {name}' in (text := path.read_text(encoding='utf-8'))
             and any(isinstance(item, ast.ClassDef) and item.name == name
                     for item in ast.parse(text).body)]
    if len(homes) != 1:
        sys.exit(f'class {name}: in {len(homes)} modules of the package; expected it in one')
    module = '.'.join(homes[0].relative_to(package.parent).with_suffix('').parts)
    return getattr(importlib.import_module(module), name)


def leaves(value: Any, key: str) -> Iterator[tuple[str, Any]]:
    """Give numbers, texts and arrays in a value, each with the way to it."""
    if isinstance(value, Enum):
        yield key, value.name
    elif isinstance(value, str | int | float | np.ndarray | np.generic | None):
        yield key, value
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from leaves(getattr(value, field.name), f'{key}.{field.name}')
    elif isinstance(value, dict):
        for name, item in value.items():
            yield from leaves(item, f'{key}.{name}')
    elif isinstance(value, tuple) and hasattr(value, '_fields'):
        yield from leaves(dict(zip(value._fields, value, strict=True)), key)
    elif isinstance(value, tuple) and len(value) == 2 and isinstance(value[0], str) and (
            not isinstance(value[1], str)):
        yield from leaves(value[1], f'{key}.{value[0]}')
    elif isinstance(value, list | tuple):
        for item in value:
            yield from leaves(item, key)


class Notes:
    """Values under keys, in the order in which they came; arrays in the end."""

    def __init__(self) -> None:
        self._all: dict[str, list[Any]] = defaultdict(list)

    def add(self, key: str, value: Any) -> None:
        """Note all that is in a value."""
        for name, leaf in leaves(value, key):
            self._all[name].append(leaf)

    def save(self, name: str) -> None:
        """Write an NPZ file."""
        np.savez(OUT / f'{name}.npz', **{
            key.replace('/', '|'): self._array(items) for key, items in self._all.items()})

    @staticmethod
    def _array(items: list[Any]) -> Any:
        if any(isinstance(item, str) or item is None for item in items):
            return np.array([str(item) for item in items])
        shapes = {np.shape(item) for item in items}
        return np.array(items) if len(shapes) == 1 else np.concatenate(
            [np.ravel(item) for item in items])


def readings(bag: str, arm: Any) -> Iterator[tuple[int, Any, dict[str, Any]]]:
    """Give stamp, positions and what is measured, sample by sample."""
    recording = td.read_recording(bag, arm)
    outputs = {name: values for name in ('effort', 'strain')
               if (values := getattr(recording, name)) is not None}
    for k, stamp in enumerate(recording.stamp):
        yield int(stamp), recording.q[k], {name: item[k] for name, item in outputs.items()}


def arms(folder: str) -> None:
    """Read descriptions."""
    for file in sorted(Path(folder).glob('*.yaml')):
        notes = Notes()
        try:
            arm = td.load_arm(file)
        except td.TudorError as err:
            notes.add('error', str(err))
            notes.save(file.stem)
            continue
        for name in ('name', 'digest', 'active_joints', 'gauge_names'):
            notes.add(name, getattr(arm, name))
        notes.add('placements', [item.homogeneous for item in arm.model.jointPlacements])
        notes.add('inertias', [item.matrix() for item in arm.model.inertias])
        notes.save(file.stem)


def bags(arm: str, *names: str) -> None:
    """Read recordings."""
    for name in names:
        notes = Notes()
        recording = td.read_recording(name, td.load_arm(arm))
        notes.add('recording', recording)
        notes.add('segments', [(part.start, part.stop) for part in recording.segments])
        notes.save(Path(name).name)


def library(arm: str, first: str, second: str, test: str) -> None:
    """Fit, store, load, predict, and estimate a load, as a script would."""
    described = td.load_arm(arm)
    bundle = td.fit([first, second], described, test=[test],
                    settings=td.FitSettings(kinds=('analytical',)))
    td.save_bundle(bundle, OUT / 'model')
    again = td.load_bundle(OUT / 'model')
    notes = Notes()
    prediction = td.predict(again, test)
    notes.add('outputs', prediction.outputs)
    notes.add('carried', td.carried(again, test))
    notes.save('library')


def plants(shape: str, elastic: str) -> None:
    """Step a plant, and list vibrations."""
    for file in (shape, elastic):
        arm = td.load_arm(file)
        notes = Notes()
        notes.add('modes', td.modes(arm, 4))
        mechanism = td.build_mechanism(arm)
        plant = td.Plant(mechanism, 0.0005)
        torque = np.linspace(0.5, 1.0, len(mechanism.joints))
        for k in range(200):
            notes.add('state', copy.deepcopy(plant.step(torque * np.sin(0.02 * k))))
        run = td.simulate(arm, {arm.active_joints[0]: lambda t: 0.3 * np.sin(9.0 * t)},
                          seconds=0.1, dt=0.0005)
        notes.add('run', run.run)
        notes.save(Path(file).stem)


def monitor(model: str, bag: str, *choices: str) -> None:
    """Watch a bag: motion, predictions, residuals, ratios, events, loads and contacts."""
    bundle = td.load_bundle(model)
    kind = next((item[5:] for item in choices if item.startswith('kind=')), 'analytical')
    methods = tuple(item for item in choices if item in ('strain', 'effort', 'momentum'))
    load = found('PayloadStage')(bundle, 0.0) if 'load' in choices else None
    if load is not None:
        bundle = bundle.at(0.0)
    watched = td.Monitor(bundle, td.MonitorSettings(
        kind=kind, methods=methods, contact='contact' in choices), payload=load)
    watched.wanted = {'effort', 'strain'} & bundle.models.keys()
    notes = Notes()
    for stamp, q, outputs in readings(bag, bundle.arm):
        notes.add('joints', watched.add_joints(stamp, q))
        notes.add('motion', watched.motion)
        notes.add('predicted', watched.predicted)
        if load is not None:
            notes.add('load', [load.mass, load.std])
        for output, values in outputs.items():
            notes.add(output, watched.add_measured(output, stamp, values))
    notes.save('monitor')


def feedforward(model: str, bag: str) -> None:
    """Ask for the efforts of single states and of a motion."""
    bundle = td.load_bundle(model)
    recording = td.read_recording(bag, bundle.arm)
    dq = np.gradient(recording.q, recording.dt, axis=0)
    ddq = np.gradient(dq, recording.dt, axis=0)
    notes = Notes()
    for at_rest in ('none', 'kept'):
        made = td.Feedforward(bundle, friction_at_rest=at_rest)
        notes.add('efforts', made.efforts(np.hstack([recording.q, dq, ddq])))
        notes.add('along', made.along(td.Trajectory(
            bundle.arm.active_joints, (recording.stamp[::10] - recording.stamp[0]) * 1e-9,
            recording.q[::10])))
    notes.save('feedforward')


def rig(file: str) -> None:
    """Let the simulated arm, its damper and its reference source run in closed loop."""
    notes = Notes()
    made = found('Rig')(td.load_arm(file), rate=500.0, delay=0.004, loss=0.01, seed=5)
    for turn, goal in enumerate((0.3, -0.2, 0.5)):
        made.source.go(np.full(len(made.arm.active_joints), goal))
        made.run(1.2)
        if turn == 1:
            made.source.collide(True)
            made.run(0.5)
            made.source.collide(False)
            made.source.clear()
    notes.add('trace', made.trace)
    notes.save('rig')


class Bus:
    """Nodes in one process: what one publishes reaches the others at once; time is the bag's."""

    def __init__(self, notes: Notes) -> None:
        import rclpy
        from rclpy.clock import Clock
        from rclpy.publisher import Publisher
        from rclpy.serialization import deserialize_message, serialize_message
        from rclpy.time import Time
        rclpy.init(args=[])
        self._open, self._close = deserialize_message, serialize_message
        self.nodes: list[Any] = []
        self.now, self.stamp = 1000.0, 0
        self._due: dict[Any, float] = {}
        self._queue: deque[tuple[str, Any, bytes]] = deque()
        self._notes = notes
        Clock.now = lambda own: Time(  # type: ignore[method-assign]
            nanoseconds=self.stamp, clock_type=own.clock_type)
        Publisher.publish = lambda own, message: self.sent(  # type: ignore[method-assign]
            own.topic_name, own.msg_type, message)
        Publisher.get_subscription_count = lambda own: 1  # type: ignore[method-assign]

    def add(self, name: str, **values: Any) -> None:
        """Make a node, which is the one class in its module that is a node."""
        from rclpy.node import Node
        from rclpy.parameter import Parameter
        module = importlib.import_module(f'tudor_dynamics.nodes.{name}')
        kind = next(item for item in vars(module).values() if isinstance(item, type)
                    and issubclass(item, Node) and item.__module__ == module.__name__)
        node = kind(steady=lambda: self.now, parameter_overrides=[
            Parameter(key, value=value == 'true' if value in ('true', 'false') else value)
            for key, value in values.items()])
        self.nodes.append(node)
        self._notes.add(f'parameters.{name}', sorted(
            f'{key}={item.value!r}' for key, item in node._parameters.items()))
        self._notes.add(f'hears.{name}', sorted(item.topic_name for item in node.subscriptions))
        self._notes.add(f'publishes.{name}', sorted(item.topic_name for item in node.publishers))

    def sent(self, topic: str, kind: Any, message: Any) -> None:
        """Note a message of a node and pass it on."""
        data = bytes(message if isinstance(message, bytes) else self._close(message))
        self.pass_on(topic, kind, data)
        if topic not in ('/rosout', '/parameter_events'):
            found = list(self._leaves(self._open(data, kind)))
            words = [item for item in found if isinstance(item, str | bytes)]
            self._notes.add(f'numbers.{topic}', np.array(
                [item for item in found if not isinstance(item, str | bytes)], dtype=float))
            self._notes.add(f'words.{topic}', ' '.join(map(str, words)))

    def pass_on(self, topic: str, kind: Any, data: bytes) -> None:
        """Let a message arrive with whoever hears it."""
        self._queue.append((topic, kind, data))

    def _leaves(self, value: Any) -> Iterator[Any]:
        if hasattr(value, 'key') and any(word in value.key for word in MACHINE):
            yield value.key
        elif hasattr(value, 'get_fields_and_field_types'):
            for name in value.get_fields_and_field_types():
                yield from self._leaves(getattr(value, name))
        elif isinstance(value, str | bytes | int | float):
            yield value
        else:
            for item in value:
                yield from self._leaves(item)

    def deliver(self) -> None:
        """Let all that was sent arrive."""
        while self._queue:
            topic, kind, data = self._queue.popleft()
            for node in self.nodes:
                for item in list(node.subscriptions):
                    if item.topic_name == topic:
                        item.callback(data if item.raw else self._open(data, kind))

    def advance(self, stamp: int) -> None:
        """Let time pass until a stamp [ns], and timers with it."""
        self.now += (stamp - self.stamp) * 1e-9 if self.stamp else 0.0
        self.stamp = stamp
        for timer in [item for node in self.nodes for item in node.timers]:
            due = self._due.setdefault(timer, self.now)
            if due <= self.now and not timer.is_canceled():
                self._due[timer] = self.now + timer.timer_period_ns * 1e-9
                timer.callback()
                self.deliver()


def nodes(source: str, bag: str, *names: str) -> None:
    """Replay the messages of a bag through nodes."""
    from rosbags.highlevel import AnyReader
    notes = Notes()
    bus = Bus(notes)
    where = {'arm' if source.endswith('.yaml') else 'model': source} if source != 'none' else {}
    topics: dict[str, str] = {}
    for name, *settings in (item.split(':') for item in names):
        given = dict(item.split('=') for item in settings)
        topics.update({key: given.pop(key) for key in list(given) if key.startswith('/')})
        bus.add(name, **where, **given)
    with AnyReader([Path(bag)]) as reader:
        end = reader.start_time + round(LONGEST * 1e9)
        for link, stamp, raw in reader.messages(stop=end):
            bus.advance(stamp)
            package, _, name = link.msgtype.partition('/msg/')
            kind = getattr(importlib.import_module(f'{package}.msg'), name)
            bus.pass_on(topics.get(link.topic, link.topic), kind, bytes(raw))
            bus.deliver()
    notes.save('nodes')


if __name__ == '__main__':
    KNOWN: dict[str, Callable[..., None]] = {
        'arms': arms, 'bags': bags, 'library': library, 'plants': plants, 'monitor': monitor,
        'feedforward': feedforward, 'rig': rig, 'nodes': nodes}
    KNOWN[sys.argv[2]](*sys.argv[3:])
