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

"""The kinds of models that there are: a new one is a file with its class, and an entry here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.analytical import AnalyticalModel, PayloadModel
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.elastic.model import ElasticModel
from tudor_dynamics.models.elm import ExtremeLearningMachine, PayloadELM


@dataclass(frozen=True)
class Kind:
    """A kind of model."""

    label: str  # what tables and legends call it
    model: type[Model]  # its class for bags of one load
    # Its class for bags of several loads; None where it cannot be fitted to them.
    of_loads: type[Model] | None = None
    # Whether it is there for comparison, so that no verdict depends on it while others are.
    compared: bool = False

    def from_content(self, content: dict[str, Any]) -> type[Model]:
        """Say which class the content of a bundle is of: of all loads where it has a range."""
        made = self.of_loads if 'payload_range' in content else self.model
        if made is None:
            msg = f'{self.label}: a range of payloads, of which this kind of model knows nothing'
            raise ModelError(msg)
        return made


KINDS: dict[str, Kind] = {
    'analytical': Kind('analytical', AnalyticalModel, PayloadModel),
    'elm': Kind('ELM', ExtremeLearningMachine, PayloadELM, compared=True),
    'elastic': Kind('elastic', ElasticModel, ElasticModel)}
"""Kinds by the names that commands, parameters and bundles use."""
