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

"""What a bag becomes: aligned arrays of one arm's joints, efforts and strains."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True)
class SetBack:
    """A clock that was set back while it stamped messages."""

    time: float  # where, since the first stamp [s]
    seconds: float  # by how much [s]
    lost: int  # messages with stamps that had been there before


@dataclass(frozen=True)
class Oddities:
    """What the arrays of a recording do not show of its bag."""

    # Where the clock of the joint states was set back; the record is split there.
    set_backs: tuple[SetBack, ...] = ()
    # How far each other name of the joint states moves, its outermost percents left out
    # [rad or m].
    others: dict[str, float] = field(default_factory=dict)
    # Joints that move, but whose velocities are all zero: velocities are not used.
    zero_velocities: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Recording:
    """
    Signals of one bag on the stamps of the joint states.

    Attributes
    ----------
    path : str
        Bag that was read.
    stamp : ndarray of int64, shape (n_samples,)
        Header stamps, strictly increasing [ns].
    q : ndarray of shape (n_samples, n_joints)
        Positions of the arm's active joints, in their order [rad or m].
    dq : ndarray of shape (n_samples, n_joints) or None
        Velocities, where the driver has them [rad/s or m/s].
    effort : ndarray of shape (n_samples, n_joints) or None
        Actuator efforts in the units of the arm description.
    strain : ndarray of shape (n_samples, n_gauges) or None
        Gauge readings in the units of the arm description.
    segments : tuple of slice
        Stretches without a gap; nothing may be filtered or differentiated across their ends.
    dt : float
        Median sample time [s].
    dropped : dict of str to int
        Messages left out, by cause.
    warnings : tuple of str
        What is odd about the bag, one sentence each.
    checksum : str
        SHA-256 over the storage files.
    payload : float or None
        Mass at the tip, where the metadata of the bag say [kg].
    earlier : (ndarray of int64, ndarray) or None
        Stamps [ns] and positions of the gapless motion just before, where this is a part of a
        bag.
    oddities : Oddities
        What the arrays do not show of the bag.

    """

    path: str
    stamp: NDArray[np.int64]
    q: FloatArray
    dq: FloatArray | None
    effort: FloatArray | None
    strain: FloatArray | None
    segments: tuple[slice, ...]
    dt: float
    dropped: dict[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    checksum: str = ''
    payload: float | None = None
    earlier: tuple[NDArray[np.int64], FloatArray] | None = None
    oddities: Oddities = Oddities()

    def __repr__(self) -> str:
        """Write length, rate, signals with their ranges, and what is odd about the bag."""
        stretches = f', {len(self.segments)} gapless stretches' if len(self.segments) > 1 else ''
        lines = [f'Recording {self.path}: {self.t[-1]:.4g} s, {len(self.stamp)} samples at '
                 f'{1.0 / self.dt:.4g} Hz{stretches}']
        lines += [f'  {name}: {values.shape[1]} channels from {np.nanmin(values):.4g} to '
                  f'{np.nanmax(values):.4g}'
                  for name, values in (('q', self.q), ('dq', self.dq), ('effort', self.effort),
                                       ('strain', self.strain)) if values is not None]
        if self.payload is not None:
            lines.append(f'  payload: {self.payload:g} kg')
        return '\n'.join(lines + [f'  warning: {warning}' for warning in self.warnings])

    @property
    def t(self) -> FloatArray:
        """Time since the first stamp [s]."""
        return np.asarray((self.stamp - self.stamp[0]) * 1e-9)
