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

from tudor_dynamics.exporting.friction import both_ways, simple_friction


def test_terms_that_have_no_place_are_named():
    simple = simple_friction({'Ia': 1.0, 'viscous+': 2.0, 'viscous-': 4.0, 'coulomb+': 1.0,
                              'coulomb-': -3.0, 'offset': 0.5, 'cube_root': 0.0})
    assert (simple.damping, simple.friction, simple.left_out) == (3.0, 2.0, ('offset',))


def test_each_direction_is_positive_where_it_takes_energy():
    assert both_ways({'coulomb+': 1.0, 'coulomb-': -3.0}, 'coulomb') == (1.0, 3.0)
    assert both_ways({'viscous': 2.0}, 'viscous') == (2.0, 2.0)
    assert both_ways({}, 'viscous') == (0.0, 0.0)


def test_friction_that_would_drive_is_left_out():
    simple = simple_friction({'viscous': -0.2, 'coulomb': 1.0})
    assert (simple.damping, simple.friction, simple.left_out) == (0.0, 1.0, (
        'viscous below zero',))
