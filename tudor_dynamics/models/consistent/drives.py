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

"""Signs that friction and rotor inertia can have."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tudor_dynamics.typing import FloatArray

_POSITIVE = ('Ia', 'viscous', 'viscous+', 'viscous-', 'coulomb', 'coulomb+')


def signs_of(columns: Sequence[str]) -> FloatArray:
    """
    Give the signs of the parameters of drives: inertia is positive, and friction takes energy.

    Terms that shape friction (Stribeck, cube root, square, load) may take from the others: with
    friction that falls with the speed they have to.

    Parameters
    ----------
    columns : sequence of str
        Names of regressor columns, such as ``coulomb-(joint2)``.

    Returns
    -------
    ndarray of shape (n_columns,)
        1 or -1; 0 where both are possible.

    """
    kinds = [name.split('(')[0] for name in columns]
    # the coefficient of the negative direction is that of a constant, not of its size
    return np.array([1.0 if kind in _POSITIVE else -1.0 if kind == 'coulomb-' else 0.0
                     for kind in kinds])
