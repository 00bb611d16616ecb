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

"""A bag and its arm, ready to be compared with alternatives."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm import Arm
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.doctor.explained import Explained
from tudor_dynamics.doctor.rows import BodyRows
from tudor_dynamics.doctor.thinned import Thinned
from tudor_dynamics.typing import FloatArray

OUTPUTS = ('effort', 'strain')
ENOUGH = 20.0
"""Shorter recordings have to show more before something is told of them [s]."""
STILL = 0.02
"""A joint that goes no farther does not move [rad or m]."""


class Case:
    """
    What is known of a bag, and how much of its outputs an alternative explains.

    outputs (n, channels).
    """

    def __init__(
        self, arm: Arm, recording: Recording, thinned: Thinned,
        broken: Collection[str] = frozenset(),
    ) -> None:
        self.arm, self.recording, self.thinned = arm, recording, thinned
        self.broken = frozenset(broken)
        self.motion = thinned.motion
        self.bodies = {name: BodyRows(arm, name) for name in OUTPUTS if thinned.has(name)}
        self.sound = {name: np.array([one not in broken for one in bodies.channels])
                      for name, bodies in self.bodies.items()}
        # what never changes leaves the same whatever is changed
        self.outputs = {name: np.where(self.sound[name], thinned.output(name), 0.0)
                        for name in self.bodies}
        self.names = tuple((name, channel) for name, bodies in self.bodies.items()
                           for channel in bodies.channels)

    def scale(self, name: str, factors: Mapping[str, float]) -> None:
        """Divide channels by factors, before anything is compared."""
        divisor = np.array([factors.get(one, 1.0) for one in self.bodies[name].channels])
        self.outputs[name] = self.outputs[name] / divisor

    def explained(
        self, motion: FloatArray | None = None, gravity: FloatArray | None = None,
        arm: Arm | None = None,
    ) -> dict[str, Explained]:
        """
        Build the least squares of all outputs for another motion, gravity or description.

        motion (n, 3 joints), gravity (3,) [m/s^2].
        """
        x = self.motion if motion is None else motion
        described = self.bodies if arm is None else {
            name: BodyRows(arm, name) for name in self.bodies}
        return {name: Explained(bodies.rows(x, gravity), bodies.own(x), bodies.groups)
                for name, bodies in described.items()}

    def rows(self, output: str) -> FloatArray:
        """Give the rows of the bodies as the description has them."""
        return self.bodies[output].rows(self.motion)

    @property
    def brevity(self) -> float:
        """Say how much shorter the recording is than one that tells enough; 1 or more."""
        return max(1.0, ENOUGH / float(self.thinned.t[-1] - self.thinned.t[0]))

    def surely(self, least: float) -> float:
        """
        Give the gain that says something, not less than one that is asked for anyway.

        What is left of a channel is known as well as its independent samples are many, which
        behind one filter go with time; the log ratios of all channels add up.
        """
        return max(least, 1.5 * float(np.sqrt(len(self.names) * self.brevity / ENOUGH)))

    @cached_property
    def moves(self) -> NDArray[np.bool_]:
        """Say which joints move."""
        n = len(self.arm.active_joints)
        return np.asarray(np.ptp(self.motion[:, :n], axis=0) > STILL)

    @cached_property
    def usual(self) -> dict[str, Explained]:
        """Build the least squares of the description as it is, once."""
        return self.explained()

    @cached_property
    def now(self) -> FloatArray:
        """Give what is left of each channel, as things are."""
        return self.shares(self.usual)

    def shares(
        self, explained: Mapping[str, Explained], outputs: Mapping[str, FloatArray] | None = None,
    ) -> FloatArray:
        """
        Give the part of the variance of each channel that is left.

        Returns (channels of all outputs,).
        """
        values = {**self.outputs, **(outputs or {})}
        return np.concatenate([item.shares(values[name]) for name, item in explained.items()])


def gain(now: FloatArray, other: FloatArray) -> float:
    """
    Say how much better an alternative is: the sum of log ratios of what is left.

    Up to a factor, twice the logarithm of the likelihood ratio of channels with unknown noise.

    now, other (channels,).
    """
    return float(np.sum(np.log(now / other)))


def relative(shares: FloatArray | Sequence[float]) -> float:
    """Give the relative residual of all channels from their shares, each with the same weight."""
    return float(np.sqrt(np.mean(shares)))
