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

"""Motors, strain sensors and damper: values of the reference arm, refusal of impossible ones."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from tudor_dynamics.arm.description import arm_from_dict, load_arm
from tudor_dynamics.arm.schema import MotorSpec
from tudor_dynamics.errors import ArmError
import yaml


@pytest.fixture
def content(root: Path) -> Any:
    """Read the reference arm's description."""
    return yaml.safe_load((root / 'config' / 'tudor.yaml').read_text(encoding='utf-8'))


def test_reference_encoder(root: Path) -> None:
    """
    The step of joint 1 is the one found in the public recordings of the arm.

    There q1 takes values that are 2.0138e-5 rad apart: four counts a line, before the gear.
    """
    motors = {motor.joint: motor for motor in load_arm(root / 'config' / 'tudor.yaml').spec.motors}
    assert motors['joint1'].encoder_resolution == pytest.approx(2.0138e-5, rel=1e-4)
    on_joint = motors['joint1'].model_copy(update={'encoder_on': 'joint'})
    assert on_joint.encoder_resolution == pytest.approx(2 * math.pi / 2000)
    assert MotorSpec(joint='a', gear_ratio=2, torque_constant=1).encoder_resolution == 0.0


def test_reference_torque(root: Path) -> None:
    """
    The motors of the reference arm can carry it, and are about as strong as identified.

    11.3 N m/A at joint 2 come from the ratio of gravity torque and gravity current of the public
    recordings; 0.58 kg m^2 from their acceleration current less the links' share. Friction and
    ripple as fitted to them, see the description.
    """
    arm = load_arm(root / 'config' / 'tudor.yaml')
    motors = {motor.joint: motor for motor in arm.spec.motors}
    assert motors['joint2'].joint_torque_constant == pytest.approx(11.3, rel=0.01)
    assert motors['joint2'].reflected_inertia == pytest.approx(0.58, rel=0.01)
    assert motors['joint2'].coulomb == (0.095, 0.079)
    assert motors['joint2'].load_friction == 0.29
    assert motors['joint2'].current_ripple == 0.064
    for motor in motors.values():  # gears lose no more than their efficiency allows
        assert motor.load_friction <= 1 / motor.efficiency - 1
    assert arm.spec.damper is not None
    assert [joint.gauge for joint in arm.spec.damper.joints] == ['link2_hub', 'link3_hub']
    assert {sensor.gauge for sensor in arm.spec.sensors} == set(arm.gauge_names)


def test_drives_are_optional(root: Path, content: Any) -> None:
    """An arm of which nothing of this is known can be described all the same."""
    for part in ('motors', 'sensors', 'damper'):
        del content[part]
    spec = arm_from_dict(content, base=root / 'config', source='tudor.yaml').spec
    assert spec.motors == ()
    assert spec.sensors == ()
    assert spec.damper is None


@pytest.mark.parametrize(('path', 'value', 'parts'), [
    ('motors.0.gear', 156, ['motors[0].gear is an unknown key; correct or remove it']),
    ('motors.0.gear_ratio', 0, ['motors[0].gear_ratio', 'above 0', 'found 0']),
    ('motors.0.torque_constant', -0.1, ['motors[0].torque_constant', 'above 0', '-0.1']),
    ('motors.0.coulomb', -0.1, ['motors[0].coulomb[0]', 'at least 0', '-0.1']),
    ('motors.0.coulomb', [0.1], ['motors[0].coulomb[1]', 'is missing; add it']),
    ('motors.0.viscous', 'thick', ['motors[0].viscous', 'a list', "'thick'"]),
    ('motors.0.backlash', 3.2, ['motors[0].backlash', 'below 3.14159', '3.2']),
    ('motors.0.backlash', -0.1, ['motors[0].backlash', 'at least 0']),
    ('motors.0.load_friction', 1.0, ['motors[0].load_friction', 'below 1', '1.0']),
    ('motors.0.presliding', -1e-3, ['motors[0].presliding', 'at least 0']),
    ('motors.0.current_ripple', -0.1, ['motors[0].current_ripple', 'at least 0']),
    ('motors.0.encoder_lines', 0, ['motors[0].encoder_lines', 'above 0']),
    ('motors.0.encoder_lines', 0.5, ['motors[0].encoder_lines', 'valid integer', '0.5']),
    ('motors.0.encoder_on', 'gear', ['motors[0].encoder_on', "'motor' or 'joint'", "'gear'"]),
    ('motors.0.current_limit', 0, ['motors[0].current_limit', 'above 0']),
    ('motors.0.stiffness', float('inf'), ['motors[0].stiffness', 'finite number', 'inf']),
    ('motors.0.joint', 'elbow', [
        "motors names the joint 'elbow'", 'not among the joints joint1, joint2, joint3']),
    ('motors.0.joint', 'joint2', ["motors: joint 'joint2' has two entries; merge"]),
    ('sensors.0.gain', 0.0, ['sensors[0]', 'measure nothing', 'remove this entry']),
    ('sensors.0.noise', -1.0, ['sensors[0].noise', 'at least 0', '-1.0']),
    ('sensors.0.gauge', 'hub', ["sensors names the gauge 'hub'", 'not among the gauges']),
    ('sensors.0.gauge', 'link3_hub', ["sensors: gauge 'link3_hub' has two entries"]),
    ('damper.joints', [], ['damper.joints', 'at least 1 item']),
    ('damper.joints.0.joint', 'elbow', ["damper names the joint 'elbow'"]),
    ('damper.joints.0.joint', 'joint3', ["damper: joint 'joint3' has two entries"]),
    ('damper.joints.0.gauge', 'hub', ["damper names the gauge 'hub'"]),
    ('damper.joints.0.gain', -1000.0, [
        'damper.joints[0].gain', 'at least 0', '-1000.0']),
    ('damper.joints.0.gain', 2e4, ['damper.joints[0].gain', 'at most 10000', '20000.0']),
    ('damper.position_gain', 0, ['damper.position_gain', 'above 0']),
    ('damper.position_gain', 32.0, ['damper', 'position_gain 32 1/s is above the 31.4 1/s that '
                                    'drives with a velocity_bandwidth of 20 Hz stand']),
    ('damper.full_delay', 1.0, ['damper.full_delay', 'at most 0.05', '1.0']),
    ('damper.drive_timeout', 60.0, ['damper.drive_timeout', 'at most 1', '60.0']),
    ('damper.mean_frequency', 30.0, [
        'damper', 'mean_frequency 30.0 Hz is not below velocity_bandwidth 20.0 Hz']),
    ('damper.rate', 40.0, ['damper', 'rate 40.0 Hz is not above twice', 'increase rate']),
])
def test_mistakes(root: Path, content: Any, path: str, value: Any, parts: list[str]) -> None:
    """Each impossible value is refused with file, key, what was found and what was expected."""
    *parents, last = [int(key) if key.isdigit() else key for key in path.split('.')]
    place = content
    for key in parents:
        place = place[key]
    place[last] = value
    with pytest.raises(ArmError) as caught:
        arm_from_dict(content, base=root / 'config', source='tudor.yaml')
    message = str(caught.value)
    assert message.startswith('tudor.yaml: ')
    for part in parts:
        assert part in message


@pytest.mark.parametrize(('key', 'value', 'other'), [
    ('hub_inertia', 0.1, 'rotor_inertia'), ('joint_stiffness', 100.0, 'stiffness'),
    ('viscous_friction', 0.1, 'viscous')])
def test_a_drive_stands_in_one_place(content: Any, root: Path, key: str, value: float,
                                     other: str) -> None:
    """A value of the drive in links, beside an entry in motors, is refused with its place."""
    content['links'][1][key] = value
    with pytest.raises(ArmError, match=rf"'joint2' has {key}.*give {other} in motors"):
        arm_from_dict(content, base=root / 'config', source='any')


def test_efficiency_counts_once() -> None:
    """Torque after the gear is that of the motor times ratio and efficiency."""
    motor = MotorSpec(joint='a', gear_ratio=100, torque_constant=0.05, efficiency=0.6)
    assert motor.joint_torque_constant == pytest.approx(3.0)
    assert MotorSpec(joint='a', gear_ratio=100, torque_constant=0.05).joint_torque_constant == 5.0
