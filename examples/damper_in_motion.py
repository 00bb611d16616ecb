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
Move the reference arm with and without its damper: damper_in_motion.gif, and its last picture.

Both arms follow the same reference with 200 g at the tip. The picture bends the links ten times
as much as they do, because it is a matter of millimetres.
"""

from pathlib import Path
import sys

from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.figure import Figure
import numpy as np

import tudor_dynamics as td
from tudor_dynamics.mechanics.run import Probe

ROOT = Path(__file__).resolve().parents[1]
LOAD = 0.2
"""At the tip [kg]."""
SECONDS, MOVES_AT = 3.6, 0.2
START, GOAL = np.radians([70.0, 10.0]), np.radians([115.0, 55.0])
"""Both joints, before and after the move [rad]."""
EVERY = 80
"""Steps of the loop between two pictures: 25 a second."""
LARGER = 10.0
"""Bending in the picture, over that of the links."""
BLADES = (1, 2, 3), (5, 6, 7)
"""Points at the root, the middle and the end of each flexible link."""
STYLES = {'with the damper': ('-', '#1f5fa8', 1.0), 'without': ((0, (4, 1.5)), '#c8502d', 0.0)}


def run(damping: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Give times [s], points of the arm (pictures, points, 3) [m] and strain [um/m]."""
    arm = td.with_payload(td.load_arm(ROOT / 'config' / 'tudor.yaml'), LOAD)
    loop = td.ClosedLoop(arm, damping=damping, imperfections=td.Imperfections.none())
    loop.reset(START)
    reference = td.follow_targets(
        START, [np.array([MOVES_AT])] * 2, [goal[None] for goal in GOAL], td.motion_limits(arm),
        loop.dt, round(SECONDS / loop.dt))
    probe, points, parts = Probe(loop.plant), [], []
    for k in range(0, len(reference.q) - EVERY, EVERY):
        parts.append(loop.run(reference.q[k:k + EVERY], reference.dq[k:k + EVERY], every=EVERY))
        points.append(probe.observe().position.copy())
    return (EVERY * loop.dt * np.arange(len(points)), np.array(points),
            np.concatenate([part.strain[:, 0] for part in parts]))


def drawn(points: np.ndarray) -> np.ndarray:
    """Give the arm from the side with more bending: a parabola through the points of each link."""
    places, s = [points[0], points[1]], np.linspace(0.0, 1.0, 9)[1:, None]
    for root, middle, end in (points[list(blade)] for blade in BLADES):
        straight, bent = 4.0 * middle - end - 3.0 * root, 2.0 * (root - 2.0 * middle + end)
        places.extend(places[-1] + s * straight + LARGER * s**2 * bent)
    return np.array(places)[:, [0, 2]]


def main(out: Path) -> None:
    """Draw both arms from the side, and the strain of the first link below."""
    found = {name: run(damping) for name, (_, _, damping) in STYLES.items()}
    t = found['without'][0]
    shapes = {name: np.array([drawn(points) for points in item[1]])
              for name, item in found.items()}
    low, high = (pick([pick(item, axis=(0, 1)) for item in shapes.values()], axis=0)
                 for pick in (np.min, np.max))
    figure = Figure(figsize=(6.4, 5.2), layout='constrained')
    side, below = figure.subplots(2, height_ratios=(2, 1))
    side.set(aspect='equal', xlim=(low[0] - 0.1, high[0] + 0.1), ylim=(low[1], high[1] + 0.1),
             xlabel='x [m]', ylabel='z [m]', title='200 g at the tip; bending drawn x 10')
    below.set(xlim=(0.0, t[-1]), xlabel='time [s]', ylabel='strain of link 2 [um/m]',
              ylim=(min(item[2].min() for item in found.values()) - 50.0,
                    max(item[2].max() for item in found.values()) + 50.0))
    lines = []
    for name, (line, colour, _) in STYLES.items():
        rest = float(np.ptp(found[name][2][t > 2.0]))
        print(f'{name}: the strain oscillates by {rest:.1f} um/m, 2 s after the start')
        lines.append((side.plot([], [], linestyle=line, color=colour, linewidth=2.5)[0],
                      below.plot([], [], linestyle=line, color=colour, label=name)[0]))
    below.legend(frameon=False, loc='upper right', ncols=2)

    def draw(k: int) -> None:
        for (arm, curve), name in zip(lines, found, strict=True):
            arm.set_data(*shapes[name][k].T)
            curve.set_data(t[:k + 1], found[name][2][:k + 1])

    draw(len(t) - 1)
    figure.savefig(out / 'damper_in_motion.png', dpi=110)
    figure.set_layout_engine('none')  # places stay, and are not sought again in each picture
    moving = out / 'damper_in_motion.gif'
    FuncAnimation(figure, draw, frames=len(t)).save(moving, writer=PillowWriter(fps=25), dpi=70)


if __name__ == '__main__':
    main(Path(sys.argv[1] if len(sys.argv) > 1 else '.'))
