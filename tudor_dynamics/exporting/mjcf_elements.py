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
    """
    Begin a file.

    Parameters
    ----------
    arm : Arm
        Arm that it is about.
    options : dict of str to str, optional
        What the file asks of the simulation, beside gravity.

    """
    root = ElementTree.Element('mujoco', model=arm.name)
    ElementTree.SubElement(root, 'compiler', angle='radian', balanceinertia='false')
    ElementTree.SubElement(root, 'option', gravity=row(np.array(arm.spec.gravity)),
                           attrib=options or {})
    return root


def new_body(parent: ElementTree.Element, name: str, place: pin.SE3) -> ElementTree.Element:
    """
    Put a body into another.

    Parameters
    ----------
    parent : Element
        Body that carries it, or the world.
    name : str
        What the file calls it.
    place : pinocchio.SE3
        Its frame in that of the parent [m].

    """
    return ElementTree.SubElement(parent, 'body', name=name, pos=row(place.translation),
                                  quat=quaternion(place.rotation))


def add_inertial(body: ElementTree.Element, inertia: pin.Inertia) -> None:
    """
    Give a body its mass.

    Parameters
    ----------
    body : Element
        Body of the file.
    inertia : pinocchio.Inertia
        Mass, centre and inertia in the body's frame.

    """
    tensor = np.asarray(inertia.inertia)
    # MuJoCo takes the inertia of a point in this form alone, and that of any body in the other
    element = ElementTree.SubElement(body, 'inertial', pos=row(inertia.lever),
                                     mass=repr(float(inertia.mass)))
    if np.any(tensor):
        element.set('fullinertia', row(tensor[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]))
    else:
        element.set('diaginertia', '0 0 0')


def finished(root: ElementTree.Element, joints: Sequence[str]) -> str:
    """
    Put a motor on each joint, and write the file.

    Parameters
    ----------
    root : Element
        The whole file.
    joints : sequence of str
        Joints that are driven.

    """
    motors = ElementTree.SubElement(root, 'actuator')
    for name in joints:
        ElementTree.SubElement(motors, 'motor', name=name, joint=name)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='unicode') + '\n'


def quaternion(rotation: FloatArray) -> str:
    """
    Write a rotation: w, x, y, z.

    Parameters
    ----------
    rotation : ndarray of shape (3, 3)
        Axes of the turned frame in columns.

    """
    x, y, z, w = pin.Quaternion(rotation).coeffs()
    return row(np.array([w, x, y, z]))
