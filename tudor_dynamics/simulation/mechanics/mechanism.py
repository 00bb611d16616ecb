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

"""A mechanism: the bodies, nodes and coordinates that compiled code works on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
import pinocchio as pin

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import check_type, SimulationError
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.simulation.mechanics.assembly import Builder
from tudor_dynamics.simulation.mechanics.chain import Chain
from tudor_dynamics.simulation.mechanics.mass import Composite
from tudor_dynamics.simulation.mechanics.section import BeamProperties
from tudor_dynamics.typing import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Mechanism:
    """A mechanism as arrays, see ``layout``; parameters may be changed in place between steps."""

    name: str  # name of the arm
    joints: tuple[str, ...]  # all joints, base first
    driven: NDArray[np.bool_]  # joints that are active in the description; the others are held
    q_index: IntArray  # coordinate of each joint
    body_of: dict[str, int]  # body behind each joint
    beams: dict[str, BeamProperties]  # beam behind each joint that has one
    # Tables for compiled code.
    body_int: IntArray
    body_float: FloatArray
    coordinate: FloatArray
    initial: FloatArray  # coordinates before the elastic state is found, (n,)
    gravity: FloatArray  # gravity in the base frame, (3,) [m/s^2]
    points: int  # number of nodes and rigid bodies
    tip: int  # point at the tip
    start: str  # 'equilibrium' or 'undeformed'

    @property
    def size(self) -> int:
        """Give the number of coordinates."""
        return int(self.coordinate.shape[0])

    @property
    def elastic(self) -> NDArray[np.bool_]:
        """Which coordinates are no joint positions."""
        mask = np.ones(self.size, dtype=bool)
        mask[self.q_index] = False
        return mask

    @cached_property
    def rotations(self) -> IntArray:
        """Coordinates of the rotations of all nodes of beams, shape (n_nodes, 3)."""
        rows = [row[at.FIRST] + 6 * node + np.arange(3, 6) for row in self.body_int
                if row[at.FLEXIBLE] for node in range(int(row[at.ELEMENTS]))]
        return np.array(rows, dtype=np.int64).reshape(-1, 3)

    def chain(self) -> Chain:
        """Make the tables for compiled code: those of the mechanism are shared, others new."""
        bodies = len(self.body_int)
        return Chain(self.body_int, self.body_float, self.coordinate, -self.gravity,
                     np.zeros((self.points, 6)), np.zeros((bodies, at.MOVING)),
                     np.zeros((bodies, 6)))

    def composite(self) -> Composite:
        """Make working memory for the mass matrix."""
        return Composite(np.zeros((self.size, 6)), np.zeros(self.size, dtype=np.int64),
                         np.zeros((len(self.body_int) + 1, 10)))

    @property
    def coordinate_names(self) -> list[str]:
        """Name of each coordinate, for messages and tables."""
        names = [''] * self.size
        bodies = {body: joint for joint, body in self.body_of.items()}
        for body, joint in bodies.items():
            row = self.body_int[body]
            names[row[at.Q]] = joint
            if row[at.SPRING] >= 0:
                names[row[at.SPRING]] = f'spring of {joint}'
            for i in range(6 * int(row[at.ELEMENTS])):
                kind = ('ux', 'uy', 'uz', 'rx', 'ry', 'rz')[i % 6]
                names[row[at.FIRST] + i] = f'{kind} of node {i // 6 + 1} behind {joint}'
        return names

    def point(self, joint: str, node: int = -1) -> int:
        """Give the number of a node behind a joint."""
        row = self.body_int[self.body_of[joint]]
        count = int(row[at.ELEMENTS]) + 1 if row[at.FLEXIBLE] else 1
        return int(row[at.POINT]) + (node + count if node < 0 else node)


def build_mechanism(arm: Arm) -> Mechanism:
    """
    Build the mechanism of an arm description.

    Parameters
    ----------
    arm : Arm
        Description with ``links`` filled in.

    Returns
    -------
    Mechanism
        Tables for compiled code.

    Raises
    ------
    SimulationError
        If a link is missing or has no length, the mechanism has no mass where it can move, or
        its drives are coupled.

    """
    check_type(arm, Arm, 'arm', "read a description with load_arm('arm.yaml')")
    builder = Builder(arm)
    if arm.spec.couplings is not None:
        msg = (f'{arm.source}: couplings are described, and a simulated motor turns with its own '
               'joint alone; leave couplings out of a copy of the description to simulate the '
               'arm as if nothing were coupled')
        raise SimulationError(msg)
    if not arm.spec.links and not any(i.mass > 0 for i in list(arm.full_model.inertias)[1:]):
        msg = (f'{arm.source}: the description has no links; add links: with a rigid or flexible '
               'entry a joint to simulate it')
        raise SimulationError(msg)
    for index in range(1, arm.full_model.njoints):
        builder.link(index)
    tip = builder.tip_frame()
    parent = builder.body_of[arm.full_model.names[tip.parentJoint if tip else -1]]
    place = pin.SE3(tip.placement) if tip else pin.SE3.Identity()
    node, rotation, offset = builder.attach(parent, place)
    if arm.spec.payload is None and node > 0 and np.linalg.norm(offset) < 1e-9:
        tip_point = int(builder.ints[parent][at.POINT]) + node
    else:
        body = builder.rigid_part(parent, place, arm.spec.payload)
        tip_point = int(builder.ints[body][at.POINT])
    joints = tuple(arm.full_model.names)[1:]
    return Mechanism(
        name=arm.name, joints=joints,
        driven=np.array([name in arm.active_joints for name in joints]),
        q_index=np.array(builder.q_index, dtype=np.int64), body_of=builder.body_of,
        beams=builder.beams, body_int=np.array(builder.ints),
        body_float=np.array(builder.floats), coordinate=np.array(builder.coordinates),
        initial=np.array(builder.initial), gravity=np.array(arm.spec.gravity, dtype=float),
        points=builder.points, tip=tip_point, start=arm.spec.simulation.start)
