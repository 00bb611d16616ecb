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

"""From names of bags to models and predictions: what ``td`` and the commands share."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
import hashlib
from pathlib import Path
import time
from typing import NamedTuple, TYPE_CHECKING
import warnings

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import check_budget, check_type, ModelError, TudorWarning, UsageError
from tudor_dynamics.files import check_target, provenance, write_figure
from tudor_dynamics.identification.choice import Choices, choose
from tudor_dynamics.identification.dataset import (
    BagChoice, BagData, check_choices, choices, common_outputs, filtered, load, parse_choice, part,
    Paths, payload_range, refuse_copies, with_recorded_gauges)
from tudor_dynamics.identification.detection import (
    Detector, evaluate_collisions, find_truth, MethodResult, Roc, roc_of_detector,
    truth_of_file)
from tudor_dynamics.identification.doctor.between import examine_bags
from tudor_dynamics.identification.doctor.findings import Finding
from tudor_dynamics.identification.excitation import Criterion, mean_error
from tudor_dynamics.identification.excitation_plan import (
    bounds_of, default_highest, judged, make_plan, Order, Plan, PlanFolder, target_of_arm,
    target_of_model)
from tudor_dynamics.identification.fit import (
    check_arm, ELASTIC, fit_models, FitResult, FitSettings, HeldOut)
from tudor_dynamics.identification.loads import bare_bundle_of, bundle_of, payload_of
from tudor_dynamics.identification.many_bags import ManyBags, Streaming, streams
from tudor_dynamics.identification.next_steps import (
    assess, Assessment, compare_with_plan, Comparison)
from tudor_dynamics.identification.tool import check_efforts
from tudor_dynamics.identification.validation import cases_of, shown_fit, validated, Validation
from tudor_dynamics.load.offline import PayloadEstimate
from tudor_dynamics.models.bundle import check_bundle_target, ModelBundle, read_facts, save_bundle
from tudor_dynamics.online.monitor import MonitorSettings
from tudor_dynamics.typing import Progress, Shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# -- From the names of bags to judged models: what ``tudor fit`` and ``td.fit`` have in common

HELD_OUT = 0.4  # part at the end of an only bag that is kept for validation


class HeldBags:
    """Bags of a fit that all stay in memory, for models of any kind; ``ManyBags`` has the same."""

    def __init__(
        self, arm: Arm, training: Sequence[BagChoice], test: Sequence[BagChoice],
        spec: PreprocessingSpec, payloads: Mapping[str, float], progress: Progress,
    ) -> None:
        """Read and filter the bags: payloads [kg]."""
        self.arm, self.spec = with_recorded_gauges(arm, [*training, *test]), spec
        self.progress = progress

        def read(choice: BagChoice, *, learn: bool) -> BagData:
            progress(f'read {choice}')
            return load(choice, self.arm, spec, learn=learn,
                        payload=payloads.get(str(Path(choice.path).resolve())))

        self.training = self.held = [read(choice, learn=True) for choice in training]
        self.test = self.held_test = [read(choice, learn=False) for choice in test]
        refuse_copies(self.held, self.held_test)

    def _parts(self, spec: PreprocessingSpec) -> tuple[BagData, BagData]:
        bag, middle = self.held[0], 1.0 - HELD_OUT
        return part(bag, 0.0, middle, spec), part(bag, middle, 1.0, spec)

    def choose(self, settings: FitSettings) -> Choices:
        """Choose what is left open by all bags, and again without what is held out."""
        chosen = choose(self.arm, self.held, self.spec, settings, self.progress)
        if len(self.held) > 1 or self.held_test:
            return chosen
        # what models are judged by passes the filters that they are delivered with
        spec = chosen.preprocessing
        fixed = spec.model_copy(update={'filter': spec.filter})
        return replace(chosen, blind=choose(self.arm, self._parts(spec)[:1], fixed, settings))

    def fits(self, chosen: Choices, specs: Sequence[PreprocessingSpec]) -> list[FitResult]:
        """Fit and judge the models, by each of several filters."""
        results: list[FitResult] = []
        for spec in reversed(specs):  # causal first: elastic models follow measured positions
            if spec is not specs[-1]:
                self.progress('zero-phase models')
            training, test = ([filtered(bag, spec) for bag in bags]
                              for bags in (self.held, self.held_test))
            held_out = None if chosen.blind is None else HeldOut(
                *self._parts(spec), chosen.blind.arm, chosen.blind.settings)
            results.append(fit_models(
                chosen.arm, training, test, held_out, spec, chosen.settings, self.progress,
                results[0].searches if results else None))
        return results[::-1]


def fit_bags(
    bags: HeldBags | ManyBags, settings: FitSettings, progress: Progress = lambda _: None, *,
    ignore_payload: bool = False, examine: bool = True,
) -> FitResult:
    """Fit models to bags, of all payloads where the bags have several."""
    found = None if ignore_payload else payload_range(bags.training, bags.test)
    if found is not None:
        settings = replace(settings, payloads=found)
    chosen = bags.choose(settings)
    findings: tuple[Finding, ...] = ()
    if examine:
        progress('doctor')
        findings = examine_bags(bags.arm, [*bags.held, *bags.held_test], chosen)
    specs = [chosen.preprocessing]
    if chosen.preprocessing.filter == 'zero_phase':  # causal ones run on the robot
        specs.append(chosen.preprocessing.model_copy(update={'filter': 'causal'}))
    result, *causal = bags.fits(chosen, specs)
    return replace(result, findings=findings, choices=chosen.made,
                   causal=causal[0] if causal else None)


def fit(
    bags: Paths, arm: Arm, *, test: Paths = (), settings: FitSettings = FitSettings(),
    preprocessing: PreprocessingSpec | None = None, payloads: Mapping[str, float] | None = None,
    ignore_payload: bool = False, out: str | Path | None = None, overwrite: bool = False,
    streaming: Streaming | None = None, bare: bool = False, progress: Progress = lambda _: None,
) -> ModelBundle:
    """
    Learn the models of an arm from bags, as ``tudor fit`` does.

    Parameters
    ----------
    bags : str, path, or sequence of them
        Bags to learn from, or parts of them: ``BAG@0-60%`` or ``BAG@5s-50s``.
    arm : Arm
        Arm that was recorded, see ``load_arm``.
    test : str, path, or sequence of them
        Bags to judge by; without them each training bag is left out once, and of an only bag the
        last 40 %.
    settings : FitSettings
        Kinds of models and their choices; the analytical model by default.
    preprocessing : PreprocessingSpec, optional
        Filters and rate; by default those of the arm description, and what that leaves open is
        chosen by left-out parts of the training bags.
    payloads : mapping of str to float, optional
        Bag, as it is named in ``bags`` or ``test``, to its mass at the tip, in place of what its
        metadata say [kg].
    ignore_payload : bool, default=False
        Fit as if all bags had the same payload.
    out : str or Path, optional
        Directory for the bundle and its report; nothing is written by default.
    overwrite : bool, default=False
        Replace a bundle that stands at ``out``.
    streaming : Streaming, optional
        Go through the bags one by one, as is done with many in any case, and how.
    bare : bool, default=False
        Give models and their figures alone, for studies with many fits: no doctor, no verdicts on
        uses, no collision thresholds and nothing for loads, which take most of the time.
    progress : callable
        Called with what is done next, in words.

    Returns
    -------
    ModelBundle
        Models of all outputs, with figures on unseen bags, verdicts and collision thresholds.

    Raises
    ------
    TudorError
        If an argument, a bag or the arm cannot be used; see ``errors`` for the kinds.

    """
    check_type(arm, Arm, 'arm', "read a description with load_arm('arm.yaml')")
    check_type(settings, FitSettings, 'settings', "such as FitSettings(kinds=('elastic',))")
    training, judging = choices(bags), choices(test, 'test')
    spec = arm.spec.preprocessing if preprocessing is None else preprocessing
    check_type(spec, PreprocessingSpec, 'preprocessing', 'arm.spec.preprocessing, changed')
    if preprocessing is not None:  # what is given is meant, defaults included
        spec = PreprocessingSpec.model_validate(spec.model_dump())
    masses = _by_path(payloads or {}, [*training, *judging])
    if bare:
        if out is not None:
            raise UsageError('bare=True collects no data for the report that out= would hold',
                             remedy='leave out either bare or out')
        check_choices(training, judging)
        source = _source(arm, training, judging, spec, settings, masses, streaming, progress)
        return bare_bundle_of(fit_bags(source, settings, progress, ignore_payload=ignore_payload,
                                       examine=False))
    return fit_choices(
        arm, training, judging, spec, settings, masses, ignore_payload=ignore_payload,
        out=None if out is None else Path(out), overwrite=overwrite, streaming=streaming,
        progress=progress).bundle


class Fit(NamedTuple):
    """A fit with all that was found, for who wants more than the models."""

    result: FitResult
    assessment: Assessment
    bundle: ModelBundle
    plan: Comparison | None  # errors that a plan expected, next to those that came
    seconds: dict[str, float]  # what took how long [s]


def fit_choices(
    arm: Arm, training: Sequence[BagChoice], test: Sequence[BagChoice],
    preprocessing: PreprocessingSpec, settings: FitSettings, payloads: Mapping[str, float], *,
    ignore_payload: bool = False, plan: PlanFolder | None = None, out: Path | None = None,
    overwrite: bool = False, streaming: Streaming | None = None,
    progress: Progress = lambda _: None,
    compare: Path | None = None,  # what the report compares with; by default what is replaced
) -> Fit:
    """Fit, judge and write: the one way from bags to a bundle, of ``td.fit`` and ``tudor fit``."""
    check_choices(training, test)
    last = None if compare is None else (str(compare), read_facts(compare))
    if out is not None:
        check_bundle_target(out, overwrite=overwrite)
        with suppress(ModelError):  # what cannot be read is not compared with
            last = last or (f'{out}, replaced', read_facts(out))
    seconds: dict[str, float] = {}
    with _timed(seconds, 'read and filter'):
        bags = _source(arm, training, test, preprocessing, settings, payloads, streaming, progress)
    with _timed(seconds, 'fit and validate'):
        result = fit_bags(bags, settings, progress, ignore_payload=ignore_payload)
    with _timed(seconds, 'collision thresholds'):
        planned = None if plan is None else compare_with_plan(result, plan)
        progress('collision thresholds')
        assessment = assess(result, out)
        if settings.tool:
            progress('flexible tool')
        bundle = bundle_of(result, assessment)
    if out is not None:
        from tudor_dynamics.show.page import LastFit, render  # slow to import

        with _timed(seconds, 'save and report'):
            progress('report')
            sums = ' '.join(bag.checksum for bag in (*result.learned, *result.judged))
            digest = hashlib.sha256(sums.encode()).hexdigest()[:16]
            bundle.facts['made'] = made = {**provenance(), 'digest of bags': digest}
            save_bundle(bundle, out, overwrite=overwrite, extra={'report.html': render(
                result, assessment, planned, made, last and LastFit(*last)).encode()})
    return Fit(result, assessment, bundle, planned, seconds)


def _source(
    arm: Arm, training: Sequence[BagChoice], test: Sequence[BagChoice], spec: PreprocessingSpec,
    settings: FitSettings, payloads: Mapping[str, float], streaming: Streaming | None,
    progress: Progress,
) -> HeldBags | ManyBags:
    """Read the bags, or, of many, look at them and be ready to go through them."""
    if ELASTIC in settings.kinds:
        check_arm(arm)
    if settings.tool:
        check_efforts(arm)
    if streams(len(training), settings, asked=streaming is not None):
        return ManyBags(arm, training, test, spec, payloads, streaming or Streaming(), progress)
    return HeldBags(arm, training, test, spec, payloads, progress)


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    """Note how long a stage takes, and all of them [s]."""
    begun = time.perf_counter()
    yield
    seconds[stage] = round(time.perf_counter() - begun, 3)
    seconds['total'] = round(sum(seconds.values()) - seconds.get('total', 0.0), 3)


def _by_path(payloads: Mapping[str, float], bags: Sequence[BagChoice]) -> dict[str, float]:
    known = {str(Path(choice.path).resolve()) for choice in bags}
    found = {str(Path(bag).resolve()): float(mass) for bag, mass in payloads.items()}
    for path, mass in found.items():
        if path not in known or not 0.0 <= mass < float('inf'):
            raise UsageError(f'payloads gives {mass:g} kg for {path}; expected 0 kg or more, '
                             f'and one of the bags {", ".join(str(choice) for choice in bags)}')
    return found


# -- Bags against models: what ``tudor evaluate`` and ``td.predict`` have in common

@dataclass(frozen=True, eq=False)
class Prediction(Shown):
    """What the models of a bundle make of bags."""

    arm: Arm  # arm of the models
    data: tuple[BagData, ...]  # bags, filtered as the models need it
    outputs: dict[str, dict[str, Validation]]  # figures and traces by output and kind

    def __repr__(self) -> str:
        """Write the fit of each model, one line each."""
        bags = ', '.join(str(bag.choice) for bag in self.data)
        lines = [f'{output} {kind}: fit {shown_fit(item.score.fit):.1f} %'
                 for output, kinds in self.outputs.items() for kind, item in kinds.items()]
        return '\n  '.join([f'Prediction of {self.arm.name} on {bags}', *lines])

    def plot(
        self, path: str | Path | None = None, *, output: str | None = None,
        channel: str | None = None,
    ) -> Figure:
        """Draw a channel of the first bag: measured, predicted by each model, and the residual."""
        # plots are slow to import, and most predictions are read
        from tudor_dynamics.show.figures import liveliest, signal_figure
        from tudor_dynamics.show.pictures import draw, style, SUFFIXES

        target = None if path is None else check_target(
            path, overwrite=True, name='path', endings=SUFFIXES)
        output = output or ('strain' if 'strain' in self.outputs else next(iter(self.outputs)))
        kinds = self.outputs[_known(self.outputs, output, 'output')]
        first = next(iter(kinds.values()))
        name = _known(first.channels, channel or first.channels[0], 'channel')
        with style():
            figure = draw(signal_figure(self.arm, output, kinds, name,
                                        liveliest(first.traces[0], self.data)))
            if target is not None:
                write_figure(figure, target)
        return figure


def _known(names: Collection[str], name: str, what: str) -> str:
    if name not in names:
        raise UsageError(f'the prediction has no {what} {name!r}; it has {", ".join(names)}')
    return name


def predict_bags(bundle: ModelBundle, data: Sequence[BagData]) -> Prediction:
    """Let every model of a bundle predict bags that were read."""
    outputs = [output for output in common_outputs(data) if output in bundle.models]
    bags = ', '.join(str(bag.choice) for bag in data)
    if not outputs:
        raise UsageError(f'the model predicts {" and ".join(bundle.models)}, but not all of these '
                         f'bags have it: {bags}; evaluate each bag alone, or use other bags')
    return Prediction(bundle.arm, tuple(data), {
        output: {kind: validated(cases_of(model, data), output, bags)
                 for kind, model in bundle.models[output].items()} for output in outputs})


def warn_of_training(bundle: ModelBundle, data: Sequence[BagData]) -> list[str]:
    """Warn of bags whose samples a model was trained on, by whatever name."""
    listed = bundle.facts.get('training')
    training = [item for item in (listed if isinstance(listed, list) else ())
                if isinstance(item, dict)]
    seen = [str(bag.choice) for bag in data if any(
        item.get('sha256') == bag.recording.checksum != ''
        and bag.choice.overlaps(parse_choice(str(item.get('bag')))) for item in training)]
    if seen:
        more = f' and {len(seen) - 3} more' if len(seen) > 3 else ''
        msg = (f'{", ".join(seen[:3])}{more}: the model was trained on this bag, so its errors '
               'are smaller here than on new ones; test it on other bags')
        warnings.warn(msg, TudorWarning, stacklevel=3)
    return seen


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


# -- What the arm of a bag carries, from its name: ``td.carried``

def carried(bundle: ModelBundle, bags: Paths, *, kind: str | None = None) -> PayloadEstimate:
    """
    Estimate what the arm carries in bags, as ``tudor payload`` does.

    Parameters
    ----------
    bundle : ModelBundle
        Fitted models, of ``fit`` or ``load_bundle``.
    bags : str, path, or sequence of them
        Bags of the same arm with one load, or parts of them: ``BAG@60-100%``.
    kind : {'analytical', 'elastic'}, optional
        Kind of model that the load is estimated by.

    Returns
    -------
    PayloadEstimate
        Mass, place and inertia with standard deviations, as far as the bags show them.

    Raises
    ------
    TudorError
        If a bag cannot be read, or has nothing that the models predict.

    """
    check_type(bundle, ModelBundle, 'bundle', 'the result of fit or load_bundle')
    data = [load(choice, bundle.arm, bundle.preprocessing) for choice in choices(bags)]
    return payload_of(bundle, data, kind)


# -- How well collisions are found in bags, from their names: ``td.detect``

def detect(
    bundle: ModelBundle, bags: Paths, settings: MonitorSettings = MonitorSettings(),
) -> list[MethodResult]:
    """
    Let bags with known pushes be watched, as ``tudor evaluate --collisions`` does.

    The pushes are those on the topic ``applied_wrench`` of a bag; without it an event is neither
    right nor false.

    Parameters
    ----------
    bundle : ModelBundle
        Models with collision thresholds, of ``fit`` or ``load_bundle``.
    bags : str, path, or sequence of them
        Bags of the same arm, or parts of them: ``BAG@60-100%``.
    settings : MonitorSettings
        Kind of model and false alarms allowed: all methods that there are thresholds for share
        them as in a monitor, and each alone is given all.

    Returns
    -------
    list of MethodResult
        For ``all`` methods together, where there are several, then for each alone (``strain``,
        ``effort``, ``momentum``) the ``score``, the ``watched`` bags with events and pushes, and
        ``roc``: factor on the threshold, false alarms per hour [1/h], detection rate.

    Raises
    ------
    TudorError
        If a bag cannot be read, or the models have no thresholds for what it has.

    """
    check_type(bundle, ModelBundle, 'bundle', 'the result of fit or load_bundle')
    check_type(settings, MonitorSettings, 'settings', "such as MonitorSettings(kind='elastic')")
    recordings = [(choice.path, load(choice, bundle.arm, None).recording)
                  for choice in choices(bags)]
    return evaluate_collisions(bundle, recordings, settings,
                               [find_truth(path) for path, _ in recordings])


def roc(
    detectors: Mapping[str, Detector | ModelBundle], bags: Paths, arm: Arm,
    truth: Sequence[str | Path] = (),
) -> dict[str, Roc]:
    """
    Compare detectors by the pushes they find and the false events they bring, at any threshold.

    Parameters
    ----------
    detectors : mapping of str to Detector or ModelBundle
        Detectors of one's own, or models with the built-in one.
    bags : str, path, or sequence of them
        Bags of the arm, or parts of them: ``BAG@60-100%``.
    arm : Arm
        Description of the arm.
    truth : sequence of str or path, optional
        Tables of ``begin,end`` [s], one a bag; by default the topic ``applied_wrench`` counts.

    Returns
    -------
    dict of str to Roc
        By name, of a bundle by ``NAME: METHOD``: ``share()`` of the pushes found [%] over
        ``per_hour()`` [1/h] at each ``factor``, with exact intervals. A factor is a function's
        threshold, or a multiple of a bundle's; ``now`` has a meaning for bundles alone.

    Raises
    ------
    TudorError
        If a bag cannot be read, its pushes are not known, or a detector gives other shapes.

    """
    check_type(arm, Arm, 'arm', "read a description with load_arm('arm.yaml')")
    data = [load(choice, arm, None) for choice in choices(bags)]
    if truth and len(truth) != len(data):
        raise UsageError(f'truth has {len(truth)} tables of pushes for {len(data)} bags; '
                         'give one for each bag')
    recordings = [(bag.choice.path, bag.recording) for bag in data]
    truths = [truth_of_file(table, bag) for table, bag in zip(truth, data, strict=True)
              ] if truth else [find_truth(path) for path, _ in recordings]
    for (path, _), known in zip(recordings, truths, strict=True):
        if not known.known:
            raise UsageError(f'{path}: the bag does not say when it was pushed (no topic '
                             'applied_wrench); give truth, a CSV of begin,end [s] for each bag')
    found: dict[str, Roc] = {}
    for name, detector in detectors.items():
        if isinstance(detector, ModelBundle):
            found |= {f'{name}: {item.method}': item.roc for item in evaluate_collisions(
                detector, recordings, MonitorSettings(), truths)}
        else:
            found[name] = roc_of_detector(detector, recordings, truths)
    return found


# -- Motions that show what is to be identified: ``td.excitation``

def excitation(
    subject: Arm | ModelBundle, motion: Trajectory | None = None, *, seconds: float = 30.0,
    rate: float = 100.0, highest: float | None = None, criterion: Criterion = mean_error,
    steps: int = 60, seed: int = 0,
) -> Plan:
    """
    Judge a motion by what it will show of an arm, or search for the one that shows most.

    The search keeps to the limits of position, velocity, acceleration and effort; links, floor
    and walls are looked at by ``tudor excite``.

    Parameters
    ----------
    subject : Arm or ModelBundle
        What is to be identified: an arm, in noise of 1 in each channel, or that of a bundle, in
        the noise that its fit left.
    motion : Trajectory, optional
        Motion of one's own that is to be judged, one measurement a point, with ``dq`` and ``ddq``:
        positions alone are joined by straight lines. One is searched by default.
    seconds, rate : float
        Length [s] and samples per second [Hz] of a motion that is searched.
    highest : float, optional
        Its largest frequency; by default below what makes links oscillate [Hz].
    criterion : callable
        From the covariances of the parameters, one for each group of channels with common ones,
        to a cost and to its slope by the information of each group (of log det C it is -C), for
        the search; the mean logarithm of all standard errors by default.
    steps, seed : int
        Steps of the search in each of its three stages, and the seed of where it begins.

    Returns
    -------
    Plan
        ``trajectory``; ``cost`` by the criterion; ``expected``, the standard error of each base
        parameter; ``beyond``, the largest part of each limit in use.

    Raises
    ------
    TudorError
        If the arm has no limits, or a motion does not move its joints.

    """
    check_type(subject, (Arm, ModelBundle), 'subject', 'an arm, or the result of fit')
    target = (target_of_arm(subject) if isinstance(subject, Arm) else
              target_of_model(subject, subject.arm))
    if motion is not None:
        check_type(motion, Trajectory, 'motion', 'such as Trajectory(joints, t, q, dq, ddq)')
        motion = motion.of(target.arm.active_joints)
        if motion.dq is None:
            msg = ('the motion has positions alone, which straight lines join: speeds jump at its '
                   'points, accelerations are 0; give dq and ddq where it is smooth')
            warnings.warn(msg, TudorWarning, stacklevel=2)
        return judged(target, motion, bounds_of(target), criterion)
    check_budget(f'{seconds:g} s at {rate:g} Hz', seconds * rate, remedy='lower seconds= or rate=')
    return make_plan(target, Order(seconds, highest or default_highest(target.arm), 1.0 / rate,
                                   steps, seed), criterion=criterion)
