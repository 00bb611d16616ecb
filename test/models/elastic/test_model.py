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

"""The elastic model: outputs, payloads, memory, and what it refuses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from elastic_making import along, blade_arm, even, GAINS, OFFSETS, recorded, travel
import numpy as np
import pytest
from sample_arms import recording_of

from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import FitError, ModelError, NotFittedError, TudorWarning
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.models.elastic.model import ElasticModel, LiveElastic, PhysicalParameter
from tudor_dynamics.models.friction import friction_columns
from tudor_dynamics.signals.filters import MotionState
from tudor_dynamics.signals.preprocessing import prepare
from tudor_dynamics.typing import FloatArray

RATE = 100.0
ARM = blade_arm(joints=[{'name': 'j1', 'friction': ['viscous', 'coulomb']},
                        {'name': 'j2', 'friction': ['viscous', 'coulomb'], 'asymmetric': True}])


def model_of(output: str = 'strain', *physical: PhysicalParameter, **more: Any) -> ElasticModel:
    """Make a model that has learned something."""
    model = ElasticModel(ARM, output, physical, **more)
    if output == 'strain':
        model.coefficients_ = tuple(np.column_stack([GAINS, OFFSETS]))
    else:
        model.coefficients_ = tuple(np.arange(1.0, 1.0 + len(c)) for c in model.columns)
    model.standard_errors_ = tuple(np.full(len(c), 0.1) for c in model.columns)
    model.noise_ = np.array([2.0, 3.0])
    return model


def moving(seconds: float = 3.0) -> tuple[FloatArray, FloatArray]:
    """Give ``[q, dq, ddq]`` and times between samples."""
    q = travel(seconds, RATE, hold=1.5)
    dq = np.gradient(q, 1.0 / RATE, axis=0)
    return np.hstack([q, dq, np.gradient(dq, 1.0 / RATE, axis=0)]), even(len(q), RATE)


def test_strain_is_gain_times_moment_and_offset() -> None:
    """Along a motion, with parameters that differ from the description."""
    motion, dt = moving()
    values = {'bending(j1)': 14.0, 'payload': 0.3}
    strain, _ = recorded(ARM, values, motion[:, :2], RATE, noise=0.0)
    model = model_of('strain', PhysicalParameter('bending(j1)', 14.0, 'N m^2'),
                     PhysicalParameter('payload', 0.3, 'kg'))
    assert np.array_equal(along(model, motion, dt), strain)
    assert model.channels == ('g1', 'g2') and model.values == values


def test_effort_is_torque_rotor_and_friction() -> None:
    """Columns of each joint: gear, rotor inertia, friction, and one constant at most."""
    model = model_of('effort')
    assert model.columns == (
        ('torque', 'Ia(j1)', 'viscous(j1)', 'coulomb(j1)', 'offset'),
        ('torque', 'Ia(j2)', 'viscous+(j2)', 'viscous-(j2)', 'coulomb+(j2)', 'coulomb-(j2)'))
    motion, dt = moving()
    torque = DrivenArm(ARM).follow(motion[:, :2], dt).torque
    found = along(model, motion, dt)
    dq, ddq = motion[:, 2:4], motion[:, 4:]
    fast = np.abs(dq).min(axis=1) > 0.15
    assert fast.sum() > 20
    first = torque[:, 0] + 2.0 * ddq[:, 0] + 3.0 * dq[:, 0] + 4.0 * np.sign(dq[:, 0]) + 5.0
    assert np.allclose(found[fast, 0], first[fast], atol=1e-6)
    friction = friction_columns(ARM.joints[1], dq[:, 1]) @ [3.0, 4.0, 5.0, 6.0]
    second = torque[:, 1] + 2.0 * ddq[:, 1] + friction
    assert np.allclose(found[:, 1], second, atol=1e-9)


def test_a_payload_put_in() -> None:
    """``at`` changes the payload alone, keeps what was learned, and its old model as it was."""
    motion, dt = moving()
    base = model_of('strain', PhysicalParameter('bending(j1)', 15.0, 'N m^2'),
                    payload_range=(0.0, 0.4))
    heavy = base.at(0.35)
    assert heavy.values == {'bending(j1)': 15.0, 'payload': 0.35}
    assert heavy.coefficients_ is base.coefficients_ and heavy.noise_ is base.noise_
    strain, _ = recorded(ARM, heavy.values, motion[:, :2], RATE, noise=0.0)
    assert np.array_equal(along(heavy, motion, dt), strain)
    assert base.values == {'bending(j1)': 15.0}
    twice = heavy.at(0.1)
    assert [p.name for p in twice.physical].count('payload') == 1
    for wrong in (-0.1, float('nan')):
        with pytest.raises(FitError):
            base.at(wrong)
    with pytest.warns(TudorWarning, match='extrapolates'):
        base.at(5.0)


def test_no_prediction_without_a_past() -> None:
    """Single samples, other joints, or nothing learned: refused with the reason."""
    motion, dt = moving()
    with pytest.raises(FitError, match='needs earlier samples'):
        model_of().predict(motion)
    with pytest.raises(NotFittedError, match='no coefficients'):
        along(ElasticModel(ARM, 'strain'), motion, dt)
    three = prepare(recording_of(np.zeros((300, 3)), RATE), PreprocessingSpec())[0]
    with pytest.raises(FitError):
        model_of().follow(three)
    with pytest.raises(ModelError, match='no parameter'):
        along(model_of('strain', PhysicalParameter('spring', 1.0, 'N m')), motion, dt)
    rigid = blade_arm(links=[], motors=[])
    with pytest.raises(ModelError, match="the key 'links' is missing"):
        LiveElastic({'strain': _of(rigid)})


def _of(arm: Any) -> ElasticModel:
    model = ElasticModel(arm, 'strain')
    model.coefficients_ = tuple(np.ones((2, 2)))
    return model


def test_the_motion_before_counts() -> None:
    """A stretch cut out of a motion: with what was before it, the very values of the whole."""
    motion, dt = moving(4.0)
    model = model_of()
    whole = along(model, motion, dt)
    cut = 150
    before = np.column_stack([dt[:cut], motion[:cut, :2]])
    assert np.array_equal(along(model, motion[cut:], dt[cut:], before), whole[cut:])
    alone = along(model, motion[cut:], dt[cut:])
    assert np.abs(alone[:50] - whole[cut:cut + 50]).max() > 2.0


@pytest.mark.parametrize('lag', [0.0, 0.04])
def test_strain_shows_how_it_begins(lag: float) -> None:
    """Cut out of a motion, with nothing of what was before: 2 s of strain make up for it."""
    rate, cut = 200.0, 800
    q, dt = travel(11.0, rate), even(2201, rate)
    dq = np.gradient(q, 1.0 / rate, axis=0)
    motion = np.hstack([q, dq, np.gradient(dq, 1.0 / rate, axis=0)])
    late = (PhysicalParameter('lag', lag, 's'),) if lag else ()
    strain, effort = model_of('strain', *late), model_of('effort', *late)
    effort.strain_model = strain
    truth = {model.output: along(model, motion, dt)[cut:] for model in (strain, effort)}
    noisy = truth['strain'] + np.random.default_rng(1).normal(0.0, 2.0, truth['strain'].shape)
    (stretch,) = prepare(recording_of(q[cut:], rate, strain=noisy, effort=truth['effort']),
                         PreprocessingSpec())
    assert stretch.past_unknown
    states = MotionState(*(part.copy() for part in np.hsplit(motion[cut:], 3)))
    stretch, later = replace(stretch, states=states, strain=noisy), slice(round(2.5 * rate), None)
    for model in (strain, effort):
        true = truth[model.output]
        plain = np.abs(along(model, stretch.motion, stretch.dt) - true)[later].max()
        seen = np.abs(model.follow(stretch) - true)[later].max()
        assert seen < 0.05 * plain, (model.output, seen, plain)
    assert effort.at(0.1).gauges is not None
    effort.strain_model = None
    plain = along(effort, stretch.motion, stretch.dt)
    assert np.array_equal(effort.follow(stretch), plain)


def test_live_equals_the_whole_motion() -> None:
    """Sample by sample, effort and strain on one arm, as ``follow`` gives them."""
    motion, dt = moving()
    models = {'strain': model_of('strain'), 'effort': model_of('effort')}
    live = LiveElastic(models)
    for k in range(len(motion)):
        found = live.step(float(dt[k]), motion[k])
        assert found is not None
        if k == 0:
            rows: dict[str, list[FloatArray]] = {name: [] for name in found}
        for name, values in found.items():
            rows[name].append(values)
    for name, model in models.items():
        assert np.abs(np.array(rows[name]) - along(model, motion, dt)).max() < 1e-9


def test_live_begins_anew_after_the_impossible() -> None:
    """A jump of the joints that makes it diverge costs samples, not the process."""
    live = LiveElastic({'strain': model_of()})
    motion, dt = moving()
    assert live.step(0.0, motion[0]) is not None
    wild = motion[1].copy()
    wild[0] = 1e9
    assert live.step(0.01, wild) is None
    found = live.step(0.01, motion[2])
    rested = along(model_of(), motion[2:3], np.zeros(1))
    assert found is not None and np.array_equal(found['strain'], rested[0])


def test_impossible_observers() -> None:
    """An observer needs a fitted model of the strain, of the same arm, with gains."""
    with pytest.raises(ModelError, match='no elastic model'):
        LiveElastic({})
    assert LiveElastic({'strain': model_of()}).observing
    assert not LiveElastic({'effort': model_of('effort')}).observing
    with pytest.raises(ModelError, match='effort and strain differ'):
        LiveElastic({'effort': model_of('effort', PhysicalParameter('payload', 0.1, 'kg')),
                     'strain': model_of()})
    dead = model_of()
    dead.coefficients_ = (np.array([0.0, 1.0]), np.array([50.0, 0.0]))
    with pytest.raises(ModelError, match='gain 0'):
        LiveElastic({'strain': dead})


def test_gauges_that_lag_are_observed() -> None:
    """Ringing from before the beginning is taken over, also after gauges that lag."""
    model, (motion, dt) = model_of(), moving()
    late = ElasticModel(model.arm, 'strain', (
        *(p for p in model.physical if p.name != 'lag'), PhysicalParameter('lag', 0.04, 's')))
    late.coefficients_, late.noise_ = model.coefficients_, np.ones(len(model.channels))
    true, plain, seen = (LiveElastic({'strain': late}) for _ in range(3))
    begin, left = len(motion) // 5, []
    for k, (row, step) in enumerate(zip(motion, dt, strict=True)):
        here = true.step(step, row)
        if here is None or k < begin:
            continue
        fresh, corrected = (live.step(step if k > begin else 0.0, row) for live in (plain, seen))
        assert fresh is not None and corrected is not None
        left.append([here['strain'] - fresh['strain'], here['strain'] - corrected['strain']])
        seen.measure(here['strain'])
    missed, observed = np.abs(left[len(left) // 2:]).max(axis=(0, 2))
    assert missed > 5.0, 'it rings'
    assert observed < 0.3 * missed
