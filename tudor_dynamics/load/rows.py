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

"""What each parameter of the last body adds to the outputs, in physical units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
import math

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.kinematics import link_frame
from tudor_dynamics.load.settings import (
    BELIEVED, CONSTANT_STD, GAIN_STD, SAMPLES, SLOW, TORQUE_STD)
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.consistent import parameters_from, pseudo_inertia
from tudor_dynamics.models.regressor import (
    EffortRegressor, last_body, PayloadRegressor, random_inputs, regressor_of)
from tudor_dynamics.models.rigid_bodies import BODY_PARAMETERS
from tudor_dynamics.typing import FloatArray


# -- Inertial parameters of a rigid body: linear forms, change of frame, physical consistency.
#
# The ten parameters (mass, first moments, inertia about the origin, in Pinocchio's order) are
# those of a body that can exist if the pseudo-inertia ``[[S, h], [h', m]]``, ``S = tr(I) 1 / 2 -
# I``, is positive semidefinite (Wensing, Kim, Slotine, "Linear matrix inequalities for physically
# consistent inertial parameter identification", IEEE RA-L 3(1), 2018, Theorem 1).

COUNT = 10
_LOWER = np.tril_indices(4)


def reframed(placement: pin.SE3) -> FloatArray:
    """Give the matrix (10, 10) that takes parameters about one frame to those about another."""
    into = placement.inverse().homogeneous
    return np.column_stack([parameters_from(into @ pseudo_inertia(unit) @ into.T)
                            for unit in np.eye(COUNT)])


def point_mass(place: FloatArray) -> FloatArray:
    """Give the parameters of one kilogram at a place: place (3,) [m]."""
    lever = np.append(place, 1.0)
    return parameters_from(np.outer(lever, lever))


def consistent(parameters: FloatArray, information: FloatArray, size: float) -> FloatArray:
    """Find the body that can exist and explains an estimate best."""
    # What the estimate does not know is that of a small body: each kilogram is drawn into a sphere
    # of the given size, by so little that no direction that is known moves.
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    mass = max(float(parameters[0]), 1e-6)
    # a thousandth of what one standard deviation of a body of this size would weigh
    shy = 1e-3 / np.array([mass, *3 * [mass * size], *6 * [mass * size ** 2]])

    def body(x: FloatArray) -> FloatArray:
        lower = np.zeros((4, 4))
        lower[_LOWER] = x
        return parameters_from(lower @ lower.T)

    def error(x: FloatArray) -> FloatArray:
        found = body(x)
        return np.concatenate([root @ (found - parameters), shy * found])

    def slope(x: FloatArray) -> FloatArray:
        lower = np.zeros((4, 4))
        lower[_LOWER] = x
        columns = []
        for row, column in zip(*_LOWER, strict=True):
            turned = np.zeros((4, 4))
            turned[row] = lower[:, column]
            columns.append(parameters_from(turned + turned.T))
        change = np.column_stack(columns)
        return np.vstack([root @ change, shy[:, None] * change])

    w, v = np.linalg.eigh(pseudo_inertia(parameters))
    scale = np.array([size, size, size, 1.0])
    start = (v * np.maximum(w, 0.0)) @ v.T + 1e-6 * mass * np.diag(scale ** 2)
    from scipy.optimize import least_squares  # slow to import, and few loads need it

    found = least_squares(error, np.linalg.cholesky(start)[_LOWER], slope, method='lm',
                          x_scale='jac', ftol=1e-14, xtol=1e-14, gtol=1e-14, max_nfev=500)
    return body(found.x)


# -- What each parameter of the last body adds to the outputs of an arm

def carrier(arm: Arm) -> str:
    """Give the joint that moves what the arm carries; its frame is that of all parameters."""
    return last_body(arm.model)


def carrier_frame(arm: Arm) -> str:
    """Give the name of the frame that turns with the carrier: its link's, or the joint's own."""
    return link_frame(arm.model, carrier(arm))


def tip(arm: Arm) -> FloatArray:
    """Give the place (3,) [m] that a load is taken to sit at: the frame that is farthest out."""
    index = arm.model.getJointId(carrier(arm))
    places = [frame.placement.translation for frame in arm.model.frames
              if frame.parentJoint == index]
    return np.array(max(places, key=np.linalg.norm, default=np.zeros(3)))


class LoadRows:
    """Rows of the last body, about the frame of the carrier whatever the output is."""

    def __init__(self, arm: Arm, output: str) -> None:
        model = arm.gauge_model if output == 'strain' else arm.model
        self.regressor = regressor_of(arm, output, 'exact')
        self.channels = self.regressor.channels
        body = last_body(model)
        columns = self.regressor.columns
        self._carried = np.array([columns.index(f'{name}({body})') for name in BODY_PARAMETERS],
                                 dtype=np.intp)
        data = model.createData()
        pin.forwardKinematics(model, data, pin.neutral(model))
        places = [data.oMi[model.getJointId(name)] for name in (carrier(arm), body)]
        self._frame = reframed(places[0].actInv(places[1]))
        self.point_parameters = np.zeros((len(self.channels), len(columns)))
        self.point_parameters[:, self._carried] = self._frame @ point_mass(tip(arm))

    def rows(self, motion: FloatArray) -> FloatArray:
        """Evaluate the rows of all parameters, (samples, channels, 10), in the output's unit."""
        return np.asarray(self.regressor.rows(motion)[:, :, self._carried] @ self._frame)

    def point(self, motion: FloatArray) -> FloatArray:
        """Evaluate what one kilogram at the tip adds (samples, channels), without the rows."""
        return self.regressor.outputs(motion, self.point_parameters)


# -- From the unit of an output to newton metres, and so to kilograms.
#
# Strains of unknown gain and currents of unknown torque constants show a load in their own unit
# only. Kilograms need torque constants, the gain of a gauge, or the masses of the description.


class Source(Enum):
    """Where kilograms come from."""

    PAYLOADS = 'a model of two known loads'
    TORQUE = 'the unit of the efforts, N m or N'
    CONSTANTS = 'the torque constants of the description'
    GAIN = 'the gains of the gauges in the description'
    MASSES = 'the masses of the description (an assumption)'
    ELASTIC = 'the elastic model and the masses of the description'
    NOTHING = 'nothing: no torque constants, gains, known loads or masses'


@dataclass(frozen=True, eq=False)
class Scale:
    """From rows of a load to an output."""

    factor: FloatArray  # (channels,): unit per unit of `LoadRows.rows`; 0 where unknown
    relative: float  # relative standard deviation that all channels have in common
    source: Source  # where it comes from


@dataclass(frozen=True, eq=False)
class Described:
    """Efforts over those of the masses of the description."""

    ratio: FloatArray  # (joints,): unit of the effort per N m or N; 1 if rightly described
    share: FloatArray  # part of the effort, friction left out, that they explain, (joints,)
    size: FloatArray  # (joints,): mean square of these masses' effort, in its unit

    @property
    def believed(self) -> FloatArray:
        """Ratios of the joints whose efforts the masses explain."""
        return np.asarray(self.ratio[self.share > BELIEVED])


def friction_terms(speed: FloatArray, slow: float) -> FloatArray:
    """Give the ways (samples, 3) in which friction may change from one day to another."""
    sharp = max(slow, SLOW * float(np.sqrt(np.mean(speed ** 2))), 1e-9)
    return np.column_stack([speed, np.tanh(speed / sharp), np.ones(len(speed))])


def described_masses(arm: Arm, motion: FloatArray, effort: FloatArray) -> Described | None:
    """Compare efforts with those of the masses of the description; None where it has none."""
    values = np.concatenate([inertia.toDynamicParameters()
                             for inertia in list(arm.model.inertias)[1:]])
    if not values.any():
        return None
    rows = EffortRegressor(arm)
    parameters = np.zeros((len(arm.active_joints), len(rows.columns)))
    parameters[:, :len(values)] = values
    torque = rows.outputs(motion, parameters)
    n = len(arm.joints)
    ratios, shares, sizes = np.zeros(n), np.zeros(n), np.zeros(n)
    for i, joint in enumerate(arm.joints):
        basis = np.linalg.qr(friction_terms(motion[:, n + i], joint.friction_velocity))[0]
        x, y = (column - basis @ (basis.T @ column) for column in (torque[:, i], effort[:, i]))
        both, size, whole = float(x @ y), float(x @ x), float(y @ y)
        sizes[i] = size / len(motion)
        if whole > 0.0 and size > 1e-6 * whole:
            ratios[i], shares[i] = both / size, both ** 2 / (size * whole)
    return Described(ratios, shares, sizes)


def find_scale(arm: Arm, output: str, motion: FloatArray, predicted: FloatArray) -> Scale:
    """Find the scale from newton metres to the readings of an output."""
    if output == 'strain':
        gains = {sensor.gauge: sensor.gain for sensor in arm.spec.sensors}
        factor = np.array([gains.get(name, 0.0) for name in arm.gauge_names])
        return Scale(factor, GAIN_STD, Source.GAIN if factor.any() else Source.NOTHING)
    known = np.array([joint.effort.unit != 'A' or joint.effort.torque_constant is not None
                      for joint in arm.joints])
    masses = described_masses(arm, motion, predicted)
    if known.any():
        measured = all(joint.effort.torque_constant is None for joint in arm.joints)
        relative = TORQUE_STD if measured else CONSTANT_STD
        if masses is not None:
            # how much the weights of the arm by the two differ is how far either may be off
            both = known & (masses.share > BELIEVED)
            if both.any():
                off = np.average((masses.ratio[both] - 1.0) ** 2, weights=masses.size[both])
                relative = max(relative, min(math.sqrt(float(off)), 1.0))
        return Scale(known.astype(float), relative,
                     Source.TORQUE if measured else Source.CONSTANTS)
    if masses is not None and len(masses.believed):
        factor = np.where(masses.share > BELIEVED, masses.ratio, 0.0)
        return Scale(factor, CONSTANT_STD, Source.MASSES)
    return Scale(np.zeros(len(known)), 0.0, Source.NOTHING)


# -- What a kilogram at the tip adds to an output, sample by sample

class LoadWorth:
    """Outputs per kilogram: reference [kg], typical (channels,)."""

    def __init__(self, arm: Arm, output: str, model: AnalyticalModel) -> None:
        rows = model.regressor
        plain = rows.plain if isinstance(rows, PayloadRegressor) else rows
        motion = random_inputs(plain, len(arm.joints), SAMPLES, 1)
        if isinstance(rows, PayloadRegressor):
            low, high = rows.payload_range
            self.source, self.reference = Source.PAYLOADS, high - low
            self._regressor, count = plain, len(plain.columns)
            self._parameters = np.zeros((len(rows.channels), count))
            self._parameters[:, rows.carried] = model.coefficients()[:, count:]
            self._factor = np.ones(len(rows.channels))
            self.typical = self.along(motion).std(axis=0)
            return
        load, predicted = LoadRows(arm, output), model.predict(motion)
        scale = find_scale(arm, output, motion, predicted)
        self.source, self._factor = scale.source, scale.factor
        self._regressor, self._parameters = load.regressor, load.point_parameters
        self.typical = self.along(motion).std(axis=0)
        most = int(np.argmax(self.typical))
        self.reference = float(predicted.std(axis=0)[most] /
                               max(float(self.typical[most]), 1e-300))

    def along(self, motion: FloatArray) -> FloatArray:
        """Evaluate samples of a motion: (samples, channels)."""
        return self._regressor.outputs(motion, self._parameters) * self._factor


def load_worth(arm: Arm, models: Mapping[str, Mapping[str, Model]]) -> dict[str, LoadWorth]:
    """Find the outputs of a bundle that show kilograms."""
    found = {}
    for output, kinds in models.items():
        model = kinds.get('analytical')
        if isinstance(model, AnalyticalModel):
            worth = LoadWorth(arm, output, model)
            if worth.source is not Source.NOTHING:
                found[output] = worth
    return found
