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

"""Readings that no arm makes, put into a recording of a known one, and what is said of each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math

from doctor_making import column, described, healthy
import numpy as np
import pytest

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification.doctor.examine import examine
from tudor_dynamics.identification.doctor.findings import Finding
from tudor_dynamics.identification.doctor.residuals import _spectrum
from tudor_dynamics.typing import FloatArray

Change = Callable[[FloatArray, FloatArray], FloatArray]


def found(recording: Recording) -> dict[str, Finding]:
    """Give what is found, by kind."""
    return {item.kind: item for item in examine(described(), recording).findings}


def of(field: str, change: Change, i: int = 0) -> Recording:
    """Change a column of a healthy recording, by time and values."""
    one = healthy(seconds=40.0)
    return replace(one, **{field: column(getattr(one, field), i, lambda x: change(one.t, x))})


def held(t: FloatArray, x: FloatArray) -> FloatArray:
    """Keep a value for a second."""
    inside = (t > 20.0) & (t < 21.0)
    return np.where(inside, x[np.argmax(inside)], x)


@pytest.mark.parametrize(('change', 'kind', 'size'), [
    (lambda t, x: x + 0.05 * (t > 20.0), 'position_jump', 0.05),
    (lambda t, x: np.where(t > 20.0, x - 2.0 * math.pi, x), 'positions_wrapped', -2.0 * math.pi),
    (held, 'position_held', 1.0),
    (lambda t, x: x[np.arange(len(x)) // 10 * 10], 'stale', 0.9),
    (lambda t, x: x + np.random.default_rng(0).normal(0.0, 0.01, len(x)), 'noisy_positions', 0.01),
    (lambda t, x: np.round(x / 0.01) * 0.01, 'coarse_positions', 0.01),
], ids=lambda item: item if isinstance(item, str) else '')
def test_positions(change: Change, kind: str, size: float) -> None:
    """What an encoder does and no joint: with its size, and the joint."""
    item = found(of('q', change))[kind]
    assert item.channels == ('j1',)
    assert item.size == pytest.approx(size, rel=0.1, abs=0.01)
    assert (' rad' in item.what) is (kind not in ('positions_wrapped', 'stale'))


@pytest.mark.parametrize(('change', 'kind'), [
    (lambda t, x: x * (np.arange(len(x)) % 2), 'alternating'),
    (lambda t, x: np.random.default_rng(1).normal(5.0, 0.3, len(x)), 'constant'),
    (lambda t, x: np.round(x / (0.1 * np.ptp(x))) * 0.1 * np.ptp(x), 'coarse_channel'),
    (lambda t, x: np.abs(x - np.median(x)), 'rectified'),
    (lambda t, x: np.where(t > 20.0, 0.4, 1.0) * x, 'gain_step'),
    (lambda t, x: x + 0.3 * np.ptp(x) * (t > 20.0), 'offset_step'),
    (lambda t, x: x + 0.2 * np.ptp(x) * np.sin(2.0 * np.pi * 7.3 * t), 'hum'),
    (lambda t, x: x + 0.2 * np.ptp(x) * np.sin(2.0 * np.pi * 1.3 * t), 'hum'),
    (lambda t, x: np.random.default_rng(2).permutation(np.repeat(x[::50], 50).reshape(-1, 50))
     .ravel()[:len(x)], 'unexplained')], ids=lambda item: item if isinstance(item, str) else '')
@pytest.mark.parametrize('field', ['effort', 'strain'])
def test_channels(field: str, change: Change, kind: str) -> None:
    """What an amplifier or a driver does and no arm."""
    assert kind in found(of(field, change))


def test_a_spectrum_is_the_sum_over_waves_also_after_a_gap() -> None:
    """Each share is that of the plain sum; the table does not grow with the square of the time."""
    t = np.concatenate([np.arange(400) * 0.05, 31.013 + np.arange(300) * 0.05])
    values = np.column_stack([np.sin(2.0 * np.pi * 1.7 * t + 0.3), np.cos(2.0 * np.pi * 4.1 * t)])
    frequency, shares = _spectrum(t, values)
    assert len(frequency) < 100 * len(t)
    free = values - values.mean(axis=0)
    inside = np.flatnonzero(frequency < 9.0)  # below half of the samples a second
    peaks = np.argmax(shares[inside], axis=0)
    assert frequency[peaks] == pytest.approx([1.7, 4.1], abs=0.005)
    for k in [*peaks, 77, 1234]:
        waves = np.exp(-2j * np.pi * frequency[k] * t)
        plain = 2.0 * np.abs(waves @ free / len(t)) ** 2 / np.mean(free ** 2, axis=0)
        assert shares[k] == pytest.approx(plain, abs=0.02)


@pytest.mark.parametrize('seconds', [12.0, 40.0])
def test_what_rings_after_each_move_is_no_hum(seconds: float) -> None:
    """It dies out and begins again, where a wave of the mains goes on."""
    one, random = healthy(seconds=seconds), np.random.default_rng(0)
    since = one.t - np.cumsum(random.uniform(2.0, 5.0, 20))[:, None]
    ringing = np.where(since > 0.0, np.exp(-0.35 * np.maximum(since, 0.0)) * np.sin(
        2.0 * np.pi * 2.8 * since), 0.0).sum(axis=0)
    assert 'hum' not in found(replace(
        one, effort=column(one.effort, 0, lambda x: x + np.std(x) * ringing)))


@pytest.mark.parametrize('gauge', [0, 1])
def test_a_gauge_with_its_sign_turned(gauge: int) -> None:
    """The effort of its joint says which sign a load has; without it nothing does."""
    one = healthy()
    turned = replace(one, strain=column(one.strain, gauge, lambda x: -x))
    assert found(turned)['gauge_sign'].channels == (('g1', 'g2')[gauge],)
    assert 'gauge_sign' not in found(replace(turned, effort=None))
    assert 'gauge_sign' not in found(one)


def test_strain_that_no_link_survives() -> None:
    """A gauge in thousandths of its unit; the other one is left alone."""
    one = healthy()
    item = found(replace(one, strain=column(one.strain, 1, lambda x: 1e3 * x)))['strain_unit']
    assert item.channels == ('g2',) and item.size == 1e3


@pytest.mark.parametrize('far', [0.3, 30.0])
@pytest.mark.parametrize('seed', [1, 3])
def test_a_load_of_one_sign_has_not_lost_it(seed: int, far: float) -> None:
    """Efforts that gravity keeps from zero, of an arm whose tool rings."""
    one = healthy(seed=seed, seconds=15.0)
    assert one.effort is not None
    size = one.effort.std(axis=0)
    rung = one.effort + 0.3 * np.outer(np.sin(2.0 * np.pi * 2.8 * one.t), size)
    assert 'rectified' not in found(replace(
        one, effort=rung - rung.min(axis=0) + far * size, strain=None))


def test_a_channel_that_copies_another() -> None:
    """Both are named: which of them is right cannot be known."""
    one = healthy()
    assert one.strain is not None
    copied = replace(one, strain=np.column_stack([one.strain[:, 0]] * 2))
    assert found(copied)['copied_channel'].channels == ('g1', 'g2')


def test_samples_that_were_filled() -> None:
    """Lines in all channels at once are no motion; where a gap is left, nothing is said."""
    one = healthy(seconds=40.0)
    kept = (one.t + 4.0) % 8.0 > 0.4

    def lines(values: FloatArray | None) -> FloatArray:
        assert values is not None
        return np.column_stack([np.interp(one.t, one.t[kept], x[kept]) for x in values.T])
    filled = replace(one, q=lines(one.q), effort=lines(one.effort), strain=lines(one.strain))
    assert found(filled)['filled'].size == pytest.approx(2.0, abs=0.2)
    assert 'filled' not in found(replace(filled, strain=one.strain))
    assert 'filled' not in found(one)


def test_loads_that_change() -> None:
    """Efforts of several joints that change at one time are no fault of each."""
    one, two = healthy(seconds=40.0), healthy(seconds=40.0, payload=2.0)
    assert one.effort is not None and two.effort is not None
    late = one.t > 20.0
    mixed = replace(one, effort=np.where(late[:, None], two.effort, one.effort), strain=None)
    kinds = set(found(mixed))
    assert kinds & {'payload_changed', 'gain_step'} and not kinds & {'joint_sign', 'gravity_axis'}


@pytest.mark.parametrize('factor', [0.5, 1.25, 2.0])
def test_a_joint_in_another_scale(factor: float) -> None:
    """Counts of single edges, or the ratio of another gear."""
    item = found(of('q', lambda t, x: factor * x, 1))['joint_scale']
    assert item.channels == ('j2',) and item.size == pytest.approx(1.0 / factor, rel=0.1)
