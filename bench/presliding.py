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

"""
What presliding would bring: friction as a spring that gives way, beside what a fit can choose.

Before a joint breaks away, friction follows its displacement: a spring that slides along at its
limit (Prandtl's element, the play operator of hysteresis). Its column needs the motion before a
sample, so it makes a model with a memory. Here it is added to the rows of recordings that
docs/validation.md names; what is not there is left out.

    python bench/presliding.py --data DATA
"""

from __future__ import annotations

import numpy as np
from reference_fits import CONFIG, data_directory

from tudor_dynamics import load_arm
from tudor_dynamics.arm import PreprocessingSpec
from tudor_dynamics.identification.bag_choice import parse_choice
from tudor_dynamics.identification.dataset import load
from tudor_dynamics.models.base_parameters import base_sets
from tudor_dynamics.models.regressor import EffortRegressor

SPEC = PreprocessingSpec(filter='zero_phase')
DISTANCES = (1e-3, 3e-3, 1e-2)
"""After which the spring gives way [rad or m]."""
FRICTION = {'friction': ('viscous', 'coulomb', 'offset'), 'asymmetric': False}
RECORDINGS = (
    ('UR10e, known gains', 'arms/ur10e_gains.yaml', 'ur10e_unloaded@0-60%',
     'ur10e_unloaded@60-100%'),
    ('Airbot Play', 'arms/airbot.yaml', 'airbot_chirp', 'airbot_trapezoidal'),
    ('UR10', CONFIG / 'ur10.yaml', 'ur10_exciting@0-60%', 'ur10_exciting@60-100%'))


def spring(q, distance):
    """Follow the springs of all joints, from -1 to 1."""
    z = np.zeros_like(q)
    for k in range(1, len(q)):
        z[k] = np.clip(z[k - 1] + (q[k] - q[k - 1]) / distance, -1.0, 1.0)
    return z


def matrices(arm, bag, distance):
    """Rows of base parameters, and of a spring for each joint where there is one."""
    regressor = EffortRegressor(arm)
    n = len(arm.active_joints)
    kept = base_sets(regressor, n)[0].kept
    rows, outputs = [], []
    for stretch in bag.stretches:
        wide = regressor.rows(stretch.motion)[:, :, kept]
        if distance is not None:
            own = spring(stretch.states.q, distance)
            wide = np.concatenate([wide, own[:, :, None] * np.eye(n)], axis=2)
        rows.append(stretch.decimation(wide))
        outputs.append(stretch.decimation(stretch.effort))
    return np.concatenate(rows), np.concatenate(outputs)


def estimate(rows, output):
    """Least squares, weighted by the residual variance of each channel."""
    weights = np.ones(output.shape[1])
    for _ in range(4):
        root = np.sqrt(weights)
        stacked = np.concatenate([rows[:, i] * w for i, w in enumerate(root)])
        values = np.concatenate([output[:, i] * w for i, w in enumerate(root)])
        size = np.maximum(np.linalg.norm(stacked, axis=0), 1e-300)
        parameters = np.linalg.lstsq(stacked / size, values, rcond=1e-7)[0] / size
        weights = 1.0 / np.mean((output - rows @ parameters) ** 2, axis=0)
    return parameters


def main():
    """Go through the recordings that are there."""
    data = data_directory(__doc__.splitlines()[1])
    for name, description, *parts in RECORDINGS:
        path = data / description
        if not path.exists() or not (data / 'bags' / parts[0].partition('@')[0]).exists():
            print(f'{name}: not there, left out')
            continue
        arm = load_arm(path)
        arm = arm.with_joints({joint: FRICTION for joint in arm.active_joints})
        bags = [load(parse_choice(str(data / 'bags' / part)), arm, SPEC) for part in parts]
        for distance in (None, *DISTANCES):
            training, test = (matrices(arm, bag, distance) for bag in bags)
            parameters = estimate(*training)
            error = np.linalg.norm(test[1] - test[0] @ parameters) / np.linalg.norm(test[1])
            what = 'without' if distance is None else f'gives way at {distance:g}'
            print(f'{name:20} {what:20} relative error {100 * error:5.2f} %')


if __name__ == '__main__':
    main()
