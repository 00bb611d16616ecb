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

"""Recordings of a campaign for training and for testing, and how a prediction is judged."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
import warnings

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import TudorWarning
from tudor_dynamics.identification.bag_choice import BagChoice
from tudor_dynamics.identification.dataset import BagData, load
from tudor_dynamics.identification.metrics import score
from tudor_dynamics.identification.validation import Trace
from tudor_dynamics.typing import FloatArray


def hub_gauges(arm: Arm) -> list[int]:
    """Give the gauge nearest to each joint: the paper has one pair a link, close to the hub."""
    nearest: dict[str, int] = {}
    for index, gauge in enumerate(arm.gauges):
        known = nearest.get(gauge.joint)
        if known is None or gauge.distance < arm.gauges[known].distance:
            nearest[gauge.joint] = index
    return sorted(nearest.values())


def read(arm: Arm, paths: Sequence[Path]) -> list[BagData]:
    """
    Read and filter bags as the arm description says.

    Parameters
    ----------
    arm : Arm
        Arm that was recorded.
    paths : sequence of Path
        Directories of the bags.

    """
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', TudorWarning)  # they are our own recordings
        return [load(BagChoice(str(path)), arm, arm.spec.preprocessing) for path in paths]


def training_and_test(paths: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """
    Split recordings into those for training and those for testing.

    Parameters
    ----------
    paths : sequence of Path
        Directories of the bags, in the order of the stimuli.

    """
    middle = len(paths) // 2
    return list(paths[:middle]), list(paths[middle:])


def figures(arm: Arm, output: str, measured: FloatArray, predicted: FloatArray) -> dict[str, Any]:
    """
    Judge a prediction as the table does.

    Parameters
    ----------
    arm : Arm
        Arm that is simulated.
    output : {'effort', 'strain'}
        Output that is judged.
    measured, predicted : ndarray of shape (n_samples, n_channels)
        Output in its units; for strain, of all gauges.

    Returns
    -------
    dict
        ``rmse``, ``sigma_e``, ``fit`` and ``fit_printed`` over the gauges near the hubs (over all
        joints for effort), and ``channels`` with the figures of each channel.

    """
    names = list(arm.active_joints if output == 'effort' else arm.gauge_names)
    chosen = list(range(len(names))) if output == 'effort' else hub_gauges(arm)
    whole = score(measured[:, chosen], predicted[:, chosen], [names[i] for i in chosen])
    every = score(measured, predicted, names)
    return {'samples': whole.samples, 'rmse': whole.rmse, 'sigma_e': whole.sigma_e,
            'fit': whole.fit, 'fit_printed': whole.fit_printed,
            'channels': {name: {'rmse': item.rmse, 'fit': item.fit}
                         for name, item in every.channels.items()}}


def judged(arm: Arm, output: str, traces: Sequence[Trace]) -> dict[str, Any]:
    """
    Judge the traces of several recordings together, as ``figures`` does.

    Parameters
    ----------
    arm : Arm
        Arm that was recorded.
    output : {'effort', 'strain'}
        What was predicted.
    traces : sequence of Trace
        Measured and predicted output of each recording.

    """
    return figures(arm, output, np.vstack([item.measured for item in traces]),
                   np.vstack([item.predicted for item in traces]))
