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
Speed of the simulator, against real time and against one LAPACK solve of the same size.

Run with ``OMP_NUM_THREADS=1 python bench/simulate_speed.py``. All figures of a run are from one
process with one thread; each is the processor's time, the best of several repetitions, after
compilation.
"""

from __future__ import annotations

import json
from pathlib import Path
import sys
from time import process_time

import numpy as np
from scipy.linalg import lapack
from tables import show

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.mechanics import integrator as gen
from tudor_dynamics.mechanics.mechanism import build_mechanism, Mechanism
from tudor_dynamics.mechanics.plant import Plant
from tudor_dynamics.mechanics.run import Probe

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from papers.lshape import l_shape  # noqa: E402, I100

REPEAT, SECONDS = 7, 5.0


def best(work, count=REPEAT) -> float:
    """Give the shortest time of several repetitions [s]."""
    times = []
    for _ in range(count):
        start = process_time()
        work()
        times.append(process_time() - start)
    return min(times)


def time_plant(mechanism: Mechanism, dt: float, torque, q, *, observe: int = 0) -> dict:
    """Step a plant through a run; ``observe``: steps between two looks at loads and strains."""
    plant = Plant(mechanism, dt)
    probe = Probe(plant) if observe else None
    steps = int(round(SECONDS / dt))
    values = np.array([torque(k * dt) for k in range(steps + 1)])

    def work() -> None:
        plant.reset(q)
        for k in range(1, steps + 1):
            plant.step(values[k])
            if probe is not None and k % observe == 0:
                probe.observe()

    work()
    seconds = best(work)
    counts = plant.tables.settings
    return {'step_us': 1e6 * seconds / steps, 'times_real_time': SECONDS / seconds,
            'unknowns': mechanism.size, 'iterations_per_step': counts[gen.ITERATIONS] / steps,
            'factorisations': int(counts[gen.FACTORS])}


def lapack_solve(size: int) -> dict:
    """One solve of a dense symmetric system of this size: bare dposv, and numpy's call."""
    generator = np.random.default_rng(0)
    a = generator.normal(size=(size, size))
    a = np.asfortranarray(a @ a.T + size * np.eye(size))
    b = generator.normal(size=size)

    def bare() -> None:
        for _ in range(1000):
            lapack.dposv(a, b)

    def numpy_call() -> None:
        for _ in range(1000):
            np.linalg.solve(a, b)

    bare()
    numpy_call()
    return {'dposv_us': 1e3 * best(bare), 'numpy_solve_us': 1e3 * best(numpy_call)}


def l_torque(t: float) -> list[float]:
    """Torque of the independent reference [N m]."""
    return [0.6 if 0.1 <= t < 0.4 else -0.6 if 0.4 <= t < 0.7 else 0.0, 0.0]


def arm_torque(t: float) -> list[float]:
    """Carry the elastic-link arm and shake it [N m]."""
    return [0.0, 7.4 + 1.5 * np.sin(9.0 * t), 0.36 + 0.2 * np.sin(14.0 * t)]


def main() -> int:
    """Measure, and print one JSON object and the table."""
    results: dict = {}
    l_mechanism = build_mechanism(l_shape(2))
    arm = build_mechanism(load_arm(ROOT / 'config' / 'elastic_arm.yaml'))
    results['lapack'] = {str(m.size): lapack_solve(m.size) for m in (l_mechanism, arm)}
    results['lapack']['25'] = lapack_solve(25)
    start = np.array([0.0, 0.3, -0.2])
    results['l_shape_1ms'] = time_plant(l_mechanism, 1e-3, l_torque, None)
    results['l_shape_1ms_observed'] = time_plant(l_mechanism, 1e-3, l_torque, None, observe=1)
    results['l_shape_4_elements_1ms'] = time_plant(
        build_mechanism(l_shape(4)), 1e-3, l_torque, None)
    results['elastic_arm_0.5ms'] = time_plant(arm, 5e-4, arm_torque, start)
    results['elastic_arm_0.5ms_observed'] = time_plant(arm, 5e-4, arm_torque, start, observe=1)
    for name in ('l_shape_1ms', 'elastic_arm_0.5ms'):
        size = str(results[name]['unknowns'])
        results[name]['in_numpy_solves'] = (
            results[name]['step_us'] / results['lapack'][size]['numpy_solve_us'])
    json.dump(results, sys.stdout, indent=2)
    show(('mechanism, step', 'unknowns', 'one step', 'times real time',
          'with loads and strains read at each step'),
         [(what, run['unknowns'], f'{run["step_us"]:.1f} µs', f'{run["times_real_time"]:.0f}',
           f'{seen["times_real_time"]:.0f}' if seen else '')
          for what, run, seen in (
              ('L, two elements a beam, 1 ms', results['l_shape_1ms'],
               results['l_shape_1ms_observed']),
              ('L, four elements a beam, 1 ms', results['l_shape_4_elements_1ms'], None),
              ('elastic arm, two elements a blade, 0.5 ms', results['elastic_arm_0.5ms'],
               results['elastic_arm_0.5ms_observed']))])
    return 0


if __name__ == '__main__':
    sys.exit(main())
