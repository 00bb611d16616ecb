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

"""A monitor that judges less than what comes says so: through topics, by a clock of the test."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
import pytest
from rcl_interfaces.msg import Log
from rclpy.qos import QoSProfile

from ros_world import feed, Hand, values_of, World
from tudor_dynamics.cli.main import main
from tudor_dynamics.nodes.collision_detector import CollisionDetectorNode
from tudor_dynamics.nodes.common.model_node import ModelNode
from tudor_dynamics.nodes.dynamics_predictor import DynamicsPredictorNode
from tudor_dynamics.nodes.joint_state_filter import JointStateFilterNode
from tudor_dynamics.nodes.monitor import MonitorNode

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
Change = Callable[[int, dict[str, Any]], None]


class Watched:
    """A node whose steady clock goes with the stamps of what it is fed."""

    def __init__(self, world: World, recording: Any, factory: Any, model: Path, **more: Any):
        self.world, self.recording, self.hand = world, recording, Hand()
        self.node = world.add(partial(factory, steady=self.hand), model=str(model),
                              **{'methods': ['strain'], 'timeout': 30.0, **more})

    def feed(self, first: int, last: int, change: Change | None = None,
             progress: Callable[[], int] | None = None) -> None:
        """Feed samples; what the change leaves is all that is sent."""
        sent, before = [0], self.node.meter.count

        def each(k: int, messages: dict[str, Any]) -> None:
            self.hand.now += self.recording.dt
            messages.pop('motor_currents', None)
            if change is not None:
                change(k, messages)
            sent[0] += len(messages)

        def through() -> int:
            return 10**9 if self.node.meter.count - before >= sent[0] else 0
        feed(self.world, self.recording, progress or through, first=first, last=last,
             change=each)
        assert self.world.spin(lambda: (progress or through)() >= last - first)

    def told(self) -> tuple[bytes, str, dict[str, str]]:
        """Give level, message and values of a diagnosis made now."""
        heard = self.world.heard['/diagnostics']
        heard.clear()
        name = f'{self.node.get_name()}: /'
        self.node.publish_diagnostics()

        def found() -> list[Any]:
            return [s for a in heard for s in a.status if s.name == name]
        assert self.world.spin(lambda: bool(found()))
        status = found()[-1]
        return status.level, status.message, values_of(status)


@pytest.fixture
def watched(world: World, model: Path, recording: Any) -> Watched:
    """Give a monitor of the strain."""
    made = Watched(world, recording, MonitorNode, model)
    assert made.node.watch.stages
    world.meet('joint_states', 'link_strains')
    return made


def test_settling_is_told_and_then_all_is_judged(watched: Watched) -> None:
    """Half a second of settling is a WARN; a second later every sample is judged: OK."""
    watched.feed(0, 40)
    level, message, values = watched.told()
    assert level == WARN and 'filters settle' in message
    assert float(values['not judged: settling']) > 50.0
    watched.feed(40, 300)
    level, message, values = watched.told()
    assert (level, message, values['not judged [%]']) == (OK, 'running', '0.0')


@pytest.mark.parametrize(('lost', 'wanted', 'share'), [
    ((7,), WARN, 5.0), ((3, 6, 9, 13, 16, 19), ERROR, 30.0)])
def test_lost_samples(watched: Watched, lost: tuple[int, ...], wanted: bytes,
                      share: float) -> None:
    """Of every twenty samples one is lost, or six: the share, and the number of samples."""
    def lose(k: int, messages: dict[str, Any]) -> None:
        if k % 20 in lost:
            messages.clear()
    watched.feed(0, 100)
    watched.feed(100, 400, lose)
    level, message, values = watched.told()
    assert level == wanted and 'lost' in message and 'not judged: gap' in values
    assert float(values['not judged: gap']) == pytest.approx(share, abs=1.0)
    # of positions and of strains
    assert int(values['dropped: gap']) == pytest.approx(2 * 15 * len(lost), abs=4)


def test_a_silent_gauge_topic(watched: Watched) -> None:
    """An ERROR within 1.2 s of the steady clock, which names the topic; back: OK."""
    def mute(_: int, messages: dict[str, Any]) -> None:
        del messages['link_strains']
    watched.feed(0, 200)
    watched.feed(200, 280, mute)
    assert watched.told()[0] != ERROR
    watched.feed(280, 325, mute)
    level, message, values = watched.told()
    assert level == ERROR and 'no message came on link_strains' in message
    assert values['not judged [%]'] == '100.0'
    watched.feed(325, 560)
    assert watched.told()[0] == OK


def test_silent_positions(watched: Watched) -> None:
    """Strains alone are no life: an ERROR that names the joints' topic."""
    def mute(_: int, messages: dict[str, Any]) -> None:
        del messages['joint_states']
    watched.feed(0, 200)
    watched.feed(200, 325, mute)
    level, message, _ = watched.told()
    assert level == ERROR and 'no message came on joint_states' in message


@pytest.mark.parametrize(('every', 'wanted'), [(20, WARN), (1, ERROR)])
def test_strains_that_are_no_numbers(watched: Watched, every: int, wanted: bytes) -> None:
    """One in twenty is a WARN, all are an ERROR, with the cause."""
    def spoil(k: int, messages: dict[str, Any]) -> None:
        if k % every == 0:
            messages['link_strains'].position[0] = float('nan')
    watched.feed(0, 200)
    watched.feed(200, 360, spoil)
    level, message, values = watched.told()
    assert level == wanted and 'NaN' in message and 'not judged: not_finite' in values
    assert float(values['not judged: not_finite']) == pytest.approx(100.0 / every, abs=2.0)


@pytest.mark.parametrize(('offset', 'wanted', 'side'), [
    (300, WARN, 'earlier'), (-300, WARN, 'later'), (10_000, ERROR, 'earlier'),
    (-10_000, ERROR, 'later')])
def test_stamps_of_two_topics_apart(
    watched: Watched, offset: int, wanted: bytes, side: str,
) -> None:
    """Clocks of two hosts: told with the offset in ms and both topics, in either direction."""
    def shift(_: int, messages: dict[str, Any]) -> None:
        stamp = messages['link_strains'].header.stamp
        now = stamp.sec * 10**9 + stamp.nanosec + offset * 10**6
        stamp.sec, stamp.nanosec = divmod(now, 10**9)
    watched.feed(0, 400, shift)
    level, message, _ = watched.told()
    assert level == wanted
    assert (f'stamps of link_strains are {abs(offset)} ms {side} than those of joint_states'
            in message)


def test_positions_with_repeated_stamps(watched: Watched) -> None:
    """A driver whose stamps stand still: an ERROR with the cause."""
    def hold(k: int, messages: dict[str, Any]) -> None:
        for message in messages.values():
            message.header.stamp.sec, message.header.stamp.nanosec = 5, 0
    watched.feed(0, 200, hold)
    level, message, values = watched.told()
    assert level == ERROR and 'stamps on ' in message and 'not judged: duplicate_stamp' in values


def test_without_thresholds(watched: Watched) -> None:
    """A monitor that only shows residuals is blind, and says what to do; learning is a WARN."""
    node = watched.node
    node.watch.use_thresholds({}, node.settings())
    node.adopt(node.bundle, node.monitor, node._own, (), {})
    assert node._note.startswith('the model has no thresholds for strain; fit it')
    watched.feed(0, 60)
    level, message, _ = watched.told()
    assert level == WARN and message.count('the model has no thresholds') == 1, message
    watched.feed(60, 300)
    level, message, values = watched.told()
    assert level == ERROR and 'the service /monitor/calibrate' in message
    assert values['not judged: no_thresholds'] == '100.0'
    watched.node._calibrate()
    level, message, values = watched.told()
    assert level == WARN and 'let nothing touch it' in message


def test_detector_without_predictions(world: World, model: Path, recording: Any) -> None:
    """The separate detector names the topic of the predictions that stopped."""
    first = world.add(JointStateFilterNode, model=str(model))
    predictor = world.add(DynamicsPredictorNode, model=str(model))
    watched = Watched(world, recording, CollisionDetectorNode, model)
    world.meet('joint_states', 'link_strains')

    def through() -> int:
        return first.meter.count
    watched.feed(0, 200, progress=through)
    assert world.spin(lambda: watched.node.watch.counts['strain']['judged'] == 150)
    world.rest(0.1)  # nothing is under way any more
    world.end(predictor)
    watched.feed(200, 340, progress=lambda: through() - 200)
    world.rest(0.1)
    level, message, values = watched.told()
    assert level == ERROR and 'no message came on predicted_strains' in message, values


def test_two_publishers_of_collisions(world: World, model: Path) -> None:
    """Monitor and detector in one namespace name each other."""
    nodes = [world.add(kind, model=str(model), timeout=60.0)
             for kind in (MonitorNode, CollisionDetectorNode)]
    for node in nodes:
        node.meter.begin()

    def told(node: Any, rival: str) -> bool:
        level, message, _ = node.status()
        return level == WARN and f'{rival} can also publish on collision' in message
    assert world.spin(lambda: told(nodes[0], '/collision_detector')
                      and told(nodes[1], '/monitor'))
    world.end(nodes[1])
    assert world.spin(lambda: nodes[0].status()[0] == OK)


def test_a_blind_monitor_outranks_a_warning(
    watched: Watched, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A payload outside the model's range does not hide that nothing is judged."""
    def mute(_: int, messages: dict[str, Any]) -> None:
        del messages['link_strains']
    watched.feed(0, 200)
    monkeypatch.setattr(ModelNode, 'verdict', lambda _: (WARN, 'payload 0.7 kg'))
    level, message, _ = watched.told()
    assert level == WARN and 'payload 0.7 kg' in message
    watched.feed(200, 325, mute)
    level, message, _ = watched.told()
    assert level == ERROR and 'no message came on link_strains' in message


def test_methods_of_the_model(
    world: World, root: Path, model: Path, tmp_path: Path,
) -> None:
    """By default those with thresholds; one that was asked for in vain is named."""
    node = world.add(MonitorNode, model=str(model))
    assert node.watch.methods == tuple(node.watch.stages) and 'strain' in node.watch.methods
    world.end(node)
    # half a bag is too little for a good network (exit code 1), but here any will do
    assert main(['fit', str(root / 'bags/two_blade_train_1'), '--arm',
                 str(root / 'config/two_blade_arm.yaml'), '--models', 'elm',
                 '--out', str(tmp_path / 'elm')]) in (0, 1)
    node = world.add(MonitorNode, model=str(tmp_path / 'elm'), kind='elm',
                     methods=['strain', 'momentum'])
    node.meter.begin()
    level, message, _ = node.status()
    assert level == WARN and 'methods momentum need a model of kind elm' in message
    world.end(node)
    node = world.add(MonitorNode, model=str(tmp_path / 'elm'), kind='elm', methods=['momentum'])
    node.meter.begin()
    level, message, _ = node.status()
    assert level == ERROR and 'methods momentum need a model of kind elm' in message


def test_log_of_starts_and_levels(world: World, model: Path) -> None:
    """One line at the start, one at each change of the level, none while nothing changes."""
    lines = world.listen('/rosout', Log, QoSProfile(depth=100))
    node = world.add(MonitorNode, model=str(model), methods=['strain'], timeout=60.0)

    def said(text: str) -> list[Log]:
        return [line for line in lines if line.name == 'monitor' and text in line.msg]
    assert world.spin(lambda: bool(said('started: ')))
    start = said('started: ')[0].msg
    for part in (str(model), 'two_blade_arm', 'methods strain', '/joint_states', '/collision'):
        assert part in start
    assert world.spin(lambda: bool(said('start -> STALE: no message comes')))
    node.meter.begin()
    for _ in range(3):
        node.publish_diagnostics()
    node.fault = 'broken'
    for _ in range(3):
        node.publish_diagnostics()
    assert world.spin(lambda: bool(said('OK -> ERROR: broken')))
    assert len(said('STALE -> OK: running')) == 1 == len(said('started: '))
    error = said('OK -> ERROR: broken')
    assert len(error) == 1 and error[0].level == 40  # of rcl_interfaces/Log


def test_diagnostics_of_a_node_that_was_shut_down(world: World) -> None:
    """A managed node that ended tells so at once and goes on telling, whatever comes in."""
    node = world.add(JointStateFilterNode)
    world.heard['/diagnostics'].clear()
    node.ended = 'shut down: start it again'
    node.publish_diagnostics()
    for _ in range(2):
        node.meter.begin()
        status = world.status('joint_state_filter')
        assert (status.level, status.message) == (WARN, 'shut down: start it again')


def test_counting_is_cheap(watched: Watched) -> None:
    """A message costs two sums and a comparison; looks come ten times a second."""
    looked: list[float] = []
    judged = watched.node.coverage._outputs[0]
    look = judged.look
    judged.look = lambda now: (looked.append(now), look(now))[1]
    watched.feed(0, 300)
    assert 25 <= len(looked) <= 32
    assert np.diff(looked).min() > 0.09
