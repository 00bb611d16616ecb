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
Learn a tool that rings from the efforts of joints, and time a motion for it: still_tool.png.

Two joints carry a blade with a mass at its end. The model is learned from bags with efforts alone;
then the same path is passed as planned, shaped by impulses, and at another time.
"""

from pathlib import Path
import sys
from tempfile import TemporaryDirectory
from typing import Any

from matplotlib.figure import Figure
import numpy as np

import tudor_dynamics as td
from tudor_dynamics.mechanics.run import Probe
from tudor_dynamics.models.still_timing import shaped_for
from tudor_dynamics.signals.motion_profile import spline

DT, REST = 2e-3, 5.0
"""Step, and rest after each motion [s]."""
NAMES = ('shoulder', 'elbow')
ROBOT: dict[str, Any] = {
    'name': 'carrier', 'kinematics': {'dh': [[0.4, 0.0, 0.0, 0.0], [0.5, 0.0, 0.0, 0.0]]},
    'joints': [{'name': name, 'effort': {'topic': '/joint_states', 'unit': 'N m'}}
               for name in NAMES]}
TOOL: dict[str, Any] = {
    'payload': {'mass': 0.5}, 'simulation': {'rayleigh': {'alpha': 0.3, 'beta': 1e-3}},
    'links': [{'joint': 'shoulder', 'rigid': {'mass': 2.0}}, {'joint': 'elbow', 'flexible': {
        'section': {'shape': 'rectangle', 'height': 0.003, 'width': 0.015}, 'elements': 3,
        'material': {'E': 2.06e11, 'nu': 0.3, 'rho': 7850.0}}}]}


def described(content: dict[str, Any]) -> td.Arm:
    """Describe an arm."""
    return td.arm_from_dict(content, base=Path(), source='still_tool.py')


def planned(start: np.ndarray, target: np.ndarray, seconds: float) -> td.Trajectory:
    """Plan a motion from rest to rest, as controllers do it."""
    s = np.linspace(0.0, 1.0, 41)[:, None]
    way = target - start
    return td.Trajectory(NAMES, seconds * s[:, 0],
                         start + s**3 * (10.0 + s * (6.0 * s - 15.0)) * way,
                         30.0 * s**2 * (1.0 - s) ** 2 * way / seconds,
                         60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) * way / seconds**2)


def driven(wanted: td.Trajectory) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Simulate a motion and the rest after it; positions, efforts [N m] and the tip [m]."""
    plant = td.Plant(td.build_mechanism(described(ROBOT | TOOL)), DT)
    for name in NAMES:
        plant.drive(name, 'motion')
    curve, end = spline(wanted), wanted.t[-1]
    t = np.arange(0.0, end + REST, DT)
    states = [np.asarray(curve(np.minimum(t, end), order)) for order in range(3)]
    plant.reset(states[0][0])
    probe, effort, tip = Probe(plant), [], []
    for q, dq, ddq in zip(*states, strict=True):
        effort.append(np.array(plant.state.effort))
        tip.append(np.array(probe.observe().position[plant.mechanism.tip]))
        plant.step(motion=(q, dq, ddq))
    return states[0], np.array(effort), np.array(tip)


def main(out: Path) -> None:
    """Record, learn, and compare."""
    random, arm = np.random.default_rng(0), described(ROBOT)
    with TemporaryDirectory() as folder:
        bags = [str(Path(folder) / f'run{number}') for number in range(6)]
        for number, bag in enumerate(bags):
            start, target = random.uniform(-1.0, 1.0, (2, 2))
            q, effort, _ = driven(planned(start, target, 0.7))
            stamp = (1e9 * (10.0 * number + DT * np.arange(len(q)))).astype(np.int64)
            noise = random.normal(0.0, 0.02, effort.shape)
            td.write_bag(bag, [td.joint_signals('/joint_states', stamp, NAMES, q, None,
                                                effort + noise)])
        model = td.fit(bags, arm, settings=td.FitSettings(tool=True))
    print(model.tool)
    wanted = planned(np.array([-0.6, 0.9]), np.array([0.7, -0.4]), 0.8)
    figure = Figure(figsize=(8.0, 3.4), layout='constrained')
    axes = figure.subplots()
    ways = {'by another timing': shaped_for(model, wanted, 'timing'),
            'by ZV': shaped_for(model, wanted, 'zv'), 'as planned': wanted}
    rest = None
    for (label, moved), style in zip(ways.items(), ('-', ':', '--'), strict=True):
        _, _, tip = driven(moved)
        rest = tip[-1] if rest is None else rest
        t = DT * np.arange(len(tip)) - moved.t[-1]
        off = 1e3 * np.linalg.norm(tip - rest, axis=1)
        print(f'{label}: {off[(t > 0.0) & (t < 1.0)].max():.2f} mm after {moved.t[-1]:.2f} s')
        axes.plot(t, off, style, label=f'{label}, {moved.t[-1]:.2f} s')
    axes.axvline(0.0, color='0.6', linewidth=0.8)
    axes.set(xlim=(-0.3, 2.5), ylim=(0.0, 12.0), xlabel='time after the last point [s]',
             ylabel='tip, from where it rests [mm]')
    axes.legend(frameon=False)
    figure.savefig(out / 'still_tool.png', dpi=110)


if __name__ == '__main__':
    main(Path(sys.argv[1] if len(sys.argv) > 1 else '.'))
