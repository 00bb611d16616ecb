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

"""Loads and gauges that a model knows otherwise, and bags of several loads compared."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

from doctor_making import bag, described, healthy
import numpy as np
import pytest

from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.identification.doctor.between import (
    Evaluated, examine_bags, examine_evaluation)
from tudor_dynamics.identification.fit import fit_models, FitSettings
from tudor_dynamics.identification.loads import bare_bundle_of
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.signals.preprocessing import prepare

SPEC = PreprocessingSpec(filter='zero_phase', cutoff=10.0, rate=20.0, settle=1.0)


def _data(recording: Recording, name: str, payload: float | None = None) -> BagData:
    return replace(bag(recording, name, payload), stretches=tuple(prepare(recording, SPEC)))


@lru_cache
def _bundle() -> ModelBundle:
    """Learn the arm without a load from two bags."""
    bags = [_data(healthy(seed=k), f'run{k}') for k in range(2)]
    return bare_bundle_of(fit_models(described(), bags, [], None, SPEC,
                                     FitSettings(kinds=('analytical',))))


def _evaluated(*recordings: Recording) -> Evaluated:
    return examine_evaluation(_bundle(), [
        _data(recording, f'test{k}') for k, recording in enumerate(recordings)])


def test_a_bag_as_the_model_knows_it() -> None:
    """Nothing is found on another motion of the same arm."""
    evaluated = _evaluated(healthy(seed=5))
    assert evaluated.findings == () and evaluated.loads == {}


def test_a_load_is_named_with_its_mass() -> None:
    """Efforts in N m weigh it; the bag without it is not named."""
    evaluated = _evaluated(healthy(seed=5), healthy(seed=6, payload=1.0))
    finding, = evaluated.findings
    assert (finding.kind, finding.bag, finding.unit) == ('load_unknown', 'test1', 'kg')
    assert finding.size == pytest.approx(1.0, abs=0.15)
    assert finding.now is not None and finding.otherwise is not None
    assert finding.otherwise < 0.5 * finding.now
    assert 'a load explains most of the residual; ' in finding.what
    assert list(evaluated.loads) == ['test1']


def test_faults_of_the_bag_stand_beside_its_load() -> None:
    """The load comes first, and what the bag shows by itself is kept."""
    recording = healthy(seed=6, payload=1.0)
    assert recording.strain is not None
    strain = recording.strain.copy()
    strain[:, 1] = 7.0
    kinds = [item.kind for item in _evaluated(replace(recording, strain=strain)).findings]
    assert kinds == ['load_unknown', 'constant']


@pytest.mark.parametrize(('gauge', 'gain', 'zero'), [
    (0, 1.05, 0.0), (1, 0.95, 0.0), (0, 1.0, -60.0), (1, 1.0, 60.0)])
def test_a_gauge_that_has_changed_is_named(gauge: int, gain: float, zero: float) -> None:
    """By its gain or its zero, with the size; the other one is not, and it is no load."""
    recording = healthy(seed=6)
    strain = np.array(recording.strain)
    strain[:, gauge] = gain * strain[:, gauge] + zero
    evaluated = _evaluated(replace(recording, strain=strain))
    finding, = evaluated.findings
    assert finding.kind == ('gauge_zero' if zero else 'gauge_gain')
    assert finding.channels == (described().gauge_names[gauge],) and evaluated.loads == {}
    assert finding.size == pytest.approx(zero or gain, rel=0.05 if zero else 0.01)


@pytest.mark.parametrize('payload', [0.01, 0.1])
def test_a_light_load_is_no_gauge(payload: float) -> None:
    """It changes what all gauges read."""
    kinds = {item.kind for item in _evaluated(healthy(seed=6, payload=payload)).findings}
    assert kinds <= {'load_unknown'}


def test_gauges_that_have_changed_all_alike() -> None:
    """No gauge is blamed for what may be a load, or the motion."""
    recording = healthy(seed=6)
    assert recording.strain is not None
    changed = _evaluated(replace(recording, strain=1.05 * recording.strain))
    assert not any(item.kind.startswith('gauge_') for item in changed.findings)


def test_a_bag_that_is_too_short() -> None:
    """Two seconds say nothing of a load."""
    short = bag(healthy(seed=6, payload=1.0, seconds=2.0), 'short')
    assert examine_evaluation(_bundle(), [short]).findings == ()


def _found(payloads: list[float | None], carried: list[float]) -> list[tuple[str, str, str]]:
    bags = [bag(healthy(seed=k, payload=mass), f'run{k + 1}', payload)
            for k, (payload, mass) in enumerate(zip(payloads, carried, strict=True))]
    return [(item.kind, item.bag, item.what) for item in examine_bags(described(), bags)]


def test_the_same_mass_stated_and_another_carried() -> None:
    """Of three bags alike by their metadata one carries something else; how much nobody says."""
    assert _found([0.0, 0.0, 0.0], [0.0, 1.0, 0.0]) == [(
        'payload_wrong', 'run2',
        'the stated load is 0 kg, but the other bags suggest a different one')]


def test_two_bags_of_one_mass_stated() -> None:
    """The one that carries more is named; how much is for the user to say."""
    assert _found([0.2, 0.2], [0.0, 1.0]) == [
        ('load_unknown', 'run2', "the arm carries more in bag 'run2' than in bag 'run1'")]


def test_the_lighter_bag_comes_second() -> None:
    """Which one is heavier does not depend on their order."""
    assert _found([None, None], [1.0, 0.0]) == [
        ('load_unknown', 'run1', "the arm carries more in bag 'run1' than in bag 'run2'")]


def test_two_bags_of_two_masses_cannot_be_judged() -> None:
    """Their difference is a kilogram in units of nobody knows what."""
    assert _found([0.0, 0.5], [0.0, 1.0]) == []


def test_evidence_of_a_wrong_payload() -> None:
    """The mass as stated, and the mass that the bag carries as the others show it."""
    bags = [bag(healthy(seed=k, payload=mass), f'run{k}', stated) for k, (stated, mass)
            in enumerate([(0.0, 0.0), (0.5, 0.5), (1.0, 1.0), (0.0, 0.5)])]
    finding, = examine_bags(described(), bags)
    assert (finding.kind, finding.bag, finding.measure) == (
        'payload_wrong', 'run3', 'payload [kg]')
    assert finding.now == 0.0 and finding.otherwise == pytest.approx(0.5, abs=0.1)
    assert finding.size == finding.otherwise


@pytest.mark.parametrize('payloads', [[0.0, 0.25, 0.5], [0.5, 0.25, 0.0], [0.0, 0.2, 0.2]])
@pytest.mark.parametrize('first', [0, 10])
def test_small_steps_of_load_are_as_stated(payloads: list[float], first: int) -> None:
    """Of two bags that differ little one direction may look alike: that is no other load."""
    bags = [bag(healthy(seed=first + k, payload=mass), f'run{k}', mass)
            for k, mass in enumerate(payloads)]
    assert examine_bags(described(), bags) == ()
