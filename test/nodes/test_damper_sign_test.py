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

"""Program damper_sign_test: what it refuses, and a joint of the simulated arm found right."""

from __future__ import annotations

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
from tudor_dynamics.nodes.damper_sign_test import main  # noqa: E402, I100


def test_wrong_input(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One line and exit code 2 for an arm without a damper, a joint without one, a huge step."""
    tudor = str(root / 'config/tudor.yaml')
    for words, expected in (
            (['--arm', str(root / 'config/two_blade_arm.yaml')], "the key 'damper' is missing"),
            (['--arm', tudor, '--joints', 'joint1'], "'joint1' is not in damper.joints"),
            (['--arm', tudor, '--step', '50'], 'up to 20 degrees')):
        assert main(['damper_sign_test', *words]) == 2
        error = capsys.readouterr().err
        assert expected in error and len(error.splitlines()) == 1


def test_the_simulated_arm_is_right(root: Path) -> None:
    """Simulator, reference generator and damper as processes; the test of joint 2 says right."""
    arm = str(root / 'config/tudor.yaml')
    Rig(load_arm(arm)).run(0.1)  # compiles, for which the program does not wait
    program = ('import sys; from tudor_dynamics.nodes.damper_sign_test import main; '
               'sys.exit(main())')
    words = '-p', f'arm:={arm}'
    nodes = [fork('arm_simulator', *words, '-p', 'clock:=true', '-p', 'lockstep:=true'),
             *(fork(node, '-p', 'use_sim_time:=true', *words)
               for node in ('reference_generator', 'oscillation_damper'))]
    try:
        test = subprocess.run(
            [sys.executable, '-c', program, '--arm', arm, '--joints', 'joint2', '--step', '5',
             '--ros-args', '-p', 'use_sim_time:=true'],
            env={**os.environ, 'PYTHONPATH': str(root)}, timeout=PATIENCE, capture_output=True,
            text=True, check=False)
        assert test.returncode == 0, test
        assert 'sign of the gauge is right' in test.stdout and 'the damper is on' in test.stdout
    finally:
        end(nodes)
