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

"""Known truth: what the search finds in the strain of an arm whose parameters are given."""

from __future__ import annotations

from elastic_making import (
    blade_arm, even, GAINS, lone_arm, lone_recording, LONE_TRUTH, OFFSETS, recorded, travel)
import numpy as np
import pytest
from thinned import first

from tudor_dynamics.errors import FitError
from tudor_dynamics.identification.elastic_problem import (
    fit_percent, Identified, Problem, Record, Straight)
from tudor_dynamics.identification.elastic_search import (
    identify, knowledge_of, simple_gears, taken_over)
from tudor_dynamics.typing import FloatArray

ARM = blade_arm()
RATE, SECONDS, HOLD = 100.0, 12.0, 1.25
TRUTH = {'bending(j1)': 13.5, 'bending(j2)': 15.0, 'gear(j1)': 260.0, 'gear(j2)': 130.0,
         'lumped(j1,1)': 0.9, 'play(j1)': 0.008, 'play(j2)': 0.006, 'tight(j1)': 0.35,
         'tight(j2)': 0.3, 'beta': 8e-4, 'payload': 0.25}
NOISE, LESS = 2.0, 1.4
"""Of the gauges [um/m]; the latter errs in 12 s as the former does in twice that time."""


def record(seed: int = 3, payload: float | None = 0.25, carried: float = 0.25) -> Record:
    """Give a record of the true arm: what is known of the payload, and what it carried."""
    q = travel(SECONDS, RATE, seed, HOLD)
    strain, _ = recorded(ARM, {**TRUTH, 'payload': carried}, q, RATE, LESS, seed)
    return Record(q, even(len(q), RATE), strain, payload=payload)


def lone_record(seed: int, payload: float = 0.2, known: bool = True) -> Record:
    """Give a record of the single blade."""
    recording = lone_recording(seed, payload=payload)
    assert recording.strain is not None
    return Record(recording.q, even(len(recording.q), RATE), recording.strain,
                  payload=payload if known else None)


@pytest.fixture(scope='module')
def found() -> Identified:
    """Identify once."""
    return identify(ARM, [record(3), record(4)])


def test_stiffness_and_masses_are_found(found: Identified) -> None:
    """Within 3 %, or half a standard error; damping and backlash within 20 %."""
    checked = []
    for parameter in found.physical:
        truth = TRUTH.get(parameter.name)
        if truth is None or not parameter.shown:
            continue
        kind = parameter.name.partition('(')[0]
        if kind in ('gear', 'bending', 'lumped', 'density'):
            room = max(0.03 * truth, 0.5 * parameter.standard_error)
            assert parameter.value == pytest.approx(truth, abs=room), parameter
        else:
            assert parameter.value == pytest.approx(truth, rel=0.2), parameter
        checked.append(parameter.name)
    assert {'gear(j1)', 'lumped(j1,1)', 'beta', 'play(j1)'} <= set(checked)


def test_standard_errors_are_honest(found: Identified) -> None:
    """The truth lies within three of them, for every parameter, shown or not."""
    nominal = dict(knowledge_of(ARM, payload=False).start)
    for parameter in found.physical:
        truth = TRUTH.get(parameter.name, nominal[parameter.name])
        assert parameter.standard_error > 0.0
        assert abs(parameter.value - truth) < 3.0 * parameter.standard_error, parameter


def test_gauges_noise_and_fit(found: Identified) -> None:
    """Gains and offsets come out, the noise is that of the gauges, and nothing is left over."""
    assert found.gauges[:, 0] == pytest.approx(GAINS, rel=0.03)
    assert found.gauges[:, 1] == pytest.approx(OFFSETS, abs=4.0)
    assert (np.abs(found.gauges[:, 1] - OFFSETS) < 4.0 * found.gauge_errors[:, 1]).all()
    assert found.noise == pytest.approx([LESS, LESS], rel=0.15)
    assert found.fit > 97.0


def test_it_explains_what_it_has_not_seen(found: Identified) -> None:
    """Another motion, with the parameters found: noise is left over."""
    new = record(9)
    values = {p.name: p.value for p in found.physical} | {'payload': 0.25}
    simulated, _ = recorded(ARM, values, new.q, RATE, noise=0.0)
    moments = (simulated - OFFSETS) / GAINS
    errors = new.strain - moments * found.gauges[:, 0] - found.gauges[:, 1]
    assert fit_percent(errors, new.strain) > 96.0


def test_an_unknown_payload_is_found() -> None:
    """
    The mass at the tip among the parameters, starting at another value.

    Strain alone shows ratios of masses, as the gauge's gain is unknown; another recording, whose
    payload is known, gives the scale.
    """
    found = identify(lone_arm(), [lone_record(3, payload=0.3, known=False), lone_record(4)],
                     warm=LONE_TRUTH)
    (payload,) = (p for p in found.physical if p.name == 'payload')
    assert payload.shown
    assert payload.value == pytest.approx(0.3, rel=0.05)
    assert abs(payload.value - 0.3) < 3.0 * payload.standard_error


@pytest.mark.parametrize('seeds', first((3, 4), (5, 6)))
def test_a_rigid_gear_is_found(seeds: tuple[int, int]) -> None:
    """Described as elastic with play: both go, the link keeps its stiffness, unseen motion too."""
    arm, truth = lone_arm(), {**LONE_TRUTH, 'gear(j1)': 4000.0, 'play(j1)': 0.0}
    records = []
    for seed in seeds:
        q = travel(12.0, RATE, seed)[:, :1]
        strain, _ = recorded(arm, {**truth, 'payload': 0.2}, q, RATE, NOISE, seed)
        records.append(Record(q, even(len(q), RATE), strain[:, :1], payload=0.2))
    found = identify(arm, records, warm={**LONE_TRUTH, 'gear(j1)': 3000.0})
    values = {p.name: p for p in found.physical}
    assert values['play(j1)'].value == 0.0 and not values['play(j1)'].shown
    assert values['gear(j1)'].value > 2000.0 and np.isnan(values['gear(j1)'].standard_error)
    assert values['bending(j1)'].value == pytest.approx(15.0, rel=0.05)
    again = taken_over(arm, records, found)
    assert {p.name: p.value for p in again.physical}['play(j1)'] == 0.0


def test_how_a_mass_is_spread_is_found() -> None:
    """An elbow that is described as a point, and is none, leaves gears and links as they are."""
    truth = {**TRUTH, 'gyration(j1,1)': 0.05}
    records = []
    for seed in (3, 4):
        q = travel(SECONDS, RATE, seed, HOLD)
        strain, _ = recorded(ARM, truth, q, RATE, LESS, seed)
        records.append(Record(q, even(len(q), RATE), strain, payload=0.25))
    values = {p.name: p for p in identify(ARM, records, warm=TRUTH).physical}
    for name in ('gyration(j1,1)', 'gear(j1)', 'gear(j2)', 'bending(j1)', 'bending(j2)'):
        found, wanted = values[name], truth[name]
        error = abs(found.value - wanted)
        assert error < 3.0 * found.standard_error and error < 0.1 * wanted, found


def test_which_gears_may_be_simple() -> None:
    """By how much they give way, and by how far their play is from what was described."""
    arm = lone_arm()
    known = knowledge_of(arm, payload=False).without('lag')

    def held(**changes: float) -> tuple[dict[str, float], dict[str, float]]:
        values = {**known.start, **{f'{name}(j1)': v for name, v in changes.items()}}
        simple, begun = simple_gears(arm, known, np.log([values[n] for n in known.names]))
        return simple.held, dict(zip(simple.names, np.exp(begun).tolist(), strict=True))

    assert held() == ({}, pytest.approx(known.start))
    rigid, rest = held(gear=5000.0)
    assert rigid['play(j1)'] == 0.0 and rigid['gear(j1)'] > 2000.0 and 'gear(j1)' not in rest
    wide, rest = held(gear=3000.0, play=0.3, edge=0.4)
    assert wide['play(j1)'] == 0.0 and 'gear(j1)' not in wide
    assert rest['gear(j1)'] == pytest.approx(3000.0 * (1.0 - 1.0 / np.hypot(1.0, 0.4)))


def test_two_payloads_at_once() -> None:
    """Each record with its own: the problem simulates each with its payload."""
    heavy = record(4, 0.5, 0.5)
    names = ('bending(j1)', 'gear(j1)')
    fixed = {k: v for k, v in TRUTH.items() if k not in names and k != 'payload'}
    center = np.log([TRUTH[name] for name in names])
    problem = Problem(ARM, [record(3), heavy], names, fixed, center, np.ones(2), inner=2.5e-3)
    moments = problem.moments(center)
    assert moments is not None
    assert problem.errors(moments, center).std(axis=0) == pytest.approx([LESS, LESS], rel=0.1)


def test_coordinates_and_back() -> None:
    """Compliances and masses relative to the centre; the slope is that of the way back."""
    names = ('bending(j1)', 'gear(j1)', 'density(j1)', 'lumped(j1,1)', 'payload', 'play(j1)')
    center, x = np.linspace(-3.0, 2.0, 6), np.linspace(1.0, -2.0, 6)
    straight = Straight(names, center, 0)
    u = straight.of(x)
    assert straight.back(u) == pytest.approx(x, abs=1e-12)
    assert u[0] == pytest.approx(np.exp(center[0]) / np.exp(x[0]))
    assert u[2] == pytest.approx(np.exp(x[2]) / np.exp(center[2]))
    assert u[5] == x[5]
    for i in range(6):
        h = np.zeros(6)
        h[i] = 1e-6 * abs(u[i])
        slope = (straight.back(u + h) - straight.back(u - h))[i] / (2.0 * h[i])
        assert slope == pytest.approx(straight.slope(u)[i], rel=1e-6)


def test_jacobian_is_that_of_the_residual() -> None:
    """
    Against differences: gains and offsets are eliminated, outliers' weights kept.

    Kaufman's form leaves out a term that vanishes with the errors, so at the truth.
    """
    q = travel(8.0, RATE, 5)
    strain, _ = recorded(ARM, TRUTH, q, RATE, noise=0.0)
    names = ('bending(j1)', 'gear(j2)', 'lumped(j1,1)', 'tight(j1)')
    fixed = {k: v for k, v in TRUTH.items() if k not in names}
    x = np.log([TRUTH[name] for name in names])
    problem = Problem(ARM, [Record(q, even(len(q), RATE), strain, payload=0.25)], names, fixed, x,
                      np.full(4, 0.5))
    assert np.abs(problem.residuals([x])[0]).max() < 1e-6
    jacobian = problem.jacobian(x)
    for i in range(len(names)):
        moved = [x.copy(), x.copy()]
        moved[0][i] += 1e-3
        moved[1][i] -= 1e-3
        up, down = problem.residuals(moved)
        column = (up - down) / 2e-3
        assert np.linalg.norm(jacobian[:, i] - column) < 0.02 * np.linalg.norm(column), names[i]


def test_outliers_count_little() -> None:
    """Readings that are spoilt for a while hardly move the result."""
    spoilt = lone_record(3)
    strain = spoilt.strain.copy()
    strain[500:530, 0] += 400.0
    strain[900, 0] = 5000.0
    found = identify(lone_arm(), [Record(spoilt.q, spoilt.dt, strain, payload=0.2)],
                     warm=LONE_TRUTH)
    values = {p.name: p for p in found.physical}
    for name, truth in (('gear(j1)', LONE_TRUTH['gear(j1)']), ('lumped(j1,1)', 0.8)):
        off = abs(values[name].value - truth)
        assert off < 0.1 * truth and off < 2.0 * values[name].standard_error
    assert found.noise == pytest.approx([NOISE], rel=0.3)


def test_impossible_motion_is_told() -> None:
    """Positions that no parameters can follow: a reason, not a traceback."""
    q: FloatArray = np.zeros((1000, 2))
    q[500:] = 1e9
    with pytest.raises(FitError, match='cannot be simulated'):
        identify(ARM, [Record(q, even(1000, RATE), np.ones((1000, 2)), payload=0.2)])
