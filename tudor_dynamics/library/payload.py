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

"""What the arm of a bag carries, from its name: ``td.carried``."""

from __future__ import annotations

from tudor_dynamics.errors import check_type
from tudor_dynamics.identification.bag_choice import choices, Paths
from tudor_dynamics.identification.dataset import load
from tudor_dynamics.identification.worth.carried import payload_of
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.payload.estimate import PayloadEstimate


def carried(bundle: ModelBundle, bags: Paths, *, kind: str | None = None) -> PayloadEstimate:
    """
    Estimate what the arm carries in bags, as ``tudor payload`` does.

    Parameters
    ----------
    bundle : ModelBundle
        Fitted models, of ``fit`` or ``load_bundle``.
    bags : str, path, or sequence of them
        Bags of the same arm with one load, or parts of them: ``BAG@60-100%``.
    kind : {'analytical', 'elastic'}, optional
        Kind of model that tells the load.

    Returns
    -------
    PayloadEstimate
        Mass, place and inertia with standard deviations, as far as the bags show them.

    Raises
    ------
    TudorError
        If a bag cannot be read, or has nothing that the models predict.

    """
    check_type(bundle, ModelBundle, 'bundle', 'the result of fit or load_bundle')
    data = [load(choice, bundle.arm, bundle.preprocessing) for choice in choices(bags)]
    return payload_of(bundle, data, kind)
