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

"""Identified parameters as tables."""

from __future__ import annotations

import csv
import io

import pytest
from robot_making import described_arm, fitted, JOINTS
from tudor_dynamics.models.comparison import full_parameters_of
from tudor_dynamics.show.description import csv_of, yaml_of
import yaml


@pytest.mark.parametrize('currents', [False, True])
def test_a_controller_finds_every_joint(tmp_path, currents):
    arm = described_arm(tmp_path, currents=currents)
    full = full_parameters_of(arm, fitted(arm, seconds=30.0))
    text = yaml_of(full)
    found = yaml.safe_load(text)['tudor_dynamics_drives']['ros__parameters']
    assert found['joints'] == list(JOINTS)
    for name in JOINTS:
        joint = found[name]
        assert joint['effort_unit'] == ('A' if currents else 'N m')
        assert joint['torque_constant'] == pytest.approx(full.torque_constants[name])
        assert joint['friction_terms']['viscous'] == pytest.approx(joint['viscous_friction'])
        assert joint['viscous_friction'] > 0.0
    gains = yaml.safe_load(text)['joint_trajectory_controller']['ros__parameters']['gains']
    assert gains == {name: {'ff_velocity_scale': found[name]['viscous_friction']}
                     for name in JOINTS}
    assert ('Torque constants are not known' in text) == currents


def test_every_parameter_has_a_line(tmp_path):
    arm = described_arm(tmp_path)
    full = full_parameters_of(arm, fitted(arm, seconds=30.0))
    rows = list(csv.DictReader(io.StringIO(csv_of(full))))
    assert [row['parameter'] for row in rows] == list(full.columns)
    by_name = {row['parameter']: row for row in rows}
    assert by_name['m(turn)']['source'] == 'description'
    assert float(by_name['m(turn)']['described']) == pytest.approx(6.0)
    assert by_name['m(lift)']['unit'] == 'kg'
    assert by_name['viscous(roll)']['unit'] == 'N m s/rad'
    assert by_name['viscous(roll)']['described'] == ''
