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

"""Friction columns: formulas, both directions apart, continuity at standstill."""

from __future__ import annotations

import numpy as np
import pytest
from sample_arms import arm_of, random_states, SIX_ROWS

from tudor_dynamics.arm.schema import FRICTION_TERMS, JointSpec, STATE_KEYS
from tudor_dynamics.errors import FitError
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.friction import (
    DAMPING, FIRST_STATE, FRICTION, friction_columns, friction_names, has_constant, TERMS)
from tudor_dynamics.models.regressor import EffortRegressor, PayloadRegressor
from tudor_dynamics.typing import FloatArray

ALL = ('viscous', 'coulomb', 'offset', 'stribeck', 'cube_root', 'square')


def test_formulas() -> None:
    """Far from standstill each column is the textbook's term, signed by the velocity."""
    joint = JointSpec(name='a', friction=ALL, friction_velocity=0.01, stribeck_velocity=0.5)
    assert friction_names(joint) == tuple(f'{term}(a)' for term in ALL)
    for v in (-0.4, 0.3, 8.0):
        sign = np.sign(v)
        expected = [v, sign, 1.0, sign * np.exp(-(v / 0.5) ** 2), np.cbrt(v), sign * v * v]
        assert np.allclose(friction_columns(joint, np.array([v]))[0], expected, rtol=1e-3)


def test_directions_apart() -> None:
    """
    Malzahn et al., Eq. (2) as meant: k_v+, k_v-, k_c+, k_c- act in their own direction alone.

    Printed, k_v+ is a constant, so that two of four columns are equal; these have full rank.
    """
    joint = JointSpec(name='a', asymmetric=True)
    assert friction_names(joint) == ('viscous+(a)', 'viscous-(a)', 'coulomb+(a)', 'coulomb-(a)')
    columns = friction_columns(joint, np.array([-2.0, -0.5, 0.5, 2.0]))
    assert np.allclose(columns, [[0, -2, 0, 1], [0, -0.5, 0, 1], [0.5, 0, 1, 0], [2, 0, 1, 0]])
    assert np.linalg.matrix_rank(columns) == 4


@pytest.mark.parametrize('asymmetric', [False, True])
def test_continuous_at_standstill(asymmetric: bool) -> None:
    """The last bit of an encoder does not throw the friction from one direction to the other."""
    joint = JointSpec(name='a', friction=ALL, asymmetric=asymmetric)
    columns = friction_columns(joint, np.array([-1e-9, 0.0, 1e-9]))
    assert np.all(np.isfinite(columns))
    assert np.max(np.abs(np.diff(columns, axis=0))) < 1e-6


def test_no_friction() -> None:
    """A joint without friction terms has no columns."""
    assert friction_columns(JointSpec(name='a', friction=()), np.zeros(3)).shape == (3, 0)


LOADED = arm_of(SIX_ROWS[:3], [
    {'name': 'a', 'friction': ['viscous', 'load'], 'friction_velocity': 0.2},
    {'name': 'b', 'friction': ['load', 'coulomb'], 'friction_velocity': 0.2},
    {'name': 'c', 'effort': {'unit': 'A', 'torque_constant': 4.0}, 'friction': ['load']}])


def _efforts(motion: FloatArray, truth: FloatArray) -> FloatArray:
    """Bodies, and friction as a part of what they ask for, without the model's own terms."""
    plain = EffortRegressor(arm_of(SIX_ROWS[:3], [{'name': n, 'friction': []} for n in 'abc']))
    bodies = plain.rows(motion) @ truth[:33]
    switch = np.tanh(motion[:, 3:6] / [0.2, 0.2, 0.02])
    effort = bodies + np.abs(plain.rows(motion)[:, :, :30] @ truth[:30]) * switch * truth[33:36]
    effort[:, 0] += truth[36] * motion[:, 3]
    effort[:, 1] += truth[37] * switch[:, 1]
    return np.asarray(effort / [1.0, 1.0, 4.0])


def test_friction_that_grows_with_the_load_is_found() -> None:
    """Its share of what the bodies ask for comes out, for any unit of the effort."""
    motion, other = random_states(800, 3, seed=1), random_states(200, 3, seed=2)
    # rotors without inertia: it cannot be told from that of the bodies, which count as load
    truth = np.concatenate([np.random.default_rng(3).uniform(0.5, 1.5, 30), np.zeros(3),
                            [0.1, 0.25, 0.05, 3.0, 2.0]])
    model = AnalyticalModel(EffortRegressor(LOADED), 3).fit(motion, _efforts(motion, truth))
    group, = model.groups_
    found = dict(zip(group.base.names, group.estimate.parameters))
    assert [found[f'load({n})'] for n in 'abc'] == pytest.approx([0.1, 0.25, 0.05], abs=1e-3)
    expected = _efforts(other, truth)
    assert np.max(np.abs(model.predict(other) - expected)) < 2e-3 * np.max(np.abs(expected))


def test_rows_are_linear_for_given_loads() -> None:
    """Rows by the loads of some parameters, times these parameters, are the efforts."""
    regressor, motion = EffortRegressor(LOADED), random_states(30, 3, seed=1)
    parameters = np.random.default_rng(4).normal(size=(3, len(regressor.columns)))
    regressor.assume(parameters)
    assert np.allclose(np.einsum('kcp,cp->kc', regressor.rows(motion), parameters),
                       regressor.outputs(motion, parameters), rtol=1e-9)


def test_load_and_several_payloads() -> None:
    """A load that hangs on the payload makes no model that is affine in it."""
    with pytest.raises(FitError, match='fit the bags of each load'):
        PayloadRegressor(EffortRegressor(LOADED), LOADED, (0.0, 0.4))


def test_every_term_of_the_description_is_in_the_table() -> None:
    """Each has a column; those with a state have a key, and codes after the others."""
    assert set(TERMS) == set(FRICTION_TERMS)
    for name, term in TERMS.items():
        assert (term.code >= FIRST_STATE) == (name in STATE_KEYS)
        columns = friction_columns(JointSpec(name='a', friction=(name,)), np.array([-0.2, 0.3]))
        power = columns[:, 0] * [-0.2, 0.3]
        assert np.all(power > 0.0) or not term.takes_energy
    assert (DAMPING, FRICTION) == ('viscous', 'coulomb')


def test_a_constant_is_recognized() -> None:
    """An offset, or Coulomb columns each way, make one; not the others."""
    speed = np.array([-3.0, -1.0, 1.0, 2.0])
    for friction, asymmetric in (('offset', False), ('coulomb', True), ('coulomb', False),
                                 ('viscous', True)):
        joint = JointSpec(name='a', friction=(friction,), asymmetric=asymmetric)
        columns = friction_columns(joint, speed)
        ones = columns @ np.linalg.lstsq(columns, np.ones(4), rcond=None)[0]
        assert has_constant(joint) == np.allclose(ones, 1.0)
