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

"""What became known of a load, with its standard deviations."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
import math
from typing import Any

import numpy as np

from tudor_dynamics.payload.scale import Source
from tudor_dynamics.typing import FloatArray


class Verdict(Enum):
    """Whether there is a load."""

    LOAD = 'load'
    NONE = 'no load'
    UNKNOWN = 'no information'


@dataclass(frozen=True, eq=False)
class Leftover:
    """What an output leaves over, each channel's own zero and friction left out."""

    channels: tuple[str, ...]  # joints or gauges; without those of unknown scale
    t: FloatArray  # since the beginning of the recording, (samples,) [s]
    # Without and with the load, in units of the channels, (samples, channels).
    before: FloatArray
    after: FloatArray

    def sizes(self) -> tuple[FloatArray, FloatArray]:
        """Give root mean squares by channel, without and with the load."""
        return (np.asarray(np.sqrt(np.mean(self.before ** 2, axis=0))),
                np.asarray(np.sqrt(np.mean(self.after ** 2, axis=0))))

    def shares(self) -> FloatArray:
        """Give the part of each channel's squares that the load explains, from 0 to 1."""
        before, after = self.sizes()
        return np.asarray(np.maximum(1.0 - (after / np.maximum(before, 1e-300)) ** 2, 0.0))


@dataclass(frozen=True, eq=False)
class OutputMass:
    """Mass at the tip as one output tells it."""

    output: str  # output that was read
    # Beside what the model knows, with its standard deviation without that of the scale [kg];
    # without a scale as a part of the arm's own moment.
    mass: float
    std: float
    # Relative residual without and with the load.
    before: float
    after: float
    bent: bool  # whether it is told by where links are that bend
    # The same sample by sample, with the load that the estimate takes: at the tip, or as a body.
    leftover: Leftover


@dataclass(frozen=True, eq=False)
class PayloadEstimate:
    """What the arm carries."""

    verdict: Verdict  # whether there is a load; `UNKNOWN` where the recording does not show
    # In all, with what the model knows of [kg]; NaN without a scale.
    mass: float
    mass_std: float
    known: float  # part of it that the model knows of [kg]
    # (3,): centre of the mass in `frame` [m]; NaN where it is not shown.
    com: FloatArray
    com_std: FloatArray
    # (6,): xx, xy, yy, xz, yz, zz about the origin of `frame` [kg m^2]; NaN where it is not shown.
    inertia: FloatArray
    inertia_std: FloatArray
    frame: str  # frame that turns with the last joint
    # Whether the load is taken to sit at the tip, for want of motion that shows its place.
    at_tip: bool
    source: Source  # where kilograms come from
    scale_std: float  # relative standard deviation of the scale, which `mass_std` has in it
    # Moment of the load over that of the arm itself, both held out horizontally by its last
    # joints; for loads without a scale.
    relative: float
    relative_std: float
    outputs: tuple[OutputMass, ...]  # what each output says by itself

    def as_dict(self) -> dict[str, Any]:
        """Give it as plain values; None for what is not known."""
        def plain(value: float) -> float | None:
            return float(f'{value:.6g}') if math.isfinite(value) else None

        def plains(values: FloatArray) -> list[float | None]:
            return [plain(float(value)) for value in values]
        return {
            'verdict': self.verdict.value, 'mass': plain(self.mass),
            'mass_std': plain(self.mass_std), 'known': plain(self.known),
            'com': plains(self.com), 'com_std': plains(self.com_std),
            'inertia': plains(self.inertia), 'inertia_std': plains(self.inertia_std),
            'frame': self.frame, 'at_tip': self.at_tip, 'scale': self.source.name.lower(),
            'scale_std': plain(self.scale_std), 'relative': plain(self.relative),
            'relative_std': plain(self.relative_std),
            'outputs': {item.output: {
                'mass': plain(item.mass), 'std': plain(item.std), 'before': plain(item.before),
                'after': plain(item.after), 'bent_links': item.bent, 'channels': {
                    name: {'before': plain(before), 'after': plain(after), 'share': plain(share)}
                    for name, before, after, share in zip(
                        item.leftover.channels, *item.leftover.sizes(), item.leftover.shares(),
                        strict=True)}} for item in self.outputs}}

    @property
    def sentence(self) -> str:
        """Say it in one sentence."""
        if self.verdict is Verdict.UNKNOWN:
            return ('no information: in these poses and motions a load hardly changes what is '
                    'measured; move the links away from the vertical')
        if self.source is Source.NOTHING:
            told = f'{100 * self.relative:.1f} +- {100 * self.relative_std:.1f} % of the moment'
            return (f'{self.verdict.value}: {told} that the arm itself makes; kilograms need '
                    'torque constants, the gain of a gauge, or a model of two known payloads')
        place = ''
        if self.verdict is Verdict.LOAD:
            if self.at_tip:
                place = ', taken to sit at the tip'
            elif np.isfinite(self.com).any():
                place = ', centre at ' + ', '.join(
                    f'{axis} {1000 * value:.0f} +- {1000 * std:.0f} mm' for axis, value, std in
                    zip('xyz', self.com, self.com_std, strict=True) if math.isfinite(value)
                ) + f' in {self.frame}'
        return (f'{self.verdict.value}: {self.mass:.4g} +- {self.mass_std:.2g} kg{place}; scale: '
                f'{self.source.value}')
