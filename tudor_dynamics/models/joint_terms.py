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

"""Rotor inertia, friction and unit of each joint's effort, times their parameters, compiled."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tudor_dynamics.arm.schema import JointSpec
from tudor_dynamics.compiled import compiled
from tudor_dynamics.models.friction import friction_codes, friction_term
from tudor_dynamics.typing import FloatArray


class JointTerms:
    """
    What the joints themselves add to the efforts of the bodies.

    Parameters
    ----------
    joints : sequence of JointSpec
        Joints with their terms.
    columns : sequence of int
        First column of each joint's own parameters: rotor inertia, then friction.
    scale : ndarray of shape (n_joints,)
        Effort per unit in which it is measured.

    """

    def __init__(
        self, joints: Sequence[JointSpec], columns: Sequence[int], scale: FloatArray,
    ) -> None:
        codes = [friction_codes(joint) for joint in joints]
        layout = [[column, joint.rotor_inertia, len(terms)] for joint, column, terms in
                  zip(joints, columns, codes, strict=True)]
        self._terms = (
            np.array(layout, dtype=np.intp), np.concatenate(codes, dtype=np.intp),
            np.array([[joint.friction_velocity, joint.stribeck_velocity] for joint in joints]),
            scale)

    def add(self, motion: FloatArray, parameters: FloatArray, out: FloatArray) -> None:
        """
        Add rotor inertias and friction, and bring the sum to the unit of the measurement.

        Parameters
        ----------
        motion : ndarray of shape (n_samples, 3 n_joints)
            ``[q, dq, ddq]`` of the active joints, in columns [rad, rad/s, rad/s^2 or m, m/s,
            m/s^2].
        parameters : ndarray of shape (n_joints, n_columns)
            Parameters of each channel.
        out : ndarray of shape (n_samples, n_joints)
            Efforts of the bodies [N m or N]; changed in place.

        """
        _add(self._terms, motion, parameters, out)


@compiled
def _add(terms: tuple, motion: FloatArray, parameters: FloatArray, out: FloatArray) -> None:
    layout, codes, speeds, scale = terms
    n = len(layout)
    for k in range(len(motion)):
        code = 0
        for i in range(n):
            column, value, dq = layout[i, 0], out[k, i], motion[k, n + i]
            if layout[i, 1] != 0:
                value += parameters[i, column] * motion[k, 2 * n + i]
                column += 1
            for term in range(layout[i, 2]):
                value += parameters[i, column + term] * friction_term(
                    codes[code + term], dq, speeds[i, 0], speeds[i, 1])
            code += layout[i, 2]
            out[k, i] = value / scale[i]
