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
Measure what planned excitation is worth, against random motion and against known truth.

criteria: what the search makes small, compared on one arm. gain: standard errors of random motions
over planned ones, same length and limits, with the most that any motion within these limits could
gain. promises: standard errors expected, over those of fits and over the true errors of parameters
of simulated recordings with white noise; and through the closed loop of the reference arm, where
noise is what an earlier fit left.

    python bench/excitation.py [criteria gain promises]
"""

from __future__ import annotations

import argparse
from contextlib import redirect_stdout
import io
import json
import os
from pathlib import Path
import tempfile
import time

for _name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'):
    os.environ.setdefault(_name, '1')  # before numpy loads

from identify_seven_joints import ROWS  # noqa: E402
import numpy as np  # noqa: E402
from tables import show  # noqa: E402

from tudor_dynamics.arm.description import arm_from_dict, load_arm  # noqa: E402
from tudor_dynamics.cli.main import main as tudor  # noqa: E402
from tudor_dynamics.identification.excitation import (  # noqa: E402
    covariance_of, Information, mean_error, played)
from tudor_dynamics.identification.excitation_plan import (  # noqa: E402
    best_series, bounds_of, default_highest, make_plan, Order, random_series, target_of_arm)
from tudor_dynamics.mechanics.campaign import stimulus_motion  # noqa: E402
from tudor_dynamics.models.analytical import AnalyticalModel  # noqa: E402
from tudor_dynamics.models.regressor import base_sets, random_inputs  # noqa: E402
from tudor_dynamics.signals.preprocessing import prepare  # noqa: E402

CONFIG = Path(__file__).resolve().parents[1] / 'config'
SECONDS, DT, EVERY = 60.0, 0.01, 5
RANDOM, STATES = 4, 40_000
SEVEN = [(2.8, 2.1), (1.7, 2.1), (2.8, 2.1), (1.4, 2.1), (2.8, 2.6), (1.8, 2.6), (2.8, 2.6)]
"""Largest angle and speed of each joint [rad, rad/s]: those of arms of this size."""
UR10 = (2.09, 2.09, 3.14, 3.14, 3.14, 3.14)


def seven_joints():
    """Describe the arm of identify_seven_joints.py with limits."""
    joints = [{'name': f'joint{i}', 'friction': ['viscous', 'coulomb', 'offset'], 'limits': {
        'lower': -angle, 'upper': angle, 'velocity': speed, 'acceleration': 15.0}}
        for i, (angle, speed) in enumerate(SEVEN, start=1)]
    return arm_from_dict({'name': 'seven joints', 'kinematics': {'dh': ROWS}, 'joints': joints},
                         base=Path('.'), source='bench')


def six_joints():
    """Describe a UR10 by its D-H rows, with the speeds of its data sheet."""
    rows = [list(row) for row in load_arm(CONFIG / 'ur10.yaml').spec.kinematics.dh]
    joints = [{'name': f'joint{i}', 'limits': {
        'lower': -2.8, 'upper': 2.8, 'velocity': speed, 'acceleration': 9.0}}
        for i, speed in enumerate(UR10, start=1)]
    return arm_from_dict({'name': 'UR10', 'kinematics': {'dh': rows}, 'joints': joints},
                         base=Path('.'), source='bench')


def arms():
    """Give the arm that choices were made on, then the others."""
    return load_arm(CONFIG / 'tudor.yaml'), seven_joints(), six_joints()


def order_of(arm, steps, seed):
    """Order a minute of motion, as tudor excite does."""
    return Order(SECONDS, default_highest(arm), DT, steps, seed)


def wanted(arm, noise=1.0):
    """Say what is to be identified, in the same noise of all channels of an output."""
    size = {'effort': np.full(len(arm.joints), noise)}
    return target_of_arm(arm, {**size, 'strain': np.ones(len(arm.gauges))}
                         if arm.gauges else size)


def errors(information, motion):
    """Give the standard errors of all parameters."""
    return np.concatenate([np.sqrt(np.diag(covariance_of(item)))
                           for item in information.matrices(motion)])


def determinant(covariances):
    """Make the volume of the ellipsoids of all errors small."""
    count = sum(len(item) for item in covariances)
    return (sum(np.linalg.slogdet(item)[1] for item in covariances) / (2.0 * count),
            [-0.5 / count * item for item in covariances])


def condition(covariances):
    """Make the condition numbers of scaled columns small."""
    cost, slopes = 0.0, []
    for covariance in covariances:
        information = np.linalg.inv(covariance)
        size = np.sqrt(np.diag(information))
        values, vectors = np.linalg.eigh(information / np.outer(size, size))
        cost += 0.5 * np.log(values[-1] / values[0]) / len(covariances)
        inner = 0.5 / len(covariances) * (
            np.outer(vectors[:, -1], vectors[:, -1]) / values[-1]
            - np.outer(vectors[:, 0], vectors[:, 0]) / values[0])
        scaled = information / np.outer(size, size)
        slopes.append(inner / np.outer(size, size)
                      - np.diag(np.sum(inner * scaled, axis=1) / size**2))
    return cost, slopes


def criteria():
    """Compare what the search may make small, by what comes out for all errors."""
    rows = {}
    for arm in arms()[:2]:
        target = wanted(arm)
        information, bounds = Information(target.models, target.noise.size), bounds_of(target)
        for name, criterion in (('mean logarithm of the errors', mean_error),
                                ('determinant of the covariance', determinant),
                                ('condition number', condition)):
            begun = time.process_time()
            motion = best_series(information, bounds, order_of(arm, 60, 0),
                                 criterion=criterion).motion[::EVERY]
            found, covariances = errors(information, motion), [
                covariance_of(item) for item in information.matrices(motion)]
            print(f'{arm.name:14} {name:26} geometric mean {np.exp(np.mean(np.log(found))):.4f} '
                  f'largest {found.max():.3f} condition {np.exp(condition(covariances)[0]):6.1f} '
                  f'{time.process_time() - begun:5.1f} s CPU', flush=True)
            rows.setdefault(name, [name]).extend((
                f'{np.exp(np.mean(np.log(found))):.4f}',
                f'{np.exp(condition(covariances)[0]):.2g}'))
    show(('cost', 'reference arm: errors', 'condition', 'seven joints: errors', 'condition'),
         rows.values())


def random_motions(arm, bounds):
    """Draw random motions of three kinds, which keep to the same limits."""
    for name, make in (
            ('Fourier, 0.5 Hz', lambda seed: random_series(
                bounds.range, bounds.limits, Order(SECONDS, 0.5, DT, 1, seed))),
            ('Fourier, 1 Hz', lambda seed: random_series(
                bounds.range, bounds.limits, Order(SECONDS, 1.0, DT, 1, seed))),
            ('APRBS', lambda seed: stimulus_motion(arm, SECONDS, seed, DT))):
        yield name, [make(seed).motion[::EVERY] for seed in range(RANDOM)]


def floors(information, bounds, motion):
    """
    Give errors that no motion of this length within the limits can fall below.

    For any u, (u_i)^2 <= var_i * n * max (y u)^2 over all states y (Cauchy and Schwarz); the
    largest over random states, many of them at the limits of speed and acceleration.
    """
    generator = np.random.default_rng(0)
    n = len(bounds.range.lower)

    def extreme(limit):
        kind = generator.random((STATES, n))
        anywhere = generator.uniform(-1.0, 1.0, (STATES, n))
        return limit * np.where(kind < 0.5, np.sign(anywhere), np.where(
            kind < 0.65, 0.05 * anywhere, anywhere))
    states = np.hstack([generator.uniform(bounds.range.lower, bounds.range.upper, (STATES, n)),
                        extreme(bounds.limits.velocity), extreme(bounds.limits.acceleration)])
    covariances = [covariance_of(item) for item in information.matrices(motion)]
    largest = [np.zeros((len(item), 2)) for item in covariances]
    for first in range(0, STATES, 2000):
        for part, covariance, rows in zip(largest, covariances, information.rows(
                states[first:first + 2000]), strict=True):
            for k, ways in enumerate((np.eye(len(covariance)), covariance)):
                part[:, k] = np.maximum(part[:, k], np.sum((rows @ ways)**2, axis=1).max(axis=0))
    return np.concatenate([np.sqrt(np.max(np.column_stack([
        np.ones(len(item)), np.diag(item)])**2 / (len(motion) * part), axis=1))
        for item, part in zip(covariances, largest, strict=True)])


def gain():
    """Compare planned and random motions."""
    rows = []
    for arm in arms():
        target = wanted(arm)
        information, bounds = Information(target.models, target.noise.size), bounds_of(target)
        planned = [best_series(information, bounds, order_of(arm, 60, seed)).motion[::EVERY]
                   for seed in range(2)]
        own = [errors(information, motion) for motion in planned]
        floor = floors(information, bounds, planned[0])
        rows.append([arm.name, len(own[0])])
        for name, motions in random_motions(arm, bounds):
            others = [errors(information, motion) for motion in motions]
            ratios = np.array([other / one for one in own for other in others])
            most = np.array([other / floor for other in others])
            medians, worst = np.median(ratios, axis=1), ratios.min(axis=1)
            open_ = most >= 3.0
            reached = np.mean([np.mean((other / one)[can] >= 3.0) for one in own
                               for other, can in zip(others, open_, strict=True) if can.any()])
            print(f'{arm.name:14} {name:16} median {medians.min():.2f} to {medians.max():.2f}, '
                  f'worst parameter {worst.min():.2f} to {worst.max():.2f}; 3 x can be had for at '
                  f'most {100 * open_.mean():.0f} % of the parameters, of which '
                  f'{100 * reached:.0f} % have it', flush=True)
            rows[-1].append(
                f'{medians.min():.2f} to {medians.max():.2f}, worst {worst.min():.2f}')
        rows[-1].append(f'{100 * open_.mean():.0f} %')
    show(('arm', 'parameters', 'random Fourier series to 0.5 Hz', 'to 1 Hz',
          'APRBS, as `tudor record`', '3 x possible, APRBS'), rows)


def recorded(arm, target, trajectory, parameters, noise, seed):
    """Give a fit of a simulated recording of exact motion, with white noise on the efforts."""
    exact = target.models['effort'].regressor.outputs(
        np.hstack([trajectory.q, trajectory.dq, trajectory.ddq]), parameters)
    recording = played(trajectory, arm)
    recording.effort[:] = exact + np.random.default_rng([seed, 7]).normal(0.0, noise, exact.shape)
    stretches = prepare(recording, target.preprocessing)
    model = AnalyticalModel(target.models['effort'].regressor, len(arm.joints))
    return model.fit_blocks(lambda: [
        block for stretch in stretches for block in stretch.blocks('effort')])


def promises():
    """Compare errors that a plan expects with those of fits, and with true ones."""
    noise, found = 0.1, []
    for arm in arms()[1:]:
        target = wanted(arm, noise)
        plan = make_plan(target, order_of(arm, 60, 0))
        expected = np.array([item.value for item in plan.expected])
        regressor = target.models['effort'].regressor
        [base] = base_sets(regressor, len(arm.joints))
        truth = np.tile(np.random.default_rng(3).uniform(0.1, 1.0, len(regressor.columns)),
                        (len(arm.joints), 1))
        rows = regressor.rows(random_inputs(regressor, len(arm.joints), 200, 5))
        exact = np.linalg.lstsq(rows[:, :, base.kept].reshape(-1, len(base.kept)), (
            rows @ truth[0]).ravel(), rcond=None)[0]
        reached, off = [], []
        for seed in range(8):
            [group] = recorded(arm, target, plan.trajectory, truth, noise, seed).groups_
            reached.append(group.estimate.standard_errors / expected)
            off.append((group.estimate.parameters - exact) / expected)
        ratio, off = np.array(reached), np.array(off)
        found.append((arm.name, f'{ratio.min():.2f} to {ratio.max():.2f}',
                      f'{np.sqrt(np.mean(off.var(axis=0, ddof=1))):.2f}',
                      f'{np.sqrt(np.mean(off.mean(axis=0)**2)):.2f}'))
    show((f'white noise of {noise:g} N m', 'each standard error', f'scatter over {len(off)} seeds',
          'mean off by'), found)
    with tempfile.TemporaryDirectory() as folder:
        closed_loop(Path(folder))


def command(*words):
    """Run a command of the package and give what it prints as JSON."""
    said = io.StringIO()
    with redirect_stdout(said):
        code = tudor([*map(str, words)])
    assert code in (0, 1), words
    return json.loads(said.getvalue()) if '--json' in words else None


def closed_loop(folder):
    """Let the reference arm record at random, plan with what that fit left, record, fit."""
    arm, rows = CONFIG / 'tudor.yaml', []
    for seed in (1, 2):
        here = folder / str(seed)
        command('record', '--arm', arm, '--stimuli', 1, '--jobs', 1, '--seed', seed, '--out',
                here / 'random')
        command('fit', here / 'random' / 'stimulus_01', '--arm', arm, '--out', here / 'first',
                '--exit-zero')
        command('excite', arm, '--floor', '-9', '--model', here / 'first', '--seed', seed,
                '--out', here / 'plan')
        command('record', '--arm', arm, '--trajectory', here / 'plan', '--stimuli', 1, '--jobs', 1,
                '--seed', seed + 10, '--out', here / 'planned')
        found = command('fit', here / 'planned' / 'stimulus_01', '--arm', arm, '--plan',
                        here / 'plan', '--out', here / 'second', '--exit-zero', '--json')['plan']
        rows.append((f'seed {seed}', *(
            f'median {found[f"median_over_{by}"]:.2f}, {found[f"within_30_percent_of_{by}"]:.0%} '
            'within 30 %' for by in ('expected', 'by_noise'))))
    show(('reference arm in its closed loop', 'by the residual of a random bag',
          'by that of its own fit'), rows)


PARTS = {'criteria': criteria, 'gain': gain, 'promises': promises}


def main():
    """Run the parts that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('parts', nargs='*', metavar='PART', help=f'of {", ".join(PARTS)}')
    parts = parser.parse_args().parts or PARTS
    for part in parts:
        if part not in PARTS:
            parser.error(f'{part}: expected some of {", ".join(PARTS)}')
    for part in parts:
        PARTS[part]()


if __name__ == '__main__':
    main()
