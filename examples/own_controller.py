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
Try a controller against the plant, step by step: own_controller.png.

A motor carries a blade with a mass at its end. A servo brings the joint to its goal, and the blade
rings. Fed back into the velocity wanted, the moment at the blade's root damps it.
"""

import math
from pathlib import Path
import sys

from matplotlib.figure import Figure
import numpy as np

import tudor_dynamics as td
from tudor_dynamics.mechanics.run import Probe

ROOT = Path(__file__).resolve().parents[1]
DT = 1e-4
"""Step [s]."""
STEPS = 20000
GOAL = 0.3
"""Where the joint shall go [rad]."""
POSITION_GAIN, VELOCITY_GAIN = 4.0, 100.0
"""Of the servo [1/s, N m s/rad]."""
FEEDBACK = 0.3
"""Of the moment at the gauge, into the velocity wanted [rad/s per N m]."""


def strain_of(feedback: float) -> np.ndarray:
    """Give the strain while the joint goes to its goal [um/m]."""
    arm = td.load_arm(ROOT / 'config' / 'single_flexible_link.yaml')
    plant = td.Plant(td.build_mechanism(arm), DT)
    probe = Probe(plant, arm=arm)
    motor = plant.mechanism.joints.index('motor')
    weight = float(probe.observe().gauge_moment[0])  # of the horizontal blade, at rest
    strain, torque = [], np.zeros(2)
    for _ in range(STEPS):
        q, dq = float(plant.state.q[motor]), float(plant.state.dq[motor])
        seen = probe.observe()
        strain.append(float(seen.strain[0]))
        load = weight * math.cos(q)
        wanted = POSITION_GAIN * (GOAL - q) + feedback * (load - float(seen.gauge_moment[0]))
        torque[motor] = VELOCITY_GAIN * (wanted - dq) + load
        plant.step(torque)
    return np.array(strain)


def main(out: Path) -> None:
    """Compare the controller with and without feedback of the moment."""
    t = DT * np.arange(STEPS)
    figure = Figure(figsize=(8.0, 3.6), layout='constrained')
    axes = figure.subplots()
    for feedback, label in ((0.0, 'joint alone'), (FEEDBACK, 'with the moment fed back')):
        strain = strain_of(feedback)
        late = strain[t > 1.0]
        print(f'{label}: strain still swings by {np.ptp(late):.1f} um/m after 1 s')
        axes.plot(t, strain, label=label)
    axes.set(xlabel='time [s]', ylabel='strain at the hub [um/m]')
    axes.legend(frameon=False)
    figure.savefig(out / 'own_controller.png', dpi=110)


if __name__ == '__main__':
    main(Path(sys.argv[1] if len(sys.argv) > 1 else '.'))
