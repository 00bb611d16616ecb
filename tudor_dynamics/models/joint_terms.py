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
from tudor_dynamics.models.friction import friction_codes, friction_term, LOAD, PRESLIDING
from tudor_dynamics.typing import FloatArray

NOT_KNOWN = np.empty((0, 0))
"""What friction that gives way has done, where nothing is known of it."""


class JointTerms:
    """
    What the drives of the joints add to the efforts of the bodies.

    scale (joints,); speeds (joints, joints): each its own by default; reach (joints, joints): of
    its own by default.
    """

    def __init__(
        self, joints: Sequence[JointSpec], columns: Sequence[int], scale: FloatArray,
        speeds: FloatArray | None = None, reach: FloatArray | None = None,
    ) -> None:
        codes = [friction_codes(joint) for joint in joints]
        first = np.cumsum([0, *(len(terms) for terms in codes)])
        layout = [[column, joint.rotor_inertia, begin, len(terms)] for joint, column, begin, terms
                  in zip(joints, columns, first, codes, strict=False)]
        own = np.eye(len(joints))
        self._terms = (
            np.array(layout, dtype=np.intp), np.concatenate(codes, dtype=np.intp),
            np.array([[joint.friction_velocity, joint.stribeck_velocity] for joint in joints]),
            scale, own if speeds is None else speeds, own if reach is None else reach)

    def add(
        self, motion: FloatArray, parameters: FloatArray, out: FloatArray,
        bent: FloatArray | None = None,
    ) -> None:
        """
        Add rotor inertias and friction, and bring the sum to the unit of the measurement.

        parameters (joints, columns), bent (samples, bristles); motion (samples, 3 joints):
        ``[q, dq, ddq]`` of the active joints, in columns [rad, rad/s, rad/s^2 or m, m/s, m/s^2];
        writes out (samples, joints) [N m or N].
        """
        _add(self._terms, motion, NOT_KNOWN if bent is None else bent, parameters, out)


@compiled
def _add(
    terms: tuple, motion: FloatArray, bent: FloatArray, parameters: FloatArray, out: FloatArray,
) -> None:
    layout, codes, smoothing, scale, speeds, reach = terms
    n = len(layout)
    loads = np.empty(n)
    for k in range(len(motion)):
        for i in range(n):
            loads[i] = abs(out[k, i])
        for drive in range(n):
            dq, ddq = 0.0, 0.0
            for j in range(n):
                dq += speeds[drive, j] * motion[k, n + j]
                ddq += speeds[drive, j] * motion[k, 2 * n + j]
            for i in range(n):
                if reach[i, drive] == 0.0:
                    continue
                column, value, bristle = layout[drive, 0], 0.0, drive
                if layout[drive, 1] != 0:
                    value += parameters[i, column] * ddq
                    column += 1
                for term in range(layout[drive, 3]):
                    code = codes[layout[drive, 2] + term]
                    if code == PRESLIDING and len(bent) > 0:
                        part = parameters[i, column + term] * bent[k, bristle]
                        bristle += n
                    else:
                        part = parameters[i, column + term] * friction_term(
                            code, dq, smoothing[drive, 0], smoothing[drive, 1])
                    value += part * loads[drive] if code == LOAD else part
                out[k, i] += reach[i, drive] * value
        for i in range(n):
            out[k, i] /= scale[i]
