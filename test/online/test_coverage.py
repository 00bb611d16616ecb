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

"""Shares of what was not judged, and samples that were lost."""

from __future__ import annotations

from collections import Counter

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from tudor_dynamics.online.coverage import (
    Coverage, CoverageLevel, MEANING, OutputCoverage, TopicCount)
from tudor_dynamics.online.streams import StampGate

MS = 1_000_000


class Robot:
    """What a detector of strain counts, by hand."""

    def __init__(self, settle: float = 0.5) -> None:
        self.motion, self.strain = TopicCount('joints'), TopicCount('strains')
        self.motions: Counter[str] = Counter()
        self.measured: Counter[str] = Counter()
        self.judged = OutputCoverage(
            'strain', self.motion, [self.strain], [self.strain], [self.motions], [self.measured],
            settle)
        self.now = 0.0

    def live(self, seconds: float, *, joints: int = 50, strains: int = 50, offset: float = 0.0,
             **causes: int) -> list[CoverageLevel]:
        """Look every 0.1 s, so many messages and so many of each cause further."""
        seen = []
        for _ in range(round(10 * seconds)):
            self.now += 0.1
            self.motion.count += joints
            self.strain.count += strains
            if joints:
                self.motion.stamp = round(self.now * 1e9)
            if strains:
                self.strain.stamp = round((self.now - offset) * 1e9)
            for cause, n in causes.items():
                counts = self.measured if cause.startswith('strain_') else self.motions
                counts[cause.removeprefix('strain_')] += n
            self.verdict = self.judged.look(self.now)
            seen.append(self.verdict.level)
        return seen


def test_all_judged() -> None:
    """Nothing is told."""
    robot = Robot()
    assert set(robot.live(5.0, judged=50)) == {CoverageLevel.ENOUGH}
    assert robot.verdict.share == 0.0 and robot.verdict.text == ''


@pytest.mark.parametrize(('causes', 'said'), [
    ({'gap': 20}, 'because messages on joints are lost'),
    ({'strain_gap': 20}, 'because messages on strains are lost'),
    ({'gap': 1, 'strain_gap': 20}, 'because messages on strains are lost'),
    ({'gap': 1, 'strain_not_finite': 20}, 'mainly because messages on strains have NaN'),
    ({'strain_not_finite': 20}, 'because messages on strains have NaN'),
    ({'no_neighbour': 20}, 'because no stamp on strains is near'),
    ({'no_thresholds': 20}, 'because the model has no thresholds; '),
    ({'no_prediction': 20}, 'because no prediction comes, or the model diverged; ')])
def test_topics(causes: dict[str, int], said: str) -> None:
    """A cause comes with the topics that it is about; its code is a value of the diagnosis."""
    robot = Robot()
    robot.live(3.0, judged=30, **causes)
    text = robot.verdict.text
    assert f'of strain in the last second, {said}' in text
    assert ' on ' in text or ' on ' not in said
    assert not any(f'({cause})' in text for cause in MEANING)


@pytest.mark.parametrize(('n', 'level'), [
    (0, CoverageLevel.ENOUGH), (1, CoverageLevel.PARTIAL), (9, CoverageLevel.PARTIAL),
    (10, CoverageLevel.NONE)])
def test_limits(n: int, level: CoverageLevel) -> None:
    """A warning from 1 %, an error from 20 %."""
    robot = Robot()
    seen = robot.live(3.0, judged=50 - n, gap=n)
    assert seen[-1] is level
    assert robot.verdict.causes.get('gap', 0.0) == pytest.approx(n / 50)
    assert robot.live(1.2, judged=50)[-1] is CoverageLevel.ENOUGH


def test_another_device_on_the_same_topic_is_no_fault() -> None:
    """Its messages count where nothing else comes, and hide no fault of the arm's."""
    robot = Robot()
    both = {'joints': 100, 'strains': 100, 'other_names': 50, 'strain_other_names': 50}
    assert set(robot.live(3.0, judged=50, **both)) == {CoverageLevel.ENOUGH}
    assert robot.verdict.share == 0.0
    robot.live(3.0, judged=49, strain_not_finite=1, **both)
    assert robot.verdict.causes == {'not_finite': pytest.approx(0.02)}
    robot.live(3.0, strain_not_finite=50, no_measurement=50, **both)
    assert ', mainly because messages on strains have NaN' in robot.verdict.text
    alone = Robot()
    assert alone.live(3.0, strains=0, other_names=50)[-1] is CoverageLevel.NONE
    assert 'no message came on strains' in alone.verdict.text
    alone = Robot()
    alone.live(3.0, other_names=50)
    assert alone.verdict.text.endswith('correct the names in the driver')
    gauges = Robot()
    gauges.live(3.0, no_measurement=50, strain_other_names=50)
    assert 'messages on strains name no joint' in gauges.verdict.text


def test_settling_is_a_warning_for_its_time_only() -> None:
    """0.7 s after the start: WARN. A gap every second, with settling: ERROR in the end."""
    robot = Robot()
    assert set(robot.live(0.7, settling=50)[1:]) == {CoverageLevel.PARTIAL}
    assert 'filters settle' in robot.verdict.text
    assert robot.live(1.2, judged=50)[-1] is CoverageLevel.ENOUGH
    seen: list[CoverageLevel] = []
    for _ in range(6):
        seen += robot.live(0.5, settling=50) + robot.live(0.5, judged=50)
    assert seen[8] is CoverageLevel.PARTIAL and seen[-1] is CoverageLevel.NONE


def test_a_long_settling_is_no_error() -> None:
    """A momentum observer of 3 s: nothing is judged for long, and that is as it should be."""
    robot = Robot(settle=3.0)
    assert set(robot.live(3.0, settling=50)[1:]) == {CoverageLevel.PARTIAL}


def test_an_interruption_is_no_flood_of_lost_samples() -> None:
    """A driver that stood for a minute: a warning while the filters settle, then all is clear."""
    robot = Robot()
    robot.live(3.0, judged=50)
    assert set(robot.live(60.0, joints=0, strains=0)[20:]) == {CoverageLevel.ENOUGH}
    seen = robot.live(0.1, gap=30_000) + robot.live(0.4, settling=50) + robot.live(2.0, judged=50)
    assert CoverageLevel.NONE not in seen and CoverageLevel.PARTIAL in seen
    assert seen[-1] is CoverageLevel.ENOUGH


def test_silence_of_one_topic_names_it() -> None:
    """Within 1.2 s; a silence of all topics is none of this."""
    robot = Robot()
    robot.live(3.0, judged=50)
    seen = robot.live(1.2, strains=0)
    assert seen[7] is CoverageLevel.ENOUGH and seen[-1] is CoverageLevel.NONE
    assert 'no message came on strains' in robot.verdict.text
    robot.live(1.2, judged=50)
    robot.live(1.2, joints=0)
    assert 'no message came on joints' in robot.verdict.text


def test_measurements_left_out_are_the_reason_for_motions_without() -> None:
    """Strains that are no numbers, not the motions that lack them, are named."""
    robot = Robot()
    robot.live(2.0, judged=50)
    robot.live(2.0, strain_not_finite=50, no_measurement=50)
    assert 'because messages on strains have NaN' in robot.verdict.text


@pytest.mark.parametrize('offset', [-0.25, -0.03, 0.03, 0.25])
def test_stamps_apart(offset: float) -> None:
    """Told with sign and size, from 20 ms."""
    robot = Robot()
    seen = robot.live(3.0, judged=50, offset=offset)
    side = 'later' if offset > 0 else 'earlier'
    assert seen[-1] is CoverageLevel.PARTIAL
    assert f'strains are {abs(offset) * 1e3:.0f} ms {side} than' in robot.verdict.text
    assert set(Robot().live(3.0, judged=50, offset=0.4 * offset / 10)) == {CoverageLevel.ENOUGH}


def test_slow_topics_are_not_apart() -> None:
    """At 20 Hz the newest stamps differ by up to a period, which means nothing."""
    robot = Robot()
    seen = robot.live(5.0, judged=2, joints=2, strains=2, offset=0.05)
    assert set(seen) == {CoverageLevel.ENOUGH}


@given(st.lists(st.dictionaries(
    st.sampled_from([*MEANING, 'judged', 'clock_set_back', *(f'strain_{c}' for c in MEANING)]),
    st.integers(0, 100), max_size=4), max_size=40))
@settings(max_examples=100, deadline=None)
def test_any_counts(steps: list[dict[str, int]]) -> None:
    """Shares are shares, what is not clear has a text, and all judged is clear in the end."""
    robot = Robot()
    for causes in steps:
        robot.live(0.1, **causes)
        verdict = robot.verdict
        assert 0.0 <= verdict.share <= 1.0 + 1e-9
        assert all(0.0 <= share <= 1.0 and cause in MEANING
                   for cause, share in verdict.causes.items())
        assert bool(verdict.text) == (verdict.level > CoverageLevel.ENOUGH)
        assert verdict.level is not CoverageLevel.ENOUGH or verdict.share < 0.01
    robot.live(4.0, judged=50)
    assert robot.verdict.level is CoverageLevel.ENOUGH and robot.verdict.share == 0.0


def test_coverage_takes_the_worst_output() -> None:
    """Effort is judged and strain is not: the texts of strain, the shares of both."""
    coverage, effort, strain = Coverage(), Counter[str](), Counter[str]()
    for output, counts in (('effort', effort), ('strain', strain)):
        coverage.add(output, 'joints', None, (output,), [counts], [Counter()], 0.5)
    told = []
    for k in range(500):
        for topic in ('joints', 'effort', 'strain', 'foreign'):
            told.append(coverage.came(topic, k * 5 * MS, k * 0.005))
        effort['judged'] += 1
        strain['no_neighbour'] += 1
    assert coverage.verdict.level is CoverageLevel.NONE and 'strain' in coverage.verdict.text
    assert 'of effort ' not in coverage.verdict.text
    assert sum(told) in (1, 2)  # to a warning, to an error


def test_what_is_the_same_for_several_outputs_is_said_once() -> None:
    """With both outputs, each with its share, where causes agree; apart where they do not."""
    for cause, lost, more, said in (
            ('gap', 20, 0, 'effort and strain in the last second, because '),
            ('gap', 10, 0, 'effort and 9.8 % of the samples of strain in the last second, beca'),
            ('gap', 19, 1, 'effort and strain in the last second, mainly because '),
            ('no_prediction', 20, 0, 'effort in the last second, because ')):
        coverage, effort, strain = Coverage(), Counter[str](), Counter[str]()
        for output, counts in (('effort', effort), ('strain', strain)):
            coverage.add(output, 'joints', None, (output,), [counts], [Counter()], 0.5)
        for k in range(500):
            for topic in ('joints', 'effort', 'strain'):
                coverage.came(topic, k * 5 * MS, k * 0.005)
            effort['gap' if k % 100 < 20 else 'judged'] += 1
            strain[cause if k % 100 < lost else 'settling' if k % 100 < lost + more
                   else 'judged'] += 1
        text = coverage.verdict.text
        assert f'19.5 % of the samples of {said}' in text
        assert text.count('cannot be detected') == 1 + (cause != 'gap'), text


def stream(gate: StampGate, stamps: np.ndarray) -> int:
    """Give what a gate counts as lost."""
    for stamp in stamps.tolist():
        gate.step(stamp)
    return gate.drops['gap']


@given(st.sets(st.integers(20, 380), max_size=60), st.floats(0.5, 50.0))
@settings(max_examples=100, deadline=None)
def test_lost_samples_are_counted(lost: set[int], period: float) -> None:
    """As many as are missing, whichever they are, at any rate."""
    stamps = np.array([round(k * period * MS) for k in range(400) if k not in lost])
    assert stream(StampGate(), stamps) == len(lost)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_late_samples_are_not_lost(seed: int) -> None:
    """Stamps made at reception jitter by 30 % of a period and come in bursts: below 1 %."""
    random = np.random.default_rng(seed)
    stamps = np.arange(1000) * 10 * MS + random.integers(-3 * MS, 3 * MS, 1000)
    for k in range(100, 1000, 100):
        stamps[k:k + 3] = stamps[k + 2] - np.array([2, 1, 0]) * MS // 10  # a burst
    assert stream(StampGate(), stamps) < 10


def test_a_source_that_slows_down_loses_nothing() -> None:
    """From 500 to 100 Hz and back, without a gap between."""
    steps = [2] * 100 + [10] * 100 + [2] * 100
    assert stream(StampGate(), np.cumsum(steps) * MS) == 0


def test_samples_that_are_no_numbers_are_not_lost() -> None:
    """They came: one cause for each sample."""
    gate = StampGate()
    for k in range(100):
        if k % 10 == 9:
            gate.unusable()
        else:
            gate.step(k * 10 * MS)
    assert gate.drops['gap'] == 0
