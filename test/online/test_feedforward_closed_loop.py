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

"""Feed-forward in the simulated closed loop: joints and tip, on another motion than was fitted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.control.cascade import INTEGRAL, INTEGRAL_GAIN
from tudor_dynamics.mechanics.campaign import stimulus_motion
from tudor_dynamics.mechanics.closed_loop import ClosedLoop
from tudor_dynamics.mechanics.hardware import with_payload
from tudor_dynamics.mechanics.run import Probe
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.regressor import EffortRegressor
from tudor_dynamics.online.feedforward import Feedforward
from tudor_dynamics.signals.motion_profile import denser

EVERY = 20
"""Steps of the loop between two points of a trajectory, 10 ms."""


@pytest.fixture(scope='module')
def arm(root: Path) -> Arm:
    """Give the reference arm with 200 g."""
    return with_payload(load_arm(root / 'config/tudor.yaml'), 0.2)


@pytest.fixture(scope='module')
def loop(arm: Arm) -> ClosedLoop:
    """Give the arm under a position loop on efforts: p and d, no integrator."""
    made = ClosedLoop(arm, damping=0.0, seed=1)
    made.cascade.rows[:, INTEGRAL_GAIN] = 0.0
    return made


def wanted(arm: Arm, seed: int, dt: float) -> Trajectory:
    """Plan ten seconds of steps."""
    motion = stimulus_motion(arm, 10.0, seed, dt)
    q, dq, ddq = (part[::EVERY] for part in (motion.q, motion.dq, motion.ddq))
    return Trajectory(arm.active_joints, np.arange(len(q)) * EVERY * dt, q, dq, ddq)


def follow(loop: ClosedLoop, path: Trajectory) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Follow a trajectory: measured positions, currents, and places of the tip."""
    between = denser(path, 1.0 / loop.dt)
    ahead = np.zeros_like(between.q) if path.effort is None else np.column_stack([
        np.interp(between.t, path.t, column) for column in path.effort.T])
    loop.reset(between.q[0], ahead[0])
    loop.cascade.state[:, INTEGRAL] = 0.0
    probe, rows = Probe(loop.plant, []), []
    for k in range(0, len(between.q) - EVERY, EVERY):
        tip = probe.observe().position[loop.plant.mechanism.tip].copy()
        part = slice(k, k + EVERY)
        done = loop.run(between.q[part], between.dq[part], every=EVERY, ahead=ahead[part])
        rows.append((done.q[0], done.current[0], tip))
    q, current, tips = (np.array(column) for column in zip(*rows, strict=True))
    return q, current, tips


@pytest.fixture(scope='module')
def bundle(arm: Arm, loop: ClosedLoop) -> ModelBundle:
    """Fit a model to what the arm did along one motion; its elastic part is as described."""
    path = wanted(arm, 1, loop.dt)
    _, current, _ = follow(loop, path)
    assert path.dq is not None and path.ddq is not None
    motion = np.hstack([path.q, path.dq, path.ddq])[:len(current)]
    model = AnalyticalModel(EffortRegressor(arm), 2).fit(motion, current)
    return ModelBundle(arm, PreprocessingSpec(), {'effort': {'analytical': model}},
                       {'training': [{'bag': 'run', 'payload': 0.2}]})


def test_joints_and_tip_follow(arm: Arm, loop: ClosedLoop, bundle: ModelBundle) -> None:
    """Efforts take two thirds off the joints' errors; led motors four fifths off the tip's."""
    path = wanted(arm, 2, loop.dt)
    paths = [path, *(Feedforward(bundle, positions=positions).along(path)
                     for positions in ('wanted', 'motor'))]
    angle = path.q.cumsum(axis=1)
    runs = [follow(loop, one) for one in paths]
    joints = [np.sqrt(np.mean((q - one.q[:len(q)]) ** 2))
              for one, (q, _, _) in zip(paths, runs, strict=True)]
    assert joints[1] < joints[0] / 3.0
    # two links of 0.393 m on a column of 0.3 m
    rigid = np.column_stack([0.393 * np.cos(angle).sum(axis=1), np.zeros(len(angle)),
                             0.3 + 0.393 * np.sin(angle).sum(axis=1)])
    tip = [np.sqrt(np.mean(np.sum((place - rigid[:len(place)]) ** 2, axis=1)))
           for _, _, place in runs]
    assert tip[2] < tip[0] / 5.0 and tip[1] > tip[0] / 2.0
