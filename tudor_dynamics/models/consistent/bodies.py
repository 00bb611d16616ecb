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
Bodies that can exist: what is known of them before any data.

A body can exist if its pseudo-inertia, second moments of its mass with first moments and mass, is
positive definite. The log-Cholesky parameters (Rucker and Wensing, IEEE RA-L 7(2), 2022) stand for
such bodies and no others: any ten numbers are a body.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm import Arm
from tudor_dynamics.typing import FloatArray

PARAMETERS = 10
LEAST_SHARE = 1e-4
"""Mass of a body that is described without any, as a part of all."""
LEAST_RADIUS = 0.01
"""Radius of gyration added to bodies that are described as points, lines or plates [m]."""
ROD = 4.0
"""Mass per length where no mass is described at all [kg/m]: that of lightweight arms."""
TOOL = 0.1
"""Length of the last body where nothing tells it [m]."""
WIDTH_DESCRIBED, WIDTH_ROD = 0.5, 1.0
"""Standard deviation of the logarithm of half a mass, described or guessed."""
WIDTH_SHAPE = 0.5
"""The same of a size; of a centre of mass and of a product of inertia as a part of the size."""


@dataclass(frozen=True, eq=False)
class Prior:
    """What a description says of the bodies."""

    center: FloatArray  # Log-Cholesky parameters, (bodies, 10)
    width: FloatArray  # their standard deviations, (bodies, 10)
    described: bool  # whether masses stand in the description; otherwise bodies are rods


def prior_of(arm: Arm) -> Prior:
    """Collect what a description says of the bodies of its active joints."""
    inertias = list(arm.model.inertias)[1:]
    described = sum(float(inertia.mass) for inertia in inertias) > 0.0
    bodies = _described(inertias) if described else _rods(arm.model)
    center = np.array([log_cholesky(parameters) for parameters in bodies])
    width = np.empty_like(center)
    # pseudo-inertia = U U', U = e^a [[e^d1 s12 s13 t1] ...]: the d are logarithms of sizes, the s
    # and t lengths
    sizes = np.exp(center[:, 1:4])
    length = np.maximum(sizes.max(axis=1), np.abs(center[:, 7:]).max(axis=1))
    width[:, 0] = WIDTH_DESCRIBED if described else WIDTH_ROD
    width[:, 1:4] = WIDTH_SHAPE
    width[:, 4:] = WIDTH_SHAPE * length[:, None]
    return Prior(center, width, described)


def parameters_of(log: FloatArray) -> FloatArray:
    """
    Give the dynamic parameters of a body.

    log (10,); returns (10,): mass [kg], first moments [kg m], inertia about the joint [kg m^2], in
    Pinocchio's order.
    """
    return np.asarray(pin.LogCholeskyParameters(log).toDynamicParameters())


def slopes_of(log: FloatArray) -> FloatArray:
    """Differentiate `parameters_of`, shape (10, 10): log (10,)."""
    return np.asarray(pin.LogCholeskyParameters(log).calculateJacobian())


def log_cholesky(parameters: FloatArray) -> FloatArray:
    """
    Give the log-Cholesky parameters of a body that can exist.

    parameters (10,): mass [kg], first moments [kg m], inertia about the joint [kg m^2], in
    Pinocchio's order; returns (10,).
    """
    pseudo = pseudo_inertia(parameters)
    # upper triangular factor: that of the reversed matrix, reversed
    upper = np.linalg.cholesky(pseudo[::-1, ::-1])[::-1, ::-1]
    upper = upper / upper[3, 3]
    return np.array([0.5 * np.log(pseudo[3, 3]), *np.log(np.diag(upper)[:3]),
                     upper[0, 1], upper[1, 2], upper[0, 2], *upper[:3, 3]])


def pseudo_inertia(parameters: FloatArray) -> FloatArray:
    """
    Give the matrix that is positive definite for bodies that can exist.

    Parameters
    ----------
    parameters : ndarray of shape (10,)
        Mass [kg], first moments [kg m], inertia about the joint [kg m^2], in Pinocchio's order.

    Returns
    -------
    ndarray of shape (4, 4)
        Second moments of mass, first moments, mass (Wensing, Kim and Slotine, IEEE RA-L 3(1),
        2018, Eq. (10)).

    """
    return np.asarray(pin.PseudoInertia.FromDynamicParameters(parameters).toMatrix())


def parameters_from(pseudo: FloatArray) -> FloatArray:
    """Give the dynamic parameters of a pseudo-inertia: pseudo (4, 4); returns (10,)."""
    return np.asarray(pin.PseudoInertia.FromMatrix(pseudo).toDynamicParameters())


def _described(inertias: list[pin.Inertia]) -> list[FloatArray]:
    """Take inertias as they stand; what cannot exist is given the least that can."""
    total = sum(float(inertia.mass) for inertia in inertias)
    found = []
    for inertia in inertias:
        mass = max(float(inertia.mass), LEAST_SHARE * total)
        center = np.asarray(inertia.lever)
        second = 0.5 * np.trace(inertia.inertia) * np.eye(3) - np.asarray(inertia.inertia)
        values, axes = np.linalg.eigh(second)
        second = (axes * np.maximum(values, mass * LEAST_RADIUS ** 2)) @ axes.T
        found.append(_body(mass, center, second))
    return found


def _rods(model: pin.Model) -> list[FloatArray]:
    """Guess bodies as rods from their joint to the next."""
    found = []
    for joint in range(1, model.njoints):
        next_ones = [child for child in range(joint + 1, model.njoints)
                     if model.parents[child] == joint]
        end = (np.asarray(model.jointPlacements[next_ones[0]].translation) if next_ones
               else np.array([0.0, 0.0, TOOL]))
        length = max(float(np.linalg.norm(end)), TOOL)
        mass = ROD * length
        second = mass * (np.outer(end, end) / 12.0 + (0.1 * length) ** 2 * np.eye(3))
        found.append(_body(mass, end / 2.0, second))
    return found


def _body(mass: float, center: FloatArray, second: FloatArray) -> FloatArray:
    """Put a body together; ``second`` are the second moments about its centre of mass."""
    pseudo = np.empty((4, 4))
    pseudo[:3, :3] = second + mass * np.outer(center, center)
    pseudo[:3, 3] = pseudo[3, :3] = mass * center
    pseudo[3, 3] = mass
    return parameters_from(pseudo)
