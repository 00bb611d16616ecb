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

"""The live view of topics: what a monitor publishes stands in it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import json
import math
from pathlib import Path
import shlex
import subprocess
import sys
import threading
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import pytest
from rich.console import Group
from ros_world import feed, Hand, joint_message, World
from std_msgs.msg import Bool, String
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.cli.main import main
from tudor_dynamics.nodes.common.base import latched
from tudor_dynamics.nodes.monitor import MonitorNode
from tudor_dynamics.nodes.watch import WatchNode
from tudor_dynamics.online.detector import time_of_day
from tudor_dynamics.show.live import drawn, LiveView, page_of, picture_of


def test_a_monitor_is_watched(
    world: World, model: Path, root: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """Values, level, event and state; where no terminal watches, each event is a line."""
    pushes = read_recording(root / 'bags/two_blade_pushes',
                            load_arm(root / 'config/two_blade_arm.yaml'))
    node = world.add(MonitorNode, model=str(model), event_bags='off')
    view = world.add(WatchNode).view
    world.meet('joint_states', 'motor_currents', 'link_strains')
    feed(world, pushes, lambda: node.meter.count // 3 + 1, first=1200, last=1800)
    assert world.spin(lambda: bool(view.events))
    assert world.spin(lambda: view.state.endswith(' % judged') and view.load == 'no load assumed')
    assert set(view.peaks) == set(node.watch.stages)
    assert max(peak for peaks in view.peaks.values() for peak in peaks.values()) > 1.0
    assert world.spin(lambda: view.level == node.watch.level.name.lower())
    for method, past in node._past.items():
        for part, values in (('ratio', past[-1].collision), ('threshold', past[-1].threshold),
                             ('residual', past[-1].residual.value)):
            assert world.spin(lambda: list(  # noqa: B023
                view.values[method, part].values()) == values.tolist())  # noqa: B023
    (line,) = view.events
    assert 'times its threshold' in line
    assert capsys.readouterr().out.splitlines() == [line]


STOPS = 1600
"""Sample from which on something is wrong with a gauge."""


def stands(k: int, messages: dict[str, Any]) -> None:
    """Let a gauge say the same for ever."""
    if k >= STOPS:
        messages['link_strains'].position[1] = 10.0


def has_no_value(k: int, messages: dict[str, Any]) -> None:
    """Let a gauge say that it knows nothing."""
    if k >= STOPS:
        messages['link_strains'].position[1] = math.nan


def is_silent(k: int, messages: dict[str, Any]) -> None:
    """Let all gauges say nothing."""
    if k >= STOPS:
        messages.pop('link_strains')


def goes_on(k: int, messages: dict[str, Any]) -> None:
    """Let all be well."""


@pytest.mark.parametrize('change, states', [
    (goes_on, ['ok', 'ok']), (stands, ['ok', 'stuck']), (has_no_value, ['not judged', 'silent']),
    (is_silent, ['silent', 'silent'])])
def test_topics_and_bag_look_the_same(
    world: World, model: Path, root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    change: Callable[[int, dict[str, Any]], None], states: list[str],
) -> None:
    """Each channel with values and state, load, share judged; the bag explains its event."""
    monkeypatch.setattr('tudor_dynamics.nodes.monitor.RECORDED_AFTER', 600.0)
    pushes = read_recording(root / 'bags/two_blade_pushes',
                            load_arm(root / 'config/two_blade_arm.yaml'))
    node = world.add(MonitorNode, model=str(model), event_bags=str(tmp_path / 'bags'))
    view, sent = world.add(WatchNode).view, [0]
    world.meet('joint_states', 'motor_currents', 'link_strains')

    def each(k: int, messages: dict[str, Any]) -> None:
        change(k, messages)
        sent[0] += len(messages)
    feed(world, pushes, lambda: 10**9 if node.meter.count >= sent[0] else 0, first=1200, last=1800,
         change=each, batch=1)
    node.close()  # writes the bag
    node.publish_diagnostics()
    assert world.spin(lambda: all(view.events.values()) and bool(view.events))
    assert [state for (method, _), (_, state) in view.states.items() if method == 'strain'
            ] == states
    assert {state for (method, _), (_, state) in view.states.items() if method != 'strain'
            } == {'ok'}
    assert world.spin(lambda: view.stamp == pushes.stamp[1799])
    world.rest(0.2)

    def lines(of: LiveView) -> list[str]:
        text = drawn(Group(*of.parts(80, 100))).export_text()
        return [of.state, *text[text.index('residual threshold'):].splitlines()]
    (bag,) = (tmp_path / 'bags').iterdir()
    replayed: list[LiveView] = []
    monkeypatch.setattr('tudor_dynamics.cli.watch.picture_of',
                        lambda view: replayed.append(view) or picture_of(view))
    assert main(['watch', str(bag), '--model', str(model), '--picture',
                 str(tmp_path / 'view.svg')]) == 0
    assert lines(replayed[0]) == lines(view) and max(map(len, lines(view))) <= 80
    assert list(replayed[0].events) == list(view.events)
    for live_or_not in (view, replayed[0]):
        words = shlex.split(next(iter(live_or_not.events.values())))
        assert words[:3] == ['tudor', 'why', str(bag)] and main(words[1:]) in (0, 1)


def test_a_pipe_gets_events_as_they_come(world: World) -> None:
    """A reader has the line while the command goes on; the command ends after its reader."""
    sender = world.probe.create_publisher(String, 'collision_record', latched())
    watch = subprocess.Popen([sys.executable, '-m', 'tudor_dynamics', 'watch'], text=True,
                             stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert watch.stdout and watch.stderr
    lines: list[str] = []
    reader = threading.Thread(target=lambda: lines.append(next(
        line for line in watch.stdout if 'nothing comes from a monitor' not in line)))
    reader.start()
    record = String(data=json.dumps({
        'onset': 10**18, 'method': 'strain', 'link': 'link3', 'ratio': {'hub\x1b[2J': 1.5}}))
    try:
        sender.publish(record)
        assert world.spin(lambda: bool(lines))
        assert watch.poll() is None
        watch.stdout.close()
        sender.publish(record)
        assert world.spin(lambda: watch.poll() is not None)
    finally:
        watch.kill()
        watch.wait()
    assert (watch.returncode, watch.stderr.read()) == (0, '')
    assert lines == [f'{time_of_day(10**18)}  link3 by strain: hub?[2J 1.50 times its threshold\n']


def test_a_monitor_that_died(world: World, capsys: pytest.CaptureFixture[str]) -> None:
    """After 2 s without a word the level is unknown, and it is said what to start."""
    hand = Hand()
    node = world.add(partial(WatchNode, steady=hand, namespace='left'))
    view = node.view
    sender = world.probe.create_publisher(Bool, '/left/contact', latched())
    assert world.spin(lambda: bool(sender.get_subscription_count()))

    def drawn() -> str:
        world.rest(0.3)
        return page_of(view)
    assert 'unknown' in drawn() and 'silent' not in drawn()
    hand.now += 2.1
    assert 'silent for 2 s' in drawn() and 'unknown' in drawn()
    assert 'ros2 run tudor_dynamics monitor' in view.warning and '__ns:=/left' in view.warning
    sender.publish(Bool(data=True))
    assert world.spin(lambda: view.level == 'contact') and 'silent' not in drawn()
    assert 'nothing comes' not in drawn()
    hand.now += 1.9
    assert 'unknown' not in drawn()
    hand.now += 10.0
    assert 'silent for 12 s' in drawn() and 'unknown' in drawn() and 'contact' not in drawn()
    assert capsys.readouterr().out.splitlines() == [view.warning] * 2


def test_a_monitor_that_judges_nothing(world: World) -> None:
    """Where its diagnosis is an ERROR the level is unknown, until a sample is judged again."""
    view = world.add(WatchNode).view
    sender = world.probe.create_publisher(DiagnosticArray, '/diagnostics', 10)
    ratios = world.output('strain_ratios')
    assert world.spin(lambda: sender.get_subscription_count() and ratios.get_subscription_count())

    def diagnosed(level: bytes) -> None:
        sender.publish(DiagnosticArray(status=[DiagnosticStatus(
            level=level, name='monitor: /', message='nothing is judged')]))
    diagnosed(DiagnosticStatus.ERROR)
    assert world.spin(lambda: view.warning == 'nothing is judged') and view.level == 'unknown'
    ratios.publish(joint_message(1_000_000_000, ['link2_hub'], position=[0.5]))
    assert world.spin(lambda: view.level == 'free')
    diagnosed(DiagnosticStatus.WARN)
    assert world.spin(lambda: view.warning == 'nothing is judged') and view.level == 'free'


@pytest.mark.parametrize('text', ['', '[]', '{"onset": 1}', '{"onset": "x", "ratio": 3}'])
def test_foreign_records(world: World, text: str) -> None:
    """They change nothing but a counter."""
    node = world.add(WatchNode)
    sender = world.probe.create_publisher(String, 'collision_record', latched())
    sender.publish(String(data=text))
    assert world.spin(lambda: node.drops['unknown_record'] == 1)
    assert not node.view.events
