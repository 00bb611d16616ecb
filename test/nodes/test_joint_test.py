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

"""Program joint_test: what it refuses, and what it finds with a driver that is right, and lies."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import subprocess
import sys

import pytest

pytest.importorskip('rclpy')

from node_processes import end, fork  # noqa: E402, I100
from patience import PATIENCE  # noqa: E402, I100
from tudor_dynamics.arm.description import load_arm  # noqa: E402, I100
from tudor_dynamics.mechanics.rig import Rig  # noqa: E402, I100
from tudor_dynamics.nodes.joint_test import main  # noqa: E402, I100

RELAY = """
import sys
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
rclpy.init()
node = Node('driver')
node.declare_parameter('joints', ['joint3', 'joint2'])
obey, report = eval(sys.argv[1]), eval(sys.argv[2])
drive = node.create_publisher(Float64MultiArray, 'drive_commands', 10)
states = node.create_publisher(JointState, 'joint_states', 10)
def command(message):
    drive.publish(Float64MultiArray(data=obey(list(message.data))))
def state(message):
    message.position = report(list(message.position))
    states.publish(message)
node.create_subscription(Float64MultiArray, 'velocity_commands', command, 10)
node.create_subscription(JointState, 'drive_states', state, 10)
rclpy.spin(node)
"""
"""A driver between the controller and the drives; joint1 comes first in its states."""
PROGRAM = 'import sys; from tudor_dynamics.nodes.joint_test import main; sys.exit(main())'
TRUE = 'lambda x: x'
LIES = {
    'swapped': ('lambda u: u[::-1]', TRUE,
                "joint2: commands to this joint move 'joint3'; correct the order"),
    'negated': ('lambda u: [u[0], -u[1]]', TRUE,
                'joint3: the joint moves the other way, so a sign is wrong'),
    'a tenth': (TRUE, 'lambda q: [q[0], 0.7 + 0.1 * q[1], q[2]]',
                'the positions that the driver reports, as its velocity is right'),
    'deaf': ('lambda u: [0.0, 0.0]', TRUE, 'joint2: the joint does not answer')}


def test_wrong_input(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One line and exit code 2 for an arm without a damper, a foreign joint, a huge step."""
    tudor = str(root / 'config/tudor.yaml')
    for words, expected in (
            (['--arm', str(root / 'config/two_blade_arm.yaml')], "the key 'damper' is missing"),
            (['--arm', tudor, '--joints', 'joint1'], "'joint1' is not an active joint"),
            (['--arm', tudor, '--step', '50'], 'up to 5 degrees')):
        assert main(['joint_test', *words]) == 2
        error = capsys.readouterr().err
        assert expected in error and len(error.splitlines()) == 1


@contextmanager
def driver(obey: str, report: str) -> Iterator[None]:
    """Run a driver as a process, for a while."""
    process = subprocess.Popen(
        [sys.executable, '-c', RELAY, obey, report], stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(PATIENCE)
        finally:
            process.kill()


def test_drivers_that_are_right_and_that_lie(
    root: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """Every lie is named, over topics; the next test begins where the one before has stopped."""
    arm = str(root / 'config/tudor.yaml')
    clock = '--ros-args', '-p', 'use_sim_time:=true'
    words = [*clock[1:], '-p', f'arm:={arm}']
    Rig(load_arm(arm)).run(0.1)  # compiles, for which the program does not wait

    def test() -> tuple[int, str]:
        code = main(['joint_test', '--arm', arm, *clock])
        return code, capsys.readouterr().out

    nodes = [
        fork('arm_simulator', *words[2:], '-p', 'rate:=100.0', '-p', 'clock:=true', '-p',
             'lockstep:=true', '-r', 'velocity_commands:=drive_commands', '-r',
             'joint_states:=drive_states'),
        fork('reference_generator', *words, '-p', 'rate:=100.0'),
        fork('oscillation_damper', *words)]
    try:
        with driver(TRUE, TRUE):
            done = subprocess.run(
                [sys.executable, '-c', PROGRAM, '--arm', arm, '--controller', 'driver', *clock],
                timeout=PATIENCE, capture_output=True, text=True, check=False,
                env={**os.environ, 'PYTHONPATH': str(root)})
            assert done.returncode == 1 and 'in this order; set' in done.stdout, done
            assert 'nothing was moved' in done.stdout
            code, said = test()
            assert code == 0, said
            for joint in ('joint2', 'joint3'):
                assert f'{joint}: right' in said, said
        for obey, report, expected in LIES.values():
            with driver(obey, report):
                code, said = test()
                assert code == 1 and expected in said, said
                assert 'oscillation_damper is inactive' in said, said
    finally:
        end(nodes)
