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

"""Elements of MJCF that all arms are made of."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm import Arm
from tudor_dynamics.exporting.rows import row
from tudor_dynamics.typing import FloatArray


def new_file(arm: Arm, options: dict[str, str] | None = None) -> ElementTree.Element:
    """Begin a file."""
    root = ElementTree.Element('mujoco', model=arm.name)
    ElementTree.SubElement(root, 'compiler', angle='radian', balanceinertia='false')
    ElementTree.SubElement(root, 'option', gravity=row(np.array(arm.spec.gravity)),
                           attrib=options or {})
    return root


def new_body(parent: ElementTree.Element, name: str, place: pin.SE3) -> ElementTree.Element:
    """Put a body into another; place: its frame in that of the parent [m]."""
    return ElementTree.SubElement(parent, 'body', name=name, pos=row(place.translation),
                                  quat=quaternion(place.rotation))


def add_inertial(body: ElementTree.Element, inertia: pin.Inertia) -> None:
    """Give a body its mass."""
    tensor = np.asarray(inertia.inertia)
    # MuJoCo takes the inertia of a point in this form alone, and that of any body in the other
    element = ElementTree.SubElement(body, 'inertial', pos=row(inertia.lever),
                                     mass=repr(float(inertia.mass)))
    if np.any(tensor):
        element.set('fullinertia', row(tensor[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]))
    else:
        element.set('diaginertia', '0 0 0')


def finished(root: ElementTree.Element, joints: Sequence[str]) -> str:
    """Put a motor on each joint, and write the file."""
    motors = ElementTree.SubElement(root, 'actuator')
    for name in joints:
        ElementTree.SubElement(motors, 'motor', name=name, joint=name)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='unicode') + '\n'


def quaternion(rotation: FloatArray) -> str:
    """
    Write a rotation: w, x, y, z.

    rotation (3, 3).
    """
    x, y, z, w = pin.Quaternion(rotation).coeffs()
    return row(np.array([w, x, y, z]))
