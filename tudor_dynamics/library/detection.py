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

"""How well collisions are found in bags, from their names: ``td.detect``."""

from __future__ import annotations

from tudor_dynamics.errors import check_type
from tudor_dynamics.identification.bag_choice import choices, Paths
from tudor_dynamics.identification.collisions.replay import evaluate_collisions, MethodResult
from tudor_dynamics.identification.collisions.truth import find_truth
from tudor_dynamics.identification.dataset import load
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.monitoring.settings import MonitorSettings


def detect(
    bundle: ModelBundle, bags: Paths, settings: MonitorSettings = MonitorSettings(),
) -> list[MethodResult]:
    """
    Let bags with known pushes be watched, as ``tudor evaluate --collisions`` does.

    The pushes are those on the topic ``applied_wrench`` of a bag; without it an event is neither
    right nor false.

    Parameters
    ----------
    bundle : ModelBundle
        Models with collision thresholds, of ``fit`` or ``load_bundle``.
    bags : str, path, or sequence of them
        Bags of the same arm, or parts of them: ``BAG@60-100%``.
    settings : MonitorSettings
        Kind of model and false alarms allowed; every method that there are thresholds for is
        given all of these.

    Returns
    -------
    list of MethodResult
        For each method (``strain``, ``effort``, ``momentum``) its ``score``, the ``watched`` bags
        with events and pushes, and ``roc``: factor on the threshold, false alarms per hour [1/h],
        detection rate.

    Raises
    ------
    TudorError
        If a bag cannot be read, or the models have no thresholds for what it has.

    """
    check_type(bundle, ModelBundle, 'bundle', 'the result of fit or load_bundle')
    check_type(settings, MonitorSettings, 'settings', "such as MonitorSettings(kind='elastic')")
    chosen = choices(bags)
    recordings = [(choice.path, load(choice, bundle.arm, bundle.preprocessing).recording)
                  for choice in chosen]
    return evaluate_collisions(bundle, recordings, settings,
                               [find_truth(path) for path, _ in recordings])
