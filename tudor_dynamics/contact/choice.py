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

"""What estimates contacts of an arm: strain where it has gauges of known scale, else efforts."""

from __future__ import annotations

from collections.abc import Collection

from tudor_dynamics.contact.estimator import ContactEstimator
from tudor_dynamics.contact.torque import TorqueEstimator
from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.bundle import ModelBundle

AnyEstimator = ContactEstimator | TorqueEstimator


def contact_estimator(bundle: ModelBundle, kind: str, methods: Collection[str]) -> AnyEstimator:
    """Choose what estimates contacts."""
    why = []
    if 'strain' in methods:
        try:
            return ContactEstimator(bundle, kind)
        except ModelError as err:
            why.append(str(err))
    if 'momentum' in methods:
        try:
            return TorqueEstimator(bundle)
        except ModelError as err:
            why.append(str(err))
    msg = '; '.join(why) or 'contacts need the methods strain or momentum'
    raise ModelError(msg)
