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

"""Commands of ``docs/howto/own_arm.md``, word for word: from a bag and a URDF to a monitor."""

from __future__ import annotations

from dataclasses import replace
from importlib import metadata
from pathlib import Path
import re
import shlex
import shutil
import signal

import numpy as np
import pytest

pytest.importorskip('rclpy')

from node_processes import finish, launch  # noqa: E402, I100
from ros_world import joint_message, series, World, world  # noqa: E402, F401
from tudor_dynamics.arm.description import load_arm  # noqa: E402
from tudor_dynamics.bags.reader import read_recording  # noqa: E402
from tudor_dynamics.bags.writer import recording_series, write_bag  # noqa: E402
from tudor_dynamics.cli.main import main  # noqa: E402
from tudor_dynamics.nodes.common.messages import nanoseconds  # noqa: E402

SAMPLES = 160
BATCH = 4


def commands(root: Path) -> list[list[str]]:
    """Read the commands off the page."""
    page = (root / 'docs' / 'howto' / 'own_arm.md').read_text(encoding='utf-8')
    block = re.search(r'^<!-- run by test/test_own_arm.py.*?```sh own\n(.*?)^```', page,
                      re.MULTILINE | re.DOTALL)
    assert block
    return [shlex.split(line) for line in block[1].splitlines()]


def own(root: Path, shared: None, folder: Path) -> None:
    """Take the bag of the reference arm, which this package recorded, without its gauges."""
    arm = load_arm(root / 'config' / 'tudor.yaml')
    recording = read_recording(root / 'bags' / 'tudor_damped' / 'stimulus_01', arm)
    write_bag(folder / 'run1', recording_series(replace(recording, strain=None), arm))
    shutil.copy(root / 'config' / 'tudor.urdf', folder / 'robot.urdf')


def ur10(root: Path, shared: Path, folder: Path) -> None:
    """Take the public recording of a UR10, and the URDF that example-robot-data has of it."""
    try:
        files = metadata.files('example-robot-data') or []
    except metadata.PackageNotFoundError:
        pytest.skip('no URDF of a UR10: pip install --no-deps example-robot-data')
    urdf = next(file for file in files if file.name == 'ur10_robot.urdf')
    shutil.copytree(shared / 'bags' / 'ur10_exciting', folder / 'run1')
    shutil.copy(str(urdf.locate()), folder / 'robot.urdf')


@pytest.mark.parametrize(('source', 'unit', 'joints'), [
    (own, 'A', 2), pytest.param(ur10, 'N m', 6, marks=pytest.mark.shared)])
def test_from_a_bag_to_a_monitor(
    source, unit: str, joints: int, root: Path, tmp_path: Path, world: World,  # noqa: F811
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """No option beyond the names of files; every joint that moves; a verdict; residuals."""
    source(root, request.getfixturevalue('shared_data') if source is ur10 else None, tmp_path)
    monkeypatch.chdir(tmp_path)
    init, fit, monitor = commands(root)
    assert init[0] == fit[0] == 'tudor' and monitor[:3] == ['ros2', 'run', 'tudor_dynamics']
    assert main(init[1:]) == 0
    arm = load_arm('arm.yaml')
    assert len(arm.active_joints) == joints
    assert {joint.effort.unit for joint in arm.joints} == {unit}
    # the bag of the reference arm has 12 s to learn from: whatever the verdict, there is one
    assert main(fit[1:]) in ((0,) if source is ur10 else (0, 1))
    assert re.search(
        r'^\S+: (good|usable|do not use): .*prediction',
        capsys.readouterr().out, re.MULTILINE)
    assert (tmp_path / 'model' / 'report.html').is_file()
    watch(world, monitor, tmp_path)


def watch(world: World, words: list[str], folder: Path) -> None:  # noqa: F811
    """Run the monitor as a process, feed it the bag, and look at its residuals."""
    arm = load_arm('arm.yaml')
    recording = read_recording('run1', arm)
    process = launch(words[3], *words[words.index('--ros-args') + 1:], cwd=folder)
    topic = arm.joints[0].effort.topic
    residuals, motions = world.listen('effort_residuals'), world.listen('joint_motion', _motion())

    def answered() -> bool:
        return bool(motions) and nanoseconds(motions[-1].header.stamp) >= stamp

    try:
        world.meet(*dict.fromkeys(('joint_states', topic)))
        for k in range(SAMPLES):
            stamp = int(recording.stamp[k])
            fields = {'position': recording.q[k]}
            if recording.dq is not None:
                fields['velocity'] = recording.dq[k]
            if topic == 'joint_states':
                fields['effort'] = recording.effort[k]
            else:
                world.output(topic).publish(joint_message(
                    stamp, list(arm.active_joints), effort=recording.effort[k]))
            world.output('joint_states').publish(joint_message(
                stamp, list(arm.active_joints), **fields))
            if not motions:  # the first may come before the other side hears, or is heard
                assert k < SAMPLES // 2, 'no answer'
                world.spin(lambda: bool(motions), 1.0)
            elif k % BATCH == BATCH - 1:
                assert world.spin(answered), f'stuck at {k}'
        assert world.spin(lambda: len(residuals) > 20)
        _, values = series(residuals, 'effort')
        assert values.shape[1] == len(arm.active_joints) and np.isfinite(values).all()
        assert np.abs(values).max() < 2 * np.abs(recording.effort).max()
    finally:
        finish(process, signal.SIGINT)


def _motion() -> type:
    from trajectory_msgs.msg import JointTrajectory
    return JointTrajectory
