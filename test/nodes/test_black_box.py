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

"""The black box: a bag at an event, from whose messages the very same event comes again."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
import json
from pathlib import Path
import re
import shlex
import shutil
import signal
from subprocess import Popen
from threading import Thread, TIMEOUT_MAX
import time
from typing import Any

from geometry_msgs.msg import InertiaStamped
from node_processes import finish, launch
import numpy as np
from patience import PATIENCE
from payload_making import LOAD, moving, payload_bundle
from printed import unwrapped
import pytest
from ros_world import feed, GAUGES, World
from std_msgs.msg import String
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.cli.main import build_parser, main
from tudor_dynamics.cli.why import causes
from tudor_dynamics.errors import BagError
from tudor_dynamics.identification.causes import explain
from tudor_dynamics.models.bundle import load_bundle, save_bundle
from tudor_dynamics.nodes.common.base import latched
from tudor_dynamics.nodes.monitor import MonitorNode, OFF
from tudor_dynamics.online.black_box import EVENTS, records_of, STATES
from tudor_dynamics.online.monitor import MonitorSettings
from tudor_dynamics.typing import FloatArray
import yaml

BEGIN, END, LAST = 1200, 1800, 2600
"""Samples of the bag of pushes that are played: one push from 15.06 s on, until LAST another."""
LOST = range(1350, 1353)
"""Readings of strain that never come."""


Change = Callable[[int, dict[str, Any]], None]
K, AFTER = 900, 1260
"""Samples of the bag without pushes: from one on something is wrong, at the other it ends."""
DRIFTED = 1720
"""Sample until which an encoder has drifted far enough for an event."""


def without_some(k: int, messages: dict[str, Any]) -> None:
    """Leave some readings out."""
    if k in LOST:
        messages.pop('link_strains')


def late(k: int, messages: dict[str, Any]) -> None:
    """Let the stamps of strains leap by 0.25 s."""
    if k >= K:
        stamp = messages['link_strains'].header.stamp
        stamp.sec, stamp.nanosec = divmod(stamp.sec * 10**9 + stamp.nanosec + 250_000_000, 10**9)


THINNED = np.random.default_rng(3).uniform(size=END - K) <= 0.8
"""Which positions are lost: enough of them for an event of the momentum observer."""


def thinned(k: int, messages: dict[str, Any]) -> None:
    """Lose four of five positions."""
    if K <= k < END and THINNED[k - K]:
        messages.pop('joint_states')


def complete(k: int, messages: dict[str, Any]) -> None:
    """Leave all as it is."""


def leaping(recording: Recording) -> Recording:
    """Let a gauge leap."""
    strain = recording.strain.copy()
    strain[K:, 0] += 6.0 * strain[:, 0].std()
    return replace(recording, strain=strain)


def stuck(recording: Recording) -> Recording:
    """Let a gauge say the same for ever."""
    strain = recording.strain.copy()
    strain[K:, 1] = strain[K, 1]
    return replace(recording, strain=strain)


def breaking_away(recording: Recording) -> Recording:
    """Let a joint need more to begin to move after it has stood."""
    effort, speed = recording.effort.copy(), np.gradient(recording.q[:, 0], recording.dt)
    still = np.abs(speed) < 0.02
    for start in np.flatnonzero(still[:-1] & ~still[1:]):
        if start > K and still[start - 30:start].all():
            span = effort[start:start + 30, 0]
            span += 2.5 * effort[:, 0].std() * np.sign(speed[start + 5]) * np.exp(
                -np.arange(len(span)) / 12.0)
    return replace(recording, effort=effort)


def drifting(recording: Recording) -> Recording:
    """Let a drive need more current while it moves, for no reason that anything shows."""
    effort = recording.effort.copy()
    ramp = np.clip((np.arange(len(effort)) - K) / 30.0, 0.0, 1.0)
    effort[:, 0] += 2.4 * effort[:, 0].std() * ramp
    return replace(recording, effort=effort)


def read_wrong(recording: Recording) -> Recording:
    """Let an encoder drift by 1.1 deg/s: too slow for a controller to doubt it."""
    q, time = recording.q.copy(), recording.t
    q[K:, 0] += 0.02 * (time[K:] - time[K])
    return replace(recording, q=q)


def hurried(recording: Recording) -> Recording:
    """Let a move go on 2.5 times as fast, with the efforts and strains of the slow motion."""
    samples = np.arange(len(recording.stamp))
    place = np.concatenate([samples[:K + 100], np.arange(K + 100, samples[-1], 2.5)])

    def taken(values: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(place, samples, column) for column in values.T])
    return replace(recording, stamp=recording.stamp[:len(place)], **{
        name: taken(getattr(recording, name)) for name in ('q', 'effort', 'strain')})


def as_it_is(recording: Recording) -> Recording:
    """Change nothing."""
    return recording


@pytest.fixture(scope='module')
def free(root: Path) -> Recording:
    """Read the bag in which nothing touches the arm."""
    return read_recording(root / 'bags/two_blade_test',
                          load_arm(root / 'config/two_blade_arm.yaml'))


@pytest.fixture(scope='module')
def pushes(root: Path) -> Recording:
    """Read the bag in which the arm is pushed."""
    return read_recording(root / 'bags/two_blade_pushes',
                          load_arm(root / 'config/two_blade_arm.yaml'))


def played(
    world: World, model: Path, recording: Recording, folder: Path, change: Change = without_some,
    *, first: int = BEGIN, last: int | None = END, busy: bool = False,
    gauges: list[str] = GAUGES, **params: object,
) -> list[dict]:
    """
    Play a part to a monitor that is ended after it; gives the records on its topic.

    Beside a busy machine all comes in bunches of 12 samples, strains late after all others.
    """
    node = world.add(MonitorNode, model=str(model), event_bags=str(folder), **params)
    records = world.listen('collision_record', String, latched())
    world.meet('joint_states', 'link_strains', *['motor_currents'] * (
        recording.effort is not None))
    sent, waiting = [0], []

    def each(k: int, messages: dict[str, Any]) -> None:
        change(k, messages)
        if busy and 'link_strains' in messages:
            waiting.append(messages.pop('link_strains'))
        sent[0] += len(messages)
        if busy and k % 12 == 5:
            sent[0] += len(waiting)
            for message in waiting:
                world.output('link_strains').publish(message)
            waiting.clear()
    feed(world, recording, lambda: 10**9 if node.meter.count >= sent[0] else 0, first=first,
         last=last, change=each, batch=12 if busy else 1, gauges=gauges)
    assert world.spin(lambda: bool(records))
    world.end(node)
    return [json.loads(message.data) for message in records]


def whole_of(record: dict[str, Any]) -> None:
    """Check that a record on the topic says all that was known, and is small."""
    assert len(json.dumps(record)) < 10_000
    last = record['last_second']
    assert 25 <= len(last) <= 50 and last[-1] == pytest.approx([0.0, *(
        record[name][record['channel']] for name in (
            'measured', 'expected', 'threshold', 'ratio'))], rel=1e-5)
    assert -1.0 <= last[0][0] < -0.9 and last[0][-1] < 1.0 <= last[-1][-1]
    assert {'level', 'dropped', 'message', 'methods'} <= record['state'].keys()
    assert record['state'][f'state: {record["method"]} {record["channel"]} [um/m]'] == 'ok'
    assert record['sensors'] == dict.fromkeys(
        ('link2_hub', 'link3_hub', 'joint2', 'joint3'), 'ok')
    assert record['load'] == {'mass': 0.0, 'std': None, 'source': 'parameter'}
    # whichever of a sample's messages was taken first
    assert {topic: value == pytest.approx(0.0, abs=0.011) for topic, value in record[
        'apart'].items()} == {'motor_currents': True, 'link_strains': True}
    assert record['settings']['rearm'] == 0.3


def test_replayed_to_the_last_bit(
    world: World, model: Path, pushes: Recording, tmp_path: Path,
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Lost readings included, the event comes again: onset, method, link and all ratios."""
    records = played(world, model, pushes, tmp_path)
    (bag,) = tmp_path.iterdir()
    kept = json.loads(open_bag(bag).metadata.custom[EVENTS])
    assert [{key: item[key] for key in records[0]} for item in kept] == records
    assert kept[0]['settings']['model'] == str(model) and kept[0]['state']['arm']
    bundle = load_bundle(model)
    assert kept[0]['digest'] == bundle.digest != '' and 'numba' in kept[0]['made']['libraries']
    assert 'rclpy' in kept[0]['made']['libraries'] and kept[0]['made']['version']
    whole_of(records[0])
    monkeypatch.setattr('tudor_dynamics.cli.console.SILENCE', TIMEOUT_MAX)
    assert main(['why', str(bag)]) == 0
    said = capsys.readouterr().out
    assert said.count(': touch\n') == said.count('to the last bit\n') == len(records)
    parser = build_parser('why')
    found = causes(parser.parse_args(['why', str(bag)]))
    assert [(event.onset, event.stamp, event.method, event.link, event.ratios)
            for event in (cause.event.event for cause in found)] == [
                tuple(record[key] for key in ('onset', 'stamp', 'method', 'link', 'ratio'))
                for record in records]
    at = causes(parser.parse_args(['why', str(bag), '--at', records[0]['time'][11:19]]))
    assert [(item.event.event.onset, item.name, item.evidence) for item in at] == [
        (item.event.event.onset, item.name, item.evidence) for item in found[:1]]
    monkeypatch.setenv('TZ', 'Asia/Tokyo')  # a reader elsewhere: times are those of the log
    time.tzset()
    assert main(['why', str(bag), '--at', records[0]['time']]) == 0
    assert records[0]['time'].endswith(' UTC') and records[0]['time'] in capsys.readouterr().out
    assert main(['why', str(bag), '--at', '33:33:33']) == 1
    said = capsys.readouterr()
    assert 'times are in UTC' in unwrapped(said.out) and not said.err
    assert main(['why', str(bag), '--at', 'noon']) == 2
    monkeypatch.undo()
    time.tzset()
    assert main(['evaluate', str(bag), '--model', str(model)]) in (0, 1)
    said = unwrapped(capsys.readouterr().out)
    assert said.startswith(f'{bag} is the bag of an event') and 'fit again' not in said
    assert f'tudor why {bag}' in said
    save_bundle(replace(bundle, facts={**bundle.facts, 'made': {}}), tmp_path / 'again')
    assert main(['why', str(bag), '--model', str(tmp_path / 'again')]) == 0
    assert 'is not the one that' in (err := capsys.readouterr().err)
    assert f', not {bundle.digest[:4]})' in err


def test_a_node_that_ran_for_long(
    world: World, model: Path, pushes: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Thresholds remember more than the ring holds: with that, the same event to the last bit."""
    monkeypatch.setattr('tudor_dynamics.online.black_box.RING_BYTES', 150_000)
    for name, seconds in {'EVERY': 0.5, 'OLDEST': 2.0, 'APART': 0.5}.items():
        monkeypatch.setattr(f'tudor_dynamics.online.memory.MEMORY_{name}', seconds)
    played(world, model, pushes, tmp_path, complete, first=950, last=1600,
           methods=['strain', 'effort'])
    (path,) = tmp_path.iterdir()
    bag = open_bag(path)
    assert bag.topics['/link_strains'].count < 640  # the beginning has gone
    command = build_parser('why').parse_args(['why', str(path)])
    assert [item.same for item in causes(command)] == [True]
    records = records_of(bag)
    kept = json.loads(bag.metadata.custom[STATES])
    assert {*kept} == {'strain', 'effort', 'load', 'observer', 'model', 'thresholds'}
    assert len(kept['strain']) == 2 and kept['load'] == [] and kept['thresholds'] == {}
    settings, bundle = MonitorSettings.of(records[0]['settings']), load_bundle(model)

    def same(states: Any) -> list[bool | None]:
        custom = {**bag.metadata.custom, STATES: json.dumps(states)}
        other = replace(bag, metadata=replace(bag.metadata, custom=custom))
        return [cause.same for cause in explain(
            other, bundle, settings, 'parameter', 0.0, records)]
    assert same(kept) == [True]
    one = deepcopy(kept['strain'][1])
    levels = kept['strain'][1]['state'][0]
    levels[0] = [3.0 * level for level in levels[0]]
    assert same(kept) != [True]
    for damaged in (7, [], {'strain': 7}, {'strain': [{'stamp': 1}]}, {
            'thresholds': {'strain': {'analytical': {'usual': []}}}}, *(
            {'strain': [{**one, 'state': state}]}
            for state in (7, [], [[[1.0], [1.0, 2.0]], *one['state'][1:]],
                          [*one['state'][:2], [2**80] * len(one['state'][2])]))):
        with pytest.raises(BagError, match='damaged records of events .key tudor_states'):
            same(damaged)


def test_the_logged_step_runs_from_any_folder(
    world: World, model: Path, pushes: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Paths of a node are relative to its own folder; in log and record they are absolute."""
    (tmp_path / 'model').symlink_to(model)
    monkeypatch.chdir(tmp_path)
    log = world.listen('/rosout', __import__('rcl_interfaces.msg').msg.Log)
    assert played(world, Path('model'), pushes, Path('an event'))
    assert world.spin(lambda: any('to see why: ' in item.msg for item in log))
    said = next(item.msg for item in log if 'to see why: ' in item.msg)
    (tmp_path / 'elsewhere').mkdir()
    monkeypatch.chdir(tmp_path / 'elsewhere')
    words = shlex.split(said.removeprefix('to see why: ').partition(' (')[0])
    assert words[0] == 'tudor' and main(words[1:]) == 0


@pytest.mark.parametrize('busy', [False, True])
@pytest.mark.parametrize(('cause', 'make', 'change', 'params'), [
    ('clock', as_it_is, late, {}),
    ('gap', as_it_is, thinned, {}), ('unexplained', drifting, complete, {}),
    ('gauge', leaping, complete, {}), ('gauge', stuck, complete, {}),
    ('encoder', read_wrong, complete, {}),
    ('friction after standstill', breaking_away, complete, {}),
    ('motion outside training', hurried, complete, {}),
    ('threshold too low', as_it_is, complete, {
        'contact_alarms_per_hour': 3600.0, 'false_alarms_per_hour': 3600.0})])
def test_each_cause_comes_again(
    world: World, model: Path, free: Recording, tmp_path: Path, cause: str,
    make: Callable[[Recording], Recording], change: Change, params: dict[str, float], busy: bool,
) -> None:
    """Whatever made the monitor alarm: the same event to the last bit, and its cause by name."""
    last = DRIFTED if make is read_wrong else AFTER
    records = played(world, model, make(free), tmp_path, change, first=0, last=last, busy=busy,
                     **params)
    found = [item for bag in sorted(tmp_path.iterdir())  # several on a slow machine
             for item in causes(build_parser('why').parse_args(['why', str(bag)]))]
    assert [item.event.event.onset for item in found] == [item['onset'] for item in records]
    assert all(item.same for item in found)
    assert {item.name for item in found} == {cause}, [
        (item.name, item.event.time, item.evidence) for item in found]


@pytest.fixture(scope='module')
def kilograms(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a model that knows what a kilogram does."""
    return payload_bundle(tmp_path_factory.mktemp('payload') / 'model')


@pytest.mark.parametrize('busy', [False, True])
@pytest.mark.parametrize(('source', 'before', 'events'), [
    ('parameter', 0.0, 1), ('topic', 0.1, 1), ('estimate', 0.0, 2)])
def test_each_load_comes_again(
    world: World, kilograms: Path, tmp_path: Path, source: str, before: float, events: int,
    busy: bool,
) -> None:
    """Nobody announces what is picked up, nor what is put down: the same events, called loads."""
    said = InertiaStamped()
    said.inertia.m = before
    world.outputs['payload'] = world.probe.create_publisher(InertiaStamped, 'payload', latched())

    def change(k: int, messages: dict[str, Any]) -> None:
        messages['joint_states'].name = ['j1', 'j2']
        if k == 0 and source == 'topic':
            world.output('payload').publish(said)
            assert world.spin(lambda: world.nodes[-1].port.load.mass == before)
    records = played(world, kilograms, moving(10.5, before, put_down=8.5), tmp_path, change,
                     first=0, last=None, busy=busy, gauges=['g1', 'g2'], payload_source=source)
    found = [item for bag in sorted(tmp_path.iterdir())
             for item in causes(build_parser('why').parse_args(['why', str(bag)]))]
    assert [item.event.event.onset for item in found] == [item['onset'] for item in records]
    assert [(item.name, item.same) for item in found] == [('load', True)] * events, [
        (item.name, item.event.time, item.evidence) for item in found]
    masses = [re.search(r'(\S+) kg at the tip', item.evidence) for item in found]
    assert [float(mass[1]) for mass in masses if mass] == pytest.approx(
        [LOAD, before][:events], abs=0.03)


def test_a_touch_beside_a_busy_machine(
    world: World, model: Path, pushes: Recording, tmp_path: Path,
) -> None:
    """Late and in bunches, no gap and no clock is seen where there is none."""
    records = played(world, model, pushes, tmp_path, complete, busy=True)
    (bag,) = tmp_path.iterdir()
    found = causes(build_parser('why').parse_args(['why', str(bag)]))
    assert [(item.name, item.same) for item in found] == [('touch', True)] * len(records)


def test_a_folder_that_takes_nothing(
    world: World, model: Path, pushes: Recording, tmp_path: Path,
) -> None:
    """The monitor goes on, and says why there is no bag."""
    (tmp_path / 'file').touch()
    node_log = world.listen('/rosout', __import__('rcl_interfaces.msg').msg.Log)
    assert played(world, model, pushes, tmp_path / 'file' / 'below')
    assert world.spin(lambda: any('cannot be written' in item.msg for item in node_log))


def two_pushes(
    world: World, model: Path, pushes: Recording, folder: Path, monkeypatch: pytest.MonkeyPatch,
) -> list[str]:
    """Play two pushes to a monitor that writes at once; gives what it says of their bags."""
    monkeypatch.setattr('tudor_dynamics.nodes.monitor.RECORDED_AFTER', 0.0)
    log = world.listen('/rosout', __import__('rcl_interfaces.msg').msg.Log)
    records = world.listen('collision_record', String, latched())
    node = world.add(MonitorNode, model=str(model), event_bags=str(folder))
    world.meet('joint_states', 'link_strains', 'motor_currents')

    def said() -> list[str]:
        return [item.msg for item in log if item.name == 'monitor' and (
            'the bag of an event' in item.msg or 'cannot be written' in item.msg
            or 'to see why: ' in item.msg)]
    for number, (first, last) in enumerate(((BEGIN, END), (END, LAST)), 1):
        begun = node.meter.count
        feed(world, pushes, lambda: 10**9 if node.meter.count >= 3 * (  # noqa: B023
            last - first) + begun else (node.meter.count - begun) // 3,  # noqa: B023
            first=first, last=last)
        assert world.spin(lambda: len(records) >= number and len(said()) >= number)  # noqa: B023
    world.end(node)
    assert len(records) == len(said()) == 2
    assert all(json.loads(record.data)['state']['level'] for record in records)
    return said()


def test_a_full_disk(
    world: World, model: Path, pushes: Recording, small_disk: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The monitor goes on judging, says so in one line an event, and no part of a bag is left."""
    (small_disk / 'rest').write_bytes(bytes(200_000))
    said = two_pushes(world, model, pushes, small_disk / 'events', monkeypatch)
    assert all('No space left' in text and '\n' not in text for text in said)
    assert {path.name for path in small_disk.rglob('*')} == {'events', 'rest'}


def test_a_folder_of_somebody_else(
    world: World, model: Path, pushes: Recording, tmp_path: Path, root: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    """Files and bags of a user stay to the last byte, however few bags are kept."""
    monkeypatch.setattr('tudor_dynamics.online.black_box.BAGS', 1)
    shutil.copytree(root / 'bags/two_blade_test', tmp_path / 'event_20200101_000000_000000')
    (tmp_path / 'event_notes').mkdir()
    (tmp_path / 'event_notes' / 'thesis.txt').write_text('years of work')
    (tmp_path / 'event_20990101_000000_000000').write_text('not a bag')
    there = {path: path.read_bytes() if path.is_file() else b'' for path in tmp_path.rglob('*')}
    said = two_pushes(world, model, pushes, tmp_path, monkeypatch)
    first, second = (Path(shlex.split(text.partition(' (')[0])[-1]) for text in said)
    assert not first.exists() and [path for path in tmp_path.iterdir() if path not in there] == [
        second]
    assert {path: path.read_bytes() if path.is_file() else b'' for path in there} == there
    assert main(['why', str(tmp_path)]) in (0, 1)
    assert f'{second}: the newest bag of an event' in unwrapped(capsys.readouterr().out)


def to_process(world: World, pushes: Recording, first: int, last: int) -> None:
    """Play a part to a monitor that runs as a process of its own."""
    world.meet('joint_states', 'link_strains', 'motor_currents')
    feed(world, pushes, lambda: 10**9, first=first, last=last, batch=1,
         change=lambda *_: time.sleep(2e-3))


def kill_at_the_next_bag(process: Popen, folder: Path) -> None:
    """Kill a process as soon as there is a file of a bag that it has not finished."""
    end = time.monotonic() + PATIENCE
    while not list(folder.glob('.event_*/*/*')) and time.monotonic() < end:
        time.sleep(1e-3)
    process.kill()


def test_killed_while_a_bag_is_written(
    world: World, model: Path, pushes: Recording, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The next start takes no half bag for a whole one; `tudor why` finds the newest whole one."""
    words = ['monitor', '-p', f'model:={model}', '-p', f'event_bags:={tmp_path}']

    def whole() -> list[Path]:
        return sorted(tmp_path.glob('event_*'))

    def named() -> str:
        assert main(['why', str(tmp_path)]) in (0, 1)
        return unwrapped(capsys.readouterr().out).partition(': the newest bag of an event')[0]
    process = launch(*words)
    try:
        to_process(world, pushes, BEGIN, END)
        assert world.spin(lambda: bool(whole()))
        killer = Thread(target=kill_at_the_next_bag, args=(process, tmp_path))
        killer.start()
        to_process(world, pushes, END, LAST)
        killer.join()
    finally:
        process.kill()
        out, _ = process.communicate()
    half = [path for path in tmp_path.glob('.event_*/*/*') if path.is_file()]
    assert half and process.returncode == -signal.SIGKILL, out
    first, = whole()
    assert named() == str(first)
    assert world.spin(lambda: not world.output('joint_states').get_subscription_count())
    process = launch(*words)
    try:
        to_process(world, pushes, BEGIN, END)
        assert world.spin(lambda: len(whole()) > 1)
    finally:
        finish(process, signal.SIGTERM)
    assert named() == str(whole()[1]) and whole()[0] == first
    assert all(path.exists() for path in half)


@pytest.mark.parametrize('word', OFF)
def test_off(world: World, model: Path, pushes: Recording, tmp_path: Path,
             monkeypatch: pytest.MonkeyPatch, word: str) -> None:
    """Nothing is written, and the record comes all the same."""
    monkeypatch.setenv('ROS_HOME', str(tmp_path))
    assert played(world, model, pushes, Path(word))
    assert not list(tmp_path.iterdir())


def test_the_word_passes_a_command_line() -> None:
    """A parameter is read as YAML, to which a bare `off` is no text."""
    assert yaml.safe_load(OFF[0]) == OFF[0]
