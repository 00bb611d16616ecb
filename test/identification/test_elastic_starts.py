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

"""Where the search begins: gear and link exchange their compliance, gauges may lag."""

from __future__ import annotations

from dataclasses import replace

from elastic_making import even, lone_arm, lone_recording, LONE_TRUTH
import numpy as np
import pytest
from thinned import first

from tudor_dynamics.identification.elastic_problem import Problem, Record
from tudor_dynamics.identification.elastic_search import (
    chosen, compare_starts, identify, knowledge_of, rivals, shared, STARTS)
from tudor_dynamics.mechanics import chain as at
from tudor_dynamics.models.elastic.arm import reduced_mechanism
from tudor_dynamics.signals.filters import low_pass
from tudor_dynamics.typing import FloatArray

NAMES = ('bending(j1)', 'gear(j1)', 'play(j1)')


def compliances(x: FloatArray) -> tuple[float, float]:
    """Give those of gear and link [rad/(N m)]."""
    mechanism = reduced_mechanism(lone_arm())
    length = float(mechanism.body_float[mechanism.body_of['j1'], at.LENGTH])
    return float(np.exp(-x[1])), length / (3.0 * float(np.exp(x[0])))


@pytest.mark.parametrize('share', [0.1, 0.5, 0.8])
def test_a_share_keeps_the_sum_of_compliances(share: float) -> None:
    """Of gear and link together; nothing else changes."""
    x = np.log([LONE_TRUTH[name] for name in NAMES])
    moved = shared(lone_arm(), NAMES, x, share)
    assert sum(compliances(moved)) == pytest.approx(sum(compliances(x)), rel=1e-12)
    assert compliances(moved)[0] == pytest.approx(share * sum(compliances(x)), rel=1e-12)
    assert moved[2] == x[2]


def test_as_described_is_as_it_was() -> None:
    """So is a joint of which only one of the two is searched."""
    x = np.log([LONE_TRUTH[name] for name in NAMES])
    assert (shared(lone_arm(), NAMES, x, None) == x).all()
    assert (shared(lone_arm(), NAMES[1:], x[1:], 0.5) == x[1:]).all()


def one_blade(seed: int) -> Record:
    """Record the single blade with 200 g."""
    recording = lone_recording(seed, payload=0.2)
    assert recording.strain is not None
    return Record(recording.q, even(len(recording.q), 100.0), recording.strain, payload=0.2)


def test_another_share_explains_more() -> None:
    """Than a gear described fifty times too stiff, already where starts are compared."""
    record, arm = one_blade(3), lone_arm()
    known = knowledge_of(arm, payload=False).without('gyration(j1,1)')  # it is a point
    names, center, width = known.names, known.center, known.width_of
    wrong = shared(arm, names, center, 0.01)
    begun, compared = compare_starts(arm, [record], names, wrong, width, lambda _: None)
    assert len(begun) == len(STARTS) and len(compared) >= len(STARTS)
    fits = [start.fit for start in compared]
    assert fits == sorted(fits, reverse=True)
    assert compared[0].share is not None
    reached = Problem(arm, [record], names, {}, center, width, inner=5e-3).fits(begun)
    assert max(reached[1:]) > reached[0] + 1.0  # as described comes first, and is worse


@pytest.mark.parametrize('seeds', first((3,), (5, 6)))
def test_a_wrong_share_is_found_out(seeds: tuple[int, ...]) -> None:
    """A gear described fifty times too stiff: the search finds what gear and link are."""
    arm = lone_arm()
    known = knowledge_of(arm, payload=False)
    wrong = shared(arm, known.names, known.center, 0.01)
    found = identify(arm, [one_blade(seed) for seed in seeds], knowledge=replace(
        known, start=dict(zip(known.names, np.exp(wrong).tolist(), strict=True))))
    values = {p.name: p.value for p in found.physical}
    for name in ('gear(j1)', 'bending(j1)'):
        assert values[name] == pytest.approx(LONE_TRUTH[name], rel=0.05)


def test_what_explains_clearly_more_is_chosen() -> None:
    """Plain before strange: another start must leave a tenth less."""
    assert chosen((90.0,)) == 0
    assert chosen((90.0, 90.5, 90.9)) == 0
    assert chosen((90.0, 91.1, 93.0)) == 2


def test_samples_are_thinned_evenly() -> None:
    """From 500 to 100 Hz, time kept; what is sparse already is left as it is."""
    n = 1001
    record = Record(np.arange(2.0 * n).reshape(n, 2), np.full(n, 2e-3), np.zeros((n, 1)), skip=7)
    thin = record.decimated(0.01)
    assert len(thin.q) == 201 and thin.skip == 2
    assert (thin.q == record.q[::5]).all()
    assert thin.dt[1:] == pytest.approx(0.01)
    assert thin.decimated(0.01) is thin


def test_what_cannot_be_told() -> None:
    """Ends as good as each other that differ in a stiffness; one that is worse does not count."""
    names = ('bending(j1)', 'gear(j1)', 'play(j1)')
    ends = [np.log([10.0, 100.0, 1e-3]), np.log([20.0, 50.0, 9e-3]), np.log([50.0, 10.0, 1e-3])]
    assert rivals(names, ends[:1], [90.0]) == ()
    assert rivals(names, ends[:2], [90.0, 89.8]) == ('bending(j1)', 'gear(j1)')
    assert rivals(names, ends[:2], [90.0, 85.0]) == ()
    assert rivals(names, [ends[0], ends[0] + 0.01], [90.0, 90.0]) == ()


def test_a_lag_of_the_amplifier_is_found() -> None:
    """Strain after a low-pass of 40 ms, of which the description says nothing; and none."""
    arm = lone_arm()
    recording = lone_recording(3, payload=0.2)
    assert recording.strain is not None
    dt = even(len(recording.q), 100.0)
    late = low_pass(recording.strain, dt, 1.0 / (2.0 * np.pi * 0.04), recording.strain[0])
    for strain, lag in ((late, 0.04), (recording.strain, 0.0)):
        found = identify(arm, [Record(recording.q, dt, strain, payload=0.2)],
                         warm={**LONE_TRUTH, 'lag': 0.02})
        values = {p.name: p for p in found.physical}
        assert values['lag'].shown == (lag > 0.0)
        assert abs(values['lag'].value - lag) < 3.0 * values['lag'].standard_error + 1e-3
        assert values['lag'].standard_error < 0.006
        gear = values['gear(j1)']
        assert abs(gear.value - LONE_TRUTH['gear(j1)']) < 3.0 * gear.standard_error
