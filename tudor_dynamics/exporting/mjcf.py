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

import pinocchio as pin

from tudor_dynamics.arm.kinematics import joint_axis
from tudor_dynamics.exporting.friction import simple_frictions
from tudor_dynamics.exporting.mjcf_elements import add_inertial, finished, new_body, new_file
from tudor_dynamics.exporting.rows import row
from tudor_dynamics.models.consistent.full import FullParameters


def mjcf_of(full: FullParameters) -> str:
    """Give the active joints of the arm with their bodies and drives as MJCF."""
    arm, model = full.arm, full.arm.model
    root = new_file(arm)
    places = [ElementTree.SubElement(root, 'worldbody')]
    drives, frictions = full.drives, simple_frictions(full)
    for index, parameters in enumerate(full.bodies.values(), start=1):
        name = str(model.names[index])
        body = new_body(places[int(model.parents[index])], f'{name}_link',
                        model.jointPlacements[index])
        add_inertial(body, pin.Inertia.FromDynamicParameters(parameters))
        simple = frictions[name]
        ElementTree.SubElement(
            body, 'joint', name=name, type='slide' if arm.is_prismatic(name) else 'hinge',
            axis=row(joint_axis(model, name)), armature=repr(drives[name].get('Ia', 0.0)),
            damping=repr(simple.damping), frictionloss=repr(simple.friction))
        places.append(body)
    return finished(root, arm.active_joints)
