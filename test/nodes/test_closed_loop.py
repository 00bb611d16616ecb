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

"""The closed loop over topics: each node a process, judged by stamps against one process."""

from __future__ import annotations

from contextlib import suppress
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
from typing import Any

from patience import PATIENCE
import pytest
from tudor_dynamics.cli.main import main

pytest.importorskip('rclpy')


def run(root: Path, model: Path) -> dict[str, Any]:
    """Run all processes and give the figures; none of them is left where they took too long."""
    process = subprocess.Popen(
        [sys.executable, str(root / 'bench/closed_loop_topics.py'), '--arm',
         str(root / 'config/tudor.yaml'), '--model', str(model), '--clock', '--json'],
        env={**os.environ, 'PYTHONPATH': str(root)}, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, start_new_session=True)
    try:
        out, err = process.communicate(timeout=PATIENCE)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 0, err
    return json.loads(out)


@pytest.fixture(scope='module')
def tudor_model(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Model of the simulated arm, learned from damped motion."""
    out, arm = tmp_path_factory.mktemp('loop'), str(root / 'config/tudor.yaml')
    assert main(['record', '--arm', arm, '--payload', '0.2', '--stimuli', '2', '--seconds', '40',
                 '--jobs', '1', '--out', str(out / 'bags')]) == 0
    assert main(['fit', *(str(out / f'bags/stimulus_0{k}') for k in (1, 2)), '--arm', arm,
                 '--models', 'analytical', '--out', str(out / 'model')]) == 0
    return out / 'model'


def test_move_push_and_floor(root: Path, tudor_model: Path) -> None:
    """
    The arm moves and settles as in one process; push and floor are found, and it lets go.

    Simulated time waits for the damper, so that no machine is too busy.
    """
    found = run(root, tudor_model)
    # positions and /clock are two topics: on a busy machine one of them comes later
    assert {said for said in found['damper'] if not said.startswith('stamps on joint_states')} <= {
        'running', 'no joint positions arrive on joint_states, so no commands are sent; start the '
        'driver of the arm', 'the joints are held: no reference yet; start reference_generator'}
    move = found['move']
    assert move['off_goal_deg'] < 0.5  # late samples slow its commands down, on a busy machine
    assert move['stamps']['joint_states']['rate'] == pytest.approx(500.0, rel=1e-3)
    link = move['strain']['link2_hub']
    assert link['offline']['settling'] > 0.2
    assert link['topics']['settling'] == pytest.approx(link['offline']['settling'], abs=0.15)
    assert found['false_events'] == 0
    push, floor = found['push'], found['floor']
    assert push['found'] and push['link'] == 'link3' and 0.0 < push['sure_s'] < 0.1
    assert floor['found'] and 0.0 < floor['sure_s'] < 0.15
    assert 'retreat' in floor['reaction'] and floor['reference_moved_deg'] > 5.0
    assert floor['largest_N'] > 5.0 and floor['at_the_end_N'] < 1.0
    assert set(found['exit_codes'].values()) == {0}
