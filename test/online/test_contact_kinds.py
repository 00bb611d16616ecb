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

"""Contacts by efforts, and by strain of a rigid model: which link, what force, until when."""

from __future__ import annotations

from pathlib import Path
import re
from typing import Any

import numpy as np
import pytest
from sample_arms import planar_arm

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.online.contact import (
    contact_estimator, ContactEstimate, ContactEstimator, ContactRecord, touch)
from tudor_dynamics.online.contact_fronts import RigidFront, Span
from tudor_dynamics.typing import FloatArray

RMSE = 0.2
ROW = np.array([0.3, -0.4, 0.0, 0.0, 0.0, 0.0])


def bundle(joints: list[dict[str, Any]] | None = None, **more: Any) -> ModelBundle:
    """Give the facts of a fit with efforts, whose validation left the same over of each joint."""
    channels = {name: {'rmse': RMSE} for name in ('j1', 'j2')}
    facts = {'validation': {'effort': {'analytical': {'validation': {'channels': channels}}}}}
    return ModelBundle(planar_arm(joints, **more), PreprocessingSpec(), {}, facts)


def by_efforts(known: ModelBundle, residuals: list[list[float]]) -> list[ContactEstimate]:
    """Estimate by residuals of the momentum observer, 10 ms apart."""
    estimator, why = contact_estimator(known, 'analytical', ('momentum',))
    assert estimator is not None and 'gauges would show force and place' in why
    found = [estimator.step(10_000_000 * (k + 1), k == 0, ROW, np.zeros(2), np.array(residual))
             for k, residual in enumerate(residuals)]
    assert all(item is not None for item in found)
    return [item for item in found if item is not None]


def test_the_outermost_joint_that_feels_a_force_moves_the_link_that_is_touched() -> None:
    """A force on a link loads all joints before it; its torque is that about the joint's axis."""
    inner, outer, none = by_efforts(bundle(), [[-3.0, 0.1], [-3.0, 1.5], [0.1, -0.2]])
    assert (inner.felt, inner.joint) == (True, 'j1') and (outer.felt, outer.joint) == (True, 'j2')
    assert inner.torque == pytest.approx([0.0, 0.0, 3.0])
    assert outer.torque == pytest.approx([0.0, 0.0, -1.5])
    assert outer.torque_deviation == RMSE and np.isnan(outer.force_deviation)
    assert np.isnan(outer.place) and 'gauges would show force and place' in outer.note
    assert not none.felt and none.note == ''


def test_a_contact_begins_at_five_deviations_and_ends_at_three() -> None:
    """So that noise about one bound does not end it."""
    sizes = [4.9, 5.1, 4.0, 3.1, 2.9, 4.0]
    found = by_efforts(bundle(), [[0.0, -size * RMSE] for size in sizes])
    assert [item.felt for item in found] == [False, True, True, True, False, False]


def test_currents_need_torque_constants() -> None:
    """A joint whose motor is not described feels nothing, and without any motor all is refused."""
    joints = [{'name': name, 'effort': {'unit': 'A'}} for name in ('j1', 'j2')]
    motor = {'joint': 'j1', 'torque_constant': 0.05, 'gear_ratio': 100, 'efficiency': 0.8,
             'rotor_inertia': 1e-5}
    found, = by_efforts(bundle(joints, motors=[motor]), [[-2.0, -9.0]])
    assert found.joint == 'j1' and found.torque[2] == pytest.approx(2.0 * 0.05 * 100 * 0.8)
    joints[0]['effort']['torque_constant'] = 7.0  # of the joint, before that of its motor
    for motors in ([], [motor]):
        found, = by_efforts(bundle(joints, motors=motors), [[-2.0, -9.0]])
        assert found.joint == 'j1' and found.torque[2] == pytest.approx(2.0 * 7.0)
    del joints[0]['effort']['torque_constant']
    found, why = contact_estimator(bundle(joints), 'analytical', ('momentum',))
    assert found is None and 'no torque constant is known' in why


def test_a_residual_that_settles_ends_a_contact() -> None:
    """Nothing is estimated of samples without a residual, and nothing is held beyond them."""
    estimator, _ = contact_estimator(bundle(), 'analytical', ('momentum',))
    assert estimator is not None
    zero = np.zeros(2)
    first = estimator.step(10_000_000, True, ROW, zero, np.array([-3.0, 0.0]))
    assert first is not None and first.felt
    assert estimator.step(20_000_000, False, ROW, zero, None) is None and not estimator.felt
    assert estimator.record().summary() == {}


def test_why_there_is_no_estimate_is_said() -> None:
    """By each method that was asked for."""
    bare = ModelBundle(planar_arm(), PreprocessingSpec(), {})
    for methods, reason in ((('effort',), 'methods strain and momentum'), (
            ('strain', 'momentum'), 'model of strain.*; .*fit the model to several bags')):
        found, why = contact_estimator(bare, 'analytical', methods)
        assert found is None and re.search(reason, why)
    known, why = contact_estimator(bundle(), 'analytical', ('strain', 'momentum'))
    assert known is not None and 'model of strain' in why, 'why efforts have to do'


class StrainModel:
    """A rigid model of the strain, of which only its noise matters here."""

    noise_ = np.full(4, 4.0)


def pushed(force: float, place: float) -> tuple[ContactEstimator, list[ContactEstimate | None]]:
    """Push the outer link of the reference arm at rest for 2 s, 1 s after the start."""
    arm = load_arm(Path(__file__).parents[2] / 'config' / 'tudor.yaml')
    known = ModelBundle(arm, arm.spec.preprocessing, {
        'strain': {'analytical': StrainModel()}})  # type: ignore[dict-item]
    estimator = ContactEstimator(known, 'analytical')
    gain = np.array([sensor.gain for sensor in arm.spec.sensors])
    lever: FloatArray = RigidFront(arm, estimator.spans, gain).rows(ROW)[-1]
    residual = gain * (lever @ [force, force * place, 0.0])
    rng = np.random.default_rng(2)
    return estimator, [estimator.step(
        10_000_000 * (k + 1), k == 0, ROW, np.zeros(4),
        (residual if 100 <= k < 300 else 0.0) + rng.normal(size=4)) for k in range(500)]


def test_a_rigid_model_has_force_and_place_of_a_push_at_rest() -> None:
    """On the link that is pushed, across it, while it lasts and not before nor long after."""
    estimator, found = pushed(3.0, 0.33)
    assert found[0] is None
    assert not any(item.felt for item in found[1:100] if item)
    during = [item for item in found[200:300] if item]
    assert all(item.felt and item.link == 'link3' for item in during)
    assert np.median([item.place for item in during]) == pytest.approx(0.33, abs=0.01)
    assert np.median([np.linalg.norm(item.force) for item in during]) == pytest.approx(
        3.0, rel=0.05)
    assert not any(item.felt for item in found[350:] if item)
    record = estimator.record()
    for item in during:
        record.add(item)
    summary = record.summary()
    assert summary['link'] == 'link3' and summary['certain'] > 0.9
    assert abs(summary['force']) == pytest.approx(3.0, rel=0.05)
    assert summary['place'] == pytest.approx(0.33, abs=0.01)


def test_an_event_that_outlasts_its_push_has_the_force_of_the_push() -> None:
    """From the beginning of the touch to its end, whatever was recorded around it."""
    estimator, found = pushed(-3.0, 0.33)
    record = estimator.record()
    for item in found[60:]:  # 0.4 s before, 2 s of touch, 2 s after
        if item:
            record.add(item)
    summary = record.summary()
    assert summary['across'] == pytest.approx(-3.0, rel=0.05)
    assert summary['force'] == pytest.approx(3.0, rel=0.05)
    assert summary['seconds'] == pytest.approx(2.0, abs=0.1)
    assert summary['force'] <= summary['peak'] == pytest.approx(3.0, rel=0.1)
    t, size = np.array(summary['course']).T
    assert 25 < len(t) <= 50 and t[0] == 0.0 and summary['seconds'] - t[-1] < 0.1
    assert np.median(size) == pytest.approx(3.0, rel=0.1)
    assert abs(summary['place'] - 0.33) < 2.0 * summary['place_deviation'] < 0.05


def test_a_touch_is_what_its_peak_stands_in() -> None:
    """Rises belong to it; what rings on the other side of zero, or comes again, does not."""
    course = np.array([0.0, 0.1, -1.0, -4.0, -5.0, -3.0, -0.5, 0.8, -2.0, 0.0])
    assert np.arange(10)[touch(course[:, None])].tolist() == [2, 3, 4, 5, 6]
    assert np.arange(3)[touch(np.ones((3, 1)))].tolist() == [0, 1, 2]


SPANS = (Span('j', 0.05, 0.24), Span('j', 0.24, 0.39))


def places_of(likely: float, samples: int, together: float) -> dict[str, Any]:
    """Sum up equal samples of a force at 150 mm or at 300 mm, with a doubt of 20 mm."""
    record = ContactRecord(SPANS, ('link', 'link'), together)
    values = np.array([[2.0, 0.3, 0.0], [2.0, 0.6, 0.0]])
    spread = np.tile(np.diag([0.0, 0.04**2, 0.0]), (2, 1, 1))
    for k in range(samples):
        record.add(ContactEstimate(
            k, 'link', 'j', True, np.zeros(3), np.zeros(3), 0.1, 0.1, pressing=values,
            spread=spread, likely=np.array([0.0, likely])))
    return record.summary()


def test_two_places_that_explain_a_contact_are_said() -> None:
    """One that is hardly less likely is named, and the deviation reaches it."""
    both = places_of(0.01, 100, 1.0)
    assert both['place'] == pytest.approx(0.3) and both['or_place'] == pytest.approx(0.15)
    assert 0.05 < both['place_deviation'] < 0.15
    sure = places_of(1.0, 100, 1.0)
    assert sure['place'] == pytest.approx(0.3) and sure['or_place'] is None


def test_samples_that_ring_together_do_not_make_a_place_certain() -> None:
    """A hundred equal samples are as uncertain as one; eight count as one for what is likely."""
    one, many = places_of(50.0, 1, 1.0), places_of(50.0, 100, 1.0)
    assert many['place_deviation'] == pytest.approx(one['place_deviation'])
    assert many['place_deviation'] == pytest.approx(0.02, rel=0.01)
    assert places_of(0.1, 100, 1.0)['or_place'] is None
    assert places_of(0.1, 100, 8.0)['or_place'] == pytest.approx(0.15)
