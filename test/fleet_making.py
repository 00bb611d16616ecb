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

"""A fleet of planar arms whose friction is known: bags of short motions, and their plan."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.writer import recording_series, write_bag
from tudor_dynamics.models.regressor import EffortRegressor, StrainRegressor
import yaml

START, SECONDS, RATE = 1_700_000_000_000_000_000, 24.0, 100.0
DATES = ('2026-01-10', '2026-03-10', '2026-05-12', '2026-07-09')
DESCRIPTION = {
    'name': 'cell', 'kinematics': {'dh': [[0.4, 0.0, 0.0, 0.0], [0.3, 0.0, 0.0, 0.0]]},
    'joints': [{'name': name, 'effort': {'topic': 'motor_currents', 'unit': 'A'},
                'friction': ['viscous', 'coulomb']} for name in ('shoulder', 'elbow')],
    'gauges': [{'name': 'upper', 'joint': 'shoulder', 'distance': 0.05},
               {'name': 'lower', 'joint': 'elbow', 'distance': 0.05}],
    'gravity': [0.0, -9.81, 0.0], 'preprocessing': {'filter': 'causal'}}
RING = 3.0
"""Frequency of the links, while the joints stand still [Hz]."""


def write_fleet(
    folder: Path, arms: int, friction: Callable[[int, int], float], dates: int = len(DATES),
) -> Path:
    """
    Write the bags of a fleet and its plan.

    Each arm has its own masses and frictions, which differ by 2 %. ``friction`` gives the factor
    on the friction of an arm's elbow at a date.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / 'cell.yaml').write_text(yaml.safe_dump(DESCRIPTION))
    arm = load_arm(folder / 'cell.yaml')
    plan = {'name': 'line 3', 'arm': 'cell.yaml', 'arms': []}
    for number in range(arms):
        own = np.random.default_rng([7, number])
        bodies = [pin.Inertia(mass, np.array([0.2, 0.0, 0.0]), np.diag([0.01] * 3)) for mass in
                  (2.0 * own.normal(1.0, 0.02), 1.0 * own.normal(1.0, 0.02))]
        drives = np.array([0.02, 0.6, 0.8, 0.01, 0.3, 0.4]) * own.normal(1.0, 0.02, 6)
        entry = {'name': f'cell_{number + 1}', 'bags': {}}
        for date in range(dates):
            name = f'cell_{number + 1}/{DATES[date]}'
            factors = np.array([1.0, 1.0, 1.0, 1.0, *[friction(number, date)] * 2])
            _write(folder / name / 'run', arm, bodies, drives * factors, [number, date])
            entry['bags'][DATES[date]] = name
        plan['arms'].append(entry)
    (folder / 'plan.yaml').write_text(yaml.safe_dump(plan))
    return folder / 'plan.yaml'


def _write(path: Path, arm: Arm, bodies: list, drives: np.ndarray, seed: list[int]) -> None:
    generator = np.random.default_rng(seed)
    t = np.arange(0.0, SECONDS, 1.0 / RATE)
    clock, still = t.copy(), np.zeros(len(t), dtype=bool)
    for begin in (6.0, 12.0, 18.0):  # the motion waits there for two seconds
        inside = (t >= begin) & (t < begin + 2.0)
        still |= inside
        clock -= np.clip(t - begin, 0.0, 2.0)
    q, dq, ddq = (np.zeros((len(t), 2)) for _ in range(3))
    for _ in range(4):
        size, rate = generator.uniform(0.1, 0.4, 2), generator.uniform(0.5, 2.5, 2)
        phase = generator.uniform(0.0, 6.3, 2)
        wave = rate * clock[:, None] + phase
        q += size * np.sin(wave)
        dq += size * rate * np.cos(wave)
        ddq -= size * rate**2 * np.sin(wave)
    dq[still] = ddq[still] = 0.0
    motion = np.hstack([q, dq, ddq])
    parameters = np.concatenate([body.toDynamicParameters() for body in bodies])
    effort = EffortRegressor(arm).rows(motion) @ np.concatenate([parameters, drives])
    strain = StrainRegressor(arm, 'paper').rows(motion)[:, :, :-1] @ parameters * [100.0, 80.0]
    for begin in (6.0, 12.0, 18.0):
        since = np.clip(t - begin, 0.0, None)
        ring = np.where(still & (since < 2.0), np.exp(-0.03 * 2 * np.pi * RING * since), 0.0)
        strain += (40.0 * ring * np.sin(2 * np.pi * RING * since))[:, None]
    effort += generator.normal(size=effort.shape) * 0.05 * effort.std(axis=0)
    strain += generator.normal(size=strain.shape) * 0.02 * strain.std(axis=0)
    stamp = START + np.round(t * 1e9).astype(np.int64)
    recording = Recording('', stamp, q, dq, effort, strain, (slice(0, len(t)),), 1.0 / RATE)
    write_bag(path, recording_series(recording, arm))
