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
Elastic model: strain and effort of a flexible arm with its oscillation in them.

Where the analytical model takes the links as rigid, this one lets them bend: the equivalent
rigid-link system of Gasparetto et al., its joints driven by measured positions through elastic
gears, carries the oscillation as its own state.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.elastic.effort import friction_jumps
from tudor_dynamics.models.elastic.fitted import FittedElastic, PhysicalParameter
from tudor_dynamics.models.elastic.io import elastic_from_dict, elastic_to_dict
from tudor_dynamics.models.elastic.live import LiveElastic
from tudor_dynamics.models.payload import check_payload
from tudor_dynamics.signals import Stretch
from tudor_dynamics.typing import FloatArray


class ElasticModel(FittedElastic, Model):
    """Strain or effort of an elastic arm; see ``FittedElastic`` for what it is made of."""

    def follow(self, stretch: Stretch) -> FloatArray:
        """Follow a stretch from rest, or out of the motion just before; see ``Model``."""
        return self.along(stretch.motion, stretch.dt, stretch.before)

    def observe(
        self, stretch: Stretch, strain_model: Model | None = None, observer: str = 'ringing',
    ) -> FloatArray:
        """Predict each sample from the strain measured until the sample before; see ``Model``."""
        strain_model = self if self.output == 'strain' else strain_model
        if stretch.strain is None or observer == 'off' or strain_model is None:
            return self.follow(stretch)
        live = type(strain_model).live({self.output: self, 'strain': strain_model}, observer)
        motion, dt = stretch.motion, stretch.dt
        dt[0] = 0.0  # an observer begins anew
        predicted = np.full((len(motion), len(self.channels)), np.nan)
        for k in range(len(motion)):
            values = live.step(float(dt[k]), motion[k])
            if values is not None:
                predicted[k] = values[self.output]
            live.measure(stretch.strain[k])
        return predicted

    def stiction(self, q: FloatArray) -> FloatArray:
        """Give what the friction terms of each joint jump by; see ``Model``."""
        if self.output != 'effort' or self.coefficients_ is None:
            return super().stiction(q)
        return friction_jumps(self.arm, self.coefficients_)

    def at(self, payload: float) -> ElasticModel:
        """Put a payload in; see ``Model``."""
        if self.payload_range is not None:
            check_payload(payload, self.payload_range)
        kept = tuple(p for p in self.physical if p.name != 'payload')
        model = ElasticModel(self.arm, self.output,
                             (*kept, PhysicalParameter('payload', payload, 'kg')))
        model.coefficients_, model.standard_errors_ = self.coefficients_, self.standard_errors_
        model.noise_ = self.noise_
        return model

    @classmethod
    def live(cls, models: Mapping[str, ElasticModel], observer: str = 'off') -> LiveElastic:
        """Let effort and strain share an arm, observed only with strain; see ``Model``."""
        return LiveElastic(models, observer if 'strain' in models else 'off')

    def to_dict(self, arm: Arm, output: str) -> dict[str, Any]:
        """Give physical parameters and the coefficients of each channel; see ``Model``."""
        return elastic_to_dict(self)

    @classmethod
    def from_dict(cls, content: dict[str, Any], arm: Arm, output: str) -> ElasticModel:
        """Build it from physical parameters and coefficients; see ``Model``."""
        return elastic_from_dict(cls, content, arm, output)


def elastic_of(bundle: ModelBundle, output: str) -> ElasticModel | None:
    """
    Find the elastic model of an output.

    Returns None where there is no such model in the bundle.
    """
    model = bundle.models.get(output, {}).get('elastic')
    return model if isinstance(model, ElasticModel) else None
