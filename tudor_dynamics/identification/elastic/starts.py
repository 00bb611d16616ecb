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
stiffnesses are tried: a scan of one common factor over short pieces. Gear and link behind it are
springs in a row, of which oscillations show the sum; so the scan is done for several ways in which
the two share their compliance. The best of each is improved by stiffness and damping alone.
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
from tudor_dynamics.identification.elastic.result import Start
from tudor_dynamics.models.elastic.parameters import kind_of
from tudor_dynamics.models.elastic.setup import reduced_mechanism
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.typing import FloatArray

FACTORS = np.exp(np.linspace(-0.9, 0.9, 37))
"""Of all stiffnesses, tried one by one: 5 % apart, 2.5 % in frequency."""
STARTS = {None: 3, 0.5: 1, 0.8: 1}
"""By the share of compliance that lies in the gears, first as described: factors to be improved
before one is chosen."""
THIN = 2
"""Of the factors with other shares than described, every so manieth is tried."""
EXCERPT = 60.0
"""Length of what starts are compared on, all pieces together [s]."""
PIECES = 4
STEPS, MORE = 5, 3
"""With which each is improved, and then the best: between a gear and its link a compliance is
shared out slowly."""
CANDIDATES = 2
"""Best starts, of different shares, that are improved further."""
COARSE = 5e-3
"""Inner step while starts are compared [s]."""


@dataclass(frozen=True, eq=False)
class Starts:
    """Where to start."""

    # (names,): logarithms of the best start as described, then of each other share, better ones
    # first.
    best: tuple[FloatArray, ...]
    compared: tuple[Start, ...]  # what was improved and compared
    runs: int  # simulations done in all


def _pieces(records: Sequence[Record]) -> list[Record]:
    """Take the beginnings of a few records, from the liveliest to the calmest."""
    order = sorted(records, key=lambda r: -float(np.std(r.strain)))
    chosen = [order[i] for i in np.unique(np.linspace(0, len(order) - 1, PIECES).astype(int))]
    return [record.head(EXCERPT / len(chosen)).thinned(2.0 * COARSE) for record in chosen]


def _stiff(names: tuple[str, ...]) -> NDArray[np.intp]:
    return np.array([i for i, name in enumerate(names) if kind_of(name).adds < 0], dtype=np.intp)


def shared(
    arm: Arm, names: tuple[str, ...], x: FloatArray, share: float | None,
) -> FloatArray:
    """
    Give gears a share of the compliance that each has together with the link behind it.

    x (names,); share: None to change nothing; returns (names,).
    """
    x = x.copy()
    if share is None:
        return x
    mechanism = reduced_mechanism(arm)
    for joint in mechanism.beams:
        if not {f'gear({joint})', f'bending({joint})'} <= {*names}:
            continue
        gear, bending = names.index(f'gear({joint})'), names.index(f'bending({joint})')
        length = float(mechanism.body_float[mechanism.body_of[joint], at.LENGTH])
        link = length / (3.0 * np.exp(x[bending]))  # slope of a cantilever by moment at its root
        both = link + np.exp(-x[gear])
        x[gear] = -np.log(share * both)
        x[bending] = np.log(length / (3.0 * (1.0 - share) * both))
    return x


def compare_starts(
    arm: Arm, records: Sequence[Record], names: tuple[str, ...], center: FloatArray,
    width: FloatArray, progress: Callable[[str], None],
) -> Starts:
    """Find where to start: center, width (names,)."""
    pieces = _pieces(records)
    scan = Problem(arm, pieces, names, {}, center, width, inner=COARSE)
    some = tuple(name for name in names if kind_of(name).early)
    index = np.array([names.index(name) for name in some], dtype=np.intp)
    starts: list[tuple[Start, FloatArray]] = []
    runs = 0

    def better(x: FloatArray, steps: int) -> float:
        nonlocal runs
        fixed = {name: float(np.exp(v)) for name, v in zip(names, x, strict=True)
                 if name not in some}
        part = Problem(arm, pieces, some, fixed, x[index], width[index], inner=COARSE)
        x[index] = improve(part, x[index], steps)
        runs += part.runs
        return part.fits([x[index]])[0]

    for share, count in STARTS.items():
        progress('elastic model, stiffness')
        peaks = _peaks(scan, shared(arm, names, center, share),
                       FACTORS if share is None else FACTORS[::THIN])
        for factor, x in peaks[:count]:
            progress('elastic model, stiffness and damping')
            starts.append((Start(factor, share, better(x, STEPS)), x))
    if not starts:
        msg = (f'{arm.name}: the elastic model cannot be simulated along these bags with any '
               'stiffness; check links and motors of the arm description')
        raise FitError(msg)
    starts.sort(key=lambda item: -item[0].fit)
    first: dict[float | None, FloatArray] = {}
    for start, x in starts:
        first.setdefault(start.share, x)
    order = sorted(first, key=lambda share: share is not None)
    for share in order[:CANDIDATES]:
        better(first[share], MORE)
    return Starts(tuple(first[share] for share in order), tuple(start for start, _ in starts),
                  runs + scan.runs)


def _peaks(
    scan: Problem, center: FloatArray, factors: FloatArray,
) -> list[tuple[float, FloatArray]]:
    """Give peaks among factors on all stiffnesses, best first, with the parameters they make."""
    stiff = _stiff(scan.names)

    def times(factor: float) -> FloatArray:
        x = center.copy()
        x[stiff] += np.log(factor)
        return x

    values = np.array(scan.fits([times(factor) for factor in factors]))
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    peaks = np.flatnonzero((values >= padded[:-2]) & (values >= padded[2:])
                           & np.isfinite(values))
    return [(float(factors[peak]), times(factors[peak]))
            for peak in peaks[np.argsort(-values[peaks])]]
