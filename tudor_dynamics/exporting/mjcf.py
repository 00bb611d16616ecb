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

"""Write an identified arm as MJCF, for MuJoCo."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.kinematics import joint_axis
from tudor_dynamics.exporting.rows import row
from tudor_dynamics.exporting.urdf import simple_friction
from tudor_dynamics.models.consistent.full import FullParameters
from tudor_dynamics.typing import FloatArray


def mjcf_of(full: FullParameters) -> str:
    """
    Give the active joints of the arm with their bodies and drives as MJCF.

    Parameters
    ----------
    full : FullParameters
        What was identified.

    Returns
    -------
    str
        Text of the file: one body for each joint, without shapes, and a motor on each joint.

    """
    arm, model = full.arm, full.arm.model
    root = ElementTree.Element('mujoco', model=arm.name)
    ElementTree.SubElement(root, 'compiler', angle='radian', balanceinertia='false')
    ElementTree.SubElement(root, 'option', gravity=row(np.array(arm.spec.gravity)))
    places = [ElementTree.SubElement(root, 'worldbody')]
    drives = full.drives
    for index, parameters in enumerate(full.bodies.values(), start=1):
        name = str(model.names[index])
        place = model.jointPlacements[index]
        body = ElementTree.SubElement(
            places[int(model.parents[index])], 'body', name=f'{name}_link',
            pos=row(place.translation), quat=_quaternion(place.rotation))
        inertia = pin.Inertia.FromDynamicParameters(parameters)
        tensor = np.asarray(inertia.inertia)
        ElementTree.SubElement(
            body, 'inertial', pos=row(inertia.lever), mass=repr(float(inertia.mass)),
            fullinertia=row(tensor[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]))
        simple = simple_friction(drives[name])
        ElementTree.SubElement(
            body, 'joint', name=name, type='slide' if arm.is_prismatic(name) else 'hinge',
            axis=row(joint_axis(model, name)), armature=repr(drives[name].get('Ia', 0.0)),
            damping=repr(simple.damping), frictionloss=repr(simple.friction))
        places.append(body)
    motors = ElementTree.SubElement(root, 'actuator')
    for name in full.arm.active_joints:
        ElementTree.SubElement(motors, 'motor', name=name, joint=name)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='unicode') + '\n'


def _quaternion(rotation: FloatArray) -> str:
    x, y, z, w = pin.Quaternion(rotation).coeffs()
    return row(np.array([w, x, y, z]))
