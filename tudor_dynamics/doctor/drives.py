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

"""Alternatives of coupled drives: motors that turn with another joint, described or not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.couplings import CouplingPair, CouplingsSpec
from tudor_dynamics.doctor.case import Case
from tudor_dynamics.doctor.explained import Explained

AT: tuple[Literal['joints', 'motors'], ...] = ('joints', 'motors')
"""What positions and efforts of coupled drives may be those of."""


@dataclass(frozen=True, eq=False)
class Drives:
    """Drives as they might be."""

    kind: str  # key of the finding that it would be
    # Motor, and the joint that turns it; all that are coupled where nothing should be.
    channels: tuple[str, ...]
    couplings: CouplingsSpec | None  # what the description would say
    explained: dict[str, Explained]  # rows of the outputs

    @property
    def ratio(self) -> float:
        """Give the turns of the motor for one of the joint; 0 where nothing is coupled."""
        return 0.0 if self.couplings is None else self.couplings.pairs[0].ratio


def with_couplings(arm: Arm, couplings: CouplingsSpec | None) -> Arm:
    """Give an arm with other couplings."""
    return replace(arm, spec=arm.spec.model_copy(update={'couplings': couplings}))


def other_drives(case: Case) -> Iterator[Drives]:
    """Go through drives that are coupled otherwise than the description says."""
    arm, names = case.arm, case.arm.active_joints
    if 'effort' not in case.outputs or len(names) < 2:
        return
    if arm.coupling is not None:
        coupled = tuple(name for i, name in enumerate(names)
                        if arm.coupling[i].nonzero()[0].size > 1
                        or arm.coupling[:, i].nonzero()[0].size > 1)
        yield Drives('coupling_wrong', coupled, None,
                     case.explained(arm=with_couplings(arm, None)))
        return
    moves = case.moves
    for i, joint in enumerate(names):
        for j in (i - 1, i + 1):
            # a slide and a hinge have a ratio of their own, which is no guess
            if (not 0 <= j < len(names) or not moves[i]
                    or arm.is_prismatic(joint) != arm.is_prismatic(names[j])):
                continue
            for ratio in (1.0, -1.0):
                for at in AT:
                    spec = CouplingsSpec(pairs=(CouplingPair(
                        motor=names[j], joint=joint, ratio=ratio),), positions=at, efforts=at)
                    yield Drives('coupling_missing', (names[j], joint), spec,
                                 case.explained(arm=with_couplings(arm, spec)))
