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

"""Thresholds, onset statistic and detector on signals whose truth is known."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
import pytest
from scipy import signal
from threshold_making import CHANNELS, ringing, walk

from tudor_dynamics.errors import FitError, ModelError
from tudor_dynamics.online.detector import (
    CollisionDetector, DetectorSettings, Excess, ExcessStage, Level, Rates)
from tudor_dynamics.online.settings import STEP
from tudor_dynamics.online.streams import Motion, Residual
from tudor_dynamics.online.threshold_learning import (
    FreeMotion, learn_thresholds, thresholds_from_dict, thresholds_to_dict)
from tudor_dynamics.online.thresholds import (
    accumulate, advance, learn_taps, MethodThresholds, motion_features, onset_statistic, Tail)


def test_doubt_about_a_tail_is_counted_in() -> None:
    """Scales estimated from few peaks: on average it is exceeded as often as asked."""
    rng, share = np.random.default_rng(5), 0.2
    for count, per_hour in ((10, 6.0), (40, 6.0), (40, 60.0)):
        tails = [Tail(0.0, scale, 0.0, share, 1.0, count) for scale in
                 rng.gamma(count, 1.0 / count, 40000)]
        exceeded = np.mean([math.exp(-tail.ratio(per_hour)) for tail in tails])
        assert 3600.0 * share * exceeded == pytest.approx(per_hour, rel=0.1)
        certain = Tail(0.0, 1.0, 0.0, share, 1.0, 1e9)
        assert Tail(0.0, 1.0, 0.0, share, 1.0, count).ratio(per_hour) > certain.ratio(per_hour)


def test_false_alarms_are_as_rare_as_asked(learned) -> None:
    """On ten minutes that were not learned from: seldom where 6 per hour are allowed."""
    for per_hour, most in ((6.0, 6), (600.0, 250)):
        stage = ExcessStage(learned, Rates(per_hour, max(per_hour, 60.0)))
        alarms = sum(
            bool(np.array([x.collision.max() for x in walk(stage, ringing(60, 10 + k))]
                          ).reshape(-1, 100).max(axis=1).__gt__(1.0).sum())
            for k in range(10))
        assert alarms <= most
    low, high = learned.ratios(600.0), learned.ratios(6.0)
    assert (low < high).all()


def test_onset_is_seen_before_the_residual_leaves_its_ringing(learned) -> None:
    """A force that rises slowly: the onset statistic exceeds first, well below the ringing."""
    record = ringing(20, 99)
    t = record.t
    force = 45.0 * np.sin(np.pi * np.clip((t - 10.0) / 0.4, 0.0, 1.0)) ** 2
    stage = ExcessStage(learned, Rates(1.0, 60.0))
    found = walk(stage, record, force)
    above = np.array([x.collision.max() > 1.0 for x in found])
    assert not above[t < 10.0].any()
    first = t[above][0]
    plain = np.array([np.abs(x.residual.value).max() for x in found])
    limit = max(np.abs(ringing(120, s).residual).max() for s in (1, 2))
    late = t[(plain > limit) & (t > 10.0)]
    assert first < 10.25
    assert not len(late) or first < late[0]


@pytest.mark.parametrize('rate', [100.0, 437.0, 1000.0])
def test_onset_by_steps_equals_onset_at_once(rate: float, learned) -> None:
    """The live statistic equals that of the whole record, at any sample rate."""
    taps = learn_taps([(ringing(60, 1).t, ringing(60, 1).residual)], STEP)
    record = ringing(15, 4, rate)
    whole = onset_statistic(record.t, record.residual, taps, STEP)
    stage = ExcessStage(replace(learned, taps=taps, step=STEP), Rates())
    steps = np.array([found.onset for found in walk(stage, record)])
    assert np.abs(whole).max() > 1.0
    assert np.abs(whole - steps).max() < 1e-6 * np.abs(whole).max()


def test_too_little_motion_is_refused() -> None:
    """A few seconds say nothing of what happens once an hour."""
    with pytest.raises(FitError, match='too little for thresholds'):
        learn_thresholds([ringing(7, 1)], CHANNELS)


@pytest.mark.parametrize(('share', 'seed'), [
    (0.3, 0), (0.5, 0), (0.5, 1), (0.5, 13), (0.5, 15), (0.5, 16), (0.7, 2), (0.7, 7), (0.9, 2)])
def test_lost_samples_give_thresholds_or_a_reason(share: float, seed: int) -> None:
    """Stretches that last long enough may have too few samples to be judged by."""
    whole = ringing(60.0, seed)
    keep = np.flatnonzero(np.random.default_rng(seed).random(len(whole.stamp)) > share)
    step = np.diff(whole.stamp[keep])
    parts = [FreeMotion(whole.stamp[rows], whole.motion[rows], whole.residual[rows])
             for rows in np.split(keep, np.flatnonzero(step > 5 * np.median(step)) + 1)
             if len(rows) > 1]
    try:
        tails = learn_thresholds(parts, CHANNELS).tails
    except FitError as err:
        assert 'of motion are too little' in str(err)
    else:
        assert all(np.isfinite([tail.location, tail.scale]).all() for tail in tails)


def test_round_trip(learned) -> None:
    """Thresholds survive being written as plain values; damaged ones are refused."""
    content = thresholds_to_dict(learned)
    again = thresholds_from_dict(content, CHANNELS, 2)
    assert np.allclose(again.ratios(1.0), learned.ratios(1.0), rtol=1e-9)
    assert np.allclose(again.taps, learned.taps, rtol=1e-9)
    for change, text in (
            ({'taps': [[[1.0]]]}, 'taps has the shape'), ({'channels': ['a']}, 'channels'),
            ({'tails': []}, 'tails has 0 entries'), ({'step': -1.0}, 'step must be above 0'),
            ({'profile': 'no'}, 'profile must'),
            ({'profile': [[1.0], [1.0, 2.0]]}, 'inhomogeneous'),
            ({'taps': [[[float('nan')]]]}, 'taps.0..0..0. must be a finite number')):
        with pytest.raises(ModelError, match=f'{text}.*; fit the model again'):
            thresholds_from_dict({**content, **change}, CHANNELS, 2)
    with pytest.raises(ModelError, match='key facts.thresholds: .*; fit the model again'):
        thresholds_from_dict([], CHANNELS, 2)


def test_reversal_widens_for_a_while() -> None:
    """The column of a joint is 1 for 150 ms after a change of its direction."""
    motion = np.zeros((40, 3))
    motion[:, 1] = np.where(np.arange(40) < 10, 0.5, -0.5)
    found = motion_features(10**18 + 10_000_000 * np.arange(40), motion)[:, -1]
    assert found.tolist() == [0.0] * 10 + [1.0] * 16 + [0.0] * 14


def excess(
    stamp: int, collision: float, contact: float = 0.0, sudden: float = 0.0,
) -> Excess:
    """Make a sample of one channel."""
    m = Motion(stamp, 9.0, 0.01, np.zeros(3))
    zero = np.zeros(1)
    return Excess(Residual(m, zero, zero, np.array([7.0])), zero,
                  np.array([max(contact, collision)]), np.array([collision]),
                  np.array([sudden]), np.ones(1))


def detector_of(settings: DetectorSettings, *methods: str) -> CollisionDetector:
    """Make a detector of methods with one channel each."""
    return CollisionDetector(settings, dict.fromkeys(methods or ('strain',), ('g',)),
                             {'g': (2, 'link2')})


def test_debounce_and_rearming() -> None:
    """One high sample is nothing, two are an event; half a second of quiet arms again."""
    detector = detector_of(DetectorSettings(0.01, 0.5))
    events, levels = [], []
    ratios = [0.1] * 5 + [1.5] + [0.1] * 5 + [1.2] * 3 + [0.7] * 20 + [0.1] * 60 + [1.3] * 3
    for k, ratio in enumerate(ratios):
        event = detector.step('strain', excess(10_000_000 * k, ratio))
        levels.append(detector.level)
        if event is not None:
            events.append((k, event))
    assert [k for k, _ in events] == [12, 95]
    assert events[0][1].onset == 11 * 10_000_000 and events[0][1].link == 'link2'
    assert events[0][1].residuals == {'g': 7.0}
    assert levels[33] is Level.COLLISION and levels[90] is Level.FREE


def test_a_model_that_lost_the_arm_does_not_make_blind() -> None:
    """However large a residual was, a push is found again seconds later."""
    detector = detector_of(DetectorSettings(0.01, 0.3))
    for k, ratio in enumerate([0.1] * 5 + [1e90] * 5 + [0.1] * 500):
        detector.step('strain', excess(10_000_000 * k, ratio))
    assert detector.level is Level.FREE
    events = [detector.step('strain', excess(10_000_000 * k, 3.0)) for k in range(510, 520)]
    assert [event is not None for event in events].count(True) == 1


def test_noise_cannot_hold_a_level_up() -> None:
    """A residual that is noise, its threshold four deviations: free again once it is only that."""
    detector = detector_of(DetectorSettings(0.01, 0.5))
    rng = np.random.default_rng(3)
    for k in range(3):
        detector.step('strain', excess(10_000_000 * k, 2.0))
    assert detector.level is Level.COLLISION
    # the largest of eight statistics: above half of the threshold most of the time
    noise = np.abs(rng.standard_normal((100, 8))).max(axis=1) / 4.0
    assert np.mean(noise) > 0.4 and noise.max() < 1.0
    for k, ratio in enumerate(noise.tolist()):
        detector.step('strain', excess(10_000_000 * (3 + k), ratio, 1.3 * ratio))
    assert detector.level is Level.FREE
    detector.step('strain', excess(2_000_000_000, 2.0))
    detector.step('strain', excess(2_010_000_000, 2.0))
    for k in range(100):
        detector.step('strain', excess(2_020_000_000 + 10_000_000 * k, math.nan))
    assert detector.level is Level.COLLISION  # what is no number is not quiet


def test_a_sensor_that_stops_does_not_hold_a_level_up() -> None:
    """A method without samples is not above its threshold for ever."""
    detector = detector_of(DetectorSettings(0.0, 0.5), 'strain', 'effort')
    detector.step('strain', excess(0, 2.0))
    assert detector.level is Level.COLLISION
    for k in range(60):
        detector.step('effort', excess(10_000_000 * k, 0.2))
    assert detector.level is Level.FREE


def test_what_a_push_leaves_behind_is_none() -> None:
    """Fifty times the threshold, then a swing of five for a second: free within that second."""
    detector = detector_of(DetectorSettings(0.01, 0.3))
    levels = []
    for k in range(200):
        ratio = 50.0 if k < 40 else 5.0 * math.exp(-0.01 * (k - 40) / 0.6)
        detector.step('strain', excess(10_000_000 * k, ratio))
        levels.append(detector.level)
    assert levels[60] is Level.COLLISION and levels[140] is Level.FREE
    # a second push of a fifth is above what the first one left
    events = [detector.step('strain', excess(10_000_000 * k, 10.0)) for k in range(200, 210)]
    assert sum(event is not None for event in events) == 1


def push_upon_push(second: float) -> list[int]:
    """Hold a force for two seconds, change it after one; give when there were events [ms]."""
    detector = detector_of(DetectorSettings(0.01, 0.5), 'strain', 'effort')
    found = []
    for k in range(300):
        held = 10 <= k < 210
        sudden = (1.5 if 10 <= k < 20 else second if 110 <= k < 120
                  else -1.5 if 210 <= k < 220 else 0.1)
        for method, late in (('strain', 0), ('effort', 30_000_000)):
            if detector.step(method, excess(10_000_000 * k + late, 3.0 if held else 0.3,
                                            sudden=sudden)) is not None:
                found.append(10 * k)
    return found


def test_a_push_during_a_push_is_told() -> None:
    """What adds to a force that lasts is an event of its own; what takes from it is none."""
    assert push_upon_push(0.1) == [110]
    assert push_upon_push(1.5) == [110, 1110]
    assert push_upon_push(-1.5) == [110]


def test_contact_is_the_more_sensitive_level() -> None:
    """A touch below the collision threshold is told and is no event."""
    detector = detector_of(DetectorSettings(0.0, 0.1))
    assert detector.step('strain', excess(1, 0.6, 1.4)) is None
    assert detector.level is Level.CONTACT


def test_little_motion_gives_wider_thresholds(learned: MethodThresholds) -> None:
    """What is learned from twelve seconds is wider than from minutes, and not often exceeded."""
    short = [learn_thresholds([ringing(12, seed)], CHANNELS) for seed in range(20, 26)]
    assert all(item.doubt(1.0) > 1.3 for item in short) and learned.doubt(1.0) < 1.2
    quiet = ringing(120, 40)
    for item in short:
        assert max(x.collision.max() for x in walk(ExcessStage(item, Rates(6.0)), quiet)) < 1.3


def test_motions_that_differ_give_wider_thresholds() -> None:
    """Days differ by more than halves of them do; where they do not, thresholds are the same."""
    def days(*sizes: float) -> list[FreeMotion]:
        return [replace(record, residual=size * record.residual, motion_of=str(day))
                for day, size in enumerate(sizes) for record in [ringing(30, day)]]

    def ratio(records: list[FreeMotion]) -> float:
        return float(learn_thresholds(records, CHANNELS).ratios(1.0)[:2].mean())

    def apart(records: list[FreeMotion]) -> float:
        return ratio(records) / ratio([replace(record, motion_of='') for record in records])

    assert 1.0 <= apart(days(1.0, 1.0, 1.0)) <= 1.3
    assert apart(days(1.0, 1.0, 4.0)) > 1.1
    # another kind: one joint alone on each day, residuals by its speed
    kinds = []
    for day, record in enumerate(days(1.0, 1.0)):
        motion = record.motion * np.tile(np.arange(2) == day, 3)
        speed = 0.1 + np.abs(motion[:, 2 + day])
        kinds.append(replace(record, motion=motion, residual=speed[:, None] * record.residual))
    assert apart(kinds) > 1.1


def _stuck(seconds: float, seed: int, friction: float) -> FreeMotion:
    """Make a joint that stops now and then, and keeps friction of either sign while it does."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(100 * seconds)) / 100.0
    dq = np.sin(t) * (np.sin(t) > -0.3)
    held = np.repeat(rng.uniform(-friction, friction, 1 + len(t) // 300), 300)[:len(t)]
    residual = np.where(dq == 0.0, held, 0.0) + 0.05 * rng.normal(size=len(t))
    motion = np.column_stack([np.cumsum(dq) / 100.0, dq, np.gradient(dq, 0.01)])
    return FreeMotion((1e9 * t).round().astype(np.int64), motion, residual[:, None])


def test_friction_that_holds_is_no_collision() -> None:
    """A joint that stands may lie off by its friction; what goes beyond that is told."""
    moving = [FreeMotion(r.stamp, r.motion, np.where(r.motion[:, 1:2] == 0.0, 0.0, r.residual))
              for r in (_stuck(60, seed, 0.0) for seed in (1, 2))]
    still = FreeMotion(np.arange(300) * 10_000_000, np.zeros((300, 3)), np.full((300, 1), 0.9))
    ratios = {}
    for stiction in (0.0, 1.0):
        learned = learn_thresholds(moving, ('a',), np.array([stiction]))
        assert learned.stiction == stiction
        ratios[stiction] = max(x.collision[0] for x in walk(ExcessStage(learned, Rates(1.0)),
                                                            still))
        pushed = walk(ExcessStage(learned, Rates(1.0)), still, np.linspace(0.0, 3.0, 300))
        assert max(x.collision[0] for x in pushed) > 1.0
        assert pushed[-1].threshold[0] > stiction
    assert ratios[0.0] > 1.0 > ratios[1.0]


def _single_move(seed: int, seconds: float) -> FreeMotion:
    """Make a move at the very beginning, after which friction covers the joint for long."""
    t = np.arange(1100) / 100.0
    dq = np.where(t < seconds, 2.0 * np.sin(np.pi * t / seconds), 0.0)
    white = np.random.default_rng(seed).normal(size=len(t))
    noise = np.convolve(white, np.full(5, 5**-0.5), 'same')
    residual = 0.5 * (dq == 0.0) + noise * (0.02 + 0.3 * np.abs(dq))
    motion = np.column_stack([np.cumsum(dq) / 100.0, dq, np.gradient(dq, 0.01)])
    return FreeMotion((1e9 * t).round().astype(np.int64), motion, residual[:, None], str(seed))


@pytest.mark.parametrize('seconds', [0.15, 0.3, 0.7])
def test_recordings_of_one_short_move_each(seconds: float) -> None:
    """Thresholds follow from the moves: neither rest nor the first samples hide them."""
    learned = learn_thresholds([_single_move(seed, seconds) for seed in range(9)], ('a',),
                               np.ones(1))
    for seed in range(20, 26):
        walked = walk(ExcessStage(learned, Rates(1.0)), _single_move(seed, seconds))
        assert max(x.collision[0] for x in walked) < 1.0
        assert walked[-1].threshold[0] < 3.0  # of which 1 is friction
        assert max(x.threshold[0] for x in walked) < 30.0  # 2 of noise; was 1800 and 4700


def test_a_soft_hit_is_told_by_its_sum() -> None:
    """A force that stays below the threshold of the residual is found as it lasts."""
    def wandering(seconds: float, seed: int) -> FreeMotion:
        record, fade = ringing(seconds, seed), math.exp(-0.01 / 0.3)
        noise = np.random.default_rng(seed).normal(size=record.residual.shape)
        return replace(record, residual=signal.lfilter(
            [math.sqrt(1.0 - fade**2)], [1.0, -fade], noise, axis=0))

    learned = learn_thresholds([wandering(120, 1), wandering(120, 2)], CHANNELS)
    without_sums = [replace(tail, location=1e9) for tail in learned.tails[4:]]
    before = replace(learned, tails=(*learned.tails[:4], *without_sums))
    free = wandering(40, 3)
    t = free.t
    soft = np.where((t > 10) & (t < 16), 3.0 * np.sin(np.pi * (t - 10) / 6), 0.0)
    with_sum, without = ([x.collision.max() for x in walk(ExcessStage(item, Rates(1.0)), free,
                                                          soft)] for item in (learned, before))
    assert max(without) < 1.0 < max(with_sum)
    assert 10.0 < t[int(np.argmax(np.array(with_sum) > 1.0))] < 16.0
    assert max(x.collision.max() for x in walk(ExcessStage(learned, Rates(1.0)), free)) < 1.0


def test_sums_are_those_that_were_learned_from() -> None:
    """Sample by sample the sums are those of a whole record, up to the threshold."""
    rng = np.random.default_rng(3)
    z = rng.normal(size=(500, 2)) + np.sin(np.arange(500) / 40.0)[:, None]
    dt = rng.uniform(0.005, 0.02, 500)
    whole = accumulate(dt, z)
    sums = np.zeros((2, 2))
    for k in range(500):
        advance(dt[k], z[k], np.full(2, 1e9), sums)
        assert np.array_equal(whole[k], sums.max(axis=0))
    advance(0.01, np.full(2, np.nan), np.full(2, 1e9), sums)
    assert np.array_equal(whole[-1], sums.max(axis=0))


def test_a_force_that_goes_is_no_new_hit() -> None:
    """Behind a hit the sum of the other direction begins below zero."""
    sums, bound = np.zeros((2, 1)), np.array([0.5])
    told = []
    for k in range(400):
        z = 5.0 if k < 40 else (-5.0 if 42 <= k < 54 else 0.0)
        advance(0.01, np.array([z]), bound, sums)
        told.append(bool(sums.max() > bound[0]))
    assert any(told[:42]) and not any(told[50:])


def test_thresholds_that_lack_something_are_refused(learned: MethodThresholds) -> None:
    """Bundles of before there was a release say what they lack, and nothing is guessed."""
    content = thresholds_to_dict(learned)
    for change, message in (({'tails': content['tails'][:4]}, 'tails has 4 entries; expected 6'),
                            ({'usual': None}, 'usual'), ({'reach': [1.0]}, 'reach'),
                            ({'stiction': [-1.0, 0.0]}, 'stiction.0. must be at least 0')):
        with pytest.raises(ModelError, match=message):
            thresholds_from_dict({**content, **change}, CHANNELS, 2)
