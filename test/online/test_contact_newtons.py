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

"""What a contact comes to in newtons: its whole size, or why that is not known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.mechanics.campaign import stimulus_motion
from tudor_dynamics.mechanics.closed_loop import ClosedLoop
from tudor_dynamics.mechanics.hardware import Push
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.models.elastic.model import ElasticModel, PhysicalParameter
from tudor_dynamics.online.contact import ContactEstimator
from tudor_dynamics.online.contact_fronts import Span

GAIN = 121.4  # of all gauges of the simulated arm [um/m per N m]
POSE = np.array([0.7, -0.5])
MEAN = 4.2  # of pushes of 5 N for 0.6 s that come and go within 0.1 s [N]
ADDED = ('bending', 'density', 'lumped', 'payload', 'gear', 'tight', 'loose')


def tudor(*, gauges: int = 4, sensors: bool = True) -> Arm:
    """Give the reference arm with its first gauges, and with or without what they read."""
    arm = load_arm(Path(__file__).parents[2] / 'config' / 'tudor.yaml')
    kept = arm.spec.gauges[:gauges]
    names = [gauge.name for gauge in kept]
    return Arm(arm.spec.model_copy(update={'gauges': kept, 'sensors': tuple(
        item for item in arm.spec.sensors if sensors and item.gauge in names)}),
        arm.full_model, arm.source, arm.urdf)


def estimator_of(arm: Arm, *, heavy: float = 1.0, doubt: float = 0.0) -> ContactEstimator:
    """Make one by an arm of which all masses and stiffnesses are wrong by a factor."""
    values = {name: value * (heavy if name.startswith(ADDED) else 1.0)
              for name, value in DrivenArm(arm).parameters.items()}
    model = ElasticModel(arm, 'strain', tuple(
        PhysicalParameter(name, value, '') for name, value in values.items()))
    model.coefficients_ = tuple(np.array([GAIN / heavy, 0.0]) for _ in arm.gauges)
    model.standard_errors_ = tuple(np.array([doubt * GAIN / heavy, 0.0]) for _ in arm.gauges)
    model.noise_ = np.full(len(arm.gauges), 6.0)
    return ContactEstimator(ModelBundle(arm, arm.spec.preprocessing, {
        'strain': {'elastic': model}}, {}), 'elastic')


def pushed(estimator: ContactEstimator, push: Push) -> dict[str, Any]:
    """Push a resting arm, and give what the second half of the push comes to."""
    loop = ClosedLoop(tudor(), damping=0.0, seed=2)
    loop.reset(POSE)
    loop.set_pushes([push])
    steps = round((push.time + push.duration) / loop.dt)
    seen = loop.run(np.tile(POSE, (steps, 1)), np.zeros((steps, 2)), every=20)
    record = estimator.record()
    gauges = len(estimator._deviation)
    for k, t in enumerate(seen.t):
        row = np.concatenate([seen.q[k], seen.dq[k], [0.0, 0.0]])
        made = estimator.step(round(t * 1e9) + 1, k == 0, row, seen.strain[k, :gauges], None)
        if made is not None and push.time + 0.5 * push.duration < t < (
                push.time + push.duration - push.rise):
            record.add(made)
    return record.summary()


# the link is 0.2 rad above the horizontal: the first acts across it, the others along it as well
FORCES = [(0.0, 0.0, -5.0), (4.0, 0.0, -3.0), (-5.0, 0.0, 1.0)]


@pytest.mark.parametrize('force', FORCES)
def test_a_force_has_its_whole_size_whatever_its_direction(
    force: tuple[float, float, float],
) -> None:
    """Not the part across the link alone; within a tenth, and within two deviations."""
    found = pushed(estimator_of(tudor()), Push(3.0, 4.0, 'joint3', 0.38, force, 0.4))
    size = np.linalg.norm(force)
    assert found['link'] == 'link3' and found['note'] == ''
    assert found['force'] == pytest.approx(size, rel=0.1)
    assert abs(found['force'] - size) < 2.0 * found['force_deviation'] < 0.6 * size
    assert found['place'] == pytest.approx(0.38, abs=0.03)


def test_one_gauge_on_the_last_link_shows_a_force_at_its_end_and_no_place() -> None:
    """A place that was assumed is not given as one that is certain to a millimetre."""
    found = pushed(estimator_of(tudor(gauges=2)), Push(3.0, 4.0, 'joint3', 0.393, FORCES[1], 0.4))
    assert found['link'] == 'link3' and found['force'] == pytest.approx(5.0, rel=0.1)
    assert found['place'] is found['place_deviation'] is None
    assert 'the link of joint3 has one gauge' in found['note'] and 'second gauge' in found['note']
    assert Span('joint3', 0.393, 0.393).weight == 0.393, 'the end stands for the whole link'


@pytest.mark.parametrize('sensors', [True, False])
def test_masses_that_are_guesses_need_the_gain_of_a_gauge(*, sensors: bool) -> None:
    """An arm taken for twice as heavy moves alike: newtons are right by a gain, or unknown."""
    estimator = estimator_of(tudor(sensors=sensors), heavy=2.0, doubt=0.4)
    found = pushed(estimator, Push(3.0, 4.0, 'joint3', 0.38, FORCES[1], 0.4))
    assert found['place'] == pytest.approx(0.38, abs=0.03), 'a place needs no newtons'
    if sensors:
        assert found['force'] == pytest.approx(5.0, rel=0.1) and found['note'] == ''
    else:
        assert found['force'] is found['across'] is found['force_deviation'] is None
        assert 'sensors[].gain' in found['note'] and '40 %' in found['note']


def test_pushes_in_motion() -> None:
    """Their mean force is right to a tenth at the median, and as certain as it is said."""
    arm = tudor()
    loop = ClosedLoop(arm, damping=0.0, seed=3)
    motion = stimulus_motion(arm, 25.0, 3, loop.dt)
    pushes = [Push(3.0 + 2.0 * k, 0.6, 'joint3', 0.38, (
        5.0 * np.cos(k), 0.0, 5.0 * np.sin(k)), 0.1) for k in range(11)]
    loop.reset(motion.q[0])
    loop.set_pushes(pushes)
    seen = loop.run(motion.q, motion.dq, every=10)
    estimator = estimator_of(arm)
    records = [estimator.record() for _ in pushes]
    for k, t in enumerate(seen.t):
        row = np.concatenate([seen.q[k], seen.dq[k], [0.0, 0.0]])
        made = estimator.step(round(t * 1e9) + 1, k == 0, row, seen.strain[k], None)
        for push, record in zip(pushes, records, strict=True):
            if made is not None and push.time - 0.2 < t < push.time + push.duration + 0.3:
                record.add(made)
    found = [record.summary() for record in records]
    off = np.array([item['force'] - MEAN for item in found])
    assert abs(np.median(off)) < 0.5
    assert np.mean(np.abs(off) < 2.0 * np.array([item['force_deviation'] for item in found])) > 0.8


def test_an_unknown_force_is_published_as_none() -> None:
    """No number stands for it in an estimate; the place stays."""
    estimator = estimator_of(tudor(sensors=False), doubt=0.4)
    estimate = replace(_last(estimator), felt=True)
    assert np.isnan(estimate.force).all() and np.isnan(estimate.force_deviation)
    assert np.isfinite(estimate.place) and 'sensors[].gain' in estimate.note


def _last(estimator: ContactEstimator) -> Any:
    loop = ClosedLoop(tudor(), damping=0.0, seed=2)
    loop.reset(POSE)
    loop.set_pushes([Push(2.0, 3.0, 'joint3', 0.38, FORCES[0], 0.2)])
    steps = round(4.0 / loop.dt)
    seen = loop.run(np.tile(POSE, (steps, 1)), np.zeros((steps, 2)), every=20)
    made = [estimator.step(round(t * 1e9) + 1, k == 0, np.concatenate([seen.q[k], np.zeros(4)]),
                           seen.strain[k], None) for k, t in enumerate(seen.t)]
    return made[-1]
