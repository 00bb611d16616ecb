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

"""The reference says what the nodes declare."""

from __future__ import annotations

from pathlib import Path

import pytest
from rclpy.publisher import Publisher
from rclpy.service import Service
from rclpy.subscription import Subscription

from ros_world import node_class, World
from tools import nodes_reference
from tudor_dynamics.nodes.common.interfaces import NODES

SHARED = {'Subscribed': ('/parameter_events',),
          'Published': ('/diagnostics', '/parameter_events', '/rosout')}
ARMS = {'oscillation_damper', 'force_controller', 'reference_generator', 'trajectory_relay',
        'arm_simulator'}
JUDGING = {'joint_state_filter', 'dynamics_predictor', 'collision_detector', 'monitor'}
MODELS = {'joint_state_filter', 'dynamics_predictor', 'collision_detector', 'monitor',
          'feedforward'}


def test_each_node_has_its_page(root: Path) -> None:
    """Every node has a page that includes its tables, and a line in the overview."""
    folder = root / 'docs/reference'
    overview = (folder / 'nodes.md').read_text(encoding='utf-8')
    for name in NODES:
        text = (folder / f'nodes/{name}.md').read_text(encoding='utf-8')
        assert text.startswith(f'# {name}: ')
        assert text.endswith(f'```{{include}} ../generated/nodes/{name}.md\n```\n')
        assert f'[`{name}`](nodes/{name}.md)' in overview
    pages = {file.stem for file in (folder / 'nodes').glob('*.md')}
    assert pages == {*NODES, 'arm_tests'}


def section(node: str, part: str) -> list[list[str]]:
    """Rows of a table, cell by cell."""
    table = f'\n{nodes_reference.page(node)}'.partition(f'\n## {part}\n')[2].split('\n## ')[0]
    rows = [[cell.strip().strip('`') for cell in line.strip('|').split('|')]
            for line in table.splitlines() if line.startswith('|')]
    return rows[2:]


@pytest.mark.parametrize('name', sorted(NODES))
def test_tables(name: str, world: World, root: Path, model: Path) -> None:
    """Parameters of the code; topics with their types, services and figures of a running node."""
    rows = section(name, 'Parameters')
    assert [row[0] for row in rows] == [param.name for param in NODES[name]]
    values = {}
    if name in ARMS:
        values['arm'] = str(root / 'config/tudor.yaml')
    if name in MODELS:
        values['model'] = str(model)
    if name == 'arm_simulator':
        values['clock'] = True
    if name in ('collision_detector', 'monitor'):
        values['methods'] = ['strain', 'effort']
    if name.startswith('bag') or name in ('payload_estimator', 'monitors'):
        return  # topics are those of the bag, or of monitor; needs kilograms
    node = world.add(node_class(name), **values)
    assert not node.fault
    assert node.depth == (100 if name in JUDGING else 10)
    # what the node itself has: what the middleware has heard of it comes late, and may be of
    # another node of this name
    for part, own in (('Subscribed', node.subscriptions), ('Published', node.publishers)):
        wanted = {'/' + row[0].replace('~', name).lstrip('/'): row[1]
                  for row in section(name, part)}
        has = {item.topic_name: type_of(item) for item in own
               if item.topic_name not in SHARED[part]}
        assert has == wanted, part
    offered = {item.srv_name.replace(f'/{name}', '~') for item in node.services
               if type_of_service(item) == 'std_srvs/Trigger'}
    listed = {row[0] for row in section(name, 'Services')}
    assert listed - offered <= {'~/expect_payload'} and offered <= listed
    shown = [row[0].rsplit(' ', 1)[0] if row[0].split()[-1].isupper() else row[0]
             for row in section(name, 'Diagnostics')]
    for key in node.status()[2]:
        if not key.startswith('dropped'):  # of every node: docs/reference/nodes.md
            assert any(key.startswith(item) for item in shown), key


def type_of_service(item: Service) -> str:
    """Name the type of a service."""
    package, _, _ = item.srv_type.__module__.partition('.')
    return f'{package}/{item.srv_type.__name__}'


def type_of(item: Publisher | Subscription) -> str:
    """Name the type of a topic as the tables do."""
    package, _, _ = item.msg_type.__module__.partition('.')
    return f'{package}/{item.msg_type.__name__}'
