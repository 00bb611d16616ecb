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

"""Shapes of links: pairs, distances with their slopes, and what is left out."""

from __future__ import annotations

import numpy as np
import pytest

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.limits import SelfCollision
from tudor_dynamics.errors import ArmError

BALL = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'
TETRAHEDRON = """solid x
{}
endsolid x
"""
FACET = 'facet normal 0 0 0\nouter loop\nvertex {}\nvertex {}\nvertex {}\nendloop\nendfacet'


def arm_with(folder, shape=BALL):
    """Describe a chain of three links of 1 m, each with a shape at its beginning."""
    links = ''.join(f'<link name="{name}">{shape}</link>' for name in ('l0', 'l1', 'l2', 'l3'))
    joints = ''.join(
        f'<joint name="j{i}" type="revolute"><parent link="l{i - 1}"/><child link="l{i}"/>'
        f'<origin xyz="{0.0 if i == 1 else 1.0} 0 0"/><axis xyz="0 0 1"/>'
        '<limit lower="-3" upper="3" velocity="1" effort="1"/></joint>' for i in (1, 2, 3))
    (folder / 'arm.urdf').write_text(f'<robot name="a">{links}{joints}</robot>')
    (folder / 'arm.yaml').write_text(
        'name: a\nkinematics: {urdf: arm.urdf}\n'
        'joints: [{name: j1}, {name: j2}, {name: j3}]\n')
    return load_arm(folder / 'arm.yaml')


def tetrahedron(folder):
    """Write a mesh of 0.1 m about the origin."""
    corners = ['0.1 0 0', '-0.1 0.1 0', '-0.1 -0.1 0', '0 0 0.1']
    facets = [FACET.format(*(corners[k] for k in face))
              for face in ((0, 1, 2), (0, 1, 3), (1, 2, 3), (0, 2, 3))]
    (folder / 'meshes').mkdir(parents=True)
    (folder / 'meshes' / 'part.stl').write_text(TETRAHEDRON.format('\n'.join(facets)))


def test_distance_of_balls(tmp_path):
    """Balls at 0 and at the end of two links: the law of cosines, with its derivative."""
    links = SelfCollision(arm_with(tmp_path))
    q = np.array([0.3, 2.0, 0.5])
    near = links.near(q, 10.0)
    found = dict(zip(near.names, near.distance, strict=True))
    assert set(found) == {('l0', 'l2'), ('l0', 'l3'), ('l1', 'l3')}
    reach = np.sqrt(2.0 + 2.0 * np.cos(2.0))
    assert found['l0', 'l3'] == pytest.approx(reach - 0.2, abs=1e-6)
    slope = near.slope[near.names.index(('l0', 'l3'))]
    np.testing.assert_allclose(slope, [0.0, -np.sin(2.0) / reach, 0.0], atol=1e-5)
    folded = links.near(np.array([0.0, 3.1, 0.0]), 0.05)
    assert ('l0', 'l3') in folded.names and folded.distance.min() < 0.0


def test_pairs_that_an_srdf_takes_out(tmp_path):
    """Disabled pairs are not looked at; an SRDF that is none is told."""
    arm = arm_with(tmp_path)
    srdf = tmp_path / 'arm.srdf'
    srdf.write_text('<robot name="a"><disable_collisions link1="l3" link2="l0" reason="x"/>'
                    '</robot>')
    links = SelfCollision(arm, srdf=srdf)
    assert links.pairs == SelfCollision(arm).pairs - 1
    assert ('l0', 'l3') not in links.near(np.zeros(3), 10.0).names
    srdf.write_text('<robot')
    with pytest.raises(ArmError, match='no valid XML'):
        SelfCollision(arm, srdf=srdf)
    with pytest.raises(ArmError, match='cannot be read'):
        SelfCollision(arm, srdf=tmp_path / 'none.srdf')


def test_meshes(tmp_path):
    """Meshes become hulls where they are found; missing ones are named, and nothing fails."""
    shape = '<collision><geometry><mesh filename="package://parts/meshes/part.stl"/></geometry>' \
            '</collision>'
    arm = arm_with(tmp_path, shape)
    without = SelfCollision(arm)
    assert without.pairs == 0 and '4 shapes are left out' in without.note
    assert 'package://parts/meshes/part.stl' in without.note
    tetrahedron(tmp_path / 'found' / 'parts')
    links = SelfCollision(arm, (tmp_path / 'found',))
    near = links.near(np.array([0.0, 0.0, 0.0]), 10.0)
    assert links.pairs == 3 and near.distance.max() == pytest.approx(1.8, abs=1e-6)


def test_a_held_joint_joins_its_links(tmp_path):
    """Links beside a held joint move as one: no pair with each other or with neighbours."""
    arm_with(tmp_path)
    (tmp_path / 'held.yaml').write_text(
        'name: a\nkinematics: {urdf: arm.urdf}\nactive_joints: [j1, j3]\n'
        'joints: [{name: j1}, {name: j2}, {name: j3}]\n')
    links = SelfCollision(load_arm(tmp_path / 'held.yaml'))
    assert links.near(np.zeros(2), 10.0).names == (('l0', 'l3'),)


def test_no_shapes_and_always_overlapping_ones(root, tmp_path):
    """An arm without shapes has no pairs; balls that are too large are left out, and counted."""
    assert 'no shapes' in SelfCollision(load_arm(root / 'config' / 'tudor.yaml')).note
    links = SelfCollision(arm_with(tmp_path, BALL.replace('0.1', '1.5')))
    assert links.pairs == 0 and '3 pairs overlap always' in links.note
