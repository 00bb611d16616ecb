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

"""Preparation of recordings: gaps, settling, decimation, blocks that add up to the whole."""

from __future__ import annotations

import numpy as np
import pytest
from sample_arms import multisine, recording_of

from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import SignalError
from tudor_dynamics.signals.filters import CausalDifferentiator, low_pass_gain
from tudor_dynamics.signals.preprocessing import prepare, Stretch


def _motion(n: int, rate: float) -> np.ndarray:
    return multisine(np.arange(n) / rate, 2)


@pytest.mark.parametrize('kind', ['causal', 'zero_phase'])
def test_nothing_crosses_a_gap(kind: str) -> None:
    """Each side of a jump gives what it gives alone: no derivative sees the jump."""
    rate = 200.0
    q = _motion(2000, rate)[:, :2]
    q[900:] += 1.0
    strain = np.column_stack([q[:, 0]])
    spec = PreprocessingSpec(filter=kind, rate=None, settle=0.5, output_cutoff=30.0)
    first, second = prepare(recording_of(q, rate, strain=strain, gaps=(900,)), spec)
    alone, = prepare(recording_of(q[900:], rate, strain=strain[900:]), spec)
    assert len(first.t) == 900 and second.t[0] == pytest.approx(900 / rate + 2.0)
    for name in ('q', 'dq', 'ddq'):
        found, expected = getattr(second.states, name), getattr(alone.states, name)
        assert np.max(np.abs(found - expected)) < 1e-6 * np.max(np.abs(expected))
    kept = second.decimation.keep
    assert np.max(np.abs(second.states.ddq[kept])) < 30.0  # a jump of 1 rad would give 4e4
    assert second.strain is not None and alone.strain is not None
    assert np.allclose(second.strain, alone.strain, atol=1e-9)


def _concatenated(stretch: Stretch) -> tuple[np.ndarray, np.ndarray]:
    motion, strain = [], []
    for block in stretch.blocks('strain'):
        assert block.decimation is not None and len(block.motion) < 4096 + 2 * 2101
        motion.append(block.decimation(block.motion))
        strain.append(block.output)
    return np.vstack(motion), np.vstack(strain)


@pytest.mark.parametrize(('kind', 'rate', 'to', 'tolerance'), [
    ('causal', 100.0, None, 0.0), ('causal', 100.0, 20.0, 0.0),
    ('zero_phase', 100.0, None, 0.0), ('zero_phase', 100.0, 20.0, 1e-7),
    ('zero_phase', 1000.0, 40.0, 1e-7), ('zero_phase', 250.0, 125.0, 1e-7)])
def test_blocks_make_the_whole(kind: str, rate: float, to: float | None, tolerance: float) -> None:
    """Blocks of bounded size, one after the other, are the whole stretch, decimated at once."""
    n = 30_000
    generator = np.random.default_rng(0)
    motion = _motion(n, rate)
    strain = motion[:, :1] + generator.normal(0, 0.3, (n, 1))
    stretch, = prepare(recording_of(motion[:, :2], rate, strain=strain),
                       PreprocessingSpec(filter=kind, rate=to, cutoff=None))
    found_motion, found_strain = _concatenated(stretch)
    assert stretch.strain is not None
    assert len(list(stretch.blocks('strain'))) > 1
    whole = stretch.decimation(stretch.motion)
    assert len(found_motion) == stretch.n_kept == len(whole)
    assert np.max(np.abs(found_motion - whole)) <= tolerance * np.max(np.abs(whole))
    strain_whole = stretch.decimation(stretch.strain)
    assert np.max(np.abs(found_strain - strain_whole)) <= tolerance * np.max(np.abs(strain_whole))


def test_rate_and_settle() -> None:
    """Samples come at the rate asked for, after settling; zero-phase settles at both ends."""
    recording = recording_of(_motion(1000, 100.0)[:, :2], 100.0, effort=np.zeros((1000, 2)))
    stretch, = prepare(recording, PreprocessingSpec(rate=20.0, settle=0.5))
    times = stretch.t[stretch.decimation.keep]
    assert times[0] == pytest.approx(0.5)
    assert np.allclose(np.diff(times), 0.05)
    assert times[-1] == pytest.approx(9.95)
    assert stretch.n_kept == 190
    both, = prepare(recording, PreprocessingSpec(filter='zero_phase', rate=20.0, settle=1.0))
    times = both.t[both.decimation.keep]
    assert times[0] == pytest.approx(1.0) and times[-1] <= 9.0
    assert both.decimation.sections is not None
    every, = prepare(recording, PreprocessingSpec(rate=None, settle=0.0))
    assert every.n_kept == 1000


@pytest.mark.parametrize('kind', ['causal', 'zero_phase'])
@pytest.mark.parametrize(('rest', 'kept_rest'), [(0.0, 0.5), (0.15, 0.1), (0.8, 0.5)])
def test_a_move_right_after_the_start_is_used(kind: str, rest: float, kept_rest: float) -> None:
    """Where the arm stood first there is nothing to settle from."""
    rate, move = 250.0, 1.2
    t = np.arange(round((rest + move + rest) * rate) + round(rate)) / rate - 0.5 - rest
    place = np.clip(t / move, 0.0, 1.0)
    q = (place - np.sin(2.0 * np.pi * place) / (2.0 * np.pi))[:, None] * np.array([1.0, -0.5])
    cut = round(0.5 * rate)
    spec = PreprocessingSpec(filter=kind, rate=None, cutoff=20.0)
    alone, = prepare(recording_of(q[cut:-cut], rate, effort=q[cut:-cut]), spec)
    whole, = prepare(recording_of(q, rate, effort=q), spec.model_copy(update={'settle': 0.0}))
    kept = alone.decimation.keep
    assert alone.t[kept[0]] == pytest.approx(kept_rest, abs=0.5 / rate)
    if kind == 'zero_phase':
        assert alone.t[-1] - alone.t[kept[-1]] == pytest.approx(kept_rest, abs=1.5 / rate)
    for name in ('dq', 'ddq'):
        found, expected = (getattr(item.states, name) for item in (alone, whole))
        error = np.abs(found[kept] - expected[cut:-cut][kept]).max()
        assert error < (2e-3 if kept_rest < spec.settle else 2e-2) * np.abs(expected).max()


def test_decimation_removes_what_it_cannot_show() -> None:
    """Zero-phase decimation keeps 1 Hz and removes 45 Hz, which would fold down to 5 Hz."""
    t = np.arange(4000) / 200.0
    strain = np.column_stack([np.sin(2 * np.pi * t), np.sin(2 * np.pi * 45.0 * t)])
    stretch, = prepare(recording_of(_motion(4000, 200.0)[:, :2], 200.0, strain=strain),
                       PreprocessingSpec(filter='zero_phase', rate=20.0))
    assert stretch.strain is not None
    kept = stretch.decimation(stretch.strain)
    assert np.allclose(kept[:, 0], strain[stretch.decimation.keep, 0], atol=0.02)
    assert np.max(np.abs(kept[40:-40, 1])) < 1e-3


@pytest.mark.parametrize('factor', [2, 5, 25])
def test_decimation_keeps_the_scale(factor: int) -> None:
    """A constant comes out of decimation as it went in."""
    strain = np.full((4000, 1), 250.0)
    stretch, = prepare(recording_of(_motion(4000, 200.0)[:, :2], 200.0, strain=strain),
                       PreprocessingSpec(filter='zero_phase', rate=200.0 / factor))
    assert stretch.strain is not None
    assert np.allclose(stretch.decimation(stretch.strain), 250.0, rtol=1e-6)


def test_output_cutoff() -> None:
    """The low-pass goes over positions, velocities and outputs alike, accelerations excepted."""
    motion = _motion(500, 100.0)
    spec = PreprocessingSpec(output_cutoff=5.0, rate=None)
    stretch, = prepare(recording_of(motion[:, :2], 100.0, effort=motion[:, :2]), spec)
    plain = CausalDifferentiator().process(np.full(500, 0.01), motion[:, :2])
    gain = low_pass_gain(5.0, 0.01)

    def smooth(x: np.ndarray) -> np.ndarray:
        y = x.copy()
        for k in range(1, len(x)):
            y[k] = y[k - 1] + gain * (x[k] - y[k - 1])
        return y

    assert stretch.effort is not None
    assert np.allclose(stretch.effort, smooth(motion[:, :2]), rtol=1e-6)
    assert np.allclose(stretch.states.q, stretch.effort, rtol=1e-9)
    assert np.allclose(stretch.states.dq, smooth(plain.dq), rtol=1e-6)
    assert np.allclose(stretch.states.ddq, plain.ddq, rtol=1e-5, atol=1e-6)


def test_measured_velocity() -> None:
    """The driver's velocity is used where it is there and wanted."""
    motion = _motion(200, 100.0)
    recording = recording_of(motion[:, :2], 100.0, dq=motion[:, 2:4])
    used, = prepare(recording, PreprocessingSpec(rate=None))
    assert np.array_equal(used.states.dq, motion[:, 2:4])
    derived, = prepare(recording, PreprocessingSpec(rate=None, measured_velocity=False))
    assert not np.allclose(derived.states.dq, motion[:, 2:4])


def test_too_short() -> None:
    """Stretches too short to settle are left out; if none is left, the message says why."""
    q = _motion(300, 100.0)[:, :2]
    stretches = prepare(recording_of(q, 100.0, gaps=(40,)), PreprocessingSpec(settle=0.5))
    assert [len(s.t) for s in stretches] == [260]
    with pytest.raises(SignalError, match='bag: no part without gaps is longer than 6 s'):
        prepare(recording_of(q, 100.0), PreprocessingSpec(settle=3.0))
    with pytest.raises(SignalError, match='32 samples'):
        prepare(recording_of(q[:20], 100.0), PreprocessingSpec(settle=0.0))
    with pytest.raises(SignalError, match='cutoff= 60 Hz'):
        prepare(recording_of(q, 100.0), PreprocessingSpec(filter='zero_phase', cutoff=60.0))
