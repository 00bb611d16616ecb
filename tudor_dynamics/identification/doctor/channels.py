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

"""The channels of a recording, one by one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification.doctor.findings import Finding, found
from tudor_dynamics.typing import FloatArray, IndexArray

SINGULAR = {'q': 'position of', 'effort': 'effort of', 'strain': 'gauge'}


@dataclass(frozen=True, eq=False)
class Channel:
    """A column of a recording."""

    field: str  # array it stands in
    name: str  # joint or gauge
    column: int  # column of the array
    values: FloatArray  # samples in their unit, (n,)
    bag: str

    def found(self, kind: str, what: str, time: float, size: float, remedy: str = '') -> Finding:
        """Say what it does."""
        return found(kind, f'{SINGULAR[self.field]} {self.name}{what}', self.bag, (self.name,),
                     time=time, size=size, remedy=remedy)


def channels(
    recording: Recording, joints: tuple[str, ...], gauges: tuple[str, ...],
) -> Iterator[Channel]:
    """Go through positions, efforts and strains, by joint and gauge."""
    for field, names in (('q', joints), ('effort', joints), ('strain', gauges)):
        values = getattr(recording, field)
        if values is not None:
            for i, name in enumerate(names):
                yield Channel(field, name, i, values[:, i], recording.path)


def runs(x: FloatArray) -> tuple[IndexArray, IndexArray]:
    """Give first sample and length of each run of equal values of ``x``."""
    first = np.flatnonzero(np.diff(x, prepend=np.nan) != 0.0)
    return first, np.diff(first, append=len(x))


def until(recording: Recording, time: float) -> str:
    """Say what to do about a channel that is of no use from a time on [s]."""
    return f'check sensor and wiring; use BAG@0-{100 * time / recording.t[-1]:.0f}% until then'
