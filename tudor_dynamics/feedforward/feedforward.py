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
Efforts that a wanted motion needs, for controllers that add them to what errors ask for.

The model is that of the bundle, asked at the wanted motion in place of the measured one: nothing
of it is noisy or late, and friction has the sign of the wanted speed. That sign is smoothed about
standstill as the model was fitted (``friction_velocity``): at rest friction is zero, since a joint
that stands keeps what friction it came to rest with, and a plain sign would shake it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from scipy.interpolate import CubicSpline

from tudor_dynamics.arm.limits import hard_limits
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import ModelError, SignalError
from tudor_dynamics.feedforward.bending import Bent, BentArm
from tudor_dynamics.feedforward.resting import AtRest, kept_speeds
from tudor_dynamics.feedforward.units import factors, Unit, unit_names
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.elastic.arm import Response
from tudor_dynamics.models.elastic.model import elastic_of, ElasticModel
from tudor_dynamics.models.payload import SAME
from tudor_dynamics.payload.worth import load_worth, LoadWorth
from tudor_dynamics.signals.splines import states
from tudor_dynamics.typing import FloatArray

Positions = Literal['wanted', 'motor']
POSITIONS: tuple[Positions, ...] = ('wanted', 'motor')
STAYS = 0.01
"""How far a joint that is held may be from there [rad or m]."""


class Feedforward:
    """
    Feed-forward of one arm.

    Parameters
    ----------
    bundle : ModelBundle
        Models with efforts.
    kind : str, default='analytical'
        Kind of model that gives the efforts; 'elastic' bends the links under their load.
    unit : {'model', 'current', 'torque'}
        What efforts are given as.
    positions : {'wanted', 'motor'}
        Whether a wanted motion is that of the motors, which is passed on; or that of the links,
        for which the motors are led further.
    friction_at_rest : {'none', 'kept'}
        What friction is at rest along a trajectory: none, so that the weight alone is held; or
        that of the last motion, which real joints keep.
    payload : float, optional
        Mass at the tip [kg]; by default that of the training bags, or that of the elastic arm.

    Attributes
    ----------
    joints : tuple of str
        Joints, in the order of all arrays.
    units : tuple of str
        Unit of each joint's effort.
    payload : float
        Mass at the tip [kg].

    Raises
    ------
    ModelError
        If the bundle has no such model of efforts, a torque constant is not known, the model knows
        nothing of the payload, or the arm has no flexible links.

    """

    def __init__(
        self, bundle: ModelBundle, *, kind: str = 'analytical', unit: Unit = 'model',
        positions: Positions = 'wanted', friction_at_rest: AtRest = 'none',
        payload: float | None = None,
    ) -> None:
        arm, efforts = bundle.arm, bundle.models.get('effort', {})
        if kind not in efforts:
            msg = (f'the bundle has no model of efforts of the kind {kind!r}; it has '
                   f'{", ".join(efforts) or "none of efforts"}')
            raise ModelError(msg, remedy='name one of these, or fit bags that have efforts')
        self.joints, self.units = arm.active_joints, unit_names(arm, unit)
        self._held = {joint.name: joint.hold for joint in arm.spec.joints
                      if joint.name not in self.joints}
        self._factor = factors(arm, unit)
        self._turning = np.array([joint.friction_velocity for joint in arm.joints])
        self._keeps = friction_at_rest == 'kept'
        self._of_all = efforts[kind]
        self._bent: BentArm | None = None
        self._leads = positions == 'motor'
        self._limits = hard_limits(arm)
        if self._leads or kind == 'elastic':
            self._bent = BentArm(arm, _physical(bundle))
        known = self._of_all.payload_range
        of_bags = bundle.payload if known is None else known[0]
        described = 0.0 if self._bent is None else self._bent.payload
        self._known = described if of_bags is None else of_bags
        self._worth = self._find_worth(bundle, kind)
        self._model: Model = self._of_all
        self.payload = self._known
        self.carry(self._known if payload is None else payload)

    def _find_worth(self, bundle: ModelBundle, kind: str) -> LoadWorth | None:
        """Give what a kilogram adds, for a model of one payload that does not know itself."""
        if self._of_all.payload_range is not None or kind != 'analytical':
            return None
        return load_worth(bundle.arm, {'effort': {kind: self._of_all}}).get('effort')

    def carry(self, payload: float) -> None:
        """
        Take another payload.

        Parameters
        ----------
        payload : float
            Mass at the tip [kg].

        Raises
        ------
        ModelError
            If it is no mass, or the model is of one payload and nothing tells what a kilogram
            more is worth.

        """
        more = payload - self._known
        if not 0.0 <= payload < float('inf'):
            msg = f'a payload of {payload} kg is impossible; give 0 or more'
            raise ModelError(msg)
        elastic = self._of_all.has_memory
        if self._of_all.payload_range is not None or (elastic and abs(more) > SAME):
            self._model = self._of_all.at(payload)
        elif self._worth is None and abs(more) > SAME:
            msg = (f'the model was fitted to a payload of {self._known:g} kg, and nothing tells '
                   f'what {payload:g} kg are in its efforts')
            raise ModelError(msg, remedy='fit a model to bags of two payloads (tudor fit '
                                         '--payload-of), or describe torque constants')
        if self._bent is not None:
            self._bent.carry(payload)
        self.payload = payload

    def efforts(self, motion: FloatArray) -> FloatArray:
        """
        Give the efforts of single states, each by itself.

        Parameters
        ----------
        motion : ndarray of shape (n_points, 3 n_joints)
            ``[q, dq, ddq]`` of the motors [rad, rad/s, rad/s^2 or m, m/s, m/s^2].

        Returns
        -------
        ndarray of shape (n_points, n_joints)
            In ``units``.

        """
        if isinstance(self._model, ElasticModel):
            assert self._bent is not None
            return self._by_torque(self._bent.under(motion, reach=False).torque, motion)
        return self._by_motion(motion)

    def _by_motion(self, motion: FloatArray) -> FloatArray:
        """Give the efforts of a model that has no memory."""
        found = self._model.predict(motion)
        more = self.payload - self._known
        if self._worth is not None and abs(more) > SAME:
            found = found + more * self._worth.along(motion)
        return np.asarray(found * self._factor)

    def _by_torque(self, torque: FloatArray, motion: FloatArray) -> FloatArray:
        """Give the efforts of an elastic model whose gears pass on a torque."""
        assert isinstance(self._model, ElasticModel)
        response = Response(np.zeros((len(motion), 0)), torque)
        return np.asarray(self._model.outputs(response, motion) * self._factor)

    def along(self, trajectory: Trajectory) -> Trajectory:
        """
        Give a trajectory with the efforts that it needs.

        Parameters
        ----------
        trajectory : Trajectory
            Wanted motion of ``joints`` in any order, see there for what is not given; joints that
            the description holds may be in it, as long as they stay where it holds them.

        Returns
        -------
        Trajectory
            The same with efforts, none for held joints; where motors are led, with their
            positions, velocities and accelerations.

        Raises
        ------
        SignalError
            If joints are missing or unknown, a held one moves, or a motor would have to be led
            beyond its limits.
        SimulationError
            If links are too weak for the load.

        """
        self._check_held(trajectory)
        motion = states(trajectory.of(self.joints))
        places = [trajectory.joints.index(name) for name in self.joints]
        if not self._leads:
            effort = self._along(motion, None)
            return replace(trajectory, effort=_put(trajectory, None, places, effort))
        assert self._bent is not None
        bent = self._bent.under(motion, reach=True)
        n = len(self.joints)
        self._check_limits(bent.motor, motion[:, :n])
        further = bent.motor - motion[:, :n]
        rate, rise = _derivatives(trajectory.t, further, motion[:, n:2 * n])
        led = np.hstack([bent.motor, motion[:, n:2 * n] + rate, motion[:, 2 * n:] + rise])
        effort = self._along(led, bent)
        q, dq, ddq, effort = (
            _put(trajectory, given, places, own) for given, own in zip(
                (trajectory.q, trajectory.dq, trajectory.ddq, None),
                (*np.split(led, 3, axis=1), effort), strict=True))
        return replace(trajectory, q=q, dq=dq, ddq=ddq, effort=effort)

    def _along(self, motion: FloatArray, bent: Bent | None) -> FloatArray:
        """Give the efforts of motors point after point; bent links may be known already."""
        n, felt = len(self.joints), motion
        if self._keeps:
            felt = motion.copy()
            felt[:, n:2 * n] = kept_speeds(motion[:, n:2 * n], self._turning)
        if not isinstance(self._model, ElasticModel):
            return self._by_motion(felt)
        assert self._bent is not None
        torque = (bent or self._bent.under(motion, reach=False)).torque
        return self._by_torque(torque, felt)

    def _check_limits(self, motor: FloatArray, wanted: FloatArray) -> None:
        """Refuse to lead a motor beyond a limit that the wanted motion keeps to."""
        low, high = self._limits.lower, self._limits.upper
        beyond = ((motor < low) | (motor > high)) & (wanted >= low) & (wanted <= high)
        if beyond.any():
            point, joint = np.argwhere(beyond)[0]
            msg = (f'to put the links there, the motor of {self.joints[joint]} would have to be '
                   f'at {motor[point, joint]:.4g} at point {point + 1}; its limits are '
                   f'{low[joint]:g} and {high[joint]:g}')
            raise SignalError(msg, remedy='keep the wanted motion further from them')

    def _check_held(self, trajectory: Trajectory) -> None:
        """Refuse joints that the model knows nothing of, and held ones that move."""
        for name, column in zip(trajectory.joints, trajectory.q.T, strict=True):
            if name in self.joints:
                continue
            if name not in self._held:
                msg = (f'the trajectory has the joint {name!r}, the model {list(self.joints)}'
                       + (f' and holds {list(self._held)}' if self._held else ''))
                raise SignalError(msg, remedy='name joints as the arm description does')
            off = np.abs(column - self._held[name])
            if off.max() > STAYS:
                msg = (f'the model was fitted with {name!r} at {self._held[name]:g}, and point '
                       f'{int(off.argmax()) + 1} has it at {column[off.argmax()]:g}')
                raise SignalError(msg, remedy='hold it there, or fit a model with it among '
                                              'active_joints')


def _put(
    trajectory: Trajectory, given: FloatArray | None, places: list[int], own: FloatArray,
) -> FloatArray:
    """Put columns of the model's joints among those of a trajectory, zero where none are given."""
    whole = np.zeros_like(trajectory.q) if given is None else given.copy()
    whole[:, places] = own
    return whole


def _derivatives(
    t: FloatArray, values: FloatArray, speed: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Differentiate along the points twice; a single point rests."""
    if len(t) < 2:
        return np.zeros_like(values), np.zeros_like(values)
    ends = tuple((1, np.zeros(values.shape[1])) if not speed[row].any() else
                 (2, np.zeros(values.shape[1])) for row in (0, -1))
    spline = CubicSpline(t, values, bc_type=ends)
    rate, rise = spline(t, 1), spline(t, 2)
    rise[[row for row in (0, -1) if not speed[row].any()]] = 0.0  # what rests is held as it is
    return np.asarray(rate), np.asarray(rise)


def _physical(bundle: ModelBundle) -> dict[str, float]:
    """Give the physical parameters that were identified; none where the description has to do."""
    model = elastic_of(bundle, 'strain') or elastic_of(bundle, 'effort')
    return {} if model is None else model.values
