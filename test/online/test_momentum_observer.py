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

"""The momentum observer against an external torque that is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.description import arm_from_dict
from tudor_dynamics.online.monitor import MomentumObserver
from tudor_dynamics.online.streams import Motion, PairedSample

RATE = 1000.0
GAIN = 40.0


class RigidModel:
    """Torques of a rigid two-link arm, each row on a scale of its own."""

    channels = ('j1', 'j2')

    def __init__(self, scale: tuple[float, float]) -> None:
        arm = arm_from_dict({'name': 'two', 'kinematics': {'dh': [[0.4, 0, 0, 0]] * 2},
                             'gravity': [0.0, -9.81, 0.0],
                             'joints': [{'name': 'j1'}, {'name': 'j2'}]},
                            base=Path(), source='test')
        self.model = arm.full_model.copy()
        for i in (1, 2):
            self.model.inertias[i] = pin.Inertia(1.5, np.array([0.2, 0.0, 0.0]),
                                                 0.03 * np.eye(3))
        self.data = self.model.createData()
        self.scale = np.array(scale)

    def trail(self) -> None:
        """Depend on nothing that was before a sample."""

    def predict(self, motion: np.ndarray) -> np.ndarray:
        """Inverse dynamics of each row."""
        return np.array([pin.rnea(self.model, self.data, *row.reshape(3, 2))
                         for row in motion]) * self.scale


def test_follows_an_external_torque_with_its_lag() -> None:
    """
    A step of torque appears after a first-order lag, on the joint's scale.

    Truth: exp(-t gain); motion and torques are exact, so only the discretisation is left.
    """
    for scale in ((1.0, 1.0), (0.09, 0.27)):
        model = RigidModel(scale)
        observer = MomentumObserver(model, GAIN, settle=0.1)
        t = np.arange(1500) / RATE
        q = np.stack([np.sin(2 * t), 0.5 * np.cos(3 * t)], axis=1)
        dq = np.stack([2 * np.cos(2 * t), -1.5 * np.sin(3 * t)], axis=1)
        ddq = np.stack([-4 * np.sin(2 * t), -4.5 * np.cos(3 * t)], axis=1)
        motion = np.hstack([q, dq, ddq])
        external = np.where(t[:, None] >= 1.0, np.array([2.0, -1.0]), 0.0) * scale
        # the motors give what the motion needs less what comes from outside
        motors = model.predict(motion) - external
        values = []
        for k in range(len(t)):
            found = observer.step(PairedSample(
                Motion(round(t[k] * 1e9), t[k], 1.0 / RATE if k else 0.0, motion[k]), None,
                motors[k]))
            values.append(np.zeros(2) if found is None else found.value)
        got = np.array(values)
        lag = np.where(t >= 1.0, 1.0 - np.exp(-GAIN * (t - 1.0)), 0.0)[:, None]
        wanted = -lag * np.array([2.0, -1.0]) * scale
        assert np.abs(got - wanted)[300:].max() < 0.1 * max(scale)  # one sample: 40 x 2 x 1 ms
        again = MomentumObserver(model, GAIN).process(
            np.round(t * 1e9).astype(np.int64), motion, motors)
        assert np.abs(again - got)[300:].max() < 1e-9
