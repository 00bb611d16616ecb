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

"""Causal and zero-phase differentiation: equal by sample and by record, gains, delays, errors."""

from __future__ import annotations

from math import pi

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from tudor_dynamics.errors import SignalError
from tudor_dynamics.signals.filters import CausalDifferentiator, low_pass_gain, zero_phase


@settings(max_examples=60, deadline=None)
@given(n=st.integers(2, 60), joints=st.integers(1, 3), seed=st.integers(0, 2**31),
       measured=st.booleans(), uniform=st.booleans())
def test_record_and_samples(
    n: int, joints: int, seed: int, measured: bool, uniform: bool,
) -> None:
    """A record in one piece and sample by sample gives the same states."""
    generator = np.random.default_rng(seed)
    dt = np.full(n, 0.001) if uniform else generator.uniform(1e-4, 2e-2, n)
    q = np.cumsum(generator.normal(0, 0.01, (n, joints)), axis=0)
    dq = generator.normal(0, 1, (n, joints)) if measured else None
    whole = CausalDifferentiator().process(dt, q, dq)
    by_sample = CausalDifferentiator()
    steps = [by_sample.step_row(float(dt[k]), q[k], None if dq is None else dq[k])
             for k in range(n)]
    for name, found in zip(('q', 'dq', 'ddq'), np.split(np.array(steps), 3, axis=1)):
        assert np.array_equal(found, getattr(whole, name))


@pytest.mark.parametrize(('dt', 'first', 'second'), [
    (0.0005, 0.22223, 0.06090), (0.001, 0.39508, 0.11809), (0.01, 0.99344, 0.71539)])
def test_gains(dt: float, first: float, second: float) -> None:
    """
    The gains are those of low-passes with the pole of the continuous ones.

    Reference: 1 - exp(-2 pi f dt) for 80 and 20 Hz, worked out by hand to five digits. A step of
    the difference quotient shows them in the filter itself.
    """
    assert low_pass_gain(80.0, dt) == pytest.approx(first, abs=5e-6)
    assert low_pass_gain(20.0, dt) == pytest.approx(second, abs=5e-6)
    filt = CausalDifferentiator()
    filt.step_row(dt, np.zeros(1))
    _, dq, ddq = filt.step_row(dt, np.array([dt]))
    assert dq == pytest.approx(first, abs=5e-6)
    assert ddq * dt == pytest.approx(first * second, abs=1e-5)


def test_delays() -> None:
    """
    At 2 kHz a slow sine comes out 2.00 ms (velocity) and 9.96 ms (acceleration) late.

    Reference: half a sample for each difference quotient, and dt (1 - gain) / gain for each
    low-pass, worked out by hand from the discrete transfer function. That is half a sample less
    for each low-pass than the time constants 1.99 and 7.96 ms of the continuous ones.

    """
    dt, w = 0.0005, 2 * pi * 0.5
    t = dt * np.arange(20_000)
    states = CausalDifferentiator().process(np.full(len(t), dt), np.sin(w * t)[:, None])
    late = slice(8_000, None)
    basis = np.column_stack([np.sin(w * t), np.cos(w * t)])[late]
    delays = []
    for signal, quarter in ((states.dq, pi / 2), (states.ddq, pi)):
        a, b = np.linalg.lstsq(basis, signal[late, 0], rcond=None)[0]
        delays.append(1e3 * ((quarter - np.arctan2(b, a)) % (2 * pi)) / w)
    assert delays[0] == pytest.approx(2.00, abs=0.01)
    assert delays[1] == pytest.approx(9.96, abs=0.01)


def test_first_sample_is_at_rest() -> None:
    """The first sample of a record has no velocity of its own, whatever came before."""
    filt = CausalDifferentiator()
    filt.process(np.full(5, 0.01), np.arange(5.0)[:, None])
    states = filt.process(np.array([7.0]), np.array([[3.0]]))
    assert states.dq.tolist() == [[0.0]] and states.ddq.tolist() == [[0.0]]


def test_inputs_stay_and_refusal_leaves_no_trace() -> None:
    """A record refused for its stamps changes nothing; what is accepted is not written to."""
    filt = CausalDifferentiator()
    q = np.array([[0.0], [1.0], [2.0]])
    with pytest.raises(SignalError, match='sample time 0 s at sample 2; stamps must increase'):
        filt.process(np.array([0.0, 0.1, 0.0]), q)
    kept = q.copy()
    after = filt.process(np.full(3, 0.1), q)
    fresh = CausalDifferentiator().process(np.full(3, 0.1), q)
    assert np.array_equal(after.ddq, fresh.ddq) and np.array_equal(q, kept)


def test_states_are_the_callers_own() -> None:
    """What a caller does with the states of a sample does not reach the next one."""
    one, other = CausalDifferentiator(), CausalDifferentiator()
    for k in range(5):
        q = np.array([0.1 * k * k])
        expected = other.step_row(0.01, q.copy())
        found = one.step_row(0.01, q)
        assert np.array_equal(found, expected)
        q[:], found[:] = 99.0, 99.0


@pytest.mark.parametrize(('call', 'message'), [
    (lambda: CausalDifferentiator().process(np.ones(3), np.zeros((3, 2)), np.zeros((3, 1))),
     'velocities have shape'),
    (lambda: CausalDifferentiator().process(np.array([1.0, np.nan]), np.zeros((2, 1))),
     'sample time nan s at sample 1'),
    (lambda: zero_phase(np.arange(40.0), np.zeros((40, 1)), 0.5), 'cutoff= 0.5 Hz: give more'),
    (lambda: zero_phase(np.arange(40.0), np.zeros((40, 1)), 0.0), 'cutoff= 0 Hz: give more'),
])
def test_errors(call: object, message: str) -> None:
    """Each impossible setting or record is refused with what was found and expected."""
    with pytest.raises(SignalError, match=message):
        call()  # type: ignore[operator]


def test_step_errors() -> None:
    """A stamp that stands still is refused in the control loop too."""
    filt = CausalDifferentiator()
    filt.step_row(0.1, np.zeros(2))
    with pytest.raises(SignalError, match='sample time 0 s; stamps must increase'):
        filt.step_row(0.0, np.zeros(2))


def test_acceleration_of_a_fast_motion() -> None:
    """At 2 Hz and 100 samples a second, accelerations are right to a ten-thousandth."""
    t = np.arange(1000) * 0.01
    q = np.sin(4.0 * pi * t)[:, None]
    states = zero_phase(t, q, 10.0, 4.0 * pi * np.cos(4.0 * pi * t)[:, None])
    wanted = -(4.0 * pi) ** 2 * q[100:-100]
    gain = float(np.vdot(states.ddq[100:-100], wanted) / np.vdot(wanted, wanted))
    assert abs(gain - 1.0) < 1e-4


@pytest.mark.parametrize('jitter', [0.0, 0.2])
@pytest.mark.parametrize('measured', [False, True])
def test_zero_phase(jitter: float, measured: bool) -> None:
    """A 1 Hz sine at 100 Hz comes out accurate and without lag, stamps uneven or not."""
    generator = np.random.default_rng(3)
    w = 2 * pi
    t = 0.01 * np.arange(1000)
    t[1:-1] += 0.01 * jitter * generator.uniform(-1, 1, 998)
    q = np.column_stack([np.sin(w * t), np.cos(w * t)])
    dq = w * np.column_stack([np.cos(w * t), -np.sin(w * t)])
    states = zero_phase(t, q, 10.0, dq if measured else None)
    inner = slice(100, -100)
    tolerance = 0.004 if jitter else 0.002
    assert np.max(np.abs(states.q - q)[inner]) < tolerance
    assert np.max(np.abs(states.dq - dq)[inner]) < w * tolerance
    assert np.max(np.abs(states.ddq + w * w * q)[inner]) < w * w * (0.02 if jitter else 0.004)
    sine, cosine = np.linalg.lstsq(
        np.column_stack([np.sin(w * t), np.cos(w * t)])[inner], states.ddq[inner, 0],
        rcond=None)[0]
    assert abs(np.arctan2(cosine, -sine)) / w < 1e-5  # lag [s]
