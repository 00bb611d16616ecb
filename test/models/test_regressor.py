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

"""Regressor rows against inverse dynamics and against closed forms of the bending moment."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from sample_arms import (
    arm_of, gauge, LENGTH_1, planar_arm, random_inertia, random_states, SIX_ROWS)

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.errors import ArmError
from tudor_dynamics.models.friction import friction_columns
from tudor_dynamics.models.regressor import EffortRegressor, Regressor, StrainRegressor

G = 9.81


def _with_links(model: pin.Model, seed: int = 0) -> pin.Model:
    generator = np.random.default_rng(seed)
    loaded = model.copy()
    for i in range(1, model.njoints):
        loaded.inertias[i] = random_inertia(generator)
    return loaded


def _bodies(model: pin.Model) -> np.ndarray:
    return np.concatenate([model.inertias[i].toDynamicParameters()
                           for i in range(1, model.njoints)])


def _expected(arm: Arm, motion: np.ndarray, full: pin.Model, own: np.ndarray) -> np.ndarray:
    """Inverse dynamics of all joints, the held ones at rest, and the terms of each joint."""
    n = len(arm.active_joints)
    held = {joint.name: joint.hold for joint in arm.spec.joints}
    places = [full.joints[full.getJointId(name)].idx_q for name in arm.active_joints]
    rest = np.array([held[name] for name in list(full.names)[1:]])
    data = full.createData()
    tau = np.empty((len(motion), n))
    for k, row in enumerate(motion):
        q, dq, ddq = rest.copy(), np.zeros(full.nv), np.zeros(full.nv)
        q[places], dq[places], ddq[places] = row[:n], row[n:2 * n], row[2 * n:]
        tau[k] = pin.rnea(full, data, q, dq, ddq)[places]
    begin = 0
    for i, joint in enumerate(arm.joints):
        columns = friction_columns(joint, motion[:, n + i])
        if joint.rotor_inertia:
            columns = np.column_stack([motion[:, 2 * n + i], columns])
        tau[:, i] += columns @ own[begin:begin + columns.shape[1]]
        begin += columns.shape[1]
    return tau


JOINTS: list[dict[str, Any]] = [
    {'name': 'a', 'friction': ['viscous', 'coulomb', 'offset']},
    {'name': 'b', 'asymmetric': True, 'hold': 0.4},
    {'name': 'c', 'rotor_inertia': False, 'hold': -0.7},
    {'name': 'd', 'friction': [], 'rotor_inertia': False},
    {'name': 'e', 'friction': ['stribeck', 'cube_root'], 'hold': 1.1},
    {'name': 'f'}]


@pytest.mark.parametrize(('changes', 'active'), [
    ({}, None),
    ({}, ['e', 'a', 'd']),
    ({'c': {'type': 'prismatic', 'effort': {'unit': 'N'}}}, None),
    ({'a': {'type': 'prismatic', 'effort': {'unit': 'N'}}}, ['b', 'f', 'a']),
])
def test_effort_rows(changes: dict[str, Any], active: list[str] | None) -> None:
    """
    Rows times link parameters are inverse dynamics, rotor inertias and friction.

    Reference: Pinocchio's recursive Newton-Euler algorithm on the whole arm with random links;
    joints that are not active stand where they are held, and active ones come in another order.
    """
    joints = [{**joint, **changes.get(joint['name'], {})} for joint in JOINTS]
    more = {} if active is None else {'active_joints': active}
    arm = arm_of(SIX_ROWS, joints, gravity=[1.0, -3.0, -9.0], **more)
    regressor = EffortRegressor(arm)
    assert regressor.channels == arm.active_joints
    full = _with_links(arm.full_model)
    locked = [full.getJointId(name) for name in list(full.names)[1:]
              if name not in arm.active_joints]
    rest = np.array([joint.get('hold', 0.0) for joint in joints])
    reduced = pin.buildReducedModel(full, locked, rest) if locked else full
    bodies = _bodies(reduced)
    own = np.random.default_rng(1).uniform(0.5, 2.0, len(regressor.columns) - len(bodies))
    motion = random_states(40, len(arm.active_joints), seed=2)
    kept = motion.copy()
    found = regressor.rows(motion) @ np.concatenate([bodies, own])
    expected = _expected(arm, motion, full, own)
    assert np.max(np.abs(found - expected)) < 1e-9 * np.max(np.abs(expected))
    assert np.array_equal(motion, kept)
    parameters = np.random.default_rng(3).normal(size=(found.shape[1], len(regressor.columns)))
    same_as_rows(regressor, motion, parameters)


def same_as_rows(regressor: Regressor, motion: np.ndarray, parameters: np.ndarray) -> None:
    """Check that outputs are rows times parameters, whatever the parameters are."""
    expected = np.einsum('kcp,cp->kc', regressor.rows(motion), parameters)
    found = regressor.outputs(motion, parameters)
    assert np.max(np.abs(found - expected)) < 1e-12 * np.max(np.abs(expected))


def test_rows_into_a_buffer() -> None:
    """Rows written over other rows are the same as fresh ones, scaled channels included."""
    arm = planar_arm([{'name': 'j1', 'effort': {'unit': 'A', 'torque_constant': 4.0}},
                      {'name': 'j2', 'friction': ['viscous', 'offset']}],
                     [gauge('g1', 'j1', 0.1)])
    for regressor in (EffortRegressor(arm), StrainRegressor(arm)):
        buffer = regressor.rows(random_states(9, 2, seed=1))
        motion = random_states(9, 2, seed=2)
        assert np.array_equal(regressor.rows(motion, out=buffer), regressor.rows(motion))


def test_currents() -> None:
    """A known torque constant divides the rows; an unknown one gives a joint its own group."""
    units = [{'unit': 'A', 'torque_constant': 2.5}, {'unit': 'A'}, {'unit': 'N m'}]
    rows = SIX_ROWS[:3]
    joints = [{'name': name, 'effort': unit} for name, unit in zip('abc', units)]
    plain = EffortRegressor(arm_of(rows, [{'name': name} for name in 'abc']))
    scaled = EffortRegressor(arm_of(rows, joints))
    motion = random_states(20, 3)
    assert plain.groups == ((0, 1, 2),)
    assert scaled.groups == ((0, 2), (1,))
    factor = np.array([2.5, 1.0, 1.0])[None, :, None]
    assert np.allclose(scaled.rows(motion) * factor, plain.rows(motion))


GAUGES = [gauge('tip2', 'j2', 0.2), gauge('out1', 'j1', 0.24), gauge('hub1', 'j1', 0.05),
          gauge('hub2', 'j2', 0.04)]


def test_paper_strain_is_the_joint_row() -> None:
    """In the paper's form a gauge's row is that of the joint before it, and an offset."""
    arm = planar_arm(gauges=GAUGES)
    motion = random_states(20, 2)
    regressor = StrainRegressor(arm, 'paper')
    same_as_rows(regressor, motion, np.random.default_rng(5).normal(
        size=(len(GAUGES), len(regressor.columns))))
    strain = regressor.rows(motion)
    effort = EffortRegressor(arm).rows(motion)
    for i, joint in enumerate([1, 0, 0, 1]):
        assert np.allclose(strain[:, i, :-1], effort[:, joint, :20])
    assert np.all(strain[:, :, -1] == 1.0)


def _moment(
    motion: np.ndarray, x_s: float, own: list[tuple[float, float]],
    link_2: list[tuple[float, float]],
) -> np.ndarray:
    """
    Bending moment at x_s on link 1, by hand: masses beyond x_s, then what link 2 does to link 1.

    Its joint moment has the lever of the whole link, its reaction force that of L1 - x_s: the
    coupling column of a rigid arm is split in two.
    """
    q1, q2, v1, v2, a1, a2 = motion.T
    total = sum(m * (c - x_s) * (c * a1 + G * np.cos(q1)) for m, c in own if c > x_s)
    m2 = sum(m for m, _ in link_2)
    first = sum(m * c for m, c in link_2)
    second = sum(m * c * c for m, c in link_2)
    joint_moment = (second * (a1 + a2)
                    + LENGTH_1 * first * (np.cos(q2) * a1 + np.sin(q2) * v1 ** 2)
                    + G * first * np.cos(q1 + q2))
    force = (m2 * (LENGTH_1 * a1 + G * np.cos(q1))
             + first * (np.cos(q2) * (a1 + a2) - np.sin(q2) * (v1 + v2) ** 2))
    return np.asarray(total + joint_moment + (LENGTH_1 - x_s) * force)


def _moment_2(motion: np.ndarray, x_s: float, link_2: list[tuple[float, float]]) -> np.ndarray:
    """Bending moment at x_s on link 2: ZZ'(a1 + a2) + L1 MX'(...) + g MX' cos(q1 + q2)."""
    q1, q2, v1, _, a1, a2 = motion.T
    beyond = [(m, c) for m, c in link_2 if c > x_s]
    mx = sum(m * (c - x_s) for m, c in beyond)
    zz = sum(m * (c - x_s) * c for m, c in beyond)
    return np.asarray(zz * (a1 + a2) + LENGTH_1 * mx * (np.cos(q2) * a1 + np.sin(q2) * v1 ** 2)
                      + G * mx * np.cos(q1 + q2))


def test_exact_strain_is_the_bending_moment() -> None:
    """
    In the exact form a row is the moment of all that is beyond x_s, about x_s.

    Reference: closed forms for point masses on a planar two-link arm, written out above. Two
    gauges on each link, in the description neither sorted by link nor by distance.
    """
    link_1 = [(0.3, 0.02), (0.5, 0.15), (0.7, 0.4)]
    link_2 = [(0.2, 0.03), (0.4, 0.11), (0.6, 0.33)]
    arm = planar_arm(gauges=GAUGES)
    regressor = StrainRegressor(arm)
    assert regressor.channels == ('tip2', 'out1', 'hub1', 'hub2')
    cuts = {'j1': [('j1', 0.0), ('hub1', 0.05), ('out1', 0.24)],
            'j2': [('j2', 0.0), ('hub2', 0.04), ('tip2', 0.2)]}
    values = dict.fromkeys(regressor.columns, 0.0)
    for joint, masses in (('j1', link_1), ('j2', link_2)):
        for mass, c in masses:
            body, at = [(name, x) for name, x in cuts[joint] if x < c][-1]
            values[f'm({body})'] += mass
            values[f'mx({body})'] += mass * (c - at)
            for axis in ('Iyy', 'Izz'):
                values[f'{axis}({body})'] += mass * (c - at) ** 2
    motion = random_states(50, 2)
    same_as_rows(regressor, motion, np.random.default_rng(4).normal(
        size=(len(GAUGES), len(regressor.columns))))
    found = regressor.rows(motion) @ np.array([values[name] for name in regressor.columns])
    expected = np.column_stack([
        _moment_2(motion, 0.2, link_2), _moment(motion, 0.24, link_1, link_2),
        _moment(motion, 0.05, link_1, link_2), _moment_2(motion, 0.04, link_2)])
    assert np.max(np.abs(found - expected)) < 1e-10 * np.max(np.abs(expected))


def test_strain_behind_a_held_joint() -> None:
    """The exact form serves a gauge after a held joint; the paper's cannot and says so."""
    gauges = [gauge('g', 'j2', 0.1)]
    joints = [{'name': 'j1'}, {'name': 'j2', 'hold': 0.0}]
    arm = planar_arm(joints, gauges, active_joints=['j1'])
    whole = planar_arm(joints, gauges)
    with pytest.raises(ArmError, match="which lack 'j2'; use the strain form exact"):
        StrainRegressor(arm, 'paper')
    motion = random_states(10, 1)
    wide = np.zeros((10, 6))
    wide[:, ::2] = motion
    rows, full = StrainRegressor(arm).rows(motion), StrainRegressor(whole).rows(wide)
    own = [f'{p}(g)' for p in ('m', 'mx', 'my', 'Izz')]
    for name in own:
        assert np.allclose(rows[:, 0, StrainRegressor(arm).columns.index(name)],
                           full[:, 0, StrainRegressor(whole).columns.index(name)])


def test_strain_refusals() -> None:
    """An unknown form and an arm without gauges are refused."""
    with pytest.raises(ArmError, match="unknown strain form 'both'; expected paper or exact"):
        StrainRegressor(planar_arm(gauges=GAUGES), 'both')
    with pytest.raises(ArmError, match='sample.yaml: the arm has no gauges'):
        StrainRegressor(planar_arm())
