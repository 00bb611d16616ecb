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

"""
Tables of the pages in ``docs/reference/nodes/``: topics, services, parameters, diagnostics.

    python tools/nodes_reference.py NODE    prints those of a node

``make docs`` writes them for all nodes; the pages include them. Parameters and diagnostics
are what the nodes declare. Topics and services stand in `TOPICS` and `SERVICES`;
``test/nodes/common/test_documentation.py`` compares them with running nodes.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
import sys

from tudor_dynamics.nodes.common.base import TudorNode
from tudor_dynamics.nodes.common.interfaces import NODES, Param

NODES_PAGE = '../nodes.md#what-all-nodes-share'
QOS = {'Subscribed': 'Best effort, so that any driver matches', 'Published':
       'Reliable, the last 100 or 10 messages; latched topics are transient local, the last one'}
HEAD = ('| name | what it does | default | unit | range | while running |\n'
        '|---|---|---|---|---|---|\n')

MOTION = 'trajectory_msgs/JointTrajectory'
STATE = 'sensor_msgs/JointState'
WRENCH = 'geometry_msgs/WrenchStamped'
CONTENT = {
    'joint_states': (STATE, 'positions [rad or m], velocities where the driver has them; the '
                     'topic is that of the arm'),
    'motor_currents': (STATE, 'effort in the unit of its driver; the topic is that of the arm'),
    'link_strains': (STATE, 'position = strain in the `unit` of its gauge; the topic is that '
                     'of the arm'),
    'filtered_joint_states': (STATE, 'position, velocity, effort after the filter'),
    'joint_motion': (MOTION, 'one point: position, velocity, acceleration; `time_from_start` is '
                     'the time since the filter started'),
    'predicted_efforts': (STATE, 'effort in the unit of its driver, stamp of the sample'),
    'predicted_strains': (STATE, 'position = strain in the `unit` of its gauge'),
    'effort_residuals': (STATE, 'measured - predicted'),
    'strain_residuals': (STATE, 'measured - predicted'),
    'momentum_residuals': (STATE, 'negative external effort of the momentum observer, in the '
                           'unit of the effort'),
    'effort_thresholds': (STATE, 'collision threshold of the residual in force'),
    'strain_thresholds': (STATE, 'the same'),
    'momentum_thresholds': (STATE, 'the same'),
    'effort_ratios': (STATE, 'ratio of each channel to a collision, which it is above 1'),
    'strain_ratios': (STATE, 'the same'),
    'momentum_ratios': (STATE, 'the same'),
    'ringing': (STATE, 'amplitude of a ringing tool in each effort, where the model knows the '
                       'tool (`--models vibration`)'),
    'collision': ('std_msgs/Bool',
                  'state of the detector, which is no safety function; latched, on change'),
    'contact': ('std_msgs/Bool', 'the more sensitive level; latched, on change'),
    'contact_wrench': (WRENCH, 'with `estimate_contact`: force, and torque about the origin of '
                       'the frame, on a link, in its frame; zero without contact'),
    'contact_marker': ('visualization_msgs/Marker', 'with `estimate_contact`: arrow of 10 mm/N, '
                       'its head at the place, on the link'),
    'contact_point': ('geometry_msgs/PointStamped', 'with `estimate_contact`: place on the link, '
                      'while it is identifiable'),
    'collision_event': ('std_msgs/Header', 'stamp = first sample above the threshold, frame_id = '
                        'link named'),
    'collision_record': ('std_msgs/String', 'JSON of the last event, latched: its channel and '
                         'its last second; measured, expected, thresholds, ratios of all; motion; '
                         'state; parameters; digest of the model; versions'),
    'payload': ('geometry_msgs/InertiaStamped', 'mass of the load [kg] and its place, in the '
                'frame of the last link; latched'),
    'wanted_trajectory': (MOTION, 'wanted motion; velocities and accelerations may be empty; '
                          'reliable'),
    'wanted_states': (STATE, 'single states: position and, where the arm is to move, velocity'),
    'trajectory_with_effort': (MOTION, 'the same with `effort`; with `positions: motor` those of '
                               'the motors'),
    'states_with_effort': (STATE, 'the same with `effort`, stamp of the wanted state'),
    'joint_reference': (STATE, 'wanted position and velocity'),
    'velocity_commands': ('std_msgs/Float64MultiArray', 'speeds of the active joints in their '
                          'order, as forward_command_controller takes them [rad/s]'),
    'wanted_force': ('std_msgs/Float64', 'force on the tip [N]; 0 or less leaves the surface'),
    'tip_force': (WRENCH, 'estimated force on the tip, in the base frame'),
    'joint_trajectory': (MOTION, 'one point: a goal; several: a trajectory; none: stop'),
    '/diagnostics': ('diagnostic_msgs/DiagnosticArray', 'whether who publishes `collision` is '
                     'able to judge'),
    '~/state': (MOTION, 'three points: reference, measurement, difference'),
    'joint_trajectory_controller/joint_trajectory': (
        MOTION, 'what was accepted, and where to rest; the name is that of `controller`'),
    'external_wrench': (WRENCH, 'force at the tip in the base frame until the next message [N]'),
    'applied_wrench': (WRENCH, 'all forces at the tip, the floor included; while somebody '
                       'subscribes'),
    '/clock': ('rosgraph_msgs/Clock', 'time of the simulation or bag, with the parameter '
               '`clock`'),
    'TOPICS': ('as recorded', 'every topic of the bag, or of `topics`, whose type is installed'),
}
"""Topic to its type and content."""

MEASURED = ('joint_states', 'motor_currents', 'link_strains')
PREDICTED = ('predicted_efforts', 'predicted_strains')
JUDGED = ('effort_residuals', 'strain_residuals', 'momentum_residuals', 'effort_thresholds',
          'strain_thresholds', 'momentum_thresholds', 'effort_ratios', 'strain_ratios',
          'momentum_ratios', 'ringing', 'collision', 'contact', 'contact_wrench',
          'contact_point', 'contact_marker', 'collision_event', 'collision_record')
TOPICS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    'joint_state_filter': (('joint_states',), ('filtered_joint_states', 'joint_motion')),
    'dynamics_predictor': (('joint_motion',), PREDICTED),
    'collision_detector': (('joint_motion', *PREDICTED, *MEASURED[1:]), JUDGED),
    'monitor': (MEASURED, ('joint_motion', *PREDICTED, *JUDGED)),
    'monitors': ((), ()),
    'watch': ((*(topic for topic in JUDGED if topic.endswith('ratios')), 'collision', 'contact',
               'collision_record', 'payload', '/diagnostics'), ()),
    'payload_estimator': (MEASURED, ('payload',)),
    'feedforward': (('wanted_trajectory', 'wanted_states'),
                    ('trajectory_with_effort', 'states_with_effort')),
    'oscillation_damper': (('joint_states', 'link_strains', 'joint_reference', 'payload',
                            'motor_currents'), ('velocity_commands',)),
    'force_controller': (('joint_states', 'link_strains', 'wanted_force'),
                         ('joint_reference', 'tip_force')),
    'reference_generator': (('joint_states', 'joint_trajectory', 'collision', 'payload',
                             'strain_residuals', '/diagnostics'), ('joint_reference', '~/state')),
    'trajectory_relay': (('joint_states', 'joint_trajectory', 'collision'),
                         ('joint_trajectory_controller/joint_trajectory',)),
    'arm_simulator': (('velocity_commands', 'external_wrench'),
                      (*MEASURED, 'applied_wrench', '/clock')),
    'bag_player': ((), ('TOPICS', '/clock')),
    'bag_recorder': (('TOPICS',), ()),
}
"""Node to the topics that it subscribes to, and those that it publishes."""

SERVICE = {
    '~/reset': 'starts again after a fault, a collision or a refusal',
    '~/calibrate': 'learns thresholds from `calibration_time` of free motion',
    '~/reload': 'reads the model again',
    '~/expect_payload': 'a load picked up or released within 3 s is not reported as a collision '
                        '(with `payload_source: estimate`)',
    '~/joints_tested': 'called by `joint_test`',
    '~/retreat': 'leads back to where the approach started',
}
"""Service (std_srvs/Trigger) to what it does."""

DETECTS = ('~/reset', '~/calibrate', '~/reload', '~/expect_payload')
SERVICES = {
    'joint_state_filter': ('~/reset',), 'dynamics_predictor': ('~/reload',),
    'collision_detector': DETECTS, 'monitor': DETECTS, 'payload_estimator': DETECTS,
    'feedforward': ('~/reload',), 'oscillation_damper': ('~/reset', '~/joints_tested'),
    'force_controller': ('~/reset', '~/retreat'), 'reference_generator': ('~/reset',),
    'trajectory_relay': ('~/reset',), 'arm_simulator': ('~/reset',),
}

LOADS = ('payload source', 'payload std [kg]', 'payload estimated from',
         'collisions that were loads', 'loads announced')
KEYLESS = {
    'DynamicsPredictorNode': LOADS[:1], 'FeedforwardNode': LOADS[:1],
    'DetectNode': ('contact', 'contact link', 'contact force [N]', 'contact place [m]',
                   'last collision [ns]', 'last link', *LOADS),
    'OscillationDamperNode': ('payload in use [kg]', 'scheduled gains in use', 'first mode [Hz]',
                              'damping ratio by schedule'),
}
"""Class to the keys of its figures that have none in `FIGURES`, because others give them."""

MEANING = {
    'model': 'directory of the bundle', 'arm': 'name of the arm and checksum of its description',
    'payload [kg]': 'load in use', 'kind': 'model that predicts',
    'level': 'free, contact or collision', 'methods': 'those with thresholds',
    'not judged [%]': 'see [what is not judged](../nodes.md#what-is-not-judged)',
    'not judged: CAUSE': 'the same by cause',
    'thresholds widened: METHOD': 'factor and channel, see '
    '[thresholds](../../explanation/thresholds.md#motion-outside-the-training-distribution)',
    'contact': 'what estimates it, or why nothing does', 'contact link': 'link that is touched',
    'contact force [N]': 'its size; `contact force deviation [N]` its standard deviation',
    'contact place [m]': 'along the link; `contact place deviation [m]` its standard deviation',
    'last collision [ns]': 'stamp', 'last link': 'its link',
    'payload source': 'parameter, estimate or topic',
    'payload std [kg]': 'standard deviation of the estimate',
    'payload estimated from': 'output that gives the estimate, and whether with bent links',
    'collisions that were loads': 'events that turned out to be a load',
    'loads announced': 'by gripper or service',
    'CPU [%]': 'of the process since the last diagnosis, of one core', 'arms': 'those given',
    'watched': 'those with a monitor', 'failures ARM': 'of its monitor',
    'unit': 'of the efforts', 'positions': 'wanted, or of the motors',
    'phase': 'of the lifecycle', 'state': 'see [safety](../../explanation/safety.md#states)',
    'cause': 'why it is in this state', 'loop delay [ms]': 'from positions to commands and back',
    'age of stamps [ms]': 'against the clock of this machine',
    'damping in use': 'what the delay allows', 'position gain in use [1/s]': 'the same',
    'payload in use [kg]': 'load by which gains are chosen, with a schedule',
    'scheduled gains in use': '0 to 1', 'first mode [Hz]': 'by the schedule',
    'damping ratio by schedule': 'of the first mode',
    'cut: CAUSE': 'commands that the envelope cut since the last diagnosis',
    'ahead of commands [rad], JOINT': 'its excess, and what is no fault',
    'refused: CAUSE': 'references refused', 'damper JOINT': 'state of its damper and gauge',
    'wanted [N]': 'force asked for', 'force [N]': 'force estimated',
    'weight by': 'source of what gauges read of the weight',
    'reaction': 'that is under way', 'shaping': 'in use',
    'not shaped': 'why the last move was not', 'monitors': 'who publishes `collision`',
    'trajectory': 'progress, or how it ended',
    'off the reference JOINT [rad]': 'measured minus wanted',
    'begun again': 'why the reference restarted, the last time',
    'controller': 'that it commands', 'forwarded': 'trajectories',
    'refused': 'why, the last time', 'efforts': 'their units',
    'simulated time [s]': 'since the start', 'gave up real time': 'how often',
    'bag': 'that is played or recorded', 'skipped': 'topics without an installed type',
    'rings': 'how a flexible tool rings, and for how long',
    'messages in the bag': 'of all topics', 'topics': 'that are recorded',
}
"""Key of a figure in the diagnostics to what it is."""


def _default(param: Param) -> str:
    value = param.default
    if isinstance(value, tuple):
        return str(list(value))
    return str(value).lower() if isinstance(value, bool) else str(value) or "''"


def row(param: Param) -> str:
    """Write the row of a parameter."""
    bounds = '' if param.low is None else f'{param.low:g} .. {param.high:g}'
    choices = f'; one of {", ".join(param.choices)}' if param.choices else ''
    return (f'| `{param.name}` | {param.text}{choices} | `{_default(param)}` | {param.unit} | '
            f'{bounds} | {"yes" if param.dynamic else "no"} |\n')


def node_class(name: str) -> type[TudorNode]:
    """Import the class of a node."""
    module = import_module(f'tudor_dynamics.nodes.{name}')
    found = getattr(module, ''.join(part.title() for part in name.split('_')) + 'Node')
    assert issubclass(found, TudorNode)
    return found


def figures(kind: type[TudorNode]) -> list[str]:
    """Name the figures in a node's diagnostics, each once."""
    keys = [key for base in reversed(kind.__mro__)
            for key in (*(figure.key for figure in base.__dict__.get('FIGURES', ())),
                        *KEYLESS.get(base.__name__, ())) if key]
    return list(dict.fromkeys(keys))


def tables(name: str) -> Iterator[str]:
    """Write the tables of a node."""
    for part, topics in zip(('Subscribed', 'Published'), TOPICS[name], strict=True):
        if topics:
            yield (f'## {part}\n\n{QOS[part]}; [quality of service]({NODES_PAGE}).\n\n'
                   '| topic | type | content |\n|---|---|---|\n') + ''.join(
                f'| `{topic}` | {CONTENT[topic][0]} | {CONTENT[topic][1]} |\n'
                for topic in topics)
    if name in SERVICES:
        yield '## Services\n\n| std_srvs/Trigger | what it does |\n|---|---|\n' + ''.join(
            f'| `{service}` | {SERVICE[service]} |\n' for service in SERVICES[name])
    yield '## Parameters\n\n' + HEAD + ''.join(row(param) for param in NODES[name])
    keys = figures(node_class(name))
    if keys:
        yield '## Diagnostics\n\n| figure | what it is |\n|---|---|\n' + ''.join(
            f'| `{key}` | {MEANING[key]} |\n' for key in keys)


def page(name: str) -> str:
    """Give all tables of a node."""
    return '\n'.join(tables(name))


if __name__ == '__main__':
    print(page(sys.argv[1]), end='')
