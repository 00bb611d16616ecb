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

"""Filter, predictor, residuals, thresholds and detector in one: a robot watched by sample."""

from __future__ import annotations

from tudor_dynamics.errors import check_type
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.monitoring.payload_stage import CarriedLoad
from tudor_dynamics.monitoring.predictor import Predictor
from tudor_dynamics.monitoring.settings import Found, MonitorSettings
from tudor_dynamics.monitoring.state_filter import Motion, StateFilter
from tudor_dynamics.monitoring.thresholds.thresholds import MethodThresholds
from tudor_dynamics.monitoring.watch import Watch
from tudor_dynamics.typing import FloatArray


class Monitor:
    """
    A whole chain, from joint states to collisions.

    Parameters
    ----------
    bundle : ModelBundle
        Fitted models, with the thresholds that were learned.
    settings : MonitorSettings, optional
        Kind of model, methods of detection, false alarms allowed.
    thresholds : dict of str to MethodThresholds, optional
        In place of those of the bundle.
    payload : CarriedLoad, optional
        Load that predictions have in them, and that follows the arm if it is a `PayloadStage`.

    Attributes
    ----------
    filter : StateFilter
        First stage: positions to motion.
    predictor : Predictor
        Second stage: motion to expected outputs.
    watch : Watch
        Third stage: residuals, thresholds and detector.
    motion : Motion or None
        Motion of the newest sample; None while a gap is crossed.
    predicted : dict of str to ndarray, or None
        Prediction for the newest sample; None while the filters settle.
    wanted : set of str
        Outputs to predict; those that the detector needs by default.

    """

    def __init__(
        self,
        bundle: ModelBundle,
        settings: MonitorSettings = MonitorSettings(),
        thresholds: dict[str, MethodThresholds] | None = None,
        payload: CarriedLoad | None = None,
    ) -> None:
        check_type(bundle, ModelBundle, 'bundle', 'the result of fit or load_bundle')
        check_type(settings, MonitorSettings, 'settings', "such as MonitorSettings(kind='elm')")
        bundle = bundle.beside_robot()
        self.filter = StateFilter(bundle.preprocessing, settings.gap)
        self.watch = Watch(bundle, settings, thresholds, payload)
        self.predictor = Predictor(
            bundle, settings.kind,
            settings.observer if 'strain' in self.watch.outputs else 'off')
        self.wanted = set(self.watch.outputs)
        self.payload = payload
        self.motion: Motion | None = None
        self.predicted: dict[str, FloatArray] | None = None

    def add_joints(
        self, stamp: int, q: FloatArray, measured_velocity: FloatArray | None = None,
    ) -> Found:
        """
        Take joint states into account.

        Parameters
        ----------
        stamp : int
            Header stamp [ns].
        q : ndarray of shape (n_joints,)
            Positions of the active joints [rad or m].
        measured_velocity : ndarray of shape (n_joints,), optional
            Velocities of the driver [rad/s or m/s].

        Returns
        -------
        Found
            What became known; ``motion`` and ``predicted`` are those of this sample, or None.

        """
        self.motion = self.filter.step(stamp, q, measured_velocity)
        self.predicted = None
        if self.motion is None:
            return Found()
        self.predicted = self.predictor.step(self.motion, self.wanted)
        if self.payload is not None and self.predicted is not None:
            self.predicted = self.payload.add_to(self.predicted, self.motion.row)
        return self.watch.add_motion(self.motion, self.predicted)

    def add_measured(self, output: str, stamp: int, values: FloatArray) -> Found:
        """
        Take efforts or strains into account.

        Parameters
        ----------
        output : {'effort', 'strain'}
            What was measured.
        stamp : int
            Header stamp [ns].
        values : ndarray of shape (n_channels,)
            Readings in the units of the arm description, NaN where there is none.

        Returns
        -------
        Found
            Residuals, ratios to the thresholds, and collisions that became known.

        """
        if output == 'strain':
            self.predictor.add_strain(stamp, values)
        return self.watch.add_measured(output, stamp, values)
