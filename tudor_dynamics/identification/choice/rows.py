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
Rows for all candidates at once: those of the bodies, and each friction term that any of them has.

Candidates differ in which columns they take, so one pass over the recordings serves all of them:
of every part that may be left out, the products of all columns are kept, and to leave a part out
is a subtraction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm import Arm, JointSpec
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.models.base_parameters import base_sets
from tudor_dynamics.models.coupling import Coupling
from tudor_dynamics.models.estimation.products import Products
from tudor_dynamics.models.friction import friction_columns, friction_names
from tudor_dynamics.models.payload import payload_regressor
from tudor_dynamics.models.presliding import bent_along
from tudor_dynamics.models.regressor import plain_regressor
from tudor_dynamics.typing import FloatArray

PARTS = 5
"""Parts that a few recordings are divided into; of more recordings each is a part."""
_EVEN = ('viscous', 'offset', 'square')
"""Terms that no switch is part of."""
Term = tuple[str, float, float]
"""
Name of a friction term, with the velocities of its switch and of Stribeck's curve; of what gives
way, with its displacement in place of the switch.
"""


@dataclass(frozen=True, eq=False)
class CandidateRows:
    """A part of the training data, its rows and outputs decimated."""

    bodies: FloatArray  # rows of the bodies and rotors, (samples, channels, body_columns)
    # (samples, joints, terms): friction terms of each drive, those of the load as yet without it.
    speed: FloatArray
    output: FloatArray  # efforts or strains in their units, as measured, (samples, channels)


def terms_of(joint: JointSpec) -> list[Term]:
    """Give the friction terms of a joint, one a column; velocities that do not count are 0."""
    found: list[Term] = [('presliding', distance, 0.0) for distance in joint.bristles]
    for name in friction_names(joint):
        kind = name.partition('(')[0]
        if not kind.startswith('presliding'):
            found.append((kind, 0.0 if kind in _EVEN else joint.friction_velocity,
                          joint.stribeck_velocity if kind == 'stribeck' else 0.0))
    return found


def joint_with(joint: JointSpec, term: Term) -> JointSpec:
    """Give a joint whose friction has a term, with another one where terms come in pairs."""
    name = term[0].rstrip('+-')
    return joint.model_copy(update={
        'friction': (name,), 'asymmetric': name != term[0],
        'friction_velocity': term[1] or joint.friction_velocity,
        'stribeck_velocity': term[2] or joint.stribeck_velocity})


class WideRows:
    """Rows of an output for all candidates."""

    def __init__(
        self, arm: Arm, output: str, candidates: Sequence[JointSpec], bags: Sequence[BagData],
        strain_form: str, *, with_payload: bool = False,
    ) -> None:
        self.output = output
        bare = arm.with_joints({joint.name: {'friction': ()} for joint in arm.joints})
        self._coupling = Coupling(arm)
        self._reach = self._coupling.reach if output == 'effort' else np.zeros((0, 0))
        names = [joint.name for joint in arm.joints]
        self.terms: list[list[Term]] = [[] for _ in names]
        self._joints = arm.joints
        if output == 'effort':
            for joint in candidates:
                own = self.terms[names.index(joint.name)]
                own += [term for term in terms_of(joint) if term not in own]
        self._widest = max((len(terms) for terms in self.terms), default=0)
        self.groupings = {}
        kept: set[int] = set()
        for shared in (False, True):
            regressor = plain_regressor(bare, output, strain_form, shared=shared)
            rows = payload_regressor(regressor, bare) if with_payload else regressor
            if shared and not rows.unknown:
                continue
            self.groupings[shared] = [(base.channels, base.kept) for base in base_sets(
                rows, len(names))]
            self.unknown, self.scaled = rows.unknown, rows.scaled
            kept |= {int(i) for _, columns in self.groupings[shared] for i in columns}
        self._regressor = rows
        self.columns = np.array(sorted(kept), dtype=np.intp)
        self.scaled = self.scaled[self.columns]
        self.parts = [part for bag in bags for part in self._parts(bag, len(bags), with_payload)]
        self._loads: FloatArray | None = None
        self.power = np.sum([np.sum(part.output ** 2, axis=0) for part in self.parts], axis=0)

    @property
    def n_columns(self) -> int:
        """Give the number of all columns, friction included."""
        return len(self.columns) + self._widest * len(self.terms)

    def _parts(self, bag: BagData, bags: int, with_payload: bool) -> list[CandidateRows]:
        pieces = []
        for stretch in bag.stretches:
            motion = stretch.motion
            if with_payload:
                motion = np.column_stack([motion, np.full(len(motion), bag.payload)])
            keep, n = stretch.decimation, len(self.terms)
            dq = self._coupling.drive_places(stretch.states.dq)
            speed = np.zeros((len(motion), n, self._widest))
            distances = sorted({term[1] for terms in self.terms for term in terms
                                if term[0] == 'presliding'})
            bent = bent_along(stretch, self._coupling, np.tile(
                np.array(distances).reshape(-1, 1), n))
            for i, terms in enumerate(self.terms):
                for k, term in enumerate(terms):
                    if term[0] == 'presliding':
                        speed[:, i, k] = bent[:, distances.index(term[1]), i]
                        continue
                    names = friction_names(joint := joint_with(self._joints[i], term))
                    place = [name.partition('(')[0] for name in names].index(term[0])
                    speed[:, i, k] = friction_columns(joint, dq[:, i])[:, place]
            rows = self._regressor.rows(motion if keep.sections is not None else keep(motion))
            bodies = rows[:, :, self.columns]
            pieces.append(CandidateRows(
                keep(bodies) if keep.sections is not None else bodies, keep(speed),
                keep(getattr(stretch, self.output))))
        whole = CandidateRows(*(np.concatenate([getattr(piece, name) for piece in pieces])
                                for name in ('bodies', 'speed', 'output')))
        count = 1 if bags >= PARTS else -(-PARTS // bags)
        edges = np.linspace(0, len(whole.output), count + 1).astype(int)
        return [CandidateRows(whole.bodies[a:b], whole.speed[a:b], whole.output[a:b])
                for a, b in zip(edges[:-1], edges[1:], strict=True)]

    def assume(self, parameters: FloatArray) -> None:
        """
        Take parameters by which the loads are known, for the terms that grow with them.

        parameters (channels, columns).
        """
        self._loads = parameters[:, :len(self.columns)]

    def products(self) -> list[list[Products]]:
        """Give the products of each part and channel, on all columns."""
        return [self._products(part) for part in self.parts]

    def _products(self, part: CandidateRows) -> list[Products]:
        speed = part.speed
        if self._loads is not None:
            speed = speed.copy()
            loads = np.abs(np.einsum('kcp,cp->kc', part.bodies, self._loads))
            for i, terms in enumerate(self.terms):
                for k, term in enumerate(terms):
                    if term[0] == 'load':
                        speed[:, i, k] *= loads[:, i]
        found = []
        for channel in range(part.output.shape[1]):
            friction = [speed[:, i] * self._reach[channel, i] for i in range(len(self._reach))]
            wide = np.hstack([part.bodies[:, channel], *friction])
            if not friction:
                wide = np.hstack([wide, np.zeros((len(wide), self.n_columns - wide.shape[1]))])
            product = Products.empty(self.n_columns)
            product.add(wide, part.output[:, channel])
            found.append(product)
        return found

    def taken(self, joints: Sequence[JointSpec], columns: NDArray[np.intp]) -> NDArray[np.intp]:
        """Give the places of the columns that a candidate takes."""
        bodies = np.searchsorted(self.columns, columns)
        if self.output != 'effort':
            return bodies
        friction = [len(self.columns) + i * self._widest + self.terms[i].index(term)
                    for i, joint in enumerate(joints) for term in terms_of(joint)]
        return np.concatenate([bodies, np.array(friction, dtype=np.intp)])
