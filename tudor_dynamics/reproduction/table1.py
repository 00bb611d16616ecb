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

"""Table I: all cells of ours and of the paper, and what they come to."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from tudor_dynamics.arm import Arm
from tudor_dynamics.identification.dataset import OUTPUTS
from tudor_dynamics.models.kinds import KINDS
from tudor_dynamics.models.units import output_units
from tudor_dynamics.reproduction.elastic_fits import KIND
from tudor_dynamics.reproduction.fits import Fits
from tudor_dynamics.reproduction.judging import hub_gauges
from tudor_dynamics.reproduction.one_model import one_model
from tudor_dynamics.reproduction.plan import grams
from tudor_dynamics.reproduction.table1_claims import (
    Cell, findings, PaperClaim, PARTS, TableBlock, TableRow, TITLES)
import yaml

MODELS = tuple(KINDS)
"""Columns, whether a kind of model is there or not."""
PRINTED = ('analytical', 'elm')
"""Those of them that the paper has."""
LABELS = {name: kind.label for name, kind in KINDS.items()}
FIGURES = ('rmse', 'sigma_e', 'fit_printed', 'fit')


@dataclass(frozen=True)
class Shared:
    """
    Test fits of one output and model: separate models, and one for all [%].

    Attributes
    ----------
    output : str
        Output, ``effort`` or ``strain``.
    model : str
        Kind of model.
    separate : dict of float to float or None
        Payload [kg] to fit of a model of its own [%].
    together : dict of float to float or None
        Payload [kg] to fit of the one model [%].

    """

    output: str
    model: str
    separate: dict[float, float | None]
    together: dict[float, float | None]


@dataclass(frozen=True)
class Table1:
    """
    The whole table.

    Attributes
    ----------
    split : str
        How training and test were told apart.
    blocks : tuple of TableBlock
        Strain, then current.
    shared : tuple of Shared
        One model for all payloads beside separate ones.
    trained_at : tuple of float
        Payloads that the one model was fitted to [kg].
    findings : tuple of PaperClaim
        The expected shape.
    remarks : tuple of str
        On how ours were fitted.
    notes : tuple of str
        On the paper's figures.
    source : str
        Of the paper's figures.

    """

    split: str
    blocks: tuple[TableBlock, ...]
    shared: tuple[Shared, ...]
    trained_at: tuple[float, float]
    findings: tuple[PaperClaim, ...]
    remarks: tuple[str, ...]
    notes: tuple[str, ...]
    source: str


@lru_cache
def published() -> dict[str, Any]:
    """Give the paper's figures."""
    text = (Path(__file__).parent / 'published.yaml').read_text(encoding='utf-8')
    content: dict[str, Any] = yaml.safe_load(text)
    return content


def _paper(output: str, model: str, part: str, payload: float) -> dict[str, float]:
    for *place, rmse, sigma_e, printed in published()['cells']:
        if place == [output, part, round(1000 * payload), model]:
            return {'rmse': rmse, 'sigma_e': sigma_e, 'fit_printed': printed}
    return {}


def _cell(output: str, model: str, part: str, payload: float, content: dict[str, Any]) -> Cell:
    paper = _paper(output, model, part, payload)
    found = content.get(output, {}).get(model)
    if found is None:
        return Cell(None, None, None, None, paper)
    values = [float(found[part][name]) for name in FIGURES]
    return Cell(values[0], values[1], values[2], values[3], paper)


def build(fits: Fits, split: str) -> Table1:
    """
    Compute the table, or put it together from what was computed before.

    Parameters
    ----------
    fits : Fits
        Stages that the table is made of.
    split : {'stimulus', 'random'}
        How training and test are told apart.

    Returns
    -------
    Table1
        All cells.

    """
    plan, arm = fits.campaign.plan, fits.campaign.arm
    separate = {payload: fits.separate(payload, split=split).content for payload in plan.payloads}
    honest = separate if split == 'stimulus' else {
        payload: fits.separate(payload).content for payload in plan.payloads}
    together = one_model(fits)
    blocks = tuple(_block(arm, output, separate) for output in ('strain', 'effort'))
    shared = []
    for output in ('strain', 'effort'):
        for model in MODELS:
            shared.append(Shared(
                output, model,
                {payload: _test_fit(content.get(output, {}).get(model, {}).get('test'))
                 for payload, content in honest.items()},
                {payload: _test_fit(together[grams(payload)].get(output, {}).get(model))
                 for payload in plan.payloads}))
    return Table1(split, blocks, tuple(shared), (min(plan.payloads), max(plan.payloads)),
                  tuple(findings(blocks)), _remarks(fits, split), tuple(published()['notes']),
                  published()['source'])


def _remarks(fits: Fits, split: str) -> tuple[str, ...]:
    plan = fits.campaign.plan
    if KIND not in plan.kinds:
        return ()
    if split == 'random':
        return ('The elastic model has a memory and no random split; beside the one model of all '
                'payloads it stands with half of the stimuli.',)
    count, of = fits.stimuli_for_search(), plan.stimuli // 2
    return (f'The elastic model is identified from {count} of the {of} training stimuli of each '
            f'payload ({count * plan.seconds:g} of {of * plan.seconds:g} s), and its training '
            'figures are those of these; it is tested on the same stimuli as the other models.',)


def _block(arm: Arm, output: str, separate: dict[float, dict[str, Any]]) -> TableBlock:
    assert output in OUTPUTS
    units = set(output_units(arm, output).values())
    sample = next(iter(next(iter(separate.values()))[output].values()))['training']
    hubs = tuple(sample['channels'])
    if output == 'strain':
        hubs = tuple(arm.gauge_names[i] for i in hub_gauges(arm))
    rows = tuple(
        TableRow(payload, part, {model: _cell(output, model, part, payload, content)
                                 for model in MODELS})
        for part in PARTS for payload, content in separate.items())
    unit = units.pop() if len(units) == 1 else 'mixed'
    return TableBlock(output, TITLES[output], unit, hubs, rows)


def _test_fit(figures: dict[str, Any] | None) -> float | None:
    return None if figures is None else float(figures['fit'])
