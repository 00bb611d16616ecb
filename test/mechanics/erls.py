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
The equations of the paper as they stand: small nodal displacements in the base frame.

Gasparetto et al. (2013), Eqs. (4) to (6), with M_G1, M_G2, M_C1, M_C2, M_C3 in full. Three defects
of the printed Eq. (6) are mended: the second block column carries -M J' (not M J), the state is
[u', q', u, q], and the ERLS is pinned by the displacements of the hub, without which the mass
matrix is singular, since the rigid motion is contained in u. The rigid virtual displacement stores
no elastic energy, so that the second block row has no stiffness.

This is the yardstick for ``equations``, not the simulator: plain numpy, for a chain of beams that
meet at their ends, with point masses at nodes. Its small-displacement assumption takes each force
to act at the undisplaced node; what that costs shows in the energy.
"""

from __future__ import annotations

from mechanics.erls_terms import element_stiffness, shape_products, skew, Terms
import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.errors import SimulationError
from tudor_dynamics.mechanics import chain as at
from tudor_dynamics.mechanics.mechanism import Mechanism
from tudor_dynamics.typing import FloatArray


class RigidLinkSystem:
    """
    Equivalent rigid-link system of a chain of beams.

    Parameters
    ----------
    mechanism : Mechanism
        Chain: each beam starts where the one before ends, first joint at the ground, revolute.

    Raises
    ------
    SimulationError
        If the mechanism is no such chain.

    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        self.beams = [b for b, row in enumerate(mechanism.body_int) if row[at.FLEXIBLE]]
        self.masses: list[tuple[int, float, FloatArray]] = []
        self.first: dict[int, int] = {}
        count = 0
        shared: dict[int, int] = {}
        for b in self.beams:
            ints, floats = mechanism.body_int[b], mechanism.body_float[b]
            meets = (np.allclose(floats[at.JOINT_PLACE:at.JOINT_PLACE + 3], 0.0)
                     and np.allclose(floats[at.BODY_PLACE:at.BODY_PLACE + 3], 0.0))
            parent = int(ints[at.PARENT])
            ends = parent < 0 or ints[at.NODE] == mechanism.body_int[parent, at.ELEMENTS]
            if not meets or not ends or ints[at.JOINT] != at.REVOLUTE or ints[at.SPRING] >= 0:
                msg = (f'{mechanism.name}: the equations of the paper are here for beams that '
                       'meet at their ends, on stiff revolute joints')
                raise SimulationError(msg)
            self.first[b] = count
            if parent >= 0:
                shared[count] = self.first[parent] + int(ints[at.NODE])
            count += int(ints[at.ELEMENTS]) + 1
        for b, row in enumerate(mechanism.body_int):
            if not row[at.FLEXIBLE]:
                node = self.first[int(row[at.PARENT])] + max(int(row[at.NODE]), 0)
                floats = mechanism.body_float[b]
                self.masses.append((node, float(floats[at.MASS]),
                                    floats[at.INERTIA:at.INERTIA + 3].copy()))
        # Each beam has nodes of its own, as the rigid links turn against each other where they
        # meet; the nodal displacements u are shared there. u_beams = P u.
        own = [node for node in range(count) if node not in shared]
        self.split = 6 * count
        self.size = 6 * len(own)
        self.share = np.zeros((self.split, self.size))
        for node in range(count):
            column = own.index(shared.get(node, node))
            self.share[6 * node:6 * node + 6, 6 * column:6 * column + 6] = np.eye(6)
        self.free = np.arange(6, self.size)  # the hub's six displacements pin the ERLS
        self._products = {b: shape_products(float(mechanism.body_float[b, at.LENGTH]))
                          for b in self.beams}
        self._stiffness = {b: element_stiffness(
            float(mechanism.body_float[b, at.LENGTH]), mechanism.body_float[b])
            for b in self.beams}

    def frames(self, q: FloatArray, dq: FloatArray) -> list[tuple[FloatArray, ...]]:
        """
        Give rotation, origin, angular velocity and its bias (base frame) of each beam.

        Parameters
        ----------
        q : ndarray of shape (n_joints,)
            Positions of the equivalent rigid links [rad].
        dq : ndarray of shape (n_joints,)
            Their rates [rad/s].

        """
        result: list[tuple[FloatArray, ...]] = []
        rotation, origin = np.eye(3), np.zeros(3)
        omega, bias = np.zeros(3), np.zeros(3)
        for number, b in enumerate(self.beams):
            floats = self.mechanism.body_float[b]
            joint = rotation @ floats[at.JOINT_ROTATION:at.JOINT_ROTATION + 9].reshape(3, 3)
            axis = floats[at.AXIS:at.AXIS + 3]
            world_axis = joint @ axis
            angle = q[number]
            turn = (np.eye(3) + np.sin(angle) * skew(axis)
                    + (1.0 - np.cos(angle)) * skew(axis) @ skew(axis))
            bias = bias + np.cross(omega, world_axis) * dq[number]
            omega = omega + world_axis * dq[number]
            rotation = joint @ turn @ floats[at.BODY_ROTATION:at.BODY_ROTATION + 9].reshape(3, 3)
            result.append((rotation, origin, omega, bias, world_axis))
            length = floats[at.LENGTH] * self.mechanism.body_int[b, at.ELEMENTS]
            origin = origin + length * rotation[:, 0]
        return result

    def terms(self, q: FloatArray, dq: FloatArray) -> Terms:
        """
        Assemble Eq. (4) over the mechanism.

        Parameters
        ----------
        q, dq : ndarray of shape (n_joints,)
            Joint positions and velocities of the equivalent rigid links.

        Returns
        -------
        Terms
            Matrices in the base frame.

        """
        n, joints = self.split, len(self.beams)
        mass, stiffness, coriolis, centrifugal, by_mass, by_stiffness = np.zeros((6, n, n))
        angular, jacobian, bias = np.zeros((joints, n, n)), np.zeros((n, joints)), np.zeros(n)
        frames = self.frames(q, dq)
        axes = [frame[4] for frame in frames]
        for number, (b, (rotation, origin, omega, rise, _)) in enumerate(
                zip(self.beams, frames, strict=True)):
            floats, products = self.mechanism.body_float[b], self._products[b]
            length, density = floats[at.LENGTH], floats[at.DENSITY]
            w, dw = skew(rotation.T @ omega), skew(rotation.T @ rise)
            t = np.kron(np.eye(4), rotation.T)
            dt = np.kron(np.eye(4), -w @ rotation.T)
            ddt = np.kron(np.eye(4), (w @ w - dw) @ rotation.T)
            plain = density * np.einsum('aaij->ij', products)
            polar = np.zeros((12, 12))
            polar[np.ix_((3, 9), (3, 9))] = floats[at.POLAR] * length / 6.0 * np.array(
                [[2.0, 1.0], [1.0, 2.0]])

            def turning(matrix: FloatArray, p: FloatArray = products, d: float = density,
                        ) -> FloatArray:
                return d * np.einsum('ab,abij->ij', matrix, p)

            g1, g2 = t.T @ turning(w) @ t, t.T @ plain @ dt
            c1 = t.T @ turning(dw + w @ w) @ t
            c2, c3 = t.T @ turning(w) @ dt, t.T @ plain @ ddt
            k = t.T @ self._stiffness[b] @ t
            m = t.T @ (plain + polar) @ t
            for e in range(int(self.mechanism.body_int[b, at.ELEMENTS])):
                start = 6 * (self.first[b] + e)
                pick = np.ix_(range(start, start + 12), range(start, start + 12))
                mass[pick] += m
                stiffness[pick] += k
                coriolis[pick] += 2.0 * (g1 + g2)
                centrifugal[pick] += c1 + 2.0 * c2 + c3
                by_mass[pick] += floats[at.ALPHA] * m
                by_stiffness[pick] += floats[at.BETA] * k
                for j in range(number + 1):
                    s = skew(rotation.T @ axes[j])
                    angular[j][pick] += t.T @ (
                        turning(s) @ t + plain @ np.kron(np.eye(4), -s @ rotation.T))
            # J and J' q' of the nodes of this beam.
            for node in range(int(self.mechanism.body_int[b, at.ELEMENTS]) + 1):
                row = 6 * (self.first[b] + node)
                place = origin + node * length * rotation[:, 0]
                bias[row:row + 3] = self._path_bias(frames, number, node * length)
                bias[row + 3:row + 6] = rise
                for j in range(number + 1):
                    jacobian[row:row + 3, j] = np.cross(axes[j], place - frames[j][1])
                    jacobian[row + 3:row + 6, j] = axes[j]
        for node, amount, inertia in self.masses:
            entries = np.arange(6 * node, 6 * node + 6)
            mass[entries[:3], entries[:3]] += amount
            mass[entries[3:], entries[3:]] += inertia  # of a part whose axes do not matter
        return Terms(mass, stiffness, coriolis, centrifugal, angular, jacobian, bias, by_mass,
                     by_stiffness)

    def _path_bias(self, frames: list[tuple[FloatArray, ...]], number: int, distance: float,
                   ) -> FloatArray:
        total = np.zeros(3)
        for index in range(number + 1):
            rotation, origin, omega, rise, _ = frames[index]
            end = (frames[index + 1][1] if index < number
                   else origin + distance * rotation[:, 0])
            total += np.cross(rise, end - origin) + np.cross(omega, np.cross(omega, end - origin))
        return total

    def accelerations(
        self, q: FloatArray, dq: FloatArray, u: FloatArray, du: FloatArray, torque: FloatArray,
        held: NDArray[np.bool_] | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """
        Solve Eq. (6) for the accelerations.

        Parameters
        ----------
        q, dq : ndarray of shape (n_joints,)
            Equivalent rigid links.
        u, du : ndarray of shape (size,)
            Nodal displacements in the base frame and their rates; zero at the hub.
        torque : ndarray of shape (n_joints,)
            Torques of the drives [N m].
        held : ndarray of bool, optional
            Joints that do not move.

        Returns
        -------
        tuple of 2 ndarray
            u'' and q''.

        """
        x, free, count, share = self.terms(q, dq), self.free, len(self.beams), self.share
        moving = np.flatnonzero(np.ones(count, bool) if held is None else ~held)
        weight = np.tile(np.concatenate([self.mechanism.gravity, np.zeros(3)]), self.split // 6)
        place, rate = share @ u, share @ du
        inertia = x.mass @ (weight - x.bias) - x.coriolis @ rate - x.centrifugal @ place
        first = share.T @ (inertia - (x.mass_damping + x.stiffness_damping) @ rate
                           - x.stiffness @ place)
        # Joint columns: rigid inertia, and the part of M_C that goes with the acceleration.
        joint = x.mass @ x.jacobian + np.stack([a @ place for a in x.angular], axis=1)
        hub = np.diag(self.mechanism.coordinate[self.mechanism.q_index, at.HUB])
        friction = self.mechanism.coordinate[self.mechanism.q_index, at.DAMPING]
        # delta r = J delta q stores no elastic energy: no K and no beta K in the second row.
        second = x.jacobian.T @ (inertia - x.mass_damping @ rate) + torque - friction * dq
        mass = share.T @ x.mass @ share
        top = np.hstack([mass[np.ix_(free, free)], (share.T @ joint)[free][:, moving]])
        bottom = np.hstack([(x.jacobian.T @ x.mass @ share)[np.ix_(moving, free)],
                            (x.jacobian.T @ joint + hub)[np.ix_(moving, moving)]])
        right = np.concatenate([first[free], second[moving]])
        answer = np.linalg.solve(np.vstack([top, bottom]), right)
        ddu, ddq = np.zeros(self.size), np.zeros(count)
        ddu[free], ddq[moving] = answer[:free.size], answer[free.size:]
        return ddu, ddq

    def energy(self, q: FloatArray, dq: FloatArray, u: FloatArray, du: FloatArray) -> float:
        """
        Give the total energy of the displaced nodes [J].

        Parameters
        ----------
        q : ndarray of shape (n_joints,)
            Positions of the equivalent rigid links [rad].
        dq : ndarray of shape (n_joints,)
            Their rates [rad/s].
        u : ndarray of shape (size,)
            Nodal displacements in the base frame [m, rad].
        du : ndarray of shape (size,)
            Their rates [m/s, rad/s].

        """
        x = self.terms(q, dq)
        velocity = x.jacobian @ dq + self.share @ du
        hub = self.mechanism.coordinate[self.mechanism.q_index, at.HUB]
        frames, place = self.frames(q, dq), np.zeros(self.split)
        for b, (rotation, origin, *_) in zip(self.beams, frames, strict=True):
            for node in range(int(self.mechanism.body_int[b, at.ELEMENTS]) + 1):
                row = 6 * (self.first[b] + node)
                place[row:row + 3] = origin + (
                    node * self.mechanism.body_float[b, at.LENGTH] * rotation[:, 0])
        # The weight acts through the mass matrix; the turned nodes carry none at rest.
        weight = np.tile(np.concatenate([self.mechanism.gravity, np.zeros(3)]), self.split // 6)
        bent = self.share @ u
        return float(0.5 * velocity @ x.mass @ velocity + 0.5 * bent @ x.stiffness @ bent
                     + 0.5 * hub @ dq**2 - weight @ x.mass @ (place + bent))

    def from_links(self, z: FloatArray, q: FloatArray) -> FloatArray:
        """
        Give base-frame displacements of all nodes, to first order.

        Parameters
        ----------
        z : ndarray
            Coordinates of the mechanism, displacements in the frames of the links.
        q : ndarray of shape (n_joints,)
            Positions of the joints [rad].

        Returns
        -------
        ndarray of shape (size,)
            Displacements in the base frame.

        """
        u = np.zeros(self.split)
        frames = self.frames(q, np.zeros(len(self.beams)))
        for b, (rotation, *_) in zip(self.beams, frames, strict=True):
            ints, floats = self.mechanism.body_int[b], self.mechanism.body_float[b]
            base, parent = 6 * self.first[b], int(ints[at.PARENT])
            if parent >= 0:
                node = 6 * (self.first[parent] + int(ints[at.NODE]))
                u[base:base + 6] = u[node:node + 6]
            shift, turn = u[base:base + 3].copy(), u[base + 3:base + 6].copy()
            for node in range(1, int(ints[at.ELEMENTS]) + 1):
                k, row = int(ints[at.FIRST]) + 6 * (node - 1), base + 6 * node
                lever = node * floats[at.LENGTH] * rotation[:, 0]
                u[row:row + 3] = shift + np.cross(turn, lever) + rotation @ z[k:k + 3]
                u[row + 3:row + 6] = turn + rotation @ z[k + 3:k + 6]
        result: FloatArray = np.asarray(np.linalg.lstsq(self.share, u, rcond=None)[0], dtype=float)
        return result
