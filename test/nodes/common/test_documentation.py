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

"""docs/reference/nodes.md says what the nodes declare."""

from __future__ import annotations

from pathlib import Path

import pytest
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

from ros_world import node_class, World
from tudor_dynamics.nodes.common.interfaces import NODES

SHARED = {'Subscribed': ('/parameter_events',),
          'Published': ('/diagnostics', '/parameter_events', '/rosout')}
ARMS = {'oscillation_damper', 'force_controller', 'reference_generator', 'trajectory_relay',
        'arm_simulator'}
JUDGING = {'joint_state_filter', 'dynamics_predictor', 'collision_detector', 'monitor'}
MODELS = {'joint_state_filter', 'dynamics_predictor', 'collision_detector', 'monitor',
          'feedforward'}


def section(root: Path, node: str, part: str) -> list[list[str]]:
    """Rows of a table, cell by cell."""
    text = (root / 'docs/reference/nodes.md').read_text()
    body = text.split(f'\n## {node}\n')[1].split('\n## ')[0]
    table = body.split(f'### {part}\n')[1].split('\n### ')[0]
    rows = [[cell.strip().strip('`') for cell in line.strip('|').split('|')]
            for line in table.splitlines() if line.startswith('|')]
    return rows[2:]


@pytest.mark.parametrize('name', sorted(NODES))
def test_tables(name: str, world: World, root: Path, model: Path) -> None:
    """Parameters with defaults, units and whether they change; topics with their types."""
    rows = section(root, name, 'Parameters')
    assert [row[0] for row in rows] == [param.name for param in NODES[name]]
    for row, param in zip(rows, NODES[name], strict=True):
        assert row[2] == param.unit and row[4] == ('yes' if param.dynamic else 'no')
        assert param.text in row[5]
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
                  for row in section(root, name, part)}
        has = {item.topic_name: type_of(item) for item in own
               if item.topic_name not in SHARED[part]}
        assert has == wanted, part


def type_of(item: Publisher | Subscription) -> str:
    """Name the type of a topic as the tables do."""
    package, _, _ = item.msg_type.__module__.partition('.')
    return f'{package}/{item.msg_type.__name__}'
