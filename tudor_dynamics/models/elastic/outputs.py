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

"""Outputs of elastic models for one sample at a time, without the arrays many samples need."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tudor_dynamics.errors import NotFittedError
from tudor_dynamics.models.elastic.arm import Response
from tudor_dynamics.models.elastic.fitted import FittedElastic
from tudor_dynamics.models.joint_terms import JointTerms
from tudor_dynamics.typing import FloatArray

LiveOutput = Callable[[Response, FloatArray], FloatArray]
"""Response at one sample and its ``[q, dq, ddq]`` to the outputs, shape (n_channels,)."""


def live_output(model: FittedElastic) -> LiveOutput:
    """Prepare the outputs of a model, the same numbers as ``FittedElastic.outputs`` gives."""
    if model.coefficients_ is None:
        msg = 'the elastic model has no coefficients yet: fit it, or load a bundle'
        raise NotFittedError(msg)
    return (_strain(model.coefficients_) if model.output == 'strain' else
            _effort(model, model.coefficients_))


def _strain(coefficients: tuple[FloatArray, ...]) -> LiveOutput:
    gains, offsets = np.array(coefficients).T.copy()

    def outputs(response: Response, row: FloatArray) -> FloatArray:
        return np.asarray(response.moment[0] * gains + offsets)
    return outputs


def _effort(model: FittedElastic, coefficients: tuple[FloatArray, ...]) -> LiveOutput:
    joints = model.arm.joints
    n = len(joints)
    torque, inertia = np.array([values[:2] for values in coefficients]).T.copy()
    constant = np.array([
        values[-1] if columns[-1] == 'offset' else 0.0
        for values, columns in zip(coefficients, model.columns, strict=True)])
    friction = [values[2:len(values) - (columns[-1] == 'offset')]
                for values, columns in zip(coefficients, model.columns, strict=True)]
    table = np.zeros((n, max(1, *(len(values) for values in friction))))
    for i, values in enumerate(friction):
        table[i, :len(values)] = values
    # the inertia of the rotor is a column of every joint here, and added below
    terms = JointTerms([joint.model_copy(update={'rotor_inertia': False}) for joint in joints],
                       [0] * n, np.ones(n))

    def outputs(response: Response, row: FloatArray) -> FloatArray:
        effort = response.torque[0] * torque + row[2 * n:] * inertia + constant
        terms.add(row[None], table, effort[None])
        return np.asarray(effort)
    return outputs
