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

"""The driven arm: statics and frequencies by hand, against the full plant, and its numerics."""

from __future__ import annotations

from math import cos, cosh, exp, pi, sin, sinh, sqrt, tan, tanh
from typing import Any

from elastic_making import blade, blade_arm, even, stepwise, travel
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from sample_arms import gauge, LENGTH_1, LENGTH_2, planar_arm

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.mechanics.mechanism import build_mechanism
from tudor_dynamics.mechanics.plant import Plant
from tudor_dynamics.mechanics.run import Probe
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.models.elastic.kernel import BLUR, gear
from tudor_dynamics.models.settings import EDGE

G = 9.81
EI = 2.06e11 * 0.015 * 0.004**3 / 12
"""Of the blade [N m^2]."""
DENSITY = 7850 * 0.015 * 0.004
"""[kg/m]"""
NO_PLAY = {'play(j1)': 0.0, 'play(j2)': 0.0}
RIGID = {'bending(j1)': 1e7, 'bending(j2)': 1e7, 'gear(j1)': 1e10, 'gear(j2)': 1e10, **NO_PLAY}


def mast(mass: float = 0.6, length: float = 0.42, **changes: float) -> DrivenArm:
    """Build one blade that leans, a mass at its end, stiff gears; the next link is none."""
    arm = planar_arm(
        gauges=[gauge('g1', 'j1', 0.0)],
        links=[{'joint': 'j1', 'flexible': blade(lumped=[{'mass': mass}], stretch=True)},
               {'joint': 'j2', 'rigid': {'mass': 0.0}}], active_joints=['j1'],
        joints=[{'name': 'j1'}, {'name': 'j2', 'hold': 0.0}])
    driven = DrivenArm(arm)
    driven.set_parameters({'gear(j1)': 1e7, 'beta': 0.0, **changes})
    assert length == LENGTH_1
    return driven


def leaning_arm(**more: Any) -> Arm:
    """Build the two blades so that bending draws their ends in."""
    return blade_arm(links=[
        {'joint': 'j1', 'flexible': blade(lumped=[{'mass': 0.8}], stretch=True, **more)},
        {'joint': 'j2', 'flexible': blade(stretch=True, **more)}])


def at_rest(driven: DrivenArm, *q: float) -> Any:
    """Let the arm rest."""
    return driven.follow(np.array([q]), np.zeros(1))


@pytest.mark.parametrize('q', [(0.0, 0.0), (0.7, -0.4), (2.2, 0.9), (-1.0, 1.4)])
def test_moment_at_rest_is_weight_times_lever(q: tuple[float, float]) -> None:
    """Links too stiff to bend: gauges and gears feel the static moments, to 1e-6."""
    driven = DrivenArm(blade_arm())
    driven.set_parameters(RIGID)
    found = at_rest(driven, *q)
    total = q[0] + q[1]
    first, second = cos(q[0]), cos(total)

    def outer(near: float) -> float:
        """Moment of what lies beyond a place on the second link."""
        return G * second * (0.2 * (LENGTH_2 - near) + DENSITY * (LENGTH_2 - near)**2 / 2)

    beyond = G * (0.8 + 0.2 + DENSITY * LENGTH_2)

    def inner(near: float) -> float:
        lever = LENGTH_1 - near
        return outer(0.0) + beyond * lever * first + G * DENSITY * lever**2 / 2 * first

    assert found.moment[0] == pytest.approx([inner(0.05), outer(0.05)], abs=1e-6)
    assert found.torque[0] == pytest.approx([inner(0.0), outer(0.0)], abs=1e-6)


def test_soft_gear_gives_way() -> None:
    """Stiff links in a soft gear: the arm rests where the twist times stiffness is the moment."""
    driven = DrivenArm(blade_arm())
    driven.set_parameters({**RIGID, 'gear(j1)': 40.0, 'gear(j2)': 1e10})
    found = at_rest(driven, 0.3, 0.0)

    def weight(angle: float) -> float:
        lever = (0.8 * LENGTH_1 + 0.2 * (LENGTH_1 + LENGTH_2)
                 + DENSITY * (LENGTH_1 + LENGTH_2)**2 / 2)
        return G * lever * cos(angle)

    twist = 0.0
    for _ in range(100):
        twist = weight(0.3 - twist) / 40.0
    assert twist > 0.1
    assert found.torque[0, 0] == pytest.approx(weight(0.3 - twist), abs=1e-6)


def test_inside_the_play_the_gear_is_slack() -> None:
    """A play shifts the twist by its half, less what its rounded edge gives."""
    driven = DrivenArm(blade_arm())
    driven.set_parameters({**RIGID, 'gear(j1)': 400.0, 'play(j1)': 0.05})
    torque = at_rest(driven, 0.0, 0.0).torque[0, 0]
    twist = torque / 400.0 + 0.05
    lever = 0.8 * LENGTH_1 + 0.2 * (LENGTH_1 + LENGTH_2) + DENSITY * (LENGTH_1 + LENGTH_2)**2 / 2
    rounding = 0.5 * (EDGE * 0.05)**2 * (1 / (2 * (twist - 0.05)) - 1 / (2 * (twist + 0.05)))
    assert torque == pytest.approx(G * lever * cos(twist + rounding), rel=2e-3)


def test_bending_and_pressure_at_rest() -> None:
    """A leaning blade under the weight at its end: the beam-column formula F tan(kL) / k."""
    for angle in (2.2, -2.2, 0.0):
        found = at_rest(mast(**{'density(j1)': 1e-9}), angle).moment[0, 0]
        load, push = 0.6 * G * cos(angle), 0.6 * G * sin(angle)
        k = sqrt(abs(push) / EI)
        factor = LENGTH_1 if push == 0 else (tan if push > 0 else tanh)(k * LENGTH_1) / k
        assert found == pytest.approx(load * factor, rel=3e-4), angle


@pytest.mark.parametrize(('angle', 'weight'), [(pi / 2, 1), (pi / 2, 0), (-pi / 2, 1)])
def test_frequency_of_an_upright_mast(angle: float, weight: int) -> None:
    """
    The weight lowers the frequency of a standing mast and raises that of a hanging one.

    Massless beam-column with a mass at its end, lateral stiffness P / (tan(kL) / k - L).
    """
    driven = mast(**{'density(j1)': 1e-9})
    if not weight:
        driven.tables.chain.base[:] = 0.0
    rate, n = 400.0, 1600
    q = np.full((n, 1), angle)
    q[5:] += 1e-3
    moment = driven.follow(q, even(n, rate)).moment[100:, 0]
    rise = moment - moment.mean()
    edges = np.flatnonzero((rise[:-1] < 0) & (rise[1:] >= 0))
    cross = edges - rise[edges] / (rise[edges + 1] - rise[edges])
    found = (len(cross) - 1) / ((cross[-1] - cross[0]) / rate)
    push = 0.6 * G * weight * np.sign(angle)
    k = sqrt(abs(push) / EI)
    stiffness = 3 * EI / LENGTH_1**3
    if push > 0:
        stiffness = push / (sin(k * LENGTH_1) / cos(k * LENGTH_1) / k - LENGTH_1)
    elif push < 0:
        stiffness = push / (sinh(k * LENGTH_1) / cosh(k * LENGTH_1) / k - LENGTH_1)
    expected = sqrt(stiffness / 0.6) / (2 * pi)
    assert found == pytest.approx(expected, rel=2e-3)
    free = sqrt(3 * EI / LENGTH_1**3 / 0.6) / (2 * pi)
    assert np.sign(round(found - free, 2)) == (-np.sign(push) if push else 0.0)


def test_agrees_with_the_full_plant() -> None:
    """Four finite elements a link, prescribed motion: the moments agree within 1 %."""
    arm = leaning_arm(elements=4)
    rate, n = 500.0, 1001
    t = np.arange(n) / rate
    q = stepwise(t, np.array([[0.3, 0.2], [0.8, -0.3]]), ramp=0.8)
    dq = np.gradient(q, 1 / rate, axis=0)
    ddq = np.gradient(dq, 1 / rate, axis=0)
    plant = Plant(build_mechanism(arm), 1 / rate)
    for joint in ('j1', 'j2'):
        plant.drive(joint, 'motion')
    plant.reset(q[0])
    look = Probe(plant, [], arm)
    expected = [look.observe().gauge_moment.copy()]
    for k in range(1, n):
        plant.step(motion=(q[k], dq[k], ddq[k]))
        expected.append(look.observe().gauge_moment.copy())
    driven = DrivenArm(arm)
    driven.set_parameters({'gear(j1)': 1e6, 'gear(j2)': 1e6, **NO_PLAY})
    found = driven.follow(q, even(n, rate)).moment
    truth = np.array(expected)
    error = np.sqrt(np.mean((found - truth)**2, axis=0))
    swing = truth[250:].max(axis=0) - truth[250:].min(axis=0)
    assert (swing > 0.2).all()  # there is a motion to compare
    assert (error < 0.01 * np.abs(truth).max(axis=0)).all()
    assert (error < 0.03 * swing).all()


def test_one_call_is_as_good_as_many() -> None:
    """Sample by sample gives the very numbers of a whole stretch; dt 0 begins again."""
    arm, rate = blade_arm(), 100.0
    q = travel(3.0, rate)
    dt = even(len(q), rate)
    one, other = DrivenArm(arm), DrivenArm(arm)
    whole = one.follow(q, dt)
    single = [other.follow(q[k:k + 1], dt[k:k + 1]) for k in range(len(q))]
    assert np.array_equal(whole.moment, np.vstack([part.moment for part in single]))
    assert np.array_equal(whole.torque, np.vstack([part.torque for part in single]))
    again = one.follow(q, dt)
    assert np.array_equal(whole.moment, again.moment)
    rested = one.follow(q[150:151], np.zeros(1)).moment
    assert np.array_equal(rested, DrivenArm(arm).follow(q[150:151], np.zeros(1)).moment)
    assert np.abs(rested - whole.moment[150]).max() > 1e-3


def test_sample_rates_agree() -> None:
    """The same motion at 100 Hz, 500 Hz and 2 kHz: finite, and alike within 3 %."""
    arm = blade_arm()
    moments = {}
    for rate in (100, 500, 2000):
        t = np.arange(5 * rate + 1) / rate
        q = stepwise(t, np.array([[0.2, 0.3], [1.4, -0.6], [2.3, 0.4]]))
        moments[rate] = DrivenArm(arm).follow(q, even(len(q), rate)).moment[::rate // 100]
    for rate in (100, 500):
        error = np.sqrt(np.mean((moments[rate] - moments[2000])**2, axis=0))
        assert (error < 0.03 * moments[2000].std(axis=0)).all(), rate


@pytest.mark.parametrize('inner', [2.5e-3, 2.5e-4])
def test_strongly_bent(inner: float) -> None:
    """
    Motion at many times the limits of an arm bends it by half a radian: no step diverges.

    The normal force of a bent beam depends on its accelerations; corrections with a mass matrix
    that does not know this diverged, the sooner the shorter the steps were.
    """
    rate = 100.0
    t = np.arange(301) / rate
    q = stepwise(t, np.array([[0.2, 0.3], [1.4, -0.6], [2.3, 0.4]]), ramp=0.5)
    arm = leaning_arm()
    driven = DrivenArm(arm, inner=inner)
    reference = DrivenArm(arm, inner=1e-3).follow(q, even(len(q), rate)).moment
    found = driven.follow(q, even(len(q), rate)).moment
    assert np.abs(found).max() > 20.0
    error = np.sqrt(np.mean((found - reference)**2, axis=0))
    assert (error < 0.02 * reference.std(axis=0)).all()


def test_uneven_samples() -> None:
    """Jitter of the stamps and a lost sample change little, a sample in a microsecond nothing."""
    arm, rate = blade_arm(), 200.0
    q = travel(4.0, rate)
    t = np.arange(len(q)) / rate
    reference = DrivenArm(arm).follow(q, even(len(q), rate)).moment
    keep = np.sort(np.random.default_rng(1).choice(np.arange(1, len(q)), 700, replace=False))
    keep = np.concatenate([[0], keep])
    found = DrivenArm(arm).follow(q[keep], np.diff(t[keep], prepend=t[0])).moment
    assert np.abs(found - reference[keep]).max() < 0.05 * reference.std(axis=0).max()
    driven = DrivenArm(arm)
    dt = even(len(q), rate)
    driven.follow(q[:300], dt[:300])
    before = driven.follow(q[300:301], dt[300:301]).moment
    after = driven.follow(q[300:301], np.array([1e-6])).moment
    assert np.abs(after - before).max() < 0.05 * reference.std(axis=0).max()


@given(twist=st.floats(-0.05, 0.05), rate=st.floats(-2.0, 2.0), play=st.floats(0.0, 0.02),
       stiff=st.floats(1.0, 1e4))
@settings(max_examples=100, deadline=None)
def test_gear_and_its_derivatives(twist: float, rate: float, play: float, stiff: float) -> None:
    """Stiffness is the slope of the torque, damping that by the rate; the torque is odd."""
    row = np.array([stiff, play, max(EDGE * play, 1e-4), 0.5, 0.1, 0.0])
    torque, slope, damping = gear(row, twist, 0.0)
    h = 1e-7
    by_difference = (gear(row, twist + h, 0.0)[0] - gear(row, twist - h, 0.0)[0]) / (2 * h)
    assert by_difference == pytest.approx(slope, rel=1e-4, abs=1e-4 * stiff)
    assert gear(row, twist, rate)[0] == pytest.approx(torque + damping * rate, rel=1e-12)
    assert gear(row, -twist, -rate)[0] == pytest.approx(-gear(row, twist, rate)[0], abs=1e-9)
    assert 0.0 <= slope <= stiff * (1 + 1e-12)
    assert 0.1 - 1e-12 <= damping <= 0.5 + 1e-12


def test_no_torque_in_the_play() -> None:
    """Midway the gear is free; well outside it is a spring shifted by the play."""
    row = np.array([200.0, 0.01, 0.001, 0.5, 0.1, 0.0])
    assert gear(row, 0.0, 0.0)[0] == 0.0
    assert abs(gear(row, 0.005, 0.0)[0]) < 0.02 * 200.0 * 0.005
    assert gear(row, 0.005, 0.0)[1] < 0.02 * 200.0
    assert gear(row, 0.005, 1.0)[2] == pytest.approx(0.1, abs=0.01)
    assert gear(row, 0.05, 0.0)[0] == pytest.approx(200.0 * 0.04, rel=1e-3)
    assert gear(row, 0.05, 1.0)[2] == pytest.approx(0.5, abs=1e-3)
    sharp = np.array([200.0, 0.0, 1e-9, 0.5, 0.1, 0.0])
    assert gear(sharp, 0.003, 0.0)[0] == pytest.approx(0.6, rel=1e-9)


def test_edges_act_alike_wherever_steps_meet_them() -> None:
    """The impulse of a crossing scatters by the phase of the steps, less with blurred edges."""
    step, rate, play = 2e-3, 0.2, 0.007

    def scatter(blur: float) -> float:
        row = np.array([200.0, play, 5e-5, 0.0, 0.0, blur])
        impulses = []
        for phase in np.linspace(0.0, 1.0, 40, endpoint=False):
            twists = play + rate * step * (np.arange(-15, 30) + phase)
            exact = 100.0 * (twists[-1] + 0.5 * rate * step - play)**2 / rate
            impulses.append(step * sum(gear(row, twist, rate)[0] for twist in twists) - exact)
        return float(np.std(impulses))

    assert scatter(0.25 * step) < 0.6 * scatter(0.0)
    driven = mast()
    driven.follow(np.linspace(0.5, 0.6, 40)[:, None], even(40, 1000.0))
    assert driven.tables.gears.springs[:, BLUR] == pytest.approx(0.25 * 1e-3)


def test_parameters_scale_what_they_say() -> None:
    """Lumped mass, density and payload enter with their weight; bending changes no statics."""
    driven = DrivenArm(blade_arm())
    driven.set_parameters(RIGID)
    base = at_rest(driven, 0.0, 0.0).moment[0]
    for name, added, lever in (
            ('lumped(j1,1)', 0.3, (LENGTH_1 - 0.05, 0.0)),
            ('payload', 0.1, (LENGTH_1 + LENGTH_2 - 0.05, LENGTH_2 - 0.05)),
            ('density(j2)', 0.2, (LENGTH_2 * (LENGTH_1 + LENGTH_2 / 2 - 0.05),
                                  (LENGTH_2 - 0.05)**2 / 2))):
        old = driven.parameters[name]
        driven.set_parameters({name: old + added})
        change = at_rest(driven, 0.0, 0.0).moment[0] - base
        assert change == pytest.approx(G * added * np.array(lever), abs=1e-5), name
        driven.set_parameters({name: old})
    assert np.array_equal(at_rest(driven, 0.0, 0.0).moment[0], base)
    driven.set_parameters({'bending(j1)': 1e6})
    assert at_rest(driven, 0.0, 0.0).moment[0] == pytest.approx(base, abs=1e-5)


def test_parameters_of_the_description(root: Any) -> None:
    """The reference arm has the parameters that its description gives, backlash halved."""
    found = DrivenArm(load_arm(root / 'config' / 'tudor.yaml')).parameters
    assert found['gear(joint2)'] == 232.0 and found['gear(joint3)'] == 162.0
    assert found['play(joint2)'] == pytest.approx(0.5 * 0.0139626)
    assert found['bending(joint2)'] == pytest.approx(EI)
    assert found['density(joint3)'] == pytest.approx(7846 * 6e-5)
    assert found['lumped(joint2,1)'] == 0.82
    assert found['tight(joint3)'] == found['loose(joint3)'] == 0.2
    assert found['beta'] == 5e-4 and found['payload'] == 0.0


@pytest.mark.parametrize(('changes', 'words'), [
    ({'stiffness': 1.0}, ('no parameter', 'bending(j1)')),
    ({'bending(j3)': 1.0}, ('no parameter', 'bending(j2)')),
    ({'play(j1)': -0.1}, ('play(j1)', '0 or more')),
    ({'beta': float('nan')}, ('beta', '0 or more')),
    ({'payload': float('inf')}, ('payload', '0 or more'))])
def test_impossible_parameters(changes: dict[str, float], words: tuple[str, ...]) -> None:
    """A parameter that does not exist or cannot be is refused with the reason."""
    with pytest.raises(SimulationError) as caught:
        DrivenArm(blade_arm()).set_parameters(changes)
    assert all(word in str(caught.value) for word in words)


def refused(arm: Arm) -> str:
    """Give the reason why an arm cannot be driven."""
    with pytest.raises(SimulationError) as caught:
        DrivenArm(arm)
    return str(caught.value)


def test_arms_without_flexible_links() -> None:
    """No link, a rigid link, a gauge on a rigid link: each is told."""
    assert 'sample.yaml' in refused(blade_arm(links=[], motors=[]))
    rigid = [{'joint': name, 'rigid': {'mass': 0.4}} for name in ('j1', 'j2')]
    assert 'no link is flexible' in refused(blade_arm(links=rigid))
    text = refused(blade_arm(links=[rigid[0], {'joint': 'j2', 'flexible': blade()}]))
    assert "'g1'" in text and 'rigid' in text


def test_buckling_is_told() -> None:
    """A blade that cannot carry the arm upright has no equilibrium, and that is said."""
    driven = DrivenArm(leaning_arm())
    driven.set_parameters({'bending(j1)': 0.2})
    with pytest.raises(SimulationError, match='no equilibrium'):
        at_rest(driven, 1.3, 0.0)


@pytest.mark.parametrize('dt', [0.002, 0.01])
def test_a_lag_is_a_low_pass_of_the_reading(dt: float) -> None:
    """
    Of first order, whatever the sample time; live, in pieces and in one go it is the same.

    Torques know nothing of it. A ramp is late by the time constant.
    """
    lag = 0.04
    t = np.arange(0.0, 2.0, dt)
    q = np.column_stack([0.4 * np.sin(3.0 * t), 0.2 * t])
    steps = np.full(len(t), dt)
    steps[0] = 0.0
    plain, late = DrivenArm(blade_arm()), DrivenArm(blade_arm())
    late.set_parameters({'lag': lag})
    there, read = plain.follow(q, steps), late.follow(q, steps)
    assert (there.torque == read.torque).all()
    expected = np.empty_like(there.moment)
    state = there.moment[0]
    for k, moment in enumerate(there.moment):
        state = state + (1.0 - exp(-steps[k] / lag)) * (moment - state)
        expected[k] = state
    assert read.moment == pytest.approx(expected, rel=1e-9, abs=1e-12)
    live = np.vstack([late.follow(q[k:k + 1], steps[k:k + 1]).moment for k in range(len(t))])
    assert live == pytest.approx(read.moment, rel=1e-9, abs=1e-12)
    both = np.vstack([late.follow(q[:77], steps[:77]).moment,
                      late.follow(q[77:], steps[77:]).moment])
    assert both == pytest.approx(read.moment, rel=1e-9, abs=1e-12)
