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

"""Faults put into recordings and descriptions of a known arm, and what the doctor says of each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from doctor_making import altered, column, described, healthy, late
import numpy as np
import pytest
from sample_arms import gauge

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.bags.recording import Oddities, Recording, SetBack
from tudor_dynamics.identification.doctor.case import Case, decimate
from tudor_dynamics.identification.doctor.examine import examine, link_length, load_of
from tudor_dynamics.identification.doctor.findings import CHECKS, Finding, found
from tudor_dynamics.signals.preprocessing import retimed
from tudor_dynamics.typing import FloatArray

Change = Callable[[Recording], Recording]


def _findings(recording: Recording, arm: Arm | None = None) -> tuple[Finding, ...]:
    return examine(arm or described(), recording).findings


def _one(recording: Recording, arm: Arm | None = None) -> Finding:
    finding, = _findings(recording, arm)
    return finding


def _effort(factors: Any) -> Change:
    return lambda r: replace(r, effort=r.effort * np.array(factors))


def _strain(i: int, changed: Callable[[FloatArray, FloatArray], FloatArray]) -> Change:
    return lambda r: replace(r, strain=column(r.strain, i, lambda x: changed(r.t, x)))


@pytest.mark.parametrize('options', [
    {}, {'seed': 1}, {'seed': 2, 'noise': 3.0}, {'seconds': 9.0}, {'seconds': 60.0},
    {'payload': 0.5}, {'velocity': True}], ids=str)
def test_nothing_is_wrong(options: dict[str, Any]) -> None:
    """Other motion, noise, length, load: nothing is found where nothing is wrong."""
    assert _findings(healthy(**options)) == ()


@pytest.mark.parametrize('changed', [
    _effort([1.0, 1.0 + 1e-3]),
    lambda r: replace(r, effort=late(r.effort, r.t, 0.008)),
    lambda r: replace(r, strain=late(r.strain, r.t, 0.008)),
    _strain(0, lambda t, x: x + 1e3),
    _strain(1, lambda t, x: 1e-3 * x),
    lambda r: replace(_strain(1, lambda t, x: -x)(r), effort=None),
    lambda r: replace(r, strain=None),
    lambda r: replace(r, effort=None),
    lambda r: replace(r, effort=None, strain=None)],
    ids=['scale', 'driver filter', 'amplifier filter', 'zero', 'unit of a gauge',
         'sign of a gauge alone', 'no strain', 'no effort', 'positions alone'])
def test_what_is_no_fault(changed: Change) -> None:
    """Lags of drivers, scales and zeros of gauges, and missing outputs are usual."""
    assert _findings(changed(healthy())) == ()


@pytest.mark.parametrize(('changed', 'kind', 'channels', 'size'), [
    (lambda r: replace(r, effort=late(r.effort, r.t, 0.05)), 'effort_late', (), 0.05),
    (lambda r: replace(r, effort=late(r.effort, r.t, -0.03)), 'effort_late', (), -0.03),
    (lambda r: replace(r, strain=late(r.strain, r.t, 0.08)), 'strain_late', (), 0.08),
    (lambda r: replace(r, q=r.q * [1.0, -1.0]), 'joint_sign', ('j2',), -1.0),
    (lambda r: replace(r, effort=r.effort[:, ::-1]), 'efforts_exchanged', ('j1', 'j2'), None),
    (lambda r: replace(r, effort=r.effort[:, ::-1], q=r.q[:, ::-1]), 'joints_exchanged',
     ('j1', 'j2'), None),
    (lambda r: replace(r, q=r.q[:, ::-1]), 'joints_exchanged', ('j1', 'j2'), None),
    (lambda r: replace(r, strain=r.strain[:, ::-1]), 'gauges_exchanged', ('g1', 'g2'), None),
    (_effort([1.0, 1e3]), 'effort_unit', ('j2',), 1e3),
    (_effort([1e3, 1e3]), 'effort_unit', ('j1', 'j2'), 1e3),
    (_effort([1.0, 0.1]), 'effort_unit', ('j2',), 0.1)])
def test_signs_names_units_and_lags(
    changed: Change, kind: str, channels: tuple[str, ...], size: float | None,
) -> None:
    """Another description explains the outputs better, and is named with its place and size."""
    finding = _one(changed(healthy()))
    assert (finding.kind, finding.channels) == (kind, channels)
    assert finding.size == (None if size is None else pytest.approx(size, abs=0.01, rel=0.05))
    assert finding.now is not None and finding.otherwise is not None
    assert finding.bag == 'run'


def test_an_effort_turned() -> None:
    """Of two efforts of a plane nobody knows which: the kinematics turned fit the other."""
    finding = _one(_effort([1.0, -1.0])(healthy()))
    assert finding.kind in ('effort_sign', 'joint_sign')
    assert set(finding.channels) <= {'j1', 'j2'}


def test_a_current_turned() -> None:
    """Friction that drives shows it where each current has parameters of its own."""
    finding = _one(_effort([1.0, -1.0])(healthy()), described('A'))
    assert (finding.kind, finding.channels) == ('effort_sign', ('j2',))
    assert finding.measure == 'correlation of friction and speed'
    assert finding.now is not None and finding.now < -0.5
    assert 'or that of the position' in finding.remedy


def test_units_of_currents_are_their_own() -> None:
    """A current that is ten times another says nothing; one of a thousand ampere does."""
    assert _findings(_effort([1.0, 10.0])(healthy()), described('A')) == ()
    finding = _one(_effort([1e3, 1e3])(healthy()), described('A'))
    assert (finding.kind, finding.size, finding.measure) == (
        'effort_unit', 1e3, 'largest effort')
    assert 'it looks like mA' in finding.what


def test_velocities_that_come_late() -> None:
    """The derivative of the positions shows the lag of the driver's filter."""
    recording = healthy(velocity=True)
    finding = _one(replace(recording, dq=late(recording.dq, recording.t, 0.06)))
    assert (finding.kind, finding.size) == ('velocity_late', pytest.approx(0.06, abs=0.005))
    assert 'measured_velocity: false' in finding.remedy


@pytest.mark.parametrize(('gravity', 'kind', 'angle'), [
    ((9.81, 0.0, 0.0), 'gravity_axis', 90.0), ((0.0, 9.81, 0.0), 'gravity_axis', 180.0),
    ((0.0, 0.0, -9.81), 'gravity_axis', 90.0)])
def test_gravity(gravity: tuple[float, float, float], kind: str, angle: float) -> None:
    """The direction that explains the outputs is named for the description."""
    finding = _one(healthy(), described(gravity=gravity))
    assert (finding.kind, finding.size) == (kind, pytest.approx(angle, abs=2.0))
    assert finding.unit == 'deg' and finding.remedy.startswith('set gravity: [')
    assert 'gravity along -y' in finding.what


def test_gravity_between_two_axes() -> None:
    """It is turned as far as the outputs ask for it."""
    tilted = described(gravity=(9.81 * np.sin(0.9), -9.81 * np.cos(0.9), 0.0))
    finding = _one(healthy(), tilted)
    assert (finding.kind, finding.size) == ('gravity_axis', pytest.approx(51.6, abs=4.0))


@pytest.mark.parametrize(('changed', 'kind', 'time', 'size'), [
    (lambda t, x: x + 5.0 * t, 'drift', 0.0, 120.0),
    (lambda t, x: np.where(t > 12.0, x[1200], x), 'dying', 12.0, 12.0),
    (lambda t, x: np.where((t > 8.0) & (t < 11.0), x[800], x), 'held', 8.0, 3.0),
    (lambda t, x: np.maximum(x, np.percentile(x, 15.0)), 'saturated', None, None),
    (lambda t, x: np.full_like(x, 7.0), 'constant', 0.0, 7.0),
    (lambda t, x: np.where(np.arange(len(t)) == 900, x + 500.0, x), 'outlier', 9.0, 500.0)])
def test_channels(
    changed: Callable[[FloatArray, FloatArray], FloatArray], kind: str, time: float | None,
    size: float | None,
) -> None:
    """Sensors that drift, die, keep a value, or have too small a range: where and how much."""
    finding = _one(_strain(1, changed)(healthy()))
    assert (finding.kind, finding.channels) == (kind, ('g2',))
    if time is not None:
        assert finding.time == pytest.approx(time, abs=0.05)
        assert finding.size == pytest.approx(size, rel=0.05)


def test_an_effort_follows_no_more() -> None:
    """Noise goes on, and the arm moves on: what dies is not held."""
    random = np.random.default_rng(0)
    recording = healthy()
    finding = _findings(replace(recording, effort=column(recording.effort, 1, lambda x: np.where(
        recording.t > 15.0, random.normal(0.0, 0.05, len(x)), x))))[0]
    assert (finding.kind, finding.channels) == ('dying', ('j2',))
    assert finding.time == pytest.approx(15.0, abs=1.5)
    assert 'use only this part ' in finding.remedy


def test_the_rest_is_judged_without_a_broken_channel() -> None:
    """One gauge is constant, and the efforts come late: both are found."""
    recording = _strain(0, lambda t, x: np.zeros_like(x))(healthy())
    kinds = {item.kind for item in _findings(
        replace(recording, effort=late(recording.effort, recording.t, 0.05)))}
    assert kinds == {'constant', 'effort_late'}


def test_standstill_at_both_ends() -> None:
    """The part in motion is named for the next command."""
    recording = healthy()
    n = len(recording.q)
    held = [np.repeat(x[:1], 500, axis=0) for x in (recording.q, recording.effort,
                                                    recording.strain) if x is not None]
    q, effort, strain = (np.vstack([still, x]) for still, x in zip(
        held, (recording.q, recording.effort, recording.strain), strict=True))
    stamp = recording.stamp[0] + np.arange(n + 500) * 10_000_000
    effort[:500] += np.random.default_rng(0).normal(0.0, 0.02, (500, 2))
    strain[:500] += np.random.default_rng(1).normal(0.0, 0.02, (500, 2))
    finding = _findings(replace(recording, stamp=stamp, q=q, effort=effort, strain=strain,
                                segments=(slice(0, n + 500),)))[-1]
    assert (finding.kind, finding.time) == ('standstill', 0.0)
    assert finding.size == pytest.approx(5.0, abs=0.2)
    assert finding.remedy.startswith((f'use {recording.path}@17-', f'use {recording.path}@16-'))


@pytest.mark.parametrize('already', [False, True])
def test_stamps_that_jitter(already: bool) -> None:
    """Whether even stamps took their place, or not."""
    random = np.random.default_rng(0)
    recording = healthy()
    stamp = recording.stamp + np.round(random.normal(0.0, 1.0e6, len(recording.q))).astype(int)
    recording = replace(recording, stamp=np.sort(stamp))
    even, timing = retimed(recording)
    assert timing is not None
    findings = examine(described(), even, timing).findings if already else _findings(recording)
    finding = next(item for item in findings if item.kind == 'jitter')
    assert finding.size == pytest.approx(1e-3, rel=0.3)
    assert ('evenly spaced stamps are used instead' in finding.what) is already


def test_what_the_reader_saw() -> None:
    """Clocks that were set back, and velocities of zeros."""
    odd = Oddities(set_backs=(SetBack(3.0, 0.5, 50),), zero_velocities=('j1',))
    back, zero = _findings(replace(healthy(), oddities=odd))
    assert (back.kind, back.time, back.size, back.unit) == ('clock_set_back', 3.0, 0.5, 's')
    assert (zero.kind, zero.channels) == ('velocity_zeros', ('j1',))


def _coupled(ratio: float, at: str = 'motors') -> Arm:
    return altered(described(), couplings={
        'pairs': [{'motor': 'j2', 'joint': 'j1', 'ratio': ratio}], 'positions': at,
        'efforts': at})


@pytest.mark.parametrize('ratio', [1.0, -1.0])
def test_drives_that_are_coupled(ratio: float) -> None:
    """Not described they are found; described they are not; described and not there they are."""
    matrix = np.array([[1.0, 0.0], [ratio, 1.0]])
    recording = healthy()
    assert recording.effort is not None
    motors = replace(recording, q=recording.q @ matrix.T,
                     effort=recording.effort @ np.linalg.inv(matrix))
    missing = _one(motors)
    assert (missing.kind, missing.channels, missing.size) == (
        'coupling_missing', ('j2', 'j1'), ratio)
    assert f'ratio: {ratio:g}' in missing.remedy
    assert _findings(motors, _coupled(ratio)) == ()
    wrong = _one(recording, _coupled(ratio))
    assert (wrong.kind, set(wrong.channels)) == ('coupling_wrong', {'j1', 'j2'})


def _table(rows: list[list[float]]) -> Arm:
    convention = described().spec.kinematics.convention
    return altered(described(), kinematics={'dh': rows, 'convention': convention})


@pytest.mark.parametrize(('arm', 'kind', 'size'), [
    (lambda: _table([[420.0, 0.0, 0.0, 0.0], [350.0, 0.0, 0.0, 0.0]]), 'dh_in_millimetres',
     770.0),
    (lambda: _table([[0.42, 180.0, 0.0, 0.0], [0.35, 0.0, 0.0, 0.0]]), 'dh_in_degrees', 180.0),
    (lambda: altered(described(), gauges=[gauge('g1', 'j1', 50.0), gauge('g2', 'j2', 0.05)]),
     'gauge_in_millimetres', 50.0),
    (lambda: altered(described(), gauges=[gauge('g1', 'j1', 0.6), gauge('g2', 'j2', 0.05)]),
     'gauge_beyond_link', 0.6)])
def test_descriptions(arm: Callable[[], Arm], kind: str, size: float) -> None:
    """Lengths and angles that no arm has, with what the bag says of them as evidence."""
    finding = next(item for item in _findings(healthy(), arm()) if item.kind == kind)
    assert finding.size == pytest.approx(size)
    assert finding.measure == 'relative residual' and finding.bag == 'run'


def test_how_far_a_link_reaches() -> None:
    """To the next joint, or the end; nobody knows of a link without length."""
    arm = described()
    assert link_length(arm, arm.gauges[0]) == pytest.approx(0.42)
    assert link_length(arm, arm.gauges[1]) == pytest.approx(0.35)


@pytest.mark.parametrize(('carried', 'known', 'expected'), [
    (0.5, 0.0, 'load_unknown'), (0.0, 0.0, None), (0.5, 0.5, None), (0.0, 0.5, 'load_unknown')])
def test_a_load_that_the_model_does_not_know(
    carried: float, known: float, expected: str | None,
) -> None:
    """A body at the end of the arm explains the residuals of the model, or there are none."""
    recording, other = healthy(payload=carried), healthy(payload=known, seed=0, noise=0.0)
    seen, predicted = decimate(recording), decimate(other)
    assert seen is not None and predicted is not None
    finding = load_of(Case(described(), recording, seen),
                      {name: predicted.output(name) for name in ('effort', 'strain')})
    assert (None if finding is None else finding.kind) == expected
    if finding is not None:
        assert finding.now is not None and finding.otherwise is not None
        assert finding.otherwise < 0.5 * finding.now


def test_another_friction_is_no_load() -> None:
    """Residuals that follow the speed are not those of a body."""
    recording = healthy()
    seen = decimate(recording)
    assert seen is not None
    case = Case(described(), recording, seen)
    speed = seen.motion[:, 2:4]
    assert load_of(case, {'effort': seen.output('effort') - 3.0 * speed}) is None


def test_too_short_to_judge() -> None:
    """Two seconds show samples and stamps, and no description."""
    recording = healthy(seconds=2.0)
    assert decimate(recording) is None
    assert _findings(replace(recording, effort=late(recording.effort, recording.t, 0.1))) == ()


def test_each_check_is_complete() -> None:
    """A title for each; a remedy where no finding gives its own; evidence only with a measure."""
    for kind, check in CHECKS.items():
        assert check.title and ' ' in check.title, kind
    plain = found('jitter', 'what', 'run', size=1e-3, now=2.0, otherwise=1.0)
    assert (plain.unit, plain.measure) == ('s', 'roughness of the positions over time')
    assert str(plain) == ('what (roughness of the positions over time: 2 now, 1 with the remedy); '
                          'let the driver set the stamp when it takes the sample')
    bare = found('dying', 'what', remedy='look')
    assert (bare.unit, bare.measure, bare.evidence, str(bare)) == ('', '', '', 'what; look')
    assert bare.as_dict() == {'kind': 'dying', 'what': 'what', 'remedy': 'look'}
