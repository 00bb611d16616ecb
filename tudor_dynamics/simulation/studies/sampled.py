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


"""Torques and forces as a program gives them, numbers, text, functions or arrays, over steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import ArrayLike

from tudor_dynamics.errors import SimulationError
from tudor_dynamics.simulation.studies.torque_input import evaluate_expression
from tudor_dynamics.typing import FloatArray

Drive = ArrayLike | Callable[[float], float]
"""What drives a joint: a constant, an expression, values, or a function of the time."""


def sampled(value: Drive, t: FloatArray, name: str) -> FloatArray:
    """
    Sample a torque, or a component of a force.

    t (samples,) [s]; value: constant, expression in t, function of the time [s], or values at
    ``t`` [N m or N]; returns (samples,) [N m or N].
    """
    if isinstance(value, str):
        return evaluate_expression(value, t)
    # not in the try below: what a function of the user raises is best seen as it is
    given = [value(time) for time in t.tolist()] if callable(value) else value
    try:
        values = np.broadcast_to(np.asarray(given, dtype=float), t.shape)
    except (TypeError, ValueError) as err:
        msg = (f'the {name} is {repr(value)[:60]} ({err}); expected a number, an '
               f'expression in t, a function of the time, or an array of {t.size} values')
        raise SimulationError(msg) from None
    if not np.isfinite(values).all():
        when = t[np.flatnonzero(~np.isfinite(values))[0]]
        msg = f'the {name} is not finite at t = {when:g} s'
        raise SimulationError(msg)
    return values


def sampled_columns(
    what: str, given: Mapping[str, Drive], t: FloatArray, columns: tuple[str, ...],
    allowed: tuple[str, ...],
) -> FloatArray:
    """
    Sample torques of joints or components of a force, as a program gives them.

    given [N m or N], t (samples,) [s]; returns (samples, columns) [N m or N], zero where nothing
    was said.
    """
    result = np.zeros((t.size, len(columns)))
    for name, value in given.items():
        if name not in allowed:
            msg = f'{what} of {name!r}: expected some of {list(allowed)}'
            raise SimulationError(msg)
        result[:, columns.index(name)] = sampled(value, t, f'{what} of {name}')
    return result
