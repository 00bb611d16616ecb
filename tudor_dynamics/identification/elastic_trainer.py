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

"""From bags to elastic models: strain by search, effort by regression."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
import warnings

import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.errors import FitError, TudorError, TudorWarning
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.identification.elastic_problem import Identified, Record, record_of, records_of
from tudor_dynamics.identification.elastic_search import identify, taken_over
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.models.elastic.model import (
    driven_arm, effort_rows, ElasticModel, follow_motion, PhysicalParameter)
from tudor_dynamics.models.friction import term_names
from tudor_dynamics.parallel import shared_out
from tudor_dynamics.typing import FloatArray, Progress

UNTOLD = 0.2
"""Relative standard error beyond which a stiffness is not identifiable."""
Searches = Mapping[tuple[str, ...], Identified]
"""Names of bags to what was found of them."""


def check_arm(arm: Arm) -> None:
    """Refuse an arm of which no elastic model can be made, before hours of work and not after."""
    reason = ''
    beyond = sorted({term for joint in arm.joints
                     for term in term_names(joint, loaded=True, state=True)})
    if arm.coupling is not None or beyond:
        what = f'friction: {", ".join(beyond)}' if beyond else 'couplings'
        raise FitError(f'{arm.source}: the elastic model knows nothing of {what}; leave that out '
                       'of the description, or elastic out of --models')
    if not arm.gauges:
        reason = (f'{arm.source}: no gauges are described, and the elastic model is identified '
                  'from strain')
    else:
        try:
            DrivenArm(arm)
        except TudorError as err:
            reason = f'{err} (the elastic model needs links)'
    if reason:
        raise FitError(f'{reason}; describe them, or leave it out of --models')


def _tell(arm: Arm, found: Identified) -> None:
    """Warn where strain does not separate a gear from the link after it."""
    values = {p.name: p for p in found.physical}
    for joint in arm.active_joints:
        both = [values.get(f'{kind}({joint})') for kind in ('gear', 'bending')]
        if None in both:
            continue
        if {f'gear({joint})', f'bending({joint})'} & {*found.untold} or any(
                p is not None and not p.shown and p.standard_error > UNTOLD * p.value
                for p in both):
            msg = (f'{arm.name}: the strain of these bags does not tell how the gear of {joint} '
                   'and the link behind it share their compliance; predictions hold on similar '
                   'motion, the stiffness of either does not: give motors[].stiffness, or a '
                   'second gauge on the link')
            warnings.warn(msg, TudorWarning, stacklevel=2)


def _names(bags: Sequence[BagData]) -> tuple[str, ...]:
    return tuple(str(bag.choice) for bag in bags)


@dataclass(frozen=True, eq=False)
class _Search:
    """Search in bags; also a worker of a cluster can do it."""

    arm: Arm
    records: list[Record]
    warm: dict[str, float] | None
    known: Identified | None


def _searched(search: _Search, progress: Progress) -> Identified:
    if search.known is not None:
        return taken_over(search.arm, search.records, search.known)
    return identify(search.arm, search.records, warm=search.warm, progress=progress)


class ElasticTrainer:
    """
    Fits elastic models to all bags, then to parts of them, each as if it had seen nothing else.

    A search from nothing takes three times as long as one that begins nearly right. It may begin
    where that for less ended, if that lies within what it is given: for all bags the part that is
    kept where the rest is held out, for some of the bags a half of all. So nothing that is left
    out to judge a model by has a hand in it.
    """

    def __init__(
        self, arm: Arm, payload_range: tuple[float, float] | None = None,
        progress: Progress = lambda _: None, warm: Mapping[str, float] | None = None,
        kept: BagData | None = None, known: Searches | None = None,
    ) -> None:
        self.arm = arm
        self.payload_range = payload_range
        self.progress = progress
        self.identified: Identified | None = None
        self._warm = warm
        self._kept = () if kept is None else (kept,)
        self._all: Sequence[BagData] = ()
        self._known = known or {}
        self._found: dict[tuple[str, ...], Identified] = {}
        self.searches: Searches = self._found

    def fit(self, bags: Sequence[BagData], output: str) -> ElasticModel:
        """Fit the model of one output."""
        self.prepare([bags])
        found = self._found[_names(bags)]
        payloads = {bag.payload for bag in bags}
        physical = found.physical
        if self.payload_range is None and len(payloads) == 1 and None not in payloads:
            (payload,) = payloads
            assert payload is not None
            physical = (*physical, PhysicalParameter('payload', payload, 'kg'))
        model = ElasticModel(self.arm, output, physical, payload_range=self.payload_range)
        if output == 'strain':
            model.coefficients_ = tuple(found.gauges)
            model.standard_errors_ = tuple(found.gauge_errors)
            model.noise_ = found.noise
        else:
            self._effort(model, bags)
        return model

    def prepare(self, parts: Sequence[Sequence[BagData]]) -> None:
        """Search for all that is going to be asked, several searches at a time."""
        self._all = self._all or parts[0]
        todo: dict[tuple[str, ...], Sequence[BagData]] = {}
        for bags in parts:
            if _names(bags) in self._found:
                continue
            for some in (self._less(bags), bags):
                if some and _names(some) not in self._found:
                    todo[_names(some)] = some
        if todo:
            check_arm(self.arm)
        while todo:
            ready = {key: bags for key, bags in todo.items()
                     if _names(self._less(bags)) not in todo}
            searches = [_Search(self.arm, records_of(bags), self._begin(bags),
                                self._known.get(key)) for key, bags in ready.items()]
            self._found.update(zip(ready, shared_out(_searched, searches, self.progress),
                                   strict=True))
            todo = {key: bags for key, bags in todo.items() if key not in ready}
            whole = _names(self._all)
            if whole in ready:
                self.identified = self._found[whole]
                if whole not in self._known:  # otherwise it was reported
                    _tell(self.arm, self.identified)

    def _less(self, bags: Sequence[BagData]) -> Sequence[BagData]:
        """Say which of the bags a search is done for before; none where it begins from nothing."""
        if self._warm is not None or _names(bags) in self._known:
            return ()
        middle = len(self._all) // 2
        less: Sequence[BagData] = ()
        if _names(bags) == _names(self._all):
            less = self._kept
        elif middle:
            less = next((half for half in (self._all[:middle], self._all[middle:])
                         if {*_names(half)} < {*_names(bags)}), ())
        # none, or too short a part of what is long enough
        enough = any(record_of(stretch, None) for bag in less for stretch in bag.stretches)
        return less if enough else ()

    def _begin(self, bags: Sequence[BagData]) -> dict[str, float] | None:
        """Say where a search begins, by nothing but the bags it is given."""
        if self._warm is not None:
            return dict(self._warm)
        less = self._less(bags)
        return {p.name: p.value for p in self._found[_names(less)].physical} if less else None

    def _effort(self, model: ElasticModel, bags: Sequence[BagData]) -> None:
        """Regress the efforts on torque of the gear, acceleration and friction."""
        driven = driven_arm(self.arm, model.values)
        rows: list[list[FloatArray]] = []
        efforts: list[FloatArray] = []
        for bag in bags:
            if self.payload_range is not None and bag.payload is not None:
                driven.set_parameters({'payload': bag.payload})
            for stretch in bag.stretches:
                response = follow_motion(driven, stretch.states.q, stretch.dt, stretch.before)
                made = effort_rows(self.arm, response, stretch.motion)
                rows.append([stretch.decimation(columns) for columns in made])
                assert stretch.effort is not None
                efforts.append(stretch.decimation(stretch.effort))
        effort = np.vstack(efforts)
        values, errors, noises = [], [], []
        for i in range(effort.shape[1]):
            columns = np.vstack([part[i] for part in rows])
            size = np.linalg.norm(columns, axis=0)
            size[size == 0.0] = 1.0
            scaled = columns / size
            solution, _, rank, _ = np.linalg.lstsq(scaled, effort[:, i], rcond=1e-8)
            left = effort[:, i] - scaled @ solution
            noise = float(left @ left) / max(len(left) - int(rank), 1)
            covariance = np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True) * noise
            noises.append(math.sqrt(noise))
            values.append(solution / size)
            errors.append(np.array([math.sqrt(max(v, 0.0)) for v in np.diag(covariance)]) / size)
        model.coefficients_, model.standard_errors_ = tuple(values), tuple(errors)
        model.noise_ = np.array(noises)
