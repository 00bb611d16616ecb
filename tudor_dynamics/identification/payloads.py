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

"""Which payload each bag was recorded with, and models that know of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import UsageError
from tudor_dynamics.identification.dataset import BagChoice, BagData
from tudor_dynamics.models.base import OutputModel
from tudor_dynamics.models.elastic.model import ElasticModel
from tudor_dynamics.models.payload import (
    payload_regressor, PayloadELM, PayloadModel, Range, SAME)
from tudor_dynamics.models.regressor import EffortRegressor, StrainRegressor

PAYLOAD_KINDS = ('analytical', 'elm', 'elastic')
"""Kinds of models that can be fitted to several payloads at once."""


def parse_payloads(texts: Sequence[str], choices: Sequence[BagChoice]) -> dict[str, float]:
    """
    Read ``BAG=KG`` arguments.

    Parameters
    ----------
    texts : sequence of str
        Arguments of the command line.
    choices : sequence of BagChoice
        Bags of the command.

    Returns
    -------
    dict of str to float
        Resolved path of each bag to its payload [kg].

    Raises
    ------
    UsageError
        If it is no bag of the command, or no mass.

    """
    known = {str(Path(choice.path).resolve()) for choice in choices}
    found = {}
    for text in texts:
        path, mark, number = text.rpartition('=')
        try:
            mass = float(number)
        except ValueError:
            mass = -1.0
        if not mark or not 0.0 <= mass < float('inf'):
            msg = (f'--payload-of {text}: expected BAG=KG with a mass of 0 or more, such as '
                   'run1=0.2')
            raise UsageError(msg)
        resolved = str(Path(path).resolve())
        if resolved not in known:
            msg = f'--payload-of {text}: {path} is none of the bags of this command'
            raise UsageError(msg)
        found[resolved] = mass
    return found


def payload_range(training: Sequence[BagData], test: Sequence[BagData]) -> Range | None:
    """
    Find the payloads of a fit.

    Parameters
    ----------
    training, test : sequence of BagData
        Bags to learn from and bags to judge by.

    Returns
    -------
    (float, float) or None
        Least and largest payload of the training bags [kg]; None where they do not differ.

    Raises
    ------
    UsageError
        If training bags differ in payload, and that of another bag is not known.

    """
    masses = [bag.payload for bag in training if bag.payload is not None]
    if not masses or max(masses) - min(masses) < SAME:
        return None
    unknown = [str(bag.choice) for bag in (*training, *test) if bag.payload is None]
    if unknown:
        msg = (f'the training bags have payloads of {min(masses):g} to {max(masses):g} kg, but '
               f'that of {", ".join(unknown)} is not known: say so with --payload-of BAG=KG, or '
               'use --ignore-payload')
        raise UsageError(msg)
    return min(masses), max(masses)


def new_payload_model(
    arm: Arm, output: str, kind: str, payloads: Range, *, estimator: str, strain_form: str,
    hidden: int, ridge: float, seed: int,
) -> PayloadModel | PayloadELM:
    """
    Build a model of all payloads that is not fitted yet.

    Parameters
    ----------
    arm : Arm
        Arm that was recorded.
    output : {'effort', 'strain'}
        What the model predicts.
    kind : {'analytical', 'elm'}
        Kind of model.
    payloads : (float, float)
        Least and largest payload of the training bags [kg].
    estimator, strain_form, hidden, ridge, seed
        As in `FitSettings`.

    Returns
    -------
    PayloadModel or PayloadELM
        Model to be fitted.

    """
    if kind == 'elm':
        channels = arm.active_joints if output == 'effort' else arm.gauge_names
        return PayloadELM(channels, payloads, hidden=hidden, ridge=ridge, seed=seed)
    plain = EffortRegressor(arm) if output == 'effort' else StrainRegressor(arm, strain_form)
    return PayloadModel(payload_regressor(plain, arm), len(arm.active_joints), payloads,
                        estimator=estimator)


def model_for(model: OutputModel, bag: BagData) -> OutputModel:
    """Put the payload of a bag into a model that knows of payloads; others stay as they are."""
    if isinstance(model, (ElasticModel, PayloadModel, PayloadELM)) and (
            model.payload_range is not None):
        if bag.payload is None:
            msg = (f'{bag.choice}: its payload is not known, and the model needs it: give '
                   '--payload KG, or --payload-of BAG=KG')
            raise UsageError(msg)
        return model.at(bag.payload)
    return model
