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
Where the search for the parameters of an elastic arm begins: frequencies first, then damping.

The error of a simulated oscillation has a minimum wherever it is in phase now and then, so several
stiffnesses are tried: a scan of one common factor over short pieces, and the best of them improved
by stiffness and damping alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import FitError
from tudor_dynamics.identification.elastic.descent import improve
from tudor_dynamics.identification.elastic.problem import Problem
from tudor_dynamics.identification.elastic.record import Record
from tudor_dynamics.identification.elastic.result import fit_percent
from tudor_dynamics.models.elastic.parameters import kind_of
from tudor_dynamics.typing import FloatArray

FACTORS = np.exp(np.linspace(-0.9, 0.9, 37))
"""Of all stiffnesses, tried one by one: 5 % apart, 2.5 % in frequency."""
STARTS = 3
"""Of the factors, improved before one is chosen."""
EXCERPT = 60.0
"""Length of what starts are compared on, all pieces together [s]."""
PIECES = 4
COARSE = 5e-3
"""Inner step while starts are compared [s]."""


@dataclass(frozen=True, eq=False)
class Starts:
    """
    Where to start.

    Attributes
    ----------
    x : ndarray of shape (n_names,)
        Logarithms of the best start.
    compared : tuple of (float, float)
        Factors on the stiffness, with the fit that each came to [%].
    runs : int
        Simulations done in all.

    """

    x: FloatArray
    compared: tuple[tuple[float, float], ...]
    runs: int


def _pieces(records: Sequence[Record]) -> list[Record]:
    """Take the beginnings of a few records, from the liveliest to the calmest."""
    order = sorted(records, key=lambda r: -float(np.std(r.strain)))
    chosen = [order[i] for i in np.unique(np.linspace(0, len(order) - 1, PIECES).astype(int))]
    return [record.head(EXCERPT / len(chosen)) for record in chosen]


def _stiff(names: tuple[str, ...]) -> NDArray[np.intp]:
    return np.array([i for i, name in enumerate(names) if kind_of(name).adds < 0], dtype=np.intp)


def compare_starts(
    arm: Arm, records: Sequence[Record], names: tuple[str, ...], center: FloatArray,
    width: FloatArray, progress: Callable[[str], None],
) -> Starts:
    """
    Find where to start.

    Parameters
    ----------
    arm : Arm
        Arm with ``links``.
    records : sequence of Record
        Gapless stretches of the training bags.
    names : tuple of str
        Parameters to be searched.
    center, width : ndarray of shape (n_names,)
        Prior of their logarithms.
    progress : callable
        Told what is done next.

    Returns
    -------
    Starts
        Logarithms of the best start, and what the others came to.

    Raises
    ------
    FitError
        If nothing could be simulated.

    """
    pieces = _pieces(records)
    progress('elastic model, stiffness')
    scan = Problem(arm, pieces, names, {}, center, width, inner=COARSE)
    stiff = _stiff(names)
    found = []
    for factor in FACTORS:
        x = center.copy()
        x[stiff] += np.log(factor)
        moments = scan.moments(x)
        found.append(-np.inf if moments is None else fit_percent(
            scan.errors(moments, x), scan.strain))
    values = np.array(found)
    if not np.isfinite(values).any():
        msg = (f'{arm.name}: the elastic model cannot be simulated along these bags with any '
               'stiffness; check links and motors of the arm description')
        raise FitError(msg)
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    peaks = np.flatnonzero((values >= padded[:-2]) & (values >= padded[2:])
                           & np.isfinite(values))
    peaks = peaks[np.argsort(-values[peaks])][:STARTS]
    some = tuple(name for name in names if kind_of(name).early)
    index = np.array([names.index(name) for name in some], dtype=np.intp)
    best: tuple[float, FloatArray] | None = None
    starts: list[tuple[float, float]] = []
    runs = scan.runs
    for peak in peaks:
        progress('elastic model, stiffness and damping')
        x = center.copy()
        x[stiff] += np.log(FACTORS[peak])
        fixed = {name: float(np.exp(v)) for name, v in zip(names, x, strict=True)
                 if name not in some}
        part = Problem(arm, pieces, some, fixed, x[index], width[index], inner=COARSE)
        x[index] = improve(part, x[index], 8)
        moments = part.moments(x[index])
        runs += part.runs
        reached = -np.inf if moments is None else fit_percent(
            part.errors(moments, x[index]), part.strain)
        starts.append((float(FACTORS[peak]), reached))
        if best is None or reached > best[0]:
            best = reached, x
    assert best is not None
    return Starts(best[1], tuple(starts), runs)
