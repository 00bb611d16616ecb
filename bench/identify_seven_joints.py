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
Time and memory of regressor, base parameters and weighted least squares for a seven-joint arm.

98 columns: ten inertial parameters, rotor inertia, viscous and Coulomb friction and an offset for
each joint. Time is that of the processor. Peak memory is that of a process of its own, above one
that did the same at 100 samples. The peer is the same problem through FIGAROH (``pip install
figaroh``), where it is installed; a plain loop with one dense regressor matrix and LAPACK is timed
in any case.

    python bench/identify_seven_joints.py [--repeats 3]
"""

from __future__ import annotations

import argparse
from importlib.util import find_spec
import json
from math import pi
import os
from pathlib import Path
import resource
import statistics
import subprocess
import sys
import time

for _name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'):
    os.environ.setdefault(_name, '1')  # before numpy loads

import numpy as np  # noqa: E402
from tables import show  # noqa: E402

from tudor_dynamics.arm.description import arm_from_dict  # noqa: E402
from tudor_dynamics.models.analytical import AnalyticalModel  # noqa: E402
from tudor_dynamics.models.regressor import EffortRegressor  # noqa: E402

# D-H rows of a seven-joint arm with offset wrist; any seven-joint arm has as many columns.
ROWS = [[0, -pi / 2, 0.333, 0], [0, pi / 2, 0, 0], [0.0825, pi / 2, 0.316, 0],
        [-0.0825, -pi / 2, 0, 0], [0, pi / 2, 0.384, 0], [0.088, pi / 2, 0, 0], [0, 0, 0.107, 0]]
NOISE = 0.05


def described_arm(joints=7):
    """Describe the arm; with more joints than seven it goes on as it began."""
    rows = [ROWS[i % len(ROWS)] for i in range(joints)]
    named = [{'name': f'joint{i + 1}', 'friction': ['viscous', 'coulomb', 'offset']}
             for i in range(joints)]
    return arm_from_dict({'name': 'bench', 'kinematics': {'dh': rows}, 'joints': named},
                         base=Path('.'), source='bench')


def data(n, joints=7):
    """Make a random-phase multisine at 1 kHz and the torques of random links, with noise."""
    generator = np.random.default_rng(1)
    t = np.arange(n)[:, None] / 1000.0
    q, dq, ddq = np.zeros((3, n, joints))
    for harmonic in range(1, 9):
        w = 2 * pi * 0.1 * harmonic
        a, phase = generator.uniform(0.05, 0.25, joints), generator.uniform(0, 2 * pi, joints)
        q += a * np.sin(w * t + phase)
        dq += a * w * np.cos(w * t + phase)
        ddq -= a * w * w * np.sin(w * t + phase)
    motion = np.hstack([q, dq, ddq])
    regressor = EffortRegressor(described_arm(joints))
    truth = generator.uniform(0.1, 1.0, len(regressor.columns))
    tau = np.empty((n, joints))
    for first in range(0, n, 256):
        tau[first:first + 256] = regressor.rows(motion[first:first + 256]) @ truth
    return motion, tau + generator.normal(0, NOISE, tau.shape)


def ours(motion, tau):
    """Fit by this package: chunks, Gram matrices."""
    joints = tau.shape[1]
    model = AnalyticalModel(EffortRegressor(described_arm(joints)), joints)
    model.fit(motion, tau)
    group = model.groups_[0]
    return len(group.base.kept), float(np.sqrt(np.mean(group.estimate.variances)))


def plain(motion, tau):
    """Fit by one dense matrix, pivoted QR and two least-squares solutions."""
    from scipy.linalg import qr
    regressor = EffortRegressor(described_arm())
    dense = regressor.rows(motion).reshape(-1, len(regressor.columns))
    r, pivot = qr(dense, mode='r', pivoting=True)
    diagonal = np.abs(np.diag(r))
    kept = np.sort(pivot[:int(np.sum(diagonal > 1e-8 * diagonal[0] * 10))])
    base = dense[:, kept]
    y = tau.reshape(-1)
    x = np.linalg.lstsq(base, y, rcond=None)[0]
    sigma = (y - base @ x).reshape(-1, 7).std(axis=0)
    weight = np.tile(1 / sigma, len(tau))
    x = np.linalg.lstsq(base * weight[:, None], y * weight, rcond=None)[0]
    return len(kept), float((y - base @ x).std())


def figaroh(motion, tau):
    """Fit by FIGAROH: its regressor, column elimination, double QR; WLS by joint variance."""
    from types import SimpleNamespace

    from figaroh.tools.qrdecomposition import QRDecomposer
    from figaroh.tools.regressor import (
        build_regressor_basic, build_regressor_reduced, get_index_eliminate)
    model = described_arm().model
    for inertia in list(model.inertias)[1:]:
        inertia.mass = 1.0
    robot = SimpleNamespace(model=model, data=model.createData())
    config = {'has_friction': True, 'has_actuator_inertia': True, 'has_joint_offset': True,
              'is_joint_torques': True, 'act_idxv': list(range(7))}
    w = build_regressor_basic(robot, motion[:, :7], motion[:, 7:14], motion[:, 14:], config)
    names = {f'p{i}': 0.0 for i in range(w.shape[1])}
    index, kept = get_index_eliminate(w, names)
    reduced = build_regressor_reduced(w, index)
    y = tau.T.reshape(-1)  # joint by joint, as FIGAROH stacks them
    result = QRDecomposer().double_decomposition(y, reduced, kept)
    base = result[0]
    x = np.linalg.lstsq(base, y, rcond=None)[0]
    # its weighted_least_squares builds a dense matrix of (7 n)^2 weights; the same by rows
    sigma = np.repeat((y - base @ x).reshape(7, -1).std(axis=1), len(tau))
    x = np.linalg.lstsq(base / sigma[:, None], y / sigma, rcond=None)[0]
    return base.shape[1], float((y - base @ x).std())


METHODS = {'this package': ours, 'plain dense': plain}
if find_spec('figaroh'):
    METHODS['figaroh'] = figaroh


def measure(method, n, joints=7):
    """Run one method once in this process and print time, peak memory and result."""
    motion, tau = data(n, joints)
    METHODS[method](motion[:200], tau[:200])  # warm up
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begun = time.process_time()
    rank, residual = METHODS[method](motion, tau)
    seconds = time.process_time() - begun
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(json.dumps({'seconds': seconds, 'mib': (after - before) / 1024, 'rank': rank,
                      'residual': residual}))


def alone(method, n, joints=7):
    """Give time, peak memory and result of one method, in a process of its own."""
    done = subprocess.run(
        [sys.executable, __file__, '--measure', method, str(n), str(joints)],
        check=True, capture_output=True, text=True)
    return json.loads(done.stdout)


def main():
    """Measure all methods at both sizes, each in processes of their own."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--repeats', type=int, default=3)
    parser.add_argument('--measure', nargs=3, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.measure:
        measure(args.measure[0], int(args.measure[1]), int(args.measure[2]))
        return
    rows = []
    for n in (16_000, 100_000):
        reference = None
        for method in METHODS:
            runs = []
            for _ in range(args.repeats if n < 50_000 or method == 'this package' else 1):
                runs.append(alone(method, n))
            seconds = statistics.median(run['seconds'] for run in runs)
            memory = statistics.median(run['mib'] for run in runs)
            reference = reference or seconds
            rows.append((n, method, f'{1e6 * seconds / n:.2f} µs', f'{memory:.1f} MiB',
                         f'{seconds / reference:.1f}', runs[0]['rank']))
    show(('samples of seven joints', 'method', 'CPU a sample', 'memory above that of 100 samples',
          'ratio of times', 'base parameters'), rows)


if __name__ == '__main__':
    main()
