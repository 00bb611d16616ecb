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
Columns of the arrays in which a mechanism is handed to compiled code.

A body is a link or a rigid part fixed to a node. Its frame stands at the start of its beam, x
along the beam, y along the section's height; a rigid body uses its joint's frame. Coordinates are,
body by body, the joint, the spring of the joint, and the nodes 1..n of the beam with three
displacements and three rotations each, all in the body's frame.
"""

from __future__ import annotations

# body_int[body, ...]
FLEXIBLE = 0  # 1 for a beam, 0 for a rigid body
PARENT = 1  # body that carries it, -1 for the ground
NODE = 2  # node of the parent that carries it; 0 or less: the parent's own frame
JOINT = 3  # kind of joint
Q = 4  # coordinate of the joint, -1 for none
SPRING = 5  # coordinate of the joint's spring, -1 for none
FIRST = 6  # first elastic coordinate
ELEMENTS = 7  # number of elements
POINT = 8  # number of its frame among all nodes of the mechanism; its nodes follow
INTS = 9

WELD, REVOLUTE, PRISMATIC = 0, 1, 2

# body_float[body, ...]
JOINT_ROTATION = 0  # 9: axes of the joint frame (at q = 0) in those of the carrying node
JOINT_PLACE = 9  # 3: its origin from the carrying node [m]
AXIS = 12  # 3: joint axis in the joint frame
BODY_ROTATION = 15  # 9: axes of the body in those of the moved joint frame
BODY_PLACE = 24  # 3: origin of the body in the moved joint frame [m]
MASS = 27  # rigid: mass [kg]
CENTER = 28  # 3: rigid: centre of mass in the body frame [m]
INERTIA = 31  # 6: rigid: xx yy zz xy xz yz about the centre [kg m^2]
LENGTH = 27  # flexible: length of one element [m]
DENSITY = 28  # mass per length [kg/m]
POLAR = 29  # polar inertia per length [kg m]
EA = 30  # [N]
EIY = 31  # bending about y [N m^2]
EIZ = 32  # bending about z [N m^2]
GJ = 33  # torsion [N m^2]
ALPHA = 37  # Rayleigh damping by mass [1/s]
BETA = 38  # Rayleigh damping by stiffness [s]
STRETCH = 39  # 1 where bending shortens the beam and its normal force stiffens it, else 0
FLOATS = 40

# coordinate[index, ...]
HUB = 0  # inertia on the diagonal [kg m^2 or kg]
STIFFNESS = 1  # spring to ground or of the joint [N m/rad or N/m]
DAMPING = 2  # viscous [N m s/rad or N s/m]
COORDINATE_FLOATS = 3

# moving[body, ...]: what the forward pass leaves for the backward pass
TO_PARENT = 0  # 9: axes of the body in the parent's
PLACE = 9  # 3: origin of the body in the parent's frame [m]
JOINT_AT = 12  # 3: joint in the parent's frame [m]
NODE_AT = 15  # 3: carrying node in the parent's frame [m]
AXIS_AT = 18  # 3: joint axis in the parent's axes
JACOBIAN = 21  # 9: left Jacobian of the carrying node's rotation
WORLD = 30  # 9: axes of the body in the base frame
OMEGA = 39  # 3: angular velocity, body axes [rad/s]
ACCELERATION = 42  # 3: of the origin, gravity subtracted, body axes [m/s^2]
ANGULAR = 45  # 3: angular acceleration, body axes [rad/s^2]
FORCE = 48  # 3: force that moves the body and all it carries, body axes [N]
MOMENT = 51  # 3: the same about the body's origin [N m]
ORIGIN = 54  # 3: origin in the base frame [m]
VELOCITY = 57  # 3: of the origin, body axes [m/s]
MOVING = 60
