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

"""Node force_controller with the simulated arm and its damper, through topics."""

from __future__ import annotations

from pathlib import Path

from geometry_msgs.msg import WrenchStamped
from ros_world import node_class, values_of, World, world  # noqa: F401
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from tudor_dynamics.mechanics.hardware import Floor


def state_of(world: World) -> dict[str, str]:  # noqa: F811
    """Give the next diagnosis of the node."""
    return values_of(world.status('force_controller'))


def test_approach_hold_and_retreat(world: World, root: Path) -> None:  # noqa: F811
    """A force on the topic is held on a floor of unknown height; the service leads back."""
    arm = str(root / 'config/tudor.yaml')
    simulator = world.add(node_class('arm_simulator'), arm=arm, rate=200.0, clock=True,
                          lockstep=True)
    damper = world.add(node_class('oscillation_damper'), arm=arm, use_sim_time=True)
    node = world.add(node_class('force_controller'), arm=arm, approach_speed=0.05,
                     use_sim_time=True)
    felt = world.listen('/tip_force', WrenchStamped)
    world.output('/wanted_force', Float64)
    assert world.spin(lambda: node.controller.pose is not None
                      and damper.controller.state.name == 'FOLLOWING'
                      and world.outputs['/wanted_force'].get_subscription_count() > 0)
    simulator.arm.floor = Floor(float(simulator.arm.tip()[2]) - 0.01, 1000.0)
    world.output('/wanted_force', Float64).publish(Float64(data=2.0))
    assert world.spin(lambda: node.controller.phase.name == 'HOLD'), node.controller.cause
    assert world.spin(lambda: bool(felt) and abs(felt[-1].wrench.force.z - 2.0) < 0.2), (
        node.controller.cause)
    state = state_of(world)
    assert state['state'] == 'hold', state
    world.call(Trigger, '/force_controller/retreat')
    assert world.spin(lambda: node.controller.phase.name == 'IDLE'), node.controller.cause
    world.end(simulator)
    assert world.spin(lambda: world.status('force_controller').message == (
        'no message comes on joint_states; start the node that publishes there'))


def test_without_an_arm_it_says_so(world: World) -> None:  # noqa: F811
    """No description, no force."""
    world.add(node_class('force_controller'))
    status = world.status('force_controller')
    assert "the parameter 'arm' is empty" in status.message
