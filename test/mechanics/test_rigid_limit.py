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

"""Rigid limits: the mechanism against Pinocchio."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from tudor_dynamics.arm.description import arm_from_dict, load_arm
from tudor_dynamics.mechanics import chain as at
from tudor_dynamics.mechanics.mechanism import build_mechanism
from tudor_dynamics.mechanics.plant import Plant
import yaml


def rigid_model(arm, mechanism):
    """Pinocchio model of the same arm with its undeformed links as rigid bodies."""
    model = arm.full_model.copy()
    owner = {body: mechanism.joints.index(name) + 1 for name, body in mechanism.body_of.items()}
    pose = {}
    for body, (ints, floats) in enumerate(
            zip(mechanism.body_int, mechanism.body_float, strict=True)):
        frame = pin.SE3(floats[at.BODY_ROTATION:at.BODY_ROTATION + 9].reshape(3, 3),
                        floats[at.BODY_PLACE:at.BODY_PLACE + 3])
        if body not in owner:  # a part on a node
            parent = int(ints[at.PARENT])
            owner[body] = owner[parent]
            node = np.array([max(ints[at.NODE], 0), 0.0, 0.0])
            if mechanism.body_int[parent, at.FLEXIBLE]:
                node = node * mechanism.body_float[parent, at.LENGTH]
            joint = pin.SE3(floats[at.JOINT_ROTATION:at.JOINT_ROTATION + 9].reshape(3, 3),
                            floats[at.JOINT_PLACE:at.JOINT_PLACE + 3])
            frame = pose[parent] * pin.SE3(np.eye(3), node) * joint * frame
        pose[body] = frame
        if ints[at.FLEXIBLE]:
            length = floats[at.LENGTH] * ints[at.ELEMENTS]
            mass = floats[at.DENSITY] * length
            across = mass * length**2 / 12.0
            inertia = pin.Inertia(mass, np.array([length / 2.0, 0.0, 0.0]), np.diag(
                [floats[at.POLAR] * length, across, across]))
        else:
            xx, yy, zz, xy, xz, yz = floats[at.INERTIA:at.INERTIA + 6]
            inertia = pin.Inertia(floats[at.MASS], floats[at.CENTER:at.CENTER + 3], np.array(
                [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
        model.inertias[owner[body]] += frame.act(inertia)
    return model


def hub_inertia(mechanism):
    """Inertia of motors and hubs, added by hand: Pinocchio's armature moved between versions."""
    return mechanism.coordinate[mechanism.q_index, at.HUB]


@pytest.mark.parametrize('name', ['l_shape', 'anthropomorphic', 'elastic_arm'])
def test_rigid_terms_are_those_of_pinocchio(root, name):
    """Without deformation the joint rows are Pinocchio's inverse dynamics."""
    arm = load_arm(root / 'config' / f'{name}.yaml')
    mechanism = build_mechanism(arm)
    plant = Plant(mechanism, 5e-4)
    model = rigid_model(arm, mechanism)
    generator = np.random.default_rng(0)
    q, dq, ddq = generator.normal(size=(3, model.nv))
    z, dz, ddz = np.zeros((3, mechanism.size))
    z[mechanism.q_index], dz[mechanism.q_index], ddz[mechanism.q_index] = q, dq, ddq
    data = model.createData()
    expected = pin.rnea(model, data, q, dq, ddq) + hub_inertia(mechanism) * ddq
    found = plant.imbalance(z, dz, ddz)[mechanism.q_index]
    damping = mechanism.coordinate[mechanism.q_index, at.DAMPING] * dq
    assert np.allclose(found - damping, expected, rtol=1e-9, atol=1e-9)


def test_stiff_links_move_as_pinocchio_says(root):
    """With E a thousand times higher the joints move as those of the rigid arm, to 0.1 %."""
    content = yaml.safe_load((root / 'config' / 'anthropomorphic.yaml').read_text())
    for link in content['links']:
        if 'flexible' in link:
            link['flexible']['material']['E'] *= 1000.0
    content['simulation']['rayleigh'] = {'alpha': 0.0, 'beta': 0.0}
    arm = arm_from_dict(content, base=Path('.'), source='stiff')
    mechanism = build_mechanism(arm)
    dt, steps = 1e-3, 1000
    plant = Plant(mechanism, dt)
    model = rigid_model(arm, mechanism)
    data = model.createData()
    hub = np.diag(hub_inertia(mechanism))

    def acceleration(q, dq, t):
        torque = np.array([0.8 * np.sin(5 * t), 6.0 * np.cos(3 * t), 1.0])
        mass = pin.crba(model, data, q).copy()
        mass = np.triu(mass) + np.triu(mass, 1).T
        return np.linalg.solve(mass + hub, torque - pin.rnea(model, data, q, dq, 0 * q))

    q, dq = plant.state.q.copy(), np.zeros(3)
    path = [q.copy()]
    for k in range(steps):  # Runge and Kutta, four stages
        t = k * dt
        k1 = acceleration(q, dq, t)
        k2 = acceleration(q + dt / 2 * dq, dq + dt / 2 * k1, t + dt / 2)
        k3 = acceleration(q + dt / 2 * dq + dt**2 / 4 * k1, dq + dt / 2 * k2, t + dt / 2)
        k4 = acceleration(q + dt * dq + dt**2 / 2 * k2, dq + dt * k3, t + dt)
        q, dq = (q + dt * dq + dt**2 / 6 * (k1 + k2 + k3), dq + dt / 6 * (
            k1 + 2 * k2 + 2 * k3 + k4))
        path.append(q.copy())
    plant.start_torque([0.0, 6.0, 1.0])
    found = [plant.state.q.copy()]
    for k in range(1, steps + 1):
        t = k * dt
        found.append(plant.step(
            [0.8 * np.sin(5 * t), 6.0 * np.cos(3 * t), 1.0]).q.copy())
    moved = np.ptp(np.array(path), axis=0)
    error = np.abs(np.array(found) - np.array(path)).max(axis=0) / moved
    assert moved.min() > 0.2
    assert error.max() < 1e-3
