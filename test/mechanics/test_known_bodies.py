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

"""Rigid bodies whose place is known: their energies say in which frame a link is described."""

from __future__ import annotations

from dataclasses import replace
from math import cos, pi, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tudor_dynamics.arm.description import Arm, arm_from_dict, load_arm
from tudor_dynamics.mechanics.mechanism import build_mechanism
from tudor_dynamics.mechanics.plant import Energy, Plant
from tudor_dynamics.typing import FloatArray

CONFIG = Path(__file__).parents[2] / 'config'
G = 9.81
ROWS = [[0.1, pi / 2, 0.4, 0.2], [0.6, 0.3, 0.05, -0.4], [0.5, -0.2, 0.0, 0.1]]
"""D-H rows of a spatial arm: a, alpha, d, theta offset."""
MASS = (4.0, 1.5, 0.8)
CENTER = ([0.02, 0.01, 0.2], [0.25, 0.03, -0.02], [0.2, 0.0, 0.04])
INERTIA = ([0.06, 0.07, 0.02, 0.003, 0.0, -0.002], [0.01, 0.03, 0.035, 0.0, 0.001, 0.0],
           [0.005, 0.01, 0.011, 0.0, 0.0, 0.001])


def turn(axis: str, angle: float) -> FloatArray:
    """Turn about an axis, as a matrix of four rows."""
    i, j = {'x': (1, 2), 'z': (0, 1)}[axis]
    made = np.eye(4)
    made[i, i] = made[j, j] = cos(angle)
    made[i, j], made[j, i] = -sin(angle), sin(angle)
    return made


def shift(x: float, z: float) -> FloatArray:
    """Move along x and z, as a matrix of four rows."""
    made = np.eye(4)
    made[0, 3], made[2, 3] = x, z
    return made


def joint_frames(q: FloatArray, convention: str) -> list[FloatArray]:
    """Give the frames in which links are described, by the words of the reference."""
    found, frame = [], np.eye(4)
    for (a, alpha, d, theta), value in zip(ROWS, q, strict=True):
        if convention == 'modified':  # the frame of the row
            frame = frame @ turn('x', alpha) @ shift(a, 0.0) @ turn('z', theta + value)
            frame = frame @ shift(0.0, d)
            found.append(frame)
        else:  # on the axis, turned, before d, a and alpha
            frame = frame @ turn('z', theta + value)
            found.append(frame)
            frame = frame @ shift(a, d) @ turn('x', alpha)
    return found


def arm_of_bodies(convention: str) -> Arm:
    """Describe the spatial arm with a known body after each joint."""
    return arm_from_dict({
        'name': 'bodies', 'kinematics': {'dh': ROWS, 'convention': convention},
        'joints': [{'name': f'j{i}'} for i in range(3)],
        'links': [{'joint': f'j{i}', 'rigid': {
            'mass': MASS[i], 'center': CENTER[i], 'inertia': INERTIA[i]}} for i in range(3)]},
        base=Path(), source='bodies.yaml')


def energy_of(arm: Arm, q: Any, dq: Any) -> Energy:
    """Give the energy of an arm as the simulator has it."""
    plant = Plant(build_mechanism(arm), 1e-3)
    plant.reset(q, dq, equilibrium=False)
    return plant.energy()


@pytest.mark.parametrize('convention', ['standard', 'modified'])
def test_energy_of_known_bodies(convention: str) -> None:
    """Weight and motion of bodies that were placed by hand, in either convention."""
    arm, random = arm_of_bodies(convention), np.random.default_rng(0)
    for _ in range(5):
        q, dq, h = random.uniform(-2, 2, 3), random.uniform(-2, 2, 3), 1e-6
        ahead, behind = (joint_frames(q + s * h * dq, convention) for s in (1.0, -1.0))
        weight, kinetic = 0.0, 0.0
        for k, frame in enumerate(joint_frames(q, convention)):
            center = np.array([*CENTER[k], 1.0])
            weight += MASS[k] * G * (frame @ center)[2]
            speed = ((ahead[k] - behind[k]) @ center)[:3] / (2.0 * h)
            spin = frame[:3, :3].T @ (ahead[k] - behind[k])[:3, :3] / (2.0 * h)
            omega = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
            xx, yy, zz, xy, xz, yz = INERTIA[k]
            tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            kinetic += 0.5 * (MASS[k] * speed @ speed + omega @ tensor @ omega)
        found = energy_of(arm, q, dq)
        assert found.gravity == pytest.approx(weight, rel=1e-9)
        assert found.kinetic == pytest.approx(kinetic, rel=1e-6)


@pytest.mark.parametrize(('name', 'mass', 'height', 'about'), [
    ('anthropomorphic.yaml', 4.0, 0.2, 0.01), ('elastic_arm.yaml', 1.5, 0.15, 0.0),
    ('tudor.yaml', 1.5, 0.15, 0.0009)])
def test_columns_of_the_sample_arms(name: str, mass: float, height: float, about: float) -> None:
    """The first link stands on its axis, half-way up: so it weighs, and so it turns."""
    arm = load_arm(CONFIG / name)
    first, *others = arm.spec.links
    assert first.rigid is not None
    light = first.model_copy(update={'rigid': first.rigid.model_copy(
        update={'mass': 0.0, 'inertia': 0.0})})
    without = replace(arm, spec=arm.spec.model_copy(update={'links': (light, *others)}))
    n = len(arm.spec.joints)
    dq = np.zeros(n)
    dq[0] = 1.0
    whole, rest = (energy_of(each, np.zeros(n), dq) for each in (arm, without))
    assert whole.gravity - rest.gravity == pytest.approx(mass * G * height, rel=1e-9)
    assert whole.kinetic - rest.kinetic == pytest.approx(0.5 * about, abs=1e-9)
