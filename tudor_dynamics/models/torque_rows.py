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

"""Pinocchio's joint torque regressor, for many samples and for a choice of joints."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
import pinocchio as pin

from tudor_dynamics.typing import FloatArray

# Pinocchio's order of the parameters of a body: mass, first moments, inertia about the joint.
BODY_PARAMETERS = ('m', 'mx', 'my', 'mz', 'Ixx', 'Ixy', 'Iyy', 'Ixz', 'Iyz', 'Izz')


def torque_rows(
    model: pin.Model,
    data: pin.Data,
    index: NDArray[np.intp],
    motion: FloatArray,
    out: FloatArray,
) -> None:
    """
    Fill rows of Pinocchio's joint torque regressor, sample by sample.

    Parameters
    ----------
    model, data : pinocchio.Model, pinocchio.Data
        Arm, and room for Pinocchio's work on it.
    index : ndarray of int, shape (n_rows,)
        Rows that are wanted, in the model's velocity vector.
    motion : ndarray of shape (3, n_samples, model.nv)
        Positions, velocities, accelerations in the model's order
        [rad, rad/s, rad/s^2 or m, m/s, m/s^2].
    out : ndarray of shape (n_samples, n_rows, 10 n_bodies)
        Filled in place.

    """
    q, dq, ddq = motion
    function = pin.computeJointTorqueRegressor
    if np.array_equal(index, np.arange(model.nv)):
        for k, state in enumerate(zip(q, dq, ddq, strict=True)):
            out[k] = function(model, data, *state)
    else:
        for k, state in enumerate(zip(q, dq, ddq, strict=True)):
            out[k] = function(model, data, *state)[index]


def in_model_order(
    motion: FloatArray, index: NDArray[np.intp], n_velocities: int,
) -> FloatArray:
    """
    Spread the active joints' motion over a model's coordinates; the others stay at zero.

    Parameters
    ----------
    motion : ndarray of shape (n_samples, 3 n_joints)
        ``[q, dq, ddq]`` of the active joints.
    index : ndarray of int, shape (n_joints,)
        Place of each active joint in the model.
    n_velocities : int
        Size of the model.

    Returns
    -------
    ndarray of shape (3, n_samples, n_velocities)
        Positions, velocities, accelerations.

    """
    n = len(index)
    full = np.zeros((3, len(motion), n_velocities))
    for i in range(3):
        full[i][:, index] = motion[:, i * n:(i + 1) * n]
    return full
