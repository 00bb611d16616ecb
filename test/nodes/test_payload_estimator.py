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

"""The load over topics: as offline, announced, and to those who follow it."""

from __future__ import annotations

from dataclasses import replace
import json
from pathlib import Path
from typing import Any

from action_msgs.msg import GoalStatus, GoalStatusArray
from geometry_msgs.msg import InertiaStamped
import numpy as np
from papers.following import follow_load
from payload_making import (
    LOAD, moving, payload_bundle, PICKED_UP, RATE, true_outputs, two_gauge_arm)
import pytest
from ros_world import feed, values_of, World
from sample_arms import LENGTH_2, multisine, recording_of
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.cli.main import build_parser, main
from tudor_dynamics.cli.why import causes
from tudor_dynamics.errors import BagError
from tudor_dynamics.identification.causes import explain, replay
from tudor_dynamics.load.live import carried_load
from tudor_dynamics.models.bundle import load_bundle
from tudor_dynamics.nodes.collision_detector import CollisionDetectorNode
from tudor_dynamics.nodes.common.base import latched, WARN
from tudor_dynamics.nodes.dynamics_predictor import DynamicsPredictorNode
from tudor_dynamics.nodes.joint_state_filter import JointStateFilterNode
from tudor_dynamics.nodes.monitor import MonitorNode
from tudor_dynamics.nodes.payload_estimator import PayloadEstimatorNode
from tudor_dynamics.online.black_box import (
    ASKED, Heard, messages_of, records_of, STATES)
from tudor_dynamics.online.coverage import CoverageLevel, CoverageReport
from tudor_dynamics.online.monitor import Monitor, MonitorSettings
from tudor_dynamics.show.live import LiveView, picture_of

SECONDS = 8.0


@pytest.fixture(scope='module')
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a model of the strains from 0 to 400 g."""
    return payload_bundle(tmp_path_factory.mktemp('payload') / 'model')


@pytest.fixture(scope='module')
def seen() -> Recording:
    """Pick up a load while the arm moves."""
    return moving(SECONDS)


def offline(bundle: Path, seen: Recording) -> list[tuple[float, float]]:
    """Follow the load with the object of the node."""
    found = follow_load(load_bundle(bundle), seen, 0.0)
    return list(zip(found.mass.tolist(), found.std.tolist(), strict=True))


def named(_: int, messages: dict[str, Any]) -> None:
    """Give the joints of a recording their names."""
    messages['joint_states'].name = ['j1', 'j2']


def test_picked_up(bundle: Path, seen: Recording) -> None:
    """A load is recognised within a second, and known to 10 g soon; before, there is none."""
    found = np.array(offline(bundle, seen))
    at = np.searchsorted(np.arange(len(found)) / RATE, [PICKED_UP, PICKED_UP + 1.0, SECONDS])
    assert abs(found[at[0] - 1, 0]) < 0.01
    assert abs(found[at[1], 0] - LOAD) < 0.03
    assert abs(found[-1, 0] - LOAD) < 0.01
    assert abs(found[-1, 0] - LOAD) < 3.0 * found[-1, 1] < 0.1


def test_over_topics(world: World, bundle: Path, seen: Recording) -> None:
    """The node knows the load that the same object knows offline, and tells it to a predictor."""
    node = world.add(PayloadEstimatorNode, model=str(bundle))
    predictor = world.add(DynamicsPredictorNode, model=str(bundle), payload_source='topic')
    world.listen('payload', InertiaStamped, latched())
    world.meet('joint_states', 'link_strains')

    feed(world, seen, lambda: node.meter.count // 2, change=named, batch=1, gauges=['g1', 'g2'])
    mass, std = offline(bundle, seen)[-1]
    assert node.port.load.mass == pytest.approx(mass, abs=1e-9)
    assert node.port.load.std == pytest.approx(std, abs=1e-9)
    own = {item.topic_name for item in node.publishers}
    assert '/payload' in own and '/payload_estimator/collision' in own
    assert '/collision' not in own and '/strain_residuals' not in own
    told = world.heard['payload']
    assert told[-1].header.frame_id == node.port.load.frame
    assert told[-1].inertia.com.x == pytest.approx(LENGTH_2)
    assert told[-1].inertia.m == pytest.approx(mass, abs=0.1 * std + 1e-9)
    assert world.spin(lambda: abs(predictor.port.load.mass - told[-1].inertia.m) < 1e-12)
    status = values_of(world.status('payload_estimator'))
    assert status['payload estimated from'] == 'strain' and float(status['payload std [kg]']) > 0.0
    assert status['load'] == f'load {mass:.3f} +- {std:.3f} kg, estimated'
    assert predictor.status()[2]['load'] == f'load {told[-1].inertia.m:.3f} kg (topic payload)'


def test_a_bag_that_is_watched_says_the_load(
    bundle: Path, seen: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The same line as the diagnostics of a node, with mass and deviation of the last sample."""
    views: list[LiveView] = []
    monkeypatch.setattr('tudor_dynamics.cli.watch.picture_of',
                        lambda view: views.append(view) or picture_of(view))
    write_bag(tmp_path / 'bag', seen, arm=two_gauge_arm())
    assert main(['watch', str(tmp_path / 'bag'), '--model', str(bundle), '--picture',
                 str(tmp_path / 'view.svg')]) == 0
    mass, std = offline(bundle, seen)[-1]
    assert views[0].load == f'load {mass:.3f} +- {std:.3f} kg, estimated'


def test_expected(world: World, bundle: Path) -> None:
    """A load is announced by a service; without a model that tells kilograms it is refused."""
    node = world.add(PayloadEstimatorNode, model=str(bundle))
    answer = node.port._expect()
    assert 'not reported as a collision' in answer and node.port.load is not None
    assert world.call(Trigger, 'payload_estimator/expect_payload').success


def test_contacts_that_go_unseen(
    world: World, bundle: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It says what this means for the load; it reports no collisions itself."""
    node = world.add(PayloadEstimatorNode, model=str(bundle))
    monkeypatch.setattr(MonitorNode, 'verdict', lambda self: (WARN, 'samples are lost'))
    assert node.verdict() == (WARN, 'samples are lost')
    node.coverage.verdict = CoverageReport(CoverageLevel.PARTIAL, 'samples are lost')
    assert node.verdict() == (WARN, 'a touch may be estimated as a load, as samples are lost')


def test_without_a_scale(world: World, model: Path) -> None:
    """Strains of unknown gain tell no kilograms: the diagnosis says what would."""
    node = world.add(PayloadEstimatorNode, model=str(model))
    assert 'two loads' in node.fault


def test_taken_back(world: World, bundle: Path, seen: Recording) -> None:
    """A load that nobody announced is a collision first, and then none; the mass is known."""
    node = world.add(MonitorNode, model=str(bundle), payload_source='estimate')
    world.listen('collision', Bool, latched())
    world.listen('payload', InertiaStamped, latched())
    world.meet('joint_states', 'link_strains')
    feed(world, seen, lambda: node.meter.count // 2, change=named, batch=1, gauges=['g1', 'g2'])
    assert world.spin(lambda: [item.data for item in world.heard['collision']] == [
        False, True, False])
    assert world.spin(lambda: abs(world.heard['payload'][-1].inertia.m - LOAD) < 0.01)
    status = values_of(world.status(
        'monitor', lambda item: values_of(item).get('collisions that were loads') == '1'))
    assert status['level'] == 'free' and status['loads announced'] == '0'
    assert node._reset() == 'armed' and node.port.load.mass == 0.0


def test_the_bag_has_what_was_heard_of_a_load(
    world: World, bundle: Path, seen: Recording, tmp_path: Path,
) -> None:
    """The load on its topic, and the gripper: as messages, like those of the sensors."""
    node = world.add(MonitorNode, model=str(bundle), event_bags=str(tmp_path),
                     payload_source='topic', gripper_topic='gripper')
    world.output('gripper', Bool)
    world.outputs['payload'] = world.probe.create_publisher(InertiaStamped, 'payload', latched())
    world.meet('joint_states', 'link_strains', 'gripper', 'payload')
    heard = InertiaStamped()
    heard.inertia.m = 0.1
    world.output('payload').publish(heard)
    world.output('gripper').publish(Bool(data=True))
    assert world.spin(lambda: node.port.load.mass == 0.1 and node.gripper._closed is True)
    records = world.listen('collision_record', String, latched())
    feed(world, seen, lambda: node.meter.count // 2, change=named, batch=1, gauges=['g1', 'g2'])
    assert world.spin(lambda: bool(records))
    world.end(node)
    (path,) = tmp_path.iterdir()
    bag = open_bag(path)
    assert (bag.topics['/payload'].count, bag.topics['/gripper'].count) == (1, 1)
    assert bag.topics['/payload'].msgtype == 'geometry_msgs/msg/InertiaStamped'


@pytest.mark.parametrize('how', ['topic', 'gripper', 'reset'])
def test_a_replay_knows_what_was_asked_for(
    world: World, bundle: Path, seen: Recording, tmp_path: Path, how: str,
) -> None:
    """A load that is heard or announced, or a reset: from the bag the same events come again."""
    at, source = round(PICKED_UP * RATE), 'topic' if how == 'topic' else 'estimate'
    node = world.add(MonitorNode, model=str(bundle), event_bags=str(tmp_path),
                     payload_source=source, gripper_topic='gripper', payload=0.0)
    heard = InertiaStamped()
    heard.inertia.m = LOAD
    world.meet('joint_states', 'link_strains')
    world.output('gripper', Bool)
    world.outputs['payload'] = world.probe.create_publisher(InertiaStamped, 'payload', latched())
    world.meet('gripper', *['payload'] * (how == 'topic'))

    def ask(k: int, messages: dict[str, Any]) -> None:
        named(k, messages)
        if how == 'topic' and k == at:
            world.output('payload').publish(heard)
            assert world.spin(lambda: node.port.load.mass == LOAD)
        if how == 'gripper' and k in (at - 100, at):
            world.output('gripper').publish(Bool(data=k == at))
            assert world.spin(lambda: node.gripper._closed is (k == at))
        if how == 'reset' and k == 680:  # during the touch, which comes again then
            assert world.call(Trigger, 'monitor/reset').success
    strain = seen.strain.copy()
    strain[650:720] += [150.0, -100.0]
    feed(world, replace(seen, strain=strain), lambda: node.meter.count // 2, change=ask, batch=1,
         gauges=['g1', 'g2'])
    world.end(node)
    (path,) = tmp_path.iterdir()
    bag, whole = open_bag(path), load_bundle(bundle)
    assert {f'/{ASKED}', *({'topic': ['/payload'], 'gripper': ['/gripper']}.get(how, []))} <= {
        *bag.topics}
    records, messages = records_of(bag), messages_of(bag, whole.arm)

    def onsets(some: list[Heard]) -> list[int]:
        monitor = Monitor(whole.at(0.0), MonitorSettings.of(records[0]['settings']),
                          payload=carried_load(source, whole, 0.0))
        return [item.event.onset for item in replay(some, monitor).log.events]
    expected = [record['onset'] for record in records]
    assert expected and onsets(messages) == expected
    assert onsets([item for item in messages if ASKED not in item.fields]) != expected
    assert all(item.same for item in causes(build_parser('why').parse_args(['why', str(path)])))


def test_a_load_of_long_ago(
    world: World, bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The load was estimated before the bag begins: the same event comes to the last bit."""
    monkeypatch.setattr('tudor_dynamics.online.black_box.RING_BYTES', 180_000)
    for name, seconds in {'EVERY': 1.0, 'OLDEST': 9.0, 'APART': 4.0}.items():
        monkeypatch.setattr(f'tudor_dynamics.online.memory.MEMORY_{name}', seconds)
    node = world.add(MonitorNode, model=str(bundle), event_bags=str(tmp_path),
                     payload_source='estimate')
    world.meet('joint_states', 'link_strains')
    recording = moving(20.0)
    strain = recording.strain.copy()
    strain[1900:1950] += [150.0, -100.0]

    def announced(k: int, messages: dict[str, Any]) -> None:
        named(k, messages)
        if k == round(PICKED_UP * RATE):
            assert world.call(Trigger, 'monitor/expect_payload').success
    feed(world, replace(recording, strain=strain), lambda: node.meter.count // 2,
         change=announced, batch=1, gauges=['g1', 'g2'])
    world.end(node)
    (path,) = tmp_path.iterdir()
    bag, command = open_bag(path), build_parser('why').parse_args(['why', str(path)])
    assert 1000 < bag.topics['/link_strains'].count < 1300  # its begin has gone
    records = records_of(bag)
    assert [item.same for item in causes(command)] == [True] * len(records) != []
    states = json.loads(bag.metadata.custom[STATES])
    inner = states['load'][0]['state']['observer']
    for damage in ({'_kept': []}, {'_recent': {**inner['_recent'], '_full': 10**6}}):
        damaged = {**states['load'][0], 'state': {
            **states['load'][0]['state'], 'observer': {**inner, **damage}}}
        custom = {**bag.metadata.custom, STATES: json.dumps({**states, 'load': [damaged]})}
        with pytest.raises(BagError, match='damaged records'):
            explain(replace(bag, metadata=replace(bag.metadata, custom=custom)),
                    load_bundle(bundle), MonitorSettings.of(records[0]['settings']), 'estimate',
                    0.0, records)
    monkeypatch.setattr('tudor_dynamics.identification.causes.STATES', 'none')
    assert [item.same for item in causes(command)] != [True] * len(records)


def test_touched(world: World, bundle: Path) -> None:
    """While the detector tells a contact the mass waits; after it the next load is learned."""
    arm, touched, ended, changed = two_gauge_arm(), 4.0, 5.5, 7.0
    t = np.arange(0.0, 8.5, 1.0 / RATE)
    moved = multisine(t, 2, 3)
    first, then = (true_outputs(arm, moved, m)['strain'] for m in (0.2, LOAD))
    strain = np.where(t[:, None] < changed, first, then)
    strain += np.random.default_rng(0).standard_normal(strain.shape)
    # shaking, so that nothing but the detector says that the arm is touched: no moment stays
    shaken = np.where((t > touched) & (t < ended), np.sin(20.0 * t), 0.0)
    strain += shaken[:, None] * [120.0, -80.0]
    node = world.add(MonitorNode, model=str(bundle), payload_source='estimate', payload=0.2)
    world.listen('collision', Bool, latched())
    world.meet('joint_states', 'link_strains')
    masses: list[float] = []

    def look(k: int, messages: dict[str, Any]) -> None:
        named(k, messages)
        masses.append(node.port.load.mass)
        if k == round(6.9 * RATE):
            node.port._expect()
    feed(world, recording_of(moved[:, :2], RATE, dq=moved[:, 2:4], strain=strain),
         lambda: node.meter.count // 2, change=look, batch=1, gauges=['g1', 'g2'])
    at = {time: round(time * RATE) for time in (touched, 4.5, 5.4, 6.9)}
    assert abs(masses[at[touched]] - 0.2) < 0.01
    assert len(set(masses[at[4.5]:at[5.4]])) == 1  # not a digit
    assert abs(masses[at[5.4]] - 0.2) < 0.02
    assert len(set(masses[at[5.4]:at[6.9]])) > 30 and abs(masses[at[6.9]] - 0.2) < 0.01
    assert abs(node.port.load.mass - LOAD) < 0.02
    assert world.spin(lambda: [item.data for item in world.heard['collision']] == [
        False, True, False])
    counted = values_of(world.status('monitor'))
    assert counted['loads announced'] == '1' and counted['collisions that were loads'] == '0'


def test_detector_estimates(world: World, bundle: Path, seen: Recording) -> None:
    """A detector of its own tells the load to its predictor, and takes the collision back."""
    chain = [world.add(JointStateFilterNode, model=str(bundle)),
             world.add(DynamicsPredictorNode, model=str(bundle), payload_source='topic'),
             world.add(CollisionDetectorNode, model=str(bundle), payload_source='estimate')]
    world.listen('collision', Bool, latched())
    world.meet('joint_states', 'link_strains')
    wanted = {'/joint_motion': 2, '/predicted_strains': 1}
    assert world.spin(lambda: all(
        item.get_subscription_count() >= wanted.get(item.topic_name, 0)
        for node in chain for item in node.publishers))
    watch = chain[2].watch
    feed(world, seen, lambda: min(sum(watch.counts['strain'].values()), chain[2].meter.count),
         change=named, batch=1, gauges=['g1', 'g2'])
    load = chain[2].port.load
    mass, std = offline(bundle, seen)[-1]
    assert load.mass == pytest.approx(mass, abs=1e-9) and load.std == pytest.approx(std, abs=1e-9)
    assert world.spin(lambda: abs(chain[1].port.load.mass - mass) < 0.2 * std)
    assert [item.data for item in world.heard['collision']] == [False, True, False]


def test_detector_hears(world: World, bundle: Path) -> None:
    """With the load on a topic it is that which counts; one that jumps is told as a load once."""
    node = world.add(CollisionDetectorNode, model=str(bundle), payload_source='topic')
    publisher = world.probe.create_publisher(InertiaStamped, 'payload', latched())
    message = InertiaStamped()
    message.inertia.m = 0.25
    assert world.spin(lambda: publisher.get_subscription_count() == 1)
    publisher.publish(message)
    assert world.spin(lambda: node.port.load.mass == 0.25)
    assert node.watch.payload is node.port.load
    sample = 0.01, np.zeros(6), np.zeros(2)
    first = node.port.load.step(1_000_000_000, *sample, touched=True)
    assert first is not None and first.change == pytest.approx(0.25)
    assert node.port.load.step(1_010_000_000, *sample, touched=True) is None


def test_gripper(world: World, bundle: Path) -> None:
    """What grippers publish announces loads: a state, fingers that are none of the arm, goals."""
    def goal(number: int, status: int) -> GoalStatusArray:
        item = GoalStatus(status=status)
        item.goal_info.goal_id.uuid = [number] * 16
        return GoalStatusArray(status_list=[item])

    def fingers(place: float, joint: float) -> JointState:
        return JointState(name=['finger', 'j1'], position=[place, joint])
    messages = {
        'std_msgs/msg/Bool': [Bool(data=False), Bool(data=False), Bool(data=True)],
        'sensor_msgs/msg/JointState': [fingers(0.04, 0.0), fingers(0.0401, 0.5),
                                       fingers(0.02, 0.5)],
        'action_msgs/msg/GoalStatusArray': [
            goal(1, GoalStatus.STATUS_SUCCEEDED), goal(2, GoalStatus.STATUS_CANCELED),
            goal(3, GoalStatus.STATUS_EXECUTING)]}
    for kind, sent in messages.items():
        topic = f'gripper_{type(sent[0]).__name__.lower()}'
        node = world.add(MonitorNode, model=str(bundle), payload_source='estimate',
                         gripper_topic=topic, gripper_type=kind)
        publisher = world.probe.create_publisher(type(sent[0]), topic, 10)
        assert world.spin(lambda: publisher.get_subscription_count() == 1)
        announced, heard, acts = [], [], node.gripper._acts
        node.gripper._acts = lambda item: heard.append(item) or acts(item)  # noqa: B023
        for message in sent:
            count = len(heard)
            publisher.publish(message)
            assert world.spin(lambda: len(heard) > count)
            announced.append(node.port.values()['loads announced'])
        assert announced == ['0', '0', '1'] and node.port.load.expecting
        world.end(node)
