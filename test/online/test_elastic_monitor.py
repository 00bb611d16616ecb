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

"""The elastic model beside a running robot: predictor, observer, monitor, and re-arming."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

from elastic_making import blade_arm, GAINS, OFFSETS, pushed, recorded, travel
import numpy as np
import pytest
from sample_arms import recording_of

from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.errors import ModelError
from tudor_dynamics.identification.dataset import BagChoice, BagData
from tudor_dynamics.identification.detection import FREE, watch_bag
from tudor_dynamics.identification.uses import as_plain, learn_all
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.elastic.model import ElasticModel
from tudor_dynamics.online.detector import CollisionEvent, Level
from tudor_dynamics.online.monitor import Monitor, MonitorSettings, warm_up
from tudor_dynamics.online.streams import Predictor, StateFilter
from tudor_dynamics.signals.preprocessing import prepare
from tudor_dynamics.typing import FloatArray

RATE = 100.0
ARM = blade_arm()
TRUTH = {'gear(j1)': 200.0}
"""What the arm is and its model is not, so that there is a residual."""
PUSH = slice(700, 730)
"""Samples of a push."""
SPEC = PreprocessingSpec(filter='causal', rate=None)


@pytest.fixture(scope='module')
def recording() -> Recording:
    """Give a recording of the true arm."""
    q = travel(6.0, RATE, 3)
    strain, response = recorded(ARM, TRUTH, q, RATE)
    return recording_of(q, RATE, strain=strain, effort=response.torque)


@pytest.fixture(scope='module')
def bundle() -> ModelBundle:
    """Make a bundle with an elastic model of effort and strain."""
    models = {}
    for output in ('effort', 'strain'):
        model = ElasticModel(ARM, output)
        model.coefficients_ = (
            (np.array([70.0, 12.0]), np.array([90.0, -7.0])) if output == 'strain'
            else tuple(np.linspace(0.3, 1.0, len(c)) for c in model.columns))
        model.noise_ = np.array([4.0, 4.0])
        models[output] = {'elastic': model}
    return ModelBundle(ARM, SPEC, models, {})


def live(
    predictor: Predictor, recording: Recording, when: str = 'after', shift: int = 0,
) -> dict[str, dict[int, FloatArray]]:
    """Run live: strain before its motion, after it, or after the next motion; shift in ns."""
    states = StateFilter(SPEC)
    found: dict[str, dict[int, FloatArray]] = {'effort': {}, 'strain': {}}
    assert recording.strain is not None
    for k, stamp in enumerate(recording.stamp.tolist()):
        if when == 'before':
            predictor.add_strain(stamp + shift, recording.strain[k])
        motion = states.step(stamp, recording.q[k])
        assert motion is not None
        for output, values in (predictor.step(motion) or {}).items():
            found[output][stamp] = values
        if when == 'late' and k > 0:
            predictor.add_strain(int(recording.stamp[k - 1]), recording.strain[k - 1])
        elif when == 'after':
            predictor.add_strain(stamp + shift, recording.strain[k])
    return found


def difference(found: dict[int, FloatArray], stamps: FloatArray, offline: FloatArray) -> float:
    """Give the largest difference at the stamps that the predictor gave."""
    index = {stamp: k for k, stamp in enumerate(stamps.tolist())}
    assert len(found) > 0.8 * len(stamps)
    return max(float(np.abs(values - offline[index[stamp]]).max())
               for stamp, values in found.items())


@pytest.mark.parametrize('when', ['before', 'after'])
def test_live_equals_offline(when: str, bundle: ModelBundle, recording: Recording) -> None:
    """As ``observe`` gives it, to 1e-9, whichever of motion and strain comes first."""
    (stretch,) = prepare(recording, SPEC)
    found = live(Predictor(bundle, 'elastic'), recording, when)
    for output in ('effort', 'strain'):
        offline = bundle.models[output]['elastic'].observe(stretch)
        assert difference(found[output], stretch.stamp, offline) < 1e-9


def test_the_observer_makes_the_residual_smaller(
    bundle: ModelBundle, recording: Recording,
) -> None:
    """With strain that the model does not explain, correction brings it nearer."""
    (stretch,) = prepare(recording, SPEC)
    model = bundle.models['strain']['elastic']
    assert stretch.strain is not None
    plain = stretch.strain - model.follow(stretch)
    observed = stretch.strain - model.observe(stretch)
    assert (observed.std(axis=0) < 0.8 * plain.std(axis=0)).all()


def test_late_strain_does_not_count(bundle: ModelBundle, recording: Recording) -> None:
    """A reading that comes after the next motion changes nothing: it is as if there were none."""
    (stretch,) = prepare(recording, SPEC)
    found = live(Predictor(bundle, 'elastic'), recording, 'late')
    offline = bundle.models['strain']['elastic'].follow(stretch)
    assert difference(found['strain'], stretch.stamp, offline) < 1e-9


def test_strain_between_the_motions_is_interpolated(
    bundle: ModelBundle, recording: Recording,
) -> None:
    """A driver of gauges with stamps of its own: as readings brought onto those of the motion."""
    assert recording.strain is not None
    between = 0.5 * (recording.strain + np.roll(recording.strain, 1, axis=0))
    between[0] = recording.strain[0]
    brought = recording_of(recording.q, RATE, strain=between)
    found = live(Predictor(bundle, 'elastic'), recording, shift=5_000_000)['strain']
    again = live(Predictor(bundle, 'elastic'), brought)['strain']
    # before the first reading nothing is known: its trace dies out
    late = [stamp for stamp in again if stamp > recording.stamp[0] + 3_000_000_000]
    assert max(np.abs(found[stamp] - again[stamp]).max() for stamp in late) < 1e-3


def test_a_gap_begins_anew(bundle: ModelBundle, recording: Recording) -> None:
    """Behind a gap the arm rests, and the observer has forgotten."""
    assert recording.strain is not None
    gapped = recording_of(recording.q, RATE, strain=recording.strain, gaps=(300,))
    parts = prepare(gapped, SPEC)
    assert len(parts) == 2
    found = live(Predictor(bundle, 'elastic'), gapped)['strain']
    offline = bundle.models['strain']['elastic'].observe(parts[1])
    second = {s: v for s, v in found.items() if s >= parts[1].stamp[0]}
    assert difference(second, parts[1].stamp, offline) < 1e-9


def test_without_strain_there_is_no_observer(bundle: ModelBundle) -> None:
    """A bundle of efforts alone predicts without; a kind that it has not is refused."""
    effort = copy(bundle.models['effort']['elastic'])
    effort.strain_model = None  # type: ignore[attr-defined]
    alone = ModelBundle(ARM, SPEC, {'effort': {'elastic': effort}}, {})
    assert not Predictor(alone, 'elastic').observing
    assert Predictor(bundle, 'elastic').observing
    with pytest.raises(ModelError, match='elm'):
        Predictor(bundle, 'elm')


def test_warm_up(bundle: ModelBundle) -> None:
    """The chain runs at rest before the robot does."""
    warm_up(bundle, MonitorSettings(kind='elastic'))


@pytest.fixture(scope='module')
def armed(bundle: ModelBundle) -> ModelBundle:
    """Give the bundle thresholds, learned from most of a minute of free motion."""
    q = travel(50.0, RATE, 5)
    strain, response = recorded(ARM, TRUTH, q, RATE, seed=5)
    free = recording_of(q, RATE, strain=strain, effort=response.torque)
    bag = BagData(BagChoice('free', 0.0, 1.0), free, prepare(free, SPEC))
    cases = [(bundle.models['strain']['elastic'], bag)]
    return ModelBundle(ARM, SPEC, bundle.models, {
        'thresholds': as_plain(learn_all([('strain', 'elastic', cases)], SPEC)[0])})


@pytest.fixture(scope='module')
def push() -> Recording:
    """Record the true arm in motion, its tip pushed by a half-sine of 6 N."""
    q = travel(11.0, RATE, 7)
    force = np.zeros((len(q), 3))
    wave = np.sin(np.linspace(0.0, np.pi, PUSH.stop - PUSH.start))
    force[PUSH] = wave[:, None] * [4.2, 4.2, 0.0]
    noise = np.random.default_rng(7).normal(0.0, 2.0, (len(q), 2))
    return recording_of(
        q, RATE, strain=pushed(ARM, q, RATE, force, TRUTH) * GAINS + OFFSETS + noise)


@dataclass
class Watched:
    """What a monitor said: residuals and ratios by sample, collisions, the level at the end."""

    residuals: dict[int, FloatArray]
    ratios: list[float]
    events: list[CollisionEvent]
    level: Level


def watched(bundle: ModelBundle, recording: Recording) -> Watched:
    """Run the monitor as a robot feeds it."""
    monitor = Monitor(bundle, MonitorSettings(kind='elastic'))
    assert recording.strain is not None and monitor.watch.stages
    said = Watched({}, [], [], Level.FREE)
    for k, stamp in enumerate(recording.stamp.tolist()):
        for found in (monitor.add_joints(stamp, recording.q[k]),
                      monitor.add_measured('strain', stamp, recording.strain[k])):
            said.residuals |= {r.motion.stamp: r.value for _, r in found.residuals}
            said.ratios += [float(excess.collision.max()) for _, excess in found.excesses]
            said.events += found.events
    said.level = monitor.watch.level
    return said


def test_residuals_online_and_offline(armed: ModelBundle, push: Recording) -> None:
    """Measured less predicted, sample by sample, is what the recording gives afterwards."""
    (stretch,) = prepare(push, SPEC)
    assert stretch.strain is not None
    offline = stretch.strain - armed.models['strain']['elastic'].observe(stretch)
    said = watched(armed, push)
    assert difference(said.residuals, stretch.stamp, offline) < 1e-9


def test_a_push_is_found(armed: ModelBundle, push: Recording) -> None:
    """No alarm before the push, one while it lasts, on the link that was pushed, and no later."""
    said = watched(armed, push)
    (event,) = said.events
    begin, end = push.stamp[[PUSH.start, PUSH.stop]]
    assert begin < event.stamp < end
    assert event.link == 'j2_link'
    assert said.level is Level.FREE
    found = watch_bag(armed, {'strain': MonitorSettings(kind='elastic')}, 'push', push, FREE)
    assert found['strain'].alarms.tolist() == [event.stamp]


def test_the_observer_takes_the_ringing_over(armed: ModelBundle, push: Recording) -> None:
    """Behind the push the arm rings as no motion explains: soon nothing of it is left over."""
    after = slice(PUSH.stop + 50, PUSH.stop + 150)
    (stretch,) = prepare(push, SPEC)
    assert push.strain is not None
    residuals = watched(armed, push).residuals
    left = np.std([residuals[stamp] for stamp in push.stamp[after].tolist()], axis=0)
    plain = push.strain - armed.models['strain']['elastic'].follow(stretch)
    assert (left < 0.5 * plain[after].std(axis=0)).all()
