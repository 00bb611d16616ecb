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

"""Identified arms in MuJoCo."""

from __future__ import annotations

import numpy as np
import pytest
from robot_making import described_arm, efforts_of, fitted, JOINTS, motion_of, true_model
from tudor_dynamics.models.comparison import full_parameters_of
from tudor_dynamics.show.mjcf import mjcf_of

mujoco = pytest.importorskip('mujoco')
N = len(JOINTS)


@pytest.fixture(scope='module')
def full(tmp_path_factory):
    arm = described_arm(tmp_path_factory.mktemp('arm'))
    return full_parameters_of(arm, fitted(arm))


def test_inverse_dynamics_in_mujoco_are_those_of_the_model(full):
    model = mujoco.MjModel.from_xml_string(mjcf_of(full))
    assert [model.joint(i).name for i in range(model.njnt)] == list(JOINTS)
    friction = [terms['coulomb'] for terms in full.drives.values()]
    assert np.allclose(model.dof_frictionloss, friction, rtol=1e-12)
    # MuJoCo's dry friction is a constraint, which has no inverse: compared without
    model.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(model)
    parameters = full.model.coefficients().copy()
    dry = [name.startswith('coulomb') for name in full.columns]
    parameters[:, dry] = 0.0
    motion = motion_of(5.0, 3)
    wanted = full.model.regressor.outputs(motion, parameters)
    for row, efforts in zip(motion, wanted, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = row[:N], row[N:2 * N], row[2 * N:]
        mujoco.mj_inverse(model, data)
        assert np.allclose(data.qfrc_inverse, efforts, rtol=0.0, atol=1e-6)


def forward(xml, motion, efforts, rate):
    """Let MuJoCo move under recorded efforts, from the first state; give its positions."""
    model = mujoco.MjModel.from_xml_string(xml)
    model.opt.timestep = 1e-3
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = motion[0, :N], motion[0, N:2 * N]
    found = []
    for row in efforts:
        found.append(data.qpos.copy())
        data.ctrl[:] = row
        for _ in range(round(1e3 / rate)):
            mujoco.mj_step(model, data)
    return np.array(found)


def test_what_is_identified_moves_more_like_the_arm_than_what_is_described(full):
    """A second of free motion under the recorded efforts, again and again."""
    arm, rate = full.arm, 100.0
    motion = motion_of(6.0, 5, rate)
    efforts = efforts_of(arm, motion)
    described = full_of_description(full)
    errors = {'identified': [], 'described': []}
    for first in range(0, 500, 100):
        part = slice(first, first + 50)
        for name, xml in (('identified', mjcf_of(full)), ('described', described)):
            moved = forward(xml, motion[part], efforts[part], rate)
            errors[name].append(np.abs(moved - motion[part, :N]).max())
    assert np.mean(errors['identified']) < 0.25 * np.mean(errors['described'])
    assert true_model(arm).nv == N


def full_of_description(full):
    """Give MJCF with the masses as described and the friction that was found."""
    import re
    text = mjcf_of(full)
    masses = iter(list(full.arm.model.inertias)[1:])

    def described(found):
        inertia = next(masses)
        tensor = np.asarray(inertia.inertia)[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]
        return (f'<inertial pos="{" ".join(map(repr, inertia.lever.tolist()))}" '
                f'mass="{inertia.mass}" fullinertia="{" ".join(map(repr, tensor.tolist()))}" />')

    return re.sub(r'<inertial [^>]*/>', described, text)
