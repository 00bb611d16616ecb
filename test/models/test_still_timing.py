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

"""Another timing of a path leaves a flexible tool still, as a simulation of its own shows."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from tool_making import ARM, curved, FREQUENCIES, KNOWN, ring_after

from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import SignalError
from tudor_dynamics.models import still_timing as module
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.flexible_tool import FlexibleTool
from tudor_dynamics.models.settings import TIMING_WINDOW
from tudor_dynamics.models.still_timing import shaped_for, still_timing
from tudor_dynamics.signals.motion_profile import spline


def bundle(tool: FlexibleTool) -> ModelBundle:
    """Put a tool into a bundle."""
    return ModelBundle(ARM, PreprocessingSpec(), {}, tool=tool)


class Coupled:
    """Efforts of joints that accelerate each other, rub, and have weight."""

    def predict(self, motion: np.ndarray) -> np.ndarray:
        """Predict them of positions, velocities and accelerations."""
        q, dq, ddq = np.split(motion, 3, axis=1)
        inertia = 0.4 * np.eye(5) + 0.6
        return ddq @ inertia + 2.0 * np.tanh(dq / 0.01) + 0.3 * dq + 4.0 * np.cos(q)

    def most(self, trajectory: Trajectory) -> np.ndarray:
        """Give the largest ones along a trajectory."""
        curve = spline(trajectory)
        t = np.linspace(trajectory.t[0], trajectory.t[-1], 2000)
        return np.abs(self.predict(np.hstack(
            [np.asarray(curve(t, order)) for order in range(3)]))).max(axis=0)


@pytest.mark.parametrize('seed', range(6))
def test_the_tool_is_still(seed: int) -> None:
    """By simulation less than a tenth of the ring is left, at most 0.6 periods later."""
    wanted = curved(seed)
    found = still_timing(ARM, KNOWN, wanted)
    assert ring_after(found) < 0.1 * ring_after(wanted)
    assert found.t[-1] - wanted.t[-1] < 0.62 / FREQUENCIES[0] + 0.01


@pytest.mark.parametrize('factor', [0.95, 1.05])
def test_frequencies_that_are_off(factor: float) -> None:
    """Of a tool that is 5 % slower or faster than was thought, less than 30 % is left."""
    for seed in range(4):
        wanted = curved(seed)
        found = still_timing(ARM, KNOWN, wanted)
        assert ring_after(found, factor) < 0.3 * ring_after(wanted, factor)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), seconds=st.floats(0.5, 3.0), points=st.integers(8, 60))
def test_limits_and_path(seed: int, seconds: float, points: int) -> None:
    """Joints keep within the speeds and accelerations given, and pass the same path."""
    wanted = curved(seed, seconds, points)
    try:
        found = still_timing(ARM, KNOWN, wanted)
    except SignalError as err:
        assert 'of the ring remain' in str(err) or 'bends the tool further' in str(err)
        return
    given, made = spline(wanted), spline(found)
    dense = np.linspace(0.0, seconds, 4000)
    t = np.linspace(0.0, float(found.t[-1]), 4000)
    for order in (1, 2):
        most = np.abs(np.asarray(given(dense, order))).max(axis=0)
        assert (np.abs(np.asarray(made(t, order))).max(axis=0) <= 1.01 * most + 1e-6).all()
    off = np.linalg.norm(np.asarray(made(t))[::40, None] - np.asarray(given(dense))[None], axis=2)
    assert off.min(axis=1).max() < 2e-3
    assert np.array_equal(found.q[[0, -1]], wanted.q[[0, -1]]) and not found.dq[[0, -1]].any()


def test_efforts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Joints need no more than their limit, or than they do as given, by the model of efforts."""
    monkeypatch.setattr(module, 'effort_limits', lambda _: np.array([5.0] * 4 + [np.inf]))
    beyond, model = [], Coupled()
    for seed in range(6):
        wanted = curved(seed)
        most = np.maximum(model.most(wanted), 5.0)
        free, found = (still_timing(ARM, KNOWN, wanted, effort) for effort in (None, model))
        assert (model.most(found) <= 1.02 * most)[:4].all()
        beyond.append(float((model.most(free) / most)[:4].max()))
        assert ring_after(found) < 0.2 * ring_after(wanted)
    assert max(beyond) > 1.05


def test_only_the_end_of_a_long_motion_changes() -> None:
    """What lasts longer than the window passes its begin as given, and is as still at its end."""
    wanted = curved(3, 9.0, 60)
    found = still_timing(ARM, KNOWN, wanted)
    t = np.linspace(0.0, 9.0 - TIMING_WINDOW, 500)
    assert np.allclose(np.asarray(spline(found)(t)), np.asarray(spline(wanted)(t)), atol=1e-6)
    assert ring_after(found) < 0.1 * ring_after(wanted)
    made = spline(found)
    t = np.linspace(found.t[0], found.t[-1], 4000)
    slopes = np.gradient(np.asarray(made(t)), t, axis=0)
    assert np.abs(slopes - np.asarray(made(t, 1))).max() < 0.01


def test_other_joints_and_impulses() -> None:
    """A gripper moves along; impulses have the frequency of the tool at the end."""
    wanted = curved(1)
    both = Trajectory((*wanted.joints, 'gripper'), wanted.t, *(
        np.column_stack([values, 0.1 * values[:, 0]])
        for values in (wanted.q, wanted.dq, wanted.ddq)))
    found = still_timing(ARM, KNOWN, both)
    assert found.joints == both.joints
    assert np.allclose(found.q[:, 5] - found.q[0, 5], 0.1 * (found.q[:, 0] - found.q[0, 0]))
    shaped = shaped_for(bundle(KNOWN), wanted, 'zv')
    frequencies = [one.value for one in KNOWN.frequency_at(ARM, wanted.q[-1])]
    assert shaped.t[-1] - wanted.t[-1] == pytest.approx(
        sum(0.5 / frequency for frequency in frequencies), rel=1e-3)
    alike = KNOWN.model_copy(update={'frequencies': [3.0, 3.05]})
    longer = shaped_for(bundle(alike), wanted, 'zv').t[-1] - wanted.t[-1]
    assert longer == pytest.approx(0.5 / 3.0, rel=0.05)


def test_what_cannot_be_shaped() -> None:
    """Positions alone, motion at an end, and a joint that is missing are refused."""
    wanted = curved(1)
    with pytest.raises(SignalError, match='no velocities; give them, or shape it by zv'):
        still_timing(ARM, KNOWN, replace(wanted, dq=None, ddq=None))
    with pytest.raises(SignalError, match='begin and end at rest'):
        still_timing(ARM, KNOWN, replace(wanted, dq=wanted.dq + 0.1))
    with pytest.raises(SignalError, match='is missing'):
        still_timing(ARM, KNOWN, replace(wanted, joints=('a', *wanted.joints[1:])))
