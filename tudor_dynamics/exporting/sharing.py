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

"""
From bodies that move as one to the links of a URDF.

Links that fixed or held joints connect move as one body, of which data show the sum alone. The sum
is reached by moving and scaling their mass as little as possible: one linear map of all of it, the
same for each link (the optimal transport between two distributions of mass). So links keep their
proportions, and each remains a body that can exist.
"""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm import Arm
from tudor_dynamics.models.consistent.bodies import pseudo_inertia
from tudor_dynamics.typing import FloatArray

LEAST = 1e-12
"""Of the largest value of a pseudo-inertia, below which it is that of a point, line or plate."""


def link_inertias(arm: Arm, bodies: Mapping[str, FloatArray]) -> dict[str, pin.Inertia]:
    """Share bodies out among the links of the arm's URDF: bodies (10,)."""
    assert arm.urdf is not None
    described = _described(ElementTree.fromstring(arm.urdf))
    model = arm.model
    found: dict[str, pin.Inertia] = {}
    for joint, parameters in bodies.items():
        index = model.getJointId(joint)
        frames = [frame for frame in model.frames
                  if frame.type == pin.FrameType.BODY and frame.parentJoint == index]
        old = [pseudo_inertia(np.asarray(frame.placement.act(
            described[frame.name]).toDynamicParameters())) for frame in frames]
        new = pseudo_inertia(parameters)
        total = np.sum(old, axis=0)
        total = total + LEAST * np.trace(new) * np.eye(4)
        way = _transport(total, new)
        shares = [way @ part @ way.T for part in old]
        shares[0] = shares[0] + new - np.sum(shares, axis=0)  # rounding, or all where all is new
        for frame, share in zip(frames, shares, strict=True):
            if frame is frames[0] or described[frame.name].mass > 0.0:
                inertia = pin.PseudoInertia.FromMatrix(share).toInertia()
                found[frame.name] = frame.placement.actInv(inertia)
    return found


def _transport(before: FloatArray, after: FloatArray) -> FloatArray:
    """Give the symmetric A with ``A before A = after``."""
    root = _root(before)
    inverse = np.linalg.inv(root)
    return np.asarray(inverse @ _root(root @ after @ root) @ inverse)


def _root(matrix: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def _described(root: ElementTree.Element) -> dict[str, pin.Inertia]:
    """Read the inertia of each link, in the frame of the link."""
    found = {}
    for link in root.iter('link'):
        inertial = link.find('inertial')
        found[str(link.get('name'))] = (pin.Inertia.Zero() if inertial is None
                                        else _inertia(inertial))
    return found


def _numbers(element: ElementTree.Element | None, key: str, n: int) -> FloatArray:
    text = None if element is None else element.get(key)
    return np.zeros(n) if text is None else np.array([float(item) for item in text.split()])


def _inertia(inertial: ElementTree.Element) -> pin.Inertia:
    origin, mass = inertial.find('origin'), inertial.find('mass')
    tensor = inertial.find('inertia')
    values = {key: float(_numbers(tensor, key, 1)[0])
              for key in ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')}
    about = np.array([[values['ixx'], values['ixy'], values['ixz']],
                      [values['ixy'], values['iyy'], values['iyz']],
                      [values['ixz'], values['iyz'], values['izz']]])
    turn = pin.rpy.rpyToMatrix(_numbers(origin, 'rpy', 3))
    return pin.Inertia(float(_numbers(mass, 'value', 1)[0]), _numbers(origin, 'xyz', 3),
                       turn @ about @ turn.T)
