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

"""The driven arm that stands behind an elastic model."""

from __future__ import annotations

from collections.abc import Mapping

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import ModelError, SimulationError
from tudor_dynamics.simulation.driven import DrivenArm


def driven_arm(arm: Arm, values: Mapping[str, float]) -> DrivenArm:
    """
    Build the driven arm of a model.

    Parameters
    ----------
    arm : Arm
        Arm with ``links``.
    values : mapping of str to float
        Physical parameters that differ from the description.

    Returns
    -------
    DrivenArm
        Arm with these parameters.

    Raises
    ------
    ModelError
        If the description cannot be used, or has no such parameter.

    """
    try:
        driven = DrivenArm(arm)
        driven.set_parameters(values)
    except SimulationError as err:
        msg = f'the elastic model cannot be used: {err}'
        raise ModelError(msg) from None
    return driven
