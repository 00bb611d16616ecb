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


"""From the names of bags to fitted models: what ``tudor fit`` and ``td.fit`` have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
import os
from pathlib import Path
from tempfile import TemporaryDirectory
import warnings

from tudor_dynamics.arm import Arm, PreprocessingSpec
from tudor_dynamics.doctor.bags import examine_bags
from tudor_dynamics.errors import check_type, TudorWarning, UsageError
from tudor_dynamics.identification.bag_choice import BagChoice, check_choices, choices, Paths
from tudor_dynamics.identification.bundling import bundle_of
from tudor_dynamics.identification.choice.choose import choose
from tudor_dynamics.identification.dataset import BagData, filtered, load, refuse_copies, split_bag
from tudor_dynamics.identification.elastic.trainer import Searches
from tudor_dynamics.identification.fit import fit_models, FitResult, FitSettings
from tudor_dynamics.identification.payloads import payload_range
from tudor_dynamics.identification.trainers import check_kinds
from tudor_dynamics.identification.worth.assessment import assess
from tudor_dynamics.library.many_bags import fit_many, Streaming, streams
from tudor_dynamics.library.recorded_gauges import with_recorded_gauges
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.kinds import KINDS
from tudor_dynamics.models.storage.bundle_io import check_target, save_bundle
from tudor_dynamics.typing import Progress


HELD_OUT = 0.4
"""Part at the end of an only bag that is kept for validation."""


def read_bags(
    arm: Arm,
    training: Sequence[BagChoice],
    test: Sequence[BagChoice],
    preprocessing: PreprocessingSpec,
    payloads: Mapping[str, float],
    progress: Progress = lambda _: None,
) -> tuple[list[BagData], list[BagData]]:
    """Read and filter the bags of a fit: payloads [kg]."""
    def read(choice: BagChoice, *, learn: bool) -> BagData:
        progress(f'read {choice}')
        return load(choice, arm, preprocessing, learn=learn,
                    payload=payloads.get(str(Path(choice.path).resolve())))

    training_data = [read(choice, learn=True) for choice in training]
    test_data = [read(choice, learn=False) for choice in test]
    refuse_copies(training_data, test_data)
    return training_data, test_data


def fit_bags(
    arm: Arm,
    training: Sequence[BagData],
    test: Sequence[BagData],
    preprocessing: PreprocessingSpec,
    settings: FitSettings,
    progress: Progress = lambda _: None,
    *,
    ignore_payload: bool = False,
) -> FitResult:
    """Fit models to bags that were read, of all payloads where the bags have several."""
    found = None if ignore_payload else payload_range(training, test)
    if found is not None:
        settings = _of_all_payloads(settings, found)
    alone = len(training) == 1 and not test
    known = [split_bag(training[0], HELD_OUT, preprocessing)[0]] if alone else training
    chosen = choose(arm, known, preprocessing, settings, progress)

    def fitted(spec: PreprocessingSpec, known: Searches | None = None) -> FitResult:
        seen, unseen = ([filtered(bag, spec) for bag in bags] for bags in (training, test))
        holdout = split_bag(training[0], HELD_OUT, spec) if alone else None
        return fit_models(chosen.arm, seen, unseen, holdout, spec, chosen.settings, progress,
                          known)

    progress('doctor')
    findings = examine_bags(arm, [*training, *test])
    result = fitted(chosen.preprocessing)
    causal = None
    if chosen.preprocessing.filter == 'zero_phase':
        progress('causal models for the robot')
        causal = fitted(chosen.preprocessing.model_copy(update={'filter': 'causal'}),
                        result.searches)
    return replace(result, findings=findings, choices=chosen.made, causal=causal)


def _of_all_payloads(settings: FitSettings, payloads: tuple[float, float]) -> FitSettings:
    if settings.random_split:
        msg = ('--random-split is for models of one payload, and these bags have several; leave '
               'it out, or add --ignore-payload')
        raise UsageError(msg)
    kinds = tuple(kind for kind in settings.kinds if KINDS[kind].of_payloads is not None)
    left_out = [kind for kind in settings.kinds if kind not in kinds]
    if left_out and kinds:
        msg = f'{", ".join(left_out)}: not fitted to several payloads at once, and left out'
        warnings.warn(msg, TudorWarning, stacklevel=2)
    if not kinds:
        msg = (f'{", ".join(left_out)} cannot be fitted to several payloads at once; fit each '
               'payload apart, or add --ignore-payload')
        raise UsageError(msg)
    return replace(settings, kinds=kinds, payloads=payloads)


def fit(
    bags: Paths,
    arm: Arm,
    *,
    test: Paths = (),
    settings: FitSettings = FitSettings(),
    preprocessing: PreprocessingSpec | None = None,
    payloads: Mapping[str, float] | None = None,
    ignore_payload: bool = False,
    out: str | Path | None = None,
    overwrite: bool = False,
    streaming: Streaming | None = None,
    progress: Progress = lambda _: None,
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
        Kinds of models and their choices; analytical model and extreme learning machine by
        default.
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
    progress : callable
        Told what is done next, in words.

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
    check_choices(training, judging)
    if out is not None:
        check_target(Path(out), overwrite=overwrite)
    check_kinds(settings.kinds, arm)
    spec = arm.spec.preprocessing if preprocessing is None else preprocessing
    check_type(spec, PreprocessingSpec, 'preprocessing', 'arm.spec.preprocessing, changed')
    if preprocessing is not None:  # what is given is meant, defaults included
        spec = PreprocessingSpec.model_validate(spec.model_dump())
    masses = _by_path(payloads or {}, [*training, *judging])
    with ExitStack() as stack:
        if streams(len(training), settings, asked=streaming is not None):
            if streaming is None:
                streaming = Streaming(Path(stack.enter_context(TemporaryDirectory())))
            result = fit_many(arm, training, judging, spec, settings, masses, streaming, progress,
                              ignore_payload=ignore_payload)
        else:
            arm = with_recorded_gauges(arm, [*training, *judging])
            data, test_data = read_bags(arm, training, judging, spec, masses, progress)
            result = fit_bags(arm, data, test_data, spec, settings, progress,
                              ignore_payload=ignore_payload)
    progress('collision thresholds')
    assessment = assess(result)
    bundle = bundle_of(result, assessment)
    if out is not None:
        from tudor_dynamics.report.page import report_bytes  # plots are slow to import

        progress('report')
        save_bundle(bundle, out, overwrite=overwrite,
                    extra={'report.html': report_bytes(result, assessment)})
    return bundle


def _by_path(payloads: Mapping[str, float], bags: Sequence[BagChoice]) -> dict[str, float]:
    known = {str(Path(choice.path).resolve()) for choice in bags}
    found = {}
    for bag, mass in payloads.items():
        path = str(Path(bag).resolve())
        if path not in known or not 0.0 <= mass < float('inf'):
            msg = (f'payloads has {mass!r} kg for {os.fspath(bag)!r}; expected a mass of 0 or '
                   f'more for one of the bags {[str(choice) for choice in bags]}')
            raise UsageError(msg)
        found[path] = float(mass)
    return found
