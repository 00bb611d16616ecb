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
from tudor_dynamics.doctor.units import masses
from tudor_dynamics.identification.finding import Finding
from tudor_dynamics.models.payload import last_body
from tudor_dynamics.models.torque_rows import BODY_PARAMETERS
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

    Parameters
    ----------
    case : Case
        Bag with its arm.
    predicted : mapping of str to ndarray of shape (n, n_channels)
        What the model says of its motion, by output.
    bag : str
        Name of the bag, for the finding.

    Returns
    -------
    Finding or None
        None where a load explains little.

    """
    best: Finding | None = None
    for output, values in predicted.items():
        found = _of_output(case, output, values, bag)
        if found is not None and (best is None or (found.now or 0.0) > (best.now or 0.0)):
            best = found
    return best


def carried_rows(case: Case, output: str) -> tuple[FloatArray, FloatArray]:
    """
    Give the rows of the last body, and those of one kilogram at the end of the arm.

    Parameters
    ----------
    case : Case
        Bag with its arm.
    output : {'effort', 'strain'}
        Output whose rows are wanted.

    Returns
    -------
    rows : ndarray of shape (n, n_channels, 10)
        Per parameter of the body.
    point : ndarray of shape (n, n_channels)
        Per kilogram.

    """
    bodies = case.bodies[output]
    model = bodies.model
    name = last_body(model)
    index = model.getJointId(name)
    first = 10 * (index - 1)
    rows = bodies.rows(case.motion)[:, :, first:first + len(BODY_PARAMETERS)]
    at = np.zeros(3)
    for frame in case.arm.full_model.frames:
        if frame.parentJoint == case.arm.full_model.njoints - 1:
            place = np.array(frame.placement.translation)
            if np.linalg.norm(place) > np.linalg.norm(at):
                at = place
    if not case.arm.full_model.existJointName(name):
        at = at - model.jointPlacements[index].translation  # behind a gauge on the last link
    x, y, z = at
    unit = np.array([1.0, x, y, z, y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z,
                     x * x + y * y])
    return rows, rows @ unit


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
    rows, point = carried_rows(case, output)
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
    free_left = nothing.residuals(left)
    free_point = nothing.residuals(point)
    both, size = np.sum(free_left * free_point, axis=0), np.sum(free_point ** 2, axis=0)
    slopes = np.where(size > 0.0, both / np.where(size > 0.0, size, 1.0), 0.0)
    mass = _mass(case, output, predicted, slopes, before - after, size)
    much = '' if mass is None else f', about {abs(mass):.2g} kg'
    more = 'something' if mass is None or mass > 0.0 else 'less'
    return Finding(
        'load_unknown', f'the arm carries {more} that the model does not know{much}',
        'fit a model to bags with this load; bags of two loads and --payload-of BAG=KG give one '
        'of all loads', bag, (), None, mass, '' if mass is None else 'kg',
        'relative error', now, then)


def _mass(
    case: Case, output: str, predicted: FloatArray, slopes: FloatArray, weight: FloatArray,
    size: FloatArray,
) -> float | None:
    """Give the load as a mass at the end of the arm; None where the unit hides it."""
    if output != 'effort':
        return None
    known = masses(case, predicted)
    ratios = np.ones(len(slopes))
    for i, joint in enumerate(case.arm.joints):
        if joint.effort.unit == 'A' and joint.effort.torque_constant is None:
            if known is None:
                return None
            ratios[i] = known.ratio[i] if known.share[i] > 0.6 else 0.0
    good = (ratios > 0.0) & (size > 1e-3 * float(size.max()))
    if not good.any():
        return None
    return float(np.average(slopes[good] / ratios[good], weights=size[good] * ratios[good] ** 2))
