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

from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.elastic.model import ElasticModel
from tudor_dynamics.models.elm import ExtremeLearningMachine


@dataclass(frozen=True)
class Kind:
    """A kind of model."""

    label: str  # what tables and legends call it
    model: type[Model]  # its class
    compared: bool = False  # whether verdicts go by the others, where there are others


KINDS: dict[str, Kind] = {
    'analytical': Kind('analytical', AnalyticalModel),
    'elm': Kind('ELM', ExtremeLearningMachine, compared=True),
    'elastic': Kind('elastic', ElasticModel)}
"""Kinds by the names that commands, parameters and bundles use."""
