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

"""Node oscillation_damper: nothing that fails moves the arm, and one diagnosis names it."""

from __future__ import annotations

from pathlib import Path
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import InertiaStamped
import numpy as np
import pytest
from rclpy.exceptions import InvalidParameterValueException
from rclpy.parameter import Parameter
from ros_world import joint_message, JOINTS, node_class, overrides, values_of, World
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from tudor_dynamics.control.motion_controller import State
from tudor_dynamics.control.schedule import columns_of, Schedule, ScheduleFile
from tudor_dynamics.nodes.common.base import ClockWatch, latched
from tudor_dynamics.nodes.oscillation_damper import OscillationDamperNode
import yaml

GAUGES = ['link2_hub', 'link3_hub', 'link2_mid', 'link3_mid']
PERIOD = 2_000_000
POSE = np.array([0.8, 0.1])
GAIN = 3.0
"""Position gain of the description [1/s]."""
LOOKED_AT = 70
"""Samples that are enough to take the arm over."""
NONE = 1e-9
"""Rounding [rad/s]."""


class Arm:
    """An arm that goes as it is told and whose links ring, in lock-step on a simulated clock."""

    def __init__(self, world: World, arm: Path, **values: Any) -> None:
        self.world = world
        self.begin = time.time_ns()
        self.k, self.begun, self.ahead = 0, False, 0
        self.node = world.add(OscillationDamperNode, **{'arm': str(arm), **values})
        self.node.steady = lambda: 1e-9 * PERIOD * self.k
        self.node.ros_time = lambda: self.stamp - self.ahead
        self.commands = world.listen('velocity_commands', Float64MultiArray)
        world.meet('joint_states', 'joint_reference', 'link_strains')
        self.random = np.random.default_rng(1)
        self.q, self.speed = POSE.copy(), np.zeros(2)
        self.q_ref, self.dq_ref = POSE.copy(), np.zeros(2)

    @property
    def stamp(self) -> int:
        """Stamp of the present sample [ns]."""
        return self.begin + PERIOD * self.k

    def strain(self) -> np.ndarray:
        """Give the next reading of all gauges: 50 um/m at 2.5 Hz, no swing yet, and noise."""
        return (300.0 + 50.0 * np.sin(2 * np.pi * 2.5 * 0.002 * self.k)
                + self.random.normal(0.0, 2.0, len(GAUGES)))

    def step(
        self, strain: Any = None, names: tuple[list[str], list[str]] = (JOINTS, GAUGES),
        reference: bool = True, gap: int = 0,
    ) -> np.ndarray:
        """Publish one sample and give the command that answers it."""
        self.k += gap
        begins, self.begun = gap or not self.begun, True
        before = len(self.commands)
        for _ in range(LOOKED_AT if begins else 1):  # a moving arm is not taken over at once
            self._publish(strain, names, reference)
            assert self.world.spin(lambda: self.node.gate.last == self.stamp)
        assert self.world.spin(lambda: len(self.commands) > before
                               or self.node.controller.state is State.FAULT)  # silent in the end
        if begins:
            self.world.rest(0.1)  # several commands are under way
        if self.commands:
            self.speed = np.array(self.commands[-1].data)
        return self.speed

    def _publish(
        self, strain: Any, names: tuple[list[str], list[str]], reference: bool,
    ) -> None:
        self.k += 1
        self.q = self.q + 1e-9 * PERIOD * self.speed
        joints, gauges = names
        values = self.strain() if strain is None else strain
        if reference:
            self.world.output('joint_reference').publish(joint_message(
                self.stamp, JOINTS, position=self.q_ref, velocity=self.dq_ref))
            self.q_ref = self.q_ref + 1e-9 * PERIOD * self.dq_ref
        if len(values):
            self.world.output('link_strains').publish(joint_message(
                self.stamp, gauges, position=[values[GAUGES.index(name)] for name in gauges]))
        self.world.output('joint_states').publish(joint_message(
            self.stamp, joints, position=[self.q[JOINTS.index(name)] if name in JOINTS else 9.0
                                          for name in joints]))

    def damping(self, count: int, strain: Any = None) -> np.ndarray:
        """Make several steps about the pose; give the damper's share of the commands."""
        shares = []
        for k in range(count):
            command = self.step(None if strain is None else strain(k))
            shares.append(command - GAIN * (POSE - self.q))
        return np.array(shares)

    def run(self, count: int, **how: Any) -> np.ndarray:
        """Make several steps."""
        return np.array([self.step(**how) for _ in range(count)])

    def wait(self, seconds: float) -> np.ndarray:
        """Let time pass without any sample; give the commands of the watchdog."""
        self.commands.clear()
        for _ in range(round(seconds / 0.02)):
            self.k += round(0.02e9 / PERIOD)
            before = len(self.commands)
            self.world.spin(lambda: len(self.commands) > before, 0.05)  # noqa: B023
        return np.array([list(command.data) for command in self.commands]).reshape(-1, 2)

    def told(self) -> Any:
        """Give a diagnosis of this moment."""
        heard = self.world.heard['/diagnostics']
        heard.clear()
        self.node.publish_diagnostics()
        assert self.world.spin(lambda: bool(heard))
        return heard[-1].status[0]


@pytest.fixture
def tudor(root: Path) -> Path:
    """Give a description with a damper."""
    return root / 'config/tudor.yaml'


def test_gauge_faults(world: World, tudor: Path) -> None:
    """
    A gauge that is constant, not a number, jumps or falls silent: its joint comes to rest.

    Nothing moves because of it, the other joint is damped on, the diagnosis names joint, gauge and
    cause, and the damper comes back with the gauge.
    """
    arm = Arm(world, tudor)
    largest = np.abs(arm.run(450)[-250:]).max(axis=0)
    assert (largest > 0.03).all()
    kept = arm.strain()

    def spoil(value: Any) -> np.ndarray:
        strain = arm.strain()
        strain[0] = value
        return strain
    for cause, fault in (('does not change', lambda k: spoil(kept[0])),
                         ('not finite', lambda k: spoil(np.nan)),
                         ('jumped', lambda k: arm.strain() + [4000.0 * (k % 2), 0, 0, 0])):
        seen = arm.damping(90, fault)
        assert np.abs(seen).max() < 1.2 * largest.max(), cause
        assert np.abs(seen[-20:, 0]).max() < NONE < np.abs(seen[-20:, 1]).max(), cause
        status = arm.told()
        assert status.level == DiagnosticStatus.ERROR, cause
        assert 'joint2, gauge link2_hub: ' in status.message and cause in status.message
        assert 'joint3' not in status.message
        assert np.abs(arm.damping(380)[-100:, 0]).max() > 0.03, cause
        arm.told()
        assert arm.told().message == 'running'
    jumped = arm.strain() + [2000.0, 0, 0, 0]
    assert np.abs(arm.step(jumped)).max() < 1.2 * largest.max()
    arm.run(20)
    status = arm.told()  # it happened once, and is told all the same
    assert status.level == DiagnosticStatus.ERROR and 'jumped' in status.message


def test_silent_gauges(world: World, tudor: Path) -> None:
    """Without new strains the damper fades out and says that none arrive."""
    arm = Arm(world, tudor)
    assert np.abs(arm.damping(400)[-100:]).max() > 0.03
    assert np.abs(arm.damping(120, lambda k: np.zeros(0))[-20:]).max() < NONE
    status = arm.told()
    assert status.level == DiagnosticStatus.ERROR and 'no new strain' in status.message


def test_watchdog(world: World, tudor: Path) -> None:
    """Positions stop: braked to standstill again and again, STALE; held when they come again."""
    arm = Arm(world, tudor)
    assert arm.run(400)[-50:].any()
    seen = arm.wait(1.0)
    assert len(seen) > 20 and not seen[-5:].any()
    status = arm.told()
    assert status.level == DiagnosticStatus.STALE and 'standstill' in status.message
    arm.speed = np.zeros(2)
    arm.step(gap=1)
    assert arm.run(400)[-50:].any()
    assert arm.told().message == 'running'


def test_a_damper_that_hears_no_positions(world: World, tudor: Path) -> None:
    """Started anew beside a driver that it does not hear yet, it holds nothing, and says so."""
    arm = Arm(world, tudor)
    assert not arm.wait(0.2).any()
    status = arm.told()
    assert status.level == DiagnosticStatus.STALE
    assert status.message == (
        'no joint positions arrive on joint_states, so no commands are sent; start the driver '
        'of the arm')
    assert arm.run(400)[-50:].any() and arm.told().message == 'running'


def test_reference_stops(world: World, tudor: Path) -> None:
    """A reference that stops in the middle of a move: the arm brakes, is held, and STALE."""
    arm = Arm(world, tudor, damping=0.0)
    arm.run(20)
    arm.dq_ref = np.array([0.5, 0.0])
    assert arm.run(700)[-1, 0] == pytest.approx(0.5, abs=0.05)  # slow until its drive has answered
    seen = arm.run(400, reference=False)
    assert np.abs(np.diff(seen, axis=0)).max() <= 17.4532925 * 0.002 + 1e-9
    assert np.abs(seen[-20:]).max() < 1e-3
    status = arm.told()
    assert status.level == DiagnosticStatus.STALE and 'no reference' in status.message
    assert values_of(status)['state'] == 'holding'


def test_bad_input_moves_nothing(world: World, tudor: Path) -> None:
    """NaN, short, foreign and repeated positions are counted; bad references are not taken."""
    arm = Arm(world, tudor, damping=0.0)
    arm.run(20)
    arm.commands.clear()
    for message in (joint_message(arm.stamp + 1, JOINTS, position=[np.nan, 0.0]),
                    joint_message(arm.stamp + 2, JOINTS, position=[0.0]),
                    joint_message(arm.stamp + 3, ['a', 'b'], position=[0.0, 0.0]),
                    joint_message(arm.stamp, JOINTS, position=[0.0, 0.0])):
        world.output('joint_states').publish(message)
    for q, dq in (([np.nan, 0.0], [0.0, 0.0]), ([0.9, 0.0], [np.inf, 0.0]), ([0.9, 0.0], []),
                  ([60.0, -20.0], [0.0, 0.0])):
        world.output('joint_reference').publish(joint_message(
            arm.stamp, JOINTS, position=np.array(q), velocity=np.array(dq)))
    assert world.spin(lambda: sum(item.total() for item in arm.node.counters()) >= 5
                      and arm.node.controller.reference.refused.total() >= 3)
    assert not arm.commands
    status = arm.told()
    assert status.level == DiagnosticStatus.WARN and 'not degrees' in status.message
    assert values_of(status)['refused: reference outside limits'] == '1'
    assert not arm.run(5, names=(['tool', 'joint3', 'joint2'], GAUGES[::-1])).any()
    values = values_of(arm.told())
    for cause, count in (('not_finite', 1), ('short_array', 2), ('other_names', 1),
                         ('duplicate_stamp', 1)):
        assert int(values[f'dropped: {cause}']) == count, cause


def test_encoder_fault_needs_a_reset(world: World, tudor: Path) -> None:
    """An encoder that jumps: ERROR with the joint, standstill; ~/reset takes the arm up again."""
    arm = Arm(world, tudor)
    arm.run(20)
    arm.q = arm.q + [0.9, 0.0]
    arm.run(60)
    arm.commands.clear()  # drives hold by themselves after standstill was commanded for a while
    arm.run(20)
    assert not arm.commands
    status = arm.told()
    assert status.level == DiagnosticStatus.ERROR
    assert all(text in status.message for text in (
        'joint2', 'jumped', 'call the service /oscillation_damper/reset'))
    arm.node._reset()
    arm.q_ref = arm.q.copy()
    arm.begun = False
    arm.run(30)
    assert arm.told().message == 'running'


def test_deactivation_brakes_and_shutdown_is_told(world: World, tudor: Path) -> None:
    """A moving arm is braked within its acceleration, then nothing is said; WARN all the same."""
    arm = Arm(world, tudor, damping=0.0)
    arm.run(20)
    arm.dq_ref = np.array([0.5, 0.0])
    last = arm.run(150)[-1]
    arm.node.trigger_deactivate()
    seen = np.vstack([last, arm.wait(1.0)])
    assert np.abs(np.diff(seen, axis=0)).max() <= 17.4532925 * 0.02
    assert len(seen) > 10 and not seen[-1].any()
    assert not len(arm.wait(0.2))
    assert arm.told().message == (
        'the node is inactive; run `ros2 lifecycle set oscillation_damper activate`')
    arm.node.trigger_shutdown()
    # one of before may still be under way
    assert world.spin(lambda: 'shut down' in arm.told().message)
    assert arm.told().level == DiagnosticStatus.WARN


def test_stamps_that_are_zero_or_of_another_clock(world: World, tudor: Path) -> None:
    """Zero stamps make the arm stand; they and a clock that differs are named."""
    arm = Arm(world, tudor)
    for _ in range(40):
        world.output('joint_states').publish(joint_message(0, JOINTS, position=POSE))
        world.rest(0.002)
    assert world.spin(lambda: arm.node.gate.drops['duplicate_stamp'] >= 30)
    status = arm.told()
    assert status.level == DiagnosticStatus.ERROR and 'zero' in status.message
    assert not arm.commands
    arm.node._reset()
    arm.ahead = 7_000_000_000
    arm.run(60)
    status = arm.told()
    assert status.level == DiagnosticStatus.WARN and 's in the future' in status.message
    assert float(values_of(status)['age of stamps [ms]']) == pytest.approx(-7000.0)


def test_a_clock_that_ticks_after_the_sample_is_no_other_clock() -> None:
    """Stamps of a simulator at 100 Hz are 10 ms ahead of its own clock."""
    clocks = ClockWatch()
    for k in range(200):
        clocks.step(10_000_000 * (k + 1), 10_000_000 * k)
    assert clocks.offset('joint_states') == ''
    for k in range(200):
        clocks.step(10_000_000 * (k + 30), 10_000_000 * k)
    assert 's in the future' in clocks.offset('joint_states')


def test_others_that_command_or_publish_positions(world: World, tudor: Path) -> None:
    """A second node on the commands is an error with its name; a second source a warning."""
    arm = Arm(world, tudor)
    arm.run(20)
    world.output('velocity_commands', Float64MultiArray)
    assert world.spin(lambda: arm.node.crowded is not None)
    status = arm.told()
    assert status.level == DiagnosticStatus.ERROR
    assert '/probe can also command the joints on /velocity_commands' in status.message
    world.probe.destroy_publisher(world.outputs.pop('velocity_commands'))
    other = world.probe.create_publisher(JointState, 'joint_states', 10)
    assert world.spin(lambda: arm.node.crowded is not None
                      and 'positions on joint_states' in arm.node.crowded[1])
    assert arm.told().level == DiagnosticStatus.WARN
    world.probe.destroy_publisher(other)
    assert world.spin(lambda: arm.node.crowded is None)


def test_a_fault_beside_a_second_commander_names_it(world: World, tudor: Path) -> None:
    """
    Its commands move joint2 by 30 deg/s: the fault names the node that sends them, not a drive.

    The text comes with the fault, stays when that node is gone, and ends with a reset.
    """
    arm = Arm(world, tudor, damping=0.0)
    arm.run(300)
    assert arm.told().message == 'running'
    begin, other = arm.q.copy(), np.radians([30.0, 0.0])
    world.output('velocity_commands', Float64MultiArray)
    assert world.spin(lambda: '/probe' in arm.node.rivals(arm.node._output))
    while arm.node.controller.state is not State.FAULT:
        arm.step()
        arm.speed = other  # the driver takes the last command
        assert np.degrees(np.abs(arm.q - begin)).max() < 5.0
    status = arm.told()
    text = ('/probe can also command the joints on /velocity_commands; let only one node publish '
            'there. If that is not the reason: joint2: ')
    assert status.level == DiagnosticStatus.ERROR and status.message.startswith(text)
    assert status.message.endswith('the joints stand still until you call the service '
                                   '/oscillation_damper/reset')
    world.probe.destroy_publisher(world.outputs.pop('velocity_commands'))
    assert world.spin(lambda: not arm.node.rivals(arm.node._output))
    world.rest(0.7)
    assert arm.told().message.startswith(text)
    arm.node._reset()
    arm.speed, arm.q_ref, arm.begun = np.zeros(2), arm.q.copy(), False
    arm.run(30)
    assert arm.told().message == 'running'


def test_no_diagnosis_is_ok_for_long_after_a_fault(world: World, tudor: Path) -> None:
    """What is wrong is published at once: a fault, lost positions, a second commander."""
    arm = Arm(world, tudor)
    arm.run(300)
    heard = world.heard['/diagnostics']

    def last() -> Any:
        return next(s for item in heard[::-1] for s in item.status if 'damper' in s.name)
    arm.told()
    world.output('velocity_commands', Float64MultiArray)
    begin = time.monotonic()
    assert world.spin(lambda: last().level == DiagnosticStatus.ERROR)
    assert time.monotonic() - begin < 1.0
    world.probe.destroy_publisher(world.outputs.pop('velocity_commands'))
    assert world.spin(lambda: last().level == DiagnosticStatus.OK)
    arm.told()
    arm.wait(0.3)  # after 0.25 s without positions it gives them up
    world.rest(0.1)
    assert last().level == DiagnosticStatus.STALE
    arm.speed = np.zeros(2)
    arm.step(gap=1)
    arm.run(300)
    assert arm.told().message == 'running'
    arm.q = arm.q + [0.9, 0.0]
    begin = arm.k
    while last().level == DiagnosticStatus.OK:
        arm._publish(None, (JOINTS, GAUGES), True)
        world.rest(0.002)
        assert (arm.k - begin) * PERIOD < 100_000_000
    assert 'jumped' in last().message


def test_another_publisher_of_positions_is_another_driver(world: World, tudor: Path) -> None:
    """Back after 0.5 s, the same driver stays tested; a new one has to be tested again."""
    arm = Arm(world, tudor, damping=0.0, require_joint_test=True)
    arm.run(100)
    arm.node._tested()
    for tested in (True, False):
        assert not arm.wait(0.5)[-1].any()
        arm.speed = np.zeros(2)
        if not tested:
            world.probe.destroy_publisher(world.outputs.pop('joint_states'))
            world.meet('joint_states')
        arm.step(gap=1)
        arm.run(100)
        assert arm.node.controller.tested == tested
    begin = arm.q.copy()
    arm.dq_ref = np.array([0.1, 0.0])
    arm.run(300)
    assert np.degrees(np.abs(arm.q - begin)).max() < 3.0
    status = arm.told()
    assert status.level == DiagnosticStatus.WARN and status.message == (
        'the joints are held: joints were not tested since their driver started; run the node '
        'joint_test')


def test_of_positions_that_wait_the_newest_counts(world: World, tudor: Path) -> None:
    """One command answers all that waited while the node was busy; the others are counted."""
    arm = Arm(world, tudor, damping=0.0)
    arm.run(100)
    before = len(arm.commands)
    for _ in range(6):
        arm.k += 1
        world.output('joint_states').publish(joint_message(arm.stamp, JOINTS, position=arm.q))
    world.output('joint_states').publish(joint_message(arm.stamp, ['tool'], position=[0.1]))
    world.output('joint_states').publish(  # a second source, or a network that changes the order
        joint_message(arm.stamp - 2 * PERIOD, JOINTS, position=arm.q))
    time.sleep(0.2)
    assert world.spin(lambda: arm.node.gate.last == arm.stamp)
    world.rest(0.004)
    values = values_of(arm.told())
    assert values['dropped: overtaken'] == '6' and 'dropped: gap' not in values
    assert len(arm.commands) <= before + 2
    assert arm.node.meter.count == 100 + LOOKED_AT
    arm.run(30)
    assert 'dropped: gap' not in values_of(arm.told())


def test_absurd_parameters_are_refused_with_the_bound(world: World, tudor: Path) -> None:
    """Damping beyond what the loop stands, and a timeout of a minute, change nothing."""
    arm = Arm(world, tudor)
    for name, value, bound in (('damping', 10.0, '1.25'), ('timeout', 60.0, '1.0'),
                               ('position_gain', 1e3, '100.0')):
        before = arm.node.value(name)
        result = arm.node.set_parameters([Parameter(name, value=value)])[0]
        assert not result.successful and f'Max: {bound}' in result.reason, result.reason
        assert arm.node.value(name) == before
    assert arm.node.controller.timeout == 0.1 and arm.node.controller.gains.share == 1.0


@pytest.mark.parametrize('name', ['reference_generator', 'force_controller', 'trajectory_relay'])
def test_no_node_that_moves_an_arm_trusts_old_input(name: str, world: World) -> None:
    """A timeout of a minute is refused with its bound, at the start as well."""
    node = world.add(node_class(name))
    result = node.set_parameters([Parameter('timeout', value=60.0)])[0]
    assert not result.successful and 'Max: 1.0' in result.reason, result.reason
    assert node.set_parameters([Parameter('timeout', value=1.0)])[0].successful
    with pytest.raises(InvalidParameterValueException, match='timeout'):
        node_class(name)(context=world.context, parameter_overrides=overrides(timeout=60.0))


def test_position_gain_goes_back_to_that_of_the_arm(world: World, tudor: Path) -> None:
    """100 is bounded and told; 0 is that of the description again."""
    arm = Arm(world, tudor)
    arm.run(20)
    assert arm.node.set_parameters([Parameter('position_gain', value=100.0)])[0].successful
    status = arm.told()
    assert status.level == DiagnosticStatus.WARN and 'position gain' in status.message
    assert arm.node.set_parameters([Parameter('position_gain', value=0.0)])[0].successful
    assert values_of(arm.told())['position gain in use [1/s]'] == '3.00'


def test_clock_of_ros_stands_still(world: World, tudor: Path) -> None:
    """With use_sim_time and no clock the watchdog brakes and the diagnosis comes all the same."""
    arm = Arm(world, tudor, use_sim_time=True)
    arm.run(60)
    seen = arm.wait(0.6)
    assert len(seen) > 10 and not seen[-3:].any()
    assert world.status('oscillation_damper').level == DiagnosticStatus.STALE


@pytest.mark.parametrize('period', [100_000_000, 500_000])
def test_rates_and_losses(period: int, world: World, tudor: Path) -> None:
    """At 10 Hz and 2 kHz, with bursts, losses and the clock set back: finite, bounded commands."""
    arm = Arm(world, tudor, timeout=1.0)
    random = np.random.default_rng(2)
    count = 300 if period > 10_000_000 else 1500
    for k in range(count):
        back = 3_000_000_000 // period if k >= count * 2 // 3 else 0  # the clock jumps back by 3 s
        arm.k = k - back
        if random.random() < 0.3:
            continue
        stamp = arm.begin + period * arm.k
        world.output('link_strains').publish(joint_message(
            stamp, GAUGES, position=arm.strain()))
        world.output('joint_states').publish(joint_message(stamp, JOINTS, position=POSE))
        if k % 8 == 7:  # eight at a time
            assert world.spin(lambda: arm.node.gate.last == stamp)  # noqa: B023
    assert world.spin(lambda: len(arm.commands) > 15)  # one for all that waited
    seen = np.array([list(command.data) for command in arm.commands])
    assert np.isfinite(seen).all() and np.abs(seen).max() < 1.9
    assert arm.node.gate.drops['clock_set_back'] == 1


def test_gauges_on_several_topics(world: World, tudor: Path, tmp_path: Path) -> None:
    """Gauges with topics of their own are read each from its own."""
    content = yaml.safe_load(tudor.read_text())
    content['kinematics']['urdf'] = str(tudor.parent / 'tudor.urdf')
    for gauge in content['gauges']:
        if gauge['name'].startswith('link3'):
            gauge['topic'] = 'link3_strains'
    path = tmp_path / 'several.yaml'
    path.write_text(yaml.safe_dump(content))
    arm = Arm(world, path)
    world.meet('link3_strains')
    for _ in range(450):
        strain = arm.strain()
        world.output('link3_strains').publish(joint_message(
            arm.stamp + PERIOD, ['link3_hub'], position=strain[1:2]))
        command = arm.step(strain, names=(JOINTS, ['link2_hub', 'link2_mid']))
    assert command.all()
    report = arm.node.controller.damper.report()
    assert all(text.endswith(': damps') for text in report), report


@pytest.fixture(scope='module')
def schedule(tmp_path_factory: Any) -> Path:
    """Write a schedule of the reference arm, of one pose."""
    joints = ('joint2', 'joint3')
    row = (1500.0, 1000.0, 2.0, 0.015, 0.6, *[0.0] * 6, 2.0, 0.01, *[0.1] * 4)
    path = tmp_path_factory.mktemp('tuned') / 'schedule.yaml'
    Schedule(ScheduleFile(
        format='tudor_dynamics/schedule', version=1, arm='tudor', joints=joints,
        damped=joints, gauges=('link2_hub', 'link3_hub'), damping_ratio=0.6,
        delay=0.005, mean_frequency=0.1, payload=(0.0, 0.4), pose=((0.0,), (0.0,)),
        columns=columns_of(joints, joints, 1),
        nodes=(row, (*row[:2], 1.0, *row[3:])))).save(path)
    return path


def test_gains_follow_the_payload(world: World, tudor: Path, schedule: Path) -> None:
    """Fixed gains until a payload is told on its topic; a payload that cannot be is counted."""
    arm = Arm(world, tudor, gain_schedule=str(schedule))
    arm.run(100)
    level, message, values = arm.node.status()
    assert level == DiagnosticStatus.WARN and 'no load was reported' in message
    assert values['scheduled gains in use'] == '0.00'
    assert float(values['position gain in use [1/s]']) == GAIN
    teller = world.probe.create_publisher(InertiaStamped, 'payload', latched())
    told = InertiaStamped()
    told.inertia.m = 0.4
    teller.publish(told)
    assert world.spin(lambda: arm.node.controller.adaptation.known(arm.node.steady()))
    arm.run(600)
    level, message, values = arm.node.status()
    assert values['scheduled gains in use'] == '1.00' and values['payload in use [kg]'] == '0.400'
    assert float(values['position gain in use [1/s]']) == pytest.approx(1.0, abs=0.02)
    told.inertia.m = 40.0
    teller.publish(told)
    assert world.spin(lambda: arm.node.drops['payload_refused'] == 1)
    assert 'outside the 0 to 0.4 kg' in arm.node.status()[1]


def test_schedule_that_cannot_be_read(world: World, tudor: Path, tmp_path: Path) -> None:
    """It says so, and commands nothing."""
    node = world.add(OscillationDamperNode, arm=str(tudor),
                     gain_schedule=str(tmp_path / 'nothing.yaml'))
    assert node.controller is None and 'cannot be read' in node.fault
