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
Compare free base parameters with bodies and drives that can exist, on unseen motion.

Each recording of bench/first_hour.py is fitted as there, the others of DATA by their first 60 % or
by another bag, the sample bags by what they come with; full parameters are found from what the
bundle keeps, and all are judged on the test bags: base parameters, bodies that can exist, and the
bodies as described with the drives that suit them best. Where clarabel is installed (``pip install
clarabel``), the same question is put to it as a semidefinite program: least squares under matrix
inequalities, with the distance from the description as a square instead of one of logarithms.

    python bench/consistent.py --data DATA
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
import tempfile
import time

from first_hour import KNOWN, undescribed, UNSEEN
import numpy as np
from reference_fits import CONFIG, data_directory, fit
from tables import show
from tudor_dynamics.identification.dataset import load, parse_choice
from tudor_dynamics.models.bundle import load_bundle
from tudor_dynamics.models.comparison import described_parameters_of, full_parameters
from tudor_dynamics.models.consistent import (
    BodyProblem, full_of, parameters_of, prior_of, pseudo_inertia)

SAMPLES = CONFIG.parent / 'bags'
OTHERS = (
    # name, description, training, test, couplings
    ('UR10e with 2.8 kg', 'ur10e.yaml', ['ur10e_loaded@0-60%'], ['ur10e_loaded@60-100%'], None),
    ('Airbot Play, loaded', 'airbot.yaml', ['airbot_chirp_loaded@0-60%'],
     ['airbot_chirp_loaded@60-100%'], None),
    ('Airbot Play, one motion', 'airbot.yaml', ['airbot_trapezoidal@0-60%'],
     ['airbot_trapezoidal@60-100%'], None),
    ('two blades, 0 g', 'two_blade_arm.yaml', ['arm_000g_free_1@0-60%'],
     ['arm_000g_free_1@60-100%'], None),
    ('same, not damped', 'two_blade_arm.yaml', ['arm_000g_undamped_1@0-60%'],
     ['arm_000g_undamped_1@60-100%'], None),
    ('two blades, sample bags', 'two_blade_arm.yaml', ['two_blade_train_1', 'two_blade_train_2'],
     ['two_blade_test'], None),
    ('reference arm, damped', 'tudor.yaml', ['tudor_damped/stimulus_01@0-60%'],
     ['tudor_damped/stimulus_01@60-100%'], None),
    ('same, not damped', 'tudor.yaml', ['tudor_undamped/stimulus_01@0-60%'],
     ['tudor_undamped/stimulus_01@60-100%'], None))

try:
    import clarabel as clarabel
except ImportError:
    clarabel = None


def relative_error(model, parameters, bags):
    """Relative error of efforts over all joints, each in units of its own size [%]."""
    measured, predicted = [], []
    for bag in bags:
        for stretch in bag.stretches:
            measured.append(stretch.decimation(stretch.effort))
            predicted.append(stretch.decimation(
                model.regressor.outputs(model.inputs(stretch), parameters)))
    y, p = np.vstack(measured), np.vstack(predicted)
    return 100.0 * np.linalg.norm(y - p) / np.linalg.norm(y)


def semidefinite(bundle, model, full):
    """Solve by clarabel at the constants that were found; full parameters and time [s]."""
    from scipy import sparse
    problem = BodyProblem(bundle.arm, model, prior_of(bundle.arm))
    rows = []
    for channel, matrix, target in problem.parts:
        factor = np.where(problem.scaled, 1.0 / full.solution.constants[channel], 1.0)
        rows.append((matrix * factor, target))
    prior = np.array([parameters_of(log) for log in problem.prior.center])
    size = np.maximum(np.abs(prior), np.abs(prior).max(axis=1, keepdims=True) * 0.05).ravel()
    n, bodies = len(model.regressor.columns), prior.size
    scale = np.concatenate([size, problem.sizes])
    data = np.vstack([matrix for matrix, _ in rows]) * scale
    target = np.concatenate([t for _, t in rows])
    weak = np.concatenate([np.ones(bodies), np.full(n - bodies, 1e-3)])
    center = np.concatenate([prior.ravel() / size, np.zeros(n - bodies)])
    quadratic = data.T @ data + np.diag(weak)
    linear = -(data.T @ target + weak * center)
    blocks, limits, cones = [], [], []
    part = np.zeros((len(problem.steps), n))
    part[:, bodies:] = -problem.steps
    blocks.append(part)
    limits.append(np.zeros(len(part)))
    cones.append(clarabel.NonnegativeConeT(len(part)))
    upper = [(i, j) for j in range(4) for i in range(j + 1)]
    for body in range(len(prior)):
        part = np.zeros((10, n))
        for k in range(10):
            unit = pseudo_inertia(np.eye(10)[k] * size[10 * body + k])
            part[:, 10 * body + k] = [-unit[i, j] * (1.0 if i == j else np.sqrt(2.0))
                                      for i, j in upper]
        blocks.append(part)
        limits.append(-1e-8 * np.array([float(i == j) for i, j in upper]))
        cones.append(clarabel.PSDTriangleConeT(4))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    begin = time.process_time()
    found = clarabel.DefaultSolver(
        sparse.csc_matrix(np.triu(quadratic)), linear, sparse.csc_matrix(np.vstack(blocks)),
        np.concatenate(limits), cones, settings).solve()
    taken = time.process_time() - begin
    values = np.asarray(found.x) * scale
    solution = replace(full.solution, bodies=values[:bodies].reshape(-1, 10),
                       drives=values[bodies:])
    return full_of(solution, problem.scaled), solution.bodies, taken


def judge(name, out, bags, test):
    """Print a line for one recording; give the row of the table."""
    bundle = load_bundle(out, with_data=True)
    model = bundle.models['effort']['analytical']
    begin = time.process_time()
    full = full_parameters(bundle)
    taken = time.process_time() - begin
    unseen = [load(parse_choice(str(bags / bag)), bundle.arm, bundle.preprocessing, learn=True)
              for bag in test]
    described = described_parameters_of(bundle.arm, model)
    errors = [relative_error(model, parameters, unseen) for parameters in (
        model.coefficients(), full.model.coefficients(), described.model.coefficients())]
    least = min(np.linalg.eigvalsh(pseudo_inertia(body)).min() for body in full.bodies.values())
    print(f'{name:22} free {errors[0]:6.2f} %  can exist {errors[1]:6.2f} %  described '
          f'{errors[2]:6.2f} %  {taken:5.2f} s  least eigenvalue {least:.1e}', end='')
    row = [name, *(f'{error:.2f} %' for error in errors), f'{taken:.2f} s', '']
    if clarabel is not None:
        values, bodies, taken = semidefinite(bundle, model, full)
        error = relative_error(model, values, unseen)
        least = min(np.linalg.eigvalsh(pseudo_inertia(body)).min() for body in bodies)
        print(f'  | semidefinite {error:6.2f} %  {taken:5.2f} s  {least:.1e}', end='')
        row[-1] = f'{error:.2f} %'
    print(flush=True)
    return row


def folder_of(bag, data):
    """Give where a bag lies: in DATA, or among the sample bags."""
    sample = (SAMPLES / bag.partition('@')[0]).exists()
    return SAMPLES if sample else data / 'bags'


def main():
    """Go through the recordings that are there."""
    data = data_directory(__doc__.splitlines()[1])
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / 'model'
        for name, arm, training, test, *_, couplings in (*UNSEEN, *(
                (*case, None) for case in KNOWN), *OTHERS):
            source = data / 'arms' / arm if (data / 'arms' / arm).exists() else CONFIG / arm
            bags = folder_of(training[0], data)
            if not all((bags / bag.partition('@')[0]).exists() for bag in (*training, *test)):
                print(f'{name}: not there, left out')
                continue
            described = (source if source.parent == CONFIG else
                         undescribed(source, folder, couplings))
            fit(out, described, [bags / bag for bag in training], [bags / bag for bag in test],
                '--models', 'analytical')
            rows.append(judge(name, out, bags, test))
    show(('recording', 'free', 'can exist', 'as described', 'CPU', 'semidefinite'), rows)


if __name__ == '__main__':
    main()
