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

"""The live chain: stamps, gaps, pairing; the same numbers as the offline tools."""

from __future__ import annotations

import numpy as np
import pytest

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.online.streams import Motion, Pairing, ResidualStage, StampGate, StateFilter
from tudor_dynamics.signals.preprocessing import prepare

MS = 1_000_000


def wave(count: int, period: int = 10 * MS) -> tuple[np.ndarray, np.ndarray]:
    """Stamps [ns] and positions of two joints that swing."""
    stamp = 10**18 + period * np.arange(count)
    t = np.arange(count)[:, None] * period * 1e-9
    return stamp, np.sin(t * np.array([2.0, 3.1]))


@pytest.mark.parametrize('cutoff', [None, 15.0])
@pytest.mark.parametrize('jitter', [0, 2 * MS])
def test_same_as_offline(cutoff: float | None, jitter: int) -> None:
    """Every sample of a record with a gap, filtered live, equals the record filtered at once."""
    spec = PreprocessingSpec(output_cutoff=cutoff, rate=None, settle=0.5)
    stamp, q = wave(600)
    rng = np.random.default_rng(1)
    stamp = stamp + (jitter * rng.uniform(size=600)).astype(np.int64)
    stamp[300:] += 2_000 * MS
    recording = Recording('wave', stamp, q, None, None, 100 * q, (slice(0, 300), slice(300, 600)),
                          0.01)
    live = StateFilter(spec)
    stage, pairing = ResidualStage(cutoff, spec.settle), Pairing()
    motions, measured = {}, {}
    for s, row in zip(stamp.tolist(), q, strict=True):
        motion = live.step(s, row)
        assert motion is not None
        pairs = pairing.add_motion(motion, np.zeros(2)) + pairing.add_measured(s, 100 * row)
        for pair in pairs:
            residual = stage.step(pair)
            if residual is not None:
                motions[s], measured[s] = residual.motion.row, residual.measured
    wanted = prepare(recording, spec)
    kept = np.concatenate([s.stamp[s.decimation.keep] for s in wanted])
    assert sorted(motions) == kept.tolist()
    for s in wanted:
        keep = s.decimation.keep
        got = np.array([motions[x] for x in s.stamp[keep].tolist()])
        assert np.abs(got - s.motion[keep]).max() < 1e-9
        got = np.array([measured[x] for x in s.stamp[keep].tolist()])
        assert s.strain is not None
        assert np.abs(got - s.strain[keep]).max() < 1e-9


def test_bad_samples_leave_no_trace() -> None:
    """NaN, repeated and late stamps are counted; what comes after is as if they never were."""
    spec = PreprocessingSpec()
    stamp, q = wave(50)
    plain, disturbed = StateFilter(spec), StateFilter(spec)
    for k, (s, row) in enumerate(zip(stamp.tolist(), q, strict=True)):
        first = plain.step(s, row)
        second = disturbed.step(s, row)
        assert first is not None and second is not None
        assert np.array_equal(first.row, second.row)
        if k == 20:
            assert disturbed.step(s, row + 1) is None
            assert disturbed.step(s - 5 * MS, row + 1) is None
            assert disturbed.step(s + MS, np.array([np.nan, 0.0])) is None
    assert disturbed.drops == {'duplicate_stamp': 1, 'backward_stamp': 1, 'not_finite': 1}


def test_gap_and_clock_set_back_begin_anew() -> None:
    """Nothing is differentiated across a gap or a jump of the clock."""
    stamp, q = wave(60)
    live = StateFilter(PreprocessingSpec())
    for s, row in zip(stamp.tolist(), q, strict=True):
        last = live.step(s, row)
    assert last is not None and last.elapsed > 0.5
    behind = live.step(int(stamp[-1]) + 1000 * MS, q[0])
    assert behind is not None and behind.elapsed == 0.0 and not behind.row[2:].any()
    back = live.step(int(stamp[0]), q[0])
    assert back is not None and back.elapsed == 0.0
    assert live.drops == {'gap': 99, 'clock_set_back': 1}


def test_slow_sources_are_no_gaps() -> None:
    """At 10 Hz samples are 100 ms apart, which is no gap; at 2 kHz 100 ms are one."""
    gate = StampGate()
    assert gate.step(0) == 0.0
    assert all(gate.step(100 * MS * k) == 0.1 for k in range(1, 50))
    gate = StampGate()
    for k in range(1, 50):
        gate.step(MS // 2 * k)
    assert gate.step(MS // 2 * 50 + 100 * MS) == 0.0


def motion(stamp: int) -> Motion:
    """Make a motion of one joint."""
    return Motion(stamp, 1.0, 0.01, np.zeros(3))


def test_pairing_interpolates_between_neighbours() -> None:
    """A motion between two readings waits for the second and gets their mean."""
    pairing = Pairing()
    assert pairing.add_measured(0, np.array([1.0])) == []
    assert pairing.add_motion(motion(5 * MS), np.zeros(1)) == []
    assert pairing.add_motion(motion(10 * MS), np.zeros(1)) == []
    first, second = pairing.add_measured(10 * MS, np.array([3.0]))
    assert first.measured[0] == pytest.approx(2.0) and second.measured[0] == 3.0
    assert not pairing.drops


def test_a_constant_reading_stays_constant() -> None:
    """To the last bit, wherever motions lie between readings: so a stuck sensor is seen."""
    pairing, found = Pairing(), []
    for k in range(200):
        found += pairing.add_measured(10 * MS * k, np.array([3.3, 0.1]))
        found += pairing.add_motion(motion(10 * MS * k + 37_511 * k), np.zeros(1))
    assert len(found) > 150 and all(pair.measured.tolist() == [3.3, 0.1] for pair in found)


def test_pairing_drops_what_has_no_neighbour() -> None:
    """A motion before the first reading, one across a gap, and a reading that is no number."""
    pairing = Pairing()
    for k in range(10):
        pairing.add_measured(100 * MS + 10 * MS * k, np.array([float(k)]))
    assert pairing.add_motion(motion(5 * MS), np.zeros(1)) == []
    assert pairing.add_motion(motion(500 * MS), np.zeros(1)) == []
    assert pairing.add_measured(600 * MS, np.array([np.nan])) == []
    assert pairing.add_measured(900 * MS, np.array([0.0])) == []
    assert pairing.drops['no_neighbour'] == 2 and pairing.drops['not_finite'] == 1


def test_memory_is_bounded() -> None:
    """Motions without any reading do not pile up."""
    pairing = Pairing()
    for k in range(5000):
        pairing.add_motion(motion(MS * k + 1), np.zeros(1))
    assert pairing.drops['no_measurement'] == 4600  # of 5000: no more than 400 wait


def test_links_by_name(root) -> None:
    """Gauges and joints belong to links; D-H rows have no names for them."""
    from tudor_dynamics.online.detector import channel_links
    links = channel_links(load_arm(root / 'config/two_blade_arm.yaml'))
    assert links['joint3'] == links['link3_hub'] == (3, 'link3')
    assert links['link2_hub'][0] == 2
