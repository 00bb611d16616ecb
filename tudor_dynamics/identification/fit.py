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

"""From bags to models with a verdict: the offline tool's main job, without its command line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import warnings

import numpy as np

from tudor_dynamics.arm import Arm, PreprocessingSpec
from tudor_dynamics.errors import check_type, FitError, TudorWarning, UsageError
from tudor_dynamics.identification.bag_facts import BagFacts, facts_of, Unused
from tudor_dynamics.identification.choice.outcome import Choice
from tudor_dynamics.identification.dataset import BagData, common_outputs, OUTPUTS
from tudor_dynamics.identification.elastic.result import Identified
from tudor_dynamics.identification.elastic.trainer import Searches
from tudor_dynamics.identification.finding import Finding
from tudor_dynamics.identification.noise import noise_floor
from tudor_dynamics.identification.ringing import find_ringing, Ringing
from tudor_dynamics.identification.trainers import blank, check_kinds, Trainer, trainer_of
from tudor_dynamics.identification.unseen import Case, Left, left_out, unseen_cases
from tudor_dynamics.identification.validation import (
    random_split, validate, validate_unseen, Validation)
from tudor_dynamics.identification.verdict import judge_model, Verdict
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.estimation.estimators import ESTIMATORS
from tudor_dynamics.models.kinds import KINDS
from tudor_dynamics.models.regressor import STRAIN_FORMS
from tudor_dynamics.typing import FloatArray, Progress


DEFAULT_KINDS = ('analytical',)
"""The elastic model takes longer, and needs to know the links."""


@dataclass(frozen=True)
class FitSettings:
    """
    Choices of a fit.

    Attributes
    ----------
    kinds : tuple of str
        Models to fit, see `models.kinds.KINDS`.
    estimator : {'auto', 'wls', 'ols', 'huber'}
        Estimator of the analytical model; ``auto`` for `choice.choose`, without it wls.
    strain_form : {'exact', 'paper'}
        Where the bending moment is taken.
    shared : bool, optional
        Let currents of unknown torque constants share one set of inertial parameters; by default
        `choice.choose` says whether, without it they do not.
    elm_hidden : int
        Number of hidden neurons.
    elm_ridge : float
        Ridge of the output weights.
    elm_seed : int
        Seed of the hidden layer.
    random_split : bool
        Also report a random 50/50 split of the samples.
    payloads : (float, float) or None
        Least and largest payload of the training bags, for models of all payloads [kg].
    elastic_start : mapping of str to float, optional
        Physical parameters of an arm that is nearly this one, where the search for an elastic
        model begins: ``{p.name: p.value for p in model.physical}`` of its model.

    """

    kinds: tuple[str, ...] = DEFAULT_KINDS
    estimator: str = 'auto'
    strain_form: str = 'exact'
    shared: bool | None = None
    elm_hidden: int = 100
    elm_ridge: float = 1e-6
    elm_seed: int = 0
    random_split: bool = False
    payloads: tuple[float, float] | None = None
    elastic_start: Mapping[str, float] | None = None

    def __post_init__(self) -> None:
        """Refuse kinds, estimators and forms that there are not."""
        check_type(self.kinds, (tuple, list), 'kinds', f'some of {tuple(KINDS)}')
        for name, found, known in (
                ('kinds', self.kinds, tuple(KINDS)),
                ('estimator', [self.estimator], ('auto', *ESTIMATORS)),
                ('strain_form', [self.strain_form], STRAIN_FORMS)):
            unknown = [item for item in found if item not in known]
            if unknown or not found:
                msg = f'{name}: found {unknown or "nothing"}, expected {" or ".join(known)}'
                raise UsageError(msg)

    def settled(self) -> FitSettings:
        """Give the settings with nothing left open: weighted least squares, nothing shared."""
        return replace(self, estimator='wls' if self.estimator == 'auto' else self.estimator,
                       shared=bool(self.shared))


@dataclass(frozen=True, eq=False)
class FittedOutput:
    """A model of one output with all that is known of its worth."""

    output: str  # what it predicts
    kind: str  # what it is, see `models.kinds.KINDS`
    model: Model  # fitted to all training bags; of all payloads where these differ
    training: Validation  # figures on the training data themselves
    validation: Validation  # figures on unseen bags
    random: Validation | None  # figures of the random split
    verdict: Verdict  # may it be used
    unseen: tuple[Case, ...] = ()  # motion with models that have not seen it, for thresholds
    # (channels,): noise of the sensor of each channel in the validation, in its unit; empty where
    # unknown.
    noise: FloatArray = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, eq=False)
class FitResult:
    """All models fitted in one go."""

    arm: Arm
    preprocessing: PreprocessingSpec  # filters and rate of training, and of every later evaluation
    settings: FitSettings  # choices of the fit
    fitted: tuple[FittedOutput, ...]  # one for each output and kind
    # Bags learned from and bags judged by.
    training: tuple[BagData, ...]
    test: tuple[BagData, ...]
    # Vibrations in the strain, or in the effort where there is no strain.
    ringing: tuple[Ringing, ...] = ()
    warnings: tuple[str, ...] = field(default=())  # what is odd about the data
    # What the elastic model found out about the arm, from all training bags.
    elastic: Identified | None = None
    # The same by names of bags, for what was left out as well.
    searches: Searches = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()  # what is wrong with the bags or with the description
    choices: tuple[Choice, ...] = ()  # what was left open and chosen, and what it brought
    # The same models fitted with causal filters, for the robot, where these are zero-phase.
    causal: FitResult | None = None
    # All bags learned from and judged by: more than `training` and `test`, where those are a
    # sample of many.
    learned: tuple[BagFacts, ...] = ()
    judged: tuple[BagFacts, ...] = ()
    unused: tuple[Unused, ...] = ()  # bags that were left out


def fit_models(
    arm: Arm,
    training: Sequence[BagData],
    test: Sequence[BagData],
    holdout: tuple[BagData, BagData] | None,
    preprocessing: PreprocessingSpec,
    settings: FitSettings,
    progress: Progress = lambda _: None,
    known: Searches | None = None,
) -> FitResult:
    """Fit every model to the training bags and validate it."""
    settings = settings.settled()
    check_kinds(settings.kinds, arm, training)
    outputs = common_outputs([*training, *test])
    if not outputs:
        have = {str(bag.choice): [o for o in OUTPUTS if bag.has(o)] for bag in (*training, *test)}
        msg = f'the bags have neither efforts nor strains in common ({have}); fit them apart'
        raise FitError(msg)
    notes = []
    for output in OUTPUTS:
        some = [str(bag.choice) for bag in (*training, *test) if bag.has(output)]
        if some and output not in outputs:
            notes.append(f'only {", ".join(some)} have {output}: no {output} model is fitted')
    for note in notes:
        warnings.warn(note, TudorWarning, stacklevel=2)
    fitted = []
    trainers = {kind: trainer_of(kind, arm, settings, progress,
                                 None if holdout is None else holdout[0], known,
                                 settings.elastic_start)
                for kind in settings.kinds}
    others = left_out(training, preprocessing)
    parts = [training, *([] if test or len(training) < 2 else [known for known, _ in others])]
    for trainer in trainers.values():
        trainer.prepare(parts)
    for output in outputs:
        noise = noise_floor(test or training, output, preprocessing)
        for kind in settings.kinds:
            progress(f'{kind} {output}')
            fitted.append(_fit_one(
                arm, training, test, holdout, others, output, kind, settings, trainers[kind],
                noise))
    ringing: tuple[Ringing, ...] = ()
    rigid = [item for item in fitted if item.kind == 'analytical']
    if rigid:
        last = rigid[-1]
        ringing = find_ringing(last.model, [*training, *test], last.output)
    read = [warning for bag in (*training, *test) for warning in bag.recording.warnings]
    return FitResult(arm, preprocessing, settings, tuple(fitted), tuple(training), tuple(test),
                     ringing, tuple(dict.fromkeys(read + notes)),
                     next((found for trainer in trainers.values()
                           if (found := trainer.identified) is not None), None),
                     {names: found for trainer in trainers.values()
                      for names, found in trainer.searches.items()},
                     learned=tuple(facts_of(bag) for bag in training),
                     judged=tuple(facts_of(bag) for bag in test))


def _fit_one(
    arm: Arm,
    training: Sequence[BagData],
    test: Sequence[BagData],
    holdout: tuple[BagData, BagData] | None,
    others: Sequence[Left],
    output: str,
    kind: str,
    settings: FitSettings,
    trainer: Trainer,
    noise: FloatArray,
) -> FittedOutput:

    def fit_bags(bags: Sequence[BagData]) -> Model:
        return trainer.fit(bags, output)

    def fit_arrays(motion: FloatArray, values: FloatArray) -> Model:
        return blank(kind, arm, output, settings).fit(motion, values)

    model = fit_bags(training)
    validation = validate_unseen(fit_bags, model, training, test, holdout, output)
    seen = validate(model, training, output, 'the training bags themselves')
    # single samples have no past: a model with a memory has no random split
    split = (random_split(fit_arrays, training, output, inputs=model.inputs)
             if settings.random_split and not model.has_memory else None)
    verdict = judge_model(model, validation, seen.score.fit, noise.tolist())
    unseen = unseen_cases(fit_bags, model, validation, others, output)
    return FittedOutput(output, kind, model, seen, validation, split, verdict, unseen, noise)
