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

"""Synthetic motions, arms and bags for the tests of this folder."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

from tudor_dynamics.arm.description import arm_from_dict
from tudor_dynamics.bags.messages import joint_signals
from tudor_dynamics.bags.writer import write_bag

START = 1_700_000_000_000_000_000
JOINTS = ('shoulder', 'elbow')
GAUGES = ('upper_gauge', 'lower_gauge')


def make_arm(**changes):
    """Make a two-joint arm with currents and strains on topics of their own."""
    effort = {'topic': 'motor_currents', 'unit': 'A'}
    content = {
        'name': 'pair', 'kinematics': {'dh': [[0.4, 0.0, 0.0, 0.0], [0.4, 0.0, 0.0, 0.0]]},
        'joints': [{'name': name, 'effort': effort} for name in JOINTS],
        'gauges': [{'name': GAUGES[0], 'joint': JOINTS[0], 'distance': 0.05},
                   {'name': GAUGES[1], 'joint': JOINTS[1], 'distance': 0.05}]}
    return arm_from_dict(content | changes, base=Path(), source='test')


def plain_arm(**joint):
    """Make a two-joint arm with efforts in the joint states and no gauges."""
    return make_arm(joints=[{'name': name} | joint for name in JOINTS], gauges=[])


def times(count=300, dt=0.01):
    """Give stamps of a regular recording [ns]."""
    return START + np.arange(count) * round(dt * 1e9)


def motion(stamp):
    """Give positions and velocities of two sines, by their stamps."""
    t = (stamp - START)[:, None] * 1e-9
    rate, size = np.array([2.0, 3.0]), np.array([1.0, 0.7])
    return size * np.sin(rate * t), size * rate * np.cos(rate * t)


def joint_states(stamp=None, frame='', **changes):
    """Give signals of joint states with all fields."""
    stamp = times() if stamp is None else stamp
    q, dq = motion(stamp)
    fields = {'topic': '/joint_states', 'stamp': stamp, 'names': JOINTS, 'position': q,
              'velocity': dq, 'effort': 5 * q}
    return replace(joint_signals(**(fields | changes)), frame=frame)


def currents(stamp=None, **changes):
    """Give signals of motor currents."""
    stamp = times() if stamp is None else stamp
    fields = {'topic': '/motor_currents', 'stamp': stamp, 'names': JOINTS,
              'effort': 2 * motion(stamp)[0]}
    return joint_signals(**(fields | changes))


def strains(stamp=None, **changes):
    """Give signals of strains."""
    stamp = times() if stamp is None else stamp
    fields = {'topic': '/link_strains', 'stamp': stamp, 'names': GAUGES,
              'position': 100 * motion(stamp)[0]}
    return joint_signals(**(fields | changes))


def make_bag(path, *series, storage='mcap'):
    """Write a bag of series, by default joint states only, and give its path."""
    write_bag(path, series or (joint_states(),), storage=storage)
    return path


def write_raw(path, log_time, data, topic='/joint_states'):
    """Write encoded JointState messages with log times of their own."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(topic, 'sensor_msgs/msg/JointState',
                                           typestore=get_typestore(Stores.ROS2_JAZZY))
        for time, message in zip(log_time.tolist(), data, strict=True):
            writer.write(connection, time, message)
