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

"""Recordings made of arrays, and as tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.errors import ArgumentError, BagError, SignalError
from tudor_dynamics.identification.dataset import cut, parse_choice

T = np.delete(np.arange(200) * 0.01, slice(80, 110))
Q = np.stack([np.sin(T), 0.5 * T], axis=1)


def test_arrays_are_split_where_samples_are_missing() -> None:
    """As a bag is; a sample time is the median."""
    recording = Recording.from_arrays(T, q=Q, effort=2.0 * Q)
    assert recording.segments == (slice(0, 80), slice(80, 170))
    assert recording.dt == pytest.approx(0.01) and recording.dq is recording.strain is None
    assert np.allclose(recording.t, T) and list(recording.signals) == ['q', 'effort']


@pytest.mark.parametrize(('t', 'q', 'error', 'said'), [
    ([0.0, 0.0, 0.1], np.zeros((3, 2)), BagError, 'times that increase'),
    ([0.0], np.zeros((1, 2)), BagError, 'times that increase'),
    ([0.0, 0.1], np.zeros((3, 2)), SignalError, 'q has the shape'),
    ([0.0, 0.1], [[0.0], [np.nan]], SignalError, 'q has NaN'),
    ([0.0, np.inf], np.zeros((2, 2)), SignalError, 't has NaN or infinite')])
def test_arrays_that_are_refused(
    t: list[float], q: np.ndarray, error: type[Exception], said: str,
) -> None:
    """Each with what is wrong."""
    with pytest.raises(error, match=said):
        Recording.from_arrays(t, q=q)


@pytest.mark.parametrize(('names', 'said'), [
    ((), 'found no signal'), (('dq',), 'expected q'), (('q', 'tau'), 'found q, tau')])
def test_names_that_no_signal_has(names: tuple[str, ...], said: str) -> None:
    """Positions have to be there; other names are refused."""
    with pytest.raises(BagError, match=said):
        Recording.from_arrays(T, **dict.fromkeys(names, Q))


def test_a_bag_of_arrays(root: Path, tmp_path: Path) -> None:
    """What is written of arrays is read again."""
    arm = load_arm(root / 'config/two_blade_arm.yaml')
    t = np.arange(300) * 0.01
    q = np.stack([np.sin(t), np.cos(t)], axis=1)
    recording = Recording.from_arrays(t + 5.0, q=q, effort=0.1 * q, strain=100.0 * q)
    write_bag(tmp_path / 'bag', recording, arm=arm)
    again = read_recording(tmp_path / 'bag', arm)
    for name, values in recording.signals.items():
        assert np.array_equal(getattr(again, name), values), name
    assert np.array_equal(again.stamp, recording.stamp)
    with pytest.raises(ArgumentError, match='knows no topics'):
        write_bag(tmp_path / 'other', recording)


def test_tables(root: Path) -> None:
    """Columns have the names of joints and gauges; a gap stays one."""
    arm = load_arm(root / 'config/two_blade_arm.yaml')
    recording = Recording.from_arrays(T, q=Q, strain=100.0 * Q)
    table, cube = recording.to_dataframe(arm), recording.to_xarray(arm)
    assert list(table) == [('q', 'joint2'), ('q', 'joint3'), ('strain', 'link2_hub'),
                           ('strain', 'link3_hub')]
    assert np.array_equal(table['q', 'joint3'], Q[:, 1]) and np.allclose(table.index, T - T[0])
    assert np.array_equal(cube['strain'].sel(gauge='link2_hub'), 100.0 * Q[:, 0])
    assert set(cube.data_vars) == {'q', 'strain'} and np.array_equal(cube['time'], recording.t)


def test_forces_that_were_applied(root: Path, tmp_path: Path) -> None:
    """A recording has them where its bag does, in parts and tables too."""
    arm = load_arm(root / 'config/two_blade_arm.yaml')
    recording = read_recording(root / 'bags/two_blade_pushes', arm)
    assert recording.push is not None and recording.push.shape == recording.stamp.shape
    begins = recording.t[1:][np.diff((recording.push > 0.01).astype(int)) > 0]
    assert len(begins) == 4
    assert np.array_equal(recording.to_dataframe(arm)['push', 'push'], recording.push)
    part = cut(recording, parse_choice('x@50-100%'))
    assert np.array_equal(part.push, recording.push[-len(part.stamp):])
    assert read_recording(root / 'bags/two_blade_test', arm).push is None
