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

"""Thresholds learned on the running robot by ``~/calibrate``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
import pytest
from ros_world import feed, series, values_of, World
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.cli.main import build_parser
from tudor_dynamics.cli.why import causes
from tudor_dynamics.nodes.monitor import MonitorNode


@pytest.fixture(scope='module')
def free(root: Path) -> Recording:
    """Half a minute without contact."""
    return read_recording(root / 'bags/two_blade_train_1',
                          load_arm(root / 'config/two_blade_arm.yaml'))


def calibrate(world: World) -> Trigger.Response:
    """Call the service."""
    return world.call(Trigger, 'monitor/calibrate')


def start(world: World, model: Path, **more: object) -> MonitorNode:
    """Start a monitor that hears the sensors."""
    node = world.add(MonitorNode, model=str(model), methods=['strain'],
                     timeout=20.0, calibration_time=30.0, **more)
    world.meet('joint_states', 'link_strains')
    return node


def let_pass(world: World, node: MonitorNode, recording: Recording, **how: object) -> None:
    """Feed a recording in lock-step."""
    before = node.meter.count
    feed(world, recording, lambda: (node.meter.count - before) // 2, **how)
    world.rest(0.1)


def test_free_motion_gives_thresholds_that_find_a_push(
    world: World, model: Path, free: Recording, recording: Recording, tmp_path: Path,
) -> None:
    """Nothing comes in: refused. Half a minute of motion: other thresholds, a push is found."""
    node = start(world, model, event_bags=str(tmp_path))
    answer = calibrate(world)
    assert not answer.success and 'no samples' in answer.message
    let_pass(world, node, free, last=60)
    before = node.watch.stages['strain'].thresholds
    answer = calibrate(world)
    assert answer.success and 'let nothing touch it' in answer.message
    # stamps go on after what was fed
    later = replace(free, stamp=free.stamp + 10**9 * 60)
    let_pass(world, node, later)
    assert world.spin(lambda: node.watch.stages['strain'].thresholds is not before)
    learned = node.watch.stages['strain'].thresholds
    assert learned.seconds == pytest.approx(30.0, abs=1.0)
    said = 'learned by the service /monitor/calibrate'  # on a busy machine losses come first
    world.status('monitor', lambda status: any(
        said in text for text in (status.message, *values_of(status).values())))
    events = world.listen('collision_event', Header)
    thresholds = world.listen('strain_thresholds')
    ratios, residuals = world.listen('strain_ratios'), world.listen('strain_residuals')
    world.meet('joint_states', 'link_strains')

    def push(k: int, messages: dict) -> None:
        if k >= 400:
            messages['link_strains'].position[0] += 400.0
            messages['link_strains'].position[1] += 300.0
    again = replace(recording, stamp=recording.stamp - recording.stamp[0] + later.stamp[-1]
                    + 10**10)
    let_pass(world, node, again, last=440, change=push)
    assert world.spin(lambda: bool(events))
    onset = events[0].stamp.sec * 10**9 + events[0].stamp.nanosec
    assert len(events) == 1 and onset == int(again.stamp[400])
    _, values = series(thresholds, 'position')
    assert (values > 0.0).all() and np.isfinite(values).all()
    stamps, ratio = series(ratios, 'position')
    assert ratio[stamps < onset].max() < 1.0 < ratio[stamps >= onset].max(axis=1)[:5].min()
    assert (ratio[-len(values):] > np.abs(series(residuals, 'position')[1])[-len(values):]
            / values - 1e-9).all()
    assert {message.header.frame_id for message in (*ratios, *residuals)} == {'base'}
    world.end(node)
    (path,) = tmp_path.iterdir()
    (cause,) = causes(build_parser('why').parse_args(['why', str(path)]))
    assert (cause.event.event.onset, cause.same) == (onset, True)  # by thresholds of the service


def test_too_little_motion_is_refused(world: World, model: Path, free: Recording) -> None:
    """Motion with a gap every 0.7 s is too little to learn from: the reason, and no change."""
    node = start(world, model)
    let_pass(world, node, free, last=60)
    before = node.watch.stages['strain'].thresholds
    assert calibrate(world).success
    node._calibration.seconds = 0.5
    broken = replace(free, stamp=free.stamp + 10**9 * (60 + np.arange(len(free.stamp)) // 70))
    let_pass(world, node, broken, last=700)
    assert world.spin(lambda: 'failed' in node._note)
    # until nothing comes any more, what the gaps cost is said with it, as an error
    status = world.status('monitor', lambda status: status.level == DiagnosticStatus.WARN)
    said = f'{status.message} {values_of(status).get("problem 2")}'
    assert 'too little' in said and 'stay in use' in said
    assert node.watch.stages['strain'].thresholds is before
    assert calibrate(world).success  # and may be tried again
    assert node._loader is None
