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

"""Inertial sensors: rest, a hand calculation, and the motion that positions show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from papers.lshape import l_shape

from tudor_dynamics.arm.description import arm_from_dict, load_arm
from tudor_dynamics.mechanics.mechanism import build_mechanism
from tudor_dynamics.mechanics.plant import Plant
from tudor_dynamics.mechanics.run import InertialSensors, Probe, run_plant


def test_at_rest_it_points_upwards() -> None:
    """A hanging mechanism feels 9.81 m/s^2 against gravity, in the axes of each beam's end."""
    plant = Plant(build_mechanism(l_shape(paper=True)), 1e-3)
    plant.drive('motor', 'hold')
    sensors = InertialSensors(plant.mechanism)
    assert sensors.names == ('motor', 'tip')
    felt = sensors.read(plant, Probe(plant).observe().acceleration)
    up = -plant.mechanism.gravity
    for axes, force, turning in zip(*(
            felt[f'sensor_{what}'] for what in ('axes', 'acceleration', 'turning')), strict=True):
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(axes @ force, up, atol=1e-6)
        np.testing.assert_allclose(turning, 0.0, atol=1e-12)


def test_a_payload_is_at_the_end_of_the_last_beam(root: Path) -> None:
    """One sensor there, named tip; a rigid link has none."""
    assert InertialSensors(build_mechanism(load_arm(
        root / 'config' / 'single_flexible_link.yaml'))).names == ('tip',)
    assert InertialSensors(build_mechanism(load_arm(
        root / 'config' / 'elastic_arm.yaml'))).names == ('joint2', 'tip')


def test_a_rigid_arm_that_turns() -> None:
    """At 3 rad/s, 0.4 m from the axis: 3.6 m/s^2 inwards."""
    arm = arm_from_dict({
        'name': 'bar', 'kinematics': {'dh': [[0.4, 0.0, 0.0, 0.0]]}, 'gravity': [0.0, 0.0, 0.0],
        'joints': [{'name': 'a'}], 'links': [
            {'joint': 'a', 'rigid': {'mass': 1.0, 'center': [0.2, 0, 0], 'inertia': 0.01}}]},
        base=Path(), source='bar')
    plant = Plant(build_mechanism(arm), 1e-3)
    plant.reset([0.7], [3.0])
    felt = InertialSensors(plant.mechanism).read(plant, Probe(plant).observe().acceleration)
    np.testing.assert_allclose(felt['sensor_acceleration'], [[-3.6, 0.0, 0.0]], atol=1e-9)
    np.testing.assert_allclose(felt['sensor_turning'], [[0.0, 0.0, 3.0]], atol=1e-12)


def test_it_feels_what_positions_show() -> None:
    """Second differences of positions, and differences of axes, along a run of the L."""
    plant = Plant(build_mechanism(l_shape(paper=True)), 1e-4)
    torque = np.zeros((5001, 2))
    torque[:, 0] = 1.0
    force = np.zeros((5001, 3))
    force[2000:, 2] = 0.3
    run = run_plant(plant, Probe(plant), torque, force=force)
    points = [plant.mechanism.point('motor'), plant.mechanism.tip]
    for sensor, point in enumerate(points):
        axes = run.sensor_axes[:, sensor]
        acceleration = np.diff(run.position[:, point], n=2, axis=0) / 1e-8
        felt = np.einsum('nij,nj->ni', axes, run.sensor_acceleration[:, sensor])
        felt = felt[1:-1] + plant.mechanism.gravity
        away = [k for k in range(len(felt)) if not (k < 50 or 1980 < k < 2060)]
        scale = np.abs(acceleration[away]).max()
        assert np.abs(felt - acceleration)[away].max() < 0.02 * scale
        turned = np.einsum('nji,njk->nik', axes[:-1], axes[1:])
        rate = np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]], axis=1) / 1e-4
        middle = 0.5 * (run.sensor_turning[1:, sensor] + run.sensor_turning[:-1, sensor])
        assert np.abs(rate - middle).max() < 5e-3 * np.abs(middle).max()
        np.testing.assert_allclose(np.linalg.norm(run.orientation(sensor), axis=1), 1.0)
