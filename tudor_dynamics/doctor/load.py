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

"""Find what the arm carries and the model does not know."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tudor_dynamics.doctor.case import Case, gain
from tudor_dynamics.doctor.explained import Explained
from tudor_dynamics.identification.finding import Finding
from tudor_dynamics.payload.rows import LoadRows
from tudor_dynamics.typing import FloatArray

LEAST_GAIN = 1.0
"""Sum of log ratios by which a load has to lessen what the model leaves."""
EXPLAINED = 0.5
"""Part of the model's relative error that a load leaves at most."""
LEAST_ERROR = 0.1
"""Relative error, friction left out, below which a model is as it was."""


def load_of(
    case: Case, predicted: Mapping[str, FloatArray], bag: str,
) -> Finding | None:
    """
    Explain what a model leaves over by a body at the end of the arm.

    predicted (n, channels); returns None where a load explains little.
    """
    best: Finding | None = None
    for output, values in predicted.items():
        found = _of_output(case, output, values, bag)
        if found is not None and (best is None or (found.now or 0.0) > (best.now or 0.0)):
            best = found
    return best


def _of_output(case: Case, output: str, predicted: FloatArray, bag: str) -> Finding | None:
    measured = case.outputs[output]
    sound = case.sound[output]
    left = np.where(sound, measured - predicted, 0.0)
    bodies = case.bodies[output]
    # another day's friction and zero are no load
    # nor are filters that are later or earlier than those of the fit
    rates = np.gradient(predicted, case.thinned.t, axis=0)
    own = [np.column_stack([columns[:, 1:] if output == 'effort' else columns, rates[:, i]])
           for i, columns in enumerate(bodies.own(case.motion))]
    rows = LoadRows(case.arm, output).rows(case.motion)
    groups = bodies.groups
    nothing = Explained(np.zeros_like(rows[:, :, :1]), own, groups)
    body = Explained(rows, own, groups)
    sizes = np.sum((measured - measured.mean(axis=0)) ** 2, axis=0)
    before = np.sum(nothing.residuals(left) ** 2, axis=0) / np.maximum(sizes, 1e-300)
    after = np.sum(body.residuals(left) ** 2, axis=0) / np.maximum(sizes, 1e-300)
    felt = sound & (before > LEAST_ERROR ** 2)
    if not felt.any():
        return None
    better = gain(np.maximum(before[felt], 1e-9), np.maximum(after[felt], 1e-9))
    if better < LEAST_GAIN:
        return None
    now, then = float(np.sqrt(before[felt].mean())), float(np.sqrt(after[felt].mean()))
    if then > EXPLAINED * now:
        return None
    return Finding(
        'load_unknown', 'the arm carries what the model does not know',
        'fit a model to bags with this load; bags of two loads and --payload-of BAG=KG give one '
        'of all loads', bag, (), None, None, '', 'relative error', now, then)
