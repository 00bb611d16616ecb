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
Bodies of a simulated seven-joint arm whose truth is known, found from noisy recordings.

The arm is described by a URDF whose masses are 30 % and centres 3 cm off (standard deviations); it
has rotors and friction, moves by Fourier series of six harmonics, and its efforts carry white
noise. Shown is how many standard errors masses are off, and all parameters that the recordings
fix; and the error on other motion of free base parameters and of bodies that can exist.

    python bench/known_bodies.py [--seeds 3]
"""

from __future__ import annotations

import argparse
from pathlib import Path
import tempfile

from identify_seven_joints import described_arm, ROWS
import numpy as np
import pinocchio as pin
from reference_fits import fit
from tables import show
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.messages import joint_signals
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.identification.dataset import load, parse_choice
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import load_bundle
from tudor_dynamics.models.comparison import (
    described_parameters_of, effort_model, full_parameters, relative_errors)
from tudor_dynamics.models.regressor import EffortRegressor
from tudor_dynamics.show.description import urdf_of
import yaml

N, RATE, NOISE = len(ROWS), 100.0, 0.2
VISCOUS = np.array([4.0, 4.0, 3.0, 3.0, 1.0, 1.0, 0.5])
COULOMB = np.array([3.0, 3.0, 2.0, 2.0, 1.0, 1.0, 0.5])
ROTOR = np.array([0.8, 0.8, 0.5, 0.5, 0.1, 0.1, 0.05])
"""Of the drives [N m s/rad, N m, kg m^2]."""
NAMES = [f'joint{i + 1}' for i in range(N)]


def motion_of(seconds, seed):
    """Give positions, velocities and accelerations of a Fourier series."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1.0 / RATE)[:, None]
    parts = np.zeros((3, len(t), N))
    for k in range(1, 7):
        w, phase = 2.0 * np.pi * 0.1 * k, random.uniform(0.0, 2.0 * np.pi, N)
        size = random.uniform(0.1, 0.5, N) / np.sqrt(k)
        parts += np.array([size * np.sin(w * t + phase), size * w * np.cos(w * t + phase),
                           -size * w**2 * np.sin(w * t + phase)])
    return parts


def described(folder):
    """Write a URDF with bodies, rods from joint to joint, and a description around it."""
    arm = described_arm()
    model = AnalyticalModel(EffortRegressor(arm), N)
    q, dq, ddq = motion_of(10.0, 0)
    model.fit(np.hstack([q, dq, ddq]), np.random.default_rng(0).standard_normal(q.shape))
    (folder / 'arm.urdf').write_text(urdf_of(described_parameters_of(arm, model)))
    (folder / 'arm.yaml').write_text(yaml.safe_dump({
        'name': 'seven', 'kinematics': {'urdf': 'arm.urdf'},
        'joints': [{'name': name, 'friction': ['viscous', 'coulomb']} for name in NAMES]}))
    return load_arm(folder / 'arm.yaml')


def true_model(arm, seed):
    """Give the bodies as they are."""
    random, model = np.random.default_rng(seed), arm.model.copy()
    for i in range(1, model.njoints):
        old, factor = model.inertias[i], float(np.exp(random.normal(0.0, 0.3)))
        model.inertias[i] = pin.Inertia(factor * old.mass, old.lever + random.normal(0.0, 0.03, 3),
                                        factor * old.inertia)
    return model


def record(folder, arm, model, name, seconds, seed):
    """Write a bag of what the true arm shows."""
    q, dq, ddq = motion_of(seconds, seed)
    data = model.createData()
    sharp = np.array([joint.friction_velocity for joint in arm.joints])
    effort = np.array([pin.rnea(model, data, *state) for state in zip(q, dq, ddq, strict=True)])
    effort += ROTOR * ddq + VISCOUS * dq + COULOMB * np.tanh(dq / sharp)
    effort += NOISE * np.random.default_rng(seed).standard_normal(effort.shape)
    stamps = (1e9 + np.arange(len(q)) * 1e9 / RATE).astype(np.int64)
    write_bag(folder / name, [joint_signals(
        topic='/joint_states', stamp=stamps, names=NAMES, position=q, velocity=dq,
        effort=effort)])
    return folder / name


def main():
    """Go through the seeds."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--seeds', type=int, default=3)
    rows = []
    for seed in range(parser.parse_args().seeds):
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            arm = described(folder)
            truth = true_model(arm, seed)
            training = record(folder, arm, truth, 'training', 60.0, 10 * seed + 1)
            test = record(folder, arm, truth, 'test', 30.0, 10 * seed + 2)
            fit(folder / 'model', folder / 'arm.yaml', [training], [test], '--models',
                'analytical', '--filter', 'zero_phase')
            bundle = load_bundle(folder / 'model', with_data=True)
            full = full_parameters(bundle)
            true = np.array([np.asarray(inertia.toDynamicParameters())
                             for inertia in list(truth.inertias)[1:]])
            off = np.abs(full.solution.bodies - true) / full.solution.body_errors
            fixed = np.array(full.sources())[:10 * N].reshape(N, 10) == 'data'
            unseen = load(parse_choice(str(test)), bundle.arm, bundle.preprocessing,
                          learn=True).stretches
            rows.append((seed, f'{off[:, 0].max():.1f}', f'{fixed.sum()} of {fixed.size}',
                         f'{off[fixed].max():.1f}', *(
                             f'{100 * np.max(relative_errors(model, unseen)):.2f} %'
                             for model in (effort_model(bundle), full.model))))
    show(('arm', 'masses off by, standard errors', 'parameters that the recording fixes',
          'these off by', 'largest error of a joint, free', 'that can exist'), rows)


if __name__ == '__main__':
    main()
