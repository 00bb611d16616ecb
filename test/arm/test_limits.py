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

"""What nothing exceeds and what is planned, told apart; from description, URDF and motors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tudor_dynamics.arm.description import Arm, arm_from_dict, load_arm
from tudor_dynamics.arm.limits import hard_limits, planned_limits
from tudor_dynamics.errors import ArmError
import yaml


def changed(root: Path, **joint2: Any) -> Arm:
    """Read the reference arm with another description of joint 2; None takes a key away."""
    content = yaml.safe_load((root / 'config/tudor.yaml').read_text())
    joint = content['joints'][1]
    joint.update(joint2)
    for key in [key for key, value in joint.items() if value is None]:
        del joint[key]
    return arm_from_dict(content, base=root / 'config', source='changed')


def test_reference_arm(root: Path) -> None:
    """The paper's 70 deg/s and 200 deg/s^2 are planned, 120 and 1000 never passed."""
    arm = load_arm(root / 'config/tudor.yaml')
    hard, planned = hard_limits(arm), planned_limits(arm)
    assert np.degrees(hard.lower) == pytest.approx([13.0, -80.0], abs=1e-4)
    assert np.degrees(hard.upper) == pytest.approx([178.0, 80.0], abs=1e-4)
    assert np.degrees(hard.velocity) == pytest.approx([120.0, 120.0], abs=1e-4)
    assert np.degrees(hard.acceleration) == pytest.approx([1000.0, 1000.0], abs=1e-3)
    assert np.degrees(planned.velocity) == pytest.approx([70.0, 70.0], abs=1e-4)
    assert np.degrees(planned.acceleration) == pytest.approx([200.0, 200.0], abs=1e-3)
    room = np.degrees(planned.lower - hard.lower)
    assert room == pytest.approx([70.0**2 / 1000.0] * 2, rel=1e-4)
    assert hard.missing == ()


def test_urdf_and_motor_fill_what_is_missing(root: Path) -> None:
    """Without limits the URDF's count, and what the motor can do; the tighter of two wins."""
    arm = changed(root, limits=None, planned=None)
    hard, planned = hard_limits(arm), planned_limits(arm)
    assert np.degrees(hard.lower[0]) == pytest.approx(13.0, abs=1e-4)
    assert np.degrees(hard.velocity[0]) == pytest.approx(120.0, abs=1e-4)
    # 2.5 A x 0.07 N m/A x 230 x 0.7 over 1.1e-5 kg m^2 x 230^2
    assert hard.acceleration[0] == pytest.approx(2.5 * 0.07 * 0.7 / (1.1e-5 * 230), rel=1e-9)
    assert planned.velocity[0] == pytest.approx(2.0 / 3.0 * hard.velocity[0])
    tight = hard_limits(changed(root, limits={'upper': 9.0, 'velocity': 0.5}, planned=None))
    assert np.degrees(tight.upper[0]) == pytest.approx(178.0, abs=1e-4)
    assert tight.velocity[0] == 0.5


def test_what_is_missing_is_said(root: Path) -> None:
    """A D-H arm without limits has none, and each is named."""
    arm = load_arm(root / 'config/two_blade_arm.yaml')
    content = arm.spec.model_dump(mode='json', exclude_none=True)
    for joint in content['joints']:
        joint.pop('limits', None)
        joint.pop('planned', None)
    hard = hard_limits(arm_from_dict(content, base=root, source='bare'))
    assert not np.isfinite(hard.velocity).any()
    for what in ('position downwards', 'position upwards', 'velocity', 'acceleration'):
        assert f'{arm.active_joints[0]}: no limit of {what}' in hard.missing
    assert not hard.outside(np.full(len(hard.lower), 1e6)).any()


@pytest.mark.parametrize('key, value', [('velocity', 2.2), ('acceleration', 20.0),
                                        ('lower', 0.1), ('upper', 3.2)])
def test_nothing_is_planned_beyond_the_limits(root: Path, key: str, value: float) -> None:
    """Planned motion beyond a limit is refused with both values."""
    planned = {'velocity': 1.0, 'acceleration': 3.0, key: value}
    with pytest.raises(ArmError, match=f'planned.{key}.*limits.{key}'):
        changed(root, planned=planned)


def test_digest_does_not_depend_on_limits(root: Path) -> None:
    """A model goes on fitting an arm whose limits were changed."""
    arm = load_arm(root / 'config/tudor.yaml')
    assert changed(root, limits=None, planned=None).digest == arm.digest
