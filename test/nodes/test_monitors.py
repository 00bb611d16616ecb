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

"""Several monitors in one process: like processes of their own, and apart from each other."""

from __future__ import annotations

from pathlib import Path
import signal

from node_processes import finish, launch
import pytest
from rcl_interfaces.srv import GetParameters
from ros_world import joint_message, JOINTS, values_of, World
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.errors import TudorError
from tudor_dynamics.nodes.monitors import GuardedMonitorNode, MonitorsNode

ARMS = ('left', 'right')


def sample(recording: Recording, k: int) -> dict[str, JointState]:
    """Joint states and strains of one sample."""
    stamp = int(recording.stamp[k])
    assert recording.strain is not None
    return {'joint_states': joint_message(stamp, JOINTS, position=recording.q[k]),
            'link_strains': joint_message(
                stamp, ['link2_hub', 'link3_hub'], position=recording.strain[k])}


class Fleet:
    """Feeds several arms, and hears what becomes of their samples."""

    def __init__(self, world: World, recording: Recording, arms: tuple[str, ...] = ARMS) -> None:
        self.world, self.recording, self.arms, self.next = world, recording, arms, 0
        self.heard = {arm: world.listen(f'/{arm}/strain_residuals') for arm in arms}

    def send(self, arms: tuple[str, ...]) -> None:
        """Send the next sample to some of the arms."""
        for arm in arms:
            for topic, message in sample(self.recording, self.next).items():
                self.world.output(f'/{arm}/{topic}').publish(message)
        self.next += 1
        self.world.rest(0.002)

    def flows(self, *arms: str) -> bool:
        """Say whether each of these arms has ten more residuals, while all are fed."""
        for arm in arms:
            self.heard[arm].clear()
        for _ in range(1500):
            self.send(self.arms)
            if all(len(self.heard[arm]) >= 10 for arm in arms):
                return True
        return False


def test_each_is_a_monitor_of_its_own(
    world: World, recording: Recording, model: Path, tmp_path: Path,
) -> None:
    """Namespaces, a parameter file, services; and a model that is missing is that arm's alone."""
    (tmp_path / 'arms.yaml').write_text(f"""
/hall/left/monitor: {{ros__parameters: {{model: {model}, robot: first, debounce: 0.02}}}}
/right/monitor: {{ros__parameters: {{model: {model}, robot: second}}}}
/third/monitor: {{ros__parameters: {{model: {tmp_path / 'none'}}}}}
/fourth/monitor: {{ros__parameters: {{kind: neural}}}}
""")
    process = launch('monitors', '-r', '__ns:=/hall', '-p', 'namespaces:=[left, /right, /third, '
                     '/fourth]', '-p', "methods:=['strain']", '--params-file',
                     str(tmp_path / 'arms.yaml'))
    try:
        fleet = Fleet(world, recording, ('hall/left', 'right'))
        assert world.spin(lambda: all(world.output(f'/{arm}/joint_states').get_subscription_count()
                                      for arm in fleet.arms))
        assert fleet.flows(*fleet.arms)
        values = world.call(GetParameters, '/hall/left/monitor/get_parameters',
                            GetParameters.Request(names=['debounce', 'robot'])).values
        assert (values[0].double_value, values[1].string_value) == (0.02, 'first')
        assert world.call(Trigger, '/right/monitor/reset').success
        found = world.status('monitor', lambda status: status.name.endswith('/third'))
        assert found.level == found.ERROR and 'none' in found.message
        host = world.status('monitors')
        assert host.level == host.ERROR and host.message.startswith('the arm in /fourth is not')
        assert 'neural' in host.message
        assert (values_of(host)['arms'], values_of(host)['watched']) == ('4', '3')
    finally:
        finish(process, signal.SIGTERM)


def test_one_that_fails_is_made_anew(
    world: World, recording: Recording, model: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An error in one monitor stops neither the other one nor itself for ever."""
    host = world.add(MonitorsNode, namespaces=list(ARMS), model=str(model), methods=['strain'],
                     pause=0.0)
    assert world.spin(lambda: all(arm.node is not None for arm in host.arms))
    fleet = Fleet(world, recording)
    world.meet(*(f'/{arm}/joint_states' for arm in ARMS))
    assert fleet.flows(*ARMS)
    first, kept = host.arms[0].node, host.arms[1].node
    assert first is not None and first.monitor is not None

    def fail(*_: object) -> None:
        msg = 'impossible'
        raise ZeroDivisionError(msg)

    tries: list[object] = []

    def made_at_the_second_try(**options: object) -> GuardedMonitorNode:
        tries.append(options)
        if len(tries) == 1:
            msg = 'not now'
            raise MemoryError(msg)
        return GuardedMonitorNode(**options)

    monkeypatch.setattr('tudor_dynamics.nodes.monitors.GuardedMonitorNode',
                        made_at_the_second_try)
    monkeypatch.setattr(first.monitor, 'add_joints', fail)
    fleet.send(('left',))
    assert world.spin(lambda: host.arms[0].failures == 1)
    assert fleet.flows('right') and host.arms[1].node is kept
    assert world.spin(lambda: host.arms[0].node is not None)
    assert host.arms[0].node is not first and len(tries) == 2
    assert fleet.flows(*ARMS)
    status = world.status('monitors', lambda found: found.level == found.WARN)
    assert 'the monitor of namespace /left failed' in status.message
    assert values_of(status)['failures /left'] == '1'


@pytest.mark.parametrize(('namespaces', 'words'), [
    (['left', '/left'], 'twice'), (['a b'], 'no namespace'), (['left', '7'], 'no namespace')])
def test_wrong_namespaces_are_refused(
    world: World, namespaces: list[str], words: str,
) -> None:
    """What names no namespace, or one a second time."""
    with pytest.raises(TudorError, match=words):
        world.add(MonitorsNode, namespaces=namespaces)


def test_all_refused(world: World) -> None:
    """Where no arm can be watched there is nothing to run."""
    with pytest.raises(TudorError, match='no arm can be watched.*neural'):
        world.add(MonitorsNode, namespaces=list(ARMS), kind='neural')
