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
from numpy.typing import NDArray

from tudor_dynamics.models.base import OutputModel
from tudor_dynamics.models.elastic import ElasticModel
from tudor_dynamics.signals import Stretch

FloatArray = NDArray[np.float64]


def sample_times(stretch: Stretch) -> FloatArray:
    """Give the time since the sample before, 0 for the first, as the running robot has it [s]."""
    return np.asarray(np.diff(stretch.stamp, prepend=stretch.stamp[0]) * 1e-9)


def predict_stretch(model: OutputModel, stretch: Stretch) -> FloatArray:
    """
    Predict the outputs at all samples of a stretch.

    Parameters
    ----------
    model : OutputModel
        Fitted model.
    stretch : Stretch
        Gapless motion.

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
