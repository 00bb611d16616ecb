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

"""Node arm_simulator: the whole arm, and an arm that comes back."""

from __future__ import annotations

from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
import numpy as np
import pytest
from ros_world import series, values_of, World
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from tudor_dynamics.nodes.arm_simulator import ArmSimulatorNode
from tudor_dynamics.nodes.common.messages import floats, nanoseconds
from tudor_dynamics.nodes.oscillation_damper import OscillationDamperNode
from tudor_dynamics.nodes.reference_generator import ReferenceGeneratorNode


@pytest.mark.parametrize('clock', [False, True])
def test_it_comes_back_after_a_diverged_run(world: World, root: Path, clock: bool) -> None:
    """ERROR with the cause, at rest, deaf to commands; ~/reset ends that; stamps only increase."""
    node = world.add(ArmSimulatorNode, arm=str(root / 'config/tudor.yaml'), rate=100.0,
                     clock=clock)
    heard, ticks = world.listen('joint_states'), world.listen('/clock', Clock)
    world.output('velocity_commands', Float64MultiArray)
    world.output('external_wrench', WrenchStamped)
    world.meet('velocity_commands', 'external_wrench')

    def drive(until) -> bool:
        """Command 0.5 rad/s all the time, as a controller does."""
        def done() -> bool:
            world.output('velocity_commands').publish(
                Float64MultiArray(data=floats(np.array([0.5, 0.0]))))
            return until()
        return world.spin(done)
    assert drive(lambda: bool(heard) and heard[-1].position[1] > 0.85)
    wrench = WrenchStamped()
    wrench.wrench.force.z = 1e6
    world.output('external_wrench').publish(wrench)
    assert drive(lambda: bool(node.arm.failure))
    count = len(heard)
    assert drive(lambda: len(heard) > count + 30)
    rest = np.array([message.position for message in heard[count + 5:]])
    assert np.abs(rest - [0.0, np.pi / 4, 0.0]).max() < 1e-3
    status = world.status('arm_simulator')
    assert status.level == DiagnosticStatus.ERROR
    assert node.arm.failure in status.message and '/arm_simulator/reset' in status.message
    assert int(values_of(status)['dropped: diverged']) > 0
    assert world.call(Trigger, 'arm_simulator/reset').success
    assert drive(lambda: heard[-1].position[1] > 0.85)
    assert world.status('arm_simulator').level != DiagnosticStatus.ERROR
    stamps, _ = series(heard, 'position')
    assert (np.diff(stamps) > 0).all()
    assert (np.diff([nanoseconds(tick.clock) for tick in ticks]) > 0).all()
    assert bool(ticks) is clock


def test_the_whole_arm_is_published(world: World, root: Path) -> None:
    """Held joints stand at their place in the order of the URDF; effort topics have none."""
    world.add(ArmSimulatorNode, arm=str(root / 'config/tudor.yaml'), rate=100.0)
    states, efforts = world.listen('joint_states'), world.listen('motor_currents')
    assert world.spin(lambda: len(states) > 5 and len(efforts) > 5)
    assert list(states[-1].name) == ['joint1', 'joint2', 'joint3']
    assert states[-1].position[0] == 0.0 and states[-1].velocity[0] == 0.0
    assert len(states[-1].position) == len(states[-1].velocity) == 3
    assert list(efforts[-1].name) == ['joint2', 'joint3'] and len(efforts[-1].effort) == 2


def test_the_loop_takes_the_whole_arm(world: World, root: Path) -> None:
    """Reference and damper read their joints out of it: commands are those of active joints."""
    arm = str(root / 'config/tudor.yaml')
    world.add(ArmSimulatorNode, arm=arm, rate=100.0)
    world.add(ReferenceGeneratorNode, arm=arm, rate=100.0)
    world.add(OscillationDamperNode, arm=arm)
    heard = world.listen('velocity_commands', Float64MultiArray)
    reference = world.listen('joint_reference')
    assert world.spin(lambda: len(heard) > 20 and len(reference) > 20)
    assert all(len(message.data) == 2 for message in heard)
    assert list(reference[-1].name) == ['joint2', 'joint3']
    assert reference[-1].position[0] == pytest.approx(np.pi / 4, abs=0.02)


def test_in_lockstep_it_waits_for_each_answer(world: World, root: Path) -> None:
    """A hundred times as fast as real time, it is no sample ahead of whoever commands."""
    world.add(ArmSimulatorNode, arm=str(root / 'config/tudor.yaml'), rate=100.0, factor=100.0,
              clock=True, lockstep=True)
    heard, answered = world.listen('joint_states'), 0
    world.output('velocity_commands', Float64MultiArray)
    world.meet('velocity_commands')

    def answer() -> bool:
        nonlocal answered
        if len(heard) > answered:
            answered = len(heard)
            world.output('velocity_commands').publish(Float64MultiArray(data=[0.0, 0.0]))
        return answered > first + 100
    first = 0
    assert world.spin(lambda: bool(heard))
    assert world.spin(answer)  # what came before the first command is heard by then
    first, begun = answered, nanoseconds(heard[-1].header.stamp)
    steps = np.diff([nanoseconds(item.header.stamp) for item in heard[-100:]])
    assert (steps == 10**7).all()  # nothing was lost: it would have been, unanswered
    assert world.spin(answer)
    assert nanoseconds(heard[-1].header.stamp) - begun <= 10**7 * (answered - first + 1)
