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

"""From datasets to fitted and judged models."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
import math
from typing import Any
import warnings

import numpy as np

from tudor_dynamics.arm.description import Arm, OUTPUTS
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import (
    check_type, FitError, SignalError, TudorError, TudorWarning, UsageError)
from tudor_dynamics.identification.dataset import (
    BagData, BagFacts, common_outputs, facts_of, model_for, part, training_blocks, Unused)
from tudor_dynamics.identification.doctor.findings import Finding
from tudor_dynamics.identification.elastic_problem import Identified, Record, record_of, records_of
from tudor_dynamics.identification.elastic_search import identify, taken_over
from tudor_dynamics.identification.ringdowns import find_ringing, Ringing
from tudor_dynamics.identification.validation import (
    Case, cases_of, judge, method_of, noise_floor, validated, Validation, Verdict)
from tudor_dynamics.models.base import MemorylessModel, Model, ModelSettings, Range
from tudor_dynamics.models.bundle import KINDS
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.models.elastic.model import (
    driven_arm, effort_rows, ElasticModel, follow_stretch, PhysicalParameter)
from tudor_dynamics.models.estimation import ESTIMATORS
from tudor_dynamics.models.regressor import STRAIN_FORMS
from tudor_dynamics.parallel import shared_out
from tudor_dynamics.typing import FloatArray, Progress


# -- What was chosen, and what it brought: for people and for files

@dataclass(frozen=True)
class Choice:
    """One thing that was left open."""

    what: str  # what was to be chosen
    # What it came to, and what it is compared with, in words.
    chosen: str
    instead: str
    # Relative error on the parts that were left out, with the one and with the other [%].
    error: float
    error_instead: float

    def __str__(self) -> str:
        """Write what was chosen and what it brought."""
        if self.chosen == self.instead:
            return f'{self.what}: {self.chosen} (nothing else is better)'
        return (f'{self.what}: {self.chosen} ({self.error:.1f} % error on parts left out, with '
                f'{self.instead} {self.error_instead:.1f} %)')


def choices_to_list(made: Sequence[Choice]) -> list[dict[str, Any]]:
    """Give choices as plain values, for JSON and bundles."""
    return [{**asdict(choice), 'error': round(choice.error, 3),
             'error_instead': round(choice.error_instead, 3)} for choice in made]


# -- Free motion that a model has not seen, as much of it as thresholds want.
#
# What a model is judged by is often short: one test bag, or the end of an only one. The residuals
# of a threshold may come from training bags as well, each predicted by a model of the others.

Left = tuple[list[BagData], BagData]
ENOUGH = 160.0  # motion of which thresholds hardly profit from more [s]
PARTS = 5  # into which an only bag is cut
SHORTEST = 4.0  # parts shorter than this lose too much at their ends, in which filters settle [s]


def left_out(
    training: Sequence[BagData], preprocessing: PreprocessingSpec, *, loads: bool = False,
) -> list[Left]:
    """Leave out each training bag once; of an only bag, or the only one of its load, each part."""
    # what is left out has to be like what is learned from: with a load that nothing else shows, a
    # model of all loads would be judged by what it cannot know
    found: list[Left] = []
    for i, bag in enumerate(training):
        others = [*training[:i], *training[i + 1:]]
        alone = not others or loads and bag.payload not in [other.payload for other in others]
        count = min(PARTS, int(bag.recording.t[-1] / SHORTEST)) if alone else 1
        if count < 2:
            found += [(others, bag)] * bool(others)
            continue
        for k in range(count):
            begin, end = k / count, (k + 1) / count
            try:
                rest = [part(bag, *piece, preprocessing)
                        for piece in ((0.0, begin), (end, 1.0)) if piece[0] < piece[1]]
                found.append(([*others, *rest], part(bag, begin, end, preprocessing)))
            except (SignalError, UsageError):
                continue  # a part in which nothing is long enough, or nothing was recorded
    return found


def unseen_cases(
    fit: Callable[[Sequence[BagData]], Model], model: Model, validation: Validation,
    others: Sequence[Left],
) -> tuple[Case, ...]:
    """Collect bags with models that have not seen them, until there is enough motion."""
    left = {bag.choice.path for _, bag in others}
    again = left <= {bag.choice.path for _, bag in validation.cases}
    if model.has_memory or again and len(left) > 1:
        return validation.cases  # each was left out already
    return enough(((model_for(fit(known), bag), bag) for known, bag in others),
                  () if left and again else validation.cases)


def enough(more: Iterable[Case], kept: Sequence[Case] = ()) -> tuple[Case, ...]:
    """Add bags with their models to those that are kept, until there is enough motion."""
    cases, rest = list(kept), iter(more)
    while (sum(float(bag.recording.t[-1]) for _, bag in cases) < ENOUGH
           and (case := next(rest, None)) is not None):
        cases.append(case)
    return tuple(cases)


# -- How each kind of model is fitted to bags: most from rows, some from whole stretches

@dataclass(eq=False)
class RowTrainer:
    """Fits models without a memory to what parts of the data, such as bags, come to."""

    kind: str
    arm: Arm
    settings: ModelSettings
    # Of an analytical model, by output, part, and whether they have triangular factors; parts that
    # are there already need no data.
    sums: dict[str, dict[tuple[str, bool], Any]] = field(default_factory=dict)

    def fit(self, bags: Sequence[BagData], output: str) -> MemorylessModel:
        """Fit the model of one output to bags."""
        kind = KINDS[self.kind].model
        assert issubclass(kind, MemorylessModel)
        model = kind.new(self.arm, output, self.settings)
        return model.fit_parts(
            {str(bag.choice): training_blocks([bag], output, model) for bag in bags},
            self.sums.setdefault(output, {}))


ELASTIC = 'elastic'  # the kind that learns from whole stretches; rows do for all others
UNTOLD = 0.2  # relative standard error beyond which a stiffness is not identifiable
Searches = Mapping[tuple[str, ...], Identified]  # names of bags to what was found of them


def check_arm(arm: Arm) -> None:
    """Refuse an arm of which no elastic model can be made, before hours of work and not after."""
    if arm.coupling is not None:
        raise FitError(f"{arm.source}: the elastic model does not support the key 'couplings'; "
                       'remove that key, or leave elastic out of models=')
    if not arm.gauges:
        raise FitError(f'{arm.source}: the description has no gauges, which the elastic model '
                       "needs; add the key 'gauges', or leave elastic out of models=")
    try:
        DrivenArm(arm)
    except TudorError as err:
        raise FitError(f'{err}, or leave elastic out of models=') from None


def _tell(arm: Arm, found: Identified) -> None:
    """Warn where strain does not separate a gear from the link after it."""
    values = {p.name: p for p in found.physical}
    for joint in arm.active_joints:
        both = {f'gear({joint})', f'bending({joint})'}
        if both <= {*values} and (both & {*found.untold} or any(
                not p.shown and p.standard_error > UNTOLD * p.value
                for p in map(values.__getitem__, both))):
            single = sum(gauge.joint == joint for gauge in arm.gauges) < 2
            msg = (f'arm {arm.name!r}: strain in these bags does not show how much the gear of '
                   f'{joint!r} bends and how much the link after it; predictions hold on similar '
                   'motion, the stiffness of either does not: give motors[].stiffness'
                   + (', or a second gauge on the link' if single else ', or other motion'))
            warnings.warn(msg, TudorWarning, stacklevel=2)


def _names(bags: Sequence[BagData]) -> tuple[str, ...]:
    return tuple(str(bag.choice) for bag in bags)


def _searched(
    arm: Arm, records: list[Record], warm: dict[str, float] | None, known: Identified | None,
    progress: Progress,
) -> Identified:
    """Search in bags; also a worker of a cluster can do it."""
    if known is not None:
        return taken_over(arm, records, known)
    return identify(arm, records, warm=warm, progress=progress)


@dataclass(eq=False)
class ElasticTrainer:
    """
    Fits elastic models to all bags, then to parts of them, each as if it had seen nothing else.

    A search from nothing takes three times as long as one that begins nearly right. It may begin
    where that for less ended, if that lies within what it is given: for all bags the part that is
    kept where the rest is held out, for some of the bags a half of all. So nothing that is left
    out to judge a model by has a hand in it.
    """

    arm: Arm
    payload_range: Range | None = None
    progress: Progress = lambda _: None
    warm: Mapping[str, float] | None = None  # where each search begins
    kept: Sequence[BagData] = ()  # part of an only bag, whose rest is held out
    known: Searches = field(default_factory=dict)  # searches of the same bags by other filters
    searches: dict[tuple[str, ...], Identified] = field(default_factory=dict)
    _all: Sequence[BagData] = ()

    def fit(self, bags: Sequence[BagData], output: str) -> ElasticModel:
        """Fit the model of one output."""
        self.prepare([bags])
        found = self.searches[_names(bags)]
        payload, physical = bags[0].payload, found.physical
        if self.payload_range is None and payload is not None and all(
                bag.payload == payload for bag in bags):
            physical = (*physical, PhysicalParameter('payload', payload, 'kg'))
        model = ElasticModel(self.arm, output, physical, payload_range=self.payload_range)
        if output == 'strain':
            model.coefficients_ = tuple(found.gauges)
            model.standard_errors_ = tuple(found.gauge_errors)
            model.noise_ = found.noise
        else:
            model.strain_model = self.fit(bags, 'strain')
            self._effort(model, bags)
        return model

    def prepare(self, parts: Sequence[Sequence[BagData]]) -> None:
        """Search for all that is going to be asked, several searches at a time."""
        self._all = self._all or parts[0]
        whole = _names(self._all)
        wanted = [bags for bags in parts if _names(bags) not in self.searches]
        # first what others begin from, and what begins from nothing
        for some in ([self._less(bags) or bags for bags in wanted], wanted):
            todo = {_names(bags): bags for bags in some if _names(bags) not in self.searches}
            searches = [partial(_searched, self.arm, records_of(bags), self._begin(bags),
                                self.known.get(key)) for key, bags in todo.items()]
            self.searches.update(zip(todo, shared_out(searches, self.progress), strict=True))
            if whole in todo and whole not in self.known:  # otherwise it was reported
                _tell(self.arm, self.searches[whole])

    def _less(self, bags: Sequence[BagData]) -> Sequence[BagData]:
        """Say which of the bags a search is done for before; none where it begins from nothing."""
        if self.warm is not None or _names(bags) in self.known:
            return ()
        middle = len(self._all) // 2
        less: Sequence[BagData] = ()
        if _names(bags) == _names(self._all):
            less = self.kept
        elif middle:
            less = next((half for half in (self._all[:middle], self._all[middle:])
                         if {*_names(half)} < {*_names(bags)}), ())
        # none, or too short a part of what is long enough
        enough = any(record_of(stretch, None) for bag in less for stretch in bag.stretches)
        return less if enough else ()

    def _begin(self, bags: Sequence[BagData]) -> dict[str, float] | None:
        """Say where a search begins, by nothing but the bags it is given."""
        if self.warm is not None:
            return dict(self.warm)
        less = self._less(bags)
        return {p.name: p.value for p in self.searches[_names(less)].physical} if less else None

    def _effort(self, model: ElasticModel, bags: Sequence[BagData]) -> None:
        """Regress the efforts on torque of the gear, acceleration and friction."""
        driven = driven_arm(self.arm, model.values)
        rows: list[list[FloatArray]] = []
        efforts: list[FloatArray] = []
        for bag in bags:
            if self.payload_range is not None and bag.payload is not None:
                driven.set_parameters({'payload': bag.payload})
            for stretch in bag.stretches:
                response = follow_stretch(driven, stretch, model.gauges)
                made = effort_rows(model.arm, response, stretch.motion)
                rows.append([stretch.decimation(columns) for columns in made])
                assert stretch.effort is not None
                efforts.append(stretch.decimation(stretch.effort))
        effort = np.vstack(efforts)
        values, errors, noises = [], [], []
        for i, columns in enumerate(map(np.vstack, zip(*rows, strict=True))):
            size = np.linalg.norm(columns, axis=0)
            size[size == 0.0] = 1.0
            scaled = columns / size
            solution, _, rank, _ = np.linalg.lstsq(scaled, effort[:, i], rcond=1e-8)
            left = effort[:, i] - scaled @ solution
            noise = float(left @ left) / max(len(left) - int(rank), 1)
            covariance = np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True) * noise
            noises.append(math.sqrt(noise))
            values.append(solution / size)
            errors.append(np.array([math.sqrt(max(v, 0.0)) for v in np.diag(covariance)]) / size)
        model.coefficients_, model.standard_errors_ = tuple(values), tuple(errors)
        model.noise_ = np.array(noises)


# -- From bags to models with a verdict: the offline tool's main job, without its command line

DEFAULT_KINDS = ('analytical',)  # the elastic model takes longer, and needs to know the links


@dataclass(frozen=True, repr=False)
class FitSettings(ModelSettings):
    """
    Choices of a fit.

    Attributes
    ----------
    kinds : tuple of str
        Models to fit, see `models.bundle.KINDS`.
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
    payloads : (float, float) or None
        Least and largest payload of the training bags, for models of all payloads [kg].
    tool : bool
        Learn also how a flexible tool at the flange rings after motion.
    elastic_start : mapping of str to float, optional
        Physical parameters of an arm that is nearly this one, where the search for an elastic
        model begins: ``{p.name: p.value for p in model.physical}`` of its model.

    """

    kinds: tuple[str, ...] = DEFAULT_KINDS
    tool: bool = False
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
    """A model of one output with its figures and its verdict."""

    output: str  # what it predicts
    kind: str  # what it is, see `models.bundle.KINDS`
    model: Model  # fitted to all training bags; of all payloads where these differ
    training: Validation  # figures on the training data themselves
    validation: Validation  # figures on unseen bags
    unseen: tuple[Case, ...]  # motion with models that have not seen it, for thresholds
    # (channels,): noise of the sensor of each channel in the validation, in its unit; empty where
    # unknown.
    noise: FloatArray

    @cached_property
    def verdict(self) -> Verdict:
        """Say whether it may be used, by its figures."""
        known = self.model.conditioning()
        return judge(self.validation, self.training.score.fit, condition=known.condition,
                     unexcited=known.unexcited, noise=self.noise.tolist())


def headline(fitted: Sequence[FittedOutput]) -> list[FittedOutput]:
    """Leave kinds out that are there for comparison, unless they are all that there is."""
    return [item for item in fitted if not KINDS[item.kind].compared] or list(fitted)


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
    ringing: tuple[Ringing, ...] = ()  # in the strain, or in the effort without strain
    warnings: tuple[str, ...] = field(default=())  # what was noted about the data
    elastic: Identified | None = None  # what all training bags show of the arm
    searches: Searches = field(default_factory=dict)  # the same by names of bags
    findings: tuple[Finding, ...] = ()  # what is wrong with the bags or with the description
    choices: tuple[Choice, ...] = ()  # what was left open and chosen, and what it brought
    causal: FitResult | None = None  # for the robot, where these are zero-phase
    # All bags learned from and judged by: more than `training` and `test`, where those are a
    # sample of many.
    learned: tuple[BagFacts, ...] = ()
    judged: tuple[BagFacts, ...] = ()
    unused: tuple[Unused, ...] = ()  # bags that were left out
    blind: Arm | None = None  # arm of the models that the end of an only bag is predicted by


@dataclass(frozen=True, eq=False)
class HeldOut:
    """The end of an only bag, and what is chosen of the rest alone."""

    first: BagData
    last: BagData  # what models of the first part are judged by
    arm: Arm  # with the friction that the first part pays for
    settings: FitSettings


def fit_models(
    arm: Arm, training: Sequence[BagData], test: Sequence[BagData], holdout: HeldOut | None,
    preprocessing: PreprocessingSpec, settings: FitSettings, progress: Progress = lambda _: None,
    known: Searches | None = None,
) -> FitResult:
    """Fit every model to the training bags and validate it."""
    settings = settings.settled()
    outputs = common_outputs([*training, *test])
    if not outputs:
        have = {str(bag.choice): [o for o in OUTPUTS if bag.has(o)] for bag in (*training, *test)}
        raise FitError(f'the bags share neither efforts nor strains ({have}); fit them apart')
    notes = []
    for output in OUTPUTS:
        some = [str(bag.choice) for bag in (*training, *test) if bag.has(output)]
        if some and output not in outputs:
            notes.append(f'only {", ".join(some)} have {output}: no {output} model is fitted')
            warnings.warn(notes[-1], TudorWarning, stacklevel=2)
    fitted = []
    elastic = ElasticTrainer(arm, settings.payloads, progress, settings.elastic_start,
                             () if holdout is None else (holdout.first,), known or {})
    trainers = {kind: elastic if kind == ELASTIC else RowTrainer(kind, arm, settings)
                for kind in settings.kinds}
    others = left_out(training, preprocessing)
    parts = left_out(training, preprocessing, loads=settings.payloads is not None)
    if ELASTIC in trainers:
        elastic.prepare([training, *([] if test or len(training) < 2 else
                                     [known for known, _ in others])])
    for output in outputs:
        noise = noise_floor(test or training, output, preprocessing)
        for kind in settings.kinds:
            progress(f'{kind} {output}')
            fitted.append(_fit_one(
                training, test, holdout, others if kind == ELASTIC else parts, output, kind,
                trainers[kind], noise))
    return replace(
        result_of(arm, preprocessing, settings, fitted, training, test,
                  [facts_of(bag) for bag in training], [facts_of(bag) for bag in test], notes),
        elastic=elastic.searches.get(_names(training)), searches=elastic.searches,
        blind=None if holdout is None else holdout.arm)


def result_of(
    arm: Arm, preprocessing: PreprocessingSpec, settings: FitSettings,
    fitted: Sequence[FittedOutput], training: Sequence[BagData], test: Sequence[BagData],
    learned: Sequence[BagFacts], judged: Sequence[BagFacts], notes: Sequence[str] = (),
) -> FitResult:
    """Collect the models of a fit, with what bags in memory and facts of all of them show."""
    ringing: tuple[Ringing, ...] = ()
    rigid = [item for item in fitted if item.kind == 'analytical']
    if rigid:
        last = rigid[-1]
        ringing = find_ringing(last.model, [*training, *test], last.output)
    said = [text for bag in (*learned, *judged) for text in bag.warnings]
    return FitResult(arm, preprocessing, settings, tuple(fitted), tuple(training), tuple(test),
                     ringing, tuple(dict.fromkeys([*said, *notes])), learned=tuple(learned),
                     judged=tuple(judged))


def _fit_one(
    training: Sequence[BagData], test: Sequence[BagData], holdout: HeldOut | None,
    others: Sequence[Left], output: str, kind: str, trainer: RowTrainer | ElasticTrainer,
    noise: FloatArray,
) -> FittedOutput:
    fit_bags = partial(trainer.fit, output=output)
    model = fit_bags(training)
    method = method_of([str(bag.choice) for bag in test], len(training), len(others))
    if test:
        cases = cases_of(model, test)
    elif len(training) > 1:
        cases = [(model_for(fit_bags(known), bag), bag) for known, bag in others]
    elif holdout is not None:
        first, last = holdout.first, holdout.last
        share = last.recording.t[-1] / (first.recording.t[-1] + last.recording.t[-1])
        method = f'the last {100 * share:.0f} % of the only bag, fitted to the rest'
        # what strain shows does not depend on friction
        blind = (replace(trainer, arm=holdout.arm) if isinstance(trainer, ElasticTrainer) else
                 RowTrainer(kind, holdout.arm, holdout.settings.settled()))
        cases = cases_of(blind.fit([first], output), [last])
    else:
        raise FitError('the fit cannot be judged with one training bag and no test bag; give a '
                       'second bag, or a test bag')
    validation = validated(cases, output, method)
    seen = validated(cases_of(model, training), output, 'the training bags themselves')
    unseen = unseen_cases(fit_bags, model, validation, others)
    return FittedOutput(output, kind, model, seen, validation, unseen, noise)
