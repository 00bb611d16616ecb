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
Convergence of the simulator with elements and step; draws ``docs/pictures/convergence.png``.

Run with ``python bench/convergence.py [--out FILE.png]``. Frequencies are compared with those of
40 elements a beam, the motion of the L-shaped mechanism (two opposite steps of torque, 2 s) with 8
elements and a step of 25 us.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

from matplotlib.figure import Figure
import numpy as np

from tudor_dynamics.mechanics.mechanism import build_mechanism
from tudor_dynamics.mechanics.plant import Plant
from tudor_dynamics.mechanics.run import modes, Probe, run_plant

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from papers.lshape import l_shape, relative_rms  # noqa: E402, I100

SECONDS = 2.0


def motion(elements: int, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Give tip acceleration and mid-link moments at 1 kHz."""
    plant = Plant(build_mechanism(l_shape(elements)), dt)
    t = np.arange(int(round(SECONDS / dt)) + 1) * dt
    times = np.array([0.1, 0.105, 0.4, 0.405, 0.7, 0.705])
    torque = np.zeros((t.size, 2))
    torque[:, 0] = np.interp(t, times, [0.0, 0.6, 0.6, -0.6, -0.6, 0.0])
    run = run_plant(plant, Probe(plant), torque, every=int(round(1e-3 / dt)))
    return run.acceleration[:, plant.mechanism.tip], run.moment


def main() -> int:
    """Measure, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--out', type=Path, default=ROOT / 'docs' / 'pictures' / 'convergence.png')
    args = parser.parse_args()
    counts = [1, 2, 3, 4, 6, 8]
    fine = modes(Plant(build_mechanism(l_shape(40))), 8).frequency
    error = np.array([np.abs(modes(Plant(build_mechanism(l_shape(n))), 8).frequency / fine - 1.0)
                      for n in counts])
    for n, row in zip(counts, error, strict=True):
        print(f'{n} elements: frequencies 1 to 8 off by', np.array2string(100 * row, precision=4),
              '%')
    tip, moment = motion(8, 2.5e-5)
    by_elements = []
    for n in counts[:-1]:
        found = motion(n, 2.5e-5)
        by_elements.append((relative_rms(found[0], tip), relative_rms(found[1], moment)))
        print(f'{n} elements: tip acceleration {by_elements[-1][0]:.2e}, moments '
              f'{by_elements[-1][1]:.2e}')
    steps = [1e-3, 5e-4, 2.5e-4, 1e-4, 5e-5]
    by_step = []
    for dt in steps:
        found = motion(8, dt)
        by_step.append((relative_rms(found[0], tip), relative_rms(found[1], moment)))
        print(f'step {1e3 * dt:g} ms: tip acceleration {by_step[-1][0]:.2e}, moments '
              f'{by_step[-1][1]:.2e}')
    figure = Figure(figsize=(11.0, 3.6), layout='constrained')
    first, second, third = figure.subplots(1, 3)
    for mode in range(0, 8, 2):
        first.loglog(counts, np.maximum(error[:, mode], 1e-9), marker='o', markersize=4,
                     label=f'mode {mode + 1}')
    first.set(xlabel='elements a beam', ylabel='relative error',
              title='frequencies, clamped')
    for axes, x, values, label in (
            (second, counts[:-1], by_elements, 'elements a beam'),
            (third, [1e3 * dt for dt in steps], by_step, 'step [ms]')):
        values = np.array(values)
        axes.loglog(x, values[:, 0], marker='o', markersize=4, label='tip acceleration')
        axes.loglog(x, values[:, 1], marker='s', markersize=4, label='mid-link moments')
        axes.set(xlabel=label, ylabel='relative RMS error', title='motion over 2 s')
    slope = np.array(by_step)[-1, 0] * (np.array(steps) / steps[-1]) ** 2
    third.loglog([1e3 * dt for dt in steps], slope, linestyle=':', color='k', label='second order')
    for axes in (first, second, third):
        axes.grid(alpha=0.3, which='both')
        axes.legend(frameon=False, fontsize=8)
    for axes in (first, second):
        axes.set_xticks(counts, [str(n) for n in counts])
        axes.set_xlim(0.9, 9.0)
        axes.minorticks_off()
    args.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(args.out, dpi=110)
    print(f'{args.out} drawn')
    return 0


if __name__ == '__main__':
    sys.exit(main())
