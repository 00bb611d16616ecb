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

"""Any model along a gapless stretch, whether it has a memory or not."""

from __future__ import annotations

import numpy as np

from tudor_dynamics.models.base import OutputModel
from tudor_dynamics.models.elastic.live import LiveElastic
from tudor_dynamics.models.elastic.model import ElasticModel
from tudor_dynamics.signals import Stretch
from tudor_dynamics.typing import FloatArray


def sample_times(stretch: Stretch) -> FloatArray:
    """Give the time since the sample before, 0 for the first, as the running robot has it [s]."""
    return np.asarray(np.diff(stretch.stamp, prepend=stretch.stamp[0]) * 1e-9)


def predict_stretch(model: OutputModel, stretch: Stretch) -> FloatArray:
    """
    Predict the outputs at all samples of a stretch.

    Parameters
    ----------
    model : OutputModel
        Model that was fitted.
    stretch : Stretch
        Motion without a gap.

    Returns
    -------
    ndarray of shape (n_samples, n_channels)
        Outputs in their units.

    """
    if not isinstance(model, ElasticModel):
        return model.predict(stretch.motion)
    dt = sample_times(stretch)
    if stretch.before is not None:
        dt[0] = stretch.since
    return model.follow(stretch.motion, dt, stretch.before)


def observe_stretch(
    model: OutputModel, stretch: Stretch, output: str, strain_model: ElasticModel | None = None,
    observer: str = 'ringing',
) -> FloatArray:
    """
    Predict the outputs at all samples, each from the strain measured until the sample before.

    Parameters
    ----------
    model : OutputModel
        Fitted model; one without memory predicts as ever.
    stretch : Stretch
        Motion without a gap, with its strain.
    output : {'effort', 'strain'}
        What the model predicts.
    strain_model : ElasticModel, optional
        Model of the strain that corrects; ``model`` itself where that predicts strain.
    observer : {'off', 'ringing', 'contact'}
        Whether measured strain corrects the model.

    Returns
    -------
    ndarray of shape (n_samples, n_channels)
        Outputs in their units.

    """
    if output == 'strain' and isinstance(model, ElasticModel):
        strain_model = model
    if (not isinstance(model, ElasticModel) or stretch.strain is None or observer == 'off'
            or strain_model is None):
        return predict_stretch(model, stretch)
    live = LiveElastic({output: model, 'strain': strain_model}, observer)
    motion, dt = stretch.motion, sample_times(stretch)
    predicted = np.full((len(motion), len(model.channels)), np.nan)
    for k in range(len(motion)):
        values = live.step(float(dt[k]), motion[k])
        if values is not None:
            predicted[k] = values[output]
        live.measure(stretch.strain[k])
    return predicted
