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

"""What the search for elastic parameters is given: stretches of recordings, and what is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tudor_dynamics.errors import FitError
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.signals import Stretch
from tudor_dynamics.typing import FloatArray

RUN_IN = 6.0
"""Left out where a stretch begins in motion whose past is unknown [s]."""
SETTLE = 0.5
"""Left out at the beginning of each stretch [s]."""
STILL = 0.02
"""Speed below which a stretch begins at rest [rad/s or m/s]."""
LEAST_SECONDS = 8.0
"""Strain below which nothing can be said of oscillations [s]."""


@dataclass(frozen=True, eq=False)
class Record:
    """A gapless stretch to compare with."""

    q: FloatArray  # measured positions, (samples, joints) [rad or m]
    dt: FloatArray  # time since the sample before, (samples,) [s]
    strain: FloatArray  # readings in their units, (samples, gauges)
    skip: int = 0  # samples at the beginning that do not count
    payload: float | None = None  # mass at the tip [kg]; None where it is among the parameters
    before: FloatArray | None = None  # `[dt, q]` of the motion just before, (earlier, 1 + joints)

    @property
    def times(self) -> FloatArray:
        """Time since the sample before; 0 at the first where nothing was before it [s]."""
        dt = np.array(self.dt, dtype=float)
        if self.before is None or not len(self.before):
            dt[0] = 0.0
        return dt

    def with_payload(self, values: dict[str, float]) -> dict[str, float]:
        """Give these parameters with the payload of this record where it is known."""
        return values if self.payload is None else {**values, 'payload': self.payload}

    def head(self, seconds: float) -> Record:
        """Take the first seconds of the record."""
        n = int(np.searchsorted(np.cumsum(self.dt[1:]), seconds)) + 1
        return Record(self.q[:n], self.dt[:n], self.strain[:n], min(self.skip, n // 2),
                      self.payload, self.before)

    def thinned(self, dt: float) -> Record:
        """Leave out samples, for coarse steps: dt [s]."""
        stride = int(dt / float(np.median(self.dt[1:])) + 0.5) if len(self.dt) > 1 else 1
        if stride < 2:
            return self
        passed = np.cumsum(self.dt)[::stride]
        return Record(self.q[::stride], np.diff(passed, prepend=passed[0] - self.dt[0]),
                      self.strain[::stride], -(-self.skip // stride), self.payload, self.before)


@dataclass(frozen=True, eq=False)
class Knowledge:
    """What is known of the parameters before any recording."""

    start: dict[str, float] = field(default_factory=dict)  # starting values by parameter
    width: dict[str, float] = field(default_factory=dict)  # standard deviation of their logarithms

    @property
    def names(self) -> tuple[str, ...]:
        """Name the parameters to be searched."""
        return tuple(self.start)

    @property
    def center(self) -> FloatArray:
        """Give the logarithms of the starting values, shape (n_names,)."""
        return np.log([self.start[name] for name in self.names])

    @property
    def width_of(self) -> FloatArray:
        """Give the standard deviations of the logarithms, shape (n_names,)."""
        return np.array([self.width[name] for name in self.names])

    def without(self, kind: str) -> Knowledge:
        """Leave a parameter out of the search."""
        return Knowledge({k: v for k, v in self.start.items() if k != kind},
                         {k: v for k, v in self.width.items() if k != kind})


def record_of(stretch: Stretch, payload: float | None) -> Record | None:
    """
    Take from a stretch what the search compares with.

    payload [kg]; returns None where it is too short.
    """
    if stretch.strain is None:
        return None
    t = stretch.t - stretch.t[0]
    # standstill before the motion shows how the links hang, and is left out of figures alone
    skip = min(int(stretch.decimation.keep[0]), int(np.searchsorted(t, SETTLE)))
    moving = float(np.abs(stretch.states.dq[t < 0.3]).max()) > STILL
    if moving and stretch.before is None:
        skip = max(skip, int(np.searchsorted(t, RUN_IN)))
    if skip >= len(t) or t[-1] - t[skip] < LEAST_SECONDS:
        return None
    return Record(stretch.states.q, stretch.dt, stretch.strain, skip, payload, stretch.before)


def records_of(bags: Sequence[BagData]) -> list[Record]:
    """Take from bags what the search compares with."""
    records = [record for bag in bags for stretch in bag.stretches
               if (record := record_of(stretch, bag.payload)) is not None]
    if not records:
        names = ', '.join(str(bag.choice) for bag in bags)
        msg = (f'no stretch of {names} has {LEAST_SECONDS:g} s of strain without a gap, which the '
               'elastic model is identified from; record longer, or leave it out of --models')
        if not any(bag.has('strain') for bag in bags):
            msg = (f'no strain in {names}, which the elastic model is identified from; record '
                   'the gauges as well, or leave it out of --models')
        raise FitError(msg)
    return records
