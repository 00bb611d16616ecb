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


"""Bags against models: what ``tudor evaluate`` and ``td.predict`` have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TYPE_CHECKING, TypeVar
import warnings

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import check_type, TudorWarning, UsageError
from tudor_dynamics.identification.bag_choice import BagChoice, choices, parse_choice, Paths
from tudor_dynamics.identification.dataset import BagData, common_outputs, load
from tudor_dynamics.identification.validation import validate, Validation
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.units import output_units

if TYPE_CHECKING:
    from matplotlib.figure import Figure

T = TypeVar('T')


@dataclass(frozen=True, eq=False)
class Prediction:
    """What the models of a bundle make of bags."""

    arm: Arm  # arm of the models
    data: tuple[BagData, ...]  # bags, filtered as the models need it
    # Output (`effort`, `strain`) to kind of model to figures and traces.
    outputs: dict[str, dict[str, Validation]]

    def __repr__(self) -> str:
        """Write the fit of each model, one line each."""
        bags = ', '.join(str(bag.choice) for bag in self.data)
        lines = [f'{output} {kind}: fit {item.score.fit:.1f} %'
                 for output, kinds in self.outputs.items() for kind, item in kinds.items()]
        return '\n  '.join([f'Prediction of {self.arm.name} on {bags}', *lines])

    def plot(
        self, path: str | Path | None = None, *, output: str | None = None,
        channel: str | None = None,
    ) -> Figure:
        """
        Draw one channel of the first bag: measured, predicted by each model, and the residual.

        path: only drawn by default; output: strain by default, where it was predicted; channel:
        the first one by default.
        """
        # plots are slow to import, and most predictions are read
        from tudor_dynamics.report.data import liveliest
        from tudor_dynamics.report.figure import write_figure
        from tudor_dynamics.report.plots import ComparedSignal, draw_signal
        from tudor_dynamics.report.roc import picture_path
        from tudor_dynamics.report.style import PAGE, style

        target = None if path is None else picture_path(path)
        output = output or ('strain' if 'strain' in self.outputs else next(iter(self.outputs)))
        kinds = _known(self.outputs, output, 'output')
        first = next(iter(kinds.values()))
        columns = {name: i for i, name in enumerate(first.channels)}
        column = _known(columns, channel or first.channels[0], 'channel')
        name, trace = first.channels[column], first.traces[0]
        series = ComparedSignal(output, name, output_units(self.arm, output)[name], trace.t,
                                trace.measured[:, column],
                                {kind: item.traces[0].predicted[:, column]
                                 for kind, item in kinds.items()})
        with style(PAGE):
            figure = draw_signal(series, liveliest(trace, self.data))
            if target is not None:
                write_figure(figure, target)
        return figure


def _known(items: dict[str, T], name: str, what: str) -> T:
    if name not in items:
        msg = f'there is no {what} {name!r} here; there are {", ".join(items)}'
        raise UsageError(msg)
    return items[name]


def predict_bags(bundle: ModelBundle, data: Sequence[BagData]) -> Prediction:
    """Let every model of a bundle predict bags that were read."""
    outputs = [output for output in common_outputs(data) if output in bundle.models]
    bags = ', '.join(str(bag.choice) for bag in data)
    if not outputs:
        msg = (f'the model predicts {" and ".join(bundle.models)}, which not all of {bags} have: '
               'evaluate them apart, or use other bags')
        raise UsageError(msg)
    return Prediction(bundle.arm, tuple(data), {
        output: {kind: validate(model, data, output, bags)
                 for kind, model in bundle.models[output].items()} for output in outputs})


def warn_of_training(bundle: ModelBundle, data: Sequence[BagData]) -> list[str]:
    """Warn of bags that a model was trained on."""
    seen = _trained_on(bundle.facts, data)
    if seen:
        msg = (f'{", ".join(seen)}: the model was trained on this; how well it does there is no '
               'test')
        warnings.warn(msg, TudorWarning, stacklevel=3)
    return seen


def _trained_on(facts: Mapping[str, Any], bags: Sequence[BagData]) -> list[str]:
    """Name those bags that have samples of a training bag, by checksum, under whatever names."""
    training = facts.get('training')
    known = [(item['sha256'], parse_choice(str(item.get('bag')))) for item in
             (training if isinstance(training, list) else ())
             if isinstance(item, dict) and item.get('sha256')]
    return [str(bag.choice) for bag in bags if any(
        bag.recording.checksum == checksum and bag.choice.overlaps(choice)
        for checksum, choice in known)]


def predict(bundle: ModelBundle, bags: Paths, *, payload: float | None = None) -> Prediction:
    """
    Compare models with what bags have measured, as ``tudor evaluate`` does.

    Parameters
    ----------
    bundle : ModelBundle
        Fitted models, of ``fit`` or ``load_bundle``.
    bags : str, path, or sequence of them
        Bags of the same arm, or parts of them: ``BAG@60-100%``.
    payload : float, optional
        Mass at the tip, in place of what the metadata of the bags say [kg].

    Returns
    -------
    Prediction
        Figures and traces of each model; ``plot`` draws them.

    Raises
    ------
    TudorError
        If a bag cannot be read, has nothing that the models predict, or its payload is unknown.

    """
    check_type(bundle, ModelBundle, 'bundle', 'the result of fit or load_bundle')
    if payload is not None:
        bundle.at(payload)  # says so if it is no use
    chosen: list[BagChoice] = choices(bags)
    data = [load(choice, bundle.arm, bundle.preprocessing, payload=payload) for choice in chosen]
    found = predict_bags(bundle, data)
    warn_of_training(bundle, data)
    return found
