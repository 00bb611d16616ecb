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

"""The model bundle: models of one arm by kind, and all that is known of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import Model, SAME
from tudor_dynamics.models.elastic.model import ElasticModel
from tudor_dynamics.models.elm import ExtremeLearningMachine
from tudor_dynamics.models.flexible_tool import FlexibleTool
from tudor_dynamics.typing import Shown


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


@dataclass(frozen=True, eq=False)
class CausalModels:
    """Models fitted with causal filters, as they run beside the robot."""

    preprocessing: PreprocessingSpec  # filters and rate
    models: dict[str, dict[str, Model]]  # as those of `ModelBundle`


@dataclass(eq=False)
class ModelBundle(Shown):
    """
    Models of one arm, with the preprocessing that they were fitted to.

    Attributes
    ----------
    arm : Arm
        Arm that the models belong to.
    preprocessing : PreprocessingSpec
        Filters and rate.
    models : dict of str to dict of str to model
        Output (``effort``, ``strain``) to kind, see `KINDS`, to model.
    facts : dict
        What else is known: training bags with checksums, validation figures, verdicts,
        thresholds. Plain values only.
    causal : CausalModels or None
        The models for the robot, where ``models`` were fitted with filters that look ahead.
    digest : str
        Checksum of the file that they were read from; empty for others.
    tool : FlexibleTool or None
        What rings at the flange, where that was fitted.

    """

    arm: Arm
    preprocessing: PreprocessingSpec
    models: dict[str, dict[str, Model]]
    facts: dict[str, Any] = field(default_factory=dict)
    causal: CausalModels | None = None
    digest: str = ''
    tool: FlexibleTool | None = None

    def __post_init__(self) -> None:
        """Let the strain model correct the effort model that was fitted with it."""
        effort, strain = elastic_of(self, 'effort'), elastic_of(self, 'strain')
        if effort and strain:
            effort.strain_model = strain

    def __repr__(self) -> str:
        """Write the models with their verdict and their fit on unseen bags, one line each."""
        found = self.facts.get('validation')
        judged = found if isinstance(found, dict) else {}
        lines = [f'ModelBundle of {self.arm.name}']
        if self.payload_range is not None:
            lines[0] += ', payloads from {:g} to {:g} kg'.format(*self.payload_range)
        for output, kinds in self.models.items():
            for kind, model in kinds.items():
                line = f'  {output} {kind}: {", ".join(model.channels)}'
                try:
                    facts = judged[output][kind]
                    line += (f'; fit {facts["validation"]["fit"]:.1f} % ({facts["method"]}): '
                             f'{facts["verdict"]}')
                except (KeyError, TypeError, ValueError):
                    pass  # of a bundle made by hand, of which nothing is known
                lines.append(line)
        lines += [] if self.tool is None else [f'  tool: {self.tool}']
        return '\n'.join(lines)

    def beside_robot(self) -> ModelBundle:
        """Give the bundle as it predicts beside the robot: with its causal models, if any."""
        if self.causal is None:
            return self
        return replace(self, preprocessing=self.causal.preprocessing, models=self.causal.models,
                       causal=None)

    @property
    def payload_range(self) -> tuple[float, float] | None:
        """Give the loads that the models were fitted to [kg]; None where they know of none."""
        ranges = (model.payload_range for kinds in self.models.values()
                  for model in kinds.values())
        return next((found for found in ranges if found is not None), None)

    @property
    def payload(self) -> float | None:
        """Load of all training bags [kg]; None if unknown, different, or if models take any."""
        bags = self.facts.get('training')
        if self.payload_range is not None or not isinstance(bags, list) or not bags:
            return None
        found = [bag.get('payload') if isinstance(bag, dict) else None for bag in bags]
        masses = [float(mass) for mass in found if isinstance(mass, (int, float))]
        if len(masses) < len(found) or not max(masses) - min(masses) < SAME:
            return None
        return masses[0]

    def at(self, payload: float) -> ModelBundle:
        """
        Give models of the motion alone for a mass [kg] at the tip.

        This bundle itself where its models are of one load and that, or none (0), is asked for; a
        ModelError if another one is.
        """
        if self.payload_range is None:
            known = self.payload
            if payload == 0.0 or (known is not None and abs(payload - known) < SAME):
                return self
            what = ('one payload of unknown mass; give none' if known is None else
                    f'one payload of {known:g} kg; give that one')
            raise ModelError(f'the model cannot predict for a payload of {payload:g} kg: it was '
                             f'fitted to {what}, or fit a model to bags with several payloads '
                             '(tudor fit BAGS --payload-of BAG=KG ...)')
        causal = self.causal
        if causal is not None:
            causal = replace(causal, models=_at(causal.models, payload))
        return replace(self, models=_at(self.models, payload), causal=causal)

    def mass_at(self, payload: float) -> float:
        """Give the mass at the tip that the models assume there: that asked for, or their own."""
        return payload if self.payload_range is not None else self.payload or 0.0


def _at(models: dict[str, dict[str, Model]], payload: float) -> dict[str, dict[str, Model]]:
    return {output: {kind: model if model.payload_range is None else model.at(payload)
                     for kind, model in kinds.items()}
            for output, kinds in models.items()}


def elastic_of(bundle: ModelBundle, output: str) -> ElasticModel | None:
    """Find the elastic model of an output; None where there is no such model in the bundle."""
    model = bundle.models.get(output, {}).get('elastic')
    return model if isinstance(model, ElasticModel) else None


def tool_of(bundle: ModelBundle) -> FlexibleTool:
    """Give the flexible tool of a bundle, or say how to learn it."""
    if bundle.tool is None:
        raise ModelError('the model knows no flexible tool', remedy='run `tudor fit --models '
                         'analytical vibration` on bags of motion with rests of three seconds')
    return bundle.tool
