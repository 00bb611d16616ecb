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

"""Every topic, service and parameter of the nodes, in one place; free of ROS."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

from tudor_dynamics.control.shaped_motion import SHAPINGS
from tudor_dynamics.models.bundle import KINDS
from tudor_dynamics.models.still_timing import TIMING
from tudor_dynamics.online.feedforward import AT_REST, POSITIONS, UNITS
from tudor_dynamics.online.settings import STUCK_TIME
from tudor_dynamics.signals.shaping import KINDS as SHAPERS

JOINT_STATES = 'joint_states'
FILTERED_JOINT_STATES = 'filtered_joint_states'
JOINT_MOTION = 'joint_motion'
PREDICTED = {'effort': 'predicted_efforts', 'strain': 'predicted_strains'}
RESIDUALS = {'effort': 'effort_residuals', 'strain': 'strain_residuals',
             'momentum': 'momentum_residuals'}
THRESHOLDS = {'effort': 'effort_thresholds', 'strain': 'strain_thresholds',
              'momentum': 'momentum_thresholds'}
RATIOS = {'effort': 'effort_ratios', 'strain': 'strain_ratios', 'momentum': 'momentum_ratios'}
RINGING = 'ringing'
COLLISION = 'collision'
CONTACT = 'contact'
COLLISION_EVENT = 'collision_event'
COLLISION_RECORD = 'collision_record'
PAYLOAD_TOPIC = 'payload'
CONTACT_WRENCH = 'contact_wrench'
CONTACT_POINT = 'contact_point'
CONTACT_MARKER = 'contact_marker'
WANTED_FORCE = 'wanted_force'
TIP_FORCE = 'tip_force'
JOINT_REFERENCE = 'joint_reference'
VELOCITY_COMMANDS = 'velocity_commands'
JOINT_TRAJECTORY = 'joint_trajectory'
WANTED_TRAJECTORY = 'wanted_trajectory'
TRAJECTORY_WITH_EFFORT = 'trajectory_with_effort'
WANTED_STATES = 'wanted_states'
STATES_WITH_EFFORT = 'states_with_effort'
EXTERNAL_WRENCH = 'external_wrench'
APPLIED_WRENCH = 'applied_wrench'
OUTPUTS = {FILTERED_JOINT_STATES, RINGING, JOINT_REFERENCE, WANTED_STATES, STATES_WITH_EFFORT,
           *PREDICTED.values(), *RESIDUALS.values(), *THRESHOLDS.values(), *RATIOS.values()}
"""Joint states of these nodes, many of them only when asked for, or while somebody listens."""
DIAGNOSTICS = '/diagnostics'
CLOCK = '/clock'

RESET, CALIBRATE, RELOAD, RETREAT = '~/reset', '~/calibrate', '~/reload', '~/retreat'
EXPECT_PAYLOAD, JOINTS_TESTED = '~/expect_payload', '~/joints_tested'
STATE, FOLLOW = '~/state', '~/follow_joint_trajectory'

Value = bool | int | float | str | tuple[str, ...]


@dataclass(frozen=True)
class Param:
    """A parameter of a node."""

    name: str  # name, with dots where it belongs to a group
    default: Value  # default; its type is the type of the parameter
    text: str  # what it does
    unit: str = ''  # unit; empty for none
    # Bounds of a number.
    low: float | None = None
    high: float | None = None
    dynamic: bool = False  # whether it may change while the node runs
    choices: Collection[str] = ()  # values allowed, for strings

    def describe(self) -> str:
        """Say what it does, with unit and choices."""
        unit = f' [{self.unit}]' if self.unit else ''
        choices = f'; one of {", ".join(self.choices)}' if self.choices else ''
        return f'{self.text}{unit}{choices}'


ROBOT = Param('robot', '', 'hardware_id of the diagnostics; the name of the arm by default')
TIMEOUT = Param('timeout', 0.5, 'input older than this is stale', 's', 0.01, 60.0, dynamic=True)
COMMON = (ROBOT, TIMEOUT)
MOVING = (ROBOT, replace(TIMEOUT, high=1.0))  # what moves an arm trusts no older input
COMMAND_TIMEOUT = Param('timeout', 0.1, 'a reference or positions older than this are missing: '
                        'the arm brakes and is held; positions after 0.25 s at the latest', 's',
                        0.01, 1.0, dynamic=True)
MODEL = Param('model', '', 'directory of a model made by tudor fit')
KIND = Param('kind', 'analytical', 'model that predicts', choices=KINDS)
PAYLOAD = Param('payload', 0.0, 'mass at the tip, for a model of all loads; a detector '
                'restarts when it changes', 'kg', 0.0, 1e3, dynamic=True)
PAYLOAD_SOURCE = Param(
    'payload_source', 'parameter', 'where the load is known from: the parameter payload, the own '
    'estimate, which payload then is the beginning of, or the topic payload',
    choices=('parameter', 'estimate', 'topic'))
GRIPPERS = ('std_msgs/msg/Bool', 'sensor_msgs/msg/JointState', 'action_msgs/msg/GoalStatusArray')
GRIPPER = (
    Param('gripper_topic', '', 'topic of a gripper that announces loads where these are estimated '
          'or heard; none by default'),
    Param('gripper_type', GRIPPERS[0], 'its type: whether it is closed, where its fingers are, or '
          'the goals of its action (such as gripper_cmd/_action/status)', choices=GRIPPERS))
LOAD_FROM = Param(
    'payload_source', 'parameter', 'where the load is known from: the parameter payload, or the '
    'topic payload', choices=('parameter', 'topic'))
GAP = Param('gap', 0.0, 'longest time between samples that is no gap; 0 for five periods, at '
            'least 20 ms', 's', 0.0, 60.0)

FILTER = (
    MODEL,
    Param('joints', (), 'joints in the order of the output; those of the model by default, else '
          'all of the first message'),
    Param('velocity_cutoff', 80.0, 'low-pass of the velocity; used without a model', 'Hz', 0.01,
          1e5),
    Param('acceleration_cutoff', 20.0, 'low-pass of the acceleration; used without a model', 'Hz',
          0.01, 1e5),
    Param('output_cutoff', 0.0, 'low-pass of positions, velocities and efforts, 0 for none; used '
          'without a model', 'Hz', 0.0, 1e5),
    Param('measured_velocity', True, "take the driver's velocity where it has one; used without a "
          'model'),
    GAP)
PREDICT = (MODEL, KIND, PAYLOAD)
DETECT = (
    Param('methods', (), 'what the detector listens to, of strain, effort and momentum; by '
          'default all that the model has thresholds for, without any all that it predicts'),
    Param('false_alarms_per_hour', 1.0, 'false collisions that are allowed', '1/h', 1e-6, 3600.0,
          dynamic=True),
    Param('contact_alarms_per_hour', 60.0, 'false contacts that are allowed', '1/h', 1e-6, 3600.0,
          dynamic=True),
    Param('debounce', 0.01, 'time for which a threshold must be exceeded', 's', 0.0, 1.0,
          dynamic=True),
    Param('rearm', 0.3, 'time below its threshold after which a level is left', 's', 0.0, 60.0,
          dynamic=True),
    Param('observer_gain', 30.0, 'bandwidth of the momentum observer', '1/s', 0.25, 1e4),
    Param('estimate_contact', False, 'estimate force and place of contacts, from strain where the '
          'model has it, else from the momentum observer'),
    Param('calibration_time', 60.0, 'motion without contact that ~/calibrate learns from', 's',
          30.0, 3600.0, dynamic=True),
    Param('stuck_time', STUCK_TIME, 'time without any change while the arm moves, after which a '
          'channel counts as dead', 's', 0.01, 600.0, dynamic=True))
EVENT_BAGS = Param(
    'event_bags', '', 'folder for a bag of the last 30 s at each collision; empty for '
    'tudor_dynamics/events in ROS_HOME or ~/.ros, none for no bags')
AHEAD = (
    Param('unit', 'model', 'efforts as the model has them, as currents, or as torques at the '
          'joints', choices=UNITS),
    Param('positions', 'wanted', 'positions stay as wanted, or become those of the motors that '
          'put the links of an elastic arm there', choices=POSITIONS),
    Param('friction_at_rest', 'none', 'friction at rest along a trajectory: none, or kept, that '
          'of the last motion', choices=AT_REST))
PLAYER = (
    Param('bag', '', 'rosbag2 directory, .mcap or .db3'),
    Param('rate', 1.0, 'speed of the replay, 1 for real time', '', 1e-3, 1e3, dynamic=True),
    Param('loop', False, 'begin again at the end', dynamic=True),
    Param('start_offset', 0.0, 'where to begin', 's', 0.0, 1e9),
    Param('topics', (), 'topics to publish; all by default'),
    Param('clock', False, 'publish /clock with the time of the bag'),
    Param('wait_for_subscribers', 0, 'subscriptions on every topic to wait for', '', 0, 100),
    Param('exit_at_end', False, 'end the node when the bag ends'))
RECORDER = (
    Param('bag', '', 'directory to make; it appears when recording ends'),
    Param('topics', (), 'topics to record; all by default'),
    Param('storage', 'mcap', 'storage format', choices=('mcap', 'sqlite3')))

MANY = (
    Param('namespaces', (), 'namespaces of the arms, from that of the node where they do not '
          'begin with a slash'),
    Param('pause', 2.0, 'time between the failure of a monitor and another one', 's', 0.0, 3600.0,
          dynamic=True))

ARM = Param('arm', '', 'arm description (YAML)')
AUTOSTART = Param('autostart', True, 'configure and activate at the start')
PARTIAL = Param('allow_partial_joints_goal', True, 'true: joints that a trajectory does not '
                'name are held; false: it is refused', dynamic=True)
DAMP = (
    ARM,
    AUTOSTART,
    Param('require_joint_test', False, 'joints go no farther than a nudge until joint_test has '
          'found them right, since their driver started', dynamic=True),
    Param('damping', 1.0, "part of the damper's gains", '', 0.0, 1.25, dynamic=True),
    Param('position_gain', 0.0, 'speed per position error, 0 for that of the arm', '1/s', 0.0,
          100.0, dynamic=True),
    Param('gain_schedule', '', 'file of tudor tune: gains follow the topic payload and the pose'),
    Param('payload_timeout', 0.0, 'age at which a load is not believed any more, and the fixed '
          'gains come back; 0 for none, a load is said once', 's', 0.0, 3600.0, dynamic=True))
REFERENCE = (
    ARM,
    AUTOSTART,
    Param('rate', 500.0, 'rate of the reference', 'Hz', 1.0, 2000.0),
    Param('mode', 'goals', 'goals from joint_trajectory, or an APRBS', choices=('goals', 'aprbs')),
    Param('seed', 0, 'seed of the APRBS', '', 0, 2**31 - 1),
    Param('reaction', 'retreat', 'what to do at a collision', dynamic=True,
          choices=('none', 'hold', 'retreat', 'comply')),
    Param('shaping', 'none', 'shapes moves so that they leave no ringing: ZV or ZVD of the first '
          'mode, or by all modes on the path', choices=SHAPINGS),
    Param('gain_schedule', '', 'file of tudor tune with the modes; the topic payload says which'),
    Param('model', '', 'fitted model whose elastic part refines moves of elastic, for gears with '
          'play; planned beside, while the reference rests'),
    Param('shaping_frequency', 0.0, 'frequency of the first mode for zv and zvd; 0: that of '
          'gain_schedule', 'Hz', 0.0, 1e3),
    Param('shaping_damping', 0.01, 'its damping ratio', '', 0.0, 0.9),
    PARTIAL,
    Param('path_tolerance', 0.0, 'the arm stops farther off a trajectory; 0 for never', 'rad', 0.0,
          10.0, dynamic=True),
    Param('goal_tolerance', 0.0, 'a trajectory is missed if the arm ends farther off; 0 for never',
          'rad', 0.0, 10.0, dynamic=True),
    Param('goal_time', 1.0, 'so long after its end that is judged, 0 for as long as it '
          'takes', 's', 0.0, 60.0, dynamic=True),
    Param('retreat_time', 1.0, 'part of the path that retreat drives back', 's', 0.0, 10.0,
          dynamic=True),
    Param('comply_gain', 1000.0, 'speed of complying per strain of the contact', 'rad/s per m/m',
          0.0, 1e5, dynamic=True),
    Param('resume', False, 'take goals again when the collision is over, not only on ~/reset',
          dynamic=True),
    Param('require_monitor', False, 'take goals only while a node that publishes collision is '
          'alive and able to judge', dynamic=True))
RELAY = (
    ARM,
    Param('controller', 'joint_trajectory_controller',
          'name of the controller that trajectories go to'),
    Param('start_tolerance', 0.05, 'a first point at the start may be so far from where the arm '
          'is; controllers jump to it', 'rad', 0.0, 10.0, dynamic=True),
    Param('shaping', 'none', 'shapes motion from rest to rest so that a tool does not ring: by ZV '
          'or ZVD, or by another timing of the same path', choices=('none', *SHAPERS, TIMING),
          dynamic=True),
    Param('tool', '', 'model with the tool (tudor fit --models vibration), which timing '
          'needs'),
    Param('shaping_frequency', 0.0, 'frequency at which the tool rings, for zv and zvd; 0: that '
          'of tool where the motion ends', 'Hz', 0.0, 1e3, dynamic=True),
    Param('shaping_damping', 0.02, 'its damping ratio', '', 0.0, 0.9, dynamic=True),
    Param('not_shaped', 'pass', 'what cannot be shaped is passed on as it is, or refused',
          choices=('pass', 'refuse'), dynamic=True),
    PARTIAL)
FORCE = (
    ARM,
    Param('model', '', 'model that says what gauges read of the weight of the arm; without '
          'one its links and the gains of its sensors do'),
    AUTOSTART,
    Param('normal', 'z', 'direction in which the surface presses on the tip, in the base frame',
          choices=('x', '-x', 'y', '-y', 'z', '-z')),
    Param('approach_speed', 0.02, 'speed of the tip towards the surface and back', 'm/s', 1e-4,
          1.0),
    Param('reach', 0.1, 'farthest that a surface is looked for', 'm', 1e-3, 10.0),
    Param('touch', 0.4, 'force from which there is contact', 'N', 0.01, 1e3),
    Param('integral', 0.3, 'integral gain: tip speed per force error', 'm/s per N', 0.0, 10.0),
    Param('proportional', 0.02, 'proportional gain: tip travel per force error', 'm/N', 0.0, 1.0),
    Param('give', 0.1, 'farthest that the surface may give way', 'm', 1e-3, 10.0),
    Param('largest', 15.0, 'force at which the arm stops', 'N', 0.1, 1e4),
    Param('lost', 0.5, 'time without contact after which the surface is lost', 's', 0.01, 60.0))
SIMULATE = (
    ARM,
    Param('rate', 500.0, 'rate of the messages', 'Hz', 1.0, 2000.0),
    Param('factor', 1.0, 'speed of simulated time, 1 for real time', '', 0.01, 100.0),
    Param('clock', False, 'publish /clock with the simulated time'),
    Param('lockstep', False, 'with clock: each sample waits for the command that answers the one '
          'before, so that no machine is too busy'),
    Param('payload', 0.0, 'mass at the tip', 'kg', 0.0, 1e3),
    Param('damping', 0.0, "part of the built-in damper's gains; 0 leaves damping to a node", '',
          0.0, 10.0),
    Param('imperfections', True, 'friction, backlash, noise and resolution'),
    Param('seed', 0, 'seed of the noise', '', 0, 2**31 - 1),
    Param('command_timeout', 0.1, 'the joints stop where no command came for so long', 's', 0.001,
          60.0, dynamic=True),
    Param('obstacle', False, 'an elastic floor below the tip', dynamic=True),
    Param('obstacle_height', 0.0, 'height of the floor in the base frame', 'm', -100.0, 100.0,
          dynamic=True),
    Param('obstacle_stiffness', 500.0, 'stiffness of the floor', 'N/m', 0.0, 1e5, dynamic=True))

NODES: dict[str, tuple[Param, ...]] = {
    'joint_state_filter': (*FILTER, *COMMON),
    'dynamics_predictor': (*PREDICT, LOAD_FROM, *COMMON),
    'collision_detector': (*PREDICT, PAYLOAD_SOURCE, *GRIPPER, *DETECT, *COMMON),
    'monitor': (*PREDICT, PAYLOAD_SOURCE, *GRIPPER, GAP, *DETECT, EVENT_BAGS, *COMMON),
    'monitors': (*MANY, ROBOT),
    'watch': (Param('web', 0, 'port on which a page is served to this machine, 0 for none', '', 0,
                    65535), ROBOT),
    'payload_estimator': (*PREDICT, *GRIPPER, GAP, *DETECT, EVENT_BAGS, *COMMON),
    'feedforward': (*PREDICT, LOAD_FROM, *AHEAD, ROBOT),
    'oscillation_damper': (*DAMP, ROBOT, COMMAND_TIMEOUT),
    'force_controller': (*FORCE, *MOVING),
    'reference_generator': (*REFERENCE, *MOVING),
    'trajectory_relay': (*RELAY, *PREDICT, *AHEAD, *MOVING),
    'arm_simulator': (*SIMULATE, *COMMON),
    'bag_player': (*PLAYER, *COMMON),
    'bag_recorder': (*RECORDER, *COMMON),
}
"""Parameters of each node."""
