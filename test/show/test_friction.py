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

"""Friction brought to two numbers."""

from __future__ import annotations

import numpy as np
import pytest
from sample_arms import arm_of
from tudor_dynamics.models.friction import friction_columns
from tudor_dynamics.show.description import both_ways, simple_friction


def joint_of(**keys):
    return arm_of([[0.3, 0.0, 0.0, 0.0]], [{'name': 'j', **keys}]).joints[0]


def test_what_two_numbers_can_say_they_say_exactly():
    simple = simple_friction(joint_of(), {'Ia': 1.0, 'viscous': 2.0, 'coulomb': 0.7}, 3.0)
    assert (simple.damping, simple.friction) == pytest.approx((2.0, 0.7), rel=1e-12)
    assert simple.left_out == ()


def test_directions_get_their_means_and_terms_without_a_place_are_named():
    joint = joint_of(asymmetric=True, friction=['viscous', 'coulomb', 'offset'])
    simple = simple_friction(joint, {'viscous+': 2.0, 'viscous-': 4.0, 'coulomb+': 1.0,
                                     'coulomb-': -3.0, 'offset': 0.5}, 2.0)
    assert (simple.damping, simple.friction) == pytest.approx((3.0, 2.0), rel=1e-12)
    assert simple.left_out[0] == 'offset'
    assert simple.left_out[1].endswith('% of the rest')


def test_other_terms_go_into_the_two_as_far_as_they_can():
    """A cube root over the speeds of a joint is mostly Coulomb friction."""
    joint = joint_of(friction=['viscous', 'cube_root'])
    simple = simple_friction(joint, {'viscous': 0.5, 'cube_root': 4.0}, 1.5)
    assert simple.friction > 1.5
    speed = np.linspace(0.2, 1.5, 30)
    wanted = friction_columns(joint, speed) @ [0.5, 4.0]
    assert np.allclose(simple.damping * speed + simple.friction, wanted, rtol=0.1)


def test_friction_that_grows_with_the_load_counts_by_what_the_joint_carries():
    joint = joint_of(friction=['viscous', 'coulomb', 'load'])
    simple = simple_friction(joint, {'viscous': 2.0, 'coulomb': 0.5, 'load': 0.1}, 2.0, load=8.0)
    assert (simple.damping, simple.friction) == pytest.approx((2.0, 0.5 + 0.8))
    assert simple.left_out == ('load, but for its mean',)


def test_friction_that_falls_with_the_speed_is_never_a_drive():
    simple = simple_friction(joint_of(), {'viscous': -0.2, 'coulomb': 1.0}, 2.0)
    assert simple.damping == 0.0
    assert 0.6 < simple.friction < 1.0


def test_each_direction_is_positive_where_it_takes_energy():
    assert both_ways({'coulomb+': 1.0, 'coulomb-': -3.0}, 'coulomb') == (1.0, 3.0)
    assert both_ways({'viscous': 2.0}, 'viscous') == (2.0, 2.0)
    assert both_ways({}, 'viscous') == (0.0, 0.0)
