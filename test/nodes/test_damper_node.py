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
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
import pytest
from rclpy.parameter import Parameter
from std_msgs.msg import Float64MultiArray
import yaml

from ros_world import joint_message, JOINTS, values_of, World
from tudor_dynamics.nodes.oscillation_damper import OscillationDamperNode

GAUGES = ['link2_hub', 'link3_hub', 'link2_mid', 'link3_mid']
PERIOD = 2_000_000
POSE = np.array([0.8, 0.1])


class Arm:
    """An arm at rest whose links ring, in lock-step with the damper."""

    def __init__(self, world: World, arm: Path, **values: Any) -> None:
        self.world = world
        self.node = world.add(OscillationDamperNode, **{
            'arm': str(arm), 'timeout': 10.0, **values})
        self.commands = world.listen('velocity_commands', Float64MultiArray)
        world.meet('joint_states', 'joint_reference', 'link_strains')
        self.k, self.begun = 0, False
        self.random = np.random.default_rng(1)

    def strain(self) -> np.ndarray:
        """Give the next reading of all gauges: 80 um/m at 2.5 Hz, with noise."""
        return (300.0 + 80.0 * np.sin(2 * np.pi * 2.5 * 0.002 * self.k)
                + self.random.normal(0.0, 2.0, len(GAUGES)))

    def step(
        self, strain: Any = None, names: tuple[list[str], list[str]] = (JOINTS, GAUGES),
        reference: bool = True, gap: int = 0,
    ) -> np.ndarray:
        """Publish one sample and give the command that answers it."""
        self.k += 1 + gap
        stamp = 10**18 + PERIOD * self.k
        joints, gauges = names
        values = self.strain() if strain is None else strain
        if reference:
            self.world.output('joint_reference').publish(joint_message(
                stamp, JOINTS, position=POSE, velocity=[0.0, 0.0]))
        if len(values):
            self.world.output('link_strains').publish(joint_message(
                stamp, gauges, position=[values[GAUGES.index(name)] for name in gauges]))
        before = len(self.commands)
        self.world.output('joint_states').publish(joint_message(
            stamp, joints, position=[POSE[JOINTS.index(name)] if name in JOINTS else 9.0
                                     for name in joints]))
        begins, self.begun = gap or not self.begun, True
        if begins:  # anew: no time has passed that a command could answer
            self.world.rest(0.05)
            return np.zeros(2)
        assert self.world.spin(lambda: len(self.commands) > before)
        return np.array(self.commands[-1].data)

    def lose_patience(self, seconds: float) -> None:
        """Let input that old count as stale from now on."""
        assert self.node.set_parameters([Parameter('timeout', value=seconds)])[0].successful

    def run(self, count: int, **how: Any) -> np.ndarray:
        """Make several steps."""
        return np.array([self.step(**how) for _ in range(count)])

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
                         ('not a number', lambda k: spoil(np.nan)),
                         ('jumped', lambda k: arm.strain() + [4000.0 * (k % 2), 0, 0, 0])):
        seen = np.array([arm.step(fault(k)) for k in range(90)])
        assert np.abs(seen).max() < 1.2 * largest.max(), cause
        assert not seen[-20:, 0].any() and seen[-20:, 1].any(), cause
        status = arm.told()
        assert status.level == DiagnosticStatus.ERROR, cause
        assert 'joint2 (link2_hub)' in status.message and cause in status.message
        assert 'joint3' not in status.message
        assert arm.run(380)[-100:, 0].any(), cause
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
    assert np.abs(arm.run(400)[-100:]).max() > 0.03
    assert not arm.run(120, strain=np.zeros(0))[-20:].any()
    status = arm.told()
    assert status.level == DiagnosticStatus.ERROR and 'no new strain' in status.message


def test_watchdog(world: World, tudor: Path) -> None:
    """Positions stop: standstill is commanded again and again, STALE, and it recovers."""
    arm = Arm(world, tudor)
    assert arm.run(400)[-50:].any()
    arm.lose_patience(0.3)
    world.rest(0.5)
    arm.commands.clear()
    assert world.spin(lambda: len(arm.commands) > 5)
    assert not np.array([list(command.data) for command in arm.commands]).any()
    status = world.status('oscillation_damper')
    assert status.level == DiagnosticStatus.STALE and 'standstill' in status.message
    arm.lose_patience(10.0)
    arm.step(gap=1000)
    assert arm.run(400)[-50:].any()
    assert values_of(world.status('oscillation_damper'))['dropped: gap'] == '1000'


def test_reference_stops(world: World, tudor: Path) -> None:
    """A reference that stops in the middle of a move: the arm is told to stand, and STALE."""
    arm = Arm(world, tudor, damping=0.0)
    for _ in range(10):
        arm.k += 1
        stamp = 10**18 + PERIOD * arm.k
        world.output('joint_reference').publish(joint_message(
            stamp, JOINTS, position=POSE, velocity=[0.5, 0.0]))
        world.rest(0.001)
        command = arm.step(reference=False)
    assert command[0] == pytest.approx(0.5)
    arm.lose_patience(0.3)
    world.rest(0.35)
    assert not arm.run(5, reference=False).any()
    status = arm.told()
    assert status.level == DiagnosticStatus.STALE and 'no reference' in status.message


def test_bad_input_moves_nothing(world: World, tudor: Path) -> None:
    """NaN, short, foreign and repeated positions are counted; bad references are not taken."""
    arm = Arm(world, tudor, damping=0.0)
    arm.run(20)
    arm.commands.clear()
    stamp = 10**18 + PERIOD * arm.k
    for message in (joint_message(stamp + 1, JOINTS, position=[np.nan, 0.0]),
                    joint_message(stamp + 2, JOINTS, position=[0.0]),
                    joint_message(stamp + 3, ['a', 'b'], position=[0.0, 0.0]),
                    joint_message(stamp, JOINTS, position=[0.0, 0.0])):
        world.output('joint_states').publish(message)
    for q, dq in (([np.nan, 0.0], [0.0, 0.0]), ([0.0, 0.0], [np.inf, 0.0]), ([0.0, 0.0], [])):
        world.output('joint_reference').publish(joint_message(
            stamp, JOINTS, position=np.array(q), velocity=np.array(dq)))
    assert world.spin(lambda: sum(
        item.total() for item in arm.node.counters()) >= 7)
    assert not arm.commands
    assert not arm.run(5, names=(['tool', 'joint3', 'joint2'], GAUGES[::-1])).any()
    values = values_of(world.status('oscillation_damper'))
    for cause, count in (('not_finite', 3), ('short_array', 2), ('unknown_names', 1),
                         ('duplicate_stamp', 1)):
        assert int(values[f'dropped: {cause}']) == count, cause


@pytest.mark.parametrize('period', [100_000_000, 500_000])
def test_rates_and_losses(period: int, world: World, tudor: Path) -> None:
    """At 10 Hz and 2 kHz, with bursts, losses and the clock set back: finite, bounded commands."""
    arm = Arm(world, tudor)
    random = np.random.default_rng(2)
    for k in range(300):
        arm.k = k if k < 200 else k - 3_000_000_000 // period  # the clock jumps back by 3 s
        if random.random() < 0.3:
            continue
        stamp = 10**18 + period * arm.k
        world.output('link_strains').publish(joint_message(
            stamp, GAUGES, position=arm.strain()))
        world.output('joint_states').publish(joint_message(stamp, JOINTS, position=POSE))
        if k % 8 == 7:  # eight at a time
            world.spin(lambda: False, 0.004)
    assert world.spin(lambda: len(arm.commands) > 60)
    world.rest(0.2)
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
            10**18 + PERIOD * (arm.k + 1), ['link3_hub'], position=strain[1:2]))
        command = arm.step(strain, names=(JOINTS, ['link2_hub', 'link2_mid']))
    assert command.all()
    report = arm.node.controller.damper.report()
    assert all(text.endswith(': damps') for text in report), report
