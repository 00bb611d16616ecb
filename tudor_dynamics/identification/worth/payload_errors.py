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

"""How far off a load is that a model tells, on motion with a known load that it has not seen."""

from __future__ import annotations

import math

import numpy as np

from tudor_dynamics.errors import TudorError
from tudor_dynamics.identification.dataset import BagData, part
from tudor_dynamics.identification.fit import FitResult
from tudor_dynamics.identification.trainers import RowTrainer
from tudor_dynamics.identification.worth.bent import watched
from tudor_dynamics.models.base import Model
from tudor_dynamics.payload.bending_search import relearned
from tudor_dynamics.payload.bent import BentLinks
from tudor_dynamics.payload.estimate import Verdict
from tudor_dynamics.payload.offline import estimate_payload

KIND = 'analytical'
"""Kind of model that loads are told by."""
PARTS = 4
"""Into which all training bags are cut; each part is left out once."""


def payload_errors(result: FitResult, bent: BentLinks | None = None) -> dict[str, float]:
    """
    Let models of a part of the training motion tell the known load of the rest.

    What their errors have beyond the standard deviations of their own residuals is the error of
    the models, a little more than that of a model of all the motion.

    Returns output to the standard deviation of a load by its model [kg].
    """
    pieces = []
    for i in range(PARTS):
        try:
            pieces.append([part(bag, i / PARTS, (i + 1) / PARTS, result.preprocessing)
                           for bag in result.training])
        except TudorError:
            return {}  # too short to be cut
    found = {}
    for item in result.fitted:
        if item.kind != KIND:
            continue
        trainer = RowTrainer(KIND, result.arm, result.settings)
        errors, variances = [], []
        for i, left in enumerate(pieces):
            known = [bag for j, bags in enumerate(pieces) if j != i for bag in bags]
            try:
                model = trainer.fit(known, item.output)
                links = None
                if bent is not None and item.output == 'strain':
                    links = relearned(bent, [one for bag in known for one in watched(bag)])
                for bag in left:
                    error, std = _error(result, model, item.output, bag, links)
                    if math.isfinite(error) and 0.0 < std < math.inf:
                        errors.append(error)
                        variances.append(std ** 2)
            except TudorError:
                continue
        if errors:
            # parts that say little of a load say little of errors
            squares = np.average(np.square(errors), weights=1.0 / np.array(variances))
            noise = len(variances) / float(np.sum(1.0 / np.array(variances)))
            found[item.output] = math.sqrt(max(float(squares) - noise, 0.0))
    return found


def _error(
    result: FitResult, model: Model, output: str, bag: BagData, bent: BentLinks | None,
) -> tuple[float, float]:
    told = estimate_payload(result.arm, {output: model}, bag.stretches,
                            known=bag.payload or 0.0, whole=False, bent=bent,
                            watched=[] if bent is None else watched(bag))
    if told.verdict is Verdict.UNKNOWN:
        return math.nan, math.nan
    one = told.outputs[0]
    true = (bag.payload or 0.0) - told.known
    return one.mass - true, one.std
