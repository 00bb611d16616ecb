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

"""Contacts beside a running robot: in the monitor as offline, in events, and not unasked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sample_arms import recording_of

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.errors import ModelError
from tudor_dynamics.mechanics.closed_loop import ClosedLoop
from tudor_dynamics.mechanics.hardware import Push
from tudor_dynamics.mechanics.mechanism import build_mechanism
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.elastic.model import ElasticModel
from tudor_dynamics.online.contact import ContactEstimate, ContactEstimator
from tudor_dynamics.online.contact_fronts import link_axes, Pressing, spans_of
from tudor_dynamics.online.monitor import Monitor, MonitorSettings

SETTINGS = MonitorSettings(kind='elastic', methods=('strain',), contact=True)
POSE = np.array([0.7, -0.5])
PLACE, FORCE = 0.33, 5.0


@pytest.fixture(scope='module')
def bundle() -> ModelBundle:
    """Give an elastic model with the values of the description."""
    arm = load_arm(Path(__file__).parents[2] / 'config' / 'tudor.yaml')
    model = ElasticModel(arm, 'strain')
    model.coefficients_ = tuple(np.array([121.4, 0.0]) for _ in arm.gauges)
    model.noise_ = np.full(len(arm.gauges), 6.0)
    spec = arm.spec.preprocessing.model_copy(update={'filter': 'causal', 'rate': None})
    return ModelBundle(arm, spec, {'strain': {'elastic': model}}, {})


@pytest.fixture(scope='module')
def recording(bundle: ModelBundle) -> Recording:
    """Record an undamped arm that is pushed at 2 s for a second."""
    loop = ClosedLoop(bundle.arm, damping=0.0, seed=4)
    loop.reset(POSE)
    angle = float(POSE.sum())
    loop.set_pushes([Push(2.0, 1.0, 'joint3', PLACE, (
        -FORCE * np.sin(angle), 0.0, FORCE * np.cos(angle)), 0.05)])
    steps = round(4.0 / loop.dt)
    seen = loop.run(np.tile(POSE, (steps, 1)), np.zeros((steps, 2)), every=20)
    return recording_of(seen.q, 100.0, strain=seen.strain)


def watched(bundle: ModelBundle, recording: Recording, settings: MonitorSettings = SETTINGS,
            ) -> list[ContactEstimate]:
    """Run the monitor; give what it estimates."""
    monitor, found = Monitor(bundle, settings), []
    assert recording.strain is not None
    for k, stamp in enumerate(recording.stamp.tolist()):
        found += monitor.add_joints(stamp, recording.q[k]).contacts
        found += monitor.add_measured('strain', stamp, recording.strain[k]).contacts
    return found


def test_the_monitor_has_what_the_estimator_has(
    bundle: ModelBundle, recording: Recording,
) -> None:
    """The same numbers as offline, to 1e-9; force and place of the push, and nothing before."""
    live = watched(bundle, recording)
    estimator, offline = ContactEstimator(bundle, 'elastic'), []
    monitor = Monitor(bundle, SETTINGS)
    assert recording.strain is not None
    for k, stamp in enumerate(recording.stamp.tolist()):
        motion = monitor.filter.step(stamp, recording.q[k])
        if motion is None:
            continue
        made = estimator.step(stamp, motion.dt == 0.0, motion.row, recording.strain[k], None)
        if made is not None:
            offline.append(made)
    assert len(live) == len(offline) > 300
    for one, other in zip(live, offline, strict=True):
        assert one.stamp == other.stamp and one.link == other.link
        assert np.abs(one.force - other.force).max() < 1e-9
        assert np.array_equal(one.place, other.place, equal_nan=True)
    begun = int(recording.stamp[0])
    quiet = [item for item in live if (item.stamp - begun) * 1e-9 < 2.0]
    during = [item for item in live if 2.3 < (item.stamp - begun) * 1e-9 < 3.0]
    assert not any(item.felt for item in quiet)
    assert all(item.felt and item.joint == 'joint3' for item in during)
    assert abs(np.nanmedian([item.place for item in during]) - PLACE) < 0.02
    assert abs(np.median([np.linalg.norm(item.force) for item in during]) - FORCE) < 1.0
    record = estimator.record()
    for item in during:
        record.add(item)
    summary = record.summary()
    assert summary['link'] == 'link3' and abs(summary['place'] - PLACE) < 0.02


def test_nothing_is_estimated_unasked(bundle: ModelBundle, recording: Recording) -> None:
    """Off by default: no estimate, and nothing that could cost time."""
    plain = MonitorSettings(kind='elastic', methods=('strain',))
    assert Monitor(bundle, plain).watch.contact is None
    assert not watched(bundle, recording, plain)


def test_without_scale_the_watch_says_why(bundle: ModelBundle) -> None:
    """An arm whose gauges have no gain: the monitor works, and says what it cannot."""
    rigid = MonitorSettings(kind='elastic', methods=('effort',), contact=True)
    watch = Monitor(ModelBundle(bundle.arm, bundle.preprocessing, bundle.models), rigid).watch
    assert watch.contact is None and 'strain and momentum' in watch.no_contact


def test_a_link_with_gauges_and_no_beam(bundle: ModelBundle) -> None:
    """It is an error of the model, so that the monitor goes on without contacts."""
    arm = bundle.arm
    span = replace(spans_of(arm, [True] * len(arm.gauges))[0], joint='joint1')
    with pytest.raises(ModelError, match='joint1.*links.*flexible'):
        Pressing(span, link_axes(arm, 'joint2'), build_mechanism(arm), ())
